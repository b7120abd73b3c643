"""Methods against their references, their orders, their kernels of every kind, and the filter of the leapfrog."""

import moving
import naive
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from moving import (
    ADAPTIVE,
    EXPLICIT,
    FISH,
    FIXED_STEP,
    SOLVING,
    STABILISED,
    THIN,
    advance,
    assert_moved,
    each_body,
    each_fixed,
    every_fixed,
    random_motion,
    tank_of,
    tiered,
    world_of,
)  # fmt: skip
from naive import steps
from numpy.polynomial import Chebyshev

from fish_env import INTEGRATORS, make_fish
from fish_env.bodies import BODIES
from fish_env.physics.forces.plan import POLYNOMIAL
from fish_env.physics.integrators import get_integrator, leapfrog_chebyshev, limits
from fish_env.physics.records import FORCES
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM

DEFAULT = FISH["mass_spring"]
plain = pytest.mark.usefixtures("kernels")

# References


@pytest.mark.parametrize("name", tiered(INTEGRATORS, "all"))
def test_every_method_has_a_reference(name):
    """A new entry of the table comes with a reference implementation, and its record names itself and its cost."""
    assert set(naive.STEPS) == set(INTEGRATORS) and set(moving.MATRIX) == set(moving.LINEARLY_IMPLICIT)
    record = get_integrator(name)
    assert record.name == name
    assert record.order >= 1 and record.source and record.kind in moving.KINDS
    assert (record.forces >= 1) == (name in EXPLICIT + SOLVING)
    assert (record.factorisations >= 1) == (record.solves >= 1) == (name in SOLVING)
    assert (record.method is None) == (record.advance is not None) == (name in ADAPTIVE)
    if record.kind not in ("stabilised", "adaptive"):
        row = record.method.plan(1e4, 10.0, 1e-3)
        assert record.method.costs(row) == (record.forces, record.factorisations, record.solves)


@plain
@pytest.mark.parametrize("name", tiered(INTEGRATORS, FIXED_STEP))
@pytest.mark.parametrize("medium", ["vacuum", "water"])
@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1), body=st.sampled_from(list(naive.TU)))
@example(seed=19573, body="published")  # two faces of the tail turn within the step
def test_step_equals_its_reference(name, medium, seed, body):
    """One step from a random state with moving rest lengths equals the textbook step.

    An adaptive method's is as accurate as its tolerance, which is of the fish's size, and of that times a frequency.
    """
    fish = FISH[body]
    x, v, rest, rate = random_motion(fish, np.random.default_rng(seed))
    h = 0.5 / naive.highest_frequency(fish.body)
    world, true_world = (THIN, VACUUM) if medium == "vacuum" else 2 * (world_of(fish),)
    moved = advance(name, fish, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, fish.body, true_world, rest, rate, x, v, h, 1)
    allowed = 1e-12 * np.abs(wanted[0] - x).max(), 1e-12 * np.abs(wanted[1]).max()
    if name in ADAPTIVE:
        from fish_env.soft.adaptive import TOLERANCE

        slack = 10 if medium == "vacuum" else 400  # the error estimate sees little of a face that turns within a step
        allowed = slack * TOLERANCE * fish.length * np.array([1.0, 0.5 / h])
    assert_moved(x, moved, wanted, *allowed)


def check_steps(name, body, n):
    """Check n steps in one call against n textbook steps: each takes the rest lengths of its own time."""
    fish = FISH[body]
    x, v, rest, rate = random_motion(fish, np.random.default_rng(7))
    h = 0.3 / naive.highest_frequency(fish.body)
    moved = advance(name, fish, world_of(fish), x, v, rest, 20 * rate, h, n)
    wanted = naive.advance(name, fish.body, world_of(fish), rest, 20 * rate, x, v, h, n)
    assert_moved(x, moved, wanted, 1e-11 * np.abs(wanted[0] - x).max(), 1e-11 * np.abs(wanted[1]).max())


@plain
@every_fixed
@each_body
def test_steps_equal_their_reference(name, body):
    """Some steps in one call equal those of the textbook."""
    check_steps(name, body, 3)


