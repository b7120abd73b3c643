"""What the shipped policies, learnt on the default fish, do on the other bodies, without further training.

python -m benchmarks.transfer     results/transfer.csv
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import numpy as np
from tqdm import tqdm

from agents.config import CONFIGS, RESULTS
from agents.controllers import scripted
from agents.evaluate import FIRST_SEED, evaluate, make_eval_env, measuring, policy_controller
from agents.policy import load_policy
from agents.report import PRETRAINED
from benchmarks.fidelity import interval_of
from benchmarks.provenance import write_csv

TASKS = ("swim", "turn", "left_after_right", "target", "avoid")
BODIES = {"planar": 100, "mass_spring": 100, "two_layer": 100, "tetrahedral": 40}
"""Episodes on each body; fewer on the dearest."""
LEARNT_ON = "mass_spring"


def rows() -> list[dict]:
    """Every task, body and controller: a row a metric."""
    found = []
    with tqdm(total=2 * len(TASKS) * len(BODIES), unit="evaluation") as bar:
        for task in TASKS:
            policy = load_policy(PRETRAINED / task / "policy.npz")
            for body, episodes in BODIES.items():
                options = measuring(CONFIGS[task].env_options) | {"body": body}
                for who in ("policy", "motor controllers"):
                    bar.set_postfix_str(f"{task}, {body}, {who}")
                    env = make_eval_env(CONFIGS[task].env_id, episodes, options)
                    scores = evaluate(policy_controller(policy, env) if who == "policy" else scripted(env), env)
                    env.close()
                    for metric in dict.fromkeys((*RESULTS[task].headline, "failed")):
                        known = scores[metric][np.isfinite(scores[metric])]
                        mean, low, high = interval_of(known) if known.size else (np.nan,) * 3
                        found.append({
                            "task": task, "learnt_on": LEARNT_ON if who == "policy" else "", "body": body, "who": who,
                            "metric": metric, "mean": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                            "episodes": episodes, "first_seed": FIRST_SEED,
                        })  # fmt: skip
                    bar.update()
    return found


def main() -> None:
    """Measure and print."""
    table = rows()
    write_csv("transfer.csv", table, "python -m benchmarks.transfer")
    for row in table:
        print(*(row[name] for name in ("task", "body", "who", "metric", "mean", "low", "high")), sep="  ")


if __name__ == "__main__":
    main()
