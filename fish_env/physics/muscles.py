"""Rest lengths of the muscles: they follow a commanded contraction at a limited rate.

A muscle lengthens by a part of what its antagonist, its mirror image, shortens: relaxed muscle resists little.

Legend: b fish; m fibre (a muscle has one or several); e spring.
"""

from math import inf

import numpy as np

from fish_env.kernels.compile import INDEX, kernel, njit


@kernel
def command(tank, contraction, b, duration):
    """Set the rates of the fibres of fish b, for the part of the contraction (B,M) that they reach in `duration` s.

    The effort is the mean square of their changes, relative to the largest possible change.
    """
    strength, squares = tank.muscle_variation[b, 0], 0.0
    limit = duration / (tank.contraction_time * tank.muscle_variation[b, 1])
    for m in range(tank.fibres.size):
        e = INDEX(tank.fibres[m])
        before, after = reached(tank, contraction, b, m, limit)
        _, opposed = reached(tank, contraction, b, INDEX(tank.opposed[m]), limit)
        shortened = strength * tank.fibre_span[m] * (after - tank.lengthening * opposed)
        tank.rate[b, e] = (tank.fibre_natural[m] - shortened - tank.rest_length[b, e]) / duration
        squares += ((after - before) / limit) * ((after - before) / limit)
    effort = squares / tank.fibres.size
    tank.effort[b] = effort if effort < inf else 0.0  # not finite if a rest length is not, which ends the motion


@kernel
def reached(tank, contraction, b, m, limit):
    """Contraction of fibre m now, and after a change towards the commanded one of at most `limit`."""
    opposed = INDEX(tank.opposed[m])
    shortened = shortening(tank, b, m) + tank.lengthening * shortening(tank, b, opposed)
    before = shortened / (1.0 - tank.lengthening * tank.lengthening)  # (63)
    goal = 0.5 * (contraction[b, INDEX(tank.drives[m, 0])] + contraction[b, INDEX(tank.drives[m, 1])])
    return before, min(max(goal, before - limit), before + limit)  # (14)


@kernel
def shortening(tank, b, m):
    """What the rest length of fibre m is below its natural length, over what it can be."""
    rest = tank.rest_length[b, INDEX(tank.fibres[m])]
    return (tank.fibre_natural[m] - rest) / (tank.muscle_variation[b, 0] * tank.fibre_span[m])


@kernel
def contraction(tank, b, m):
    """Contraction of muscle m of fish b: 0 relaxed, 1 full."""
    shortened, opposed = shortening_of(tank, b, m), shortening_of(tank, b, INDEX(tank.antagonists[m]))
    return (shortened + tank.lengthening * opposed) / (1.0 - tank.lengthening * tank.lengthening)  # (63)


@kernel
def shortening_of(tank, b, m):
    """What the rest length of muscle m is below its natural length, over what it can be."""
    return (tank.natural[m] - tank.rest_length[b, INDEX(tank.muscles[m])]) / tank.span[m]


def contraction_of(fish, rest_length) -> np.ndarray:
    """Contraction (...,M) of each muscle, 0 relaxed to 1 full, of the rest lengths (...,E) m of all springs."""
    natural = fish.body.springs.rest_length[fish.muscles]
    shortened = (natural - rest_length[..., fish.muscles]) / ((1.0 - fish.contracted) * natural)
    if not fish.lengthening:
        return shortened
    opposed = shortened[..., fish.mirrored_muscles]
    return (shortened + fish.lengthening * opposed) / (1.0 - fish.lengthening**2)  # (63)


def antagonists(fish) -> np.ndarray:
    """Muscle (M,) that lengthens as each one contracts: its mirror image."""
    return fish.mirrored_muscles if fish.lengthening else np.arange(fish.num_muscles)


def opposed_fibres(fish) -> np.ndarray:
    """Fibre (K,) that lengthens as each one contracts: its mirror image."""
    if not fish.lengthening:
        return np.arange(len(fish.fibres))
    number = {frozenset(pair): k for k, pair in enumerate(fish.drives.tolist())}
    return np.array([number[frozenset(pair)] for pair in fish.mirrored_muscles[fish.drives].tolist()])


@njit
def command_all(tank, contraction, duration):
    """Call `command` for every fish."""
    for b in range(contraction.shape[0]):
        command(tank, contraction, b, duration)
