"""Plan without learning: try random motions in a batch of fish, carry out the beginning of the best, and plan again.

    python plan_random_shooting.py

Every fish of the batch goes on from the state of the fish that swims. The open-loop gait swims the same episodes.
"""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np

import fish_env
from fish_env.control import best_gait
from fish_env.envs import FishState

MOTIONS, HORIZON, KEPT = 256, 15, 3  # motions that are tried; environment steps that are planned, and carried out


def random_motions(fish: fish_env.Fish, interval: float, generator: np.random.Generator) -> np.ndarray:
    """Actions (MOTIONS,HORIZON,M) of waves of random frequency, Hz, phase, lag along the body, size and side."""
    low, high = (2.0, 0.0, -1.5, 0.7, -0.5), (10.0, 2.0 * np.pi, 3.0, 2.0, 0.5)
    frequency, phase, lag, size, side = generator.uniform(low, high, (MOTIONS, 5)).T[:, :, None, None]
    time = interval * np.arange(HORIZON)[:, None]
    wave = size * np.sin(2.0 * np.pi * frequency * time + phase - lag * fish.segments)
    return np.clip(fish.sides * (wave + side), -1.0, 1.0)


def plan(state: FishState, batch: fish_env.FishVectorEnv, generator: np.random.Generator) -> np.ndarray:
    """The actions (HORIZON,M) of the motion with the largest reward, from this state of a fish."""
    motions = random_motions(batch.tank.fish, batch.control_interval, generator)
    batch.set_state(state)  # the same for all fish
    total, going_on = np.zeros(MOTIONS), np.ones(MOTIONS, dtype=bool)
    for step in range(HORIZON):
        _, reward, terminated, truncated, _ = batch.step(motions[:, step])
        total += reward * going_on
        going_on &= ~(terminated | truncated)
    return motions[total.argmax()]


def main() -> None:
    """Swim some episodes by planning and by the gait, and print the speed of both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=5)
    fast: dict[str, Any] = {"effort_weight": 0.0, "sway_weight": 0.0}  # only speed counts
    env, batch = gym.make("FishEnv/Swim-v0", **fast), fish_env.FishVectorEnv(MOTIONS, task="swim", **fast)
    fish, interval, gait = batch.tank.fish, batch.control_interval, best_gait()
    for seed in range(parser.parse_args().episodes):
        generator, speed = np.random.default_rng(seed), {}
        for name in ("gait", "planned"):
            env.reset(seed=seed)
            step, over, motion = 0, False, np.zeros(0)
            while not over:
                if name == "planned" and step % KEPT == 0:
                    motion = plan(env.get_wrapper_attr("get_state")(), batch, generator)
                action = gait.action(fish, step * interval) if name == "gait" else motion[step % KEPT]
                _, _, terminated, truncated, info = env.step(action)
                step, over = step + 1, terminated or truncated
            speed[name] = info["speed"]
        print(f"episode {seed}: gait {speed['gait']:.2f}, planned {speed['planned']:.2f} body lengths per second")


if __name__ == "__main__":
    main()
