"""The table of bodies: how they are built, moved and driven, and what their makers refuse.

What the elements do by themselves is in test_elements.py, what every method does with them in test_every_method.py;
every method on every body, which takes long to compile, is behind `pytest -m slow`.
"""

import gymnasium as gym
import naive
import numpy as np
import pytest
from moving import FISH as TOPOLOGICAL
from moving import tiered
from naive.reactive import added_mass, reactive_force

from fish_env import BODIES, INTEGRATORS, Fish, Tank, World, make_fish, make_water
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.fitted import WATERS
from fish_env.bodies.outline import layers_of
from fish_env.bodies.sizes import slowness
from fish_env.envs.variation import vary
from fish_env.physics.body import make_body
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM
from fish_env.soft import statics
from fish_env.soft.tetrahedral import make_mesh, softening
from fish_env.tasks.start import rotation

FOUR = ("mass_spring", "planar", "two_layer", "tetrahedral")
FISH = TOPOLOGICAL | {name: make_fish(name) for name in FOUR[1:]}
DEFAULT = FISH["mass_spring"]
STATIONS = -np.array([0.0, *tu.check_parameters("mass_spring", {}).layer_position, 1.0]) * DEFAULT.length
each_body = pytest.mark.parametrize("name", FOUR)


def deformed(fish, rng, displacement=0.001, speed=0.3):
    """A deformed, moving fish, turned about z; a flat one stays flat."""
    free = fish.body.inverse_mass > 0.0
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    x = (fish.body.position + displacement * fish.length * rng.uniform(-1, 1, free.shape) * free) @ turn.T
    return x, speed * fish.length / fish.contraction_time * rng.uniform(-1, 1, free.shape) * free


# Building


@pytest.mark.parametrize("name", BODIES)
def test_every_body_builds(name):
    """Each entry of the table is a fish at rest, with finite numbers and muscles and sides as the default fish has."""
    fish = FISH[name]
    assert isinstance(fish, Fish) and fish.name == name == BODIES[name].name and BODIES[name].description
    assert isinstance(fish.water, World) and (fish.water.linear > 0 or fish.water.quadratic > 0)
    body, x = fish.body, fish.body.position
    for array in (x, body.mass, *body.springs, *body.faces[:3], *body.profile):
        assert array.dtype in (np.float64, np.int64) and array.flags.c_contiguous and np.isfinite(array).all()
    assert repr(fish).startswith(f"<Fish {name!r}: {len(x)} nodes, ") and len(repr(fish)) < 120
    assert np.ptp(x[:, 0]) == pytest.approx(fish.length, rel=1e-12)
    assert x[fish.nose, 0] == x[:, 0].max() and (x[fish.tail, 0] == x[:, 0].min()).all()
    assert fish.flat or x[fish.tail[0], 2] > 0 > x[fish.tail[1], 2]
    assert fish.line @ x[:, 0] == pytest.approx(1.0)
    assert (x[fish.left, 1] > 0).all() and (x[fish.right, 1] < 0).all()
    np.testing.assert_allclose(x[fish.mirror] * (1, -1, 1), x, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fish.mirror[fish.left], fish.right)
    for part in ("sides", "segments", "mirrored_muscles"):
        np.testing.assert_array_equal(getattr(fish, part), getattr(DEFAULT, part))
    np.testing.assert_array_equal(np.sign(fish.heights), np.sign(DEFAULT.heights))
    np.testing.assert_array_equal(fish.landmarks.faces, DEFAULT.landmarks.faces)
    for fibre, (upper, lower) in zip(fish.fibres, fish.drives, strict=True):
        assert (np.sign(x[body.springs.nodes[fibre], 1]) == fish.sides[upper]).all()
        assert fish.sides[upper] == fish.sides[lower] and fish.segments[upper] == fish.segments[lower]
    assert set(fish.drives.ravel()) == set(range(12)) and set(fish.muscles) <= set(fish.fibres)
    f = Evaluator(body, VACUUM).force(body.springs.rest_length, x, np.zeros_like(x))
    assert np.abs(f).max() <= 1e-12 * body.springs.stiffness.max() * fish.length


