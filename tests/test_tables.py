"""Tables of the pages are those of benchmarks/results: each is written again from its CSV file and found there."""

import numpy as np
import pytest
from pages import ROOT

from benchmarks.accuracy.held_out import SETTINGS, least_expensive
from benchmarks.calibration import living_fish
from benchmarks.common.tables import read_table
from benchmarks.objects import layers, solids, survey
from benchmarks.objects.scenes import SCENES
from benchmarks.water import levels
from fish_env.bodies.objects import OBJECTS, SONG


def select(table, /, **wanted):
    """Rows of a table with these values."""
    return [row for row in read_table(table) if all(row[key] == value for key, value in wanted.items())]


def short(value, digits=2):
    """A number with a few significant digits."""
    return f"{float(f'{value:.{digits}g}'):,.10g}" if value >= 10 else f"{value:#.{digits}g}".rstrip(".")


HELD_OUT = (("reactive", "mass_spring"), ("reactive", "planar"), ("drag", "mass_spring"), ("drag", "tetrahedral"))


def line(*cells):
    """A row of a page's table."""
    return f"| {' | '.join(map(str, cells))} |"


def held_out(row):
    """Price and errors of a method at a step: over the held-out scenes, and on the abrupt turn."""
    errors = (row[key] for key in ("geometric_mean", "ninety_percent", "worst", "turn"))
    percent = (np.format_float_positional(float(f"{100 * error:.2g}"), trim="-") for error in errors)
    return short(row["us_per_interval"]), *(f"{error} %" for error in percent)


def methods():
    """Methods on the held-out scenes of the default fish."""
    for name, steps in (
        ("leapfrog_chebyshev", (6, 8, 12, 24, 48)), ("symplectic_euler", (48,)), ("semi_implicit", (48,)),
        ("rosenbrock", (24,)), ("midpoint", (96,)), ("rk4", (32,)),
    ):  # fmt: skip
        for k in steps:
            row = select("held_out.csv", body="mass_spring", water="reactive", integrator=name, substeps=k)[0]
            assert not row["failed"]
            yield line(f"`{name}`", k, *held_out(row))


def own_steps():
    """Every body with its own method and step on the held-out scenes: the first row of each."""
    for water, body in SETTINGS:
        row = select("held_out.csv", body=body, water=water)[0]
        assert not row["failed"]
        name = f"`{body}`" if water == "reactive" else f"`{body}`, in drag"
        yield line(name, row["substeps"], *held_out(row), row["unpredictable"])


def least_prices():
    """The least expensive method of every body by the error that nine held-out scenes of ten stay below."""
    for percent in (2, 1, 0.5, 0.1, 0.01):
        cells = []
        for water, body in HELD_OUT:
            row = least_expensive(select("held_out.csv", body=body, water=water), percent / 100, "ninety_percent")
            cells.append(f"`{row['integrator']}` {row['substeps']}: {short(row['us_per_interval'])}")
        yield line(f"{percent:g} %", *cells)


def failures():
    """Fish that failed under attack, by body and kind of mistreatment."""
    rows = read_table("attack.csv")
    starts = ("perturbed", "fast", "crumpled", "inverted")
    for body in dict.fromkeys(row["body"] for row in rows):
        cells = []
        for kinds in (("random", "bang-bang", "oscillating"), starts, ("stiffness",), ("search",)):
            mine = [row for row in rows if row["body"] == body and row["family"].split(",")[0].split(" ")[0] in kinds]
            cells.append(f"{sum(row['failures'] for row in mine)} of {sum(row['fish'] for row in mine):,}")
        yield line(f"`{body}`{', at its step of 0.0275' * (body == 'published')}", *cells)


def bodies():
    """Nodes, costs and distances of the bodies."""
    rows = read_table("fidelity.csv")
    (cost,) = {row["cost_s_per_s"] for row in rows if row["body"] == "mass_spring"}
    for body, level in dict.fromkeys((row["body"], row["level"]) for row in rows):
        mine = [row for row in rows if (row["body"], row["level"], row["quantity"]) == (body, level, "all")]
        worst, best = (100 * choose(row["error"] for row in mine) for choose in (max, min))
        distance = f"{short(best)} to {short(worst)} %" if best else "0"
        ratio, speed = mine[0]["cost_s_per_s"] / cost, 1.0 / mine[0]["cost_s_per_s"]
        relative = "1" if ratio == 1 else short(ratio, 1 if ratio > 50 else 2)
        yield line(mine[0]["nodes"], relative, short(speed, 1 if body == "tetrahedral" and level == 2 else 2), distance)


