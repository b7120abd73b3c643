"""Radius and rate of turns beside those of living fish, and failures in many reversals.

python -m benchmarks.learning.turning              results/turning.csv: radius and turning rate
python -m benchmarks.learning.turning --reversals  results/reversals.csv: failures in 10,000 abrupt reversals, and at
                                                   twice the severity, by the shipped policy and by random actions
"""

import argparse

import numpy as np
from tqdm import tqdm

from agents.config import CONFIGS
from benchmarks.common.tables import write_csv
from fish_env import Tank, make_fish
from fish_env.control import (
    FIRST_SEED,
    best_gait,
    evaluate,
    evaluation_options,
    load_policy,
    make_eval_env,
    policy_controller,
    random_actions,
    scripted,
)
from fish_env.control.policy import PRETRAINED

EPISODES, BATCH = 10_000, 500
LEAD, BEND = 60, 10  # environment steps: swimming before a bend, and the bend
LIVING = [
    {"who": "trout (Webb 1983)", "radius_L": 0.18, "turning_rate": ""},
    {"who": "smallmouth bass (Webb 1983)", "radius_L": 0.11, "turning_rate": ""},
    {"who": "dogfish, slow starts (Domenici et al. 2004)", "radius_L": "", "turning_rate": 434},
    {"who": "dogfish, fast starts (Domenici et al. 2004)", "radius_L": "", "turning_rate": 1023},
    {"who": "Pacific bluefin tuna, best (Downs et al. 2023)", "radius_L": 0.38, "turning_rate": 302},
    {"who": "seven species, largest, fast starts (Webb 1978)", "acceleration": "22.7 to 39.5"},
    {"who": "trout, largest, fast starts (Harper & Blake 1990)", "acceleration": 59.7},
]


def bend(cruising: bool) -> dict:
    """All muscles of one side fully contracted for BEND environment steps, then relaxed, swimming or from rest."""
    fish, gait = make_fish(), best_gait()
    tank = Tank(fish, 1, water=fish.water)
    mass = fish.body.mass / fish.body.mass.sum()
    yaws, path = [], []
    for k in range((LEAD if cruising else 0) + 4 * BEND):
        since = k - (LEAD if cruising else 0)
        action = gait.action(fish, tank.time + fish.control_interval)[0]
        if since >= 0:
            action = np.where((fish.sides < 0) & (since < BEND), 1.0, -1.0)
            yaws.append(np.arctan2(*(fish.line @ tank.position[0])[1::-1]))
            path.append(mass @ tank.position[0])
        tank.swim(action, fish.control_interval)
    turned = np.abs(np.unwrap(yaws) - yaws[0])
    end = np.argmax(turned >= 0.9 * turned.max())  # (43), of all that it turns before it springs back
    moved = np.linalg.norm(np.diff(path[: end + 1], axis=0), axis=1).sum()
    acceleration = np.linalg.norm(np.diff(path, n=2, axis=0), axis=1) / fish.control_interval**2
    how = "cruising" if cruising else "from rest"
    return {
        "who": f"all muscles of one side for {BEND * fish.control_interval:g} s, {how}",
        "turned": round(float(np.degrees(turned.max()))),
        "radius_L": round(float(moved / turned[end] / fish.length), 3),
        "turning_rate": round(float(np.degrees(np.abs(np.diff(turned)).max() / fish.control_interval))),
        "acceleration": round(float(acceleration.max()), 1),  # m/s2, mean of two control intervals
    }


def turn_of(who: str, controller, env) -> dict:
    """A commanded turn of 90 degrees, 50 episodes to either side: the median and the best."""
    scores = [evaluate(controller, env, options={"turn": side * np.pi / 2}) for side in (1, -1)]
    radius, rate = (np.concatenate([s[name] for s in scores]) for name in ("radius", "turning_rate"))
    known = radius[np.isfinite(radius)]
    return {
        "who": f"{who}, commanded 90 degrees",
        "turned": 90,
        "best_radius_L": round(float(known.min()), 3) if known.size else "",
        "best_turning_rate": round(float(rate.max())),
        "radius_L": round(float(np.median(known)), 3) if known.size else "",
        "turning_rate": round(float(np.median(rate))),
    }


def turning() -> None:
    """Radius (path over angle until 90 % of the turn) and turning rate of the body's line, beside the literature."""
    config = CONFIGS["turn"]
    env = make_eval_env(config.env_id, 50, evaluation_options(config.env_options))
    policy = policy_controller(load_policy(PRETRAINED / "turn" / "policy.npz"), env)
    rows = [
        bend(True),
        bend(False),
        turn_of("motor controllers", scripted(env), env),
        turn_of("PPO", policy, env),
        *LIVING,
    ]
    columns = ("who", "turned", "radius_L", "best_radius_L", "turning_rate", "best_turning_rate", "acceleration")
    rows = [{name: row.get(name, "") for name in columns} for row in rows]
    for row in rows:
        print(row)
    print(write_csv("turning.csv", rows, "python -m benchmarks.learning.turning"))


def reversals(episodes: int = EPISODES) -> None:
    """Failures of the physics and successes in many episodes of LeftAfterRight-v0."""
    config, rows = CONFIGS["left_after_right"], []
    policy = load_policy(PRETRAINED / "left_after_right" / "policy.npz")
    for severity in (1.0, 2.0):
        env = make_eval_env(config.env_id, BATCH, evaluation_options(config.env_options) | {"severity": severity})
        for who, controller in (("PPO", policy_controller(policy, env)), ("random", random_actions(env))):
            failed, success = 0, []
            for k in tqdm(
                range(episodes // BATCH), desc=f"{who}, severity {severity:g}", unit_scale=BATCH, unit=" episodes"
            ):
                scores = evaluate(controller, env, FIRST_SEED + k * BATCH)
                failed += int(scores["failed"].sum())
                success.append(scores["success"].mean())
            rows.append({"who": who, "severity": severity, "episodes": episodes, "failed": failed,
                         "success": round(float(np.mean(success)), 4)})  # fmt: skip
            print(rows[-1])
    print(write_csv("reversals.csv", rows, "python -m benchmarks.learning.turning --reversals"))


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reversals", action="store_true", help="count failures in many reversals")
    arguments = parser.parse_args()
    reversals() if arguments.reversals else turning()


if __name__ == "__main__":
    main()
