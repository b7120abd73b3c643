"""Bodies of the table: how they are built, moved and driven, from which outlines and of which lengths."""

import warnings
from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise

import gymnasium as gym
import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import inertia, moments, rows, tiered
from naive.forces import added_mass, reactive_force

from fish_env import BODIES, INTEGRATORS, Fish, Tank, World, make_fish, make_water
from fish_env.bodies import mass_spring as tu
from fish_env.bodies import masses
from fish_env.bodies.fitted import WATERS, read_calibration
from fish_env.bodies.mass_spring import CROSS, LAYERS, MUSCLE, OTHER, topology
from fish_env.bodies.outline import layers_of, outline_of, read_outline
from fish_env.bodies.sizes import ALLOWED, MEANT, SLOWNESS, slowness
from fish_env.control.gait import best_gait
from fish_env.envs.variation import vary
from fish_env.physics.body import make_body
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM
from fish_env.tasks.start import rotation

FOUR = ("mass_spring", "planar", "two_layer", "tetrahedral")
fish_of = cache(make_fish)
DEFAULT = fish_of("mass_spring")
STATIONS = -np.array([0.0, *tu.check_parameters("mass_spring", {}).layer_position, 1.0]) * DEFAULT.length
plain = pytest.mark.usefixtures("kernels")
each_body = pytest.mark.parametrize("name", tiered(FOUR, "all"))


def deformed(fish, rng, displacement=0.001, speed=0.3):
    """A deformed, moving fish, turned about z; a flat one stays flat."""
    free = fish.body.inverse_mass > 0.0
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    x = (fish.body.position + displacement * fish.length * rng.uniform(-1, 1, free.shape) * free) @ turn.T
    return x, speed * fish.length / fish.contraction_time * rng.uniform(-1, 1, free.shape) * free


# Building


@plain
@pytest.mark.parametrize("name", tiered(BODIES, "all"))
def test_every_body_builds(name):
    """Each entry of the table is a fish at rest, with finite numbers and muscles and sides as the default fish has."""
    fish = fish_of(name)
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
    fish = fish_of(name)
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


REFUSED = [
    ({"body": "trout"}, f"unknown body 'trout'; choose from {', '.join(map(repr, BODIES))}"),
    ({"weight": 3}, "the mass_spring fish has no parameter 'weight'.*; choose from 'length', "),
    ({"length": 0.0}, "length is 0.0 .*; give positive numbers"),
    ({"length": "long"}, "length is 'long'; give finite numbers"),
    ({"layer_position": (0.1, 0.3, 0.2, 0.5, 0.6)}, "layer_position is .*; give increasing numbers"),
    ({"half_depth": (0.1,) * 4}, r"half_depth has shape \(4,\); give shape \(5,\)"),
    ({"half_width": (0.1, 0.1, -0.1, 0.1, 0.1)}, r"half_width is -0.1 at \(2,\); give positive"),
    ({"layer_position": (0.01, 0.02, 0.03, 0.04, 0.05)}, "no masses of these nodes have the inertia of the outli"),
    ({"relaxation_time": -1e-3}, "relaxation_time is -0.001 .*; give zero or positive"),
    ({"contracted": (0.7, 0.7, 1.0)}, "contracted is .*; give fractions below 1"),
    ({"lengthening": 1.0}, "lengthening is 1.0; give a number from 0 to below 1"),
    ({"water_place": (0.5, 0.5, 0.5, 0.5, 0.5, 1.0)}, "water_place is .*; give fractions below 1"),
    ({"body": "published", "contracted": (0.7, 0.7, 1.2)}, "contracted is .*; give fractions between 0 and 1"),
    ({"body": "published", "contraction_time": -1.0}, "contraction_time is -1.0; give a positive"),
    ({"body": "tetrahedral", "water_drag": (1,) * 6}, "the tetrahedral fish has no parameter 'water_drag'"),
    ({"body": "two_layer", "damping_taper": (1,) * 6}, "the two_layer fish has no parameter 'damping_taper'"),
    ({"body": "planar", "level": 1}, "the planar fish has no parameter 'level'.*; choose from 'length'"),
    ({"body": "planar", "bending": [1.0] * 4}, r"bending has shape \(4,\); give shape \(5,\)"),
]
SOFT = [
    ({"body": "tetrahedral", "level": 0}, "level is 0; give a whole number, 1 to 4"),
    ({"body": "tetrahedral", "poisson": 0.5}, "poisson is 0.5 in element 0; give numbers above -1 and below 0.5"),
    ({"body": "tetrahedral", "lumping": "thirds"}, "unknown rule 'thirds'; choose from 'matched', 'quarter', 'uni"),
    ({"body": "two_layer", "inner_size": 1.0}, "inner_size is 1.0; give a number between 0 and 1"),
    ({"body": "two_layer", "inner_mass": 0.0}, "inner_mass is .*; give"),
    ({"body": "two_layer", "pressure": -1.0}, r"pressures \(Pa\) is -1.0 at \(0,\); give zero or positive numbers"),
]


