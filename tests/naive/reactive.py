"""Reference implementation of the inertia of the water: Lagrange's equations, with derivatives by complex steps."""

import numpy as np

STEP = 1e-30  # of a derivative by a complex step, which has no error of cancellation


def direction_of(a, usual):
    """Direction of a vector, analytic in its complex parts; it fades below a fifth of the usual length."""
    square, short = (a * a).sum(), 0.04 * usual**2
    lacking = max(0.0, short - square, key=lambda number: number.real)
    return a / np.sqrt(square + 0.5 * lacking**2 / short)


def sections_of(body):
    """Nodes of every section, and their shares."""
    s = body.sections
    return zip(np.split(s.nodes, s.first[1:-1]), np.split(s.share, s.first[1:-1]), strict=True)


def moving_water(body, world, x):
    """Of each section: its nodes, their shares, its tangent, and lateral and vertical added mass with directions."""
    s = body.sections
    middle = [share @ x[nodes] for nodes, share in sections_of(body)]
    above = np.array([0.0, 0.0, s.height])
    rise, usual = ((at[s.upper] - at[s.lower]).sum(axis=0) + above for at in (x, body.position))
    for k, (nodes, share) in enumerate(sections_of(body)):
        begin = min(max(k - 1, 0), len(middle) - 3)
        tangent = s.slope[k] @ np.array(middle[begin : begin + 3])
        t = direction_of(tangent, 1.0)
        n = direction_of(np.cross(t, rise), np.linalg.norm(usual))
        lateral, vertical = world.added_mass * (s.lateral[k], s.vertical[k])
        yield nodes, share, t, ((lateral, n), (vertical, np.cross(n, t)))


def water_energy(body, world, x, v):
    """Kinetic energy of the water."""
    total = 0.0
    for nodes, share, _, parts in moving_water(body, world, x):
        speed = share @ v[nodes] - world.current
        total = total + sum(0.5 * mass * (speed @ direction) ** 2 for mass, direction in parts)
    return total


def water_momentum(body, world, x, v):
    """Derivative of that energy with respect to the velocities, (N,3)."""
    found = np.zeros_like(x)
    for nodes, share, _, parts in moving_water(body, world, x):
        speed = share @ v[nodes] - world.current
        for mass, direction in parts:
            found[nodes] += np.outer(share, mass * (speed @ direction) * direction)
    return found


def added_mass(body, world, x):
    """Added mass of the nodes, (3N,3N)."""
    n = len(x)
    matrix = np.zeros((n, 3, n, 3))
    for nodes, share, _, parts in moving_water(body, world, x):
        for mass, direction in parts:
            both = np.multiply.outer(share, direction)
            matrix[np.ix_(nodes, range(3), nodes, range(3))] += mass * np.multiply.outer(both, both)
    return matrix.reshape(3 * n, 3 * n)


def wake_force(body, world, x, v):
    """What the trailing edge of the tail sheds, and the narrowing rear sideways of it, (N,3)."""
    found, s = np.zeros_like(x), body.sections
    for k, (nodes, share, t, ((_, n), (_, b))) in enumerate(moving_water(body, world, x)):
        speed = share @ v[nodes] - world.current
        ahead = max(0.0, -(speed @ t))
        force = -world.added_mass[1] * s.narrowing[k] * ahead * (speed @ b) * b
        if k == len(s.lateral) - 1 and ahead:
            edge, w = world.added_mass[0] * s.trailing, speed @ n
            force = force - edge * ahead * w * n - 0.5 * edge * w**2 * ahead / np.hypot(ahead, w) * t
        found[nodes] += np.outer(share, force)
    return found


def reactive_force(body, world, x, v):
    """Force of the water's inertia on the nodes that would not accelerate, (N,3)."""
    force = -water_momentum(body, world, x + 1j * STEP * v, v + 0j).imag / STEP
    for i in np.ndindex(x.shape):
        shifted = x + 0j
        shifted[i] += 1j * STEP
        force[i] += water_energy(body, world, shifted, v).imag / STEP
    return relieve_fin(body, x, force + wake_force(body, world, x, v))


def relieve_fin(body, x, force):
    """The same forces, but those along the body on the fin's sections act on the section before, in turn."""
    sections = list(sections_of(body))
    for k in range(1, body.sections.fin + 1):
        (before, part), (here, share) = sections[-k - 1], sections[-k]
        chord = share @ x[here] - part @ x[before]
        pull = force[here].sum(axis=0) @ chord * chord / (chord @ chord)
        force[here] -= np.outer(share, pull)
        force[before] += np.outer(part, pull)
    return force
