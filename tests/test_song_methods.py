"""A closed room, Song's methods through impacts, level of detail, forces of spheres, parameters."""

import numpy as np
import pytest

from benchmarks.objects import detail
from benchmarks.objects.closed import SIZE, thrown
from benchmarks.objects.hand import dragged
from benchmarks.objects.impact import costs, force_error, icosphere, longest, track
from benchmarks.objects.parameters import fall
from fish_env import INTEGRATORS, Tank
from fish_env.bodies.detail import LevelOfDetail, carried_over, facet_gap, projected_size
from fish_env.bodies.fish import ElasticObject
from fish_env.bodies.objects import FINEST, OBJECTS, make_ring, room
from fish_env.bodies.skins import globe, octasphere
from fish_env.body import make_body

USUAL = ("explicit_euler", "midpoint", "rk4", "leapfrog_chebyshev")
METHODS = [pytest.param(name, marks=() if name in USUAL else pytest.mark.slow)
           for name, method in INTEGRATORS.items() if method.kind != "adaptive"]  # fmt: skip


def test_room():
    """An open room has a floor and two walls; a closed one six walls, all the same distance from the origin."""
    assert len(room((0.0, -1.0, 0.0), 0.3).planes) == 3
    planes = room((0.0, -1.0, 0.0), 0.3, closed=True).planes
    assert sorted(map(tuple, planes[:, :3].tolist())) == sorted(
        map(tuple, np.concatenate([np.eye(3), -np.eye(3)]).tolist())
    )
    np.testing.assert_array_equal(planes[:, 3], -0.3)


@pytest.mark.parametrize("name", METHODS)
def test_nothing_leaves_a_closed_room(name):
    """A thrown ring is never further behind a wall than its nodes move in two steps, with any method."""
    for seed in (0, 1):
        found = thrown(make_ring(), name, seed, 1e-4 if name == "explicit_euler" else None, seconds=0.3)
        assert not found["failure"]
        assert 0.0 < found["depth"] < 2.0 * found["travel"]


@pytest.mark.parametrize("name", ["string", "uniform sphere"])
def test_no_other_object_leaves_either(name):
    """Nor is any other object, with the default method, further behind than its nodes move in one step."""
    found = thrown(OBJECTS[name].make(), "leapfrog_chebyshev", 3, seconds=0.3)
    assert not found["failure"] and 0.0 < found["depth"] < found["travel"]


@pytest.mark.parametrize("name", USUAL)
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


def test_song_methods_through_an_impact():
    """A step at which RK4 brings the ring through a fall ends it with explicit Euler."""
    assert not track("ring", "dropped", "rk4", 8)["failure"]
    assert track("ring", "dropped", "explicit_euler", 8)["failure"]


def test_a_hand_that_jumps_does_not_converge():
    """A hand of evenly spaced events that has its velocity errs by a tenth when told four times as often."""
    exact = dragged("ring", None, True, 1 / 1920)
    off = {(rate, moves): np.linalg.norm(dragged("ring", rate, moves, 1 / 1920) - exact, axis=2).max() / 0.2
           for rate in (20, 80) for moves in (True, False)}  # fmt: skip
    assert off[80, True] < 0.15 * off[20, True] < 0.03
    assert min(off[20, False], off[80, False]) > 0.5


def test_longest_step():
    """The longest step that survives with all shorter ones; 0 where the shortest fails."""
    cases = {"rk4": [(4.0, True), (2.0, False), (1.0, True), (0.5, True)], "midpoint": [(1.0, False), (2.0, True)]}
    rows = [{"object": "ring", "scene": "dropped", "integrator": name, "step_ms": step, "survives": survives}
            for name, line in cases.items() for step, survives in line]  # fmt: skip
    assert [longest(rows, "ring", "dropped", name) for name in cases] == [1.0, 0.0]


def test_costs():
    """Every method is timed, and the ratios are over explicit Euler."""
    rows = costs("string", 5)
    assert [row["integrator"] for row in rows] == ["explicit_euler", "midpoint", "rk4"]
    assert rows[0]["over_euler"] == 1.0 and all(row["us_per_step"] > 0 for row in rows)


def test_icosphere():
    """An icosahedron divided n times: 10 4^n + 2 nodes, of which 12 have 5 neighbours and all others 6."""
    for level in range(3):
        skin = icosphere(level)
        assert (len(skin.place), len(skin.edges), len(skin.faces)) == (10 * 4**level + 2, 30 * 4**level, 20 * 4**level)
        around = np.bincount(skin.edges.ravel())
        assert np.sum(around == 5) == 12 and set(around.tolist()) <= {5, 6}


def test_force_error():
    """Regular solids have equal forces; the poles of circles of latitude are worse, the finer the worse."""
    for skin in (octasphere(0), icosphere(0)):
        assert force_error("", skin)["largest"] < 1e-13
    few, many = (force_error("", globe(n, 2 * n // 3))["largest"] for n in (12, 24))
    assert many > 2.0 * few > 2.0


def test_parameters():
    """The harder the radius springs, the less a ring is flattened; the more gas, the higher it rebounds."""
    heights = [fall("radius_stiffness", value)["least_height"] for value in (40.0, 150.0, 600.0)]
    assert heights == sorted(heights)
    rebounds = [fall("pressure", value)["rebound"] for value in (0.0, 20.0, 45.0)]
    assert rebounds == sorted(rebounds)


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
    coarse, fine = OBJECTS["uniform sphere"].make(1), OBJECTS["uniform sphere"].make(2)
    rng = np.random.default_rng(0)
    turn, shift = np.eye(3) + 0.3 * rng.normal(size=(3, 3)), rng.normal(size=3)
    for old, new in ((coarse, fine), (fine, coarse)):
        affine = old.body.position @ turn + shift
        np.testing.assert_allclose(carried_over(old, new, affine), new.body.position @ turn + shift, atol=1e-13)
        shaken = affine + 0.01 * rng.normal(size=affine.shape)
        found, common = carried_over(old, new, shaken), 0
        for layer in ("outer", "inner"):
            mine, other = getattr(old, layer), getattr(new, layer)
            apart = np.linalg.norm(new.body.position[other][:, None] - old.body.position[mine], axis=2)
            for i, j in np.argwhere(apart < 1e-10):
                np.testing.assert_allclose(found[other[i]], shaken[mine[j]], atol=1e-10)
                common += 1
        assert common == 36  # all nodes of the coarse level
    with pytest.raises(ValueError, match="no inner layer"):
        carried_over(coarse, OBJECTS["uniform sphere"].make(2, layers=1), coarse.body.position)


def test_what_a_level_of_detail_costs(monkeypatch):
    """Each level is taken from its own distance on, where its gap covers a pixel; finer ones cost more."""
    monkeypatch.setattr(detail, "SECONDS", 0.01)
    rows = detail.costs((0, 1))
    assert [row["nodes"] for row in rows] == [12, 36] and all(row["alive"] for row in rows)
    for row in rows:
        gap = facet_gap(row["level"]) * detail.RADIUS
        assert float(row["from_m"]) == pytest.approx(gap * detail.FOCAL, rel=2e-4)


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
