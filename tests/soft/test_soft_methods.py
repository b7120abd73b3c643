"""Methods on a body with all kinds of elements in a world with everything; adaptive ones; constant matrices."""

from itertools import product

import naive
import numpy as np
import pytest
import scipy.integrate
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import (
    ADAPTIVE,
    FISH,
    FIXED_STEP,
    STABILISED,
    advance,
    assert_moved,
    every_fixed,
    every_method,
    rows,
    run_into_failure,
    scene,
    tank_of,
    tiered,
    without_walls,
)  # fmt: skip
from scipy.integrate import solve_ivp
from small_bodies import ALL, BODIES, bent, block, control, start

from benchmarks.common.beam import loose
from fish_env import INTEGRATORS, Tank, make_fish, make_water, make_world
from fish_env.physics import forces
from fish_env.physics.body import fix, make_body
from fish_env.physics.failures import FAILURES, NO_CONVERGENCE, TORN, UNTRUSTED_SOLVE
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import FORCES
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM
from fish_env.soft import adaptive
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import grid, lumped_mass
from fish_env.soft.objects import SOLIDS, make_ring, make_sphere, make_string, make_uniform_sphere

DEFAULT, STILL = FISH["mass_spring"], np.zeros((23, 3))
plain = pytest.mark.usefixtures("kernels")


# Own steps


THINGS = {
    "string": make_string(9), "ring": make_ring(), "ring of 40": make_ring(40), "sphere": make_sphere(),
    "uniform sphere": make_uniform_sphere(1), "finer sphere": make_uniform_sphere(2),
    **{name: record.make() for name, record in SOLIDS.items()},
    **{f"{body}, {water}": make_fish(body, water=water)
       for body in ("mass_spring", "planar", "two_layer", "tetrahedral") for water in ("drag", "reactive")},
}  # fmt: skip
GIVEN_STEP = [name for name in FIXED_STEP if INTEGRATORS[name].kind in ("explicit", "semi-implicit")]
UNHURRIED = [("ring", "explicit_euler"), ("ring of 40", "explicit_euler"), ("sphere", "explicit_euler")]
"""Where what grows at 2.5 times the own step grows too slowly to be seen in the steps of the test."""
FEW = [("string", "rk4"), ("uniform sphere", "rk4")]
"""Where a control interval has two or three steps, and one fewer would be too few."""


@pytest.mark.filterwarnings("ignore:.*will fail")
@pytest.mark.parametrize("name", tiered(GIVEN_STEP, ("semi_implicit",)))
@pytest.mark.parametrize("what", tiered(THINGS, ("ring", "finer sphere")))
def test_own_step_is_stable_and_near_the_limit(what, name):
    """A small disturbance of any body fades in 10,000 own steps of any method, and grows in steps 2.5 times as long."""
    thing, energy = THINGS[what], []
    for factor in (1.0, 2.5):
        tank = Tank(thing, 1, name, factor * own_step(thing, INTEGRATORS[name]))
        v = 1e-6 * np.random.default_rng(0).normal(size=tank.velocity[0].shape) * (thing.body.inverse_mass > 0)
        tank.velocity[0] = v
        tank.advance(10_000)
        moving = thing.body.mass @ (tank.velocity[0] ** 2).sum(axis=1) / (thing.body.mass @ (v**2).sum(axis=1))
        energy.append(moving if tank.alive[0] else np.inf)
    assert energy[0] < 1.0
    assert energy[1] > 1.0 or (what, name) in UNHURRIED + FEW


@pytest.mark.parametrize("name", ["explicit_euler", "midpoint"])
def test_unknown_own_step(name):
    """Where undamped motion grows, a method has no step of its own on a large body of springs; it takes a given one."""
    with pytest.raises(ValueError, match=f"'{name}' has no known stable step on 'uniform sphere': it has too many"):
        Tank(make_uniform_sphere(3), 1, name)
    assert Tank(make_uniform_sphere(3), 1, name, 1e-5).dt == 1e-5


# Every method on a body with all kinds of elements


