"""Learn to swim from pictures: PPO with a convolutional network sees the last four, 84 x 84 pixels, and no numbers.

    python pixels.py                            trains for 100,000 environment steps, and saves pixels.zip

It needs fish_env with the extra [train]. The fish is to swim along the arrow; its nose points up in every picture. How
many steps good swimming takes has not been measured.
"""

import argparse

import gymnasium as gym
from gymnasium.wrappers import AddRenderObservation
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecFrameStack

import fish_env  # noqa: F401 - registers the environments


def make_env() -> gym.Env:
    """One fish whose observation is its picture."""
    look = {"width": 84, "height": 84, "camera": "follow", "panel": False}
    env = gym.make("FishEnv/Swim-v0", render_mode="rgb_array", control_interval=0.04, max_episode_steps=125, **look)
    return AddRenderObservation(env, render_only=True)


def main() -> None:
    """Train and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--timesteps", type=int, default=100_000, help="environment steps (default 100000)")
    parser.add_argument("--rollout", type=int, default=256, help="environment steps between updates (default 256)")
    args = parser.parse_args()
    envs = VecFrameStack(make_vec_env(make_env, n_envs=8, seed=0), n_stack=4)
    size = min(128, args.rollout)
    model = PPO(
        "CnnPolicy", envs, n_steps=args.rollout // 8, batch_size=size, gamma=0.96, n_epochs=4, seed=0, verbose=1
    )
    model.learn(args.timesteps)
    model.save("pixels")


if __name__ == "__main__":
    main()
