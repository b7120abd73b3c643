"""The leapfrog's filter: how many stages a step takes, and what passes."""

import naive
import numpy as np
import pytest
from moving import FISH, STABILISED, THIN, advance, assert_moved, each_body, tank_of, world_of
from naive import leapfrog
from numpy.polynomial import Chebyshev

from fish_env import Tank, make_fish
from fish_env.physics.forces.plan import POLYNOMIAL
from fish_env.physics.integrators import leapfrog_chebyshev, limits
from fish_env.physics.records import FORCES
from fish_env.physics.world import VACUUM, make_water


@pytest.mark.parametrize("name", STABILISED)
@each_body
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


def test_most_stages():
    """A step too long for any number of stages allowed is taken with the most, not looked for without end."""
    body = FISH["mass_spring"].body
    stages = leapfrog_chebyshev.stages_for(body.max_stiffness_eigenvalue, body.max_damping_eigenvalue, 1e6)
    assert stages == leapfrog_chebyshev.MOST_STAGES


@pytest.mark.parametrize("stages", [2, 3, 5, 12, 60])
def test_filter(stages):
    """The filter is 1 at rest; kicks of all vibrations within its reach are positive and at most what is stable, 4."""
    midpoint, first, factor, reach = leapfrog_chebyshev.polynomial(stages)
    t = np.cosh(np.arange(stages + 1) * np.arccosh(midpoint))
    z = np.linspace(1e-6, reach, 2000)
    a, before = first / midpoint * np.ones_like(z), np.zeros_like(z)
    for s in range(1, stages):  # (37)
        pull = 2.0 * (first + midpoint * a) - factor * z * a
        a, before = (t[s] * pull - t[s - 1] * before) / t[s + 1], a
    assert abs(a[0] - 1.0) < 1e-5
    assert (z * a).min() > 0.0 and 3.9 < (z * a).max() <= 4.0 + 1e-9


def test_polynomials_of_a_plan():
    """A plan holds the Chebyshev polynomials at the filter's midpoint, as their recurrence makes them."""
    body = FISH["mass_spring"].body
    row = leapfrog_chebyshev.plan(
        body.max_stiffness_eigenvalue, body.max_damping_eigenvalue, 20 * limits.leapfrog(body)
    )
    t = row[POLYNOMIAL:]
    assert len(t) == leapfrog_chebyshev.costs(row)[0] + 1 > 10
    midpoint = leapfrog_chebyshev.polynomial(len(t) - 1)[0]
    np.testing.assert_allclose(t[:2], [1.0, midpoint], rtol=1e-15)
    np.testing.assert_allclose(t[2:], 2.0 * midpoint * t[1:-1] - t[:-2], rtol=1e-13)


def documented(stages):
    """Midpoint, first factor, factor on stiffness and reach, by the formulas below equation (37) of docs/physics.md."""
    polynomial = Chebyshev.basis(stages)
    midpoint = 1.0 + 4.0 / stages**2
    highest = 4.0 / (1.0 + 1.0 / polynomial(midpoint))
    factor = polynomial(midpoint) / (highest * polynomial.deriv()(midpoint))
    return midpoint, highest * factor, factor, (1.0 + midpoint) / factor


@pytest.mark.parametrize("stages", [2, 3, 7, 20])
def test_filter_is_the_documented_one(stages):
    """Its midpoint, its factors and its reach are those of the equations, by numpy's polynomials."""
    midpoint, first, factor, reach = leapfrog_chebyshev.polynomial(stages)
    np.testing.assert_allclose([midpoint, first, 0.5 * factor, reach], documented(stages), rtol=1e-9)


@pytest.mark.parametrize(("elastic", "viscous"), [(1e4, 0.0), (1e8, 0.0), (1e9, 30.0), (0.0, 500.0), (3e5, 2000.0)])
def test_fewest_stages_that_reach(elastic, viscous):
    """The fewest that reach 1.2 times the highest rates, two at least; no more than a thousand."""
    h = 1e-3
    wanted = 1.2 * (h * h * elastic + 2.0 * h * viscous)
    fewest = next(p for p in range(2, 100) if documented(p)[3] >= wanted)
    if fewest == 2 and 1.2 * h * viscous > 2.0:
        fewest = 3  # with two stages, the damping that is at least applied would overshoot
    assert leapfrog_chebyshev.stages_for(elastic, viscous, h) == fewest
    assert leapfrog_chebyshev.MOST_STAGES == 1000


@each_body
def test_no_push_turns_its_face_around(body):
    """Where pushes would turn faces around, a step equals the reference's, in which they stop them."""
    fish, rng, h = FISH[body], np.random.default_rng(9), FISH[body].time_step
    x, v = naive.random_state(fish, rng, displacement=0.002, speed=0.2)
    rest, world = fish.body.springs.rest_length, world_of(fish)
    world = world._replace(quadratic=300 * world.quadratic)
    middle = x + 0.5 * h * v
    free = naive.total_force(fish.body, world, rest, middle, v) - naive.total_force(fish.body, VACUUM, rest, middle, v)
    held, _ = leapfrog.water_pushes(fish.body, world, 0.5 * h, middle, v, v)
    assert np.abs(held).max() < 0.5 * np.abs(free).max()  # the limit is at work
    found = advance("leapfrog_chebyshev", fish, world, x, v, rest, np.zeros_like(rest), h, 1)
    wanted = leapfrog.leapfrog_chebyshev(fish.body, world, lambda t: rest, 0.0, h, x, v)
    assert_moved(0.0, found, wanted, *(1e-9 * np.abs(reference).max() for reference in wanted))


@pytest.mark.parametrize(("body", "density"), [("mass_spring", 16_000.0), ("planar", 16_000.0), ("two_layer", 4000.0)])
def test_light_fish_in_heavy_water(body, density):
    """Muscles that alternate at random for 1 s, with half the mass and twice the drag in water of that density.

    Without the limit on pushes some of these fish fail.
    """
    fish, count = make_fish(body), 16
    tank = Tank(fish, count, water=make_water(density), threads=1, lanes="xyz")
    for i in range(count):
        tank.vary(i, stiffness=2.0, mass=0.5, drag=2.0)
    rng = np.random.default_rng(8)
    for _ in range(50):
        tank.swim(rng.choice([-1.0, 1.0], (count, fish.num_muscles)), fish.control_interval)
    assert tank.alive.all(), tank.state.failure
    assert np.abs(tank.velocity).max() < 50 * fish.length
