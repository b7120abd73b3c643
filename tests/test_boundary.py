"""Nodes fixed and moved: by elimination against the reduced dense system, and by penalty against elimination."""

from functools import cache

import naive
import numpy as np
import pytest
import small_bodies
from moving import ADAPTIVE, each_method, without_walls
from small_bodies import Task, bar_task

from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.physics.body import fix
from fish_env.physics.conditions import PENALTY, largest_entry
from fish_env.physics.fish import ElasticObject
from fish_env.physics.integrators import limits
from fish_env.physics.prescribed import prescribed_displacement
from fish_env.physics.records import World
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM, make_anchors, make_world

FISH = make_fish()


def fish_task():
    """The fish, its head fixed, the two nodes of its tail, and how far they go, (2,3) m: a twentieth of its length."""
    head = FISH.body.position[:, 0] >= np.sort(FISH.body.position[:, 0])[-5]
    return Task(fix(FISH.body, head), FISH.tail, np.tile([0.0, 0.05 * FISH.length, 0.0], (2, 1)))


each_task = pytest.mark.parametrize("make", [fish_task, bar_task])


def present_lengths(body):
    """Lengths of the springs at rest, (E,) m: taken for the rest lengths, they leave no force at rest."""
    ends = body.position[body.springs.nodes]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def displaced(task, **method):
    """Displacement (N,3) m of all nodes, and the forces on those that are moved, of a body without forces at rest."""
    body = task.body._replace(springs=task.body.springs._replace(rest_length=present_lengths(task.body)))
    return prescribed_displacement(body, task.nodes, task.displacement, **method)


def penalty(task):
    """An anchor without length for every node to be moved: the penalty of the textbook."""
    point = task.body.position[task.nodes] + task.displacement
    return make_anchors(task.nodes, point, PENALTY * largest_entry(task.body))


def thing(body, name="fixed"):
    """The body as a tank takes it, moved as the fish is."""
    return ElasticObject(name=name, body=body, length=FISH.length, time_step=FISH.time_step, control_interval=0.02)


def moved(name, body, world, x, v, h, n):
    """Motion of one body after n steps, (x, v)."""
    tank = Tank(thing(body), 1, name, h, water=world, threads=1)
    tank.position[0], tank.velocity[0] = x, v
    tank.advance(n)
    assert tank.alive[0], tank.failure[0]
    return tank.position[0], tank.velocity[0]


# Elimination


def fixed_two_layers(whole):
    """The small body of all kinds of elements with two nodes fixed, and two more along some axes unless `whole`."""
    body = fix(small_bodies.two_layers(), [0, 12])
    return body if whole else fix(fix(body, [17, 5], "z"), [3], "xy")


QUICK = {
    "leapfrog_chebyshev": "two layers", "rk4": "fish", "semi_implicit": "fish in a plane", "rosenbrock": "fish",
    "dop853": "fish in a plane",
}  # fmt: skip
"""What a representative method moves in every run; the other pairs are slow."""


@pytest.mark.parametrize(
    ("name", "what"),
    [
        pytest.param(name, what, marks=() if QUICK.get(name) == what else pytest.mark.slow)
        for name in INTEGRATORS
        for what in ("two layers", "fish", "fish in a plane")
    ],
)
def test_motion_equals_the_reduced_system(name, what):
    """Steps with fixed nodes, some of them moving, are those of the dense system without them, to 1e-12."""
    rng, slanted = np.random.default_rng(1), name != "semi_implicit"
    if what == "two layers":
        body = fixed_two_layers(whole=not slanted)
        world = without_walls(name, small_bodies.world_with_all(body))
        x, v = small_bodies.shaken(body, rng)
    else:
        body = fix(FISH.body, range(23), "z") if what == "fish in a plane" else fix(FISH.body, [0, 7, 20])
        body = fix(body, [3], "y") if slanted else body
        world = World(*naive.dense_water(FISH, current=(0.3, -0.2, 0.1)))
        x, v = naive.random_state(FISH, rng, speed=0.2)
    free, rest, h = body.inverse_mass > 0, body.springs.rest_length, 0.3 / np.sqrt(body.max_stiffness_eigenvalue)
    n = 1 if name in ADAPTIVE else 4
    near_x, near_v = moved(name, body, world, x, v, h, n)
    far_x, far_v = naive.advance(name, body, world, rest, 0 * rest, x, v, h, n)
    np.testing.assert_array_equal(near_v[~free], v[~free])
    np.testing.assert_allclose(near_x[~free], (x + n * h * v)[~free], rtol=0, atol=1e-15 * np.ptp(body.position))
    tolerance = 1e-7 if name in ADAPTIVE else 1e-12
    np.testing.assert_allclose(near_x - x, far_x - x, rtol=0, atol=tolerance * np.abs(far_x - x).max())
    np.testing.assert_allclose(near_v, far_v, rtol=0, atol=tolerance * np.abs(far_v).max())
    loose_x, _ = naive.advance(name, FISH.body if what != "two layers" else small_bodies.two_layers(), world, rest,
                               0 * rest, x, v, h, n)  # fmt: skip
    assert np.abs(loose_x - far_x).max() > 1e-3 * np.abs(far_x - x).max()  # holding makes a difference


