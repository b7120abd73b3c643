"""Every method on a body that has all kinds of elements, in a world with everything."""

from functools import cache

import moving
import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import ADAPTIVE, STABILISED, assert_moved, each_fixed, each_method, tank_of, tiered
from moving import advance as advance_body
from scipy.integrate import solve_ivp
from small_bodies import ALL, BODIES, bent

from fish_env import INTEGRATORS
from fish_env.physics.failures import TORN
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM
from fish_env.soft import adaptive
from fish_env.soft.forces import barriers
from fish_env.soft.room import make_world


def advance(name, world, x, v, rest, rate, h, n, body=ALL):
    """Motion of one body after n steps, (x, v)."""
    return advance_body(name, body, world, x, v, rest, rate, h, n)


@each_method
@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.3, 1.5]))
def test_step_equals_its_reference(name, seed, reach):
    """One step, short and long, equals the textbook's; an adaptive method's is as accurate as its tolerance."""
    rng = np.random.default_rng(seed)
    x, v = small_bodies.shaken(ALL, rng)
    world = moving.without_walls(name, small_bodies.world_with_all(ALL))
    rest = ALL.springs.rest_length * rng.uniform(0.95, 1.05, 36)
    h = reach / np.sqrt(ALL.max_stiffness_eigenvalue)
    rate = rest * rng.uniform(-0.3, 0.3, rest.size)
    if name in ADAPTIVE:
        h = min(h, 0.3 / np.sqrt(ALL.max_stiffness_eigenvalue))
    moved = advance(name, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, ALL, world, rest, rate, x, v, h, 1)
    if name in ADAPTIVE:
        allowed = 100 * adaptive.TOLERANCE * np.ptp(ALL.position, axis=0).max() * np.array([1.0, 1.0 / h])
    else:
        allowed = 1e-12 * np.abs(wanted[0] - x).max(), 1e-12 * np.abs(wanted[1]).max()
    assert_moved(x, moved, wanted, *allowed)


@each_fixed
def test_steps_at_walls_equal_their_reference(name):
    """Eight steps among walls that nodes run into and rest on equal the textbook's."""
    x, v = small_bodies.shaken(ALL, np.random.default_rng(8), speed=0.3)
    world, h = small_bodies.world_with_all(ALL, offset=0.03), 0.2 / np.sqrt(ALL.max_stiffness_eigenvalue)
    rest = ALL.springs.rest_length
    moved = advance(name, world, x, v, rest, 0 * rest, h, 8)
    wanted = naive.advance(name, ALL, world, rest, 0 * rest, x, v, h, 8)
    free = naive.advance(name, ALL, world._replace(planes=None), rest, 0 * rest, x, v, h, 8)
    assert np.abs(free[1] - wanted[1]).max() > 0.05
    assert_moved(x, moved, wanted, 1e-11 * np.abs(wanted[0] - x).max(), 1e-11 * np.abs(wanted[1]).max())


@pytest.mark.parametrize("name", tiered(moving.FIXED_STEP, STABILISED))
def test_comes_to_rest_on_a_wall(name):
    """A block dropped on the floor comes to rest there, however it is moved, and does not sink in."""
    body = small_bodies.completed(small_bodies.block(relaxation_time=1e-2))
    world = small_bodies.completed_world(make_world((0.0, 0.0, -9.8), [((0, 0, 1), -0.02, 0.5)], 0.1))
    h = 0.2 * INTEGRATORS[name].base(body)
    n = round(1.5 / h)
    x, v = advance(name, world, body.position, 0 * body.position, np.zeros(0), np.zeros(0), h, n, body)
    lowest = x[:, 2].min() + 0.02
    deepest = h * 1.0  # what a node moves in a step at 1 m/s, which it reaches in a fall of 5 cm
    assert np.abs(v).max() < 0.02 and -deepest < lowest < 1e-4
    x, v = advance(name, world, x, v, np.zeros(0), np.zeros(0), h, n, body)
    assert np.abs(v).max() < 2e-3 and x[:, 2].min() + 0.02 > lowest - 2e-5