@pytest.mark.parametrize(
    ("arguments", "text"), [*REFUSED, *(pytest.param(*row, marks=pytest.mark.soft) for row in SOFT)], ids=str
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


@pytest.mark.parametrize("body", tiered(["mass_spring", "planar", "two_layer"], "all"))
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


@pytest.mark.parametrize("body", tiered(["planar", "two_layer"], "all"))
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
        ("position", np.eye(2), r"position \(m\) has shape \(2, 2\); give shape \(3, 3\)"),
        ("pairs", [(0, 1), (2, 2)], "spring 1 joins node 2 to itself; give two different nodes"),
        ("pairs", [(0, 1), (1, 0)], "two springs join the same pair of nodes"),
        ("pairs", [(0, 1.0), (1, 2)], r"springs have shape \(2, 2\) and type float64; give whole numbers \(K, 2\)"),
        ("share", [[0.5, 0.5, 0.5, -0.5]], r"share is -0.5 at \(0, 3\); give zero or positive"),
        ("share", [[0.5, 0.5, 0.5, 0.0]], "the shares of the corners of face 0 add up to 1.5; give parts of 1"),
        ("drag", [0.0], r"drag is 0.0 at \(0,\); give positive"),
        ("stiffness", [1.0, -1.0], r"stiffness \(N/m\) is -1.0 at \(1,\); give zero or positive"),
        ("damping", [0.0, np.nan], r"damping \(N s/m\) is nan at \(1,\)"),
        ("rest_length", [1.0, 0.0], r"rest_length \(m\) is 0.0 at \(1,\); give positive"),
        ("faces", [(0, 1, 2)], r"faces have shape \(1, 3\) and type int64; give whole numbers \(K, 4\)"),
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


@plain
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


@pytest.mark.parametrize("name", tiered(naive.TU, ("mass_spring",)))
@pytest.mark.parametrize("method", tiered(INTEGRATORS))
def test_muscles_bend_towards_their_side(name, method):
    """In water, contracting all muscles of the left side bends head and tail to the left, and so for the right."""
    fish = fish_of(name)
    dt = own_step(fish, INTEGRATORS[method])
    tank = Tank(fish, 2, method, dt, make_water(density=fish.body.mass.sum() / (0.01 * fish.length**3)))
    for _ in range(round(fish.contraction_time / fish.control_interval)):
        tank.swim(np.stack([fish.sides, -fish.sides]), fish.control_interval)
    assert tank.alive.all()
    y = tank.position[:, :, 1]
    bend = 0.5 * (y[:, 1:5].mean(axis=1) + y[:, fish.tail].mean(axis=1)) - y[:, 5:13].mean(axis=1)
    assert bend[0] > 1e-3 * fish.length and bend[1] < -1e-3 * fish.length


@pytest.mark.parametrize("method", tiered(INTEGRATORS, ("leapfrog_chebyshev",)))
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


@pytest.mark.parametrize("name", tiered(FOUR, ("mass_spring", "planar")))
def test_mirrored_commands_mirror_the_path(name):
    """Left and right exchanged, a fish swims the mirror image of its path."""
    fish = fish_of(name)
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


def test_a_flat_fish_stays_flat():
    """No node of the flat fish leaves its plane; it can neither pitch nor roll nor chase a target in space."""
    fish = fish_of("planar")
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


@pytest.mark.soft
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


@pytest.mark.soft
@pytest.mark.parametrize("level", [1, 3])
def test_the_solid_is_as_stiff_in_bending_as_a_continuum(level):
    """The energy of pure bending, of elements that were softened, is half E I over the length, slice by slice."""
    from fish_env.soft.tetrahedral import make_mesh, softening

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


@pytest.mark.slow
@pytest.mark.soft
@pytest.mark.parametrize("level", [1, 2])
def test_a_bent_fish_swings_about_as_fast(level):
    """The first vibration keeps 95 % of its frequency when the tail swings 20 mm without water: no fibre buckles."""
    from fish_env.soft import statics

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


# Outlines

BARREL = [(0.0, 0.02, 0.03), (0.25, 0.07, 0.06), (0.6, 0.06, 0.09), (1.0, 0.01, 0.05)]  # blunt, without a peduncle
OUTLINED = [(name, None) for name in FOUR] + [("tetrahedral", 2)]


def parameters(**given):
    """Those of the default body, some of them replaced."""
    return tu.check_parameters("mass_spring", given)


def check_masses(body, level, outline, length):
    """Mass, centre and yaw inertia are those of ellipses, by quadrature of 20,000 slices."""
    options = {} if level is None else {"level": level}
    fish, table = make_fish(body, outline=outline, length=length, **options), read_outline(outline)
    s = length * (np.arange(20_000) + 0.5) / 20_000
    width, depth = (length * np.interp(s / length, table.place, part) for part in (table.widths, table.depths))
    slices = 1000.0 * np.pi * width * depth * length / s.size
    found = moments(fish.body.mass, fish.body.position)
    centre = slices @ s / slices.sum()
    yaw = slices @ ((s - centre) ** 2 + width**2 / 4)
    assert (found.mass, -found.centre, inertia(found)[2]) == pytest.approx((slices.sum(), centre, yaw), rel=1e-5)
    assert fish.body.mass.min() > 0.0
    return fish


@pytest.mark.parametrize(("body", "level"), rows(OUTLINED))
@pytest.mark.parametrize("outline", ["trout", BARREL], ids=["trout", "barrel"])
def test_masses_follow_the_outline(body, level, outline):
    """Every body has them; of the solid ones roll and pitch too. Landmarks are where those of the default body are."""
    fish = check_masses(body, level, outline, 0.25)
    wanted = inertia(masses.continuum(parameters(outline=outline, length=0.25)))
    if body in ("two_layer", "tetrahedral"):
        found = inertia(moments(fish.body.mass, fish.body.position))
        np.testing.assert_allclose(found, wanted, rtol=1e-8)
    default = make_fish(outline=outline, length=0.25)
    np.testing.assert_allclose(fish.points(fish.body.position), default.body.position, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("body", "level"), rows([*OUTLINED[:2], *OUTLINED[3:]]))
@settings(max_examples=5)
@given(
    count=st.integers(2, 12), bulge=st.floats(0.5, 1.5), depth=st.floats(0.05, 0.15), narrow=st.floats(0.3, 1.0),
    tail=st.floats(0.02, 0.15), seed=st.integers(0, 99),
)  # fmt: skip
def test_masses_follow_any_outline(body, level, count, bulge, depth, narrow, tail, seed):
    """Also where the stations are few, many or nowhere near the layers."""
    inside = np.sort(np.random.default_rng(seed).uniform(0.02, 0.98, count))
    half = depth * np.sin(np.pi * inside**bulge) + 0.01
    table = np.array([(0, 0, 0), *zip(inside, narrow * half, half, strict=True), (1, 0, tail)])
    check_masses(body, level, table, 0.2)


def test_trout():
    """It has a trout's mass and tail fin; its last layer stands in its peduncle, unless layers are given."""
    p = parameters(outline="trout")
    assert 0.0107 < masses.continuum(p).mass / (1000.0 * p.length**3) < 0.0110
    assert p.tail_half_span == pytest.approx(0.5 * 0.18 * 20.0**1.05 / 20.0, rel=1e-3)  # Webb 1984, cm
    narrowest = outline_of(p).place[5:][np.argmin(outline_of(p).depths[5:])] / p.length
    assert p.layer_position == (*tu.calibrated()["layer_position"][:4], narrowest)
    assert parameters(outline=BARREL).layer_position == tuple(tu.calibrated()["layer_position"])
    assert parameters(outline="trout", layer_position=(0.2, 0.4, 0.5, 0.7, 0.9)).layer_position[4] == 0.9


@pytest.mark.parametrize("body", tiered(FOUR, "all"))
def test_trout_swims(body):
    """With three times the stiffness, two seconds of the best gait's strokes carry every body forward."""
    own = read_calibration("tetrahedral") if body == "tetrahedral" else {"parameters": tu.calibrated()}
    stiffer = {"young": tuple(3.0 * np.array(own["young"]))} if "young" in own else {}
    fish = make_fish(body, outline="trout", stiffness=tuple(3.0 * np.array(own["parameters"]["stiffness"])), **stiffer)
    tank, gait = Tank(fish, 1, water=fish.water), replace(best_gait(), frequency=3.5)
    for k in range(100):
        tank.swim(gait.action(fish, np.array(0.02 * (k + 1))), 0.02)
    assert tank.alive[0] and tank.position[0, fish.nose, 0] > 0.8 * fish.length


@pytest.mark.soft
def test_finer_meshes_follow_the_outline():
    """Between layers too: the volume inside a mesh tends to that of the outline, from below where it bulges."""
    p = parameters(outline="trout")
    off = []
    for level in (1, 2, 4):
        body = make_fish("tetrahedral", outline="trout", level=level).body
        off.append(body.tets.volume.sum() * 1000.0 / masses.continuum(p).mass - 1.0)
    assert -0.15 < off[0] < 3 * off[1] < 9 * off[2] < 0.0 and off[2] > -0.01, off
    middle = np.unique(body.position[:, 0])[10]  # behind it the fin, whose sides tend to the half axes
    place, high = -middle, body.position[body.position[:, 0] == middle, 2].max()
    whole = outline_of(p)
    assert (2.0 * high) ** 2 * whole.half_width(place) / whole.half_depth(place) == pytest.approx(whole.area(place))


@pytest.mark.parametrize(
    ("outline", "text"),
    [
        ("eel", r"unknown outline 'eel'; choose 'trout' or give a table of stations, shape \(S, 3\)"),
        (0.2, r"outline has shape \(\); give shape \(4, 3\)"),
        (np.ones((5, 2)), r"outline has shape \(5, 2\); give shape \(5, 3\)"),
        ([BARREL[0], (0.2, 0.1), *BARREL[2:]], r"outline is .*; give finite numbers of shape \(4, 3\)"),
        ([*BARREL[:3], (1.0, 0.0, np.nan)], r"outline is nan at \(3, 2\); give finite numbers"),
        (BARREL[::-1], r"outline has the places \[1.0, .*; give increasing ones, from 0 \(nose\) to 1 \(tail\)"),
        ([*BARREL[:3], BARREL[2], BARREL[3]], "outline has the places .*; give increasing ones"),
        ([*BARREL[:2], (0.6, -0.06, 0.09), BARREL[3]], "outline has the half width -0.06 at place 0.6; its sides must"),
        ([*BARREL[:2], (0.6, 0.0, 0.09), BARREL[3]], "outline has no half width at place 0.6; there must be a volume"),
        ([*BARREL[:3], (1.0, 0.01, 0.0)], "outline has no half depth at place 1; give that of the tail fin's tips"),
    ],
    ids=str,
)  # fmt: skip
def test_outlines_that_are_refused(outline, text):
    """In one line that says what is allowed."""
    with pytest.raises(ValueError, match=text) as refused:
        make_fish(outline=outline)
    assert "\n" not in str(refused.value)


def test_an_outline_is_given_once():
    """Not beside the half depths that it has; nor to the published fish, whose masses were published."""
    with pytest.raises(ValueError, match="half_depth and an outline, which has it, are both given; give one of them"):
        make_fish("planar", outline="trout", half_depth=(0.1,) * 5)
    with pytest.raises(ValueError, match="the published fish has no parameter 'outline'"):
        make_fish("published", outline="trout")


# Fish of other lengths: the same tissue, slower muscles


@pytest.mark.parametrize("body", tiered(FOUR, "all"))
@pytest.mark.parametrize("length", MEANT)
def test_the_tissue_is_the_same(body, length):
    """Moduli, pressures, relaxation times and densities are; so vibrations take as many times as long as it is long."""
    fish, other = fish_of(body), make_fish(body, length=length)
    ratio = length / fish.length
    for power, part in ((3, "mass"), (1, "position")):
        np.testing.assert_allclose(getattr(other.body, part), ratio**power * getattr(fish.body, part), rtol=1e-9)
    for power, part in ((1, "stiffness"), (1, "damping"), (1, "rest_length")):
        found, own = (getattr(body.springs, part) for body in (other.body, fish.body))
        np.testing.assert_allclose(found, ratio**power * own, rtol=1e-12)
    np.testing.assert_array_equal(other.contracted, fish.contracted)
    if body == "tetrahedral":
        for part in ("shear", "dilation", "relaxation_time"):
            found, own = (getattr(body.tets, part) for body in (other.body, fish.body))
            np.testing.assert_allclose(found, own, rtol=1e-9)  # softened by quotients of integrals
    if body == "two_layer":
        np.testing.assert_array_equal(other.body.compartments.ambient, fish.body.compartments.ambient)
        np.testing.assert_allclose(other.body.barriers.energy, ratio**3 * fish.body.barriers.energy)
    found, own = (np.sqrt(each.body.max_stiffness_eigenvalue) for each in (other, fish))
    assert found == pytest.approx(own / ratio, rel=1e-6) and own > 1.0


@pytest.mark.parametrize("body", tiered(FOUR, "all"))
@pytest.mark.parametrize("length", ALLOWED)
@pytest.mark.filterwarnings("ignore:a fish of")
def test_the_ends_of_the_range_swim(body, length):
    """A second of square waves from side to side, a few contractions long each, leaves the fish sound and moving.

    Full contractions, held as long, fold the two skins of a fish of 0.6 m and more, which is soft for its length.
    """
    fish = make_fish(body, length=length)
    assert fish.contraction_time == pytest.approx(make_fish().contraction_time * (length / 0.2) ** SLOWNESS)
    tank = Tank(fish, 1, water=fish.water)
    steps, half = round(fish.control_interval / tank.dt), max(1, round(2 * fish.contraction_time / 0.02))
    assert steps * tank.dt == pytest.approx(fish.control_interval, rel=1e-12)
    strength = 0.6 if body == "two_layer" else 1.0
    for k in range(50):
        tank.drive(strength * np.where(fish.sides > 0, k // half % 2, 1 - k // half % 2).astype(float)[None], steps)
    assert tank.alive[0] and np.abs(tank.position[0] - fish.body.position).max() > 0.01 * length


def test_lengths_out_of_range():
    """They are warned of, or refused, saying what is allowed; times that are given are kept at every length."""
    with pytest.warns(
        UserWarning, match=r"a fish of 1 m is outside the range in which the model is meant, 0\.05 to 0\.6"
    ):
        make_fish(length=1.0)
    for length in (0.019, 1.1, 1e300):
        with pytest.raises(ValueError, match=r"length is .* m; give 0\.02 to 1 m, best 0\.05 to 0\.6 m"):
            make_fish("planar", length=length)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fish = make_fish(length=0.05, contraction_time=0.05, time_step=0.001)
    assert (fish.contraction_time, fish.time_step) == (0.05, 0.001)
    slower = make_fish(length=0.4).contraction_time / make_fish().contraction_time
    assert slower == pytest.approx(2.0**SLOWNESS)


# Topology of the published fish

LEFT_MUSCLES = [[(1, 5), (4, 8)], [(5, 9), (8, 12)], [(9, 13), (12, 16)]]
RIGHT_MUSCLES = [[(2, 6), (3, 7)], [(6, 10), (7, 11)], [(10, 14), (11, 15)]]


@pytest.fixture(params=naive.TU)
def fish(request):
    """Each body of the table."""
    return make_fish(request.param)


def pair_set(pairs):
    """Pairs of nodes without order."""
    return {tuple(sorted(map(int, pair))) for pair in pairs}


def test_counts():
    """There are 23 nodes, 91 units (46 cross, 12 muscles, 33 others) and 24 faces, four to each of six segments."""
    pairs, classes, sections, faces = topology()
    assert len({node for layer in LAYERS for node in layer}) == 23 == pairs.max() + 1
    assert len(pair_set(pairs)) == len(pairs) == len(sections) == 91
    assert Counter(classes.tolist()) == {CROSS: 46, MUSCLE: 12, OTHER: 33}
    assert faces.shape == (24, 4)
    for fish in map(make_fish, naive.TU):
        assert len(fish.body.mass) == 23
        np.testing.assert_array_equal(fish.body.springs.nodes, pairs)
        np.testing.assert_array_equal(fish.body.faces.nodes, faces)


def test_muscles(fish):
    """The twelve muscles are the straight links of the three segments, two a side, with their segment and side."""
    nodes = fish.body.springs.nodes[fish.muscles]
    for segment in range(3):
        for side, wanted in ((1, LEFT_MUSCLES), (-1, RIGHT_MUSCLES)):
            chosen = (fish.segments == segment) & (fish.sides == side)
            assert pair_set(nodes[chosen]) == set(wanted[segment])
    assert fish.num_muscles == len(set(fish.muscles.tolist())) == 12


def test_cross_units():
    """Cross units are the diagonals: of the squares, of the faces between them and of the tail fin."""
    pairs, classes, _, _ = topology()
    wanted = set()
    for layer in LAYERS[1:6]:
        wanted |= {(layer[0], layer[2]), (layer[1], layer[3])}
    for here, behind in pairwise(LAYERS[1:6]):
        wanted |= {(here[k], behind[(k + step) % 4]) for k in range(4) for step in (1, -1)}
    wanted |= {(17, 22), (18, 22), (19, 21), (20, 21)}
    assert pair_set(pairs[classes == CROSS]) == wanted


def test_only_space_diagonals_are_left_out():
    """All pairs inside a layer and between neighbouring layers are units, but for the 16 space diagonals."""
    pairs, _, _, _ = topology()
    near = {pair for layer in LAYERS for pair in combinations(layer, 2)}
    near |= {(i, j) for here, behind in pairwise(LAYERS) for i in here for j in behind}
    diagonals = {(here[k], behind[(k + 2) % 4]) for here, behind in pairwise(LAYERS[1:6]) for k in range(4)}
    assert len(diagonals) == 16
    assert near - pair_set(pairs) == diagonals
    assert pair_set(pairs) <= near


def test_band_and_skyline(fish):
    """The system matrix has half-bandwidth 7 and 126 stored entries, and every unit knows its own."""
    pairs, profile = fish.body.springs.nodes, fish.body.profile
    assert np.abs(pairs[:, 0] - pairs[:, 1]).max() == 7
    assert profile.start[-1] == 126
    where = {(i, j): profile.start[i] + j - profile.first[i] for i in range(23) for j in range(profile.first[i], i)}
    assert [where[max(i, j), min(i, j)] for i, j in pairs] == fish.body.springs.entry.tolist()


def test_six_zero_modes(fish):
    """The units make the body rigid: the linearised stiffness has the six motions of a rigid body and no other."""
    values = np.linalg.eigvalsh(naive.stiffness_matrix(fish.body))
    assert np.count_nonzero(values < 1e-12 * values[-1]) == 6
    assert values[6] > 1e-6 * values[-1]


def test_mirror_symmetry(fish):
    """Exchanging left and right leaves positions, masses (to their last digit), units and the faces as they are."""
    body, mirror = fish.body, fish.mirror
    np.testing.assert_array_equal(mirror[mirror], np.arange(23))
    np.testing.assert_array_equal(body.position[mirror], body.position * [1, -1, 1])
    np.testing.assert_allclose(body.mass[mirror], body.mass, rtol=1e-15)
    springs = body.springs
    units = {
        frozenset(map(int, pair)): values
        for pair, *values in zip(springs.nodes, springs.stiffness, springs.damping, springs.rest_length, strict=True)
    }
    for pair, values in units.items():
        assert units[frozenset(int(mirror[i]) for i in pair)] == pytest.approx(values, rel=1e-15)

    def cycle(nodes):
        start = nodes.index(min(nodes))
        return tuple(nodes[start:] + nodes[:start])

    outward = {cycle([int(i) for i in naive.polygon(face)]) for face in body.faces.nodes}
    reflected = {cycle([int(mirror[i]) for i in naive.polygon(face)][::-1]) for face in body.faces.nodes}
    assert reflected == outward


def test_surface_is_closed(fish):
    """Every edge is shared by two faces that run along it in opposite directions, and all look outward."""
    edges = Counter()
    for face in fish.body.faces.nodes:
        nodes = naive.polygon(face)
        edges.update(zip(nodes, nodes[1:] + nodes[:1], strict=True))
    assert set(edges.values()) == {1}
    assert {(j, i) for i, j in edges} == set(edges)
    areas = np.array([naive.area_vector(fish.body.position[face]) for face in fish.body.faces.nodes])
    assert np.abs(areas.sum(axis=0)).max() <= 1e-14 * np.abs(areas).sum()
    assert naive.enclosed_volume(fish.body.faces, fish.body.position) > 0


def test_shares():
    """The corners of a face carry all of its force: quarters, or thirds for the three nodes of a triangle."""
    body = make_fish("published").body
    np.testing.assert_allclose(body.faces.share, [naive.shares(face) for face in body.faces.nodes], rtol=1e-15)
    for face, share in zip(body.faces.nodes, body.faces.share, strict=True):
        carried = [share[face == node].sum() for node in naive.polygon(face)]
        np.testing.assert_allclose(carried, 1 / len(carried), rtol=1e-15)


@pytest.mark.parametrize("length", [0.05, 0.2, 0.6])
def test_neutral_buoyancy(length):
    """A fish of any length weighs as much as the water it displaces: 1000 kg/m3 times the enclosed volume.

    Where its sections are rectangles: flat faces cut off a part of elliptic ones, whose mass is in `test_bodies.py`.
    """
    body = make_fish("mass_spring", length=length, water="drag").body
    displaced = 1000.0 * naive.enclosed_volume(body.faces, body.position)
    assert body.mass.sum() == pytest.approx(displaced, rel=1e-12)


def test_deeper_than_wide():
    """The default fish is deeper than wide at every layer, as long as asked, and its tail ends in a vertical edge."""
    fish = make_fish("mass_spring", length=0.3)
    for layer in LAYERS[1:]:
        width, depth = np.ptp(fish.body.position[layer, 1]), np.ptp(fish.body.position[layer, 2])
        assert depth > width
    assert np.ptp(fish.body.position[:, 0]) == pytest.approx(0.3, rel=1e-15) == fish.length
    assert np.ptp(fish.body.position[fish.tail, 1]) == 0 and fish.body.position[fish.nose, 0] == 0


def test_published_constants():
    """The published body has the published masses, stiffness by class and viscosity."""
    body = make_fish("published").body
    _, classes, _, _ = topology()
    assert body.mass.sum() == pytest.approx(107.03, rel=1e-14)
    assert Counter(body.mass.tolist()) == {1.1: 9, 6.6: 8, 11.0: 4, 0.165: 2}
    for kind, stiffness in ((CROSS, 38.0), (MUSCLE, 28.0), (OTHER, 30.0)):
        assert set(body.springs.stiffness[classes == kind]) == {stiffness}
    assert set(body.springs.damping) == {0.1}
