"""Environments that are reset, stepped, closed, copied and pickled in any order behave as fresh ones that are not."""

import contextlib
import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from fuzzing import FACTOR, REFUSED, examples
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from fish_env import INTEGRATORS, Tank, make_fish, make_sb3_vec_env

FISH = make_fish()
IDS = ("FishEnv/Swim-v0", "FishEnv/Stub-v0") if FACTOR == 1 else tuple(
    sorted(id for id in gym.registry if id.startswith("FishEnv/")))  # fmt: skip
ids, seeds, some_steps, nodes = st.sampled_from(IDS), st.integers(0, 9), st.integers(0, 3), st.integers(0, 22)
new_seeds = st.sampled_from([None, 0, 3])
variations = st.sampled_from([None, {"mass": (0.8, 1.25), "current": (0.0, 0.3)}])
yaws = st.sampled_from([{}, {"yaw": 0.5}])
bad_actions = st.sampled_from([None, "left", np.zeros(5), np.full(12, np.inf), np.full((2, 12), np.nan),
                               np.zeros((2, 12), complex)])  # fmt: skip
bad_options = st.sampled_from(
    [{"wind": 1}, {"yaw": np.nan}, {"yaw": 9.0}, [1], {"reset_mask": [True]}, {"pitch": "up"}]
)


def actions(shape):
    """Actions of that shape, from a seed."""
    return seeds.map(lambda seed: np.random.default_rng(seed).uniform(-1.2, 1.2, shape).astype(np.float32))


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

    @rule(way=st.sampled_from(["pickle", "deepcopy", "pickle of a copy"]), seed=seeds)
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


class Single(Sequence):
    """One fish, by `gym.make`, in Gymnasium's wrappers, in episodes of a few steps."""

    def make(self):
        return gym.make(**self.options, disable_env_checker=True)

    @initialize(id=ids, max_episode_steps=st.integers(1, 6), variation=variations)
    def start(self, **options):
        self.begin(**options)

    @rule(seed=new_seeds, options=yaws)
    def reset(self, seed, options):
        self.do("reset", seed=seed, options=options)

    @rule(action=actions(12))
    def step(self, action):
        """Take an environment step, also after the end of an episode."""
        self.do("step", action)

    @rule(action=bad_actions)
    def bad_step(self, action):
        if np.shape(action) != (2, 12):  # TimeLimit counts before it asks
            self.refused("step", action)

    @rule(options=bad_options, seed=seeds)
    def bad_reset(self, options, seed):
        with pytest.raises(REFUSED):
            self.env.unwrapped.reset(seed=seed, options=options)


class Batch(Sequence):
    """Several fish, by `gym.make_vec`, in all three autoreset modes."""

    def make(self):
        return gym.make_vec(**self.options)

    @initialize(id=ids, num_envs=st.sampled_from([1, 3]), max_episode_steps=st.integers(1, 5),
                autoreset_mode=st.sampled_from(["NextStep", "SameStep", "Disabled"]), threads=st.sampled_from([1, 2]),
                info_every_step=st.booleans(), variation=variations)  # fmt: skip
    def start(self, **options):
        self.begin(**options)

    @rule(seed=new_seeds, options=yaws, mask=st.integers(0, 7))
    def reset(self, seed, options, mask):
        chosen = (mask >> np.arange(self.env.num_envs) & 1).astype(bool)
        self.do("reset", seed=seed, options=options | ({"reset_mask": chosen} if chosen.any() else {}))

    @rule(seed=seeds)
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


class OfStableBaselines3(Sequence):
    """The `VecEnv` of Stable-Baselines3."""

    def make(self):
        return make_sb3_vec_env(num_envs=2, max_episode_steps=3, monitor=False, **self.options)

    @initialize(id=ids, seed=seeds, staggered=st.booleans())
    def start(self, **options):
        pytest.importorskip("stable_baselines3")
        self.begin(**options)

    def first(self):
        self.do("reset")

    def disturb(self, original, seed):
        original.seed(seed)
        original.reset()
        original.close()

    @rule(seed=new_seeds)
    def reset(self, seed):
        if seed is not None:
            self.do("seed", seed)
        self.do("reset")

    @rule(action=actions((2, 12)))
    def step(self, action):
        self.do("step", action)

    @rule(action=bad_actions)
    def bad_step(self, action):
        self.refused("step", action)


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

    @rule(action=actions(12), steps=st.integers(1, 3))
    def drive(self, action, steps):
        self.do("drive", np.tile(0.5 * (action.clip(-1, 1) + 1.0), (2, 1)), steps)

    @rule(steps=some_steps)
    def advance(self, steps):
        self.do("advance", steps)

    @rule(call=st.one_of(
        st.tuples(st.just("fix"), st.lists(nodes, max_size=2), st.sampled_from(["x", "yz", "xyz"])),
        st.tuples(st.just("move"), st.lists(nodes, max_size=2), st.sampled_from([np.zeros(3), np.array([0.01, 0, 0])])),
        st.tuples(st.just("grab"), nodes, st.just(np.array([0.1, 0, 0])), st.sampled_from([0.0, 5.0])),
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


TestSingle, TestBatch, TestVecEnv, TestTank = (
    machine.TestCase for machine in (Single, Batch, OfStableBaselines3, Tanks)
)
TestSingle.settings = TestBatch.settings = TestVecEnv.settings = TestTank.settings = examples(
    10, stateful_step_count=12
)