@each_fixed
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
def test_compiled_steps_equal_their_reference(name, body):
    """So do more of them, compiled."""
    check_steps(name, body, 8)


@each_fixed
def test_calls_add_up(name):
    """With constant controls, n steps in one call and n calls of one step are the same bits; the clock reads n h.

    In a vacuum the leapfrog makes one drift of two halves between steps, so that its last digit may differ.
    """
    x, v, rest, _ = random_motion(DEFAULT, np.random.default_rng(8))
    world, h = world_of(DEFAULT), 0.5 * own_step(DEFAULT, INTEGRATORS[name])
    once, often = (tank_of(name, DEFAULT, world, x, v, h, rest) for _ in range(2))
    once.advance(10)
    for _ in range(10):
        often.advance(1)
    slack = 1e-13 * (name in STABILISED)
    assert_moved(0.0, (once.position, once.velocity), (often.position, often.velocity),
                 slack * np.abs(x).max(), slack * np.abs(once.velocity).max())  # fmt: skip
    assert once.time[0] == pytest.approx(10 * h, rel=1e-15) and often.time[0] == pytest.approx(10 * h, rel=1e-14)


STEPS = {"vacuum": (64, 128, 256), "water": (32, 64, 128), "stiff": (24, 32, 48)}


@each_fixed
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
@pytest.mark.parametrize("medium", tiered(STEPS, ("water",)))
def test_order(name, body, medium):
    """The error falls with the method's order: in vacuum, in water, and at steps near the limit of the stiffest spring.

    The step times the highest frequency is 1/4 to 1/16 in water, half of that in vacuum, where all vibrations count,
    and in the stiff scene 2/3 to 1/3, where explicit methods end at 2: its fast vibrations are not resolved, but hardly
    excited either. The first-order methods whose error is in the damping take steps a fraction of that (`FINER`): the
    amplitude's error grows as exp(h), so that it is straight in h only where the step is short against each vibration's
    own relaxation. So does the leapfrog, whose filter holds back the damping differently above a step of six relaxation
    times: its error has two slopes of second order and a bend. With the two stages that it takes here it is of second
    order, with more of first (`test_benchmarks.py`).
    """
    steps = moving.FINER.get(name, 1) * np.array(STEPS[medium])
    (world, x, v, rest, rate, duration), (true_x, true_v) = moving.scene(body, medium)
    world, errors = world if medium == "water" else moving.vacuum_for(name), []
    for n in steps:
        near_x, near_v = advance(name, FISH[body], world, x, v, rest, rate, duration / n, n)
        errors.append(np.linalg.norm(near_x - true_x) + duration * np.linalg.norm(near_v - true_v))
    order = moving.slope_of(errors, duration / steps)
    stated = 2 if name in STABILISED else INTEGRATORS[name].order
    assert abs(order - stated) <= 0.15, f"measured order {order:.3f}, errors {errors}"


# Kernels of every kind


def moved(name, body, kind, count=3, steps=1, **options):
    """A tank of fish in water, shaken and driven, every third with a stiffness, mass and current of its own.

    Bodies that tear more easily than the default one are shaken a fifth as much, and take half the step.
    """
    calm, part = (1.0, 1.0) if body == DEFAULT.name else (0.2, 0.5)
    fish, rng = FISH.get(body) or make_fish(body), np.random.default_rng(2)
    free = fish.body.inverse_mass > 0
    x = fish.body.position + calm * 0.005 * fish.length * rng.uniform(-1, 1, (count, *free.shape)) * free
    v = calm * 0.2 * fish.length / fish.contraction_time * rng.uniform(-1, 1, x.shape) * free
    natural = fish.body.springs.rest_length
    rest = natural * rng.uniform(1 - 0.03 * calm, 1 + 0.03 * calm, (count, len(natural)))
    rate = 0.1 * rest * rng.uniform(-1, 1, rest.shape) / fish.contraction_time
    h = part * naive.SHORTER.get(name, 1) * own_step(fish, INTEGRATORS["symplectic_euler"])
    tank = tank_of(name, fish, world_of(fish), x, v, h, rest, rate, lanes=kind, **options)
    for i in range(0, count, 3):
        tank.vary(i, stiffness=1.1, mass=0.9, drag=1.2, current=(0.01, 0.02, 0.0))
    tank.advance(steps)
    assert tank.alive.all()
    return tank


