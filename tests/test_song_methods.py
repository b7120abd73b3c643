"""A closed room, Song's methods through impacts, a moving hand, level of detail, parameters."""

import numpy as np
import pytest
from moving import tiered

from benchmarks.objects.methods import largest_surviving
from benchmarks.objects.scenes import DRAG_SPRING, FRAME
from benchmarks.objects.survey import survives
from fish_env import INTEGRATORS, Tank
from fish_env.physics.body import make_body
from fish_env.physics.fish import ElasticObject
from fish_env.soft.detail import LevelOfDetail, carry_over, facet_gap, projected_size
from fish_env.soft.objects import FINEST, OBJECTS, make_ring, room

SIZE = 0.3  # m from the middle of the closed room to every wall
FIXED_STEP = [name for name, method in INTEGRATORS.items() if method.kind != "adaptive"]


def thrown(thing, name, seed, dt=None, seconds=0.3):
    """A throw in a closed room: the failure, how far a node was behind a wall, and how far one moved in a step, m."""
    tank = Tank(thing, integrator=name, dt=dt, water=room(thing.down, SIZE, 0.5, closed=True), threads=1)
    tank.velocity[0] = 2.0 * np.random.default_rng(seed).normal(size=3) * (thing.body.inverse_mass > 0)
    depth = travel = 0.0
    while tank.alive[0] and tank.time[0] < seconds:
        before = tank.position[0].copy()
        tank.advance(1)
        depth = max(depth, float((np.abs(tank.position[0]) - SIZE).max()))
        travel = max(travel, float(np.linalg.norm(tank.position[0] - before, axis=1).max()))
    return tank.failure[0], depth, travel


def test_room():
    """An open room has a floor and two walls; a closed one six walls, all the same distance from the origin."""
    assert len(room((0.0, -1.0, 0.0), 0.3).planes) == 3
    planes = room((0.0, -1.0, 0.0), 0.3, closed=True).planes
    wanted = np.concatenate([np.eye(3), -np.eye(3)])
    assert sorted(planes.tolist()) == sorted([*normal, -0.3, 0.5] for normal in wanted.tolist())


@pytest.mark.parametrize("name", tiered(FIXED_STEP, ("rk4", "leapfrog_chebyshev")))
def test_nothing_leaves_a_closed_room(name):
    """A thrown ring is never further behind a wall than its nodes move in two steps, with any method."""
    for seed in (0, 1):
        failure, depth, travel = thrown(make_ring(), name, seed, 1e-4 if name == "explicit_euler" else None)
        assert not failure and 0.0 < depth < 2.0 * travel


@pytest.mark.parametrize("name", tiered(["string", "uniform sphere"], ["uniform sphere"]))
def test_no_other_object_leaves_either(name):
    """Nor is any other object, with the default method, further behind than its nodes move in one step."""
    failure, depth, travel = thrown(OBJECTS[name].make(), "leapfrog_chebyshev", 3)
    assert not failure and 0.0 < depth < travel


@pytest.mark.slow
@pytest.mark.parametrize("name", ["explicit_euler", "midpoint", "rk4", "leapfrog_chebyshev"])
def test_a_ball_in_a_closed_room(name):
    """A free node is reflected without loss along all axes: its speeds stay, its place is the unfolded line's."""
    body = make_body(np.zeros((1, 3)), [1.0], [], [], [], [], np.zeros((0, 4), np.int64))
    world = room((0.0, 0.0, -1.0), SIZE, 1.0, 0.0, closed=True)
    thing = ElasticObject(name="ball", body=body, length=0.1, water=world, time_step=1e-4, control_interval=1e-2)
    tank = Tank(thing, integrator=name, dt=1e-4, water=world)
    tank.velocity[0, 0] = speed = np.array([3.0, 2.0, 1.3])
    tank.advance(10000)
    np.testing.assert_allclose(np.abs(tank.velocity[0, 0]), speed, rtol=1e-12)
    line = speed * tank.time[0]
    unfolded = np.abs((line - SIZE) % (4 * SIZE) - 2 * SIZE) - SIZE
    bounces = np.ceil((line + SIZE) / (2 * SIZE))
    assert (np.abs(tank.position[0, 0] - unfolded) <= 2.0 * bounces * speed * 1e-4).all()


@pytest.mark.slow
def test_song_methods_through_an_impact():
    """A step with which RK4 brings the ring through all scenes is too long for explicit Euler."""
    assert survives(make_ring(), "rk4", FRAME / 8) and not survives(make_ring(), "explicit_euler", FRAME / 8)


def test_largest_step():
    """The first of three successive steps that survive, else the first of those at the end; 0 if the last fails."""
    steps = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25]
    for good, found in (({8, 2, 1, 0.5}, 2.0), ({4, 2, 1}, 4.0), ({8, 0.5, 0.25}, 0.5), ({8, 4}, 0.0)):
        assert largest_surviving(good.__contains__, steps) == found