@each_body
def test_bodies_are_the_same_fish(name):
    """Mass and landmarks are those of the default fish; every method has a step, a whole part of the interval."""
    fish = FISH[name]
    assert fish.body.mass.sum() == pytest.approx(DEFAULT.body.mass.sum(), rel=1e-12)
    np.testing.assert_allclose(fish.points(fish.body.position), DEFAULT.body.position, rtol=0, atol=1e-12)
    for record in INTEGRATORS.values():
        if record.kind != "adaptive":
            steps = fish.control_interval / own_step(fish, record)
            assert steps == pytest.approx(round(steps), rel=1e-9) and steps >= 1


def test_grouping():
    """Muscles act alone, or in pairs of a segment and side; an unknown grouping is refused."""
    np.testing.assert_array_equal(DEFAULT.grouping("muscles"), np.arange(12))
    pairs = DEFAULT.grouping("pairs")
    assert sorted(pairs.tolist()) == [k // 2 for k in range(12)]
    for group in range(6):
        chosen = pairs == group
        assert set(DEFAULT.segments[chosen]) == {group // 2}
        assert set(DEFAULT.sides[chosen]) == {1 if group % 2 == 0 else -1}
    with pytest.raises(ValueError, match=r"unknown muscle grouping 'sides'; choose 'muscles' .* or 'pairs'"):
        DEFAULT.grouping("sides")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"body": "trout"}, f"unknown body 'trout'; choose from {', '.join(map(repr, BODIES))}"),
        ({"weight": 3}, "unknown parameter 'weight' of the mass_spring fish; choose from length, "),
        ({"body": "published", "weight": 3}, "unknown parameter 'weight' of the published fish"),
        ({"length": 0.0}, "length is 0.0 .*; give positive numbers"),
        ({"length": "long"}, "length is 'long'; give finite numbers"),
        ({"length": [0.2]}, r"length has shape \(1,\)"),
        ({"layer_position": (0.1, 0.3, 0.2, 0.5, 0.6)}, "layer_position is .*; give increasing numbers"),
        ({"layer_position": (0.1, 0.2, 0.3, 0.5, 1.0)}, "layer_position is .*; give increasing numbers"),
        ({"half_depth": (0.1,) * 4}, r"half_depth has shape \(4,\); give shape \(5,\)"),
        ({"half_width": (0.1, 0.1, -0.1, 0.1, 0.1)}, r"half_width is -0.1 at \(2,\); give positive"),
        ({"taper": (1, 1, 1, 1, 1, float("nan"))}, r"taper is nan at \(5,\)"),
        ({"layer_position": (0.01, 0.02, 0.03, 0.04, 0.05)}, "no masses of these nodes have the inertia of the outli"),
        ({"relaxation_time": -1e-3}, "relaxation_time is -0.001 .*; give zero or positive"),
        ({"contracted": (0.7, 0.7, 1.0)}, "contracted is .*; give fractions below 1"),
        ({"activation_time": (0.01, -1.0)}, r"activation_time is -1.0 at \(1,\); give zero or positive"),
        ({"activation_time": (0.01, 0.0)}, "activation_time is .*; give two positive times, or"),
        ({"water_place": (0.5, 0.5, 0.5, 0.5, 0.5, 1.0)}, "water_place is .*; give fractions below 1"),
        ({"damping_taper": (1.0,) * 5}, r"damping_taper has shape \(5,\)"),
        ({"body": "published", "contracted": (0.7, 0.7)}, r"contracted has shape \(2,\)"),
        ({"body": "published", "contracted": (0.7, 0.7, 1.2)}, "contracted is .*; give fractions between 0 and 1"),
        ({"body": "published", "contraction_time": -1.0}, "contraction_time is -1.0; give a positive"),
        ({"body": "planar", "level": 1}, "unknown parameter 'level' of the planar fish; choose from length"),
        ({"body": "planar", "bending": [1.0] * 4}, r"bending has shape \(4,\); give shape \(5,\)"),
        ({"body": "planar", "damping": -1.0}, r"damping is -1\.0"),
        ({"body": "tetrahedral", "level": 0}, "level is 0; give a whole number, 1 to 4"),
        ({"body": "tetrahedral", "poisson": 0.5}, "poisson is 0.5 in element 0; give numbers above -1 and below 0.5"),
        ({"body": "tetrahedral", "lumping": "thirds"}, "unknown rule 'thirds'; choose from 'matched', 'quarter', 'uni"),
        ({"body": "two_layer", "inner_size": 1.0}, "inner_size is 1.0; give a number between 0 and 1"),
        ({"body": "two_layer", "inner_mass": 0.0}, "inner_mass is .*; give"),
        ({"body": "two_layer", "pressure": -1.0}, r"pressures \(Pa\) is -1.0 at \(0,\); give positive numbers"),
    ],
    ids=str,
)
def test_make_fish_refuses(arguments, text):
    """An unknown body, an unknown parameter or an impossible value is refused, saying what is allowed."""
    with pytest.raises(ValueError, match=text):
        make_fish(**arguments)