def check_bits(alone, together):
    """Check that fish side by side in lanes end, bit for bit, where each ends alone."""
    for one, many in zip(alone.state, together.state, strict=True):
        np.testing.assert_array_equal(one, many)
    assert np.abs(alone.position[1] - alone.position[2]).max() > 1e-5 * alone.fish.length


def check_near(exact, near):
    """Check that fish in float32 move as in float64, to that precision."""
    speed, size = np.abs(exact.velocity).max(), np.abs(exact.position).max()
    np.testing.assert_allclose(near.position, exact.position, rtol=0, atol=1e-3 * speed * exact.time[0] + 1e-6 * size)
    np.testing.assert_allclose(near.velocity, exact.velocity, rtol=0, atol=2e-3 * speed)
    assert (near.velocity != exact.velocity).any()


@plain
@every_fixed
def test_lanes(name):
    """Fish in lanes move as alone with their coordinates in a register; in float32 nearly so."""
    alone = moved(name, DEFAULT.name, "xyz")
    check_bits(alone, moved(name, DEFAULT.name, 4))
    check_near(alone, moved(name, DEFAULT.name, 4, dtype="float32"))


@pytest.mark.slow
@every_fixed
@pytest.mark.parametrize("body", tiered(BODIES))
@pytest.mark.parametrize("lanes", (1, 4, 8, 16))
def test_compiled_lanes(name, body, lanes):
    """So do two full blocks of eight and two that are left over, compiled, bit for bit; in float32 nearly."""
    alone = moved(name, body, "xyz", 18, 5)
    check_bits(alone, moved(name, body, lanes, 18, 5))
    if lanes in (1, 16):
        check_near(alone, moved(name, body, lanes, 18, 5, dtype="float32"))


# The leapfrog's filter: how many stages a step takes, and what passes


@pytest.mark.parametrize("name", STABILISED)
@pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))
def test_stages_grow_with_the_step(name, body):
    """A stabilised method takes more stages at longer steps and holds where symplectic Euler has long failed.

    At 2 and 3 times the stable step of symplectic Euler: the fish, shaken in vacuum, loses its energy.
    """
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(3), displacement=0.001, speed=0.1)
    limit, stages = limits.leapfrog(fish.body), []
    rates = fish.body.max_stiffness_eigenvalue, fish.body.max_damping_eigenvalue
    for factor in (0.1, 2.0, 3.0):
        tank, n = tank_of(name, fish, THIN, x, v, factor * limit), 400
        tank.advance(n)
        stages.append(tank.state.counters[0, FORCES] / n)
        assert tank.alive[0]
        motion = naive.kinetic_energy(fish.body.mass, tank.velocity[0] - fish.body.mass @ v / fish.body.mass.sum())
        assert motion < naive.kinetic_energy(fish.body.mass, v)
        assert stages[-1] == leapfrog_chebyshev.stages_for(*rates, factor * limit)
    assert stages[0] == 2 and stages[0] < stages[1] <= stages[2]
    assert stages[1] < leapfrog_chebyshev.stages_for(*rates, 4.0 * limit)
    assert stages[2] < leapfrog_chebyshev.stages_for(*rates, 10.0 * limit)
    tank = tank_of("symplectic_euler", fish, THIN, x, v, 2.0 * limit)
    tank.advance(400)
    assert not tank.alive[0]


@pytest.mark.parametrize("stages", [2, 3, 5, 12, 60])
def test_filter(stages):
    """The filter is 1 at rest; kicks of all vibrations within its reach are positive, and 0.8 of what is stable, 4."""
    midpoint, first, factor, reach = leapfrog_chebyshev.polynomial(stages)
    t = np.cosh(np.arange(stages + 1) * np.arccosh(midpoint))
    z = np.linspace(1e-6, reach, 2000)
    a, before = first / midpoint * np.ones_like(z), np.zeros_like(z)
    for s in range(1, stages):  # (23)
        pull = 2.0 * (first + midpoint * a) - factor * z * a
        a, before = (t[s] * pull - t[s - 1] * before) / t[s + 1], a
    assert abs(a[0] - 1.0) < 1e-5
    assert (z * a).min() > 0.0 and 3.0 < (z * a).max() <= 0.8 * 4.0 + 1e-9


