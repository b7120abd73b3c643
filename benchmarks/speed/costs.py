"""What moving fish costs: kinds of kernels, integrators, bodies. Runs alternate within one process; see `timing`.

Times are processor time a fish, unless it is said that they are the clock's; ratios are medians of those of each round.
Everything is made several times: where its arrays come to lie in memory can cost a tank twice its time.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.common.timing import Cost, interleaved
from fish_env import BODIES, INTEGRATORS, Tank, make_fish
from fish_env.bodies import Fish
from fish_env.control import best_gait

SETS, ROUNDS = 3, 5  # how often all tanks are made, and are timed in turn
SAMPLE = 0.04  # s of each run in a round, about
EXPLICIT_STEP = 0.0003  # s, at which methods are compared; the default takes its own
TOGETHER = 64  # fish in lanes
SPREAD = 0.2  # by which the factors of varied fish differ from 1
BATCHES = (256, 1024)


def swimming(fish: Fish, num_fish: int, **options) -> Tank:
    """Fish that have swum for a second, all in the same state."""
    swimmer, gait = Tank(fish, 1, water=fish.water), best_gait()
    steps = round(fish.control_interval / swimmer.dt)
    for k in range(round(1.0 / fish.control_interval)):
        swimmer.drive(gait.contraction(fish, k * fish.control_interval)[None], steps)
    tank = Tank(fish, num_fish, water=fish.water, **{"threads": 1} | options)
    state = swimmer.get_state() | {"counters": np.zeros((1, 5), dtype=np.int64)}
    tank.set_state({name: np.repeat(value, num_fish, axis=0) for name, value in state.items()})
    return tank


def vary(tank: Tank) -> Tank:
    """Make every fish differ from the others."""
    generator = np.random.default_rng(0)
    for i in range(tank.num_fish):
        stiffness, mass, drag = generator.uniform(1.0 - SPREAD, 1.0 + SPREAD, 3)
        current = 0.1 * tank.fish.length * generator.uniform(-1.0, 1.0, 3) * (not tank.fish.flat, 1.0, 0.0)
        tank.vary(i, stiffness, mass, drag, current)
    return tank


class Glide:
    """Steps of a tank whose fish are left alone."""

    steps = 1
    """Steps of what is timed."""

    def __init__(self, tank: Tank):
        self.tank, self.state = tank, tank.get_state()

    def start(self) -> None:
        """Back to where all began."""
        self.tank.set_state(self.state)

    def run(self, times: int) -> None:
        """Glide on."""
        self.tank.advance(times)
        assert self.tank.alive.all(), self.tank.failure


class Swim(Glide):
    """Control intervals of a gait, of all fish of a tank."""

    def __init__(self, tank: Tank):
        super().__init__(tank)
        fish, gait = tank.fish, best_gait()
        self.steps = round(fish.control_interval / tank.dt)
        beat = [gait.contraction(fish, k * fish.control_interval) for k in range(13)]
        self.goals = [np.repeat(goal[None], tank.num_fish, axis=0) for goal in beat]

    def run(self, times: int) -> None:
        """Swim on."""
        for k in range(times):
            self.tank.drive(self.goals[k % len(self.goals)], self.steps)
        assert self.tank.alive.all(), self.tank.failure


def costs(make: Callable[[], list[Glide]], rounds: int = ROUNDS, sets: int = SETS) -> list[Cost]:
    """Cost of an interval, or a step, and fish of each, and its ratio to the first's: medians over what is made."""
    found = [timed(make(), rounds) for _ in range(sets)]
    return [Cost(*np.median([tuple(cost) for cost in same], axis=0)) for same in zip(*found, strict=True)]


def timed(works: list[Glide], rounds: int) -> list[Cost]:
    """The same of works that are at hand."""
    runs = []
    for work in works:
        work.start()
        work.run(1)  # compiles
        work.start()
        begin = time.process_time()
        work.run(1)
        often = max(1, min(200, round(SAMPLE / max(time.process_time() - begin, 1e-6))))
        runs.append((work.start, partial(work.run, often), often * work.tank.num_fish))
    return interleaved(runs, rounds)


def row(table: str, name: str, cost: Cost, against: str, num_fish: int) -> dict:
    """A row: time a fish, and its ratio to that of what it is compared with."""
    (low, middle, high), ratio = cost.time, cost.ratio
    return {
        "table": table, "name": name, "fish": num_fish, "us": f"{middle:.4g}", "us_q1": f"{low:.4g}",
        "us_q3": f"{high:.4g}", "against": against, "ratio": f"{ratio[1]:.3f}", "ratio_q1": f"{ratio[0]:.3f}",
        "ratio_q3": f"{ratio[2]:.3f}",
    }  # fmt: skip