@pytest.mark.parametrize("part", ["length", "contraction_time", "control_interval"])
def test_parameters_reach_the_fish(part):
    """A parameter that is given is the one the fish has."""
    assert getattr(make_fish(**{part: 2 * getattr(DEFAULT, part)}), part) == 2 * getattr(DEFAULT, part)


def test_materials_reach_the_fish():
    """So are stiffness and contraction, by class and by segment."""
    changed = make_fish(stiffness=(1.0, 2.0, 3.0), taper=(1.0,) * 6, contracted=(0.6, 0.7, 0.8))
    assert set(np.round(changed.body.springs.stiffness, 12)) == {1.0, 2.0, 3.0}
    np.testing.assert_array_equal(changed.contracted, np.array([0.6, 0.7, 0.8])[DEFAULT.segments])


@pytest.mark.parametrize("body", ["mass_spring", "planar", "two_layer"])
def test_where_the_water_is_felt(body):
    """A flank feels the water as far along its section as `water_place` says, its other sides level with it."""
    place = (0.6, 0.2, 0.3, 0.4, 0.7, 0.8)
    own = {} if body == "mass_spring" else {"drag": np.ones(6)}
    fish = make_fish(body, water_place=place, water_drag=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), **own)
    plain = make_fish(body, water_place=place, water_drag=np.ones(6), **own)
    faces = fish.body.faces
    point = np.einsum("fc,fck->fk", faces.share, fish.body.position[faces.nodes])
    section = np.searchsorted(-STATIONS, -point[:, 0]) - 1
    flank = np.abs(fish.body.position[faces.nodes, 1].sum(axis=1)) > 1e-9
    wanted = STATIONS[:-1] + np.array(place) * np.diff(STATIONS)
    assert set(section[flank]) == set(range(6))
    np.testing.assert_allclose(point[flank, 0], wanted[section[flank]], rtol=1e-12)
    np.testing.assert_allclose(faces.drag, plain.body.faces.drag * (section + 1.0), rtol=1e-12)
    assert fish.water.quadratic == plain.water.quadratic


@pytest.mark.parametrize(("body", "own"), [("mass_spring", {}), ("planar", {"damping": 2.0})])
def test_damping_along_the_body(body, own):
    """Damping over stiffness is the relaxation time times the section's factor, between sections in between."""
    factors = np.array([0.5, 0.8, 1.5, 2.0, 1.2, 0.3])
    fish = make_fish(body, relaxation_time=1e-3, damping_taper=tuple(factors), **own)
    springs = fish.body.springs
    ends = np.searchsorted(-STATIONS, -fish.body.position[springs.nodes, 0] - 1e-9)
    within = ends[:, 0] == ends[:, 1]
    inside = np.exp(0.5 * (np.log(factors[1:]) + np.log(factors[:-1])))  # of a layer between two sections
    section = ends.min(axis=1)
    wanted = np.where(within & (section < 6), inside[np.clip(section - 1, 0, 4)], factors[np.clip(section, 0, 5)])
    wanted *= 1e-3 * own.get("damping", 1.0)
    np.testing.assert_allclose(springs.damping / springs.stiffness, wanted, rtol=1e-12)


@pytest.mark.parametrize("body", ["planar", "two_layer"])
def test_damping_of_a_fitted_body(body):
    """The factor `damping` multiplies the damping of every spring and nothing else."""
    once, twice = (make_fish(body, damping=factor).body.springs for factor in (1.0, 2.0))
    np.testing.assert_allclose(twice.damping, 2.0 * once.damping, rtol=1e-12)
    np.testing.assert_array_equal(twice.stiffness, once.stiffness)


GOOD = {"position": np.eye(3), "mass": [1.0, 2.0, 3.0], "pairs": [(0, 1), (2, 1)], "stiffness": [5.0, 0.0],
        "damping": [0.0, 1.0], "rest_length": [1.0, 1.5], "faces": [(0, 1, 2, 2)]}  # fmt: skip