@plain
@every_method
@settings(max_examples=2)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.3, 1.5]))
def test_step_equals_its_reference(name, seed, reach):
    """One step, short and long, equals the textbook's; an adaptive method's is as accurate as its tolerance.

    The adaptive ones move a smaller body; `test_adaptive_with_all_elements` takes long.
    """
    rng, body = np.random.default_rng(seed), BODIES["compartment"] if name in ADAPTIVE else ALL
    x, v = small_bodies.shaken(body, rng, squeezed=body is ALL)
    world = without_walls(name, small_bodies.world_with_all(body))
    rest = body.springs.rest_length * rng.uniform(0.95, 1.05, body.springs.rest_length.size)
    h = (0.3 if name in ADAPTIVE else reach) / np.sqrt(body.max_stiffness_eigenvalue)
    rate = rest * rng.uniform(-0.3, 0.3, rest.size)
    moved = advance(name, body, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, body, world, rest, rate, x, v, h, 1)
    if name in ADAPTIVE:
        allowed = 100 * adaptive.TOLERANCE * np.ptp(body.position, axis=0).max() * np.array([1.0, 1.0 / h])
    else:
        allowed = 1e-12 * np.abs(wanted[0] - x).max(), 1e-12 * np.abs(wanted[1]).max()
    assert_moved(x, moved, wanted, *allowed)


@plain
@every_fixed
def test_steps_at_walls_equal_their_reference(name):
    """Four steps among walls that nodes run into and rest on equal the textbook's."""
    x, v = small_bodies.shaken(ALL, np.random.default_rng(8), speed=0.3)
    world, h = small_bodies.world_with_all(ALL, offset=0.03), 0.2 / np.sqrt(ALL.max_stiffness_eigenvalue)
    rest = ALL.springs.rest_length
    moved = advance(name, ALL, world, x, v, rest, 0 * rest, h, 4)
    wanted = naive.advance(name, ALL, world, rest, 0 * rest, x, v, h, 4)
    free = naive.advance(name, ALL, world._replace(planes=None), rest, 0 * rest, x, v, h, 4)
    assert np.abs(free[1] - wanted[1]).max() > 0.05
    assert_moved(x, moved, wanted, 1e-11 * np.abs(wanted[0] - x).max(), 1e-11 * np.abs(wanted[1]).max())


@plain
@pytest.mark.parametrize("lanes", tiered(("xyz", 1, 4, 8, 16), (8,)))
@pytest.mark.parametrize("name", tiered(INTEGRATORS, STABILISED))
def test_batch_is_one_by_one(name, lanes):
    """Bodies moved in one call end, bit for bit, where each ends alone; a failed one in their midst stands still.

    Whether they are moved one by one or side by side in lanes, at walls and among everything else.
    """
    rng, count = np.random.default_rng(10), 3 if name in ADAPTIVE else 9
    world = without_walls(name, small_bodies.world_with_all(ALL, offset=0.04))
    states = [small_bodies.shaken(ALL, rng) for _ in range(count)]
    h = 0.1 / np.sqrt(ALL.max_stiffness_eigenvalue)
    batch = tank_of(name, ALL, world, *map(np.array, zip(*states, strict=True)), h, lanes=lanes)
    batch.state.failure[1] = TORN
    batch.advance(5)
    np.testing.assert_array_equal(batch.position[1], states[1][0])
    for b in (0, *range(2, count)):
        alone = tank_of(name, ALL, world, *states[b], h)
        alone.advance(5)
        assert alone.alive[0]
        for one, many in zip(alone.state, batch.state, strict=True):
            np.testing.assert_array_equal(one[0], many[b])


# Adaptive methods

METHOD = {"dop853": "DOP853", "radau": "Radau"}


