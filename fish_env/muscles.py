"""Muscles' rest lengths: set out for a commanded contraction at a limited rate.

Legend: b fish; m fibre (a muscle has one or several); e spring.
"""

from fish_env._jit import INDEX, kernel, njit


@kernel
def command(tank, contraction, b, duration):
    """Set the rates at which the fibres of fish b move: to the contraction (B,M), or as far as `duration` s allows."""
    squares, fastest = 0.0, duration / tank.contraction_time
    for m in range(tank.fibres.size):
        e = INDEX(tank.fibres[m])
        goal = 0.5 * (contraction[b, INDEX(tank.drives[m, 0])] + contraction[b, INDEX(tank.drives[m, 1])])
        wanted = tank.fibre_natural[m] - goal * tank.fibre_span[m] - tank.rest_length[b, e]
        limit = fastest * tank.fibre_span[m]
        change = min(max(wanted, -limit), limit)
        tank.rate[b, e] = change / duration
        squares += (change / limit) ** 2
    tank.effort[b] = squares / tank.fibres.size


@njit
def command_all(tank, contraction, duration):
    """`command` every fish."""
    for b in range(contraction.shape[0]):
        command(tank, contraction, b, duration)
