"""The BODIES table and what the body builders refuse; a longer fish swims as a shorter one does."""

import naive
import numpy as np
import pytest
from moving import tiered

from fish_env import BODIES, INTEGRATORS, Fish, Tank, World, make_fish, make_water
from fish_env.bodies import mass_spring as tu
from fish_env.physics.body import make_body
from fish_env.physics.tank_options import own_step

each_body = pytest.mark.parametrize("name", naive.TU)


@each_body
def test_every_body_builds(name):
    """Each entry of the table builds a fish of its name, whose numbers are finite and whose arrays the kernels take."""
    fish = make_fish(name)
    assert isinstance(fish, Fish) and fish.name == name == BODIES[name].name and BODIES[name].description
    assert isinstance(fish.water, World) and (fish.water.linear > 0 or fish.water.quadratic > 0)
    body = fish.body
    for array in (body.position, body.mass, *body.springs, *body.faces[:3], *body.profile):
        assert array.dtype in (np.float64, np.int64) and array.flags.c_contiguous and np.isfinite(array).all()
    assert np.ptp(body.position[:, 0]) == pytest.approx(fish.length, rel=1e-15)
    assert body.position[fish.nose, 0] == body.position[:, 0].max()
    np.testing.assert_array_equal(body.position[fish.tail, 0], body.position[:, 0].min())
    assert body.position[fish.tail[0], 2] > 0 > body.position[fish.tail[1], 2]
    assert fish.line @ body.position[:, 0] == pytest.approx(1.0)
    steps = fish.control_interval / fish.time_step
    assert steps == pytest.approx(round(steps), rel=1e-9), "the control interval is not a whole number of steps"


@each_body
def test_sides(name):
    """Left is at positive y, `right` its mirror images in the same order, and a muscle's sign that of its nodes' y."""
    fish = make_fish(name)
    y = fish.body.position[:, 1]
    assert np.all(y[fish.left] > 0) and np.all(y[fish.right] < 0)
    np.testing.assert_array_equal(fish.mirror[fish.left], fish.right)
    np.testing.assert_array_equal(fish.mirror[fish.right], fish.left)
    middle = np.delete(np.arange(23), np.concatenate([fish.left, fish.right]))
    np.testing.assert_array_equal(fish.mirror[middle], middle)
    assert not y[middle].any()
    ends = fish.body.springs.nodes[fish.muscles]
    np.testing.assert_array_equal(np.sign(y[ends]), np.stack([fish.sides, fish.sides], axis=1))
    x = fish.body.position[ends, 0].mean(axis=1)
    for segment in range(2):  # the foremost segment is 0
        assert x[fish.segments == segment].min() > x[fish.segments == segment + 1].max()


