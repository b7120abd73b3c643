"""Nodes of a tank that are fixed, moved and released while it runs, against what can be worked out by hand."""

import numpy as np
import pytest
from moving import tiered

from fish_env import Tank, make_fish, make_world
from fish_env.bodies.objects import make_ring
from fish_env.bodies.solids import make_beam
from fish_env.physics.body import fix, make_body
from fish_env.physics.conditions import make_penalty
from fish_env.physics.fish import ElasticObject
from fish_env.physics.statics import equilibrium

STIFFNESS, DAMPING, MASS, LENGTH, STEP = 50.0, 3.0, 0.1, 0.25, 1e-3


def bar(nodes=5, method="leapfrog_chebyshev"):
    """A bar of damped springs along x that moves along x only, one metre at most."""
    position = np.zeros((nodes, 3))
    position[:, 0] = LENGTH * np.arange(nodes)
    pairs, count = np.stack([np.arange(nodes - 1), np.arange(1, nodes)], axis=1), nodes - 1
    body = make_body(position, np.full(nodes, MASS), pairs, np.full(count, STIFFNESS), np.full(count, DAMPING),
                     np.full(count, LENGTH), np.zeros((0, 4), int))  # fmt: skip
    body = fix(body, range(nodes), "yz")
    return ElasticObject(name="bar", body=body, length=1.0, time_step=STEP, control_interval=0.02, integrator=method)


def settled(tank, seconds=20.0):
    """Let the damping end all motion."""
    tank.advance(round(seconds / STEP))
    assert tank.alive.all(), tank.failure
    assert np.abs(tank.velocity).max() < 1e-10


@pytest.mark.parametrize("name", ["leapfrog_chebyshev", "linearly_implicit", "dop853"])
def test_fixed_stays_to_the_bit(name):
    """A node that is fixed in the middle of a motion stays where it is, others go on, and a release lets it go."""
    fish = make_fish()
    tank = Tank(fish, 2, name, 0.002, threads=1)
    tank.velocity[:] = np.random.default_rng(1).normal(size=tank.velocity.shape) * 0.1
    tank.advance(5)
    before, clock = tank.position.copy(), tank.time.copy()
    tank.fix([3, 7])
    np.testing.assert_array_equal(tank.position, before)
    tank.advance(10)
    np.testing.assert_array_equal(tank.position[:, [3, 7]], before[:, [3, 7]])
    assert (tank.time > clock).all() and np.abs(tank.position - before)[:, 10].min() > 0
    tank.release([3, 7])
    assert tank.fish is not None and not tank.fixed.any()
    free = Tank(fish, 2, name, 0.002, threads=1)
    free.set_state(tank.get_state())
    for one in (tank, free):
        one.advance(10)
    np.testing.assert_array_equal(tank.position, free.position)


@pytest.mark.parametrize("method", ["elimination", "penalty"])
def test_prescribed_displacement_of_a_bar(method):
    """Pulled by d at its end, a bar stretches evenly, and both ends bear k d / n, but for the penalty's error."""
    tank, d, n = Tank(bar()), 0.1, 4
    tank.fix([0])
    tank.move([n], (d, 0, 0), "x" if method == "elimination" else "xyz", method)
    tank.advance(1000)
    tank.fix([n], method=method)
    settled(tank)
    force, tolerance = STIFFNESS / n * d, 1e-9 if method == "elimination" else 1e-3
    np.testing.assert_allclose(tank.position[0, :, 0], (LENGTH + d / n) * np.arange(5), rtol=0, atol=tolerance * d)
    found = tank.reactions()[0]
    np.testing.assert_allclose(found[[0, 4], 0], [-force, force], rtol=tolerance)
    np.testing.assert_allclose(found.sum(axis=0), 0.0, atol=1e-8 * force)


def test_reactions_bear_the_weight():
    """At rest under gravity the reactions add up to the weight, by elimination and by penalty."""
    world = make_world((-9.81, 0.0, 0.0))
    for method in ("elimination", "penalty"):
        tank = Tank(bar(), water=world)
        tank.fix([0], method=method)
        settled(tank, 40.0)
        np.testing.assert_allclose(tank.reactions().sum(axis=(0, 1)), [5 * MASS * 9.81, 0, 0], rtol=1e-8, atol=1e-12)


def test_motion_at_constant_velocity():
    """Moved at one end for long, the whole bar moves at that velocity and nothing is left to bear; to rounding."""
    for method in ("elimination", "penalty"):
        tank = Tank(bar())
        tank.move([0], (0.3, 0, 0), method=method)
        tank.advance(20_000)
        np.testing.assert_allclose(tank.velocity[0, :, 0], 0.3, rtol=1e-9)
        np.testing.assert_allclose(tank.position[0, 0, 0], 0.3 * 20.0, rtol=1e-9)
        np.testing.assert_allclose(tank.reactions(), 0.0, atol=1e-7)


