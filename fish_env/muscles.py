"""Muscles' rest lengths: set out for a commanded contraction, at a limited rate or by first-order activation.

Legend: b fish; m fibre (a muscle has one or several); e spring.
"""

from math import exp

from fish_env._jit import INDEX, kernel, njit


@kernel
def reach(tank, now, goal, duration):
    """The contraction that a fibre gets to in `duration` s from contraction `now`, with the command `goal`."""
    rise, fall = tank.activation_time[0], tank.activation_time[1]
    if rise > 0.0:
        return goal + (now - goal) * exp(-duration / (rise if goal > now else fall))  # (65)
    limit = duration / tank.contraction_time
    return now + min(max(goal - now, -limit), limit)


@kernel
def command(tank, contraction, b, duration):
    """Set the rates at which the fibres of fish b move: to what they get to, of the contraction (B,M), in `duration` s.

    The effort is the mean square of their changes, over the largest there can be.
    """
    squares, most = 0.0, reach(tank, 0.0, 1.0, duration)
    for m in range(tank.fibres.size):
        e = INDEX(tank.fibres[m])
        goal = 0.5 * (contraction[b, INDEX(tank.drives[m, 0])] + contraction[b, INDEX(tank.drives[m, 1])])
        now = (tank.fibre_natural[m] - tank.rest_length[b, e]) / tank.fibre_span[m]
        change = reach(tank, now, goal, duration) - now
        tank.rate[b, e] = -change * tank.fibre_span[m] / duration
        squares += (change / most) ** 2
    tank.effort[b] = squares / tank.fibres.size


@njit
def command_all(tank, contraction, duration):
    """`command` every fish."""
    for b in range(contraction.shape[0]):
        command(tank, contraction, b, duration)
