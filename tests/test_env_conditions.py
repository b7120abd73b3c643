"""Conditions of an environment's tank act in its steps: to the bit as in a tank of its own."""

import pickle

import gymnasium as gym
import numpy as np
import pytest

import fish_env
from fish_env.physics.tank import Tank

SWIM, STEPS = "FishEnv/Swim-v0", 3
PATHS = {
    "single": lambda: gym.make(SWIM),
    "batch": lambda: gym.make_vec(SWIM, 3, variation={"stiffness": (0.8, 1.25), "current": (0.0, 0.2)}),
    "threads": lambda: gym.make_vec(SWIM, 33, threads=2, variation={"mass": (0.8, 1.25)}),
    "VecEnv": lambda: fish_env.make_sb3_vec_env(SWIM, 33, seed=0, monitor=False, threads=2),
}
ASIDE = (0.0, 0.05, 0.0)
CONDITIONS = {
    "fix": lambda tank: tank.fix([0]),
    "fix by penalty": lambda tank: tank.fix([0], method="penalty"),
    "move": lambda tank: tank.move([0, 21], ASIDE, "xy"),
    "move by penalty": lambda tank: tank.move([0], ASIDE, method="penalty"),
    "move by a function": lambda tank: tank.move([0], lambda t: (0.0, 0.01 * np.sin(9.0 * t), 0.0)),
    "grab": lambda tank: tank.grab(0, tank.position[0, 0] + ASIDE, 20.0, 0.5),
    "grab by a moving point": lambda tank: tank.grab(0, tank.position[0, 0], 20.0, 0.5, velocity=ASIDE),
}


def made(path):
    """An environment after its first reset, and the batch in it."""
    env = PATHS[path]()
    env.reset(**({} if path == "VecEnv" else {"seed": 0}))
    return env, env.unwrapped.fish if path == "single" else getattr(env, "fish", env.unwrapped)


def stepped(path, env, fish, others=(), seed=0):
    """What an environment returns for some actions, which other tanks are given too."""
    found = []
    for action in np.random.default_rng(seed).uniform(-1.0, 1.0, (STEPS, *fish.action_space.shape)).astype(np.float32):
        obs, reward, *_ = env.step(action[0] if path == "single" else action)
        found += [np.array(obs), np.array(reward)]
        for tank in others:
            tank.drive(0.5 * (action.astype(float) + 1.0), fish._substeps)
    return found


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("path", PATHS)
def test_the_tank_of_an_environment(path, condition):
    """A condition set, set again elsewhere and released; then a new episode beside a fresh environment."""
    if path == "VecEnv":
        pytest.importorskip("stable_baselines3")
    env, fish = made(path)
    fish.tank.position[:], fish.tank.velocity[:] = fish.tank.position[0], 0.0  # a penalty draws all to one place
    bare, free = (pickle.loads(pickle.dumps(fish.tank)) for _ in range(2))
    assert type(bare) is Tank
    acts = [CONDITIONS[condition], CONDITIONS["grab"], Tank.release]
    if "penalty" not in condition:  # by now, the fish are in different places
        acts.append(CONDITIONS[condition])
    for seed, act in enumerate(acts):
        act(fish.tank)
        act(bare)
        stepped(path, env, fish, (bare, free), seed)
        wanted = bare.get_state()
        for name, array in fish.tank.get_state().items():
            np.testing.assert_array_equal(array, wanted[name], err_msg=f"{name} after step {seed} of the sequence")
        assert np.abs(bare.position - free.position).max() > 1e-6, "the condition acts"
    fish.tank.release()
    fish.tank.release(np.arange(23))
    fresh, other = made(path)
    if path == "VecEnv":
        env.seed(0)
    env.reset(**({} if path == "VecEnv" else {"seed": 0}))
    for one, two in zip(stepped(path, env, fish), stepped(path, fresh, other), strict=True):
        np.testing.assert_array_equal(one, two)
    for each in (env, fresh):
        each.close()
