"""Anchors, gravity, air and walls against their reference implementations."""

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given
from hypothesis import strategies as st
from kernels import Block, energy, force
from naive.surroundings import borne
from small_bodies import ALL, close

from fish_env import Tank, make_fish
from fish_env.physics import forces
from fish_env.physics.body import fix, make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM, make_anchors, make_world

seeds = st.integers(0, 2**32 - 1)
FIXED = fix(fix(ALL, [1, 18]), [3], "xz")


@given(seed=seeds)
def test_world_equals_its_reference(seed):
    """Anchors, gravity and air, and walls at work are those of the textbook's formulas; so are the impacts."""
    rng = np.random.default_rng(seed)
    x, v = small_bodies.shaken(ALL, rng)
    world, h = small_bodies.world_with_all(ALL, offset=0.07), 0.005
    close(force("anchors", ALL, world, x, v), naive.anchor_force(world.anchors, x, v))
    assert energy("anchors", ALL, world, x) == pytest.approx(naive.anchor_energy(world.anchors, x), rel=1e-12)
    close(force("gravity", ALL, world, x, v), ALL.mass[:, None] * world.gravity - world.viscosity * v)
    assert energy("gravity", ALL, world, x) == pytest.approx(naive.weight_energy(ALL, world, x), rel=1e-12)
    v[0, 2], f = -0.1, rng.normal(size=x.shape)
    f[0] = [0.0, 0.0, -1.0]  # onto the walls, behind which it is
    walls = Block(("contact",), FIXED, world, h=h).set(x, v)
    wanted = naive.with_reaction(world.planes, x, v, f)
    assert np.abs(wanted - f).max() > 0
    close(walls.add("add_force", f=f), wanted)
    wanted = borne(world.planes, x, v, h, f)
    assert np.abs(wanted - f).max() > 0
    close(walls.add("constrain", f=f), wanted)
    v[[1, 3, 18], 2], v[[1, 3], 0] = -0.2, 0.05  # fixed nodes keep the velocity they are given
    wanted = naive.bounce(FIXED, world, h, x, v)
    found = walls.set(x, v).velocities("finish")
    close(found, wanted)
    assert (found != v).any()
    assert (found == v)[FIXED.inverse_mass == 0.0].all()
    assert np.sum(found**2, axis=1) @ ALL.mass < np.sum(v**2, axis=1) @ ALL.mass


@given(seed=seeds)
def test_decay_in_the_air(seed):
    """Half a step in the air leaves exp(-h mu / 2m) of a velocity that is not fixed; the force left is the weight."""
    rng, h = np.random.default_rng(seed), 0.3
    x, v = small_bodies.shaken(ALL, rng)
    world = small_bodies.world_with_all(ALL)
    mass = rng.uniform(0.5, 2.0)
    block = Block(("gravity",), FIXED, world, variation=[1, mass, 1, 0, 0, 0], h=h).set(x, v)
    wanted = np.exp(-0.5 * h * world.viscosity * FIXED.inverse_mass / mass) * v
    close(block.velocities("decay"), wanted, 1e-14)
    assert (wanted == v).sum() == 8
    close(block.add("add_force_cached", "add_force"), ALL.mass[:, None] * world.gravity)
    drag = h * world.viscosity / mass
    close(block.matrix("add_system"), drag * np.eye(60))


def test_without_gravity():
    """Walls without gravity bounce everything; a world without a force compiles nothing for it."""
    world = make_world(planes=[((0, 0, 1), 0.0, 0.5)])._replace(gravity=None)
    assert forces.present(ALL, world) == ("springs", "tets", "pressure", "barriers", "contact")
    body = make_body([[0.0, 0.0, -1e-9]], [1.0], [], [], [], [], [])
    assert forces.present(body, VACUUM) == ()
    found = Block(None, body, world, h=0.1).set(body.position, np.array([[1.0, 0.0, -2.0]])).velocities("finish")
    np.testing.assert_array_equal(found, [[1.0, 0.0, 1.0]])


def test_anchor_at_its_point():
    """An anchor with a length whose node is at its very point has no direction, and pulls nowhere."""
    body = make_body(np.zeros((1, 3)), [1.0], [], [], [], [], [])
    world = VACUUM._replace(anchors=make_anchors([0], np.zeros(3), 5.0, 1.0, 0.3, [1.0, 0.0, 0.0]))
    still = np.zeros((1, 3))
    evaluator = Evaluator(body, world)
    assert not evaluator.force(np.zeros(0), still, still).any()
    assert not np.any(evaluator.jacobian(np.zeros(0), still, still))
    block = Block(None, body, world).set(still, still)
    assert not block.add("add_force_cached").any() and not block.add("add_tangent", v=still + 1.0).any()
    assert not block.set(still, still).matrix("add_system").any()


def test_bounds_of_anchors():
    """The node with the stiffest anchors sets the rates, stiffness and damping each."""
    world = small_bodies.world_with_all(ALL)
    inner, bound = forces.bounds(ALL, world)
    assert inner == forces.FORCES["barriers"].bounds(ALL, world)
    assert bound == pytest.approx(naive.leapfrog.anchor_rates(ALL, world), rel=1e-14)
    assert forces.bounds(ALL, VACUUM) == [inner]


@pytest.mark.parametrize("name", ["leapfrog_chebyshev", "linearly_implicit"])
def test_slow_and_deep_contact(name):
    """A slow node rests on a wall, no deeper than it falls in a step; one that begins behind a wall stays there."""
    h, g = 1e-3, 9.81
    body = make_body(np.array([[0.0, 0.0, 1e-9], [1.0, 0.0, 1e-3], [2.0, 0.0, -0.01]]), np.full(3, 0.1), *[[]] * 5)
    thing = ElasticObject(name="beads", body=body, length=1.0, time_step=h, control_interval=0.02)
    tank = Tank(thing, 1, name, h, water=make_world((0.0, 0.0, -g), [((0, 0, 1), 0.0, 0.5)]), threads=1)
    tank.velocity[0, 2, 2] = -0.2
    tank.advance(3000)
    slow, dropped, deep = tank.position[0, :, 2]
    assert -h * h * g * 1.001 < slow <= 0.0
    assert -h * np.sqrt(2.0 * g * 1e-3) < dropped <= 0.0
    assert deep == pytest.approx(-0.01, abs=2e-3) and np.abs(tank.velocity).max() < 1e-12


@pytest.mark.parametrize("name", ["semi_implicit", "linearly_implicit", "rosenbrock", "leapfrog_chebyshev"])
def test_anchors_of_a_heavier_body(name):
    """A body twice as heavy and as stiff, held by anchors twice as stiff and damped, has the same motion."""
    fish, found = make_fish(), []
    point = fish.body.position[[2, 9]] + [[0.01, 0.02, 0.0], [0.0, -0.02, 0.01]]
    for factor in (1.0, 2.0):
        hold = make_anchors([2, 9], point, 4.0 * factor, 0.05 * factor, [0.0, 0.01], [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
        tank = Tank(fish, integrator=name, dt=5e-4, water=VACUUM._replace(anchors=hold), threads=1)
        tank.vary(0, stiffness=factor, mass=factor)
        tank.advance(100)
        assert tank.alive[0]
        found.append(np.stack([tank.position[0], tank.velocity[0]]))
    np.testing.assert_array_equal(*found)
    assert np.abs(found[0][0] - fish.body.position).max() > 1e-3
