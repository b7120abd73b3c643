"""The search of the calibrations where derivatives are of no use: CMA-ES."""

import numpy as np
from tqdm import tqdm


def minimise(cost, start, step, generations: int, seed: int, population=16, each=map, **options):
    """Best point that CMA-ES finds, and its cost.

    Args:
        cost: of a point.
        start: a point.
        step: standard deviation of the first points.
        generations: how many.
        seed: of the points.
        population: points a generation.
        each: a `map`, which may share its calls out to processes.
        options: further ones of `cma`.
    """
    import cma

    options |= {"seed": seed, "popsize": population, "verbose": -9, "maxiter": generations}
    strategy = cma.CMAEvolutionStrategy(np.asarray(start), step, options)
    with tqdm(total=generations, mininterval=10) as bar:
        while not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, list(each(cost, points)))
            bar.update()
            bar.set_postfix(cost=f"{strategy.result.fbest:.4f}")
    return strategy.result.xbest, float(strategy.result.fbest)
