"""What every method conserves: momenta, mirror images, and energy, which muscles put in and water takes out."""

from dataclasses import replace
from functools import cache

import moving
import naive
import numpy as np
import pytest
from moving import ADAPTIVE, FINER, FISH, FIXED_STEP, advance, each_method, slope_of, tank_of, tiered, world_of
from naive.forces import added_mass, reactive_force

from fish_env import INTEGRATORS, Tank, make_fish, make_water
from fish_env.control.gait import best_gait
from fish_env.physics.forces.evaluate import Evaluator

each_body = pytest.mark.parametrize("body", tiered(naive.TU, ("mass_spring",)))


@each_method
@each_body
def test_momenta(name, body):
    """In vacuum, linear momentum stays for thousands of steps; angular momentum drifts with the order of the method.

    Symplectic Euler keeps angular momentum to rounding. Tu's method pulls along the line between the nodes' new places
    while the momentum arm is the old one: a drift that halves with the step. An adaptive one's is its tolerance.
    """
    fish, adaptive = FISH[body], name in ADAPTIVE
    mass, rest = fish.body.mass, fish.body.springs.rest_length

    def moved(x, v, h, n):
        return advance(name, fish, moving.vacuum_for(name), x, v, rest, np.zeros_like(rest), h, n)

    x, v = naive.random_state(fish, np.random.default_rng(4), displacement=0.005, speed=0.3)
    n, h = 30 if adaptive else 3000, naive.SHORTER.get(name, 1) * 0.3 / naive.highest_frequency(fish.body)
    (end_x, end_v), size = moved(x, v, h, n), mass @ np.linalg.norm(v, axis=1)
    assert np.abs(naive.momentum(mass, end_v) - naive.momentum(mass, v)).max() <= 1e-13 * size
    travelled = n * h * naive.momentum(mass, v)
    np.testing.assert_allclose(naive.momentum(mass, end_x - x), travelled, rtol=0, atol=1e-12 * size * n * h)

    x, v = naive.random_state(fish, np.random.default_rng(5), displacement=0.005, speed=0.1)
    v += np.cross([0.2, -0.3, 0.25], x) / fish.contraction_time
    before, size = naive.angular_momentum(mass, x, v), mass @ np.linalg.norm(np.cross(x, v), axis=1)

    def drift(h, n):
        return np.linalg.norm(naive.angular_momentum(mass, *moved(x, v, h, n)) - before) / size

    h = 0.4 / naive.highest_frequency(fish.body) / FINER.get(name, 1)
    if adaptive or name == "symplectic_euler":
        assert drift(h, 20) <= 1e-9 if adaptive else drift(h, 3000) <= 1e-12
    else:
        drifts = [drift(h / k, 100 * k) for k in (1, 2, 4)]
        order = slope_of(drifts, h / np.array([1, 2, 4]))
        assert order >= INTEGRATORS[name].order - 0.2, f"drift falls with order {order:.3f}: {drifts}"