@each_body
def test_grouping(name):
    """Muscles act alone, or in pairs of a segment and side; an unknown grouping is refused."""
    fish = make_fish(name)
    np.testing.assert_array_equal(fish.grouping("muscles"), np.arange(12))
    pairs = fish.grouping("pairs")
    assert sorted(pairs.tolist()) == [k // 2 for k in range(12)]
    for group in range(6):
        chosen = pairs == group
        assert set(fish.segments[chosen]) == {group // 2}
        assert set(fish.sides[chosen]) == {1 if group % 2 == 0 else -1}
    with pytest.raises(ValueError, match=r"unknown muscle grouping 'sides'; choose 'muscles' .* or 'pairs'"):
        fish.grouping("sides")


@each_body
@pytest.mark.parametrize("method", tiered(INTEGRATORS))
def test_muscles_bend_towards_their_side(name, method):
    """In water, contracting all muscles of the left side bends head and tail to the left, and so for the right."""
    fish = make_fish(name)
    dt = own_step(fish, INTEGRATORS[method])
    tank = Tank(fish, 2, method, dt, make_water(density=fish.body.mass.sum() / (0.01 * fish.length**3)))
    for _ in range(round(fish.contraction_time / fish.control_interval)):
        tank.swim(np.stack([fish.sides, -fish.sides]), fish.control_interval)
    assert tank.alive.all()
    y = tank.position[:, :, 1]
    bend = 0.5 * (y[:, 1:5].mean(axis=1) + y[:, fish.tail].mean(axis=1)) - y[:, 5:13].mean(axis=1)
    assert bend[0] > 1e-3 * fish.length and bend[1] < -1e-3 * fish.length


@pytest.mark.parametrize("method", tiered(INTEGRATORS))
def test_motion_scales_with_length(method):
    """Fish of 0.2 and 0.3 m under the same commands move alike, in body lengths and seconds."""
    short, long = make_fish(length=0.2), make_fish(length=0.3)
    np.testing.assert_allclose(long.body.mass, 1.5**3 * short.body.mass, rtol=1e-13)
    dt, allowed = own_step(short, INTEGRATORS[method]), 1e-10
    if INTEGRATORS[method].kind == "adaptive":
        allowed = 1e-6  # they err by 1e-10 a step, which this motion magnifies a thousandfold
    tanks = [Tank(fish, 1, method, dt, make_water(current=(0.1 * fish.length, 0, 0))) for fish in (short, long)]
    for action in np.random.default_rng(1).uniform(-1, 1, (16, 12)):
        for tank in tanks:
            tank.swim(action, short.control_interval)
            assert tank.alive[0]
        moved = [tank.position[0] / tank.fish.length for tank in tanks]
        np.testing.assert_allclose(moved[1], moved[0], rtol=0, atol=allowed)
    assert np.abs(moved[0] - short.body.position / short.length).max() > 0.01


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            {"body": "trout"},
            "unknown body 'trout'; choose from 'mass_spring', 'planar', 'two_layer', 'tetrahedral', 'published'",
        ),
        ({"weight": 3}, "unknown parameter 'weight' of the mass_spring fish; choose from length, "),
        ({"body": "published", "weight": 3}, "unknown parameter 'weight' of the published fish"),
        ({"length": 0.0}, "length is 0.0 .*; give positive numbers"),
        ({"length": "long"}, "length is 'long'; give finite numbers"),
        ({"length": [0.2]}, r"length has shape \(1,\)"),
        ({"length": float("inf")}, "length is inf"),
        ({"layer_position": (0.1, 0.3, 0.2, 0.5, 0.6)}, "layer_position is .*; give increasing numbers"),
        ({"layer_position": (0.1, 0.2, 0.3, 0.5, 1.0)}, "layer_position is .*; give increasing numbers"),
        ({"half_depth": (0.1,) * 4}, r"half_depth has shape \(4,\); give shape \(5,\)"),
        ({"half_width": (0.1, 0.1, -0.1, 0.1, 0.1)}, r"half_width is -0.1 at \(2,\); give positive"),
        ({"stiffness": (1.0, 0.0, 1.0)}, r"stiffness is 0.0 at \(1,\); give positive"),
        ({"mass_factor": (1, 1, 1, 1, 1, 1, -1)}, r"mass_factor is -1.0 at \(6,\); give positive"),
        ({"taper": (1, 1, 1, 1, 1, float("nan"))}, r"taper is nan at \(5,\)"),
        (
            {"layer_position": (0.01, 0.02, 0.03, 0.04, 0.05)},
            "no masses of these nodes have the inertia of the outline",
        ),
        ({"relaxation_time": -1e-3}, "relaxation_time is -0.001 .*; give zero or positive"),
        ({"contracted": (0.7, 0.7, 1.0)}, "contracted is .*; give fractions below 1"),
        ({"contraction_time": 0}, "contraction_time is 0.0 .*; give positive"),
        ({"activation_time": (0.01, -1.0)}, r"activation_time is -1.0 at \(1,\); give zero or positive"),
        ({"activation_time": (0.01, 0.0)}, "activation_time is .*; give two positive times, or"),
        ({"time_step": -1}, "time_step is -1.0"),
        ({"control_interval": float("nan")}, "control_interval is nan"),
        ({"body": "published", "contracted": (0.7, 0.7)}, r"contracted has shape \(2,\)"),
        ({"body": "published", "contracted": (0.7, 0.7, 1.2)}, "contracted is .*; give fractions between 0 and 1"),
        ({"body": "published", "contraction_time": -1.0}, "contraction_time is -1.0; give a positive"),
        ({"body": "published", "time_step": float("nan")}, "time_step is nan; give a positive"),
    ],
    ids=str,
)
def test_make_fish_refuses(arguments, text):
    """An unknown body, an unknown parameter or an impossible value is refused, saying what is allowed."""
    with pytest.raises(ValueError, match=text):
        make_fish(**arguments)


