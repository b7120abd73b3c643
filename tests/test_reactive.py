"""Water with inertia: against Lagrange's equations, potential theory and Lighthill's, and in every method."""

from functools import cache

import numpy as np
import pytest
from naive.reactive import added_mass, reactive_force, water_energy

from fish_env import make_fish, make_water
from fish_env.physics.body import fix
from fish_env.physics.elements import make_sections
from fish_env.physics.forces.evaluate import Evaluator

WATER = make_water(drag_coefficient=0.0, current=(0.1, -0.2, 0.05), inertia=True, added_mass=(0.9, 0.7), righting=0.0)
BODIES = ("mass_spring", "planar", "two_layer", "tetrahedral")
each_body = pytest.mark.parametrize("name", BODIES)


@cache
def trout(name="mass_spring", **options):
    """A fish with a trout's outline."""
    return make_fish(name, outline="trout", **options)


def shaken(body, seed=0, displacement=0.004, speed=0.3):
    """A body in motion: positions and velocities (N,3), none along fixed axes."""
    rng, free = np.random.default_rng(seed), body.inverse_mass > 0
    x = body.position + displacement * rng.normal(size=body.position.shape) * free
    return x, speed * rng.normal(size=x.shape) * free


def own_force(body, world, x, v):
    """Force of the water's inertia alone, with the resistance to the acceleration that it causes, (N,3)."""
    return Evaluator(body, world, ("reactive",)).force(body.springs.rest_length, x, v)


@each_body
@pytest.mark.parametrize("fixed", [False, True])
def test_equals_lagrange(name, fixed):
    """Forces and accelerations are those of Lagrange's equations, by complex steps, also with nodes that are fixed."""
    body = trout(name).body
    body = fix(fix(body, [5, 7]), [3], "x") if fixed else body
    x, v = shaken(body)
    wanted, free = reactive_force(body, WATER, x, v), body.inverse_mass.ravel() > 0
    a, inertia = np.zeros(x.size), added_mass(body, WATER, x)
    whole = inertia + np.diag(np.repeat(body.mass, 3))
    a[free] = np.linalg.solve(whole[np.ix_(free, free)], wanted.ravel()[free])
    found = own_force(body, WATER, x, v)
    np.testing.assert_allclose(
        found, wanted - (inertia @ a).reshape(x.shape), rtol=0, atol=1e-11 * np.abs(wanted).max()
    )
    energy = Evaluator(body, WATER, ("reactive",)).energies(body.springs.rest_length, x, v)["reactive"]
    np.testing.assert_allclose(energy, water_energy(body, WATER, x, v), rtol=1e-12)


def test_derivatives():
    """Exact derivatives contain the resistance to acceleration: those of the force by differences."""
    body = trout().body
    x, v = shaken(body)
    evaluator, rest = Evaluator(body, WATER), body.springs.rest_length
    stiffness, damping = evaluator.jacobian(rest, x, v)
    way = np.random.default_rng(1).normal(size=x.shape)
    for matrix, step in ((stiffness, (1e-8 * way, 0 * way)), (damping, (0 * way, 1e-6 * way))):
        ahead, behind = (evaluator.force(rest, x + sign * step[0], v + sign * step[1]) for sign in (1, -1))
        slope = (behind - ahead).ravel() / 2 / (1e-8 if step[0].any() else 1e-6)
        np.testing.assert_allclose(matrix @ way.ravel(), slope, rtol=0, atol=1e-5 * np.abs(slope).max())


def ellipse(width=0.3, depth=0.8, count=9):
    """A straight body with equal elliptic sections of four nodes, 10 m long: mass, positions, sections."""
    place = np.linspace(0.0, 10.0, count)
    around = np.array([(0, 0.1, 0.1), (0, -0.1, 0.1), (0, -0.1, -0.1), (0, 0.1, -0.1)])
    position = (around + place[:, None, None] * (-1, 0, 0)).reshape(-1, 3)
    mass, nodes = np.full(4 * count, 2.0), np.arange(4 * count).reshape(count, 4)
    outline = place, np.full(count, width), np.full(count, depth)
    return (
        position,
        mass,
        make_sections(position, mass, list(nodes), [nodes[:, :2].ravel(), nodes[:, 2:].ravel()], outline),
    )


def test_ellipse_and_heaving_plate():
    """Added mass of an ellipse, pi rho times the square of the other half axis (Lamb 1932); of a plate the same.

    A body that heaves as a whole has the energy of that mass, and a force resists nothing but its acceleration.
    """
    density, width, depth = 1025.0, 0.3, 0.8
    position, mass, sections = ellipse(width, depth)
    body = trout().body._replace(position=position, mass=mass, inverse_mass=np.repeat(1.0 / mass[:, None], 3, axis=1),
                                 sections=sections)  # fmt: skip
    world = make_water(density, 0.0, inertia=True, righting=0.0)
    for axis, half in ((1, depth), (2, width)):
        v = np.zeros_like(position)
        v[:, axis] = 0.7
        np.testing.assert_allclose(
            2 * water_energy(body, world, position, v) / 0.49, np.pi * density * half**2 * 10, rtol=1e-10
        )
        push = np.zeros_like(v)
        push[:, axis] = (mass.sum() + np.pi * density * half**2 * 10) / mass.sum() * mass
    np.testing.assert_allclose(sections.trailing, np.pi * depth**2, rtol=1e-14)


@each_body
def test_heaving(name):
    """A fish that is pushed sideways as a whole, each section by its weight and its water's, moves as one."""
    body = trout(name).body
    world = make_water(drag_coefficient=0.0, inertia=True, righting=0.0)
    names, s = ("reactive",), body.sections
    share = np.zeros(len(body.mass))
    for k, (a, b) in enumerate(zip(s.first, s.first[1:], strict=False)):
        share[s.nodes[a:b]] = s.share[a:b] * (1000.0 * s.lateral[k] / body.mass[s.nodes[a:b]].sum())
    still, rest = np.zeros_like(body.position), body.springs.rest_length
    found = Evaluator(body, world, names).force(rest, body.position, still)
    np.testing.assert_array_equal(found, still)
    outline = 1000.0 * s.lateral.sum()
    v = still + np.array([0.0, 1.0, 0.0])
    energy = Evaluator(body, world, names).energies(rest, body.position, v)["reactive"]
    np.testing.assert_allclose(energy, 0.5 * outline, rtol=1e-12)
