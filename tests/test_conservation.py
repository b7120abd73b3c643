"""What every method conserves: momenta, mirror images, and energy, which muscles put in and water takes out."""

from dataclasses import replace

import naive
import numpy as np
import pytest
from moving import ADAPTIVE, FINER, FISH, FIXED_STEP, THIN, advance, each_body, each_method, slope_of, tank_of, world_of

from fish_env import INTEGRATORS, Tank
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM


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
        return advance(name, fish, VACUUM, x, v, rest, np.zeros_like(rest), h, n)

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
def test_mirrored_commands_mirror_the_path(name, body):
    """Two beats of random commands, left and right exchanged, take the fish along the mirror image of its path."""
    fish = FISH[body]
    rng = np.random.default_rng(6)
    steps = round(4 * fish.contraction_time / fish.control_interval)
    allowed = (1e-9 if name in FIXED_STEP else 1e-7) * fish.length  # where a face turns, tolerances are all there is
    dt = own_step(fish, INTEGRATORS[name])
    tanks = [Tank(fish, 1, name, dt, water=world_of(fish, (0, 0, 0))) for _ in range(2)]
    for action in rng.uniform(-1, 1, (steps, 12)):
        tanks[0].swim(action, fish.control_interval)
        tanks[1].swim(action[naive.mirrored_muscles(fish)], fish.control_interval)
        assert all(tank.alive[0] for tank in tanks)
        image = tanks[0].position[0, fish.mirror] * [1, -1, 1]
        assert np.abs(tanks[1].position[0] - image).max() <= allowed
    assert np.abs(tanks[0].position[0] - image).max() > 1e-2 * fish.length, "it swam straight: nothing was tested"


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
        tank = tank_of(name, fish, VACUUM, fish.body.position, 0.0 * fish.body.position, h / parts, rate=rate)
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


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("count", [1, 9])
def test_work_against_a_sum_over_steps(count, moved):
    """The default method's work is the tension at the middle of each step of dt times the shortening in it."""
    fish, rng = FISH["mass_spring"], np.random.default_rng(3)
    tank, single = (Tank(fish, count, water=THIN, threads=1) for _ in range(2))
    c, (first, second) = fish.body.springs.stiffness, fish.body.springs.nodes.T
    h, wanted = tank.dt, np.zeros(count)
    held = [5, 6] if moved else []
    for each in (tank, single) if moved else ():
        each.move(held, lambda t: (0.01 * fish.length * np.sin(20.0 * t), 0.0, 0.0))
    for action in rng.uniform(-1, 1, (5, count, fish.num_muscles)):
        tank.swim(action, fish.control_interval)
        single.command(0.5 * (action + 1.0), fish.control_interval)
        rate = single.control.rate.copy()
        for _ in range(round(fish.control_interval / h)):
            x, rest = single.position.copy(), single.rest_length + 0.5 * h * rate
            middle = x + 0.5 * h * single.velocity
            single.control.rate[:] = rate
            single.advance(1)
            middle[:, held] = 0.5 * (x + single.position)[:, held]
            tension = c * (np.linalg.norm(middle[:, second] - middle[:, first], axis=2) - rest)
            wanted -= (tension * rate).sum(axis=1) * h
    assert (wanted > 0).all()
    np.testing.assert_allclose(tank.work, wanted, rtol=1e-9)
