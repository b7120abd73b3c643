"""Solids of finite elements: which method moves them, and how near they are to theory (`finite_elements.py`).

A beam oscillates in free flight: errors against a reference solution, and the largest stable step. Then it is let go
oscillating, twisted by half a turn, or inside out, with shorter and shorter steps until it gains no energy in a second.
Costs are medians of ratios, of steps that are timed in turn.
"""

import numpy as np

from benchmarks.common.charts import METHOD_STYLE, legend_below, panels, save, words
from benchmarks.common.tables import RESULTS, publish, read_table
from benchmarks.common.timing import interleaved
from benchmarks.objects import finite_elements, methods
from fish_env import Tank
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM
from fish_env.soft.distorted import invert, twist
from fish_env.soft.room import InRoom
from fish_env.soft.solids import make_beam

METHODS = ("explicit_euler", "midpoint", "rk4", "symplectic_euler", "leapfrog_chebyshev", "linearly_implicit",
           "rosenbrock")  # fmt: skip
STRAINS = ("linear", "corotational", "green_lagrange")  # costs are over those of the first
STARTS = ("swing", "twisted", "inverted")
TRIED = [1 / 15 / 2**k for k in range(14)]  # s
WATCHED, CHECKS, GAIN = 1.0, 20, 0.01  # s; times at which the energy is compared; what it may gain of that at the start
FIRST, COST_STEPS, ROUNDS = 160, 40, 15  # steps in 0.2 s of those that costs are over; steps of each timing; timings


def released(thing: InRoom, how: str, name: str, dt: float) -> Tank:
    """Tank with a solid in vacuum, about to oscillate, twisted, or inside out."""
    tank = Tank(thing, integrator=name, dt=dt, water=VACUUM, threads=1)
    if how == "swing":
        tank.velocity[0] = methods.swing(thing, 0.5)
    else:
        tank.position[0] = {"twisted": twist, "inverted": invert}[how](thing)
    return tank


def survives(thing: InRoom, how: str, name: str, dt: float) -> bool:
    """Return True if a solid lasts a second with steps of dt s without gaining energy."""
    tank, evaluator, begun = released(thing, how, name, dt), Evaluator(thing.body, VACUUM), None
    for _ in range(CHECKS + 1):
        level = sum(evaluator.energies(tank.rest_length[0], tank.position[0], tank.velocity[0]).values())
        begun = level if begun is None else begun
        if not (tank.alive[0] and level <= (1.0 + GAIN) * begun):
            return False
        tank.advance(max(1, round(WATCHED / dt / CHECKS)))
    return True


def add_costs(rows: list[dict], things: dict[str, InRoom]) -> None:
    """Add to each row the median cost of a step of every length, over the first that is timed.

    That is explicit Euler with linear strain and 1.25 ms. Steps that failed are not timed.
    """

    def timing(row, steps):
        tank = methods.start(things[row["strain"]], row["method"], methods.DURATION / steps)
        begun, count = tank.get_state(), min(COST_STEPS, steps)
        return lambda: tank.set_state(begun), lambda: tank.advance(count), count

    keys = [(row, steps) for row in rows for steps in methods.STEPS if np.isfinite(row[methods.column("error", steps)])]
    keys.sort(key=lambda key: (key[0] is not rows[0], key[1] != FIRST))
    found = interleaved([timing(*key) for key in keys], ROUNDS)
    for row in rows:
        row.update({methods.column("cost", steps): np.nan for steps in methods.STEPS})
    for (row, steps), cost in zip(keys, found, strict=True):
        row[methods.column("cost", steps)] = round(float(cost.ratio[1]), 2)


def compare() -> list[dict]:
    """Rows of every method on a beam of every measure of strain."""
    things = {strain: make_beam(strain=strain) for strain in STRAINS}
    rows = []
    for strain, thing in things.items():
        exact = methods.reference(thing)
        for name in METHODS:
            row = {"strain": strain, "method": name, **methods.largest_stable(thing, name)}
            for how in STARTS:
                row[f"{how}_ms"] = np.nan
                if strain == "corotational":
                    row[f"{how}_ms"] = 1e3 * methods.largest_surviving(
                        lambda dt, how=how, name=name, thing=thing: survives(thing, how, name, dt), TRIED
                    )
            rows.append(row | methods.errors(thing, name, exact))
    add_costs(rows, things)
    return rows


def error_and_cost(row: dict) -> tuple[np.ndarray, np.ndarray]:
    """Errors below 1, and costs of 0.2 s, in steps of explicit Euler, of a row of the table."""
    step, error = methods.line_of(row, "error")
    return error, methods.DURATION / step * 1e3 * [row[f"cost_{each:g}_ms"] for each in step]


def drawn(strain: str) -> list[dict]:
    """Rows of the methods of the chart."""
    return [row for row in read_table("solids_methods.csv", strain=strain) if row["method"] != "explicit_euler"]


def draw() -> None:
    """Draw error over cost, linear and corotational, and the largest step of each start; the chart of the elements.

    Explicit Euler is in the table only: its errors are those of symplectic Euler, its largest steps those of midpoint.
    """
    figure, axes = panels(3, 5.0)
    for panel, strain in zip(axes, ("linear", "corotational"), strict=False):
        for row in drawn(strain):
            colour, marker = METHOD_STYLE[row["method"]]
            panel.loglog(*error_and_cost(row)[::-1], color=colour, marker=marker, label=words(row["method"]))
        panel.set(title=f"beam, {strain} strain", xlabel="cost of 0.2 s,\nin steps of explicit Euler",
                  ylabel="error, beam's lengths", ylim=(1e-10, 1.0))  # fmt: skip
    for row in drawn("corotational"):
        colour, marker = METHOD_STYLE[row["method"]]
        axes[2].semilogy(STARTS, [row[f"{how}_ms"] for how in STARTS], color=colour, marker=marker)
    axes[2].set(title="beam, corotational strain", xlabel="state at the start",
                ylabel="largest step without a gain of energy, ms")  # fmt: skip
    legend_below(figure, 3)
    save(figure, RESULTS / "solids_methods.svg")
    finite_elements.draw()


if __name__ == "__main__":
    elements = {"elements_beam.csv": finite_elements.refined, "elements_strains.csv": finite_elements.strains}
    publish(__doc__, {"solids_methods.csv": compare} | elements, draw)
