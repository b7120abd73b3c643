"""Reference implementations of the springs, of the water and its inertia, of anchors, weight and walls."""

import numpy as np

STEP = 1e-30  # of a derivative by a complex step, which has no error of cancellation


def spring_force(springs, rest_length, x, v):
    """Elastic and viscous force of every unit on its two nodes, (N,3)."""
    force = np.zeros_like(x)
    for (i, j), c, k, natural in zip(springs.nodes, springs.stiffness, springs.damping, rest_length, strict=True):
        separation = x[j] - x[i]
        length = np.linalg.norm(separation)
        direction = separation / length
        elastic = c * (length - natural)
        viscous = k * np.dot(v[j] - v[i], direction)
        force[i] += (elastic + viscous) * direction
        force[j] -= (elastic + viscous) * direction
    return force


def spring_energy(springs, rest_length, x):
    """Elastic energy of all units."""
    lengths = [np.linalg.norm(x[j] - x[i]) for i, j in springs.nodes]
    return sum(
        0.5 * c * (length - natural) ** 2
        for c, length, natural in zip(springs.stiffness, lengths, rest_length, strict=True)
    )


def area_vector(corners):
    """Area times normal of a quadrilateral (4,3): half the cross product of its diagonals."""
    return 0.5 * np.cross(corners[2] - corners[0], corners[3] - corners[1])


def shares(corners):
    """Part of a face's force on each of its four corners: a quarter, or a third to each node of a triangle."""
    return np.array([1 / 3, 1 / 3, 1 / 6, 1 / 6]) if corners[2] == corners[3] else np.full(4, 0.25)


def face_force(corners, share, world, x, v):
    """Force of the water along the normal of one face, (3,): nothing on a face that moves inward."""
    linear, quadratic, current = world[:3]
    area = area_vector(x[corners])
    size = np.linalg.norm(area)
    normal = area / size
    velocity = share @ v[corners] - current
    outward = np.dot(normal, velocity)
    along = velocity - outward * normal
    speed = np.sqrt(outward**2 + world.oblique * along @ along)
    pressure = linear * outward + quadratic * speed * outward
    return min(0.0, -pressure) * size * normal


def face_friction(body, corners, share, world, x, v):
    """Friction of the water on one face over its velocity along itself, N s/m, and that velocity (3,)."""
    area = area_vector(x[corners])
    size = np.linalg.norm(area)
    velocity = share @ v[corners] - world.current
    length = max(np.ptp(body.position[:, axis]) for axis in range(3))
    coefficient = world.friction / np.sqrt(length)
    across = np.dot(velocity, area) * area / size**2
    square = velocity @ velocity
    more = 1.0 + world.thinning * (across @ across) / square if square else 1.0
    return coefficient * size * square**0.25 * more, velocity - across


def water_force(body, world, x, v):
    """Force of the water on every node, (N,3)."""
    force, faces = np.zeros_like(x), body.faces
    for corners, share, factor in zip(faces.nodes, faces.share, faces.drag, strict=True):
        push = factor * face_force(corners, share, world, x, v)
        rough, along = face_friction(body, corners, share, world, x, v)
        push -= rough * along
        for node, part in zip(corners, share, strict=True):
            force[node] += part * push
    return force


# Inertia of the water: Lagrange's equations, with derivatives by complex steps


def direction_of(a, usual):
    """Direction of a vector, analytic in its complex parts; it fades below half of the usual length."""
    square, short = (a * a).sum(), 0.25 * usual**2
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


# What surrounds a body


def anchor_force(anchors, x, v):
    """Pull of every anchor, (N,3): along itself, or, without a length, straight to its point."""
    force = np.zeros_like(x)
    for i, point, moving, c, k, natural in zip(*anchors, strict=True):
        r, u = point - x[i], moving - v[i]
        if natural == 0.0:
            force[i] += c * r + k * u
        else:
            direction = r / np.linalg.norm(r)
            force[i] += (c * (np.linalg.norm(r) - natural) + k * np.dot(u, direction)) * direction
    return force


def anchor_energy(anchors, x):
    """Elastic energy of the anchors."""
    lengths = np.linalg.norm(anchors.point - x[anchors.node], axis=1)
    return 0.5 * np.sum(anchors.stiffness * (lengths - anchors.rest_length) ** 2)


def weight_energy(body, world, x):
    """Energy of the weight."""
    return -np.sum(body.mass[:, None] * world.gravity * x)


def behind(plane, x, v, i):
    """Whether node i is behind a plane and does not come back by itself."""
    return plane[:3] @ x[i] <= plane[3] and plane[:3] @ v[i] <= 1e-12 * np.linalg.norm(v[i])


def with_reaction(planes, x, v, force):
    """The force (N,3) less what presses nodes further behind the planes."""
    force = force.copy()
    for plane in () if planes is None else planes:
        for i in range(len(x)):
            if behind(plane, x, v, i):
                force[i] -= min(0.0, plane[:3] @ force[i]) * plane[:3]
    return force


def constrain(planes, x, v, h, acceleration):
    """Accelerations (N,3) that in h send no node further behind a plane that it is behind: it stops at most."""
    acceleration = acceleration.copy()
    for plane in () if planes is None else planes:
        for i in range(len(x)):
            if plane[:3] @ x[i] <= plane[3]:
                least = -max(0.0, plane[:3] @ v[i]) / h
                acceleration[i] += max(0.0, least - plane[:3] @ acceleration[i]) * plane[:3]
    return acceleration


def bounce(body, world, h, x, v):
    """Velocities (N,3) after the impacts on the planes that follow a step."""
    v = v.copy()
    for plane in () if world.planes is None else world.planes:
        normal = plane[:3]
        falling = 0.0 if world.gravity is None else 2 * h * abs(normal @ world.gravity)
        for i in range(len(x)):
            speed = normal @ v[i]
            if behind(plane, x, v, i) and speed < 0:
                hit = -speed > falling and normal @ x[i] - plane[3] > 2 * h * speed
                part = plane[4] if hit else 0.0
                v[i] -= (1 + part) * speed * normal * (body.inverse_mass[i] > 0)
    return v


def anchors_of(world, x):
    """Of every anchor: node, stiffness, damping, the axes it acts along (3,3), and its strain, at least zero."""
    for i, point, _, c, k, natural in zip(*world.anchors, strict=True) if world.anchors is not None else ():
        r = point - x[i]
        if natural == 0.0:
            yield i, c, k, np.eye(3), 1.0
        else:
            yield i, c, k, np.outer(r, r) / (r @ r), max(0.0, 1.0 - natural / np.linalg.norm(r))


def anchor_rates(body, world):
    """Stiffness and damping over mass of the node with the stiffest anchors."""
    stiffness, damping = np.zeros(len(body.mass)), np.zeros(len(body.mass))
    if world.anchors is not None:
        np.add.at(stiffness, world.anchors.node, world.anchors.stiffness)
        np.add.at(damping, world.anchors.node, world.anchors.damping)
    inverse = body.inverse_mass.max(axis=1)
    return (stiffness * inverse).max(), (damping * inverse).max()


def at(world, t):
    """The world t seconds into a call: its anchors have moved."""
    if world.anchors is None:
        return world
    return world._replace(anchors=world.anchors._replace(point=world.anchors.point + t * world.anchors.velocity))