def kinds() -> list[dict]:
    """A control interval of the default fish by every kind of kernel, one fish and many; varied fish."""
    fish, rows = make_fish(), []
    one = {"xyz": {}, "lanes=1": {"lanes": 1}, "xyz, float32": {"dtype": "float32"}}
    found = costs(lambda: [Swim(swimming(fish, 1, **options)) for options in one.values()])
    rows += [row("one fish", name, cost, "xyz", 1) for name, cost in zip(one, found, strict=True)]
    for count in BATCHES:
        many = {
            "8 lanes": {}, "16 lanes, float32": {"dtype": "float32"}, "xyz": {"lanes": "xyz"}, "lanes=1": {"lanes": 1},
            "4 lanes": {"lanes": 4}, "16 lanes": {"lanes": 16},
        }  # fmt: skip
        varied = {f"{name}, varied": many[name] for name in ("8 lanes", "16 lanes, float32")}

        def make(count=count, many=many, varied=varied):
            equal = [swimming(fish, count, **options) for options in many.values()]
            different = [vary(swimming(fish, count, **options)) for options in varied.values()]
            return [Swim(tank) for tank in (*equal, *different)]

        names = (*many, *varied)
        rows += [row(f"{count} fish", *each, "8 lanes", count) for each in zip(names, costs(make), strict=True)]
    return rows


def threads(count: int = BATCHES[-1], rounds: int = SETS * ROUNDS) -> dict:
    """By the clock: a control interval over two threads and over one, in turn."""
    works = [Swim(swimming(make_fish(), count, threads=number)) for number in (1, 2)]
    taken = np.empty((rounds + 1, 2))
    for times in taken:
        for k, work in enumerate(works):
            work.start()
            begin = time.perf_counter()
            work.run(3)
            times[k] = (time.perf_counter() - begin) / 3 / count * 1e6
    for work in works:
        work.tank.close()
    quarters = [25, 50, 75]
    times = np.percentile(taken[1:, 1], quarters)
    cost = Cost(times, np.percentile(taken[1:, 1] / taken[1:, 0], quarters))
    return row("threads, by the clock", "two", cost, "one", count)


def in_lanes(make, names, count: int = TOGETHER) -> list[tuple[str, Cost, Cost]]:
    """Cost of each name's fish, one by itself beside the first's, and of one of many in lanes beside it by itself."""
    alone = costs(lambda: [make(name, 1) for name in names])
    beside = [costs(lambda name=name: [make(name, 1), make(name, count)])[1] for name in names]
    return list(zip(names, alone, beside, strict=True))


def integrators() -> list[dict]:
    """A step of every method with steps of its own, beside symplectic Euler's; one of many in lanes, beside alone."""
    fish, default = make_fish(), make_fish().integrator
    names = [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"]
    names.sort(key=lambda name: name != "symplectic_euler")

    def glide(name, count):
        return Glide(swimming(fish, count, integrator=name, dt=fish.time_step if name == default else EXPLICIT_STEP))

    return [{"integrator": name, "us_per_step": f"{one.time[1]:.4g}", "symplectic_steps": f"{one.ratio[1]:.3f}",
             "fish_in_lanes": TOGETHER, "us_in_lanes": f"{many.time[1]:.4g}", "over_alone": f"{many.ratio[1]:.3f}"}
            for name, one, many in in_lanes(glide, names)]  # fmt: skip


def bodies() -> list[dict]:
    """A control interval of every body, beside the default's; one of many in lanes, beside alone."""
    fish = {name: make_fish(name) for name in BODIES}
    names = sorted(fish, key=lambda name: name != make_fish().name)
    return [{"body": name, "nodes": fish[name].body.mass.size, "us_per_interval": f"{one.time[1]:.4g}",
             "default_intervals": f"{one.ratio[1]:.3f}", "simulated_s_per_s": f"{interval(fish[name], one):.4g}",
             "fish_in_lanes": TOGETHER, "us_in_lanes": f"{many.time[1]:.4g}", "over_alone": f"{many.ratio[1]:.3f}"}
            for name, one, many in in_lanes(lambda name, count: Swim(swimming(fish[name], count)), names)]  # fmt: skip


def interval(fish: Fish, cost: Cost) -> float:
    """Simulated seconds a second of computing."""
    return fish.control_interval / (1e-6 * cost.time[1])
