"""The picture and the film of the documentation, from the shipped policies.

python docs/site/task_pictures.py     writes docs/images/swim.png and docs/videos/left_after_right.html
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

from fish_env.control import (
    evaluation_options,
    load_policy,
    make_eval_env,
    record,
    run_episodes,
    write_film,
)
from fish_env.control.policy import PRETRAINED

ROOT = Path(__file__).parents[2]
MOMENTS = (0.08, 2.0, 2.12)  # s: setting off, and the two halves of a tail beat at full speed


def play(task: str, seconds: float):
    """Play an episode with the shipped policy: (time, picture) after every environment step."""
    policy = load_policy(PRETRAINED / task / "policy.npz")
    options = evaluation_options(policy.about["env_options"]) | {"render_mode": "rgb_array"}
    env = make_eval_env(policy.about["env_id"], 1, options)
    for k, (_, done, _) in enumerate(run_episodes(env, policy)):
        if done.any() or k > round(seconds / env.control_interval):
            break
        if k > 0:
            yield k * env.control_interval, env.render()[0]
    env.close()


def picture() -> None:
    """Three moments of an episode side by side."""
    frames = [frame for time, frame in play("swim", MOMENTS[-1]) if any(abs(time - m) < 1e-9 for m in MOMENTS)]
    together = Image.fromarray(np.concatenate(frames, axis=1)).resize((1260, 315), Image.Resampling.LANCZOS)
    path = ROOT / "docs" / "images" / "swim.png"
    together.quantize(256).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


def film(task: str = "left_after_right", episodes: int = 3) -> None:
    """A page with episodes of the shipped policy, in 3-D."""
    policy = load_policy(PRETRAINED / task / "policy.npz")
    env = gym.make(policy.about["env_id"], **evaluation_options(policy.about["env_options"]))
    path = write_film(
        [record(env, policy, seed) for seed in range(episodes)], ROOT / "docs" / "videos" / f"{task}.html"
    )
    env.close()
    print(f"{path}: {path.stat().st_size // 1000} kB")


def main() -> None:
    """Write all of them."""
    picture()
    film()


if __name__ == "__main__":
    main()
