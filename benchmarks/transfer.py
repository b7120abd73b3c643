"""Do policies move from body to body, and does learning on a cheap one save time?

python -m benchmarks.transfer              learn on every body, replay on every other, fine-tune there:
                                           results/transfer_matrix.csv, transfer_curves.csv and
                                           docs/images/transfer.svg (hours; stop and go on at any time)
python -m benchmarks.transfer --chart      the chart only, from the CSVs
python -m benchmarks.transfer --shipped    what the shipped policies do on the other bodies: results/transfer.csv

Every run learns for as many decisions with the settings of its task, whatever the body; a run of fine-tuning begins
with what was learnt on another body. Runs keep the policies on their way, with the processor's seconds until then.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import os

import numpy as np
from tqdm import tqdm

from agents.config import CONFIGS, RESULTS
from agents.results import interval, read_rows, rounded
from benchmarks.fidelity import interval_of
from benchmarks.provenance import RESULTS as FILES
from benchmarks.provenance import write_csv
from benchmarks.transfer_chart import chart, saving_rows
from benchmarks.transfer_runs import (
    BODIES,
    FINEST,
    PROOF,
    PROOF_EPISODES,
    SHORT,
    TASKS,
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

RUNS = Path("runs/transfer")
SHIPPED = ("swim", "turn", "left_after_right", "target", "avoid")


def measurements(learnt: list[Run], tuned: list[Run], root: Path) -> list[tuple]:
    """What `measured` is to be called with: last policies on every body, those on the way on the finest."""
    calls = []
    for run in (*learnt, *tuned):
        stops = sorted(stops_of(run, root))
        if not run.source:
            calls += [(run, root, stops[-1], body, None, BODIES[body]) for body in BODIES]
            calls.append((run, root, stops[-1], FINEST, PROOF, PROOF_EPISODES))
        else:
            calls.append((run, root, stops[-1], run.body, None, BODIES[run.body]))
        if not run.source or run.body == FINEST:
            calls += [(run, root, stop, FINEST, None, BODIES[FINEST]) for stop in stops]
    return list(dict.fromkeys(calls))


def matrix_rows(learnt: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """A row for a body learnt on, the body replayed on, before or after fine-tuning there, and a metric."""
    generator, rows = np.random.default_rng(0), []
    cells: dict[tuple, list[Scores]] = {}
    for run, _, stop, body, level, episodes in measurements(learnt, tuned, root):
        if stop == max(stops_of(run, root)):
            key = (run.task, run.source or run.body, body, level or "", SHORT if run.source else 0)
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


def curve_rows(learnt: list[Run], tuned: list[Run], root: Path) -> list[dict]:
    """The score on the finest body along every run; a fine-tuning counts the seconds of what it began with."""
    rows = []
    for run in (*learnt, *(run for run in tuned if run.body == FINEST)):
        before = max(stops_of(run._replace(body=run.source, source=""), root).values()) if run.source else 0.0
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
    """Learn, fine-tune, measure, write down and draw what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shipped", action="store_true", help="only the shipped policies on the other bodies")
    parser.add_argument("--chart", action="store_true", help="only the chart, from the CSVs")
    parser.add_argument("--runs", type=Path, default=RUNS, help=f"where runs are kept ({RUNS})")
    parser.add_argument("--tasks", nargs="+", choices=list(TASKS), default=list(TASKS), help="only these")
    parser.add_argument(
        "--bodies", nargs="+", choices=list(BODIES), default=list(BODIES), help="only these; no CSV then"
    )
    parser.add_argument("--jobs", type=int, help="runs side by side (default one a processor)")
    chosen = parser.parse_args()
    if chosen.shipped:
        write_csv("transfer.csv", shipped_rows(), "python -m benchmarks.transfer --shipped")
        return
    if not chosen.chart:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")  # for the processes to come
        learnt, tuned = runs(chosen.tasks, chosen.bodies)
        for what, some in (("learning", learnt), ("fine-tuning", tuned)):
            left = [run for run in some if not (run.folder(chosen.runs) / "seconds.json").exists()]
            in_parallel([(learn, run, chosen.runs) for run in left], chosen.jobs, what)
        calls = measurements(learnt, tuned, chosen.runs)
        in_parallel([(measured, *call) for call in calls], chosen.jobs, "measuring")
        if set(chosen.bodies) != set(BODIES):
            return
        write_csv("transfer_matrix.csv", matrix_rows(learnt, tuned, chosen.runs), "python -m benchmarks.transfer")
        curves = curve_rows(learnt, tuned, chosen.runs)
        write_csv("transfer_curves.csv", curves, "python -m benchmarks.transfer")
        write_csv("transfer_savings.csv", saving_rows(curves), "python -m benchmarks.transfer")
    print(chart(*(read_rows(FILES / f"transfer_{name}.csv") for name in ("matrix", "curves"))))
    for row in read_rows(FILES / "transfer_savings.csv"):
        print(*(f"{name}: {value}" for name, value in row.items()), sep="  ")


if __name__ == "__main__":
    main()