@pytest.mark.parametrize("part", ["length", "contraction_time", "contracted", "stiffness", "control_interval"])
def test_parameters_reach_the_fish(part):
    """A parameter that is given is the one the fish has."""
    plain = make_fish()
    if part == "stiffness":
        changed = make_fish(stiffness=(1.0, 2.0, 3.0), taper=(1.0,) * 6)
        assert set(np.round(changed.body.springs.stiffness, 12)) == {1.0, 2.0, 3.0}
    elif part == "contracted":
        changed = make_fish(contracted=(0.6, 0.7, 0.8))
        np.testing.assert_array_equal(changed.contracted, np.array([0.6, 0.7, 0.8])[plain.segments])
    else:
        assert getattr(make_fish(**{part: 2 * getattr(plain, part)}), part) == 2 * getattr(plain, part)


GOOD = {
    "position": np.eye(3),
    "mass": [1.0, 2.0, 3.0],
    "pairs": [(0, 1), (2, 1)],
    "stiffness": [5.0, 0.0],
    "damping": [0.0, 1.0],
    "rest_length": [1.0, 1.5],
    "faces": [(0, 1, 2, 2)],
}


@pytest.mark.parametrize("body", ["mass_spring", "planar", "two_layer"])
def test_where_the_water_is_felt(body):
    """A flank feels the water as far along its section as `water_place` says, its other sides level with it."""
    place = (0.6, 0.2, 0.3, 0.4, 0.7, 0.8)
    own = {} if body == "mass_spring" else {"drag": np.ones(6)}
    fish = make_fish(body, water_place=place, water_drag=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), **own)
    plain = make_fish(body, water_place=place, water_drag=np.ones(6), **own)
    stations = -np.array([0.0, *tu.calibrated()["layer_position"], 1.0]) * fish.length
    faces = fish.body.faces
    point = np.einsum("fc,fck->fk", faces.share, fish.body.position[faces.nodes])
    section = np.searchsorted(-stations, -point[:, 0]) - 1
    flank = np.abs(fish.body.position[faces.nodes, 1].sum(axis=1)) > 1e-9
    wanted = stations[:-1] + np.array(place) * np.diff(stations)
    assert set(section[flank]) == set(range(6))
    np.testing.assert_allclose(point[flank, 0], wanted[section[flank]], rtol=1e-12)
    np.testing.assert_allclose(faces.drag, plain.body.faces.drag * (section + 1.0), rtol=1e-12)
    assert fish.water.quadratic == plain.water.quadratic
    with pytest.raises(ValueError, match=r"water_place is .*; give fractions below 1"):
        make_fish(body, water_place=(0.5, 0.5, 0.5, 0.5, 0.5, 1.0))


@pytest.mark.parametrize("body", ["mass_spring", "planar"])
def test_damping_along_the_body(body):
    """Damping over stiffness is the relaxation time times the section's factor, between sections in between."""
    factors = np.array([0.5, 0.8, 1.5, 2.0, 1.2, 0.3])
    own = {} if body == "mass_spring" else {"damping": 2.0}
    fish = make_fish(body, relaxation_time=1e-3, damping_taper=tuple(factors), **own)
    springs, stations = fish.body.springs, -np.array([0.0, *tu.calibrated()["layer_position"], 1.0]) * fish.length
    ends = np.searchsorted(-stations, -fish.body.position[springs.nodes, 0] - 1e-9)
    within = ends[:, 0] == ends[:, 1]
    inside = np.exp(0.5 * (np.log(factors[1:]) + np.log(factors[:-1])))  # of a layer between two sections
    section = ends.min(axis=1)
    wanted = np.where(within & (section < 6), inside[np.clip(section - 1, 0, 4)], factors[np.clip(section, 0, 5)])
    wanted *= 1e-3 * own.get("damping", 1.0)
    np.testing.assert_allclose(springs.damping / springs.stiffness, wanted, rtol=1e-12)
    with pytest.raises(ValueError, match=r"damping_taper has shape \(5,\)"):
        make_fish(body, damping_taper=(1.0,) * 5)


@pytest.mark.parametrize("body", ["planar", "two_layer"])
def test_damping_of_a_fitted_body(body):
    """The factor `damping` multiplies the damping of every spring and nothing else."""
    once, twice = make_fish(body, damping=1.0).body, make_fish(body, damping=2.0).body
    np.testing.assert_allclose(twice.springs.damping, 2.0 * once.springs.damping, rtol=1e-12)
    np.testing.assert_array_equal(twice.springs.stiffness, once.springs.stiffness)
    with pytest.raises(ValueError, match=r"damping is -1\.0"):
        make_fish(body, damping=-1.0)


