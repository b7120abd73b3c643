"""Other people's tests: checkers and wrappers of Gymnasium and Stable-Baselines3 over every id, body and option."""

import hashlib
import random
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector as batched
from moving import tiered

from fish_env import BODIES, INTEGRATORS, make_sb3_vec_env
from fish_env.envs import VARIATIONS

IDS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))
OPTIONS = {
    "pairs": {"muscle_groups": "pairs"},
    "variation": {"variation": {name: (option.low, option.high) for name, option in VARIATIONS.items()}},
    "info": {"info_every_step": True},
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
CASES = {f"{id[8:]} {name}": (id, keywords) for id in IDS for name, keywords in OPTIONS.items()}
CASES |= {f"{id[8:]} {body}": (id, {"body": body}) for id in IDS for body in BODIES}
CASES |= {f"{id[8:]} {name}": (id, keywords) for name, (id, keywords) in OF_TASKS.items()}
CASES |= {f"Swim-v0 {name}": ("FishEnv/Swim-v0", {"integrator": name}) for name in INTEGRATORS}
SURE = [f"Swim-v0 {name}" for name in ("variation", "info", "limit", "threads", "speed", "mass_spring")]
SURE += [f"{id[8:]} pairs" for id in IDS]
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


def digest(env, seed, disturbance, steps=10):
    """A hash of episodes of an environment, after numbers were drawn from the generators that all programs share."""
    seen = hashlib.sha256()
    env.action_space.seed(42)
    for k in range(3):
        obs, _ = env.reset(seed=seed + k)
        random.random(), np.random.normal(size=disturbance)  # noqa: NPY002 - the shared ones, on purpose
        for _ in range(steps):
            seen.update(obs.tobytes())
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            seen.update(np.array([reward, terminated, truncated]).tobytes())
            if terminated or truncated:
                break
    return seen.hexdigest()


@each_case
def test_seeds(case):
    """As PettingZoo's seed test: episodes follow from their seed, whatever came before and whatever else is drawn."""
    env = made(case)
    first = digest(env, 0, 1)
    assert first == digest(env, 0, 7) == digest(made(case), 0, 3)
    assert first != digest(env, 50, 1)


# Wrappers

ZERO, ONE = np.float32([0.0, 1.0])
BASIC = {
    "ClipAction": {}, "ClipReward": {"min_reward": -1.0, "max_reward": 1.0}, "DtypeObservation": {"dtype": np.float16},
    "FlattenObservation": {}, "NormalizeObservation": {}, "NormalizeReward": {}, "RecordEpisodeStatistics": {},
    "RescaleAction": {"min_action": ZERO, "max_action": ONE}, "RescaleObservation": {"min_obs": ZERO, "max_obs": ONE},
}  # fmt: skip
"""Keywords of Gymnasium's wrappers, for one environment and for batches."""
OF_ONE = BASIC | {
    "Autoreset": {}, "DelayObservation": {"delay": 2}, "DiscretizeAction": {"bins": 2, "multidiscrete": True},
    "DiscretizeObservation": {"bins": 3, "multidiscrete": True}, "FrameStackObservation": {"stack_size": 3},
    "MaxAndSkipObservation": {"skip": 2}, "OrderEnforcing": {}, "PassiveEnvChecker": {},
    "RepeatAction": {"num_repeats": 2}, "StickyAction": {"repeat_action_probability": 0.5}, "TimeAwareObservation": {},
    "TimeLimit": {"max_episode_steps": 3},
}  # fmt: skip
UNUSED = {
    "AddRenderObservation", "AddWhiteNoise", "AtariPreprocessing", "GrayscaleObservation", "HumanRendering",
    "ObstructView", "RecordVideo", "RenderCollection", "ResizeObservation", "FilterObservation", "ReshapeObservation",
    "TransformAction", "TransformObservation", "TransformReward", "ArrayConversion", "JaxToNumpy", "JaxToTorch",
    "NumpyToTorch",
}  # fmt: skip
"""Wrappers of pictures, of dictionaries, of other arrays, and of functions of the user."""
says_lowered = pytest.mark.filterwarnings("ignore:.*precision lowered by casting to float16")


def test_every_wrapper_is_named():
    """No wrapper of Gymnasium is forgotten."""
    assert {name for name in dir(wrappers) if isinstance(getattr(wrappers, name), type)} <= set(OF_ONE) | UNUSED


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


@each_id
def test_what_wrappers_say_is_true(id):
    """Statistics, stacks, scales and clips agree with the environment without them."""
    plain, stacked = gym.make(id, max_episode_steps=4), wrappers.FrameStackObservation(gym.make(id), 2)
    counted = wrappers.RecordEpisodeStatistics(gym.make(id, max_episode_steps=4))
    scaled = wrappers.RescaleAction(gym.make(id), np.float32(0.0), np.float32(1.0))
    clipped = wrappers.ClipAction(gym.make(id))
    obs = [env.reset(seed=9)[0] for env in (plain, stacked, counted, scaled, clipped)]
    total, actions = 0.0, np.random.default_rng(0).integers(0, 2, (4, 12)).astype(np.float32)
    for action in actions:
        before = obs[0]
        obs, *_ = zip(*(env.step(given) for env, given in (
            (plain, 2 * action - 1), (stacked, 2 * action - 1), (counted, 2 * action - 1), (scaled, action),
            (clipped, 5.0 * (2 * action - 1)))), strict=True)  # fmt: skip
        np.testing.assert_array_equal(obs[1], [before, obs[0]])
        for other in obs[2:]:
            np.testing.assert_array_equal(other, obs[0])
    plain.reset(seed=9)
    results = [plain.step(2 * action - 1) for action in actions]
    total = sum(reward for _, reward, *_ in results)
    counted.reset(seed=9)
    *_, (_, _, _, truncated, info) = [counted.step(2 * action - 1) for action in actions]
    assert truncated and info["episode"]["l"] == 4 and info["episode"]["r"] == pytest.approx(total, rel=1e-6)


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


# Stable-Baselines3


@each_id
def test_saved_and_loaded(id, tmp_path):
    """A model of Stable-Baselines3 with its normalisation, saved and loaded, acts and goes on training as before."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    def batch():
        return make_sb3_vec_env(id, 2, seed=0, max_episode_steps=8)

    env = VecNormalize(batch())
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu")
    model.learn(32)
    model.save(tmp_path / "model")
    env.save(str(tmp_path / "normalise.pkl"))
    again = VecNormalize.load(str(tmp_path / "normalise.pkl"), batch())
    loaded = PPO.load(tmp_path / "model", env=again, device="cpu")
    obs = np.random.default_rng(0).normal(size=(5, *env.observation_space.shape)).astype(np.float32)
    np.testing.assert_array_equal(model.predict(obs, deterministic=True)[0], loaded.predict(obs, deterministic=True)[0])
    np.testing.assert_array_equal(env.normalize_obs(obs), again.normalize_obs(obs))
    loaded.learn(16, reset_num_timesteps=False)
    assert loaded.num_timesteps == 48


@each_id
def test_two_trainings_are_one(id):
    """Two trainings of Stable-Baselines3 with the same seed end with the same bits."""
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    found = []
    for _ in range(2):
        env = make_sb3_vec_env(id, 2, seed=1, max_episode_steps=5)
        model = stable_baselines3.PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=2, seed=3, device="cpu")
        model.learn(32)
        found.append([part.detach().numpy().tobytes() for part in model.policy.parameters()])
        env.close()
    assert found[0] == found[1]
