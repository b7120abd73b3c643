"""Calls of tanks and environments, given anything and arrays in odd memory: refused, or done; never a number lost.

In any order, with copies and refusals between them, they answer as a fresh environment that is given those that count.
"""

import contextlib
import copy
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from fuzzing import FACTOR, LAYOUTS, REFUSED, THINGS, WHOLE, call, examples, numbers, odd, scaled, single
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from fish_env import INTEGRATORS, Tank, make_fish, make_sb3_vec_env, observation_layout
from fish_env.control import load_policy, shipped_policy
from fish_env.envs import FishVectorEnv
from fish_env.kernels.simd import Kind

pytestmark = pytest.mark.soft

FISH, SWIM, STUB = make_fish(), "FishEnv/Swim-v0", "FishEnv/Stub-v0"
ACTION = single(np.random.default_rng(0).uniform(-1.0, 1.0, (2, 12)))


def finite(tank):
    """Nothing of a tank is lost: what has failed is where it last was valid."""
    state = tank.get_state()
    return all(np.isfinite(array).all() for array in state.values()) and np.isfinite(tank.effort).all()


def durations(dt):
    """Durations that take no time: of a few steps, or more steps than a clock can count."""
    return st.one_of(st.sampled_from([0.0, -0.0, 1e-320, 1e-12, dt, 2 * dt, 3 * dt, 1.5 * dt, 1e154, 1e300, np.inf]),
                     st.sampled_from(THINGS), st.sampled_from([np.float32(dt), -dt, 10**400, "0.02"]))  # fmt: skip


steps = st.one_of(st.sampled_from([n for n in WHOLE if n <= 7 or n > 2**53]), st.sampled_from(THINGS))
nodes = st.one_of(st.sampled_from([[0], [3, 3], [], np.arange(23), np.zeros(23, bool), [-1], [23], [[0], [1]]]), odd)
points = st.one_of(scaled(np.zeros(3)), odd)
METHODS = st.sampled_from(["elimination", "penalty", "glue", None])
CALLS = {
    "advance": lambda tank: st.tuples(steps),
    "swim": lambda tank: st.tuples(st.one_of(scaled(ACTION), scaled(ACTION[0]), odd), durations(tank.dt)),
    "drive": lambda tank: st.tuples(st.one_of(scaled(abs(ACTION)), odd), steps),
    "command": lambda tank: st.tuples(st.one_of(scaled(abs(ACTION)), odd), st.one_of(durations(tank.dt), numbers)),
    "vary": lambda tank: st.tuples(st.one_of(st.sampled_from([0, 1, -1, 2]), odd), numbers, numbers, numbers, points),
    "grab": lambda tank: st.tuples(st.one_of(st.sampled_from([0, 22, 23]), odd), points, numbers, numbers, numbers,
                                   points),
    "fix": lambda tank: st.tuples(nodes, st.one_of(st.sampled_from(["xyz", "x", "", "w"]), odd), METHODS),
    "move": lambda tank: st.tuples(nodes, points, st.just("xyz"), METHODS),
    "release": lambda tank: st.tuples(nodes),
    "nearest": lambda tank: st.tuples(points, nodes, st.one_of(st.sampled_from([0, 1, 2]), odd)),
    "reset": lambda tank: st.tuples(st.one_of(st.sampled_from([None, np.array([True, False])]), odd)),
    "set_state": lambda tank: st.tuples(st.one_of(states(tank), odd)),
}  # fmt: skip


@st.composite
def states(draw, tank):
    """A state with one part changed, missing or unknown."""
    state = tank.get_state()
    name = draw(st.sampled_from([*state, "y"]))
    if draw(st.booleans()):
        state[name] = draw(st.one_of(scaled(state[name]), odd)) if name in state else 0.0
    else:
        state.pop(name, None)
    return state


@pytest.mark.parametrize("name", CALLS)
@examples(12)
@given(data=st.data())
def test_tank(name, data):
    """Every method of a tank: what is refused changes nothing, what is accepted leaves finite numbers."""
    tank = Tank(FISH, 2, water=FISH.water)
    for _ in range(2):
        arguments = data.draw(CALLS[name](tank))
        before = tank.get_state()
        if call(lambda: (getattr(tank, name)(*arguments), True)) is None:  # noqa: B023
            for part, array in tank.get_state().items():
                np.testing.assert_array_equal(array, before[part])
        call(tank.advance, 1)
        assert finite(tank)
    if name in ("fix", "move", "grab"):
        assert np.isfinite(tank.reactions()).all() or not tank.alive.all() or np.abs(tank.velocity).max() > 1e100


