"""What was given is what counts, on every path: combinations drawn by a seed, of which none is silent.

Each combination is right, bit for bit, or raises an error. What is given: a condition of a tank, a keyword, a state, or
the interval of a policy. A path: how the environment was made, and how it was told.
"""

import copy
import functools
import inspect
import itertools
import pickle
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from fish_env import Tank, make_fish, make_sb3_vec_env
from fish_env.control import evaluate, load_policy
from fish_env.control.equivariant import export_policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.episode import Episodes

ID, ALIAS = "FishEnv/Swim-v0", "Every/Path-v0"
REFUSED = (ValueError, AttributeError, gym.error.Error)
STEPS, SEED = 6, 5


@pytest.fixture(scope="module", autouse=True)
def registered():
    """Ids of somebody else's project: the environment as it is, and at intervals of its own."""
    spec = gym.spec(ID)
    for name, kwargs in {ALIAS: {}, **{f"Every/Path{i}-v0": {"control_interval": i / 100} for i in (1, 2, 4)}}.items():
        gym.register(name, spec.entry_point, vector_entry_point=spec.vector_entry_point,
                     max_episode_steps=spec.max_episode_steps, kwargs=spec.kwargs | kwargs)  # fmt: skip
    yield
    for name in [name for name in gym.registry if name.startswith("Every/")]:
        del gym.registry[name]


class Pickled(FishVectorEnv):
    """A batch that was pickled after it was made."""

    def __new__(cls, num_envs, **options):
        env = gym.make_vec(ID, num_envs, **options).unwrapped
        return pickle.loads(pickle.dumps(env))


def dummy(**options):
    """Stable-Baselines3's own vector environment, with its monitor."""
    return DummyVecEnv([lambda: Monitor(gym.make(ID, **options))] * 2)


MAKERS = {
    "one": lambda **options: gym.make(ID, **options),
    "wrapped": lambda **options: gym.Wrapper(gym.make(ID, **options)),
    "registered": lambda **options: gym.make(ALIAS, **options),
    "copied": lambda **options: copy.deepcopy(gym.make(ID, **options)),
    "batch": lambda **options: gym.make_vec(ID, 2, **options),
    "pickled": lambda **options: Pickled(2, **options),
    "SyncVectorEnv": lambda **options: SyncVectorEnv([lambda: gym.make(ID, **options)] * 2),
    "SB3": lambda **options: make_sb3_vec_env(ID, 2, monitor=False, **options),
    "SB3, monitored": lambda **options: make_sb3_vec_env(ID, 2, **options),
    "DummyVecEnv": dummy,
}
"""Ways to make an environment of one or two fish."""


def fish_of(env) -> FishVectorEnv:
    """The batch in which the first fish of an environment is."""
    while not isinstance(env, FishVectorEnv):
        if hasattr(env, "envs"):
            env = env.envs[0]
        else:
            env = next(
                getattr(env, name)
                for name in ("fish", "venv", "env", "unwrapped")
                if getattr(env, name, None) is not None
            )
    return env


def begin(env) -> np.ndarray:
    """Reset with the seed: what the first fish observes."""
    if hasattr(env, "env_method"):
        env.seed(SEED)
        return env.reset()[0]
    obs, _ = env.reset(seed=SEED)
    return obs if isinstance(env, gym.Env) else obs[0]


def act(env, action: np.ndarray) -> tuple:
    """One step: observation, reward and end of the first fish."""
    if isinstance(env, gym.Env):
        obs, reward, terminated, truncated, _ = env.step(action)
        return obs, np.float32(reward), terminated or truncated
    found = env.step(np.stack([action] * 2))
    obs, reward = found[0][0], np.float32(found[1][0])
    return obs, reward, bool(found[2][0] or (len(found) == 5 and found[3][0]))


def actions(env, steps=STEPS) -> np.ndarray:
    """Some actions, the same for all environments of as many muscles."""
    return (
        np.random.default_rng(3).uniform(-1, 1, (steps, fish_of(env).single_action_space.shape[0])).astype(np.float32)
    )


def trace(env, obs=None) -> list:
    """What the first fish observes and gets in some steps, from a reset or from where it is; in the last it fails."""
    found = [begin(env) if obs is None else obs]
    for step, action in enumerate(actions(env)):
        if step == STEPS - 1:
            fish_of(env).tank.rest_length[0] = np.nan
        found += act(env, action)
        if found[-1]:
            break
    return found


