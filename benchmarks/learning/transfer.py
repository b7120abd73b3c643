"""The shipped policies and the motor controllers, made for the default fish, on every body; and how they move it.

results/transfer.csv and results/learning/kinematics.csv.
"""

import numpy as np
from tqdm import tqdm

from benchmarks.common.tables import publish
from benchmarks.learning import kinematics
from benchmarks.learning.publish import PUBLICATIONS
from fish_env.control import FIRST_SEED, evaluate, evaluation_options, load_policy, make_eval_env, scripted
from fish_env.control.policy import PRETRAINED
from fish_env.control.statistics import interval
from fish_env.training.config import CONFIGS

BODIES = {"planar": 100, "mass_spring": 100, "two_layer": 50, "tetrahedral": 25}
"""Episodes on each body; fewer on the most expensive."""
SHIPPED = ("swim", "turn", "left_after_right", "target", "avoid")


def shipped_rows() -> list[dict]:
    """A row for each task, body, controller and metric: its mean over episodes with the interval."""
    found = []
    with tqdm(total=2 * len(SHIPPED) * len(BODIES), unit="evaluation") as bar:
        for task in SHIPPED:
            policy = load_policy(PRETRAINED / task / "policy.npz")
            for body, episodes in BODIES.items():
                options = evaluation_options(CONFIGS[task].env_options) | {"body": body}
                for who in ("policy", "motor controllers"):
                    bar.set_postfix_str(f"{task}, {body}, {who}")
                    env = make_eval_env(CONFIGS[task].env_id, episodes, options)
                    scores = evaluate(env, policy if who == "policy" else scripted(env))
                    env.close()
                    for metric in dict.fromkeys((*PUBLICATIONS[task].headline, "failed")):
                        mean, low, high = interval([scores], metric, np.random.default_rng(0))
                        found.append({
                            "task": task, "learnt_on": "mass_spring" if who == "policy" else "", "body": body,
                            "who": who, "metric": metric, "mean": f"{mean:.4g}", "low": f"{low:.4g}",
                            "high": f"{high:.4g}", "episodes": episodes, "first_seed": FIRST_SEED,
                        })  # fmt: skip
                    bar.update()
    return found


if __name__ == "__main__":
    publish(__doc__, {"transfer.csv": shipped_rows, "learning/kinematics.csv": kinematics.shipped_rows})
