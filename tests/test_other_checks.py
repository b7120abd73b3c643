"""Other people's tests: checkers and wrappers of Gymnasium and Stable-Baselines3 over every id, body and option."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.wrappers import vector as batched
from moving import tiered

from fish_env import BODIES, INTEGRATORS
from fish_env.envs import VARIATIONS

IDS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))
OPTIONS = {
    "variation": {"variation": {name: (option.low, option.high) for name, option in VARIATIONS.items()}},
    "interval": {"control_interval": 0.04},
    "limit": {"max_episode_steps": 2},
    "linear water": {"water": {"law": "linear", "drag_coefficient": 500.0, "current": (0.1, 0.0, 0.0)}},
    "vacuum": {"water": {"density": 0.0}},
    "float32": {"dtype": "float32"},
    "one lane": {"lanes": 1},
    "threads": {"threads": 2},
    "no refinement": {"refine": float("inf")},
}
"""Keywords that every environment takes, one at a time."""
OF_TASKS = {
    "speed": ("FishEnv/Swim-v0", {"speed": (0.5, 1.5)}),
    "angle": ("FishEnv/Turn-v0", {"angle": 1.0}),
    "severity": ("FishEnv/LeftAfterRight-v0", {"severity": 1.0, "reversals": 2}),
    "dimensions": ("FishEnv/Target-v0", {"dimensions": 3, "radius": 0.3}),
    "sweeping": ("FishEnv/Avoid-v0", {"sweeping": 1.0, "drift": 2.0, "turning": 0.0}),
}
"""Keywords of single tasks."""
CASES = {f"Swim-v0 {name}": ("FishEnv/Swim-v0", keywords) for name, keywords in OPTIONS.items()}
CASES |= {f"Swim-v0 {name}": ("FishEnv/Swim-v0", {"body": name}) for name in BODIES}
CASES |= {f"Swim-v0 {name}": ("FishEnv/Swim-v0", {"integrator": name}) for name in INTEGRATORS}
CASES |= {f"{id[8:]} pairs": (id, {"muscle_groups": "pairs"}) for id in IDS}
CASES |= {f"{id[8:]} info": (id, {"info_every_step": True}) for id in IDS}
CASES |= {f"{id[8:]} {name}": (id, keywords) for name, (id, keywords) in OF_TASKS.items()}
SURE = [f"Swim-v0 {name}" for name in ("variation", "limit", "threads", "speed", "mass_spring")]
SURE += [f"{id[8:]} {name}" for id in IDS for name in ("pairs", "info")]
"""Those that other tests compile the kernels of anyway."""


each_case = pytest.mark.parametrize("case", tiered(CASES, SURE))
each_id = pytest.mark.parametrize("id", tiered(IDS, ("FishEnv/Swim-v0",)))


def made(case):
    """The environment of a case."""
    id, keywords = CASES[case]
    try:
        return gym.make(id, **keywords, disable_env_checker=True)
    except ValueError as error:
        pytest.skip(str(error))  # a method that has no stable step on a body, or a flat fish that is to roll


@each_case
@pytest.mark.parametrize("checker", ["gymnasium.utils", "stable_baselines3.common"])
def test_checkers(checker, case):
    """The environment checkers of Gymnasium and Stable-Baselines3 have nothing to say: a warning is an error."""
    check = pytest.importorskip(f"{checker}.env_checker").check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(made(case).unwrapped, skip_render_check=case != "Swim-v0 mass_spring")


@pytest.mark.parametrize("id", IDS)
def test_infos_are_equal(id):
    """With `info_every_step`, infos of the same fish are equal as Gymnasium's tests compare them: none is NaN."""
    make = {"one": gym.make, "batch": lambda id, **options: gym.make_vec(id, 2, **options)}
    for maker in make.values():
        envs = [maker(id, info_every_step=True) for _ in range(2)]
        infos = [env.reset(seed=5)[1] for env in envs]
        for step in range(min(80, gym.spec(id).max_episode_steps - 1)):
            assert data_equivalence(*infos) and infos[0]
            action = np.full(envs[0].action_space.shape, (-1.0) ** (step // 6), dtype=np.float32)
            infos = [env.step(action)[4] for env in envs]


# Wrappers

ZERO, ONE = np.float32([0.0, 1.0])
BASIC = {
    "ClipAction": {}, "ClipReward": {"min_reward": -1.0, "max_reward": 1.0}, "DtypeObservation": {"dtype": np.float16},
    "FlattenObservation": {}, "NormalizeObservation": {}, "NormalizeReward": {}, "RecordEpisodeStatistics": {},
    "RescaleAction": {"min_action": ZERO, "max_action": ONE}, "RescaleObservation": {"min_obs": ZERO, "max_obs": ONE},
}  # fmt: skip
"""Keywords of Gymnasium's wrappers, for one environment and for batches; not those of pictures and functions."""
OF_ONE = BASIC | {
    "Autoreset": {}, "DelayObservation": {"delay": 2}, "DiscretizeAction": {"bins": 2, "multidiscrete": True},
    "DiscretizeObservation": {"bins": 3, "multidiscrete": True}, "FrameStackObservation": {"stack_size": 3},
    "MaxAndSkipObservation": {"skip": 2}, "OrderEnforcing": {}, "PassiveEnvChecker": {},
    "RepeatAction": {"num_repeats": 2}, "StickyAction": {"repeat_action_probability": 0.5}, "TimeAwareObservation": {},
    "TimeLimit": {"max_episode_steps": 3},
}  # fmt: skip
says_lowered = pytest.mark.filterwarnings("ignore:.*precision lowered by casting to float16")


def check_same(answers):
    """Two lists of answers have the same bits."""
    for one, other in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, other)


@says_lowered
@pytest.mark.parametrize("name", [name for name in OF_ONE if hasattr(wrappers, name)])
@each_id
def test_wrappers(id, name):
    """Wrapped in each, two environments answer alike, within the wrapper's spaces, over the ends of episodes."""
    answers = []
    for _ in range(2):
        env = getattr(wrappers, name)(gym.make(id, max_episode_steps=5), **OF_ONE[name])
        env.action_space.seed(1)
        obs, _ = env.reset(seed=4)
        answers.append([obs])
        for _ in range(12):
            assert env.observation_space.contains(obs), name
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            answers[-1] += [obs, reward, terminated, truncated]
            assert np.isfinite(reward) and np.isfinite(obs).all()
            if (terminated or truncated) and name != "Autoreset":
                obs, _ = env.reset()
    check_same(answers)


@says_lowered
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("name", [*BASIC, "DictInfoToList"])
@each_id
def test_wrappers_of_batches(id, name, mode):
    """Wrapped in each wrapper for batches, the native batch answers as Gymnasium's own batch of single fish does."""
    answers = []
    native = gym.make_vec(id, 3, max_episode_steps=4, autoreset_mode=mode)
    mode = native.metadata["autoreset_mode"]
    own = gym.vector.SyncVectorEnv([lambda: gym.make(id, max_episode_steps=4)] * 3, autoreset_mode=mode)
    if "Observation" in name and mode is gym.vector.AutoresetMode.SAME_STEP:
        pytest.skip("Gymnasium's wrappers of observations take no batches that restart in the same step")
    for batch in (native, own):
        env = getattr(batched, name)(batch, **BASIC.get(name, {}))
        env.action_space.seed(1)
        wrong = name == "NormalizeObservation" and env.observation_space == batch.observation_space  # Gymnasium 1.2's
        answers.append([env.reset(seed=4)[0]])
        for _ in range(10):
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            assert wrong or env.observation_space.contains(obs)
            answers[-1] += [obs, reward, terminated, truncated]
    check_same(answers)