@each_method
@each_body
def test_energy_never_grows_in_water(name, body):
    """Left alone in still water, a shaken fish only loses energy, of motion and elastic together."""
    fish = FISH[body]
    x, v = naive.random_state(fish, np.random.default_rng(9), displacement=0.01, speed=0.5)
    rest, h, world = fish.body.springs.rest_length, 0.05 / naive.highest_frequency(fish.body), world_of(fish, (0, 0, 0))
    tank, energy = tank_of(name, fish, world, x, v, h), []
    calls = 100 if name in FIXED_STEP else 25
    for _ in range(calls):
        motion = naive.kinetic_energy(fish.body.mass, tank.velocity[0])
        energy.append(motion + naive.spring_energy(fish.body.springs, rest, tank.position[0]))
        tank.advance(4000 // calls)
    assert tank.alive[0]
    assert np.all(np.diff(energy) < 0)
    assert energy[-1] < 0.5 * energy[0]


@each_method
def test_work_is_the_energy_put_in(name):
    """In vacuum, without damping, the muscles' work is the growth of all energy, to the order of the method."""
    fish, factor = FISH["mass_spring"], 1.4
    springs = fish.body.springs._replace(damping=np.zeros_like(fish.body.springs.damping))
    fish = replace(fish, body=fish.body._replace(springs=springs, max_damping_eigenvalue=0.0))
    rate = -0.3 * springs.rest_length / fish.contraction_time * (np.arange(springs.stiffness.size) % 2)
    h = 0.1 / naive.highest_frequency(fish.body) / FINER.get(name, 1)

    def error(parts):
        """Of the work, relative to it."""
        tank = tank_of(
            name, fish, moving.vacuum_for(name), fish.body.position, 0.0 * fish.body.position, h / parts, rate=rate
        )
        tank.vary(0, stiffness=factor)
        tank.advance(40 * FINER.get(name, 1) * parts)
        stored = factor * naive.spring_energy(springs, tank.rest_length[0], tank.position[0])
        gained = stored + naive.kinetic_energy(fish.body.mass, tank.velocity[0])
        assert tank.alive[0] and gained > 0
        return abs(tank.work[0] / gained - 1.0)

    if name in ADAPTIVE:
        assert error(1) < 1e-4  # Simpson's rule over long steps
    else:
        errors = [error(parts) for parts in (1, 2, 4)]
        order = slope_of(errors, h / np.array([1, 2, 4]))
        assert order >= INTEGRATORS[name].order - 0.2, f"the error falls with order {order:.3f}: {errors}"


@pytest.mark.parametrize("length", [0.05, 0.6])
def test_friction_of_any_size_only_slows(length):
    """A fish shot along itself is slowed by the default method at its own step, also by friction of any size."""
    fish = make_fish(length=length)
    for factor in (100.0, 1e5):
        tank, energy = Tank(fish, 1, water=make_water(friction=factor), threads=1), []
        tank.velocity[:, :, 0] = 3.0 * length
        for _ in range(round(0.1 / tank.dt)):
            energy.append(fish.body.mass @ (tank.velocity[0] ** 2).sum(axis=1))
            tank.advance(1)
        assert tank.alive.all() and max(energy) == energy[0] and energy[-1] < 0.3 * energy[0]


# Where energy goes

SWIMMERS = ("mass_spring", "planar", "two_layer", "tetrahedral")
CURRENT = np.array([0.05, -0.02, 0.0])  # m/s; planar bodies are held in their plane
VARIED = {"stiffness": 0.9, "mass": 0.8, "drag": 1.3, "current": (-0.02, 0.03, 0.0)}
SECONDS = 0.5


@cache
def scene(name: str, inertia: bool):
    """A fish and water of the level that it is calibrated for, but with more friction."""
    fish = make_fish(name, water="reactive" if inertia else "drag")
    return fish, make_water(drag_coefficient=1.0, current=CURRENT, inertia=inertia, friction=4.0)


def swim(tank: Tank, seconds: float = SECONDS) -> None:
    """Swim by half of the open-loop gait, which all fish survive."""
    fish, interval = tank.fish, tank.fish.control_interval
    for k in range(round(seconds / interval)):
        contraction = 0.5 * best_gait().contraction(fish, (k + 1) * interval)
        tank.drive(np.tile(contraction, (tank.num_fish, 1)), round(interval / tank.dt))
    assert tank.alive.all(), tank.failure


def imbalance(name, inertia, parts, integrator=None):
    """Energy that a nominal and a varied fish lose beyond the flows, over their positive work, (2,); and the tank."""
    fish, water = scene(name, inertia)
    tank = Tank(fish, 2, integrator, fish.time_step / parts, water, threads=1, energy=True)
    tank.vary(1, **VARIED)
    before = sum(tank.energies().values())
    swim(tank)
    flows, after = tank.flows, sum(tank.energies().values())
    assert (flows["positive_work"] > tank.work).all() and (flows["damping"] > 0).all() and (flows["water"] > 0).all()
    lost = tank.work - flows["damping"] - flows["water"] - (after - before)
    return np.abs(lost) / flows["positive_work"], tank


CASES = [(name, inertia) for name in SWIMMERS for inertia in (True, False)]


@pytest.mark.parametrize(("name", "inertia"), moving.rows(CASES, CASES[:1]))
def test_balance_closes(name, inertia):
    """Work is what is stored, damped and left to the water: to 1 % at the default step, 0.1 % at a quarter of it."""
    assert imbalance(name, inertia, 4)[0].max() <= 1e-3
    assert imbalance(name, inertia, 1)[0].max() <= 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "parts", "allowed"), [("rk4", 8, 1e-5), ("semi_implicit", 256, 1e-3), ("rosenbrock", 8, 1e-3)]
)
def test_balance_closes_in_every_kind_of_method(method, parts, allowed):
    """The same, to their order, of methods that measure in other places; all agree on the thrust."""
    (found, tank), (_, default) = imbalance("mass_spring", True, parts, method), imbalance("mass_spring", True, 4)
    assert found.max() <= allowed
    np.testing.assert_allclose(tank.flows["thrust"], default.flows["thrust"], rtol=0.02)


