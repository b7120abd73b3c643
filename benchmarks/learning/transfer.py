"""Transfer of policies from body to body, and the training time that an inexpensive body saves.

python -m benchmarks.learning.transfer             train on every body, replay on every other, fine-tune there:
                                                   results/transfer_*.csv and docs/images/transfer.svg
                                                   (an hour on two cores; it can be interrupted and resumed at any time)
python -m benchmarks.learning.transfer --chart     the chart only, from the CSVs
python -m benchmarks.learning.transfer --shipped   the shipped policies on the other bodies: results/transfer.csv

Every run takes as many environment steps with the settings of its task, whatever the body; fine-tuning starts from a
policy that was trained on another body. Runs save checkpoints, with the processor's seconds until then.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from tqdm import tqdm

from agents.config import CONFIGS, FINE_TUNING, RESULTS
from agents.statistics import interval, rounded
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import RESULTS as FILES
from benchmarks.common.tables import read_rows, write_csv
from benchmarks.learning.transfer_chart import chart, saving_rows
from benchmarks.learning.transfer_runs import (
    BODIES,
    FINEST,
    SEEDS,
    TASKS,
    VALIDATION_EPISODES,
    VALIDATION_LEVEL,
    Run,
    in_parallel,
    learn,
    measured,
    runs,
    stops_of,
)
from fish_env.control import (
    FIRST_SEED,
    Scores,
    evaluate,
    evaluation_options,
    load_policy,
    make_eval_env,
    policy_controller,
    scripted,
)
from fish_env.control.policy import PRETRAINED

COMMAND = "python -m benchmarks.learning.transfer"
RUNS = Path("runs/transfer")
SHIPPED = ("swim", "turn", "left_after_right", "target", "avoid")


def measurements(trained: list[Run], tuned: list[Run], root: Path) -> list[tuple]:
    """What `measured` is to be called with: last policies on every body, those of the checkpoints on the finest."""
    calls = []
    for run in (*trained, *tuned):
        stops = sorted(stops_of(run, root))
        if not run.source:
            calls += [(run, root, stops[-1], body, None, BODIES[body]) for body in BODIES]
            calls.append((run, root, stops[-1], FINEST, VALIDATION_LEVEL, VALIDATION_EPISODES))
        else:
            calls.append((run, root, stops[-1], run.body, None, BODIES[run.body]))
        if not run.source or run.body == FINEST:
            calls += [(run, root, stop, FINEST, None, BODIES[FINEST]) for stop in stops]
    return list(dict.fromkeys(calls))


def matrix_rows(trained: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """A row for a body trained on, the body replayed on, before or after fine-tuning there, and a metric."""
    generator, rows = np.random.default_rng(0), []
    cells: dict[tuple, list[Scores]] = {}
    for run, _, stop, body, level, episodes in measurements(trained, tuned, root):
        if stop == max(stops_of(run, root)):
            key = (run.task, run.source or run.body, body, level or "", FINE_TUNING["timesteps"] if run.source else 0)
            cells.setdefault(key, []).append(measured(run, root, stop, body, level, episodes))
    for (task, source, body, level, short), found in cells.items():
        for metric in dict.fromkeys((RESULTS[task].score, *RESULTS[task].headline, "return", "failed")):
            value, low, high = interval(found, metric, generator)
            rows.append({
                "task": task, "learnt_on": source, "body": body, "level": level, "fine_tuned": short, "metric": metric,
                "value": rounded(value), "low": rounded(low), "high": rounded(high), "seeds": len(found),
                "episodes": len(found[0]["return"]), "first_seed": FIRST_SEED,
            })  # fmt: skip
    return rows


def curve_rows(trained: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """The score on the finest body along every run; a fine-tuning counts the seconds of the run that it began with.

    Of each run, only the first fine-tuning is one of these.
    """
    rows = []
    for run in (*trained, *(run for run in tuned if run.body == FINEST and run.seed < SEEDS[run.task])):
        before = max(stops_of(run.begun_with(), root).values()) if run.source else 0.0
        for stop, seconds in stops_of(run, root).items():
            scores = measured(run, root, stop, FINEST, None, BODIES[FINEST])
            rows.append({
                "task": run.task, "learnt_on": run.source or run.body, "fine_tuned": int(bool(run.source)),
                "seed": run.seed, "decisions": stop, "seconds": round(before + seconds, 1),
                "metric": RESULTS[run.task].score, "score_on_finest": rounded(scores[RESULTS[run.task].score].mean()),
                "return_on_finest": rounded(scores["return"].mean()),
            })  # fmt: skip
    return rows


def shipped_rows() -> list[dict]:
    """What the shipped policies and the motor controllers, made for the default fish, do on every body."""
    found = []
    with tqdm(total=2 * len(SHIPPED) * len(BODIES), unit="evaluation") as bar:
        for task in SHIPPED:
            policy = load_policy(PRETRAINED / task / "policy.npz")
            for body, episodes in BODIES.items():
                options = evaluation_options(CONFIGS[task].env_options) | {"body": body}
                for who in ("policy", "motor controllers"):
                    bar.set_postfix_str(f"{task}, {body}, {who}")
                    env = make_eval_env(CONFIGS[task].env_id, episodes, options)
                    scores = evaluate(policy_controller(policy, env) if who == "policy" else scripted(env), env)
                    env.close()
                    for metric in dict.fromkeys((*RESULTS[task].headline, "failed")):
                        known = scores[metric][np.isfinite(scores[metric])]
                        mean, low, high = interval_of(known) if known.size else (np.nan,) * 3
                        found.append({
                            "task": task, "learnt_on": "mass_spring" if who == "policy" else "", "body": body,
                            "who": who, "metric": metric, "mean": f"{mean:.4g}", "low": f"{low:.4g}",
                            "high": f"{high:.4g}", "episodes": episodes, "first_seed": FIRST_SEED,
                        })  # fmt: skip
                    bar.update()
    return found


def main() -> None:
    """Train, fine-tune, measure, write and draw what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shipped", action="store_true", help="only the shipped policies on the other bodies")
    parser.add_argument("--chart", action="store_true", help="only the chart, from the CSVs")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"folder of the runs ({RUNS})")
    parser.add_argument("--tasks", nargs="+", choices=list(TASKS), default=list(TASKS), help="only these")
    parser.add_argument(
        "--bodies", nargs="+", choices=list(BODIES), default=list(BODIES), help="only these; no CSV then"
    )
    parser.add_argument("--jobs", type=int, help="runs side by side (default one a processor)")
    chosen = parser.parse_args()
    if chosen.shipped:
        write_csv("transfer.csv", shipped_rows(), f"{COMMAND} --shipped")
        return
    if not chosen.chart:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")  # for the processes to come
        trained, tuned = runs(chosen.tasks, chosen.bodies)
        for what, some in (("training", trained), ("fine-tuning", tuned)):
            left = [run for run in some if not (run.folder(chosen.runs) / "seconds.json").exists()]
            in_parallel([(learn, run, chosen.runs) for run in left], chosen.jobs, what)
        calls = measurements(trained, tuned, chosen.runs)
        in_parallel([(measured, *call) for call in calls], chosen.jobs, "measuring")
        if set(chosen.bodies) != set(BODIES):
            return
        write_csv("transfer_matrix.csv", matrix_rows(trained, tuned, chosen.runs), COMMAND)
        curves = curve_rows(trained, tuned, chosen.runs)
        write_csv("transfer_curves.csv", curves, COMMAND)
        write_csv("transfer_savings.csv", saving_rows(curves), COMMAND)
    print(chart(*(read_rows(FILES / f"transfer_{name}.csv") for name in ("matrix", "curves"))))
    for row in read_rows(FILES / "transfer_savings.csv"):
        print(*(f"{name}: {value}" for name, value in row.items()), sep="  ")


if __name__ == "__main__":
    main()