def same(one: list, other: list) -> bool:
    """Whether two traces have the same bits; the observation after an end is that of the next episode on some paths."""
    ended = one[-1] is True and other[-1] is True
    pairs = [(a, b) for a, b in itertools.zip_longest(one, other)]
    if ended:
        del pairs[-3]
    return all(np.array_equal(a, b) for a, b in pairs)


def draw(count: int, *choices, allowed=lambda *case: True) -> list[tuple]:
    """So many combinations of the choices that are allowed, none twice."""
    every = [case for case in itertools.product(*choices) if allowed(*case)]
    picked = np.random.default_rng(11).permutation(len(every))[:count]
    return [every[i] for i in sorted(picked)]


@functools.cache
def untold(path: str) -> list:
    """The trace of an environment that is told nothing after it is made."""
    return trace(MAKERS[path]())


# Conditions of the tank


def sway(t: float) -> tuple[float, float, float]:
    """A displacement after a time, m."""
    return 0.0, 0.02 * np.sin(20.0 * t), 0.0


def pull(tank: Tank, **options) -> None:
    """A spring draws the nose aside."""
    tank.grab(0, tank.position[0, 0] + 0.05, 40.0, 0.1, **options)


def let_go(tank: Tank) -> None:
    """All that was given is taken away again."""
    tank.fix([0])
    pull(tank)
    tank.release([0])
    tank.release()


CONDITIONS = {
    "hold": lambda tank: tank.fix([0, 1]),
    "hold softly": lambda tank: tank.fix([0], method="penalty"),
    "lead": lambda tank: tank.move([0], (0.05, 0.0, 0.0)),
    "sway": lambda tank: tank.move([0], sway),
    "sway softly": lambda tank: tank.move([0], sway, method="penalty"),
    "pull": pull,
    "tow": lambda tank: pull(tank, velocity=(0.1, 0.0, 0.0)),
    "let go": let_go,
}
WHEN = ("at once", "later", "released")


@pytest.mark.parametrize(("condition", "path", "when"), draw(72, CONDITIONS, MAKERS, WHEN), ids=str)
def test_conditions(condition, path, when):
    """A condition acts as in a bare tank with the same commands; after its release, as if it had never been."""
    options = {"variation": {"stiffness": 1.1}} if path == "batch" else {}
    env = MAKERS[path](**options)
    begin(env)
    fish, own = fish_of(env), Tank(fish_of(env).tank.fish, fish_of(env).num_envs, water=fish_of(env).tank.world)
    for step, action in enumerate(actions(env)):
        if step == (0 if when == "at once" else 2):
            own.set_state(fish.tank.get_state())
            try:
                CONDITIONS[condition](fish.tank)
            except REFUSED:  # the fish of this batch are in different places
                assert fish.num_envs > 1 and "softly" in condition
                return
            CONDITIONS[condition](own)
        if step == 4 and when == "released":
            for tank in (fish.tank, own):
                tank.release(np.arange(tank.position.shape[1]))
                tank.release()
        act(env, action)
        if step >= 2 or when == "at once":
            own.swim(action.astype(float)[None].repeat(fish.num_envs, 0), fish.control_interval)
            assert np.array_equal(fish.tank.position, own.position), f"step {step}"
    if when == "released":
        assert same(trace(env), trace(MAKERS[path](**options)))


# Keywords

GOOD = {
    "integrator": "rk4", "dt": 0.001, "control_interval": 0.04, "water": "drag", "muscle_groups": "pairs",
    "variation": {"mass": 1.2}, "max_episode_steps": 4, "threads": 2, "dtype": "float32", "lanes": 1, "refine": 0.5,
    "observation": "sensors", "privileged": True, "history": 1, "observation_noise": {"velocity": 0.05},
    "action_noise": 0.1, "observation_delay": 1, "action_delay": 1, "failure_penalty": 3.0, "info_every_step": True,
    "heading_error": 0.0, "speed": 1.0, "effort_weight": 0.4, "body": "planar", "task": "turn", "camera": "side",
    "width": 320, "height": 320, "panel": False, "render_mode": "rgb_array", "autoreset_mode": "Disabled",
    "num_envs": 3,
}  # fmt: skip
BAD = {"failure_penalty": np.nan, "effort_weight": -1.0, "variation": {"mas": 1.2}, "heading_error": "north",
       "info_every_step": 2, "max_episode_steps": 0}  # fmt: skip