@pytest.mark.usefixtures("kernels")
def test_flows_of_one_step():
    """Flows are powers of the forces at the middle of a step, at the mean of the velocities before and after it."""
    fish, water = scene("mass_spring", True)
    body, rest = fish.body, fish.body.springs.rest_length
    tank, rng = Tank(fish, 1, water=water, energy=True, refine=np.inf), np.random.default_rng(2)
    tank.position[:] += 0.0005 * rng.normal(size=tank.position.shape)
    tank.velocity[:] = [0.3, 0.0, 0.0] + 0.1 * rng.normal(size=tank.position.shape)
    tank.advance(4)  # vibrations that the filter slows die out
    x, v, before = tank.position[0].copy(), tank.velocity[0].copy(), {k: a[0] for k, a in tank.flows.items()}
    tank.advance(1)
    h, mean, a = tank.dt, 0.5 * (v + tank.velocity[0]), (tank.velocity[0] - v) / tank.dt
    x, through = x + 0.5 * h * v, mean - CURRENT

    def force(names, speed):
        return Evaluator(body, water, names).force(rest, x, speed)

    drag, moving = force(("water",), mean), reactive_force(body, water, x, mean)
    moving -= (added_mass(body, water, x) @ a.ravel()).reshape(x.shape)
    later, sooner = (
        Evaluator(body, water).energies(rest, x + sign * 1e-6 * through, mean + sign * 1e-6 * a)["reactive"]
        for sign in (1, -1)
    )
    ahead = fish.line @ x
    ahead /= np.linalg.norm(ahead)
    wanted = {
        "positive_work": 0.0,  # the muscles hold still
        "damping": -((force(("springs",), mean) - force(("springs",), 0.0 * mean)) * mean).sum(),
        "water": -((drag + moving) * through).sum() - (later - sooner) / 2e-6,
        "thrust": np.maximum((drag + moving) @ ahead, 0.0).sum() * (body.mass @ through / body.mass.sum() @ ahead),
    }
    assert wanted["water"] > 0.0 and abs(wanted["thrust"]) > 0.0
    for name, value in wanted.items():
        assert tank.flows[name][0] - before[name] == pytest.approx(h * value, rel=1e-6, abs=1e-18), name


@pytest.mark.usefixtures("kernels")
def test_measuring_changes_nothing():
    """Motion has the bits of a tank that does not measure; flows those of a single fish, whatever the lanes."""
    fish, rng, count = make_fish(), np.random.default_rng(4), 5
    actions = rng.uniform(-1, 1, (2, count, fish.num_muscles))
    options = ({"threads": 2, "energy": True}, {"threads": 1}, {"energy": True})
    tanks = [Tank(fish, many, water=fish.water, **each) for many, each in zip((count, count, 1), options, strict=True)]
    for action in actions:
        for tank in tanks:
            tank.swim(action[-tank.num_fish :], fish.control_interval)
    batch, plain, single = tanks
    assert (batch.position == plain.position).all() and (batch.work == plain.work).all()
    assert (batch.flow[-1] == single.flow[0]).all() and (batch.flow[:, :3] > 0.0).all()
    saved = batch.get_state()
    batch.reset(np.arange(count) < 2)
    assert not batch.flow[:2].any() and (batch.flow[2:] == saved["flow"][2:]).all()
    batch.set_state(saved)
    assert (batch.flow == saved["flow"]).all() and set(plain.get_state()) == set(saved) - {"flow"}


def test_refused():
    """What cannot be measured is refused, saying why."""
    for energy, integrator, text in ((1, None, "give True or False"), (True, "dop853", "does not measure energy")):
        with pytest.raises(ValueError, match=text):
            Tank(make_fish(), 1, integrator, energy=energy)
    with pytest.raises(AttributeError, match="energy=True"):
        _ = Tank(make_fish()).flows
