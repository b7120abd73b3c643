"""Step-size limits of every method: against stiffness, on the abrupt manoeuvre, and by linear theory.

    taskset -c 1 python -m benchmarks.stability.survey          every method, step and stiffness (9 min): CSVs, charts
    taskset -c 1 python -m benchmarks.stability.survey --draw   tables and charts again, from the CSV

A run is stable if the fish does not fail and its energy, kinetic and elastic, never exceeds BOUND times the reference
solution's. The largest stable step is the largest below which every tested one is stable: stability can come and go
with the step. With a step beyond the control interval, a command lasts as long as the step.
"""

import argparse
import sys

import numpy as np
from tqdm import tqdm

from benchmarks.common.tables import RESULTS, read_table, write_csv
from benchmarks.stability import charts
from benchmarks.stability.linear import linear_limit
from benchmarks.stability.runs import FIXED, cases, limit, reference, sweep

COMMAND = "python -m benchmarks.stability.survey"


def survey() -> list[dict]:
    """Every cell, or those found before Ctrl-C: the CSV is written after each sweep."""
    rows, todo = [], cases()
    try:
        with tqdm(total=len(todo) * len(FIXED), unit="sweep") as bar:
            for body, factor, fish in todo:
                bar.set_postfix_str(f"{body} x{factor:g} reference")
                reference_path, reference_energy = reference(fish)
                for name in FIXED:
                    bar.set_postfix_str(f"{body} x{factor:g} {name}")
                    found = sweep(fish, name, reference_path, reference_energy)
                    found.sort(key=lambda row: -row["step_s"])
                    rows += [{"body": body, "stiffness": factor} | row for row in found]
                    write_csv("stability.csv", rows, COMMAND)
                    bar.update()
    except KeyboardInterrupt:
        print("interrupted: what was measured is in the CSV")
    return rows


def limits(rows: list[dict]) -> list[dict]:
    """Largest stable step by body, stiffness and method, measured and by linear theory, and over explicit Euler's."""
    table = []
    for body, factor, fish in cases():
        measured, theory = {}, {}
        for name in FIXED:
            mine = [row for row in rows if (row["body"], row["stiffness"], row["integrator"]) == (body, factor, name)]
            if mine:
                measured[name], theory[name] = limit(mine), linear_limit(name, fish.body, 10 * fish.control_interval)
        explicit, linear = measured.get("explicit_euler", [np.nan])[0], theory.get("explicit_euler", np.nan)
        for name, (largest, unstable) in measured.items():
            table.append(
                {
                    "body": body, "stiffness": factor, "integrator": name, "largest_stable_s": largest,
                    "unstable_from_s": unstable, "linear_theory_s": theory[name],
                    "over_explicit_euler": round(largest / explicit, 3),
                    "linear_over_explicit_euler": round(theory[name] / linear, 3),
                }
            )  # fmt: skip
    return table


def draw_all(rows: list[dict]) -> None:
    """Tables and every chart from the cells."""
    table = limits(rows)
    write_csv("stability_limits.csv", table, COMMAND)
    charts.report(rows, table)
    charts.draw_limits(table, RESULTS / "stability.svg")
    charts.draw_map(rows, RESULTS / "stability_map.svg")
    print(f"written to {RESULTS / 'stability.csv'}, stability_limits.csv and stability*.svg beside it")


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="tables and charts again from the CSV")
    draw_all(read_table("stability.csv") if parser.parse_args().draw else survey())
    return 0


if __name__ == "__main__":
    sys.exit(main())
