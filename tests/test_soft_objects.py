"""The tables of docs/soft-objects.md are those of benchmarks/results, and so are the numbers in its text."""

import numpy as np
import pytest
import soft_bodies
from pages import ROOT

from benchmarks.common.tables import read_table
from benchmarks.objects import layers, solids, survey
from benchmarks.objects.scenes import SCENES
from fish_env.bodies.objects import OBJECTS, SONG

PAGE = (ROOT / "docs/soft-objects.md").read_text()
HEAD = {
    "scenes": "| | Largest growth of energy | at half the step | Largest distance behind a wall | Times real time |",
    "layers": "| | Layers | Without gas | 1/16 of the pressure | 1/4 | Standard pressure |",
    "limits": "| Stable; scenes | Explicit Euler | Midpoint | RK4 | `leapfrog_chebyshev` |",
    "errors": "| Error | Explicit Euler | Midpoint | RK4 | `leapfrog_chebyshev` |",
    "beam": "| Cells through the thickness | Nodes | Deflection | First frequency | with equal masses |",
    "strains": "| | linear | corotational | Green-Lagrange |",
    "solids": "| | Swing | Twisted | Inverted | Stable | Error | Cost |",
}


def select(name, **wanted):
    """Rows of a table with these values."""
    return [row for row in read_table(name) if all(row[key] == value for key, value in wanted.items())]


def short(value, digits=2):
    """A number with a few digits; of small and large ones the first digit and the power of ten."""
    return "0" if value == 0.0 else f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.0e}"


def step(value):
    """A step, ms, with two digits."""
    return f"{value:.0f}" if value > 99 else f"{value:.2g}"


def scenes():
    """The worst of the scenes of every object."""
    for kind in OBJECTS:
        rows = select("objects_scenes.csv", object=kind)
        assert [row["scene"] for row in rows] == list(SCENES) and not any(row["escapes"] for row in rows)
        worst = [max(row[key] for row in rows) for key in ("growth", "growth_at_half_step", "depth_over_travel")]
        yield kind, *map(short, worst), f"{min(row['times_real_time'] for row in rows):.0f}"


def collapse():
    """What objects of one layer and of two keep, by pressure."""
    for kind in layers.STANDARD:
        for count in (1, 2):
            rows = select("objects_layers.csv", object=kind, layers=count)
            kept = {row["pressure_over_standard"]: row["kept"] for row in rows}
            yield kind, str(count), *(f"{abs(kept[p]):.2f}" for p in (0.0, 0.0625, 0.25, 1.0))


def of_methods(cell):
    """A row an object, a cell a method."""
    for kind in SONG:
        rows = {row["method"]: row for row in select("objects_methods.csv", object=kind)}
        yield kind, *(cell(rows[name]) for name in survey.METHODS)


def limits():
    """Largest stable step and largest step through the scenes."""
    return of_methods(lambda row: f"{step(row['stable_ms'])}; {step(row['scenes_ms'])}")


def errors():
    """Errors at one step."""
    return of_methods(lambda row: short(row["error_0.3125_ms"]))


def beam():
    """The cantilever under refinement."""
    for row in read_table("elements_beam.csv"):
        values = (f"{row[key]:.3f}" for key in ("deflection", "frequency", "frequency_equal_masses"))
        yield str(row["cells"]), str(row["nodes"]), *values


def strains():
    """The measures of strain beside one another."""

    def line(label, case, at, key="value", digits=2):
        found = [select("elements_strains.csv", case=case, strain=strain, at=at)[0][key] for strain in solids.STRAINS]
        return label, *(short(value, digits) for value in found)

    def cost(method):
        rows = [select("solids_methods.csv", strain=strain, method=method)[0] for strain in solids.STRAINS]
        return (short(row["cost_1.25_ms"] / rows[0]["cost_1.25_ms"]) for row in rows)

    yield line("Energy of a block rotated by 90°, over $`E V`$", "rotation", 90)
    yield line("Tip of a bent beam from the elastica, over its length, end load $`EI/L^2`$", "bending", 1)
    yield line("the same, $`10\\,EI/L^2`$", "bending", 10)
    yield line("Volume under $`10\\,EI/L^2`$, over that at rest", "bending", 10, "volume", 4)
    yield line("Force on a bar of 1.5 times its length, over $`E A`$", "extension", 1.5)
    yield line("Force on a bar of half its length", "extension", 0.5)
    yield "Cost of a step of `leapfrog_chebyshev`", *cost("leapfrog_chebyshev")
    yield "Cost of a step of `linearly_implicit`, factors reused", *cost("linearly_implicit")


def moved_solids():
    """Methods on the corotational beam."""
    for name in solids.METHODS:
        (row,) = select("solids_methods.csv", strain="corotational", method=name)
        steps = (step(row[key]) for key in ("swing_ms", "twisted_ms", "inverted_ms", "stable_ms"))
        error, cost = solids.error_and_cost(row)
        yield f"`{name}`", *steps, short(row["error_1.25_ms"]), f"{cost[error < 1e-3].min():.0f}"


TABLES = {"scenes": scenes, "layers": collapse, "limits": limits, "errors": errors, "beam": beam,
          "strains": strains, "solids": moved_solids}  # fmt: skip


def written(name):
    """A table as it stands on the page."""
    columns = HEAD[name].count("|") - 1
    rows = ["| " + " | ".join(row) + " |" for row in TABLES[name]()]
    return "\n".join([HEAD[name], "|" + "---|" * columns, *rows])


@pytest.mark.parametrize("name", TABLES)
def test_table(name):
    """It stands on the page as it follows from the results."""
    assert written(name) in PAGE


def test_energy_that_implicit_euler_loses():
    """At ten steps a period 96 % are lost after one: the energy falls with the square of the amplitude."""
    assert 1 - np.exp(-2 * soft_bodies.implicit_euler(0.0, 10)[1]) == pytest.approx(0.96, abs=0.005)