def dragged(rate, moves, dt=1 / 1920):
    """Nodes of a ring (20,24,3) m dragged along a circle by a hand that is told `rate` times a second."""
    thing, found = make_ring(), []
    tank = Tank(thing, dt=dt, water=room(thing.down, 10.0, gravity=0.0), threads=1)
    node = tank.nearest((1.0, 0.0, 0.0), thing.outer)
    begin, each = tank.position[0, node].copy(), round(1 / (rate * dt))
    for k in range(0, 1920, each):
        here, there = (begin + 0.1 * np.array([np.sin(a), 1.0 - np.cos(a), 0.0]) for a in
                       (2 * np.pi * dt * j for j in (k, k + each)))  # fmt: skip
        tank.grab(node, here, *DRAG_SPRING, velocity=(there - here) / (each * dt) if moves else (0.0, 0.0, 0.0))
        tank.advance(each)
        if (k + each) % 96 == 0:
            found.append(tank.position[0].copy())
    assert tank.alive[0]
    return np.array(found)


def test_a_hand_that_jumps_does_not_converge():
    """A hand of evenly spaced events that has its velocity errs by a tenth when told four times as often."""
    exact = dragged(1920, True)
    off = {(rate, moves): np.linalg.norm(dragged(rate, moves) - exact, axis=2).max() / 0.2
           for rate in (20, 80) for moves in (True, False)}  # fmt: skip
    assert off[80, True] < 0.15 * off[20, True] < 0.03
    assert min(off[20, False], off[80, False]) > 0.5


def test_projected_size():
    """A metre at ten metres through a camera of 500 pixels covers 50; an octahedron's edge is 1 - sqrt(1/2) below."""
    assert projected_size(1.0, 10.0, 500.0) == 50.0
    assert facet_gap(0) == pytest.approx(1.0 - np.sqrt(0.5), rel=1e-14)
    assert facet_gap(3) / facet_gap(2) == pytest.approx(0.25, rel=0.1)


def test_level_of_detail():
    """The coarsest level whose gap is at most a pixel; the finest when none is; the next level at its own distance."""
    for level in range(FINEST):
        limit = 0.1 * facet_gap(level) * 800.0  # the gap is a pixel here
        assert LevelOfDetail().choose(limit * 1.0001, 800.0) == level
        assert LevelOfDetail().choose(limit * 0.9999, 800.0) == level + 1
    assert LevelOfDetail().choose(1e-6, 800.0) == FINEST


def test_level_of_detail_does_not_flicker():
    """Back and forth across a limit the choice stays; beyond the margin it changes."""
    chooser, limit = LevelOfDetail(), 0.1 * facet_gap(1) * 800.0
    assert {chooser.choose(limit * part, 800.0) for part in (0.99, 1.01, 0.99, 1.2, 0.99)} == {2}
    assert chooser.choose(limit * 1.26, 800.0) == 1 and chooser.level == 1
    assert chooser.choose(limit * 1.01, 800.0) == 1


def test_a_motion_is_carried_over_to_another_level():
    """Affine motion is carried over exactly, and so is what a node has that both levels have."""
    coarse, fine = (OBJECTS["uniform sphere"].make(level) for level in (1, 2))
    rng = np.random.default_rng(0)
    turn, shift = np.eye(3) + 0.3 * rng.normal(size=(3, 3)), rng.normal(size=3)
    for old, new in ((coarse, fine), (fine, coarse)):
        affine = old.body.position @ turn + shift
        np.testing.assert_allclose(carry_over(old, new, affine), new.body.position @ turn + shift, atol=1e-13)
        shaken = affine + 0.01 * rng.normal(size=affine.shape)
        found = carry_over(old, new, shaken)
        apart = np.linalg.norm(new.body.position[:, None] - old.body.position, axis=2)
        i, j = np.nonzero(apart < 1e-10)
        assert len(i) == 36  # all nodes of the coarse level
        np.testing.assert_allclose(found[i], shaken[j], atol=1e-10)
    with pytest.raises(ValueError, match="no inner layer"):
        carry_over(coarse, OBJECTS["uniform sphere"].make(2, layers=1), coarse.body.position)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: LevelOfDetail(margin=1.0), "margin is 1.0; give a number from 0 to less than 1"),
        (lambda: LevelOfDetail(radius=0.0), r"radius \(m\)"),
        (lambda: LevelOfDetail().choose(0.0, 800.0), r"distance \(m\)"),
        (lambda: LevelOfDetail().choose(1.0, float("nan")), r"focal \(pixels\)"),
        (lambda: facet_gap(9), "level is 9; give a whole number, 0 to 3"),
    ],
)
def test_refused(call, message):
    """What has no meaning is refused with what is allowed."""
    with pytest.raises(ValueError, match=message):
        call()
