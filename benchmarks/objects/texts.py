"""What the texts state about these objects and methods: the matrix and its order, costs, springs, gas, levels."""

import time
from contextlib import contextmanager, nullcontext

import numpy as np
from matplotlib.colors import to_rgb

from benchmarks.common.charts import BLUE, GREY, METHOD_STYLE, ORANGE, own_legend, panels, save, words
from benchmarks.common.tables import RESULTS, columns, read_table
from fish_env import Tank
from fish_env.physics import forces
from fish_env.physics.linalg import ldlt, rates
from fish_env.soft.objects import OBJECTS, make_ring, make_sphere, make_uniform_sphere
from fish_env.soft.solids import make_beam

MESHES = {
    "ring": [lambda n=n: make_ring(n) for n in (12, 24, 48, 96)],
    "uniform sphere": [lambda n=n: make_uniform_sphere(n) for n in (0, 1, 2, 3)],
    "sphere": [lambda n=n: make_sphere(n, n - 4) for n in (8, 12, 16, 24)],
}
RUNS, STEPS = 9, 40
COSTS = ("explicit_euler", "midpoint", "rk4")
SPRINGS = {"outer": BLUE, "inner": ORANGE, "radius": GREY, "shear left": "#009E73", "shear right": "#CC79A7"}


@contextmanager
def own_order():
    """Let the rows of matrices be in the order of the nodes."""
    kept, ldlt.MOSTLY_FULL = ldlt.MOSTLY_FULL, 0.0
    try:
        yield
    finally:
        ldlt.MOSTLY_FULL = kept


def seconds_of_step(thing, name: str) -> float:
    """Time of a small step, s: the median of RUNS."""
    tank, taken = Tank(thing, 1, name, 1e-5, threads=1), []
    for _ in range(RUNS + 1):
        begin = time.process_time()
        tank.advance(STEPS)
        taken.append((time.process_time() - begin) / STEPS)
    return float(np.median(taken[1:]))


def skyline() -> list[dict]:
    """Rows: entries of the skyline and time of a step of Tu's method, with nodes in both orders; counts of meshes."""
    rows = []
    for kind, makes in MESHES.items():
        for make in makes:
            thing = make()
            row = {"object": kind, "nodes": len(thing.body.mass), "springs": len(thing.body.springs.nodes),
                   "faces": len(thing.skin)}  # fmt: skip
            for order, place in (("chosen", nullcontext()), ("own", own_order())):
                with place:
                    thing = make()
                    row[f"{order}_entries"] = int(thing.body.profile.start[-1])
                    row[f"{order}_us"] = 1e6 * seconds_of_step(thing, "semi_implicit")
            rows.append(row)
    return rows


def costs() -> list[dict]:
    """Rows: time of a step of Song's methods, over that of explicit Euler, measured in turn."""
    rows = []
    for kind in ("ring", "sphere", "uniform sphere"):
        thing = OBJECTS[kind].make()
        found = {name: seconds_of_step(thing, name) for name in COSTS}
        rows.append({"object": kind} | {name: found[name] / found[COSTS[0]] for name in COSTS})
    return rows


def implicit_matrix(thing, h: float) -> np.ndarray:
    """S = M + h D + h^2 K of implicit Euler at rest, dense."""
    size = thing.body.position.size
    parts = [rates.assemble(forces.rest_matrices(thing.body, elastic), size, size) for elastic in (True, False)]
    return np.diag(np.repeat(thing.body.mass, 3)) + h * np.asarray(parts[1]) + h**2 * np.asarray(parts[0])


def lying(pressure: float):
    """Positions of a ring, with its gas or without, after 2 s on the floor."""
    thing = make_ring(pressure=45.0 * pressure, gap_pressure=30.0 * pressure)
    tank = Tank(thing, water=thing.water, threads=1)
    tank.advance(round(2.0 / tank.dt))
    return thing, tank.position[0]


def draw() -> None:
    """Draw six panels: order and time, costs, springs, gas, and the matrix with its inverse."""
    figure, (entries, taken, cost, springs, gas, matrix) = panels(3, 9.6, rows=2)
    for kind, marker in zip(MESHES, "osv", strict=True):
        for order, colour in (("own", ORANGE), ("chosen", BLUE)):
            label = f"{kind}, {'own order' if order == 'own' else 'reordered'}"
            for panel, what in ((entries, "entries"), (taken, "us")):
                line = columns(read_table("objects_skyline.csv", object=kind), "nodes", f"{order}_{what}")
                panel.loglog(*line, color=colour, marker=marker, label=label)
    entries.set(xlabel="nodes", ylabel="stored entries of the matrix")
    own_legend(entries)
    taken.set(xlabel="nodes", ylabel="time of a semi-implicit step, µs")
    own_legend(taken)
    rows = read_table("objects_costs.csv")
    for k, name in enumerate(COSTS):
        at = np.arange(len(rows)) + 0.25 * (k - 1)
        cost.bar(at, [row[name] for row in rows], 0.22, color=METHOD_STYLE[name][0], label=words(name))
    cost.set_xticks(range(len(rows)), [row["object"].replace(" ", "\n") for row in rows])
    cost.set(ylabel="time of a step, over explicit Euler's")
    own_legend(cost)
    thing = make_ring()
    for kind, which in thing.kinds.items():
        for k, ends in enumerate(thing.body.position[thing.body.springs.nodes[which]]):
            springs.plot(*ends[:, :2].T, color=SPRINGS[kind], label=kind if k == 0 else None)
    springs.set(title="springs of a ring", aspect="equal", xlabel="m", ylabel="m")
    own_legend(springs, 2)
    for pressure, colour in ((0.0, ORANGE), (1.0, BLUE)):
        thing, x = lying(pressure)
        for layer in (thing.outer, thing.inner):
            loop, label = np.append(layer, layer[:1]), "with gas" if pressure else "without gas"
            gas.plot(*x[loop, :2].T, color=colour, marker=".", label=label if layer is thing.outer else None)
    gas.set(title="rings on the floor, after a fall", aspect="equal", xlabel="m", ylabel="m")
    own_legend(gas)
    system = implicit_matrix(make_beam(), 1 / 60)
    inverse = np.linalg.inv(system)
    filled = [np.abs(each) > 1e-9 * np.abs(each).max() for each in (system, inverse)]
    colours = np.array([to_rgb(colour) for colour in ("white", GREY, BLUE)])
    matrix.imshow(colours[np.where(filled[0], 2, filled[1])], interpolation="none")
    matrix.grid(False)
    share = [100 * each.mean() for each in filled]
    matrix.set_title(f"S of a beam: {share[0]:.0f} % not zero;\nits inverse (grey): {share[1]:.0f} %")
    save(figure, RESULTS / "objects_texts.svg")
