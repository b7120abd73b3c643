"""The moving picture at the top of README.md: the shipped policy turns left before a right turn is over.

python docs/site/moving_picture.py     writes docs/images/left_after_right.webp
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import fish_env  # noqa: F401  registers the environments
from fish_env.control import load_policy, shipped_policy

ROOT = Path(__file__).parents[2]
POLICY = shipped_policy("left_after_right")
COMMANDS = {"yaw": 2.2, "side": -1, "first": 1.4, "second": 1.5, "part": 0.6, "wait": 0.6}
SECONDS = 2.6  # simulated; the picture is played at half speed
WIDTH = 520  # pixels
QUALITY = 62


def frames():
    """Pictures (H,W,3) uint8 of the fish, one after every environment step of the policy."""
    policy = load_policy(POLICY)
    env = gym.make(policy.about["env_id"], render_mode="rgb_array", **policy.about["env_options"])
    obs, _ = env.reset(seed=0, options=COMMANDS)
    for _ in range(round(SECONDS / env.unwrapped.fish.control_interval)):
        obs, *_ = env.step(policy(obs))
        yield env.render()
    env.close()


def reduced(frame: np.ndarray) -> Image.Image:
    """The frame at the width of the picture."""
    picture = Image.fromarray(frame)
    return picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS)


def main() -> None:
    """Play the episode and write the picture."""
    policy_interval = load_policy(POLICY).about["env_options"]["control_interval"]
    pictures = [reduced(frame) for frame in frames()]
    path = ROOT / "docs" / "images" / "left_after_right.webp"
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=round(2000 * policy_interval),  # ms: twice as long as it was simulated
        loop=0,
        quality=QUALITY,
        method=6,
    )
    print(f"{path}: {len(pictures)} frames, {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
