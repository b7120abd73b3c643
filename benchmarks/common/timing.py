"""Costs measured in turn, so that a change of the processor's speed affects them all."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np


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
