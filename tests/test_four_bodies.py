"""The same fish on four bodies: built alike, moved by every method that can, seen and driven alike.

What the elements do by themselves is in test_elements.py, what every method does with them in test_every_method.py;
every method on every body, which takes long to compile, is behind `pytest -m slow`.
"""

import gymnasium as gym
import naive
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from moving import tiered

from fish_env import BODIES, INTEGRATORS, Tank, make_fish
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.masses import outline
from fish_env.bodies.tetrahedral import meshed, softening
from fish_env.physics import statics
from fish_env.physics.failures import FAILURES
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import adaptive
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import VACUUM

FOUR = ("mass_spring", "planar", "two_layer", "tetrahedral")
FISH = {name: make_fish(name) for name in FOUR}
QUICK = ("leapfrog_chebyshev",)
each_body = pytest.mark.parametrize("name", FOUR)
two_bodies = pytest.mark.parametrize("name", tiered(FOUR, ("planar", "mass_spring")))
"""For what the elements of the other bodies, and worlds without water, are compiled for once more."""
each_pair = pytest.mark.parametrize(
    ("name", "method"),
    [
        pytest.param(name, method, marks=() if method in QUICK and name == "planar" else pytest.mark.slow)
        for name in FOUR
        for method, record in INTEGRATORS.items()
        if record.kind != "adaptive" and not (method == "explicit_euler" and name != "planar")
    ],
)
"""Explicit Euler's stable step is so short on the others that a beat takes minutes; test_every_method.py has it."""


def deformed(fish, rng, displacement=0.001, speed=0.3):
    """A deformed, moving fish, turned about z; a flat one stays flat."""
    free = fish.body.inverse_mass > 0.0
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    x = (fish.body.position + displacement * fish.length * rng.uniform(-1, 1, free.shape) * free) @ turn.T
    return x, speed * fish.length / fish.contraction_time * rng.uniform(-1, 1, free.shape) * free


def test_the_table_has_all():
    """The four bodies and the published one are listed."""
    assert set(BODIES) == {*FOUR, "published"}


