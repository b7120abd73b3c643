"""Why two layers: objects of one layer and of two on a floor, with gas and without; the inner layer against the outer.

python -m benchmarks.objects.argument           both tables and charts (about 1 min)
python -m benchmarks.objects.argument --draw    the charts again, from the tables
"""

import argparse

import numpy as np

from benchmarks.common.charts import BLUE, GREY, ORANGE, pyplot, save
from benchmarks.common.tables import RESULTS, read_table, write_csv
from fish_env import Tank
from fish_env.bodies.objects import GLOBE, OBJECTS, RING, SPHERE, Layered, room
from fish_env.elements import make_compartments
from fish_env.volume import volume_of

COMMAND = "python -m benchmarks.objects.argument"
STANDARD = {"ring": RING, "sphere": GLOBE, "uniform sphere": SPHERE}
PRESSURES = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)  # times the standard one
SETTLING = 4.0  # s on the floor, after which most objects lie still


def enclosed(thing: Layered, x) -> float:
    """Area inside the outer layer of a ring, m2, or volume inside that of a sphere, m3, at positions x (N,3) m."""
    faces = make_compartments(thing.body.position, [thing.skin], 1.0).faces
    return volume_of(faces, x)[0]


def pressed(kind: str, layers: int, factor: float) -> Layered:
    """An object with `factor` times the standard pressures; with one layer, that has the mass of both."""
    standard = STANDARD[kind]
    if layers == 1:
        mass = standard.mass + standard.inner_mass
        return OBJECTS[kind].make(layers=1, mass=mass, pressure=factor * standard.pressure)
    return OBJECTS[kind].make(pressure=factor * standard.pressure, gap_pressure=factor * standard.gap_pressure)


def settled(thing: Layered) -> Tank:
    """The object after SETTLING seconds on a floor just below it, on which nothing bounces."""
    tank = Tank(thing, water=room(thing.down, 0.51 * thing.length, 0.0), threads=1)
    tank.advance(round(SETTLING / tank.dt))
    if not tank.alive[0]:
        raise ArithmeticError(f"{thing.name}: {tank.failure[0]} at {tank.time[0]:.3f} s")
    return tank


def collapse(kind: str, layers: int, factor: float) -> dict:
    """A row: area or volume, and height, over those of the unloaded object: means, and ranges, of a second at the end.

    Bending of a single layer stretches no spring, so that nothing damps it: some objects still swing a little.
    """
    thing = pressed(kind, layers, factor)
    tank, rest, kept, height = settled(thing), thing.body.position, [], []
    for _ in range(60):
        x = tank.position[0]
        kept.append(enclosed(thing, x) / enclosed(thing, rest))
        height.append(np.ptp(x[thing.outer] @ thing.down) / np.ptp(rest[thing.outer] @ thing.down))
        tank.advance(round(1 / 60 / tank.dt))
    return {"object": kind, "layers": layers, "pressure_over_standard": factor, "kept": np.mean(kept),
            "kept_range": np.ptp(kept), "height_kept": np.mean(height), "height_range": np.ptp(height)}  # fmt: skip


def draw_collapse(plt) -> None:
    """What is kept over the pressure, and the ring's outlines with gas and without."""
    rows = read_table("song_collapse.csv")
    figure, panels = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained", width_ratios=(1.6, 1, 1))
    for kind, marker in zip(STANDARD, "osv", strict=True):
        for layers, colour in ((1, ORANGE), (2, BLUE)):
            line = [row for row in rows if (row["object"], row["layers"]) == (kind, layers)]
            panels[0].plot(
                [row["pressure_over_standard"] for row in line], [row["kept"] for row in line], color=colour,
                marker=marker, markersize=4.5, linewidth=1.1, label=f"{kind}, {'one layer' if layers == 1 else 'two'}",
            )  # fmt: skip
    panels[0].set_xscale("symlog", base=2, linthresh=0.0625)
    panels[0].set_xticks(PRESSURES, [f"{p:g}" for p in PRESSURES])
    panels[0].set(xlabel="gas pressure over the standard one", ylabel="area or volume over that of the unloaded object")
    panels[0].legend(frameon=False, fontsize=8)
    panels[0].grid(alpha=0.2)
    for panel, layers in zip(panels[1:], (1, 2), strict=True):
        for factor, colour, label in ((0.0, ORANGE, "no gas"), (0.125, GREY, "1/8"), (1.0, BLUE, "standard gas")):
            thing = pressed("ring", layers, factor)
            x = settled(thing).position[0]
            for layer in (thing.outer, thing.inner):
                loop = np.append(layer, layer[:1])
                panel.plot(x[loop, 0], x[loop, 1], color=colour, marker=".", linewidth=1.2,
                           label=label if layer is thing.outer else None)  # fmt: skip
        panel.axhline(-0.51 * thing.length, color="black", linewidth=1.0)
        panel.set(title=f"ring of {'one layer' if layers == 1 else 'two layers'} on the floor", aspect="equal",
                  xlim=(-0.2, 0.2), ylim=(-0.12, 0.14), xlabel="m")  # fmt: skip
        panel.legend(frameon=False, fontsize=8, loc="upper center", ncols=3, columnspacing=0.8, handlelength=1.0)
    save(figure, RESULTS / "song_collapse.svg")


def measure() -> None:
    """Write the tables."""
    rows = [collapse(kind, layers, p) for kind in STANDARD for layers in (1, 2) for p in PRESSURES]
    write_csv("song_collapse.csv", rows, COMMAND)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="the charts again, from the tables")
    if not parser.parse_args().draw:
        measure()
    draw_collapse(pyplot())
    print(f"written to {RESULTS}/song_collapse.csv and the chart beside it")


if __name__ == "__main__":
    main()
