"""Nodes fixed, moved and released, against dense systems and results by hand; walls, anchors and the drag spring."""

import naive
import numpy as np
import pytest
import small_bodies
from moving import ADAPTIVE, FIXED_STEP, rows, tiered, without_walls
from small_bodies import Task, bar_task

from fish_env import INTEGRATORS, Tank, make_fish, make_world
from fish_env.physics.body import fix, make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.records import World
from fish_env.physics.world import VACUUM
from fish_env.soft.conditions import PENALTY, largest_entry, make_anchors, make_penalty
from fish_env.soft.objects import make_string
from fish_env.soft.solids import make_beam
from fish_env.soft.statics import prescribed_displacement

FISH = make_fish()
STIFFNESS, DAMPING, MASS, LENGTH, STEP = 50.0, 3.0, 0.1, 0.25, 1e-3
METHODS = ("elimination", "penalty")
AXES = {"elimination": "x", "penalty": "xyz"}
plain = pytest.mark.usefixtures("kernels")
each_way = pytest.mark.parametrize("method", METHODS)


def fish_task():
    """The fish, its head fixed, the two nodes of its tail, and how far they go, (2,3) m: a twentieth of its length."""
    head = FISH.body.position[:, 0] >= np.sort(FISH.body.position[:, 0])[-5]
    return Task(fix(FISH.body, head), FISH.tail, np.tile([0.0, 0.05 * FISH.length, 0.0], (2, 1)))


each_task = pytest.mark.parametrize("make", [fish_task, bar_task])