def test_polynomials_of_a_plan():
    """A plan holds the Chebyshev polynomials at the filter's midpoint, as their recurrence makes them."""
    body = DEFAULT.body
    row = leapfrog_chebyshev.plan(
        body.max_stiffness_eigenvalue, body.max_damping_eigenvalue, 20 * limits.leapfrog(body)
    )
    t = row[POLYNOMIAL:]
    assert len(t) == leapfrog_chebyshev.costs(row)[0] + 1 > 10
    midpoint = leapfrog_chebyshev.polynomial(len(t) - 1)[0]
    np.testing.assert_allclose(t[:2], [1.0, midpoint], rtol=1e-15)
    np.testing.assert_allclose(t[2:], 2.0 * midpoint * t[1:-1] - t[:-2], rtol=1e-13)


def documented(stages):
    """Midpoint, first factor, factor on stiffness and reach, by the formulas below docs/physics.md, eq. 23."""
    polynomial = Chebyshev.basis(stages)
    midpoint = 1.0 + 3.5 / stages**2
    highest = 0.8 * 4.0 / (1.0 + 1.0 / polynomial(midpoint))
    factor = polynomial(midpoint) / (highest * polynomial.deriv()(midpoint))
    return midpoint, highest * factor, factor, (1.0 + midpoint) / factor


@pytest.mark.parametrize("stages", [2, 3, 7, 20])
def test_filter_is_the_documented_one(stages):
    """Its midpoint, its factors and its reach are those of the equations, by numpy's polynomials."""
    midpoint, first, factor, reach = leapfrog_chebyshev.polynomial(stages)
    np.testing.assert_allclose([midpoint, first, 0.5 * factor, reach], documented(stages), rtol=1e-9)


@pytest.mark.parametrize(("elastic", "viscous"), [(1e4, 0.0), (1e8, 0.0), (1e9, 30.0), (0.0, 500.0), (3e5, 2000.0)])
def test_fewest_stages_that_reach(elastic, viscous):
    """The fewest that reach 1.1 times the highest rates, two at least; no more than a thousand."""
    h = 1e-3
    wanted = 1.1 * (h * h * elastic + 2.0 * h * viscous)
    fewest = next(p for p in range(2, 100) if documented(p)[3] >= wanted)
    if fewest == 2 and 1.1 * h * viscous > 2.0:
        fewest = 3  # with two stages, the damping that is at least applied would overshoot
    assert leapfrog_chebyshev.stages_for(elastic, viscous, h) == fewest
    assert leapfrog_chebyshev.stages_for(elastic, viscous, 1e6) == leapfrog_chebyshev.MOST_STAGES == 1000


@plain
@each_body
def test_no_push_turns_its_face_around(body):
    """Where pushes would turn faces around, a step equals the reference's, in which they stop them."""
    fish, rng, h = FISH[body], np.random.default_rng(9), FISH[body].time_step
    x, v = naive.random_state(fish, rng, displacement=0.002, speed=0.2)
    rest, world = fish.body.springs.rest_length, world_of(fish)
    world = world._replace(quadratic=300 * world.quadratic)
    middle = x + 0.5 * h * v
    free = naive.total_force(fish.body, world, rest, middle, v) - naive.total_force(fish.body, VACUUM, rest, middle, v)
    held, _ = steps.water_pushes(fish.body, world, 0.5 * h, middle, v, v)
    assert np.abs(held).max() < 0.5 * np.abs(free).max()  # the limit is at work
    found = advance("leapfrog_chebyshev", fish, world, x, v, rest, np.zeros_like(rest), h, 1)
    wanted = steps.leapfrog_chebyshev(fish.body, world, lambda t: rest, 0.0, h, x, v)
    assert_moved(0.0, found, wanted, *(1e-9 * np.abs(reference).max() for reference in wanted))
