"""Cost against the number of fish, and against the number of nodes of a body of tetrahedra.

Fish: a control interval of the default fish on one thread. Nodes: a step of the fish of tetrahedra at its levels; and
of bars clamped at one end that swing in vacuum, at a millisecond, so that only the number of force evaluations grows as
their elements shrink. Processor time; medians and quartiles.
"""

from collections.abc import Iterator
from functools import partial

from tqdm import tqdm

from benchmarks.common.beam import LENGTH, cantilever, loose
from benchmarks.common.charts import BLUE, ORANGE, own_legend, panels, save
from benchmarks.common.tables import IMAGES, columns, publish, read_table
from benchmarks.common.timing import Glide, Swim, costs, swimming
from fish_env import Tank, make_fish

FISH = (1, 2, 3, 4, 8, 16, 64, 256, 1024, 4096, 16_384, 100_000)
LEVELS = (1, 2, 3)
THROUGH = (2, 4, 6, 8, 12, 18)  # cells through the thickness of the bars: 189 to 10,317 nodes
STEP, SPEED = 0.001, 0.1  # s; m/s, of the free end at the start: of the bars
OFTEN, RARELY = (3, 3), (3, 1)  # rounds, and how often all is made, of most, and of what takes long
LABELS = {"float64": "default fish, float64", "float32": "default fish, float32", "fish": "fish of tetrahedra",
          "bar": "bar of tetrahedra"}  # fmt: skip


def both(fish, count) -> list[Glide]:
    """So many fish in either precision."""
    return [Swim(swimming(fish, count, dtype=dtype)) for dtype in ("float64", "float32")]


def row(what: str, fish: int, nodes: int, forces, cost, steps=1) -> dict:
    """A row: what one fish, or one body, costs."""
    low, middle, high = (f"{value / steps:.4g}" for value in cost.time)
    return {"what": what, "fish": fish, "nodes": nodes, "forces_a_step": forces, "us": middle, "us_q1": low,
            "us_q3": high}  # fmt: skip


def by_fish() -> list[dict]:
    """A row for each number of fish and precision: a control interval of one of them."""
    rows, fish = [], make_fish()
    for count in tqdm(FISH, unit="number of fish"):
        found = costs(partial(both, fish, count), *(OFTEN if count <= 4096 else RARELY))
        for dtype, cost in zip(("float64", "float32"), found, strict=True):
            rows.append(row(dtype, count, fish.body.mass.size, "", cost))
    return rows


def bodies(levels=LEVELS, through=THROUGH) -> Iterator[tuple[str, Glide]]:
    """Fish and bars of tetrahedra, one of each alone."""
    for level in levels:
        yield "fish", Swim(swimming(make_fish("tetrahedral", level=level), 1))
    for n in through:
        tank = Tank(loose(cantilever(n), STEP), 1, threads=1)
        tank.velocity[:, :, 2] = SPEED * (tank.position[:, :, 0] / LENGTH) ** 2
        yield "bar", Glide(tank)


def by_nodes() -> list[dict]:
    """A row for each body: a step of one."""
    rows = []
    for name, work in tqdm(bodies(), total=len(LEVELS) + len(THROUGH), unit="body"):
        nodes = len(work.tank.fish.body.mass)
        (cost,) = costs(lambda work=work: [work], OFTEN[0], 1)
        work.start()
        before = work.tank.counters["force_evaluations"][0]
        work.run(1)
        forces = float(work.tank.counters["force_evaluations"][0] - before) / work.steps
        rows.append(row(name, 1, nodes, f"{forces:g}", cost, work.steps))
    return rows


def draw() -> None:
    """Left: a control interval of one fish against how many there are. Right: a step of one body against its nodes."""
    figure, (left, right) = panels(2, 4.4)
    for panel, key, names in ((left, "fish", ("float64", "float32")), (right, "nodes", ("fish", "bar"))):
        for name, colour in zip(names, (BLUE, ORANGE), strict=True):
            mine = columns(read_table("scaling.csv", what=name), key, "us")
            panel.loglog(*mine, "o-", color=colour, label=LABELS[name])
        own_legend(panel)
    left.set(xlabel="fish on one thread", ylabel="time of a control interval of one fish, µs", ylim=(1, None))
    right.set(xlabel="nodes", ylabel="time of a step of one body, µs")
    save(figure, IMAGES / "scaling.svg")


if __name__ == "__main__":
    publish(__doc__, {"scaling.csv": lambda: by_fish() + by_nodes()}, draw)