def displaced(task, **options):
    """Displacements (N,3) m of a task, and the reactions, if the springs of its body have no tension at rest."""
    ends = task.body.position[task.body.springs.nodes]
    springs = task.body.springs._replace(rest_length=np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
    return prescribed_displacement(task.body._replace(springs=springs), task.nodes, task.displacement, **options)


def penalty_of(task):
    """Anchors without length for the nodes to be moved: the penalty of the textbook."""
    point = task.body.position[task.nodes] + task.displacement
    return make_anchors(task.nodes, point, PENALTY * largest_entry(task.body))


def thing(body, name="fixed"):
    """An object with the length and the steps of the fish."""
    return ElasticObject(name=name, body=body, length=FISH.length, time_step=FISH.time_step, control_interval=0.02)


STILL = make_world()._replace(gravity=np.zeros(3), anchors=make_anchors([], np.zeros((0, 3)), 1.0))
"""Nothing around, with the kernels of gravity and anchors, which all bars here share."""


def bar(nodes=5, method="leapfrog_chebyshev"):
    """A bar of damped springs along x that moves along x only, one metre at most."""
    position = np.zeros((nodes, 3))
    position[:, 0] = LENGTH * np.arange(nodes)
    pairs, ones = np.stack([np.arange(nodes - 1), np.arange(1, nodes)], axis=1), np.ones(nodes - 1)
    body = make_body(position, np.full(nodes, MASS), pairs, STIFFNESS * ones, DAMPING * ones, LENGTH * ones, [])
    body = fix(body, range(nodes), "yz")
    return ElasticObject(name="bar", body=body, length=1.0, time_step=STEP, control_interval=0.02, integrator=method)


def settle(tank, seconds=20.0):
    """Let the damping end all motion."""
    tank.advance(round(seconds / STEP))
    assert tank.alive.all(), tank.failure
    assert np.abs(tank.velocity).max() < 1e-10


# Elimination


def fixed_two_layers(whole):
    """The small body of all kinds of elements with two nodes fixed, and two more along some axes unless `whole`."""
    body = fix(small_bodies.two_layers(), [0, 12])
    return body if whole else fix(fix(body, [17, 5], "z"), [3], "xy")


BODIES = ("two layers", "fish", "fish in a plane")
PAIRS = [(name, what) for name in INTEGRATORS for what in BODIES]
QUICK = [pair for pair in PAIRS if (pair[1] == "two layers" and pair[0] not in ADAPTIVE) or pair in (
    ("leapfrog_chebyshev", "fish"), ("semi_implicit", "fish in a plane"), ("dop853", "fish in a plane"))]  # fmt: skip
"""Of every method one body at least; the other pairs are slow."""


@plain
@pytest.mark.parametrize(("name", "what"), rows(PAIRS, QUICK))
def test_motion_equals_the_reduced_system(name, what):
    """Steps with fixed nodes, some of them moving, are those of the dense system without them, to 1e-12."""
    rng, slanted = np.random.default_rng(1), name != "semi_implicit"
    if what == "two layers":
        free_body, body = small_bodies.two_layers(), fixed_two_layers(whole=not slanted)
        world = without_walls(name, small_bodies.world_with_all(body))
        x, v = small_bodies.shaken(body, rng)
    else:
        free_body = FISH.body
        body = fix(FISH.body, range(23), "z") if what == "fish in a plane" else fix(FISH.body, [0, 7, 20])
        body = fix(body, [3], "y") if slanted else body
        world = World(*naive.dense_water(FISH, current=(0.3, -0.2, 0.1)))
        x, v = naive.random_state(FISH, rng, speed=0.2)
    free, rest, h = body.inverse_mass > 0, body.springs.rest_length, 0.3 / np.sqrt(body.max_stiffness_eigenvalue)
    n, tolerance = (1, 1e-7) if name in ADAPTIVE else (3, 1e-12)
    tank = Tank(thing(body), 1, name, h, water=world, threads=1)
    tank.position[0], tank.velocity[0] = x, v
    tank.advance(n)
    assert tank.alive[0], tank.failure[0]
    near_x, near_v = tank.position[0], tank.velocity[0]
    far_x, far_v = naive.advance(name, body, world, rest, 0 * rest, x, v, h, n)
    np.testing.assert_array_equal(near_v[~free], v[~free])
    np.testing.assert_allclose(near_x[~free], (x + n * h * v)[~free], rtol=0, atol=1e-15 * np.ptp(body.position))
    np.testing.assert_allclose(near_x - x, far_x - x, rtol=0, atol=tolerance * np.abs(far_x - x).max())
    np.testing.assert_allclose(near_v, far_v, rtol=0, atol=tolerance * np.abs(far_v).max())
    loose_x, _ = naive.advance(name, free_body, world, rest, 0 * rest, x, v, h, n)
    assert np.abs(loose_x - far_x).max() > 1e-3 * np.abs(far_x - x).max()  # the condition makes a difference


def test_rates_of_free_degrees():
    """The highest rates of a fixed body are those of its reduced matrices, no higher than those of the free body."""
    for body in (fixed_two_layers(whole=False), fix(FISH.body, [0, 4, 5]), fix(FISH.body, range(23), "z")):
        free = body.inverse_mass.ravel() > 0
        weight = np.sqrt(body.inverse_mass.ravel()[free])
        for kind, found in (("stiffness", body.max_stiffness_eigenvalue), ("damping", body.max_damping_eigenvalue)):
            matrix = naive.stiffness_matrix(body, kind)[np.ix_(free, free)]
            assert found == pytest.approx(np.linalg.eigvalsh(matrix * np.outer(weight, weight))[-1], rel=1e-12)
    assert fix(FISH.body, [0, 4, 5]).max_stiffness_eigenvalue < FISH.body.max_stiffness_eigenvalue
    np.testing.assert_array_equal(fix(FISH.body, [5, 0]).fixed, [[0, 0], [0, 1], [0, 2], [5, 0], [5, 1], [5, 2]])
    np.testing.assert_array_equal(fix(FISH.body, np.arange(23) == 5).fixed, fix(FISH.body, [5]).fixed)
    assert not FISH.body.fixed.size


# The static problem, by both methods


def solve_dense(body, load, displacement, penalties=None):
    """Displacements (N,3) by numpy's dense solver: fixed degrees of freedom are displaced as given."""
    matrix = naive.stiffness_matrix(body)
    load = load.ravel() - matrix @ displacement.ravel()
    if penalties is not None:
        for i, point, _, stiffness, _, _ in zip(*penalties, strict=True):
            places = np.arange(3 * i, 3 * i + 3)
            matrix[places, places] += stiffness
            load[places] += stiffness * (point - body.position[i])
    free, found = body.inverse_mass.ravel() > 0, displacement.ravel().copy()
    found[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return found.reshape(displacement.shape)


@each_task
def test_static_problem(make):
    """Elimination is the reduced dense system, and the penalty the textbook's: 1e4 largest entries on the diagonal."""
    body, nodes, displacement = task = make()
    rng, still = np.random.default_rng(2), np.zeros_like(body.position)
    load, given = rng.normal(size=still.shape), still.copy()
    found, bearing = displaced(task, load=load)
    given[nodes] = displacement
    wanted = solve_dense(fix(body, np.union1d(body.fixed[:, 0], nodes)), load, given)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    np.testing.assert_array_equal(found[nodes], displacement)
    force = (naive.stiffness_matrix(body) @ wanted.ravel()).reshape(still.shape) - load
    free = np.setdiff1d(np.arange(len(body.mass)), np.union1d(body.fixed[:, 0], nodes))
    np.testing.assert_allclose(force[free], 0.0, atol=1e-9 * np.abs(force).max())
    force[free] = 0.0
    np.testing.assert_allclose(bearing, force, rtol=0, atol=1e-11 * np.abs(force).max())
    penalties, size = penalty_of(task), np.abs(displacement).max()
    np.testing.assert_allclose(penalties.stiffness, 1e4 * np.abs(naive.stiffness_matrix(body)).max(), rtol=1e-14)
    wanted, found = solve_dense(body, still, still, penalties), displaced(task, method="penalty")[0]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    assert 0 < np.abs(found[nodes] - displacement).max() < 1e-4 * size
    assert np.abs(found - displaced(task)[0]).max() < 1e-4 * size


# The penalty in motion


# Conditions of a running tank


@plain
@pytest.mark.parametrize("name", tiered(["leapfrog_chebyshev", "linearly_implicit", "dop853"], FIXED_STEP))
def test_fixed_stays_to_the_bit(name):
    """A node that is fixed during a motion stays where it is, the others move on, and a release frees it."""
    tank = Tank(FISH, 2, name, 0.002, threads=1)
    tank.velocity[:] = np.random.default_rng(1).normal(size=tank.velocity.shape) * 0.1
    tank.advance(2)
    before, clock = tank.position.copy(), tank.time.copy()
    tank.fix([3, 7])
    np.testing.assert_array_equal(tank.position, before)
    tank.advance(3)
    np.testing.assert_array_equal(tank.position[:, [3, 7]], before[:, [3, 7]])
    assert (tank.time > clock).all() and np.abs(tank.position - before)[:, 10].min() > 0
    tank.release([3, 7])
    assert not tank.fixed.any()
    free = Tank(FISH, 2, name, 0.002, threads=1)
    free.set_state(tank.get_state())
    for one in (tank, free):
        one.advance(3)
    np.testing.assert_array_equal(tank.position, free.position)


@each_way
def test_bar_by_hand(method):
    """A bar that is pulled stretches evenly, one that hangs carries its weight, one moved steadily carries nothing."""
    d, n, tolerance = 0.1, 4, 1e-9 if method == "elimination" else 1e-3
    tank, force = Tank(bar(), water=STILL), STIFFNESS / n * d
    tank.fix([0])
    tank.move([n], (d, 0, 0), AXES[method], method)
    tank.advance(1000)
    tank.fix([n], method=method)
    settle(tank)
    np.testing.assert_allclose(tank.position[0, :, 0], (LENGTH + d / n) * np.arange(5), rtol=0, atol=tolerance * d)
    found = tank.reactions()[0]
    np.testing.assert_allclose(found[[0, 4], 0], [-force, force], rtol=tolerance)
    np.testing.assert_allclose(found.sum(axis=0), 0.0, atol=1e-8 * force)
    tank = Tank(bar(), water=STILL)
    tank.move([0], (0.3, 0, 0), method=method)
    tank.advance(20_000)
    np.testing.assert_allclose(tank.velocity[0, :, 0], 0.3, rtol=1e-9)
    np.testing.assert_allclose(tank.position[0, 0, 0], 0.3 * 20.0, rtol=1e-9)
    np.testing.assert_allclose(tank.reactions(), 0.0, atol=1e-7)
    tank = Tank(bar(), water=STILL._replace(gravity=np.array([-9.81, 0.0, 0.0])))
    tank.fix([0], method=method)
    settle(tank, 40.0)
    np.testing.assert_allclose(tank.reactions().sum(axis=(0, 1)), [5 * MASS * 9.81, 0, 0], rtol=1e-8, atol=1e-12)


@plain
def test_reset_and_states():
    """Conditions stay through `reset` and `set_state`; a state replays bit for bit under the same ones."""
    tank = Tank(FISH)
    tank.move([0], (0.1, 0, 0))
    tank.advance(2)
    state = tank.get_state()
    tank.advance(2)
    first = tank.position.copy()
    tank.set_state(state)
    tank.advance(2)
    np.testing.assert_array_equal(tank.position, first)
    tank.reset()
    np.testing.assert_array_equal(tank.velocity[0, 0], [0.1, 0, 0])
    assert tank.fixed[0].all() and make_penalty(tank.fish.body, [0], np.zeros(3)).stiffness[0] > 0


@each_way
@pytest.mark.parametrize(
    "name", tiered(["leapfrog_chebyshev", "linearly_implicit", "rosenbrock"], ("leapfrog_chebyshev",))
)
def test_driven_bar(name, method):
    """Driven at its end by a cos(w t) - a, a bar ends in the harmonic motion of its equations, by complex numbers.

    The end is on its path at every step: to rounding by elimination, to 1 / PENALTY by penalty.
    """
    size, rate, tank = 0.02, 12.0, Tank(bar(method=name), water=STILL, threads=1)
    tank.move([0], lambda t: [size * (np.cos(rate * t) - 1.0), 0, 0], AXES[method], method)
    springs = np.zeros((5, 5))
    for i in range(4):
        springs[np.ix_([i, i + 1], [i, i + 1])] += [[1, -1], [-1, 1]]
    dynamic = (STIFFNESS + 1j * rate * DAMPING) * springs - rate**2 * MASS * np.eye(5)
    amplitude = np.concatenate([[size], np.linalg.solve(dynamic[1:, 1:], -size * dynamic[1:, 0])])
    tank.advance(5000)
    part, stiff = 0.05 if name == "linearly_implicit" else 2e-3, 1e-12 if method == "elimination" else 1e-3 * size
    for _ in range(3):
        tank.advance(137)
        wanted = (amplitude * np.exp(1j * rate * tank.time[0])).real - size
        found = tank.position[0, :, 0] - LENGTH * np.arange(5)
        np.testing.assert_allclose(found[0], wanted[0], rtol=0, atol=stiff)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=part * np.abs(amplitude).max())


@plain
def test_prescribed_motions_end():
    """Each node has a motion of its own; it ends with `release`, `fix` or another `move`, axis by axis."""
    tank = Tank(FISH, threads=1)
    start = tank.position.copy()
    tank.move([2, 5], lambda t: np.outer([1.0, -2.0], [0.1 * t**2, 0, 0.2 * t]), "xz")
    tank.advance(3)
    time = tank.time[0]
    displacement = (tank.position - start)[:, 2, [0, 2]]
    np.testing.assert_allclose(displacement, [[0.1 * time**2, 0.2 * time]], rtol=1e-11)
    np.testing.assert_allclose(tank.position[:, 5, 2] - start[:, 5, 2], -0.4 * time, rtol=1e-12)
    tank.fix([2], "x")
    tank.release([5])
    assert not tank.fixed[5].any() and tank.fixed[2].tolist() == [True, False, True]
    before, free = tank.position.copy(), tank.velocity[:, 5].copy()
    tank.advance(3)
    np.testing.assert_array_equal(tank.position[:, 2, 0], before[:, 2, 0])
    np.testing.assert_allclose(tank.position[:, 2, 2] - start[:, 2, 2], 0.4 * time, rtol=1e-12)
    assert np.abs(tank.velocity[:, 5] - free).max() > 0
    tank.move([2], (0, 0, 0.5), "z")
    tank.advance(3)
    np.testing.assert_array_equal(tank.velocity[:, 2, 2], 0.5)
    assert not tank._conditions.motions


# The drag spring


@plain
def test_dragged_mass():
    """Drawn from rest by a spring whose far end moves at v, a mass is at v t - (v / w) sin(w t).

    The energy of the mass and the spring is the work of the moving end: its force times its path.
    """
    mass, stiffness, v, h, n = 0.1, 10.0, 0.3, 1e-3, 400
    w, times = np.sqrt(stiffness / mass), h * np.arange(1, n + 1)
    body = make_body(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.full(2, mass), *[[]] * 5)
    tank = Tank(ElasticObject(name="beads", body=body, length=1.0, time_step=h, control_interval=0.02), 1, None, h)
    tank.grab(0, np.zeros(3), stiffness, velocity=(v, 0.0, 0.0))
    place, speed = np.zeros(n), np.zeros(n)
    for k in range(n):
        tank.advance(1)
        place[k], speed[k] = tank.position[0, 0, 0], tank.velocity[0, 0, 0]
    near = (w * h) ** 2  # the method is of second order
    np.testing.assert_allclose(place, v * times - v / w * np.sin(w * times), rtol=0, atol=near * v * times[-1])
    np.testing.assert_allclose(speed, v - v * np.cos(w * times), rtol=0, atol=near * 2 * v)
    stretch = v * times - place
    force = stiffness * np.concatenate([[0.0], stretch])
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * v * h)
    energy = 0.5 * mass * speed**2 + 0.5 * stiffness * stretch**2
    np.testing.assert_allclose(energy, work, rtol=0, atol=2 * near * energy.max())