def test_make_body():
    """A body keeps what it was given, as copies, and the corners of its triangle share its force in thirds."""
    mass = np.array(GOOD["mass"])
    body = make_body(**(GOOD | {"mass": mass}))
    mass[:] = -1
    np.testing.assert_array_equal(body.mass, GOOD["mass"])
    np.testing.assert_array_equal(body.springs.nodes, GOOD["pairs"])
    np.testing.assert_array_equal(body.springs.stiffness, GOOD["stiffness"])
    np.testing.assert_array_equal(body.springs.damping, GOOD["damping"])
    np.testing.assert_array_equal(body.springs.rest_length, GOOD["rest_length"])
    np.testing.assert_array_equal(body.profile.first, [0, 0, 0])  # the face joins nodes 0 and 2
    np.testing.assert_array_equal(body.faces.share, [[1 / 3, 1 / 3, 1 / 6, 1 / 6]])


@pytest.mark.parametrize(
    ("part", "value", "text"),
    [
        ("mass", [1, -2, 3], r"mass \(kg\) is -2.0 at \(1,\); give positive numbers"),
        ("mass", [1, 0, 3], r"mass \(kg\) is 0.0 at \(1,\)"),
        ("mass", [1, np.inf, 3], r"mass \(kg\) is inf at \(1,\)"),
        ("mass", [], r"mass has shape \(0,\); give one mass a node"),
        ("mass", 1.0, r"mass has shape \(\); give one mass a node"),
        ("mass", [1, "a", 3], r"mass \(kg\) is .*; give finite numbers"),
        ("position", np.eye(2), r"position \(m\) has shape \(2, 2\); give shape \(3, 3\)"),
        ("position", np.full((3, 3), np.nan), r"position \(m\) is nan at \(0, 0\)"),
        ("pairs", [(0, 1), (2, 2)], "spring 1 joins node 2 to itself; give two different nodes"),
        ("pairs", [(0, 1), (1, 0)], "two springs join the same pair of nodes"),
        ("pairs", [(0, 1), (1, 3)], "springs contain node 3; valid numbers are 0 to 2"),
        ("pairs", [(0, 1), (1, -1)], "springs contain node -1; valid"),
        ("pairs", [(0, 1.0), (1, 2)], r"springs have shape \(2, 2\) and type float64; give whole numbers \(K, 2\)"),
        ("pairs", [(0, 1, 2)], r"springs have shape \(1, 3\)"),
        ("share", [[0.5, 0.5, 0.5, -0.5]], r"share is -0.5 at \(0, 3\); give zero or positive"),
        ("share", [[0.5, 0.5, 0.5, 0.0]], "the shares of the corners of face 0 add up to 1.5; give parts of 1"),
        ("share", [0.25] * 4, r"share has shape \(4,\); give shape \(1, 4\)"),
        ("drag", [0.0], r"drag is 0.0 at \(0,\); give positive"),
        ("stiffness", [1.0, -1.0], r"stiffness \(N/m\) is -1.0 at \(1,\); give zero or positive"),
        ("stiffness", [1.0], r"stiffness \(N/m\) has shape \(1,\); give shape \(2,\)"),
        ("damping", [0.0, np.nan], r"damping \(N s/m\) is nan at \(1,\)"),
        ("rest_length", [1.0, 0.0], r"rest_length \(m\) is 0.0 at \(1,\); give positive"),
        ("faces", [(0, 1, 2)], r"faces have shape \(1, 3\) and type int64; give whole numbers \(K, 4\)"),
        ("faces", [(0, 1, 2, 5)], "faces contain node 5; valid"),
    ],
)
def test_make_body_refuses(part, value, text):
    """A body with a misshapen, non-finite or impossible part is refused by that part's name."""
    with pytest.raises(ValueError, match=text):
        make_body(**(GOOD | {part: value}))


def test_inside_out_surface_is_refused():
    """A closed surface wound clockwise, on which the water would pull instead of push, is refused."""
    body = make_fish().body
    parts = (body.position, body.mass, body.springs.nodes, *body.springs[1:4])
    make_body(*parts, body.faces.nodes)
    with pytest.raises(ValueError, match="negative volume"):
        make_body(*parts, body.faces.nodes[:, ::-1][:, [2, 3, 0, 1]])