OPTIONS = {
    "task": "turn", "body": "mass_spring", "integrator": "leapfrog_chebyshev", "dt": 0.001, "control_interval": 0.02,
    "water": {"density": 900.0}, "muscle_groups": "pairs", "variation": {"mass": (0.8, 1.2)}, "max_episode_steps": 3,
    "threads": 2, "dtype": "float32", "lanes": 1, "refine": 0.1, "autoreset_mode": "SameStep", "render_mode": None,
    "info_every_step": True, "num_envs": 2, "speed": 1.0, "heading_error": 0.1, "unknown": 1,
}  # fmt: skip
WATERS = st.dictionaries(st.sampled_from(["density", "drag_coefficient", "current", "law", "salt"]),
                         st.one_of(numbers, scaled(np.zeros(3)), st.just("linear")), max_size=2)  # fmt: skip
VARIED = st.dictionaries(st.sampled_from(["mass", "stiffness", "drag", "current", "pitch", "depth"]),
                         st.one_of(numbers, st.tuples(numbers, numbers)), max_size=2)  # fmt: skip


@examples(40)
@given(data=st.data())
def test_environments(data):
    """Every keyword of `gym.make_vec`, one or two odd; what is made keeps to its space and to finite rewards."""
    names = data.draw(st.lists(st.sampled_from(list(OPTIONS)), min_size=1, max_size=2, unique=True))
    better = {"water": WATERS, "variation": VARIED, "control_interval": durations(FISH.time_step)}
    options = {name: data.draw(st.one_of(better.get(name, odd), odd, st.just(OPTIONS[name]))) for name in names}
    env = call(FishVectorEnv, **options)
    if env is None or env.num_envs > 64:
        return
    if FACTOR > 1 or (env.tank.kind == Tank(FISH, 2).kind and env._step is not None):  # others are compiled for
        call(env.reset, seed=0)
        for _ in range(2):
            obs, reward, *_ = env.step(env.action_space.sample())
            assert np.isfinite(reward).all() and env.observation_space.contains(obs)
    env.close()


@pytest.fixture(scope="module")
def batch():
    """Two fish that are stepped by all examples."""
    return FishVectorEnv(2, max_episode_steps=5)


seeds = st.one_of(
    st.sampled_from([None, 0, -1, 10**400, [1, 2], [1], [None, 3], np.array([4, 5]), [1, -1], [1.5, 2]]), odd
)


@examples(30)
@given(data=st.data())
def test_resets_and_steps(batch, data):
    """Resets with any seed and options, steps with any action: a refused one leaves no trace at all."""
    call(batch.reset, seed=7)
    other = FishVectorEnv(2, max_episode_steps=5)
    other.reset(seed=7)
    for _ in range(2):
        kind = data.draw(st.sampled_from(["seed", "options", "mask", "action"]))
        if kind == "action":
            done = call(batch.step, data.draw(st.one_of(scaled(ACTION), odd)))
        elif kind == "seed":
            done = call(batch.reset, seed=data.draw(seeds))
        elif kind == "mask":
            done = call(batch.reset, options={"reset_mask": data.draw(odd)})
        else:
            name, value = data.draw(st.sampled_from([*batch.reset_options, "wind"])), data.draw(st.one_of(numbers, odd))
            options = data.draw(st.sampled_from([{name: value, "yaw": 0.5}, value]))
            done = call(batch.reset, seed=3, options=options)
        if done is not None:
            assert batch.observation_space.contains(done[0])
            return
    for _ in range(2):  # all was refused: what follows is what would have followed without it
        for mine, others in zip(batch.step(ACTION)[:4], other.step(ACTION)[:4], strict=True):
            np.testing.assert_array_equal(mine, others)
    np.testing.assert_array_equal(batch.reset()[0], other.reset()[0])


def test_a_flat_fish_is_not_made_to_vary_in_pitch():
    """What every reset would refuse is refused when the environment is made."""
    with pytest.raises(ValueError, match="can neither pitch nor roll"):
        FishVectorEnv(2, body="planar", variation={"pitch": (-0.1, 0.1)})
    assert FishVectorEnv(2, body="planar", variation={"pitch": 0.0}).reset(seed=0)[0].shape[0] == 2