@pytest.mark.parametrize("name", tiered(ADAPTIVE))
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
@pytest.mark.parametrize("medium", tiered(["vacuum", "water", "stiff"], ("vacuum",)))
def test_adaptive_is_exact(name, body, medium):
    """An adaptive method ends at the reference solution, to its tolerance; a wider one is less exact and costs less."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = scene(body, medium)
    errors, costs = [], []
    for tolerance in (1e-10, 1e-4):
        state = start(x, v)
        adaptive.solve(FISH[body].body, world, state, control(rest, rate), duration, METHOD[name], tolerance)
        assert state.failure[0] == 0 and state.t[0] == duration
        error = np.linalg.norm(state.x[0] - true_x) + duration * np.linalg.norm(state.v[0] - true_v)
        errors.append(error / (np.linalg.norm(true_x - x) + duration * np.linalg.norm(true_v)))
        costs.append(state.counters[0, FORCES])
    assert errors[0] <= 2e-7 and 1e-7 <= errors[1] <= 0.2 and costs[1] < costs[0]


@plain
@pytest.mark.parametrize("name", ADAPTIVE)
def test_adaptive_counters(name, monkeypatch):
    """An adaptive method counts every evaluation of the forces, and the factorisations that scipy tells of."""
    evaluations, found, force = [], [], Evaluator.force

    def counted(*arguments):
        evaluations.append(arguments)
        return force(*arguments)

    def remember(*arguments, **options):
        found.append(solve_ivp(*arguments, **options))
        return found[-1]

    monkeypatch.setattr(Evaluator, "force", counted)
    monkeypatch.setattr(scipy.integrate, "solve_ivp", remember)
    body = BODIES["compartment"]
    tank = tank_of(name, body, VACUUM, *bent("compartment", np.random.default_rng(3)), 0.01)
    tank.advance(2)
    tank.advance(1)
    assert len(found) == 2 and found[0].nfev + found[1].nfev == len(evaluations) == tank.counters["force_evaluations"]
    assert tank.counters["factorisations"] == found[0].nlu + found[1].nlu
    assert (tank.counters["factorisations"] > 0) == (name == "radau") and tank.counters["solves"] == 0


@plain
@pytest.mark.parametrize("name", ADAPTIVE)
def test_adaptive_gives_up(name, monkeypatch):
    """A motion that takes more evaluations than are allowed fails as not converged, and is put back; counters stay."""
    monkeypatch.setattr(adaptive, "MOST_EVALUATIONS", 100)
    x, v = naive.random_state(DEFAULT, np.random.default_rng(13))
    tank = tank_of(name, DEFAULT, VACUUM, x, v, 1.0)
    assert run_into_failure(tank, 1) == NO_CONVERGENCE
    np.testing.assert_array_equal(tank.position[0], x)
    assert tank.state.counters[0, FORCES] == 101


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"method": "RK45"}, "unknown method 'RK45'; choose from 'DOP853', 'Radau'"),
        ({"tolerance": 1e-14}, "tolerance is 1e-14; give a number from 1e-13 to 0.01"),
        ({"tolerance": 0.1}, "tolerance is 0.1; give a number"),
        ({"tolerance": float("nan")}, "tolerance is nan; give a number"),
        ({"tolerance": "fine"}, "tolerance is 'fine'; give a number"),
        ({"duration": -1.0}, "duration is -1.0; give a finite number of seconds, zero or more"),
        ({"duration": float("inf")}, "duration is inf; give a finite number"),
    ],
    ids=str,
)
def test_adaptive_refuses(arguments, text):
    """A method, tolerance or duration that is not allowed is refused before anything moves."""
    state, rest = start(DEFAULT.body.position, STILL), control(DEFAULT.body.springs.rest_length)
    with pytest.raises(ValueError, match=text):
        adaptive.solve(DEFAULT.body, VACUUM, state, rest, **{"duration": 0.1, **arguments})
    np.testing.assert_array_equal(state.x[0], DEFAULT.body.position)


# A constant matrix is factored once, and again when what it is made of changes

STEP = 0.002  # s
AIR = make_world(gravity=(0.0, 0.0, -9.81), viscosity=1e-3)._replace(anchors=make_anchors([], np.zeros((0, 3)), 1.0))
"""Without anchors, but with the kernels of anchors, which all tests here share."""
METHODS = ("linearly_implicit", "linearly_implicit_projected", "rosenbrock")
MANY = {"count": 11}
OPTIONS = ({}, MANY, {"count": 3, "dtype": "float32"})
QUICK = (("linearly_implicit", {}), ("linearly_implicit", MANY), ("rosenbrock", {}))


def made(count=1, name="linearly_implicit", world=AIR, strain="linear", clamped=True, **options) -> Tank:
    """Blocks of eight cells, their nodes displaced at random."""
    body = block(strain, cells=2)
    body = fix(body, body.position[:, 0] == body.position[:, 0].min()) if clamped else body
    tank = Tank(loose(body, STEP), count, name, STEP, world, **({"threads": 1} | options))
    shift = np.random.default_rng(0).normal(scale=1e-3, size=tank.position[0].shape)
    tank.position[:] += shift * (body.inverse_mass > 0)
    return tank


def refactoring(tank: Tank) -> Tank:
    """The tank, told that its matrix changes with the motion: it factors one a step, as for other bodies."""
    for each in tank._engine.blocks:
        each.control.set(constant=False)
    return tank


def factored(tank: Tank, steps: int) -> list[int]:
    """How many factorisations each body was counted while it took so many steps."""
    before = tank.counters["factorisations"].copy()
    tank.advance(steps)
    return (tank.counters["factorisations"] - before).tolist()


def same(one: Tank, other: Tank, i=slice(None), k=slice(None)) -> bool:
    """Whether bodies i of a tank move as bodies k of another one, bit for bit."""
    return all(a[i].tobytes() == b[k].tobytes() for a, b in zip(one.state[:2], other.state[:2], strict=True))


@plain
@pytest.mark.parametrize(
    ("name", "options"),
    rows(product(METHODS, OPTIONS), QUICK),
    ids=str,
)
def test_same_bits_as_with_refactorisation(name, options):
    """The factors that are used again give the trajectory of a new factorisation a step, bit for bit."""
    tank, other = made(name=name, **options), refactoring(made(name=name, **options))
    for _ in range(3):
        tank.advance(3)
        other.advance(3)
    assert tank.alive.all() and np.ptp(tank.position - tank.fish.body.position) > 1e-3 and same(tank, other)
    assert tank.counters["factorisations"].sum() == min(tank.num_fish, tank.kind.width)  # those of the first block
    assert (other.counters["factorisations"] == 9).all()
    assert np.array_equal(tank.counters["solves"], other.counters["solves"])


@plain
def test_factored_again_when_it_changes():
    """Another stiffness, mass, boundary condition or penalty is a new matrix; positions and drag are none."""
    tank = made()
    assert factored(tank, 4) == [1]
    assert factored(tank, 4) == [0]
    tank.reset()
    assert factored(tank, 3) == [0]
    last = tank.position.shape[1] - 1
    for change in (
        lambda: tank.vary(0, stiffness=2.0), lambda: tank.vary(0, stiffness=2.0, mass=0.5), lambda: tank.vary(0),
        lambda: tank.fix([last], "xy"), lambda: tank.move([last], (0.0, 0.0, 0.1)), lambda: tank.release([last]),
        lambda: tank.fix([last], method="penalty"), lambda: tank.release([last]),
        lambda: tank.grab(last, (0.3, 0.0, 0.0), 5.0, 0.1, 0.0),
    ):  # fmt: skip
        change()
        assert factored(tank, 2) == [1]
    tank.grab(last, (0.0, 0.3, 0.0), 5.0, 0.1, 0.0)  # the hand has moved, the spring is the same
    assert factored(tank, 2) == [0]
    tank.grab(last, (0.0, 0.3, 0.0), 5.0, 0.1, 0.05)  # a spring with a length turns, and its stiffness with it
    assert factored(tank, 3) == [3]


@plain
@pytest.mark.parametrize("change", [{"stiffness": 3.0}, {"mass": 0.4}, {"stiffness": 0.5, "mass": 0.5}], ids=str)
def test_fish_that_differ_have_matrices_of_their_own(change):
    """In a batch of bodies some of which differ, in the first and in the second block, each moves as by itself."""
    batch = made(**MANY)
    for i in (1, 9):
        batch.vary(i, **change)
    batch.advance(3)
    batch.advance(3)
    alike, varied = refactoring(made()), refactoring(made())
    varied.vary(0, **change)
    alike.advance(6)
    varied.advance(6)
    assert all(same(batch, varied if i in (1, 9) else alike, i, 0) for i in range(11))


@plain
def test_what_is_not_constant():
    """Elements of another measure of strain, and water that is taken implicitly, are factored a step."""
    for strain in ("linear", "corotational", "green_lagrange"):
        assert forces.constant_system(block(strain), AIR) == (strain == "linear")
    mesh = grid(np.linspace(0.0, 0.2, 3), np.full(3, 0.05), np.full(3, 0.05), 2, 2)
    tets = make_tets(mesh.position, mesh.tets, 2e4, 0.3, strain="linear")
    mass = lumped_mass(mesh.position, mesh.tets, 1000.0)
    wet = loose(make_body(mesh.position, mass, [], [], [], [], mesh.faces, tets=tets), STEP)
    assert factored(Tank(wet, 1, "linearly_implicit_water", STEP, make_water(), threads=1), 3) == [3]


@plain
def test_anchors_without_length_are_constant():
    """A body on anchors without length has one matrix, and swings as it does with a new factorisation a step."""
    world = AIR._replace(anchors=make_anchors([0, 1], np.zeros((2, 3)), 40.0, 0.1, 0.0))
    tank, other = made(world=world, clamped=False), refactoring(made(world=world, clamped=False))
    assert factored(tank, 5) == [1] and factored(other, 5) == [5] and same(tank, other)


@plain
def test_a_matrix_that_cannot_be_trusted_is_not_kept():
    """A free body beside whose stiffness its mass is lost fails; afterwards it moves as if nothing had been."""
    tank, other = made(clamped=False), made(clamped=False)
    tank.vary(0, stiffness=1e9, mass=1e-9)
    tank.advance(5)
    assert tank.failure[0] == FAILURES[UNTRUSTED_SOLVE]
    tank.vary(0)
    tank.reset()
    other.reset()
    assert factored(tank, 3) == [1] and factored(other, 3) == [1] and same(tank, other)
