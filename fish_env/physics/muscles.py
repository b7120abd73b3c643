"""Rest lengths of the muscles: they follow a commanded contraction at a limited rate.

A muscle lengthens by a part of what its antagonist, its mirror image, shortens: relaxed muscle resists little.

Legend: b fish; m fibre (a muscle has one or several); e spring.
"""

from math import inf

import numpy as np

from fish_env.kernels.compile import INDEX, kernel, njit


@kernel
def command(tank, goals, b, duration):
    """Set the rates of the fibres of fish b, for the part of the contractions (B,M) that they reach in `duration` s."""
    # The effort is the mean square of their changes, relative to the largest possible change.
    strength, squares = tank.muscle_variation[b, 0], 0.0
    limit = duration / (tank.contraction_time * tank.muscle_variation[b, 1])
    for m in range(tank.fibres.size):
        e = INDEX(tank.fibres[m])
        before, after = reached(tank, goals, b, m, limit)
        shortened = after
        if tank.lengthening > 0.0:
            _, opposed = reached(tank, goals, b, INDEX(tank.opposed[m]), limit)
            shortened -= tank.lengthening * opposed
        shortened *= strength * tank.fibre_span[m]
        tank.rate[b, e] = (tank.fibre_natural[m] - shortened - tank.rest_length[b, e]) / duration
        squares += ((after - before) / limit) * ((after - before) / limit)
    effort = squares / tank.fibres.size
    tank.effort[b] = effort if effort < inf else 0.0  # not finite if a rest length is not, which ends the motion


@kernel
def reached(tank, goals, b, m, limit):
    """Contraction of fibre m now, over its strength, and after a change towards the goal of at most `limit`."""
    before = contraction(tank, b, m) / tank.muscle_variation[b, 0]
    goal = 0.5 * (goals[b, INDEX(tank.drives[m, 0])] + goals[b, INDEX(tank.drives[m, 1])])
    return before, min(max(goal, before - limit), before + limit)  # (1)


@kernel
def contraction(tank, b, m):
    """Contraction of fibre m of fish b: 0 relaxed, 1 full."""
    shortened = shortening(tank, b, m)
    if tank.lengthening > 0.0:
        shortened += tank.lengthening * shortening(tank, b, INDEX(tank.opposed[m]))
        shortened /= 1.0 - tank.lengthening * tank.lengthening  # (2)
    return shortened


@kernel
def shortening(tank, b, m):
    """Part of its span by which the rest length of fibre m is below its natural length."""
    return (tank.fibre_natural[m] - tank.rest_length[b, INDEX(tank.fibres[m])]) / tank.fibre_span[m]


def contraction_of(fish, rest_length) -> np.ndarray:
    """Contraction (...,M) of each muscle, 0 relaxed to 1 full, of the rest lengths (...,E) m of all springs."""
    natural = fish.body.springs.rest_length[fish.muscles]
    shortened = (natural - rest_length[..., fish.muscles]) / ((1.0 - fish.contracted) * natural)
    if not fish.lengthening:
        return shortened
    opposed = shortened[..., fish.mirrored_muscles]
    return (shortened + fish.lengthening * opposed) / (1.0 - fish.lengthening**2)  # (2)


def first_fibres(fish) -> np.ndarray:
    """The first fibre (M,) that each muscle drives."""
    return np.array([(fish.drives == m).any(axis=1).argmax() for m in range(fish.num_muscles)], dtype=np.int64)


def opposed_fibres(fish) -> np.ndarray:
    """Fibre (K,) that lengthens as each one contracts: its mirror image."""
    if not fish.lengthening:
        return np.arange(len(fish.fibres))
    number = {frozenset(pair): k for k, pair in enumerate(fish.drives.tolist())}
    return np.array([number[frozenset(pair)] for pair in fish.mirrored_muscles[fish.drives].tolist()])


@njit
def command_all(tank, goals, duration):
    """Call `command` for every fish."""
    for b in range(goals.shape[0]):
        command(tank, goals, b, duration)