# Arrays in odd memory


def lay(layout, array):
    """The array in that layout; of boolean and whole numbers the plain one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return LAYOUTS[layout](np.asarray(array))


def begun():
    """Two fish after a reset."""
    env = FishVectorEnv(2)
    env.reset(seed=0)
    return env


def tank_after(change, **options):
    """The state of a tank of two fish after a change and two steps."""
    tank = Tank(FISH, 2, water=FISH.water, **options)
    change(tank)
    tank.advance(2)
    assert tank.alive.all()
    return tank.get_state()


STATE = {name: single(array) for name, array in Tank(FISH, 2).get_state().items()}
CHANGES = {
    "swim": lambda tank, lay: tank.swim(lay(ACTION), 6 * tank.dt),
    "drive": lambda tank, lay: tank.drive(lay(abs(ACTION)), 6),
    "command": lambda tank, lay: tank.command(lay(abs(ACTION)), tank.dt),
    "grab": lambda tank, lay: tank.grab(3, lay(np.array([0.5, 0.25, 0.0])), 2.0, velocity=lay(np.array([0.5, 0, 0]))),
    "move": lambda tank, lay: tank.move([3], lay(np.array([0.5, 0.25, 0.0]))),
    "vary": lambda tank, lay: tank.vary(1, 1.5, current=lay(np.array([0.5, 0.25, 0.0]))),
    "set_state": lambda tank, lay: tank.set_state({name: lay(array) for name, array in STATE.items()}),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_arrays_in_odd_memory(layout):
    """Strides, byte order, alignment, precision and protection of what is given change no bit of what follows."""
    chosen = lambda array: lay(layout, array)  # noqa: E731
    for name, change in CHANGES.items():
        plain, laid = (tank_after(lambda tank, how=how: change(tank, how)) for how in (np.array, chosen))  # noqa: B023
        for part, array in plain.items():
            np.testing.assert_array_equal(array, laid[part], err_msg=f"{name} {part}")
    one, other = begun(), begun()
    np.testing.assert_array_equal(one.step(ACTION)[0], other.step(chosen(ACTION))[0])


def test_one_compilation_for_all_memory():
    """A contraction in odd memory reaches the kernel as a plain one: nothing is compiled for it."""
    from fish_env.physics.muscles import command_all

    for layout in LAYOUTS:
        Tank(FISH, 2, water=FISH.water).drive(lay(layout, abs(ACTION)), 2)
    assert len({signature[1] for signature in command_all.signatures}) == 1


def test_arrays_of_its_own():
    """A tank and an environment may be given their own arrays: the result is that of copies."""
    for name, change in {
        "drive": lambda tank, own: tank.drive(own(tank.contraction.clip(0.0, 1.0)), 6),
        "swim": lambda tank, own: tank.swim(own(tank.velocity.reshape(2, -1)[:, :12]), 6 * tank.dt),
        "command": lambda tank, own: tank.command(own(tank.rest_length[:, :12]), tank.dt),
        "grab": lambda tank, own: tank.grab(3, own(tank.position[0, 3]), 2.0, velocity=own(tank.velocity[0, 0])),
        "move": lambda tank, own: tank.move([3], own(tank.velocity[0, 3])),
        "vary": lambda tank, own: tank.vary(1, current=own(tank.velocity[0, 5])),
        "set_state": lambda tank, own: tank.set_state(
            {**tank.get_state(), "x": own(tank.position[::-1]), "v": own(tank.velocity[::-1])}
        ),
        "reset": lambda tank, own: tank.reset(own(tank.alive)),
    }.items():
        before = lambda tank: tank.swim(0.5 * ACTION, 6 * tank.dt)  # noqa: E731
        one, other = (tank_after(lambda tank, own=own: (before(tank), change(tank, own)))  # noqa: B023
                      for own in (np.array, np.asarray))  # fmt: skip
        for part, array in one.items():
            np.testing.assert_array_equal(array, other[part], err_msg=name)
    one, other = begun(), begun()
    for env in (one, other):
        env.step(ACTION)
    obs = one.step(one._contraction)[0]
    np.testing.assert_array_equal(obs, other.step(other._contraction.copy())[0])
    np.testing.assert_array_equal(one.step(one._action)[0], other.step(other._action.copy())[0])


def test_observations_in_odd_memory():
    """A policy gives the same actions for observations in any memory."""
    policy = load_policy(shipped_policy("swim"))
    obs = FishVectorEnv(2).reset(seed=0)[0].astype(float)
    for layout in LAYOUTS:
        np.testing.assert_array_equal(policy(obs), policy(lay(layout, obs)))


@pytest.mark.parametrize("name", ["FishEnv.step", "FishVectorEnv.step", "FishVecEnv.step", "Tank.swim", "Tank.drive",
                                  "Policy"])  # fmt: skip
def test_odd_arrays(name):
    """What is under a mask, complex or needs a gradient is refused everywhere by a ValueError; bfloat16 is taken."""
    torch = pytest.importorskip("torch")
    single, batch, vec = gym.make(STUB).unwrapped, gym.make_vec(STUB), make_sb3_vec_env(STUB)
    for env in (single, batch, vec):
        env.reset()
    tank, policy = Tank(FISH, 1), load_policy(shipped_policy("swim"))
    call = {
        "FishEnv.step": lambda a: single.step(a[0]), "FishVectorEnv.step": batch.step, "FishVecEnv.step": vec.step,
        "Tank.swim": lambda a: tank.swim(a, tank.dt), "Tank.drive": lambda a: tank.drive(a, 1), "Policy": policy,
    }[name]  # fmt: skip
    plain = np.full((1, 156 if name == "Policy" else 12), 0.25)
    mask = np.zeros(plain.shape, dtype=bool)
    call(plain)
    call(np.ma.array(plain, mask=mask))
    for dtype in (torch.float32, torch.float64, torch.bfloat16, torch.float16):
        call(torch.from_numpy(plain).to(dtype))
    mask[0, 3] = True
    grad = torch.full(plain.shape, 0.25, requires_grad=True)
    for bad in (np.ma.array(plain, mask=mask), np.ma.array(plain, mask=True), grad, grad * 1.0,
                torch.nn.Parameter(grad.detach()), grad.to(torch.bfloat16), grad.detach().to(torch.complex64),
                grad.detach().to("meta"), grad.detach().to_sparse(), plain + 0j, plain.astype(str),
                np.zeros(plain.shape, "M8[s]"), [[10**400] * plain.size]):  # fmt: skip
        with pytest.raises(ValueError):
            call(bad)
    with pytest.raises(ValueError, match="detach"):
        call(grad)


def test_a_body_of_extreme_size_is_refused():
    """A fish whose stiffness no float can hold is refused in a sentence, not by an error of arithmetic."""
    for body in ("mass_spring", "planar", "two_layer", "tetrahedral"):
        with pytest.raises(ValueError, match="follows from numbers that are too large or too small"):
            make_fish(body, stiffness=(1e308,) * 3)


@pytest.mark.parametrize("number", [np.timedelta64(1, "s"), True, 1.0])
def test_no_whole_number(number):
    """Durations, which are whole numbers to numpy, truth values and floats name no fish and count no steps."""
    tank = Tank(FISH, num_fish=2)
    for refused in (lambda: tank.vary(number), lambda: tank.advance(number)):
        with pytest.raises(ValueError, match="give a whole number"):
            refused()


def test_no_text_and_no_lanes():
    """What is no text names no environment, and an empty array no lanes."""
    with pytest.raises(ValueError, match="id is None; give the name of an environment"):
        observation_layout(None)
    with pytest.raises(ValueError, match="lanes is array"):
        Kind(lanes=np.array([]))


def test_small_whole_numbers():
    """Counts of a type of numpy's that cannot hold what follows from them make the same tank and batch."""
    tank = Tank(FISH, num_fish=np.int8(2), threads=np.int8(1))
    assert (type(tank.num_fish), type(tank.threads)) == (int, int) and len(tank.position) == 2
    env = FishVectorEnv(np.int8(2))
    assert type(env.num_envs) is int and env.reset(seed=0)[0].shape[0] == 2
    env.close()


