"""Checks of the finite-element body: a beam against beam theory, large bending, recovery, damping.

    python -m benchmarks.accuracy.finite_elements           everything (about 5 min): CSVs, charts, and the bars
    python -m benchmarks.accuracy.finite_elements --draw    the charts again, from the CSVs
    python -m benchmarks.accuracy.finite_elements --bars    the CSVs against their bars, exit 1 if one is missed

The beam is that of `benchmarks/common/beam.py`.
"""

import argparse
import sys

import numpy as np

from benchmarks.accuracy.beam_bending import bending, converging, order
from benchmarks.accuracy.beam_vibration import vibrating
from benchmarks.accuracy.block_recovery import recovering
from benchmarks.accuracy.finite_element_charts import draw_beam, draw_bending, draw_vibration
from benchmarks.common.beam import SHEAR
from benchmarks.common.tables import IMAGES, RESULTS, read_table, write_csv

COMMAND = "python -m benchmarks.accuracy.finite_elements"


def bars() -> bool:
    """Print what was measured beside its bar; True if all are met."""
    beam, bent = read_table("finite_elements_beam.csv"), read_table("finite_elements_bending.csv")
    back, rung = read_table("finite_elements_recovery.csv"), read_table("finite_elements_vibration.csv")
    cells, finest, last = [row["cells"] for row in beam], beam[-1], bent[-1]
    deflections = order(cells[1:], [1.0 + SHEAR - row["deflection"] for row in beam[1:]])
    apart = max(
        np.hypot(row["corotational_x"] - row["elastica_x"], row["corotational_z"] - row["elastica_z"]) for row in bent
    )
    slow = [row for row in rung if row["method"] == "linearly_implicit" and row["steps_a_period"] == 2000]
    fine = [row for row in rung if row["method"] == "leapfrog_chebyshev" and row["steps_a_period"] == 500]
    large = next(row for row in rung if row["method"] == "linearly_implicit")
    found = (
        ("order of the deflection from 4 cells on", deflections, deflections > 1.8, "above 1.8"),
        *(
            (f"{name} over Euler's, {int(cells[-1])} cells", finest[name], abs(finest[name] - 1.0) < 0.02, "1 +- 0.02")
            for name in ("deflection", "frequency_quarter", "frequency_uniform")
        ),
        ("tip of the bent beam from the elastica's, over the length", apart, apart < 0.03, "below 0.03"),
        *(
            (f"volume under the largest load, {kind}", last[f"{kind}_volume"], met, bar)
            for kind, met, bar in (
                ("corotational", abs(last["corotational_volume"] - 1.0) < 0.03, "1 +- 0.03"),
                ("linear", abs(last["linear_volume"] - 1.0) > 0.2, "off by more than 0.2"),
            )
        ),
        *(
            (f"{start} blocks back in shape to 1e-6, of {len(mine)}", sum(mine), all(mine), "all")
            for start in ("reflected", "flattened", "scrambled")
            for mine in [[row["out_of_shape"] < 1e-6 and not row["failure"] for row in back if row["start"] == start]]
        ),
        ("frequency of implicit Euler at 2000 steps", slow[0]["frequency"], abs(slow[0]["frequency"] - 1) < 1e-3,
         "1 +- 0.001"),
        ("energy after a period at 10 steps", large["energy_after_a_period"], large["energy_after_a_period"] < 0.1,
         "below 0.1"),
        ("decay over s w^2 / 2", fine[1]["decay"] / fine[1]["decay_wanted"],
         abs(fine[1]["decay"] / fine[1]["decay_wanted"] - 1.0) < 0.01, "1 +- 0.01"),
    )  # fmt: skip
    for name, value, met, bar in found:
        print(f"{name}: {value:.6g}, bar {bar}: {'met' if met else 'MISSED'}")
    return all(met for _, _, met, _ in found)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="draw the charts again from the CSVs")
    action.add_argument("--bars", action="store_true", help="compare the CSVs with the bars, exit 1 if one is missed")
    arguments = parser.parse_args()
    if not (arguments.draw or arguments.bars):
        for name, measure in (("vibration", vibrating), ("recovery", recovering), ("beam", converging)):
            write_csv(f"finite_elements_{name}.csv", measure(), COMMAND)
        for name, rows in zip(("bending", "shapes"), bending(), strict=True):
            write_csv(f"finite_elements_{name}.csv", rows, COMMAND)
    if not arguments.bars:
        for chart in (draw_beam, draw_bending, draw_vibration):
            chart()
        print(f"written to {RESULTS} and {IMAGES}")
    return 0 if arguments.draw or bars() else 1


if __name__ == "__main__":
    sys.exit(main())
