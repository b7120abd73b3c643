"""What every method conserves: momenta, mirror images, and energy, which in water only falls."""

import naive
import numpy as np
from moving import ADAPTIVE, FINER, FISH, FIXED_STEP, advance, each_body, each_method, slope_of, tank_of, world_of

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