# Calls in any order


IDS = (SWIM, STUB) if FACTOR == 1 else tuple(sorted(id for id in gym.registry if id.startswith("FishEnv/")))
ids, few, some_steps, places = st.sampled_from(IDS), st.integers(0, 9), st.integers(0, 3), st.integers(0, 22)
new_seeds = st.sampled_from([None, 0, 3])
variations = st.sampled_from([None, {"mass": (0.8, 1.25), "current": (0.0, 0.3)}])
yaws = st.sampled_from([{}, {"yaw": 0.5}])
bad_actions = st.sampled_from([None, "left", np.zeros(5), np.full(12, np.inf), np.full((2, 12), np.nan),
                               np.zeros((2, 12), complex)])  # fmt: skip
bad_options = st.sampled_from(
    [{"wind": 1}, {"yaw": np.nan}, {"yaw": 9.0}, [1], {"reset_mask": [True]}, {"pitch": "up"}]
)


def same(one, other, place=""):
    """Whether two results have the same bits: arrays, numbers, and dictionaries and tuples of them."""
    assert type(one) is type(other), place
    if isinstance(one, dict):
        assert one.keys() == other.keys(), place
        for key in one:
            same(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), place
        for k, parts in enumerate(zip(one, other, strict=True)):
            same(*parts, f"{place}[{k}]")
    elif isinstance(one, np.ndarray) and one.dtype == object:
        same(one.tolist(), other.tolist(), place)
    else:
        one, other = np.asarray(one), np.asarray(other)
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes(), f"{place}: {one} is not {other}"


