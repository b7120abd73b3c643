"""The pictures of the documentation, from the shipped policy.

python -m benchmarks.pictures       writes docs/images/swim.png
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import numpy as np

from agents.evaluate import FIRST_SEED, make_eval_env
from agents.policy import load_policy

ROOT = Path(__file__).parent.parent
MOMENTS = (0.06, 2.0, 2.12)  # s: setting off, and the two halves of a tail beat at full speed


def main() -> None:
    """Play one episode and keep three moments of it, side by side."""
    from PIL import Image

    policy = load_policy(ROOT / "agents" / "pretrained" / "swim" / "policy.npz")
    env = make_eval_env(policy.about["env_id"], 1, dict(policy.about["env_options"]) | {"render_mode": "rgb_array"})
    obs, _ = env.reset(seed=FIRST_SEED)
    frames = []
    for step in range(1, round(MOMENTS[-1] / env.control_interval) + 1):
        obs, *_ = env.step(policy(obs))
        frame = env.render()[0]
        if any(abs(step * env.control_interval - moment) < 1e-9 for moment in MOMENTS):
            frames.append(frame)
    picture = Image.fromarray(np.concatenate(frames, axis=1)).resize((1260, 315), Image.Resampling.LANCZOS)
    path = ROOT / "docs" / "images" / "swim.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.quantize(256).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
