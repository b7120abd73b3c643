"""What the constant system matrix of linear elasticity saves: a step with the factors used again, and with new ones.

    taskset -c 1 python -m benchmarks.speed.constant_matrix          CSV (about 1 min)

A clamped beam of linear tetrahedra sags in air, by the linearly implicit methods; both kinds of step alternate in one
process. Positions after all steps are compared bit for bit.
"""

import argparse
import time
from statistics import median

import numpy as np

from benchmarks.common.beam import loose, solid
from benchmarks.common.tables import write_csv
from fish_env import Tank, make_world
from fish_env.bodies.mesh import box
from fish_env.body import Body, fix

CELLS = ((6, 2, 2), (12, 2, 2), (10, 4, 4), (16, 4, 4), (23, 4, 4), (40, 4, 4), (20, 6, 6))
METHODS = ("linearly_implicit", "rosenbrock")
CELL, STEP, STEPS, REPEATS = 0.01, 0.002, 10, 25
NAME = "constant_matrix.csv"
COMMAND = "taskset -c 1 python -m benchmarks.speed.constant_matrix"


def refactoring(tank: Tank) -> Tank:
    """The tank, told that its matrix changes with the motion: it factors one a step, as for other bodies."""
    for block in tank._engine.blocks:
        block.control.set(constant=False)
    return tank


def beam(cells) -> Body:
    """A clamped beam of so many cubic cells along, across and upward."""
    position, nodes = box(CELL * np.array(cells), cells)
    body = solid(position, nodes, 0.3, relaxation_time=0.002, strain="linear")
    return fix(body, position[:, 0] == 0.0)


def measure(cells, name: str) -> dict:
    """Medians of the time of a step both ways and of their ratio, with its quartiles, and how far they end apart."""
    thing, world = loose(beam(cells), STEP), make_world(gravity=(0.0, 0.0, -9.81), viscosity=1e-4)
    made = {way: Tank(thing, 1, name, STEP, world, threads=1) for way in ("again", "new")}
    refactoring(made["new"])
    taken = {way: [] for way in made}
    for tank in made.values():
        tank.advance(STEPS)
    for _ in range(REPEATS):
        for way, tank in made.items():
            begin = time.perf_counter()
            tank.advance(STEPS)
            taken[way].append((time.perf_counter() - begin) / STEPS)
    ratio = np.array(taken["again"]) / np.array(taken["new"])
    return {
        "integrator": name, "nodes": len(thing.body.mass), "steps": STEPS * (REPEATS + 1),
        "factorisations": int(made["again"].counters["factorisations"][0]),
        "again_us": round(1e6 * median(taken["again"]), 1), "new_us": round(1e6 * median(taken["new"]), 1),
        "ratio": round(float(np.median(ratio)), 3), "ratio_quarter": round(float(np.quantile(ratio, 0.25)), 3),
        "ratio_three_quarters": round(float(np.quantile(ratio, 0.75)), 3),
        "apart": float(np.abs(made["again"].position - made["new"].position).max()),
    }  # fmt: skip


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = []
    for name in METHODS:
        for cells in CELLS:
            rows.append(measure(cells, name))
            print(rows[-1], flush=True)
    write_csv(NAME, rows, COMMAND)


if __name__ == "__main__":
    main()