class Sequence(RuleBasedStateMachine):
    """Calls in any order. At the end a fresh environment is given those that count, and must answer alike."""

    def make(self):
        raise NotImplementedError

    def begin(self, **options):
        """Make the environment, and call it for the first time."""
        self.options, self.log = options, []
        self.env = self.make()
        self.first()

    def first(self):
        self.do("reset", seed=0)

    def answer(self, env, method, args, keywords):
        """What a method returns; of a tank, whose methods return nothing, the state that it leads to."""
        result = getattr(env, method)(*copy.deepcopy(args), **copy.deepcopy(keywords))
        return env.get_state() | {"effort": env.effort.copy()} if isinstance(env, Tank) else result

    def do(self, method, *args, **keywords):
        """Make a call that counts."""
        self.last = self.answer(self.env, method, args, keywords)
        self.log.append((method, args, keywords, copy.deepcopy(self.last)))
        return copy.deepcopy(self.last)

    def refused(self, method, *args, **keywords):
        """Make a call that is refused, and does not count."""
        with pytest.raises(REFUSED):
            getattr(self.env, method)(*args, **keywords)

    @rule(way=st.sampled_from(["pickle", "deepcopy", "pickle of a copy"]), seed=few)
    def clone(self, way, seed):
        """Go on with a copy; what becomes of the original does not matter to it."""
        original = self.env
        made = copy.deepcopy(original) if way != "pickle" else original
        self.env = pickle.loads(pickle.dumps(made)) if way != "deepcopy" else made
        self.disturb(original, seed)

    def disturb(self, original, seed):
        original.reset(seed=seed)
        original.close()

    @rule()
    def close(self):
        """Close it; a fish goes on, as its threads and its window begin again when they are needed."""
        getattr(self.env, "unwrapped", self.env).close()

    @rule()
    def overwrite(self):
        """Write to the arrays that were handed out last: they are the caller's."""
        for part in self.last if isinstance(self.last, tuple) else (self.last,):
            if isinstance(part, np.ndarray):
                part[...] = 1

    def teardown(self):
        """A fresh environment, given the same calls, answers with the same bits."""
        if not getattr(self, "log", None):
            return
        self.env.close()
        fresh = self.make()
        for k, (method, args, keywords, result) in enumerate(self.log):
            same(self.answer(fresh, method, args, keywords), result, f"call {k}, {method}")
        fresh.close()


