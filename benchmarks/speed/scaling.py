"""Cost against the number of fish, and against the number of nodes of a body of tetrahedra.

    python -m benchmarks.speed.scaling            two CSVs and the chart (about 5 min, 3 GB)
    python -m benchmarks.speed.scaling --draw     the chart again, from the CSVs

Fish: a control interval of the default fish on one thread. Nodes: the fish of tetrahedra at its levels, at its own
step; and bars clamped at one end that swing in vacuum, at steps of a millisecond, so that only the number of stages
grows as their elements shrink. Processor time; medians.
"""

import argparse
from functools import partial

import numpy as np
from tqdm import tqdm

from benchmarks.common.beam import LENGTH, cantilever, loose
from benchmarks.common.charts import pyplot, save
from benchmarks.common.tables import IMAGES, RESULTS, read_table, write_csv
from benchmarks.speed.costs import Glide, Swim, costs, swimming
from fish_env import Tank, make_fish
from fish_env.tank_options import kind_for

FISH = (1, 2, 3, 4, 8, 16, 64, 256, 1024, 4096, 16_384, 100_000)
LEVELS = (1, 2, 3)
THROUGH = (2, 4, 6, 8, 12, 18)  # cells through the thickness of the bars: 189 to 10,317 nodes
STEP, SPEED = 0.001, 0.1  # s; m/s, of the free end at the start: of the bars
IN_LANES, MOST_IN_LANES = 8, 2000  # fish side by side, and the most nodes of which so many are tried
OFTEN, RARELY = (3, 3), (3, 1)  # rounds, and how often all is made, of most, and of what takes long
PRECISIONS = ("float64", "float32")
COMMAND = "python -m benchmarks.speed.scaling"
BY_FISH, BY_NODES = "scaling_fish.csv", "scaling_nodes.csv"
CHART = IMAGES / "scaling.svg"


def both(fish, count) -> list[Swim]:
    """So many fish in either precision."""
    return [Swim(swimming(fish, count, dtype=dtype)) for dtype in PRECISIONS]


def by_fish() -> list[dict]:
    """A row for each number of fish and precision."""
    rows, fish = [], make_fish()
    for count in tqdm(FISH, unit="number of fish"):
        works = partial(both, fish, count)
        for kind, cost in zip(PRECISIONS, costs(works, *(OFTEN if count <= 4096 else RARELY)), strict=True):
            rows.append({"fish": count, "dtype": kind, "lanes": kind_for(count, kind, None).lanes,
                         "us_a_fish": f"{cost.time[1]:.4g}",
                         "us_q1": f"{cost.time[0]:.4g}", "us_q3": f"{cost.time[2]:.4g}",
                         "fish_intervals_a_second": f"{1e6 / cost.time[1]:.4g}"})  # fmt: skip
    return rows


def bodies() -> list[tuple[str, object]]:
    """Names, and functions of a number of fish that make what is timed."""

    def level(k):
        fish = make_fish("tetrahedral", level=k)
        return lambda count: Swim(swimming(fish, count))

    def bar(n):
        def make(count):
            tank = Tank(loose(cantilever(n), STEP), count, threads=1)
            tank.velocity[:, :, 2] = SPEED * (tank.position[:, :, 0] / LENGTH) ** 2
            return Glide(tank)

        return make

    return [(f"fish, level {k}", level(k)) for k in LEVELS] + [(f"bar, {n} cells through", bar(n)) for n in THROUGH]


def several(make, counts) -> list[Glide]:
    """What is timed of a body, for each of these numbers of it."""
    return [make(count) for count in counts]


def by_nodes() -> list[dict]:
    """A row for each body: a step of one fish alone, and of one of several in lanes."""
    rows = []
    for name, make in tqdm(bodies(), unit="body"):
        one = make(1)
        body, steps = one.tank.fish.body, one.steps
        counts = (1, IN_LANES) if len(body.mass) <= MOST_IN_LANES else (1,)
        found = costs(partial(several, make, counts), *(OFTEN if len(body.mass) < 500 else RARELY))
        one.start()
        before = one.tank.counters["force_evaluations"][0]
        one.run(1)
        stages = float(one.tank.counters["force_evaluations"][0] - before) / steps
        alone, lanes = (each.time[1] / steps for each in (found[0], found[-1]))
        rows.append({"body": name, "nodes": len(body.mass), "tetrahedra": len(body.tets.nodes),
                     "forces_a_step": f"{stages:g}", "us_a_step": f"{alone:.4g}",
                     "us_a_step_in_lanes": f"{lanes:.4g}" if len(counts) > 1 else np.nan,
                     "ns_a_tetrahedron_and_force": f"{1e3 * alone / stages / len(body.tets.nodes):.4g}",
                     "ns_in_lanes": f"{1e3 * lanes / stages / len(body.tets.nodes):.4g}" if len(counts) > 1 else np.nan,
                     })  # fmt: skip
    return rows


def draw() -> None:
    """Left: cost a fish against how many there are. Right: cost a step against nodes, and of each element and force."""
    plt = pyplot()

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.3), layout="constrained")
    fish, nodes = read_table(BY_FISH), read_table(BY_NODES)
    for dtype, colour in (("float64", "#0072B2"), ("float32", "#D55E00")):
        line = [row for row in fish if row["dtype"] == dtype]
        left.loglog([row["fish"] for row in line], [row["us_a_fish"] for row in line], "o-", color=colour, label=dtype)
    left.set(xlabel="fish on one thread", ylabel="a control interval of one fish, us", ylim=(1, None))
    left.legend(frameon=False)
    families = (("fish", "#009E73", "s"), ("bar", "#0072B2", "o"))
    for panel, keys in ((middle, ("us_a_step", "us_a_step_in_lanes")),
                        (right, ("ns_a_tetrahedron_and_force", "ns_in_lanes"))):  # fmt: skip
        for family, colour, marker in families:
            line = [row for row in nodes if row["body"].startswith(family)]
            for key, style in zip(keys, ("-", "--"), strict=True):
                label = f"{family}, {'one of ' + str(IN_LANES) + ' in lanes' if style == '--' else 'alone'}"
                panel.plot([row["nodes"] for row in line], [row[key] for row in line], style, marker=marker,
                           color=colour, markersize=4.5, label=label)  # fmt: skip
        panel.set(xscale="log", xlabel="nodes")
    middle.set(yscale="log", ylabel="a step, us")
    right.set(ylabel="an element's force, ns", ylim=(0, None))
    middle.legend(frameon=False, fontsize=8)
    for panel in (left, middle, right):
        panel.grid(alpha=0.2)
    save(figure, CHART)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSVs")
    if not parser.parse_args().draw:
        write_csv(BY_FISH, by_fish(), COMMAND)
        write_csv(BY_NODES, by_nodes(), COMMAND)
    draw()
    print(f"written to {RESULTS / BY_FISH}, {BY_NODES} beside it, and {CHART}")


if __name__ == "__main__":
    main()