WAYS = {
    "set_attr": lambda env, name, value: env.set_attr(name, value if hasattr(env, "env_method") else [value] * 2),
    "set_wrapper_attr": lambda env, name, value: env.set_wrapper_attr(name, value),
    "env_method": lambda env, name, value: env.env_method("set_wrapper_attr", name, value),
    "attribute": lambda env, name, value: setattr(env.unwrapped, name, value),
    "attribute of the batch": lambda env, name, value: setattr(fish_of(env), name, value),
    "attribute of the task": lambda env, name, value: setattr(fish_of(env).task, name, value),
}
"""Ways to set a keyword; those of the wrappers of others are theirs, as the page says."""


def ways_of(path: str) -> tuple[str, ...]:
    """The ways that an environment has."""
    if path in ("one", "wrapped", "registered", "copied"):
        return "set_wrapper_attr", "attribute", "attribute of the batch", "attribute of the task"
    own = () if path in ("SB3", "SB3, monitored", "SyncVectorEnv", "DummyVecEnv") else ("attribute",)
    if path == "DummyVecEnv":
        return "env_method", "attribute of the batch", "attribute of the task"
    return "set_attr", *own, "attribute of the batch", "attribute of the task"


TOLD = [(path, way) for path in MAKERS for way in ways_of(path)]
OF_TASK = ("heading_error", "speed", "effort_weight")


def told(name: str, told: tuple[str, str]) -> bool:
    """Whether this way is one for this keyword: any other attribute of a task, and a misspelt one, is Python's own."""
    way = told[1]
    return name in OF_TASK if way == "attribute of the task" else name in GOOD or not way.startswith("attribute")


def test_all_keywords_are_tried():
    """The table has every keyword of the environments and of the task."""
    makers = (Episodes.__init__, FishVectorEnv.__init__, type(FishVectorEnv(1).task).__init__)
    names = {name for maker in makers for name in inspect.signature(maker).parameters}
    assert names - set(GOOD) == {"self", "options", "task_options", "weights"}


@pytest.mark.parametrize(("name", "by"), draw(120, GOOD, TOLD, allowed=told), ids=str)
def test_keywords(name, by):
    """A keyword that is set counts in the next episode as if the environment had been made with it, or is refused."""
    path, way = by
    env, value = MAKERS[path](), GOOD[name]
    trace(env)
    try:
        WAYS[way](env, name, value)
    except REFUSED as error:
        assert name in str(error)
        assert same(trace(env), untold(path))
        return
    assert same(trace(env), trace(MAKERS[path](**{name: value})))


@pytest.mark.parametrize(("name", "by"), draw(40, [*BAD, "efort_weight", "action_nois"], TOLD, allowed=told), ids=str)
def test_what_is_not_allowed(name, by):
    """A value that is not allowed, and a misspelt name, are refused, and nothing has changed."""
    path, way = by
    env = MAKERS[path]()
    with pytest.raises(REFUSED, match=name):
        WAYS[way](env, name, BAD.get(name, 1.0))
    assert same(trace(env), untold(path))


# States

THICK = [(0.0, 0.02, 0.03), (0.4, 0.07, 0.1), (0.8, 0.02, 0.04), (1.0, 0.01, 0.08)]

OTHERS = {
    "the same": {}, "threads": {"threads": 2}, "severity": {"effort_weight": 0.4}, "method": {"integrator": "rk4"},
    "step": {"dt": 0.002}, "water": {"water": {"drag_coefficient": 1.0}}, "interval": {"control_interval": 0.04},
    "a fish for drag": {"water": "drag"}, "slow muscles": {"body": functools.partial(make_fish, contraction_time=0.3)},
    "another outline": {"body": functools.partial(make_fish, outline=THICK)}, "history": {"history": 1},
    "delay": {"action_delay": 1}, "length": {"body": functools.partial(make_fish, length=0.3)},
    "groups": {"muscle_groups": "pairs"}, "sensors": {"observation": "sensors"}, "task": {"task": "turn"},
}  # fmt: skip
SAME_BITS = ("the same", "threads")
DOCUMENTED = (*SAME_BITS, "severity", "method", "step", "water")
"""What may differ where a state is set, as the page says."""


def options_of(other: str) -> dict:
    """The keywords of an environment that differs."""
    return {name: value() if callable(value) else value for name, value in OTHERS[other].items()}


def make(path: str, other: str):
    """An environment that differs; of another task it is made by the batch's own class."""
    options = options_of(other)
    if "task" in options:
        return FishVectorEnv(2, **options)
    return MAKERS[path](**options)


STATEFUL = [path for path in MAKERS if path not in ("SyncVectorEnv", "DummyVecEnv", "SB3, monitored", "copied")]