class Batch(Sequence):
    """Several fish, by `gym.make_vec`, in all three autoreset modes."""

    def make(self):
        return gym.make_vec(**self.options)

    @initialize(id=ids, num_envs=st.sampled_from([1, 2]), max_episode_steps=st.integers(1, 5),
                autoreset_mode=st.sampled_from(["NextStep", "SameStep", "Disabled"]), threads=st.sampled_from([1, 2]),
                info_every_step=st.booleans(), variation=variations)  # fmt: skip
    def start(self, **options):
        self.begin(**options)

    @rule(seed=new_seeds, options=yaws, mask=st.integers(0, 3))
    def reset(self, seed, options, mask):
        chosen = (mask >> np.arange(self.env.num_envs) & 1).astype(bool)
        self.do("reset", seed=seed, options=options | ({"reset_mask": chosen} if chosen.any() else {}))

    @rule(seed=few)
    def step(self, seed):
        """Take an environment step; where autoreset is disabled, begin again what has ended."""
        action = np.random.default_rng(seed).uniform(-1.2, 1.2, self.env.action_space.shape)
        _, _, terminated, truncated, _ = self.do("step", action)
        over = terminated | truncated
        if over.any() and self.options["autoreset_mode"] == "Disabled":
            self.refused("step", action)
            self.do("reset", options={"reset_mask": over})

    @rule(action=bad_actions)
    def bad_step(self, action):
        self.refused("step", action)

    @rule(options=bad_options, seed=st.sampled_from([None, 5, -1]))
    def bad_reset(self, options, seed):
        self.refused("reset", seed=seed, options=options)


class Tanks(Sequence):
    """A tank: it is moved, held, dragged, varied and reset."""

    def make(self):
        return Tank(FISH, 2, water=FISH.water, **self.options)

    @initialize(integrator=st.sampled_from([None] if FACTOR == 1 else [None, *INTEGRATORS]))
    def start(self, **options):
        self.begin(**options)

    def first(self):
        self.saved = self.env.get_state()
        self.do("advance", 1)

    def disturb(self, original, seed):
        original.velocity[:] = seed
        original.fix([seed])
        original.advance(1)

    @rule(seed=few, steps=st.integers(1, 3))
    def drive(self, seed, steps):
        self.do("drive", np.tile(np.random.default_rng(seed).uniform(size=12), (2, 1)), steps)

    @rule(steps=some_steps)
    def advance(self, steps):
        self.do("advance", steps)

    @rule(call=st.one_of(
        st.tuples(st.just("fix"), st.lists(places, max_size=2), st.sampled_from(["x", "yz", "xyz"])),
        st.tuples(st.just("move"), st.lists(places, max_size=2), st.sampled_from([np.zeros(3), np.full(3, 0.01)])),
        st.tuples(st.just("grab"), places, st.just(np.array([0.1, 0, 0])), st.sampled_from([0.0, 5.0])),
    ))  # fmt: skip
    def hold(self, call):
        """Hold, move or drag a node, if the method can; a refusal has changed nothing."""
        with contextlib.suppress(ValueError):
            self.do(*call)

    @rule(nodes=st.sampled_from([None, [0, 5], list(range(23))]))
    def release(self, nodes):
        self.do("release", nodes)

    @rule(i=st.integers(0, 1), mass=st.sampled_from([0.8, 1.0, 1.25]))
    def vary(self, i, mass):
        self.do("vary", i, mass=mass)

    @rule(mask=st.sampled_from([None, np.array([True, False])]))
    def reset(self, mask):
        self.do("reset", mask)

    @rule(keep=st.booleans())
    def save_or_restore(self, keep):
        """Keep the state, or come back to the one that was kept, whatever holds the nodes now."""
        if keep:
            self.saved = self.env.get_state()
        else:
            self.do("set_state", self.saved)

    @rule(steps=some_steps)
    def twin(self, steps):
        """A fresh tank that is given the state goes on as a copy does whose nodes nothing holds."""
        copied, fresh = copy.deepcopy(self.env), self.make()
        copied.release(range(23))
        copied.release()
        state = copied.get_state()
        fresh.set_state(state)
        same(fresh.get_state(), state, "set_state")
        for each in (copied, fresh):
            each.advance(steps)
        same(fresh.get_state(), copied.get_state(), "advance after set_state")

    @rule(name=st.sampled_from(["x", "failure", "variation"]), value=st.sampled_from([np.nan, -5.0, None, 10**400]))
    def bad_state(self, name, value):
        """A state of which a part is missing or not allowed."""
        if name != "x" or value != -5.0:
            self.refused("set_state", {k: v for k, v in (self.saved | {name: value}).items() if v is not None})

    @rule(node=st.sampled_from([-1, 23, 10**30, 0.5, None]))
    def bad_node(self, node):
        self.refused("fix", [node])
        self.refused("grab", node, np.zeros(3), 1.0)


TestBatch, TestTank = Batch.TestCase, Tanks.TestCase
TestBatch.settings = TestTank.settings = examples(10, stateful_step_count=12)