@each_method
def test_fixed_nodes_keep_their_velocity(name):
    """A fixed node follows a given velocity, changed from call to call, along exactly its way."""
    fish, h, n = FISH, own_step(FISH, INTEGRATORS[name]), 10
    body = fix(fish.body, [0, 1])
    tank, path = Tank(thing(body), 1, name, h, threads=1), body.position[:2].copy()
    for k in range(20):
        velocity = 0.2 * fish.length * np.array([np.cos(k), np.sin(k), 0.5])
        tank.velocity[0, :2] = velocity
        tank.advance(n)
        path += n * h * velocity
    assert tank.alive[0], tank.failure[0]
    np.testing.assert_allclose(tank.position[0, :2], path, rtol=0, atol=1e-14 * fish.length)
    assert np.abs(tank.position[0] - body.position)[2:].max() > 1e-3 * fish.length  # the others come along


def test_rates_of_what_is_free():
    """The highest rates of a fixed body are those of its reduced matrices, no higher than those of the free body."""
    for body in (fixed_two_layers(whole=False), fix(FISH.body, [0, 4, 5]), fix(FISH.body, range(23), "z")):
        free = body.inverse_mass.ravel() > 0
        weight = np.sqrt(body.inverse_mass.ravel()[free])
        for kind, found in (("stiffness", body.max_stiffness_eigenvalue), ("damping", body.max_damping_eigenvalue)):
            reduced = naive.stiffness_matrix(body, kind)[np.ix_(free, free)]
            assert found == pytest.approx(np.linalg.eigvalsh(reduced * np.outer(weight, weight))[-1], rel=1e-12)
    assert fix(FISH.body, [0, 4, 5]).max_stiffness_eigenvalue < FISH.body.max_stiffness_eigenvalue
    np.testing.assert_array_equal(fix(FISH.body, [5, 0]).fixed, [[0, 0], [0, 1], [0, 2], [5, 0], [5, 1], [5, 2]])
    mask = np.arange(23) == 5
    np.testing.assert_array_equal(fix(FISH.body, mask).fixed, fix(FISH.body, [5]).fixed)
    assert not FISH.body.fixed.size


