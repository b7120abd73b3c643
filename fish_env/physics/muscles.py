"""Rest lengths of the muscles: they follow a commanded contraction at a limited rate or by first-order activation.

Legend: b fish; m fibre (a muscle has one or several); e spring.
"""

from math import exp, inf

from fish_env.kernels.compile import INDEX, kernel, njit


@kernel
def command(tank, contraction, b, duration):
    """Set the rates of the fibres of fish b, for the part of the contraction (B,M) that they reach in `duration` s.

    The effort is the mean square of their changes, relative to the largest possible change.
    """
    strength, slowness = tank.muscle_variation[b, 0], tank.muscle_variation[b, 1]
    squares, fastest = 0.0, duration / (tank.contraction_time * slowness)
    rise, fall = tank.activation_time[0] * slowness, tank.activation_time[1] * slowness
    if rise > 0.0:
        fastest = 1.0 - exp(-duration / rise)
    for m in range(tank.fibres.size):
        e = INDEX(tank.fibres[m])
        goal = 0.5 * (contraction[b, INDEX(tank.drives[m, 0])] + contraction[b, INDEX(tank.drives[m, 1])])
        span = strength * tank.fibre_span[m]
        wanted = tank.fibre_natural[m] - goal * span - tank.rest_length[b, e]
        limit = fastest * span
        if rise > 0.0:
            change = wanted * (1.0 - exp(-duration / (rise if wanted < 0.0 else fall)))  # (63)
        else:
            change = min(max(wanted, -limit), limit)  # (14)
        tank.rate[b, e] = change / duration
        squares += (change / limit) * (change / limit)
    effort = squares / tank.fibres.size
    tank.effort[b] = effort if effort < inf else 0.0  # not finite if a rest length is not, which ends the motion


@njit
def command_all(tank, contraction, duration):
    """Call `command` for every fish."""
    for b in range(contraction.shape[0]):
        command(tank, contraction, b, duration)