@pytest.mark.parametrize("bad", [
    ({"nodes": [99]}, "contain node 99"), ({"nodes": [0], "axes": "w"}, "axes"),
    ({"nodes": [0], "method": "glue"}, "method"),
    ({"nodes": [0], "axes": "x", "method": "penalty"}, "all axes"), ({"nodes": range(5)}, "leave one"),
])  # fmt: skip
def test_refused(bad):
    """What cannot be is refused, and nothing has changed."""
    tank = Tank(bar())
    before = tank.fixed
    with pytest.raises(ValueError, match=bad[1]):
        tank.fix(**bad[0])
    np.testing.assert_array_equal(tank.fixed, before)


def test_methods_that_cannot():
    """Tu's method refuses some axes, an explicit one the penalty, and says why; a tank of unlike bodies refuses too."""
    fish = make_fish()
    with pytest.raises(ValueError, match="along some axes only"):
        Tank(fish, integrator="semi_implicit").fix([3], "x")
    with pytest.raises(ValueError, match="stable steps are shorter"):
        Tank(fish, integrator="symplectic_euler").fix([3], method="penalty")
    tank = Tank(fish, 2)
    tank.position[1] += 0.1
    with pytest.raises(ValueError, match="different places"):
        tank.fix([3], method="penalty")


def test_reset_and_states():
    """Conditions stay through `reset` and `set_state`; a state replays bit for bit under the same ones."""
    tank = Tank(make_fish())
    tank.move([0], (0.1, 0, 0))
    tank.advance(5)
    state = tank.get_state()
    tank.advance(5)
    first = tank.position.copy()
    tank.set_state(state)
    tank.advance(5)
    np.testing.assert_array_equal(tank.position, first)
    tank.reset()
    np.testing.assert_array_equal(tank.velocity[0, 0], [0.1, 0, 0])
    assert tank.fixed[0].all() and make_penalty(tank.fish.body, [0], np.zeros(3)).stiffness[0] > 0


@pytest.mark.parametrize("method", ["elimination", "penalty"])
@pytest.mark.parametrize("name", tiered(["ring", "linear", "corotational", "green_lagrange"], ("ring", "linear")))
def test_held_objects_come_to_rest_where_statics_has_them(name, method):
    """A ring, and beams of every measure of strain, hang from nodes that were moved apart: by their weight."""
    if name == "ring":
        thing, held = make_ring(relaxation_time=0.05), [0, 6]
    else:
        thing = make_beam(4, strain=name, young=1e5, relaxation_time=0.05)
        held = np.flatnonzero(np.abs(np.abs(thing.body.position[:, 0]) - 0.2) < 1e-9)
    world = make_world(gravity=9.81 * thing.down)
    tank = Tank(thing, integrator="linearly_implicit", dt=1 / 240, water=world, threads=1)
    way = 0.04 * np.sign(thing.body.position[held]) * [1.0, 0.0, 0.0]
    tank.move(held, way, "xy" if name == "ring" and method == "elimination" else "xyz", method)
    tank.advance(120)
    tank.fix(held, "xy" if name == "ring" and method == "elimination" else "xyz", method)
    tank.advance(2400)
    assert tank.alive.all() and np.abs(tank.velocity).max() < 1e-6
    start = thing.body.position.copy()
    start[held] += 0.5 * way
    wanted = equilibrium(fix(thing.body, held), world, start=start)
    tolerance = 1e-6 if method == "elimination" else 1e-3
    np.testing.assert_allclose(tank.position[0], wanted, rtol=0, atol=tolerance * thing.length)
    assert np.abs(wanted - start)[:, 1 if name == "ring" else 2].max() > 1e-3
    weight = -thing.body.mass.sum() * 9.81 * thing.down
    np.testing.assert_allclose(tank.reactions()[0].sum(axis=0), weight, rtol=0, atol=1e-5 * np.abs(weight).max())