def fits():
    """Distances of the fitted bodies on other seeds."""
    names = {"swim": "Swim", "turn": "Turn", "left_after_right": "LeftAfterRight", "target": "Target", "avoid": "Avoid",
             "fast_start": "FastStart", "square": "square waves", "chirp": "chirps",
             "gaits": "gaits up to 6 Hz"}  # fmt: skip
    for scene, name in names.items():
        rows = select("fit_tests.csv", water="reactive", scene=scene, quantity="all")
        found = {row["body"]: row["distance"] for row in rows}
        yield line(name, *(short(100 * found[body]) for body in ("mass_spring", "planar", "two_layer")))


def transfers():
    """What the shipped policies and the motor controllers do on every body."""
    for task, metric, text in (
        ("swim", "speed", "Swim: speed, BL/s"), ("turn", "success", "Turn: success, %"),
        ("turn", "latency", "Turn: latency, s"), ("left_after_right", "success", "LeftAfterRight: success, %"),
        ("left_after_right", "latency", "LeftAfterRight: latency, s"),
        ("target", "time_per_target", "Target: time per target, s"), ("avoid", "avoided", "Avoid: avoided, %"),
    ):  # fmt: skip
        rows = select("transfer.csv", task=task, metric=metric)
        scale, digits = (100, ".0f") if "%" in text else (1, ".2f")
        found = {(row["who"], row["body"]): f"{scale * row['mean']:{digits}}" for row in rows}
        bodies = ("planar", "mass_spring", "two_layer", "tetrahedral")
        yield line(text, *(f"{found['policy', body]}; {found['motor controllers', body]}" for body in bodies))
    assert not any(row["mean"] for row in select("transfer.csv", metric="failed"))


def bounds():
    """The best that was found, beside the motor controllers and the policy: means of the starts in which both are."""
    names = {"turn": "Turn", "left_after_right": "Left after right", "fast_start": "Fast start", "swim": "Swim"}
    rows = read_table("learning/bound.csv")
    for task, quantity in dict.fromkeys((row["task"], row["quantity"]) for row in rows):
        mine = [row for row in rows if (row["task"], row["quantity"]) == (task, quantity)]
        cells = [f"{np.mean([row['bound'] for row in mine]):.2f}"]
        for who in ("motor_controllers", "policy"):
            both = [(row[who], row["bound"]) for row in mine if row[who] != ""]
            ratio = np.sum(both, axis=0)[0] / np.sum(both, axis=0)[1] if both else np.nan
            few = f", in {len(both)} of {len(mine)}" if len(both) < len(mine) else ""
            cells.append(f"{ratio:.2f} times{few}" if both else "-")
        apart = max(row["seeds_apart"] for row in mine)
        yield line(f"{names[task]}: {quantity}{UNITS[quantity]}", *cells, f"{apart:.3f}")


UNITS = {"latency": ", s", "latency, then settled": ", s", "escape distance": ", BL", "speed": ", BL/s"}


def gait():
    """The best gait in both waters, at the default step and by RK4."""
    found = {(row["water"], row["quantity"]): row for row in read_table("gait.csv")}
    for name in living_fish.GAIT:
        digits = ".1f" if "speed" in name else ".2f"
        values = (found[water, name][key] for water in ("drag", "reactive") for key in ("ours", "reference"))
        yield line(name, *(f"{value:{digits}}" for value in values), "")[:-2]


def rates():
    """Environment steps a second, rounded to thousands, and times of control intervals."""
    found = {row["quantity"]: row["value"] for row in read_table("throughput.csv")}
    steps = [value for name, value in found.items() if name.endswith("steps/s")]
    yield f"| {round(steps[0], -2):,.0f} |"
    yield from (f"| {round(value, -3):,.0f} |" for value in steps[1:])
    times = [value for name, value in found.items() if name.startswith("a control interval")]
    yield from (f"| {short(value)} |" for value in times)
    first = [value for name, value in found.items() if name.startswith("first make")]
    yield f"take {first[0]:.1f} s with nothing compiled, and {first[1]:.1f} s after that"
    yield f"one environment takes {found['memory of a process with one environment, MB']:.0f} MB"


