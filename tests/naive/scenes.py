"""What to move, and what to measure on it: momenta, energies, random states, water."""

import numpy as np

from naive.elements import triangles

TU = ("mass_spring", "published")
"""The bodies of Tu's topology, 23 nodes and 91 units; tests/test_bodies.py has the others."""


def momentum(mass, v):
    """Linear momentum, (3,)."""
    return mass @ v


def angular_momentum(mass, x, v):
    """Angular momentum about the origin, (3,)."""
    return mass @ np.cross(x, v)


def kinetic_energy(mass, v):
    """Energy of motion."""
    return 0.5 * np.sum(mass * np.sum(v * v, axis=1))


def polygon(corners):
    """The different nodes of a face, in order: four, or three where the third is given twice."""
    return list(corners[:3]) if corners[2] == corners[3] else list(corners)


def enclosed_volume(faces, x):
    """Volume inside a closed surface of triangles and bilinear patches.

    The volume under a bilinear patch is the mean of those under its two triangulations.
    """
    return sum(part * np.linalg.det(x[list(nodes)]) / 6 for face in faces.nodes for nodes, part in triangles(face))


def mirrored_muscles(fish):
    """(M,) the muscle that each muscle becomes when left and right are exchanged, found through its two nodes."""
    ends = [frozenset(map(int, fish.body.springs.nodes[e])) for e in fish.muscles]
    return np.array([ends.index(frozenset(int(fish.mirror[i]) for i in pair)) for pair in ends])


def random_state(fish, rng, displacement=0.02, speed=1.0):
    """A deformed, moving and turned fish: displacements in body lengths, speeds in body lengths a contraction time."""
    size = fish.body.position.shape
    turn = turned(rng)
    x = (fish.body.position + displacement * fish.length * rng.uniform(-1, 1, size)) @ turn.T
    v = speed * fish.length / fish.contraction_time * rng.uniform(-1, 1, size)
    return x, v


def turned(rng):
    """A random rotation."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn))


SHORTER = {"explicit_euler": 1 / 32, "midpoint": 1 / 4}
"""Part of an ordinary step at which a method is stable; light damping is all that stabilises explicit Euler."""


def dense_water(fish, law="quadratic", current=(0.0, 0.0, 0.0)):
    """Water about as dense as the fish, which fills a hundredth of its length cubed: (linear, quadratic, current).

    The linear law resists a speed of one length a contraction time as the quadratic one does. `current` is in that
    unit too.
    """
    unit = fish.length / fish.contraction_time
    quadratic = 0.5 * 1.5 * fish.body.mass.sum() / (0.01 * fish.length**3)
    flow = unit * np.asarray(current, dtype=float)
    return (0.0, quadratic, flow) if law == "quadratic" else (quadratic * unit, 0.0, flow)