@pytest.mark.parametrize(("other", "source", "target"), draw(90, OTHERS, STATEFUL, STATEFUL), ids=str)
def test_states(other, source, target):
    """A state goes on with the same bits in the same fish, is taken where a page says so, and is refused elsewhere."""
    env, into = MAKERS[source](), make(target, other)
    begin(env), begin(into)
    for action in actions(env)[:2]:
        act(env, action)
    state = fish_of(env).get_state([0])
    try:
        obs = fish_of(into).set_state(state)[0]
    except ValueError as error:
        assert other not in DOCUMENTED, error
        return
    assert other in DOCUMENTED
    assert np.array_equal(fish_of(env).tank.position[0], fish_of(into).tank.position[0])
    if other in SAME_BITS:
        assert same(trace(env, fish_of(env).observe()[0]), trace(into, obs))


# Intervals of policies

INTERVALS = (0.01, 0.02, 0.03, 0.04)
GIVEN = ("keyword", "registered")
FORMS = ("model in a batch", "model in a DummyVecEnv", "exported", "a file", "an onnx file")
SEEN = ("batch", "one")


class Trained(NamedTuple):
    """An untrained network, as a training at an interval would leave it."""

    batch: PPO
    own: PPO
    files: dict[str, str]


@functools.cache
def trained(interval: float, given: str, folder) -> Trained:
    """The same network for all intervals, in the environment of its training."""
    id = ID if given == "keyword" else f"Every/Path{round(100 * interval)}-v0"
    options = {"control_interval": interval} if given == "keyword" else {}
    batch = PPO(
        "MlpPolicy", make_sb3_vec_env(id, 2, **options), seed=1, device="cpu", policy_kwargs={"log_std_init": 0.0}
    )
    with_head(batch)
    own = PPO("MlpPolicy", DummyVecEnv([lambda: gym.make(id, **options)]), seed=1, device="cpu")
    own.policy.load_state_dict(batch.policy.state_dict())
    policy = export_policy(batch, {"env_id": id, "env_options": options})
    files = {"a file": f"{folder}/{given}{interval}.npz", "an onnx file": f"{folder}/{given}{interval}.onnx"}
    policy.save(files["a file"])
    policy.to_onnx(files["an onnx file"])
    return Trained(batch, own, files | {"exported": policy})


def with_head(model: PPO) -> None:
    """Let the actions of a fresh network be large, so that it matters when it acts."""
    model.policy.action_net.weight.data *= 100.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the policies are."""
    return tmp_path_factory.mktemp("policies")


CASES = [case for case in itertools.product(FORMS, INTERVALS, GIVEN, INTERVALS, SEEN)
         if not (case[2] == "registered" and case[1] == 0.03)]  # fmt: skip


@pytest.mark.parametrize(
    ("form", "interval", "given", "acts", "seen"), [CASES[i] for (i,) in draw(80, range(len(CASES)))], ids=str
)
def test_intervals(folder, form, interval, given, acts, seen):
    """A policy acts at the interval of its training in every form, and where that cannot be, it is refused."""
    made = trained(interval, given, folder)
    policy = {"model in a batch": made.batch, "model in a DummyVecEnv": made.own} | made.files
    options = {"control_interval": acts, "max_episode_steps": 12}
    env = gym.make_vec(ID, 2, **options) if seen == "batch" else gym.make(ID, **options)
    fits = abs(interval / acts - round(interval / acts)) < 1e-9
    if not fits:
        with pytest.raises(ValueError, match="control_interval"):
            evaluate(env, policy[form], **{} if seen == "batch" else {"episodes": 2})
        return
    found = evaluate(env, policy[form], **{} if seen == "batch" else {"episodes": 2})
    wanted = held(load_policy(made.files["a file"]), round(interval / acts), options)
    assert np.allclose(found["return"], wanted, rtol=1e-5, atol=1e-6)


def held(policy, every: int, options: dict) -> np.ndarray:
    """Returns of two fish by a loop of its own: commands move linearly to what the policy wants next."""
    env = gym.make_vec(ID, 2, **options)
    obs, _ = env.reset(seed=1_000_000)
    total, goal = np.zeros(2), None
    for step in range(12):
        if step % every == 0:
            goal = policy(obs)
        start = (2.0 * env.unwrapped.tank.contraction - 1.0).astype(np.float32)
        obs, reward, *_ = env.step((start + (goal - start) / (every - step % every)).astype(np.float32))
        total += reward
    return total