# Walls and anchors


@plain
@pytest.mark.parametrize("name", ["leapfrog_chebyshev", "linearly_implicit"])
def test_slow_and_deep_contact(name):
    """A slow node rests on a wall, no deeper than it falls in a step; one that begins behind a wall stays there."""
    h, g = 1e-3, 9.81
    body = make_body(np.array([[0.0, 0.0, 1e-9], [1.0, 0.0, 1e-3], [2.0, 0.0, -0.01]]), np.full(3, 0.1), *[[]] * 5)
    thing = ElasticObject(name="beads", body=body, length=1.0, time_step=h, control_interval=0.02)
    tank = Tank(thing, 1, name, h, water=make_world((0.0, 0.0, -g), [((0, 0, 1), 0.0, 0.5)]), threads=1)
    tank.velocity[0, 2, 2] = -0.2
    tank.advance(400)
    slow, dropped, deep = tank.position[0, :, 2]
    assert -h * h * g * 1.001 < slow <= 0.0
    assert -h * np.sqrt(2.0 * g * 1e-3) < dropped <= 0.0
    assert deep == pytest.approx(-0.01, abs=2e-3) and np.abs(tank.velocity).max() < 1e-12


@plain
@pytest.mark.parametrize("name", ["semi_implicit", "linearly_implicit", "rosenbrock", "leapfrog_chebyshev"])
def test_anchors_of_a_heavier_body(name):
    """A body twice as heavy and as stiff, held by anchors twice as stiff and damped, has the same motion."""
    fish, found = make_fish(water="drag"), []
    point = fish.body.position[[2, 9]] + [[0.01, 0.02, 0.0], [0.0, -0.02, 0.01]]
    for factor in (1.0, 2.0):
        hold = make_anchors([2, 9], point, 4.0 * factor, 0.05 * factor, [0.0, 0.01], [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
        tank = Tank(fish, integrator=name, dt=5e-4, water=VACUUM._replace(anchors=hold), threads=1)
        tank.vary(0, stiffness=factor, mass=factor)
        tank.advance(8)
        assert tank.alive[0]
        found.append(np.stack([tank.position[0], tank.velocity[0]]))
    np.testing.assert_array_equal(*found)
    assert np.abs(found[0][0] - fish.body.position).max() > 1e-5


# Input validation


@pytest.mark.parametrize(
    ("nodes", "axes", "text"),
    [
        (range(23), "xyz", "all 23 nodes would be fixed along every axis; leave one of them free"),
        ([23], "xyz", "fixed nodes contain node 23; valid numbers are 0 to 22"),
        ([0, -1], "x", "fixed nodes contain node -1; valid"),
        ([0.5], "x", "fixed nodes have shape"),
        ([3, 3], "x", r"the nodes are \[3, 3\]; give each of them once"),
        (np.zeros(22, bool), "x", r"the mask of nodes has shape \(22,\); give \(23,\)"),
        ([0], "w", "axes are 'w'; give some of 'xyz'"),
        ([0], "", "axes are ''; give some of 'xyz'"),
        ([0], 1, "axes are 1; give some of 'xyz'"),
    ],
)
def test_fix_refuses(nodes, axes, text):
    """`fix` and `Tank.fix` refuse missing nodes, other axes, and a body without a free degree of freedom."""
    tank = Tank(FISH)
    for call in (lambda: fix(FISH.body, nodes, axes), lambda: tank.fix(nodes, axes)):
        with pytest.raises(ValueError, match=text):
            call()
    assert not tank.fixed.any()
    flat = fix(fix(FISH.body, range(23), "x"), range(23), "y")  # the last free axis counts too
    with pytest.raises(ValueError, match="all 23 nodes would be fixed along every axis"):
        fix(flat, range(23), "z")


def test_methods_refuse():
    """Methods refuse conditions that they cannot serve, with the reason; penalties need equal places and all axes."""
    slanted = fix(FISH.body, [7], "yz")
    with pytest.raises(
        ValueError, match=r"'semi_implicit' cannot move 'fixed' .*: node 7 is fixed along some axes only"
    ):
        Tank(thing(slanted), integrator="semi_implicit")
    for body in (fix(FISH.body, [7]), fix(FISH.body, range(23), "z"), fix(fix(FISH.body, range(23), "z"), [4])):
        assert Tank(thing(body), integrator="semi_implicit").alive.all()
    walls = make_world(planes=[((0, 0, 1), -1.0, 0.0)])
    for name in ADAPTIVE:
        with pytest.raises(ValueError, match=f"'{name}' cannot move .* here: .*walls; choose another integrator"):
            Tank(FISH, integrator=name, water=walls)
        assert Tank(FISH, integrator=name, water=make_world()).alive.all()
    for name, options, text in (("semi_implicit", {"axes": "x"}, "along some axes only"),
                                ("symplectic_euler", {"method": "penalty"}, "stable steps are at most"),
                                (None, {"method": "glue"}, "method is 'glue'; choose from 'elimination'"),
                                (None, {"axes": "x", "method": "penalty"}, "all axes")):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            Tank(FISH, integrator=name).fix([3], **options)
    tank = Tank(FISH, 2)
    tank.position[1] += 0.1
    with pytest.raises(ValueError, match="different places"):
        tank.fix([3], method="penalty")


@plain
def test_refused_motions():
    """A motion that does not begin at zero, leaves its axes, or has another shape is refused, also later."""
    tank = Tank(FISH, threads=1)
    for along, axes, text in ((lambda t: (1.0, 0, 0), "xyz", "begins where the nodes are"),
                              (lambda t: (0.0, 0), "xyz", "shape"), (lambda t: (np.nan, 0, 0), "xyz", "finite"),
                              ((0.1, 0.1, 0.0), "x", "not along the axes 'x' alone")):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            tank.move([3], along, axes)
        assert not tank.fixed.any()
    tank.move([3], lambda t: (t, 0.0 if t < 3.5 * tank.dt else t, 0), "x")
    with pytest.raises(ValueError, match="not along the axes 'x' alone"):
        tank.advance(10)
    np.testing.assert_allclose(tank.time, 3 * tank.dt)
    np.testing.assert_allclose(tank.position[0, 3, 0] - FISH.body.position[3, 0], 3 * tank.dt, rtol=1e-9)


PATHS = {
    "constant": ((0.1, 0.0, 0.0), lambda t: np.array([0.1 * t, 0.0, 0.0])),
    "smooth": (lambda t: np.array([0.01 * (1.0 - np.cos(12.0 * t)), 0.0, 0.0]),) * 2,
}
MOVABLE = {
    "fish": lambda: FISH,
    "reactive": lambda: make_fish(water="reactive"),
    "beam": make_beam,
    "string": make_string,
}
"""The string is held at its other end, and its pull stretches the penalty by a part of 1e-4 of its own stretch."""


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("name", tiered([n for n in INTEGRATORS if INTEGRATORS[n].kind != "explicit"], "all"))
@pytest.mark.parametrize("what", tiered(MOVABLE, ("fish",)))
def test_penalty_moves_a_node_where_the_step_ends(what, name, path):
    """With every method, a moved node is on its path at the end of every control interval, within 1e-6 of the length.

    The string pulls: 1e-4 of its stretch is left.
    """
    body = MOVABLE[what]()
    tank, (given, along), node = Tank(body, 1, name), PATHS[path], 1 if what == "string" else 0
    tank.move([node], given, method="penalty")
    start = tank.position[0, node].copy()
    for _ in range(2 if INTEGRATORS[name].kind == "adaptive" else 20):
        tank.advance(round(body.control_interval / tank.dt))
        missed = np.abs(tank.position[0, node] - start - along(tank.time[0])).max()
        pull = 1.1e-4 * np.abs(along(tank.time[0])).max() if what == "string" else 0.0
        assert tank.alive[0] and missed < 1e-6 * body.length + pull
