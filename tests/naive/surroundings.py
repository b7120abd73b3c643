"""Reference implementations of what surrounds a body: anchors, weight and walls."""

import numpy as np


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
