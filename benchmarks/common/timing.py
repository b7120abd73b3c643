"""Costs measured in turn, so that a change of the processor's speed affects them all; and fish that are timed."""

import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from fish_env import Fish, Tank
from fish_env.control import best_gait

SETS, ROUNDS = 3, 5  # how often all tanks are made, and are timed in turn
SAMPLE = 0.04  # s of each run in a round, about


class Cost(NamedTuple):
    """Median and quartiles over the rounds of a time, us, and of its ratio to the first one's in the same round."""

    time: np.ndarray  # (3,) lower quartile, median, upper quartile
    ratio: np.ndarray  # (3,)


def interleaved(runs: list[tuple[Callable[[], None], Callable[[], None], int]], rounds: int) -> list[Cost]:
    """Cost of each run, which prepares (not timed), runs, and does a number of steps: us of processor time a step.

    Processor time of this process is what a lone process would take from the clock on the wall, since all runs on one
    core and nothing waits. A first round, of caches and compilation, is not counted.
    """
    found = np.empty((rounds + 1, len(runs)))
    for times in found:
        for k, (prepare, run, steps) in enumerate(runs):
            prepare()
            begin = time.process_time()
            run()
            times[k] = (time.process_time() - begin) / steps * 1e6
    found, quarters = found[1:], [25, 50, 75]
    times, ratios = np.percentile(found, quarters, axis=0).T, np.percentile(found / found[:, :1], quarters, axis=0).T
    return [Cost(*pair) for pair in zip(times, ratios, strict=True)]


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


class Glide:
    """Steps of a tank whose fish are left alone."""

    steps = 1
    """Steps of what is timed."""

    def __init__(self, tank: Tank):
        self.tank, self.state, self.count = tank, tank.get_state(), tank.num_fish

    def start(self) -> None:
        """Back to where all began."""
        self.tank.set_state(self.state)

    def run(self, times: int) -> None:
        """Glide on."""
        self.tank.advance(times)
        assert self.tank.alive.all(), self.tank.failure


class Swim(Glide):
    """Control intervals of all fish of a tank, by goals (K,B,M), again and again; by default the best gait's."""

    def __init__(self, tank: Tank, goals: np.ndarray | None = None):
        super().__init__(tank)
        fish, gait = tank.fish, best_gait()
        self.steps = round(fish.control_interval / tank.dt)
        beat = [gait.contraction(fish, k * fish.control_interval) for k in range(13)]
        self.goals = [np.repeat(goal[None], tank.num_fish, axis=0) for goal in beat] if goals is None else goals

    def run(self, times: int) -> None:
        """Swim on."""
        for k in range(times):
            self.tank.drive(self.goals[k % len(self.goals)], self.steps)
        assert self.tank.alive.all(), self.tank.failure


def costs(make: Callable[[], list], rounds: int = ROUNDS, sets: int = SETS, most: int = 200) -> list[Cost]:
    """Cost of an interval, or a step, and fish of each, and its ratio to the first's: medians over what is made."""
    found = [timed(make(), rounds, most) for _ in range(sets)]
    return [Cost(*np.median([tuple(cost) for cost in same], axis=0)) for same in zip(*found, strict=True)]


def timed(works: list, rounds: int, most: int = 200) -> list[Cost]:
    """Costs of works that are at hand: `start` prepares one, and `run` does it up to `most` times, for `count` fish."""
    runs = []
    for work in works:
        work.start()
        work.run(1)  # compiles
        work.start()
        begin = time.process_time()
        work.run(1)
        often = max(1, min(most, round(SAMPLE / max(time.process_time() - begin, 1e-6))))
        runs.append((work.start, partial(work.run, often), often * work.count))
    return interleaved(runs, rounds)