def test_make_body():
    """A body keeps what it was given, as copies, and the corners of its triangle share its force in thirds."""
    mass = np.array(GOOD["mass"])
    body = make_body(**(GOOD | {"mass": mass}))
    mass[:] = -1
    np.testing.assert_array_equal(body.mass, GOOD["mass"])
    np.testing.assert_array_equal(body.springs.nodes, GOOD["pairs"])
    for part in ("stiffness", "damping", "rest_length"):
        np.testing.assert_array_equal(getattr(body.springs, part), GOOD[part])
    np.testing.assert_array_equal(body.profile.first, [0, 0, 0])  # the face joins nodes 0 and 2
    np.testing.assert_array_equal(body.faces.share, [[1 / 3, 1 / 3, 1 / 6, 1 / 6]])


@pytest.mark.parametrize(
    ("part", "value", "text"),
    [
        ("mass", [1, -2, 3], r"mass \(kg\) is -2.0 at \(1,\); give positive numbers"),
        ("mass", [], r"mass has shape \(0,\); give one mass a node"),
        ("mass", [1, "a", 3], r"mass \(kg\) is .*; give finite numbers"),
        ("position", np.eye(2), r"position \(m\) has shape \(2, 2\); give shape \(3, 3\)"),
        ("pairs", [(0, 1), (2, 2)], "spring 1 joins node 2 to itself; give two different nodes"),
        ("pairs", [(0, 1), (1, 0)], "two springs join the same pair of nodes"),
        ("pairs", [(0, 1), (1, 3)], "springs contain node 3; valid numbers are 0 to 2"),
        ("pairs", [(0, 1.0), (1, 2)], r"springs have shape \(2, 2\) and type float64; give whole numbers \(K, 2\)"),
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
    body = DEFAULT.body
    with pytest.raises(ValueError, match="negative volume"):
        make_body(body.position, body.mass, body.springs.nodes, *body.springs[1:4], body.faces.nodes[:, [3, 2, 1, 0]])


# Forces and motion


@pytest.mark.parametrize("water", WATERS)
@each_body
def test_force_equals_its_reference(name, water):
    """The sum of all forces on a bent, moving fish in its water is that of the slow reference implementations."""
    fish = make_fish(name, water=water)
    body, (x, v) = fish.body, deformed(fish, np.random.default_rng(1))
    f = Evaluator(body, fish.water).force(body.springs.rest_length, x, v)
    if fish.flat:  # of an upright face: its upper corners are nodes of their own
        wanted = upright_water(fish, x, v) + naive.spring_force(body.springs, body.springs.rest_length, x, v)
    else:
        wanted = naive.total_force(body, fish.water, body.springs.rest_length, x, v)
    if water == "reactive":  # beside the sections, water is accelerated too
        wanted += reactive_force(body, fish.water, x, v)
        for edge, sign in ((body.sections.upper, 1.0), (body.sections.lower, -1.0)):
            wanted[edge, 2] += sign * fish.water.righting * body.sections.leverage
        free, beside = body.inverse_mass.ravel() > 0.0, added_mass(body, fish.water, x)
        whole, a = beside + np.diag(np.repeat(body.mass, 3)), np.zeros(x.size)
        a[free] = np.linalg.solve(whole[np.ix_(free, free)], wanted.ravel()[free])
        wanted -= (beside @ a).reshape(x.shape)
    np.testing.assert_allclose(f, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def upright_water(fish, x, v):
    """Force of the water (N,3) on upright faces, taken as ordinary ones between raised copies of the nodes."""
    total, faces = np.zeros_like(x), fish.body.faces
    for corners, share, factor, depth in zip(faces.nodes, faces.share, faces.drag, faces.depth, strict=True):
        raised = x[corners] + np.array([0, 0, depth, depth])[:, None] * (0, 0, 1)
        push = factor * naive.face_force(np.arange(4), share, fish.water, raised, v[corners])
        rough, along = naive.face_friction(fish.body, np.arange(4), share, fish.water, raised, v[corners])
        push -= rough * along
        for node, part in zip(corners, share, strict=True):
            total[node] += part * push
    return total


@pytest.mark.parametrize("name", naive.TU)
@pytest.mark.parametrize("method", tiered(INTEGRATORS))
def test_muscles_bend_towards_their_side(name, method):
    """In water, contracting all muscles of the left side bends head and tail to the left, and so for the right."""
    fish = FISH[name]
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
    """A fish of 0.3 m moves, in body lengths, as one of 0.2 m does that is varied to 1.5 times the length.

    The water has a linear law beside the quadratic one, inertia, friction and a righting couple; the fish is turned.
    """
    short, long = make_fish(length=0.2), make_fish(length=0.3)
    np.testing.assert_allclose(long.body.mass, 1.5**3 * short.body.mass, rtol=1e-13)
    dt, allowed = own_step(short, INTEGRATORS[method]), 1e-10
    if INTEGRATORS[method].kind == "adaptive":
        allowed = 1e-6  # they err by 1e-10 a step, which this motion magnifies a thousandfold
    waters = [fish.water._replace(linear=3.0, current=np.array([0.1 * fish.length, 0, 0])) for fish in (short, long)]
    tanks = [Tank(fish, 1, method, dt, water) for fish, water in zip((short, long), waters, strict=True)]
    for tank in tanks:
        tank.position[:] = tank.position @ rotation(0.0, 0.2, 0.7).T
    vary(tanks[0], 0, {"length": 1.5, "contraction_time": slowness(1.5)})
    for action in np.random.default_rng(1).uniform(-1, 1, (16, 12)):
        for tank in tanks:
            tank.swim(action, short.control_interval)
            assert tank.alive[0]
        moved = [tank.position[0] / tank.fish.length for tank in tanks]
        np.testing.assert_allclose(moved[1], moved[0], rtol=0, atol=allowed)
    assert np.abs(moved[0] - short.body.position / short.length).max() > 0.01


@each_body
def test_mirrored_commands_mirror_the_path(name):
    """Left and right exchanged, a fish swims the mirror image of its path."""
    fish = FISH[name]
    one, other = (Tank(fish, 1, water=fish.water) for _ in range(2))
    for action in np.random.default_rng(7).uniform(-1, 1, (10, 12)):
        one.swim(action, fish.control_interval)
        other.swim(action[fish.mirrored_muscles], fish.control_interval)
    image = one.position[0, fish.mirror] * (1, -1, 1)
    np.testing.assert_allclose(other.position[0], image, rtol=0, atol=1e-9 * fish.length)
    assert np.abs(one.position[0] - image).max() > 1e-2 * fish.length


@pytest.mark.parametrize("name", tiered(FOUR[1:], ("planar",)))
def test_spaces_are_the_same(name):
    """Observations and actions have the shape and, at the start, nearly the numbers of the default fish."""
    env, default = (gym.make("FishEnv/Swim-v0", body=body) for body in (name, "mass_spring"))
    assert env.observation_space == default.observation_space and env.action_space == default.action_space
    pair = [one.reset(seed=3, options={"yaw": 0.3})[0] for one in (env, default)]
    np.testing.assert_allclose(pair[0][:69], pair[1][:69], rtol=0, atol=0.02)


@each_body
def test_harsh_commands_break_no_body(name):
    """Square waves for two seconds, random on every muscle or from side to side at 5 Hz, leave every fish sound."""
    fish, rng, command = FISH[name], np.random.default_rng(9), np.zeros((8, 12))
    tank = Tank(fish, 8, water=fish.water, lanes="xyz")  # the kernels of one fish
    for k in range(100):
        command = np.where(rng.random((8, 12)) < 0.15, rng.integers(0, 2, (8, 12)), command)
        command[0] = fish.sides * np.sin(0.2 * np.pi * (k + 0.5)) > 0
        tank.drive(command, round(fish.control_interval / tank.dt))
    assert tank.alive.all(), tank.failure


def test_a_flat_fish_stays_flat():
    """No node of the flat fish leaves its plane; it can neither pitch nor roll nor chase a target in space."""
    fish = FISH["planar"]
    tank = Tank(fish, 2, water=fish.water)
    for action in np.random.default_rng(8).uniform(-1, 1, (20, 2, 12)):
        tank.swim(action, fish.control_interval)
    assert tank.alive.all() and not tank.position[:, :, 2].any() and not tank.velocity[:, :, 2].any()
    env = gym.make("FishEnv/Swim-v0", body="planar")
    with pytest.raises(ValueError, match="the flat 'planar' fish can neither pitch nor roll"):
        env.reset(seed=0, options={"roll": 0.1})
    with pytest.raises(ValueError, match="dimensions is 3, but the 'planar' fish is flat"):
        gym.make("FishEnv/Target-v0", body="planar", dimensions=3)


# Tetrahedra


@pytest.mark.parametrize("level", [1, 2, 3])
def test_fibres_run_from_layer_to_layer(level):
    """At every level they are the default fish's springs along its four edges."""
    fish = make_fish("tetrahedral", level=level)
    springs, place = fish.body.springs, {int(node): k for k, node in enumerate(fish.landmarks.node)}

    def units(pairs):
        return {frozenset(map(int, pair)) for pair in pairs}

    pairs = [[place[int(node)] for node in pair] for pair in springs.nodes]
    assert len(units(pairs)) == len(springs.nodes) == 24 and units(pairs) < units(DEFAULT.body.springs.nodes)
    assert units(np.array(pairs)[fish.muscles]) == units(DEFAULT.body.springs.nodes[DEFAULT.muscles])


@pytest.mark.parametrize("level", [1, 3])
def test_the_solid_is_as_stiff_in_bending_as_a_continuum(level):
    """The energy of pure bending, of elements that were softened, is half E I over the length, slice by slice."""
    poisson, p = 0.4, tu.MassSpringParameters(**tu.calibrated("drag"))
    mesh, section = make_mesh(p, level)
    factor = softening(mesh, section, poisson)
    x, y, z = mesh.position.T
    bent = np.stack([-x * y, 0.5 * (x**2 + poisson * (y**2 - z**2)), poisson * y * z], axis=1)
    energy = np.zeros(6)
    for nodes, k in zip(mesh.tets, section, strict=True):
        edges, moved = (a[nodes[1:]] - a[nodes[0]] for a in (mesh.position, bent))
        slope = np.linalg.solve(edges, moved)
        strain = 0.5 * (slope + slope.T)
        stress = (strain + poisson / (1 - 2 * poisson) * np.trace(strain) * np.eye(3)) / (1 + poisson)
        energy[k] += 0.5 * factor[k] * (stress * strain).sum() * abs(np.linalg.det(edges)) / 6
    share = (np.arange(6000) + 0.5) / 1000  # slices: of a rectangle 2a by 2b, I is 4 a3 b / 3
    _, width, depth = (np.interp(share, np.arange(7), row) for row in layers_of(p))
    slices = 0.5 * 4 / 3 * width**3 * depth * np.repeat(np.abs(np.diff(layers_of(p)[0])), 1000) / 1000
    np.testing.assert_allclose(energy, slices.reshape(6, 1000).sum(axis=1), rtol=1e-5)


def test_finer_meshes_are_softened_less():
    """The factors tend to 1 as the mesh is refined."""
    p = tu.MassSpringParameters(**tu.calibrated())
    factors = [softening(*make_mesh(p, level), 0.4) for level in (1, 2, 4)]
    assert factors[0].min() > 0 and (factors[0] < factors[1]).all() and (factors[1] < factors[2]).all()
    assert 0.75 < factors[2].max() < 1


@pytest.mark.parametrize("level", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_bent_fish_swings_about_as_fast(level):
    """The first vibration keeps 95 % of its frequency when the tail swings 20 mm without water: no fibre buckles."""
    fish = make_fish("tetrahedral", level=level)
    frequencies, shapes = statics.modes(fish.body, count=10)
    sideways = np.einsum("n,cn->c", fish.body.mass, shapes[:, :, 1] ** 2) > 0.5
    first = np.flatnonzero(sideways & (frequencies > 0.1))[0]  # before it are rigid motions
    thin = make_water(drag_coefficient=1e-9)  # as good as none, with the kernels of water
    tank, tail = Tank(fish, 1, water=thin), []
    tank.position[0] += 0.02 * shapes[first] / shapes[first][fish.tail, 1].mean()
    share, still = fish.body.mass / fish.body.mass.sum(), np.zeros((1, fish.num_muscles))
    while len(tail) * tank.dt < 0.6:
        tank.drive(still, 1)
        tail.append(tank.position[0, fish.tail, 1].mean() - share @ tank.position[0, :, 1])
    assert tank.alive[0]
    tail = np.array(tail)
    down = np.flatnonzero((tail[:-1] > 0) & (tail[1:] <= 0))
    crossing = (down + tail[down] / (tail[down] - tail[down + 1])) * tank.dt
    assert 1.0 / np.diff(crossing).mean() > 0.95 * frequencies[first]