def reduced(task, load, moved, penalties=None):
    """Displacement (N,3) by numpy's dense solver: of what is free, what is fixed being where it is to be."""
    body, matrix = task, naive.stiffness_matrix(task)
    load = load.ravel() - matrix @ moved.ravel()
    if penalties is not None:
        for i, point, _, stiffness, _, _ in zip(*penalties, strict=True):
            places = np.arange(3 * i, 3 * i + 3)
            matrix[places, places] += stiffness
            load[places] += stiffness * (point - body.position[i])
    free, found = body.inverse_mass.ravel() > 0, moved.ravel().copy()
    found[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return found.reshape(moved.shape)


@each_task
def test_static_elimination(make):
    """K u = f with nodes fixed and moved, by elimination, is the reduced dense system's, to 1e-12."""
    body, nodes, displacement = task = make()
    rng = np.random.default_rng(2)
    load, move = rng.normal(size=body.position.shape), np.zeros_like(body.position)
    found, bearing = displaced(task, load=load)
    move[nodes] = displacement
    wanted = reduced(fix(body, np.union1d(body.fixed[:, 0], nodes)), load, move)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    np.testing.assert_array_equal(found[nodes], displacement)
    held = (naive.stiffness_matrix(body) @ wanted.ravel()).reshape(wanted.shape) - load
    free = np.setdiff1d(np.arange(len(body.mass)), np.union1d(body.fixed[:, 0], nodes))
    np.testing.assert_allclose(held[free], 0.0, atol=1e-9 * np.abs(held).max())
    held[free] = 0.0
    np.testing.assert_allclose(bearing, held, rtol=0, atol=1e-11 * np.abs(held).max())


# Penalty


@each_task
def test_penalty_of_the_textbook(make):
    """Ten thousand largest entries on the diagonal, and that times the displacement on the right: solved alike."""
    body, nodes, displacement = task = make()
    penalties = penalty(task)
    entry = np.abs(naive.stiffness_matrix(body)).max()
    np.testing.assert_allclose(penalties.stiffness, 1e4 * entry, rtol=1e-14)
    still = np.zeros_like(body.position)
    wanted = reduced(body, still, still, penalties)
    found = displaced(task, method="penalty")[0]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    size = np.abs(displacement).max()
    assert 0 < np.abs(found[nodes] - displacement).max() < 1e-4 * size
    assert np.abs(found - displaced(task)[0]).max() < 1e-4 * size


@each_task
def test_penalty_error(make):
    """The penalty's error falls as one over the penalty, from ten largest entries up to where rounding takes over."""
    task = make()
    truth, multiples = displaced(task)[0], 10.0 ** np.arange(1, 9)
    for which in (task.nodes, slice(None)):
        errors = [np.abs(displaced(task, method="penalty", multiple=multiple)[0] - truth)[which].max()
                  for multiple in multiples]  # fmt: skip
        slope = np.polyfit(np.log(multiples), np.log(errors), 1)[0]
        assert abs(slope + 1) <= 0.05, f"slope {slope:.4f}, errors {errors}"


@cache
def bent_fish():
    """The fish's task with the 1e4 penalty: body, anchors, and the world they make."""
    task = fish_task()
    pulling = penalty(task)
    task = task._replace(body=small_bodies.completed(task.body))
    return task, pulling, small_bodies.completed_world(VACUUM)._replace(anchors=pulling)


def test_penalty_in_time():
    """With linearly implicit Euler, nodes pulled by the 1e4 penalty follow a moving point at the fish's own step.

    They lag by what the fish pulls back over the penalty, and by what a step of the point's motion changes in its
    speed.
    """
    task, pulling, world = bent_fish()
    body, h, n = task.body, FISH.time_step, 200
    tank = Tank(thing(body), 1, "linearly_implicit", h, water=world, threads=1)
    start, worst = body.position[task.nodes], 0.0
    for k in range(n):
        phase = np.pi * (k + 1) / n
        point = start + task.displacement * 0.5 * (1 - np.cos(phase))
        tank._set_anchors(pulling._replace(point=point))
        tank.advance(1)
        worst = max(worst, np.abs(tank.position[0, task.nodes] - point).max())
    size = np.abs(task.displacement).max()
    assert tank.alive[0], tank.failure[0]
    assert worst < 1e-3 * size
    force = naive.spring_force(body.springs, body.springs.rest_length, tank.position[0], tank.velocity[0])[task.nodes]
    lag = np.abs(tank.position[0, task.nodes] - point).max()
    assert 0 < lag < 2 * np.abs(force).max() / pulling.stiffness[0] + 1e-4 * size


def test_explicit_methods_and_the_penalty():
    """The leapfrog's plan takes the anchors into account: stable at the fish's own step with the 1e4 penalty.

    It takes as many more stages as the root of what they add; symplectic Euler, at its own step, is shaken apart, and
    holds at a step a hundredth as long. The nodes are sent a four-hundredth of the fish's length: let go, they swing
    twice as far, and no unit is to tear.
    """
    task, pulling, world = bent_fish()
    body, displacement = task.body, 0.05 * task.displacement
    pulling = pulling._replace(point=body.position[task.nodes] + displacement)
    world = world._replace(anchors=pulling)
    assert FISH.integrator == "leapfrog_chebyshev"
    tank = Tank(thing(body), 1, water=world)
    free = Tank(thing(body), 1, water=small_bodies.completed_world(VACUUM))
    for part in (tank, free):
        part.advance(2000)
        assert part.alive.all()
    evaluations = [part.counters["force_evaluations"][0] / 2000 for part in (tank, free)]
    assert 20 < evaluations[0] / evaluations[1] < 200
    size = np.abs(displacement).max()
    off = np.abs(tank.position[0, task.nodes] - pulling.point).max()
    assert off <= 1.01 * size  # it may swing about its point for ever: nothing damps it, and nothing feeds it
    elastic = pulling.stiffness[0] * body.inverse_mass[task.nodes].max()
    stiffer = body._replace(max_stiffness_eigenvalue=body.max_stiffness_eigenvalue + elastic)
    longest, own = limits.leapfrog(stiffer), limits.leapfrog(body)
    assert longest < own / 20
    for h, sound in ((0.9 * longest, True), (0.9 * own, False)):
        tank = Tank(thing(body), 1, "symplectic_euler", h, water=world)
        tank.advance(2000)
        assert tank.alive.all() == sound


def test_damped_penalty_settles():
    """With a damper beside it, the penalty takes the node to its point and keeps it there, whatever the method."""
    task, pulling, world = bent_fish()
    critical = 2 * np.sqrt(pulling.stiffness * task.body.mass[task.nodes])
    world = world._replace(anchors=pulling._replace(damping=critical))
    for name in ("leapfrog_chebyshev", "linearly_implicit", "semi_implicit"):
        tank = Tank(thing(task.body), 1, name, own_step(FISH, INTEGRATORS[name]), water=world)
        tank.advance(round(20 / tank.dt))
        assert tank.alive.all()
        off = np.abs(tank.position[0, task.nodes] - pulling.point).max() / np.abs(task.displacement).max()
        assert off < 1e-3


# What is refused


@pytest.mark.parametrize(
    ("nodes", "axes", "text"),
    [
        (range(23), "xyz", "all 23 nodes would be fixed along every axis; leave one of them free"),
        ([23], "xyz", "fixed nodes contain node 23; valid numbers are 0 to 22"),
        ([0, -1], "x", "fixed nodes contain node -1; valid"),
        ([0.5], "x", "fixed nodes have shape"),
        (np.zeros(22, bool), "x", r"the mask of nodes has shape \(22,\); give \(23,\)"),
        ([0], "w", "axes are 'w'; give some of 'xyz'"),
        ([0], "", "axes are ''; give some of 'xyz'"),
        ([0], 1, "axes are 1; give some of 'xyz'"),
    ],
)
def test_fix_refuses(nodes, axes, text):
    """Nodes that are not there, axes of another name, and a body with nothing left to move are refused."""
    with pytest.raises(ValueError, match=text):
        fix(FISH.body, nodes, axes)


def test_all_held_bit_by_bit():
    """Also when the last free axis is taken from a body that was fixed along the others."""
    body = fix(fix(FISH.body, range(23), "x"), range(23), "y")
    with pytest.raises(ValueError, match="all 23 nodes would be fixed along every axis"):
        fix(body, range(23), "z")


def test_methods_refuse():
    """Tu's method refuses a node that is fixed along some axes only, naming it, and adaptive methods refuse walls."""
    with pytest.raises(
        ValueError, match="'semi_implicit' cannot move 'fixed' here: node 7 is fixed along some axes only"
    ):
        Tank(thing(fix(FISH.body, [7], "yz")), integrator="semi_implicit")
    for body in (fix(FISH.body, [7]), fix(FISH.body, range(23), "z"), fix(fix(FISH.body, range(23), "z"), [4])):
        assert Tank(thing(body), integrator="semi_implicit").alive.all()
    walls = make_world(planes=[((0, 0, 1), -1.0, 0.0)])
    for name in ADAPTIVE:
        with pytest.raises(ValueError, match=f"'{name}' cannot move .* here: .*walls; choose another integrator"):
            Tank(FISH, integrator=name, water=walls)
        assert Tank(FISH, integrator=name, water=make_world()).alive.all()


def test_anchors_are_no_springs_in_the_matrix():
    """A penalty adds to its node's own diagonal alone, and the same on all axes, wherever the node is."""
    task, pulling, world = bent_fish()
    x = task.body.position + 0.01 * FISH.length
    with_it, without = (naive.implicit_matrices(task.body, w, present_lengths(task.body), x, 0 * x)[0]
                        for w in (world, VACUUM))  # fmt: skip
    added = np.zeros_like(with_it)
    places = (3 * task.nodes[:, None] + np.arange(3)).ravel()
    added[places, places] = pulling.stiffness[0]
    np.testing.assert_allclose(with_it - without, added, rtol=0, atol=1e-10 * pulling.stiffness[0])
    assert make_anchors([1], np.zeros(3), 2.0).rest_length[0] == 0.0