@cache
def smooth_motion():
    """A motion to measure orders on, and its end: what barriers act, and which faces move outward, stays as it was."""
    rng = np.random.default_rng(9)
    x, v = small_bodies.shaken(ALL, rng, displacement=5e-4, speed=0.01)
    world = small_bodies.world_with_all(ALL)
    rest = ALL.springs.rest_length
    rate, duration = 0.2 * rest * rng.uniform(-1, 1, rest.size), 1.0 / np.sqrt(ALL.max_stiffness_eigenvalue)
    evaluator, seen = Evaluator(ALL, world), set()

    def slope(t, y):
        positions, velocities = y.reshape(2, -1, 3)
        f = evaluator.force(rest + t * rate, positions, velocities, t)
        through = np.einsum("fc,fck->fk", ALL.faces.share, velocities[ALL.faces.nodes]) - world.current
        areas = np.array([naive.area_vector(positions[face]) for face in ALL.faces.nodes])
        acting = tuple(k for k, _, s, _ in naive.barrier_shares(ALL.barriers, positions) if s < barriers.NEAR)
        seen.add((acting, tuple(np.sum(areas * through, axis=1) > 0)))
        return np.concatenate([velocities.ravel(), (f / ALL.mass[:, None]).ravel()])

    y = np.concatenate([x.ravel(), v.ravel()])
    end = solve_ivp(slope, (0, duration), y, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1].reshape(2, -1, 3)
    assert len(seen) == 1 and next(iter(seen))[0], "a face or a barrier changed its mind: the scene is not smooth"
    return (world, x, v, rest, rate, duration), end


@each_fixed
def test_order(name):
    """The error falls with the method's order, all kinds of elements at work in a world with everything."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = smooth_motion()
    steps = (1 if name in STABILISED else moving.FINER.get(name, 1)) * np.array([32, 64, 128])
    errors = []
    for n in steps:
        near_x, near_v = advance(name, world, x, v, rest, rate, duration / n, n)
        errors.append(np.linalg.norm(near_x - true_x) + duration * np.linalg.norm(near_v - true_v))
    order = moving.slope_of(errors, duration / steps)
    stated = 2 if name in STABILISED else INTEGRATORS[name].order  # with the two stages that it takes here
    assert abs(order - stated) <= 0.15, f"measured order {order:.3f}, errors {errors}"


@moving.each_adaptive
def test_adaptive_is_exact(name):
    """An adaptive method ends at the reference solution, to its tolerance, on this body and on one without springs."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = smooth_motion()
    near_x, near_v = advance(name, moving.without_walls(name, world), x, v, rest, rate, duration, 1)
    assert_moved(
        x, (near_x, near_v), (true_x, true_v), 5e-9 * np.linalg.norm(true_x - x), 5e-9 * np.linalg.norm(true_v)
    )
    body = BODIES["block"]
    x, v = bent("block", np.random.default_rng(7))
    none, h = np.zeros(0), 1.0 / np.sqrt(body.max_stiffness_eigenvalue)
    moved = advance(name, VACUUM, x, v, none, none, h, 1, body)
    wanted = naive.advance(name, body, VACUUM, none, none, x, v, h, 1)
    assert_moved(x, moved, wanted, 1e-7 * np.abs(wanted[0] - x).max(), 1e-7 * np.abs(wanted[1]).max())


@pytest.mark.parametrize("lanes", tiered(("xyz", 1, 4, 8, 16), ("xyz",)))
@pytest.mark.parametrize("name", tiered(INTEGRATORS, STABILISED))
def test_batch_is_one_by_one(name, lanes):
    """Bodies moved in one call end, bit for bit, where each ends alone; a failed one in their midst stands still.

    Whether they are moved one by one or side by side in lanes, at walls and among everything else.
    """
    rng, count = np.random.default_rng(10), 3 if name in ADAPTIVE else 9
    world = moving.without_walls(name, small_bodies.world_with_all(ALL, offset=0.04))
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
