"""How long a step each family of methods bears about rest, by linear theory: what a default step is taken from.

A body's fastest vibration has the frequency w, w^2 = `elastic_rate`, and the relaxation time s, s w^2 = `viscous_rate`.
Where `benchmarks/stability.py` measures more, these stay on the safe side.
"""

import math

from fish_env.body import Body


def leapfrog(body: Body) -> float:
    """Of symplectic Euler, s: (sqrt((w s)^2 + 4) - w s) / w. Tu's has the same; all but two others bear it."""
    elastic, viscous = body.elastic_rate, body.viscous_rate
    if elastic == 0.0:
        return 2.0 / viscous if viscous > 0.0 else math.inf
    return (math.sqrt(viscous**2 + 4.0 * elastic) - viscous) / elastic


def relaxation(body: Body) -> float:
    """Shortest relaxation time k/c of the units, s; infinite without stiffness."""
    springs = body.springs
    elastic = springs.stiffness > 0.0
    return float((springs.damping[elastic] / springs.stiffness[elastic]).min(initial=math.inf))


def explicit_euler(body: Body) -> float:
    """Of explicit Euler, s: the relaxation time, without which it has no stable step."""
    return min(relaxation(body), leapfrog(body))


def midpoint(body: Body) -> float:
    """Of the midpoint method, s: a step h feeds a vibration (h w)^4 / 4 and damping takes h s w^2."""
    if body.elastic_rate == 0.0:
        return leapfrog(body)
    return min((4.0 * relaxation(body) / body.elastic_rate) ** (1 / 3), leapfrog(body))