def peers():
    """MuJoCo's time over this package's."""
    one, many = (next(row["times_ours"] for row in select("speed/peers.csv", what="springs", copies=copies)
                      if "MuJoCo" in row["name"]) for copies in (1, 256))  # fmt: skip
    yield f"takes {one:.0f} times as long for one fish, and {many:.0f} times for each of 256"
    for name in ("HalfCheetah-v5", "Swimmer-v5"):
        (row,) = select("speed/peers.csv", name=name)
        yield line(name, f"{row['times_ours']:.1f}", f"{row['times_ours'] * 0.02 / row['simulated_s']:.1f}")


# Elastic objects


def tiny(value, digits=2):
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
        yield line(kind, *map(tiny, worst), f"{min(row['times_real_time'] for row in rows):.0f}")


def collapse():
    """What objects of one layer and of two keep, by pressure."""
    for kind in layers.STANDARD:
        for count in (1, 2):
            rows = select("objects_layers.csv", object=kind, layers=count)
            kept = {row["pressure_over_standard"]: row["kept"] for row in rows}
            yield line(kind, count, *(f"{abs(kept[p]):.2f}" for p in (0.0, 0.0625, 0.25, 1.0)))


def limits():
    """Largest stable step and largest step through the scenes: a row an object, a cell a method."""
    for kind in SONG:
        found = {row["method"]: row for row in select("objects_methods.csv", object=kind)}
        yield line(kind, *(f"{step(found[k]['stable_ms'])}; {step(found[k]['scenes_ms'])}" for k in survey.METHODS))


def beam():
    """The cantilever under refinement."""
    for row in read_table("elements_beam.csv"):
        values = (f"{row[key]:.3f}" for key in ("deflection", "frequency", "frequency_equal_masses"))
        yield line(row["cells"], row["nodes"], *values)


def strains():
    """The measures of strain beside one another."""

    def compared(label, case, at, key="value", digits=2):
        found = [select("elements_strains.csv", case=case, strain=strain, at=at)[0][key] for strain in solids.STRAINS]
        return line(label, *(tiny(value, digits) for value in found))

    def cost(method):
        rows = [select("solids_methods.csv", strain=strain, method=method)[0] for strain in solids.STRAINS]
        return (tiny(row["cost_1.25_ms"] / rows[0]["cost_1.25_ms"]) for row in rows)

    yield compared("Energy of a block rotated by 90°, over $`E V`$", "rotation", 90)
    yield compared("Tip of a bent beam from the elastica, over its length, end load $`EI/L^2`$", "bending", 1)
    yield compared("the same, $`10\\,EI/L^2`$", "bending", 10)
    yield compared("Volume under $`10\\,EI/L^2`$, over that at rest", "bending", 10, "volume", 4)
    yield compared("Force on a bar of 1.5 times its length, over $`E A`$", "extension", 1.5)
    yield compared("Force on a bar of half its length", "extension", 0.5)
    yield line("Cost of a step of `leapfrog_chebyshev`", *cost("leapfrog_chebyshev"))
    yield line("Cost of a step of `linearly_implicit`, factors reused", *cost("linearly_implicit"))


def moved_solids():
    """Methods on the corotational beam."""
    for name in solids.METHODS:
        (row,) = select("solids_methods.csv", strain="corotational", method=name)
        steps = (step(row[key]) for key in ("swing_ms", "twisted_ms", "inverted_ms", "stable_ms"))
        error, cost = solids.error_and_cost(row)
        yield line(f"`{name}`", *steps, tiny(row["error_1.25_ms"]), f"{cost[error < 1e-3].min():.0f}")


def water_tables():
    """Tables of the levels of water, as they are written."""
    for name, table in levels.TABLES.values():
        yield "\n".join(table(read_table(name)))


PAGES = {
    "choosing-an-integrator": (methods, own_steps, least_prices, failures),
    "choosing-a-body": (bodies, fits, transfers),
    "choosing-the-water": (water_tables,),
    "results": (bounds,),
    "validation": (
        gait,
        lambda: [living_fish.table(read_table("living_fish.csv"))],
        lambda: [living_fish.strength_table(read_table("strength.csv"))],
    ),
    "performance": (rates, peers),
    "soft-objects": (scenes, collapse, limits, beam, strains, moved_solids),
}


@pytest.mark.parametrize("name", PAGES)
def test_page(name):
    """Every row, and every number of a sentence, stands on the page as it follows from the results."""
    page = (ROOT / f"docs/{name}.md").read_text()
    missing = [text for table in PAGES[name] for text in table() if text not in page]
    assert not missing
