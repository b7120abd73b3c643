"""Why two layers: one and two on a floor, with gas and without, and in an impact; and what the texts state."""

import numpy as np

from benchmarks.common.charts import BLUE, ORANGE, own_legend, panels, save
from benchmarks.common.tables import RESULTS, columns, read_table
from fish_env import Tank
from fish_env.soft.elements import make_compartments
from fish_env.soft.objects import GLOBE, OBJECTS, RING, SPHERE, Layered, room
from fish_env.soft.room import make_world
from fish_env.soft.volume import volume_of

STANDARD = {"ring": RING, "sphere": GLOBE, "uniform sphere": SPHERE}
PRESSURES = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)  # times the standard one
DROPS = (0.002, 0.02, 0.1, 0.3)  # m above the floor, from which objects without gas fall
SETTLING = 4.0  # s on the floor, after which most objects lie still
HEAVY = 6.0  # times the mass of the standard inner layer


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


def lie_on_floor(thing: Layered, drop=DROPS[0]) -> Tank:
    """Tank with the object after SETTLING seconds on a floor `drop` m below it, on which nothing bounces."""
    tank = Tank(thing, water=room(thing.down, 0.5 * thing.length + drop, 0.0), threads=1)
    tank.advance(round(SETTLING / tank.dt))
    if not tank.alive[0]:
        raise ArithmeticError(f"{thing.name}: {tank.failure[0]} at {tank.time[0]:.3f} s")
    return tank


def collapse(kind: str, layers: int, factor: float, drop=DROPS[0]) -> dict:
    """A row: area or volume over that of the unloaded object, mean and range of the second that follows."""
    thing = pressed(kind, layers, factor)
    tank, kept = lie_on_floor(thing, drop), []
    for _ in range(60):
        kept.append(enclosed(thing, tank.position[0]) / enclosed(thing, thing.body.position))
        tank.advance(round(1 / 60 / tank.dt))
    return {"object": kind, "layers": layers, "pressure_over_standard": factor, "drop": drop, "kept": np.mean(kept),
            "kept_range": np.ptp(kept)}  # fmt: skip


def impact(kind: str, inner_mass: float, speed=2.5) -> np.ndarray:
    """Times, s, and mean velocities of both layers, m/s, (K,3), of an object that flies into a wall along x."""
    thing = OBJECTS[kind].make(inner_mass=inner_mass)
    tank = Tank(thing, water=make_world(planes=[((-1.0, 0.0, 0.0), -0.11, 0.5)]), threads=1)
    tank.velocity[0, :, 0] = speed
    rows = []
    for _ in range(round(0.2 / tank.dt)):
        tank.advance(1)
        v = tank.velocity[0, :, 0]
        rows.append((tank.time[0], v[thing.outer].mean(), v[thing.inner].mean()))
    return np.array(rows)


def measure() -> list[dict]:
    """A row for each object, number of layers and pressure; two layers without gas also fall from higher."""
    scenes = [(layers, p, DROPS[0]) for layers in (1, 2) for p in PRESSURES] + [(2, 0.0, drop) for drop in DROPS[1:]]
    return [collapse(kind, *scene) for kind in STANDARD for scene in scenes]


def draw() -> None:
    """Draw what is kept over the pressure, rings without gas on a floor, and both layers' velocities in an impact."""
    figure, (left, middle, right) = panels(3, 5.4, width_ratios=(1.4, 1.1, 1.0))
    for kind, marker in zip(STANDARD, "osv", strict=True):
        for layers, colour in ((1, ORANGE), (2, BLUE)):
            rows = read_table("objects_layers.csv", object=kind, layers=layers, drop=DROPS[0])
            label = f"{kind}, {'one layer' if layers == 1 else 'two layers'}"
            left.plot(*columns(rows, "pressure_over_standard", "kept"), color=colour, marker=marker, label=label)
    left.set_xscale("symlog", base=2, linthresh=0.0625)
    left.set_xticks(PRESSURES, ["0", "1/16", "1/8", "1/4", "1/2", "1"])
    left.set(xlabel="gas pressure over the standard one", title="kept area or volume, over that at rest")
    own_legend(left)
    for layers, colour in ((1, ORANGE), (2, BLUE)):
        thing = pressed("ring", layers, 0.0)
        x = lie_on_floor(thing).position[0]
        for layer in (thing.outer, thing.inner):
            loop = np.append(layer, layer[:1])
            name = ("one layer", "two layers")[layers - 1] if layer is thing.outer else None
            middle.plot(*x[loop, :2].T, color=colour, marker=".", label=name, zorder=4 - layers)
    middle.set(title="rings without gas on the floor", aspect="equal", xlabel="m", ylabel="m")
    own_legend(middle)
    for factor, line in ((1.0, ":"), (HEAVY, "-")):
        time, outer, inner = impact("ring", factor * RING.inner_mass).T
        for velocity, colour, label in ((outer, BLUE, "outer"), (inner, ORANGE, "inner")):
            right.plot(1e3 * time[:240], velocity[:240], color=colour, linestyle=line,
                       label=f"{label} layer; inner: {factor * RING.inner_mass:g} kg")  # fmt: skip
    right.set(title="a ring flies into a wall", xlabel="time, ms", ylabel="mean velocity, m/s")
    own_legend(right)
    save(figure, RESULTS / "objects_layers.svg")