@pytest.mark.parametrize("method", ["elimination", "penalty"])
@pytest.mark.parametrize("name", ["leapfrog_chebyshev", "linearly_implicit", "rosenbrock"])
def test_driven_bar(name, method):
    """Driven at its end by a cos(w t) - a, a bar ends in the harmonic motion of its equations, by complex numbers.

    The end is on its way at every step: to rounding by elimination, but for 1 / PENALTY by penalty.
    """
    size, rate, tank = 0.02, 12.0, Tank(bar(method=name), threads=1)
    tank.move([0], lambda t: [size * (np.cos(rate * t) - 1.0), 0, 0], "x" if method == "elimination" else "xyz", method)
    springs = np.zeros((5, 5))
    for i in range(4):
        springs[np.ix_([i, i + 1], [i, i + 1])] += [[1, -1], [-1, 1]]
    dynamic = (STIFFNESS + 1j * rate * DAMPING) * springs - rate**2 * MASS * np.eye(5)
    amplitude = np.concatenate([[size], np.linalg.solve(dynamic[1:, 1:], -size * dynamic[1:, 0])])
    tank.advance(8000)
    first_order, stiff = name == "linearly_implicit", 1e-12 if method == "elimination" else 1e-3 * size
    for _ in range(5):
        tank.advance(137)
        wanted = (amplitude * np.exp(1j * rate * tank.time[0])).real - size
        moved = tank.position[0, :, 0] - LENGTH * np.arange(5)
        np.testing.assert_allclose(moved[0], wanted[0], rtol=0, atol=stiff)
        np.testing.assert_allclose(
            moved, wanted, rtol=0, atol=(0.05 if first_order else 2e-3) * np.abs(amplitude).max()
        )


def test_ways_and_muscles():
    """Muscles contract alike while a node stays by `fix`, by a velocity of zero, or by a way that leads nowhere."""
    fish, found = make_fish(), []
    for hold in (lambda tank: tank.fix([3]), lambda tank: tank.move([3], (0, 0, 0)),
                 lambda tank: tank.move([3], lambda t: (0, 0, 0))):  # fmt: skip
        tank = Tank(fish, 2, threads=1)
        hold(tank)
        for k in range(4):
            tank.swim(np.sin(np.arange(fish.num_muscles) + k), fish.control_interval)
        found.append([tank.position.copy(), tank.rest_length.copy()])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_allclose(one, two, rtol=0, atol=1e-12)


def test_ways_end_and_are_shared():
    """Each node has a way of its own; a way ends with `release`, `fix` or another `move`, axis by axis."""
    tank = Tank(make_fish(), 2, threads=1)
    start = tank.position.copy()
    tank.move([2, 5], lambda t: np.outer([1.0, -2.0], [0.1 * t**2, 0, 0.2 * t]), "xz")
    tank.advance(10)
    time = tank.time[0]
    moved = (tank.position - start)[:, 2, [0, 2]]
    np.testing.assert_allclose(moved, [[0.1 * time**2, 0.2 * time]] * 2, rtol=1e-12)
    np.testing.assert_allclose(tank.position[:, 5, 2] - start[:, 5, 2], -0.4 * time, rtol=1e-12)
    tank.fix([2], "x")
    tank.release([5])
    assert not tank.fixed[5].any() and tank.fixed[2].tolist() == [True, False, True]
    before, free = tank.position.copy(), tank.velocity[:, 5].copy()
    tank.advance(10)
    np.testing.assert_array_equal(tank.position[:, 2, 0], before[:, 2, 0])
    np.testing.assert_allclose(tank.position[:, 2, 2] - start[:, 2, 2], 0.4 * time, rtol=1e-12)
    assert np.abs(tank.velocity[:, 5] - free).max() > 0
    tank.move([2], (0, 0, 0.5), "z")
    tank.advance(10)
    np.testing.assert_array_equal(tank.velocity[:, 2, 2], 0.5)
    assert not tank._conditions.motions


def test_refused_ways():
    """A way that does not begin at zero, leaves its axes, or has another shape is refused, also later."""
    tank = Tank(make_fish(), threads=1)
    for along, axes, says in ((lambda t: (1.0, 0, 0), "xyz", "begins where the nodes are"),
                              (lambda t: (0.0, 0), "xyz", "shape"),
                              (lambda t: (np.nan, 0, 0), "xyz", "finite")):  # fmt: skip
        with pytest.raises(ValueError, match=says):
            tank.move([3], along, axes)
        assert not tank.fixed.any()
    with pytest.raises(ValueError, match="not along the axes 'x' alone"):
        tank.move([3], (0.1, 0.1, 0.0), "x")
    tank.move([3], lambda t: (t, 0.0 if t < 3.5 * tank.dt else t, 0), "x")
    with pytest.raises(ValueError, match="not along the axes 'x' alone"):
        tank.advance(10)
    np.testing.assert_allclose(tank.time, 3 * tank.dt)
    np.testing.assert_allclose(tank.position[0, 3, 0] - tank.fish.body.position[3, 0], 3 * tank.dt, rtol=1e-9)
