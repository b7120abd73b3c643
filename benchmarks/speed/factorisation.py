"""Our skyline factorisation against a general sparse one, on the system matrix of finite-element fish of many sizes.

    taskset -c 1 python -m benchmarks.speed.factorisation            CSV and chart (about 1 min)
    taskset -c 1 python -m benchmarks.speed.factorisation --draw     the chart again, from the CSV

The matrix is that of `linearly_implicit`, M + h D + h^2 K, of slender bodies from a pointed nose to an upright tail;
what is timed is one factorisation and one solution. The sparse solver is SuperLU (scipy.sparse.linalg.splu), the better
of two orderings, given the matrix ready in its own format. Repeats alternate; ratios are medians.
"""

import argparse
import time
from statistics import median

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from benchmarks.common.beam import solid
from benchmarks.common.charts import BLUE, ORANGE, panels, save
from benchmarks.common.systems import System
from benchmarks.common.tables import IMAGES, read_table, write_csv
from fish_env.bodies.mesh import grid
from fish_env.body import Body
from fish_env.world import VACUUM

SECTIONS = ((2, 2), (2, 4), (4, 4), (4, 6), (8, 8), (12, 12))  # cells across and upward
LONG = (3, 5, 8, 12, 18, 27, 40, 60)  # cells along
MOST_NODES, REPEATS = 1600, 15
ORDERINGS = ("COLAMD", "MMD_AT_PLUS_A")
STEP = 0.005  # s
NAME = "factorisation.csv"


def slender(along: int, across: int, upward: int) -> Body:
    """A fish's outline, 0.3 m long: a point at the nose, a vertical line at the tail."""
    s = np.linspace(0.0, 1.0, along + 1)
    widths = 0.03 * np.sqrt(s) * (1.0 - s)
    depths = 0.05 * np.sqrt(s) * (1.0 - 0.7 * s)
    mesh = grid(-0.3 * s, widths, depths, across, upward)
    return solid(mesh.position, mesh.tets, 0.3, relaxation_time=0.01)


def systems(body: Body):
    """The system in its skyline, and its matrix as scipy's compressed columns."""
    shape, n, system = body.profile, len(body.mass), System(body, VACUUM, STEP)
    a = system.assemble()
    row = np.repeat(np.arange(n), np.diff(shape.start))
    column = np.arange(len(a)) - shape.start[row] + shape.first[row]
    i, j = (3 * at[:, None, None] + k for at, k in ((row, np.arange(3)[:, None]), (column, np.arange(3))))
    i, j = np.broadcast_to(i, a.shape).ravel(), np.broadcast_to(j, a.shape).ravel()
    lower = coo_array((a.ravel(), (i, j)), shape=(3 * n, 3 * n)).tocsc()
    lower.eliminate_zeros()
    below = coo_array((a.ravel() * (i // 3 > j // 3), (i, j)), shape=(3 * n, 3 * n)).tocsc()
    return system, (lower + below.T).tocsc()


def seconds(work) -> float:
    """How long a call takes, with what it returns thrown away."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def measure(body: Body) -> dict:
    """Median times of both and of their ratio, with the quartiles of the ratio, and how far the solutions are apart."""
    system, sparse = systems(body)
    sparse.eliminate_zeros()
    n, load = len(body.mass), np.cos(np.arange(body.position.size)).reshape(-1, 3)
    matrix = system.columns.copy()

    def skyline():
        system.columns[:], system.load[:] = matrix, load
        return seconds(system.factor_solve)

    def general(ordering):
        symmetric = {} if ordering == "COLAMD" else {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return splu(sparse, permc_spec=ordering, **symmetric).solve(load.ravel())

    skyline()
    apart = np.abs(system.load.ravel() - general("COLAMD")).max() / np.abs(system.load).max()
    ours, theirs = [], {ordering: [] for ordering in ORDERINGS}
    for _ in range(REPEATS):
        ours.append(skyline())
        for ordering, taken in theirs.items():
            taken.append(seconds(lambda ordering=ordering: general(ordering)))
    best = min(theirs, key=lambda ordering: median(theirs[ordering]))
    ratio = np.array(theirs[best]) / np.array(ours)
    return {
        "nodes": n, "mean_width": round(float(np.diff(body.profile.start).mean()), 2),
        "skyline_us": round(median(ours) * 1e6, 1), "sparse_us": round(median(theirs[best]) * 1e6, 1),
        "ordering": best, "ratio": round(float(np.median(ratio)), 3),
        "ratio_quarter": round(float(np.quantile(ratio, 0.25)), 3),
        "ratio_three_quarters": round(float(np.quantile(ratio, 0.75)), 3), "apart": apart,
    }  # fmt: skip


def draw() -> None:
    """Times and ratios against the number of nodes, a line a cross-section."""
    rows = read_table(NAME)
    figure, (left, right) = panels(2)
    for (across, upward), marker in zip(SECTIONS, "os^Dv*", strict=True):
        mine = [row for row in rows if (row["across"], row["upward"]) == (across, upward)]
        nodes, label = [row["nodes"] for row in mine], f"{across} x {upward} cells"
        for name, colour in (("skyline", BLUE), ("sparse", ORANGE)):
            text = {"skyline": "skyline", "sparse": "sparse (SuperLU)"}[name] if marker == "o" else None
            left.loglog(nodes, [row[f"{name}_us"] for row in mine], marker=marker, color=colour, label=text)
        right.loglog(nodes, [row["ratio"] for row in mine], marker=marker, label=label)
    right.axhline(1.0, color="black", linewidth=0.8)
    left.set(xlabel="nodes", ylabel="one factorisation and solution, us")
    right.set(xlabel="nodes", ylabel="time of the sparse solver over the skyline's")
    right.set_ylim(0.1, 60.0)
    left.legend(frameon=False, fontsize=8)
    right.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", title="cells in a cross-section")
    save(figure, IMAGES / "factorisation.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSV")
    if not parser.parse_args().draw:
        rows = []
        for across, upward in SECTIONS:
            for along in LONG:
                body = slender(along, across, upward)
                if len(body.mass) <= MOST_NODES:
                    rows.append({"along": along, "across": across, "upward": upward} | measure(body))
                    print(rows[-1], flush=True)
        write_csv(NAME, rows, "taskset -c 1 python -m benchmarks.speed.factorisation")
    draw()


if __name__ == "__main__":
    main()