@each_body
def test_built_alike(name):
    """Mass, length, muscles and landmarks are those of the default fish; left is left, and mirrors are mirrors."""
    fish, default = FISH[name], FISH["mass_spring"]
    assert fish.name == name and fish.body.mass.sum() == pytest.approx(default.body.mass.sum(), rel=1e-12)
    assert np.ptp(fish.body.position[:, 0]) == pytest.approx(fish.length, rel=1e-12)
    np.testing.assert_array_equal(fish.sides, default.sides)
    np.testing.assert_array_equal(fish.segments, default.segments)
    np.testing.assert_array_equal(np.sign(fish.heights), np.sign(default.heights))
    np.testing.assert_array_equal(fish.mirrored_muscles, default.mirrored_muscles)
    np.testing.assert_allclose(fish.points(fish.body.position), default.body.position, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(fish.landmarks.faces, default.landmarks.faces)
    np.testing.assert_allclose(fish.body.position[fish.mirror] * (1, -1, 1), fish.body.position, rtol=0, atol=1e-12)
    assert (fish.body.position[fish.left, 1] > 0).all() and (fish.body.position[fish.right, 1] < 0).all()
    np.testing.assert_array_equal(fish.mirror[fish.left], fish.right)
    for fibre, (upper, lower) in zip(fish.fibres, fish.drives, strict=True):
        ends = fish.body.springs.nodes[fibre]
        assert (np.sign(fish.body.position[ends, 1]) == fish.sides[upper]).all()
        assert fish.sides[upper] == fish.sides[lower] and fish.segments[upper] == fish.segments[lower]
    assert set(fish.drives.ravel()) == set(range(12)) and set(fish.muscles) <= set(fish.fibres)
    still = np.zeros_like(fish.body.position)
    f = Evaluator(fish.body, VACUUM).force(fish.body.springs.rest_length, fish.body.position, still)
    assert np.abs(f).max() <= 1e-12 * fish.body.springs.stiffness.max() * fish.length


@each_body
def test_force_equals_its_reference(name):
    """The sum of all forces on a bent, moving fish in water is that of the slow reference implementations."""
    fish = FISH[name]
    x, v = deformed(fish, np.random.default_rng(1))
    f = Evaluator(fish.body, fish.water).force(fish.body.springs.rest_length, x, v)
    if fish.flat:  # of an upright face: its upper corners are nodes of their own
        springs = fish.body.springs
        wanted = upright_water(fish, x, v) + naive.spring_force(springs, springs.rest_length, x, v)
    else:
        wanted = naive.total_force(fish.body, fish.water, fish.body.springs.rest_length, x, v)
    np.testing.assert_allclose(f, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


def upright_water(fish, x, v):
    """Force of the water (N,3) on upright faces, taken as ordinary ones between raised copies of the nodes."""
    total, faces = np.zeros_like(x), fish.body.faces
    for corners, share, factor, depth in zip(faces.nodes, faces.share, faces.drag, faces.depth, strict=True):
        raised = x[corners] + np.array([0, 0, depth, depth])[:, None] * (0, 0, 1)
        push = factor * naive.face_force(np.arange(4), share, fish.water, raised, v[corners])
        for node, part in zip(corners, share, strict=True):
            total[node] += part * push
    return total


@two_bodies
def test_derivatives(name):
    """The exact derivatives are the differences of the forces."""
    fish = FISH[name]
    x, v = deformed(fish, np.random.default_rng(2))
    rest, evaluator = fish.body.springs.rest_length, Evaluator(fish.body, fish.water)
    stiffness, damping = evaluator.jacobian(rest, x, v)

    def force(x, v):
        return evaluator.force(rest, x, v)

    wanted = naive.derivatives(force, x, v, 1e-6 * fish.length, 1e-6 * np.abs(v).max())
    np.testing.assert_allclose(stiffness, wanted[0], rtol=0, atol=1e-6 * np.abs(wanted[0]).max())
    np.testing.assert_allclose(damping, wanted[1], rtol=0, atol=1e-6 * np.abs(wanted[1]).max())


@each_pair
def test_order(name, method):
    """In vacuum the error of a driven fish falls with the method's order."""
    fish = FISH[name]
    x, v = deformed(fish, np.random.default_rng(3), 0.001, 0.05)
    rate, fibres = np.zeros(len(fish.body.springs.nodes)), np.unique(fish.fibres)
    rate[fibres] = fish.body.springs.rest_length[fibres] * 0.1 / fish.contraction_time
    finer = {"explicit_euler": 64, "midpoint": 4}.get(method, 16 if INTEGRATORS[method].order == 1 else 2)
    duration = 2.0 / np.sqrt(fish.body.max_stiffness_eigenvalue + fish.body.max_damping_eigenvalue**2)

    def end(integrator, n):
        tank = Tank(fish, 1, integrator, duration / n)
        tank.position[0], tank.velocity[0], tank.control.rate[0] = x, v, rate
        tank.advance(n)
        assert tank.alive[0]
        return np.concatenate([tank.position[0], duration * tank.velocity[0]])

    tank = Tank(fish, 1)
    tank.position[0], tank.velocity[0], tank.control.rate[0] = x, v, rate
    adaptive.solve(fish.body, tank.world, tank.state, tank.control, duration, "DOP853", 1e-13)
    assert tank.alive[0]
    exact = np.concatenate([tank.position[0], duration * tank.velocity[0]])
    steps = np.array([16, 32, 64]) * finer
    errors = [np.linalg.norm(end(method, int(n)) - exact) for n in steps]
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(order - INTEGRATORS[method].order) <= 0.15, f"order {order:.3f}, errors {errors}"


@each_pair
@pytest.mark.parametrize("task", ["Swim", "LeftAfterRight"])
def test_tasks_run(name, method, task):
    """A beat of a bang-bang manoeuvre in a task, at the step a method takes by itself: sound, and it moves the fish."""
    env = gym.make(f"FishEnv/{task}-v0", body=name, integrator=method)
    obs, _ = env.reset(seed=1)
    fish, first = FISH[name], obs
    for k in range(14):
        action = np.where((fish.sides > 0) == (k % 10 < 5), 1.0, -1.0).astype(np.float32)
        obs, reward, terminated, _, info = env.step(action)
        assert np.isfinite(obs).all() and np.isfinite(reward) and not terminated, info
    assert np.abs(obs[:69] - first[:69]).max() > 0.02
    env.close()


@two_bodies
def test_linear_momentum(name):
    """In vacuum the centre of mass of a shaken fish moves straight."""
    fish = FISH[name]
    tank = Tank(fish, 1)
    tank.position[0], tank.velocity[0] = deformed(fish, np.random.default_rng(5))
    mass = fish.body.mass
    before, start = mass @ tank.velocity[0], mass @ tank.position[0]
    tank.advance(300)
    assert tank.alive[0]
    size = mass @ np.linalg.norm(tank.velocity[0], axis=1)
    assert np.abs(mass @ tank.velocity[0] - before).max() <= 1e-11 * size
    np.testing.assert_allclose(mass @ tank.position[0] - start, 300 * tank.dt * before, rtol=0, atol=1e-10 * size)


@each_body
def test_batch_equals_one_by_one(name):
    """Three fish together move, bit for bit, as each alone; one that is broken does not touch the others."""
    fish, rng = FISH[name], np.random.default_rng(6)
    together = Tank(fish, 3, water=fish.water)
    alone = [Tank(fish, 1, water=fish.water) for _ in range(3)]
    actions = rng.uniform(-1, 1, (4, 3, 12))
    together.position[1] = np.nan
    for action in actions:
        together.swim(action, fish.control_interval)
        for one, command in zip(alone, action, strict=True):
            one.swim(command[None], fish.control_interval)
    assert together.alive.tolist() == [True, False, True]
    assert together.failure[1] == FAILURES[1] and np.isfinite(together.position).all()
    for i in (0, 2):
        np.testing.assert_array_equal(together.position[i], alone[i].position[0])


@each_body
def test_mirrored_commands_mirror_the_path(name):
    """Left and right exchanged, a fish swims the mirror image of its path."""
    fish = FISH[name]
    tanks = [Tank(fish, 1, water=fish.water) for _ in range(2)]
    for action in np.random.default_rng(7).uniform(-1, 1, (10, 12)):
        tanks[0].swim(action, fish.control_interval)
        tanks[1].swim(action[fish.mirrored_muscles], fish.control_interval)
    image = tanks[0].position[0, fish.mirror] * (1, -1, 1)
    assert np.abs(tanks[1].position[0] - image).max() <= 1e-9 * fish.length, np.abs(tanks[1].position[0] - image).max()
    assert np.abs(tanks[0].position[0] - image).max() > 1e-2 * fish.length


@two_bodies
def test_spaces_are_the_same(name):
    """Observations and actions have the shape and, at the start, nearly the numbers of the default fish."""
    env, default = (gym.make("FishEnv/Swim-v0", body=body) for body in (name, "mass_spring"))
    assert env.observation_space == default.observation_space and env.action_space == default.action_space
    pair = [one.reset(seed=3, options={"yaw": 0.3})[0] for one in (env, default)]
    np.testing.assert_allclose(pair[0][:69], pair[1][:69], rtol=0, atol=0.02)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_fibres_run_from_layer_to_layer(level):
    """At every level they are the default fish's springs along its four edges."""
    fish, default = make_fish("tetrahedral", level=level), FISH["mass_spring"]
    springs = fish.body.springs
    place = {int(node): k for k, node in enumerate(fish.landmarks.node)}
    pairs = {frozenset(place[int(node)] for node in pair) for pair in springs.nodes}
    assert len(pairs) == len(springs.nodes) == 24
    assert pairs < {frozenset(pair) for pair in default.body.springs.nodes.tolist()}
    muscles = {frozenset(place[int(node)] for node in pair) for pair in springs.nodes[fish.muscles]}
    assert muscles == {frozenset(pair) for pair in default.body.springs.nodes[default.muscles].tolist()}


@pytest.mark.parametrize("level", [1, 3])
def test_the_solid_is_as_stiff_in_bending_as_a_continuum(level):
    """The energy of pure bending, of elements that were softened, is half E I over the length, slice by slice."""
    poisson, p = 0.4, tu.MassSpringParameters(**tu.calibrated())
    mesh, section = meshed(p, level)
    factor = softening(mesh, section, poisson)
    assert ((factor > 0) & (factor < 1)).all()
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
    _, width, depth = (np.interp(share, np.arange(7), row) for row in outline(p))
    slices = 0.5 * 4 / 3 * width**3 * depth * np.repeat(np.abs(np.diff(outline(p)[0])), 1000) / 1000
    np.testing.assert_allclose(energy, slices.reshape(6, 1000).sum(axis=1), rtol=1e-5)


def test_finer_meshes_are_softened_less():
    """The factors tend to 1 as the mesh is refined."""
    p = tu.MassSpringParameters(**tu.calibrated())
    factors = [softening(*meshed(p, level), 0.4) for level in (1, 2, 4)]
    assert (factors[0] < factors[1]).all() and (factors[1] < factors[2]).all() and factors[2].max() > 0.75


@pytest.mark.parametrize(("level", "kept"), [(1, 0.87), (2, 0.9)])
def test_a_bent_fish_swings_about_as_fast(level, kept):
    """The first vibration keeps nine tenths of its frequency when the tail swings 20 mm: no fibre buckles.

    The coarsest mesh, whose elements are softened most, keeps a little less.
    """
    fish = make_fish("tetrahedral", level=level)
    frequencies, shapes = statics.modes(fish.body, count=10)
    sideways = np.einsum("n,cn->c", fish.body.mass, shapes[:, :, 1] ** 2) > 0.5
    first = np.flatnonzero(sideways & (frequencies > 0.1))[0]  # before it are rigid motions
    shape = shapes[first] / shapes[first][fish.tail, 1].mean()
    tank, tail = Tank(fish, 1), []
    tank.position[0] += 0.02 * shape
    share, still = fish.body.mass / fish.body.mass.sum(), np.zeros((1, fish.num_muscles))
    while len(tail) * tank.dt < 0.6:
        tank.drive(still, 1)
        tail.append(tank.position[0, fish.tail, 1].mean() - share @ tank.position[0, :, 1])
    assert tank.alive[0]
    tail = np.array(tail)
    down = np.flatnonzero((tail[:-1] > 0) & (tail[1:] <= 0))
    crossing = (down + tail[down] / (tail[down] - tail[down + 1])) * tank.dt
    assert 1.0 / np.diff(crossing).mean() > kept * frequencies[first]


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


def test_square_waves_break_no_two_layers():
    """Left against right at 5 Hz, from side to side at once, for two seconds: the inner layer stays inside."""
    env = gym.make("FishEnv/Swim-v0", body="two_layer")
    env.reset(seed=0)
    for k in range(100):
        action = FISH["two_layer"].sides * np.sign(np.sin(0.2 * np.pi * (k + 0.5)))
        _, _, terminated, _, info = env.step(action.astype(np.float32))
        assert not terminated, info
    env.close()


def test_harsh_commands_break_no_body():
    """Random square waves on every muscle for two seconds leave every fish sound, its inner layer inside."""
    for name in FOUR:
        fish = FISH[name]
        tank, rng = Tank(fish, 8, water=fish.water), np.random.default_rng(9)
        command = np.zeros((8, 12))
        for _ in range(100):
            command = np.where(rng.random((8, 12)) < 0.15, rng.integers(0, 2, (8, 12)), command)
            tank.drive(command, round(fish.control_interval / tank.dt))
        assert tank.alive.all(), (name, tank.failure)


@pytest.mark.parametrize(
    ("body", "parameters", "text"),
    [
        ("planar", {"level": 1}, "unknown parameter 'level' of the planar fish; choose from length"),
        ("planar", {"bending": [1.0] * 4}, r"bending has shape \(4,\); give shape \(5,\)"),
        ("planar", {"weight": 1.0}, "unknown parameter 'weight' of the planar fish; choose from length"),
        ("tetrahedral", {"level": 0}, "level is 0; give a whole number from 1 to 4"),
        ("tetrahedral", {"poisson": 0.5}, "poisson is 0.5 in element 0; give numbers above -1 and below 0.5"),
        ("tetrahedral", {"lumping": "thirds"}, "unknown rule 'thirds'; choose from 'matched', 'quarter', 'uniform'"),
        ("two_layer", {"inner_size": 1.0}, "inner_size is 1.0; give a number between 0 and 1"),
        ("two_layer", {"inner_mass": 0.0}, "inner_mass is .*; give"),
        ("two_layer", {"pressure": -1.0}, r"pressures \(Pa\) is -1.0 at \(0,\); give positive numbers"),
    ],
)
def test_refuses(body, parameters, text):
    """What a body cannot be made of is refused."""
    with pytest.raises(ValueError, match=text):
        make_fish(body, **parameters)


def test_own_steps():
    """Every method but the adaptive ones has a step of its own on every body, a whole part of the control interval."""
    for fish in FISH.values():
        for record in INTEGRATORS.values():
            if record.kind != "adaptive":
                steps = fish.control_interval / own_step(fish, record)
                assert steps == pytest.approx(round(steps), rel=1e-9) and steps >= 1
