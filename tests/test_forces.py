"""Forces against their reference implementations, against energy, and against what is known of them by theory."""

import naive
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from kernels import Block, energy, force

from fish_env import make_fish, make_water
from fish_env.physics.body import make_body
from fish_env.physics.failures import STRETCH_LIMIT
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.forces.springs import MOST_COMPRESSED
from fish_env.physics.records import World
from fish_env.physics.world import VACUUM

LAWS = ("quadratic", "linear")
FISH = {name: make_fish(name) for name in naive.TU}
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
seeds = st.integers(0, 2**32 - 1)
bodies = st.sampled_from(list(naive.TU))


def plate(corners, faces=((0, 1, 2, 3),)):
    """A surface without springs."""
    return make_body(corners, np.ones(len(corners)), [], [], [], [], faces)


def world_of(fish, law="quadratic", current=(0.3, -0.2, 0.1)):
    """The water of `naive.dense_water` as the kernels take it."""
    return World(*naive.dense_water(fish, law, current))


def close(actual, wanted, tolerance=1e-12):
    """Equal up to `tolerance` times the largest element."""
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())


@given(seeds, bodies)
def test_springs_equal_their_reference(seed, name):
    """Spring forces and energy on a random state, with random rest lengths, equal the textbook formulas."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng)
    rest = fish.body.springs.rest_length * rng.uniform(0.7, 1.3, 91)
    close(force("springs", fish.body, VACUUM, x, v, rest), naive.spring_force(fish.body.springs, rest, x, v))
    wanted = naive.spring_energy(fish.body.springs, rest, x)
    assert energy("springs", fish.body, VACUUM, x, rest) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
@given(seed=seeds, name=bodies)
def test_water_equals_its_reference(law, seed, name):
    """Water forces on a random state in a current equal the textbook formulas, face by face."""
    fish = FISH[name]
    world = world_of(fish, law)
    x, v = naive.random_state(fish, np.random.default_rng(seed))
    close(force("water", fish.body, world, x, v), naive.water_force(fish.body.faces, world, x, v))


@pytest.mark.parametrize("name", naive.TU)
def test_total_is_the_sum(name):
    """The total force is the springs' plus the water's, whatever was evaluated before."""
    fish, rng = FISH[name], np.random.default_rng(1)
    rest, world = fish.body.springs.rest_length, world_of(fish)
    evaluator = Evaluator(fish.body, world)
    for _ in range(2):
        x, v = naive.random_state(fish, rng)
        close(evaluator.force(rest, x, v), naive.total_force(fish.body, world, rest, x, v))


@pytest.mark.parametrize("name", naive.TU)
def test_cached_total_is_the_total(name):
    """The sum that keeps what the filtered leapfrog needs is the total force; its change is that of a new velocity.

    In a step of no duration nothing of a face's own drag is taken implicitly.
    """
    fish, rng = FISH[name], np.random.default_rng(15)
    x, v = naive.random_state(fish, rng)
    world, block = world_of(fish), Block(None, fish.body, world_of(fish), h=0.0)
    found = block.set(x, v).add("add_force_cached", "add_force")
    close(found, naive.total_force(fish.body, world, fish.body.springs.rest_length, x, v))
    later = v + 0.1 * rng.normal(size=v.shape) * np.abs(v).max()
    change = naive.water_force(fish.body.faces, world, x, later) - naive.water_force(fish.body.faces, world, x, v)
    close(block.add("add_change", v=later), change)


@pytest.mark.parametrize("name", naive.TU)
def test_tangent_is_the_stiffness(name):
    """What resists a step's acceleration is FACTOR (h^2 K + 2 h D), or LEAST h D where that is more.

    K is that of the derivative of the elastic force, the strain across no less than MOST_COMPRESSED.
    """
    fish, rng, h = FISH[name], np.random.default_rng(16), 0.01 * FISH[name].contraction_time
    body, springs = fish.body, fish.body.springs
    x, v = naive.random_state(fish, rng, displacement=0.002)
    rest, y = springs.rest_length * rng.uniform(0.95, 1.05, 91), rng.normal(size=x.shape)
    rest[0] *= 1.5
    ends = x[springs.nodes[:, 1]] - x[springs.nodes[:, 0]]
    strain = 1.0 - rest / np.linalg.norm(ends, axis=1)
    assert strain[0] < MOST_COMPRESSED < strain[1:].min()
    for factor, least in ((1.5, 0.0), (1e-9, 0.7)):
        block = Block(("springs",), body, VACUUM, rest_length=rest, h=h, factor=factor, least=least)
        block.set(x, v).add("add_force_cached")
        wanted = np.zeros_like(y)
        for e, (i, j) in enumerate(springs.nodes):
            n = ends[e] / np.linalg.norm(ends[e])
            elastic, viscous = factor * h**2 * springs.stiffness[e], h * springs.damping[e]
            across = elastic * max(strain[e], MOST_COMPRESSED)
            along = np.outer(n, n) * (max(elastic + 2 * factor * viscous, least * viscous) - across)
            pull = (along + across * np.eye(3)) @ (y[j] - y[i])
            wanted[i] += pull
            wanted[j] -= pull
        close(block.add("add_tangent", v=y), wanted)


@pytest.mark.parametrize("name", naive.TU)
def test_elastic_force_is_minus_gradient_of_energy(name):
    """Without damping the force on each node is minus the gradient of the elastic energy (central differences)."""
    fish, rng = FISH[name], np.random.default_rng(2)
    body = fish.body._replace(springs=fish.body.springs._replace(damping=np.zeros(91)))
    rest = body.springs.rest_length * rng.uniform(0.7, 1.3, 91)
    x, v = naive.random_state(fish, rng)
    step = 1e-3 * body.springs.rest_length.min()
    gradient = np.zeros_like(x)
    for place in np.ndindex(x.shape):
        for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):  # fourth order
            moved = x.copy()
            moved[place] += shift * step
            gradient[place] += weight * energy("springs", body, VACUUM, moved, rest) / step
    close(force("springs", body, VACUUM, x, v, rest), -gradient, 1e-9)


# Derivatives


@pytest.mark.parametrize(
    ("part", "law"), [("springs", LAWS[0]), *(("water", law) for law in LAWS), *(("total", law) for law in LAWS)]
)
@pytest.mark.parametrize("name", naive.TU)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_derivatives(part, law, name, seed):
    """The exact derivatives are the differences of the textbook forces, of units and water alone and of both."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng)
    rest = fish.body.springs.rest_length * rng.uniform(0.7, 1.3, 91)
    world = VACUUM if part == "springs" else world_of(fish, law)
    body = fish.body
    if part == "water":
        body = body._replace(springs=body.springs._replace(stiffness=np.zeros(91), damping=np.zeros(91)))
    stiffness, damping = Evaluator(body, world).jacobian(rest, x, v)
    textbook = {
        "springs": lambda x, v: naive.spring_force(body.springs, rest, x, v),
        "water": lambda x, v: naive.water_force(body.faces, world, x, v),
        "total": lambda x, v: naive.total_force(body, world, rest, x, v),
    }[part]
    wanted = naive.derivatives(textbook, x, v, 1e-5 * fish.length, 1e-5 * np.abs(v).max())
    close(stiffness, wanted[0], 1e-6)
    close(damping, wanted[1], 1e-6)
    assert part == "springs" or np.abs(stiffness - stiffness.T).max() > 1e-3 * np.abs(stiffness).max()


def test_inward_faces_have_no_derivative():
    """A face that moves inward changes nothing in the forces around it."""
    outward = make_body(SQUARE, np.ones(4), [], [], [], [], [(0, 1, 2, 3)])
    world, v = make_water(), np.zeros((4, 3))
    for speed, found in ((1.0, True), (-1.0, False)):
        v[:, 2] = speed
        stiffness, damping = Evaluator(outward, world).jacobian(np.zeros(0), SQUARE, v)
        assert (stiffness.any(), damping.any()) == (found, found)


@given(seeds, bodies)
def test_system_is_the_symmetric_part(seed, name):
    """The assembled h D + h^2 K is that of the exact derivatives of the units, less what turns with the velocities.

    Of the stiffness that is k n (P u)^T/|r|: nothing where nothing moves or nothing is damped.
    """
    fish, rng, h = FISH[name], np.random.default_rng(seed), 0.37
    x, v = naive.random_state(fish, rng)
    rest = fish.body.springs.rest_length * rng.uniform(0.7, 1.3, 91)
    still = np.zeros_like(v)
    evaluator = Evaluator(fish.body, VACUUM)
    stiffness, damping = evaluator.jacobian(rest, x, still)
    close(damping, damping.T)
    close(stiffness, stiffness.T)
    block = Block(None, fish.body, VACUUM, rest_length=rest, h=0.0, inner=h)
    close(block.set(x, still).matrix("add_system"), h * damping + h**2 * stiffness)
    moving, damping = evaluator.jacobian(rest, x, v)
    turning = np.zeros((23, 3, 23, 3))
    for (i, j), k in zip(fish.body.springs.nodes, fish.body.springs.damping, strict=True):
        r, u = x[j] - x[i], v[j] - v[i]
        n = r / np.linalg.norm(r)
        term = k * np.outer(n, u - n * (n @ u)) / np.linalg.norm(r)
        for p, q, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            turning[p, :, q] += sign * term
    wanted = h * damping + h**2 * (moving - turning.reshape(69, 69))
    close(block.set(x, v).matrix("add_system"), wanted)


@given(seeds, bodies, st.sampled_from(LAWS))
def test_assembled_matrices_equal_their_reference(seed, name, law):
    """K and D of every linearly implicit method, projected or not, with and without the water, as the textbook's."""
    fish, rng, h = FISH[name], np.random.default_rng(seed), 0.37
    x, v = naive.random_state(fish, rng)
    rest, world = fish.body.springs.rest_length * rng.uniform(0.7, 1.3, 91), world_of(fish, law)
    for projected, wet in ((False, False), (True, False), (False, True)):
        stiffness, damping = naive.implicit_matrices(fish.body, world, rest, x, v, projected, wet)
        block = Block(None, fish.body, world, rest_length=rest, h=h, lowest=0.0 if projected else -np.inf).set(x, v)
        found = block.matrix("add_system") + (block.matrix("add_damping") if wet else 0.0)
        close(found, h * damping + h**2 * stiffness)
        y = rng.normal(size=(23, 3))
        close(block.add("add_tangent", v=y).ravel(), -stiffness @ y.ravel())


@given(seeds, bodies, st.sampled_from(LAWS))
def test_semi_definite(seed, name, law):
    """Projected, K of a compressed fish has no negative eigenvalue, and as it is, it has; the water adds none to D."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng)
    body = fish.body
    undamped = FISH[name].body._replace(springs=body.springs._replace(damping=np.zeros(91)))
    rest, lowest = 1.3 * body.springs.rest_length, {}
    for floor in (-np.inf, 0.0):
        block = Block(("springs",), undamped, VACUUM, rest_length=rest, h=1.0, lowest=floor)
        values = np.linalg.eigvalsh(block.set(x, v).matrix("add_system"))
        lowest[floor] = values[0] / values[-1]
    assert lowest[-np.inf] < -1e-6 and lowest[0.0] > -1e-13
    values = np.linalg.eigvalsh(Block(("water",), body, world_of(fish, law), h=1.0).set(x, v).matrix("add_damping"))
    assert values[0] > -1e-13 * values[-1] and values[-1] > 0


def test_damping_of_the_water_is_part_of_its_derivative():
    """The water's part of D is what a push along a face's normal changes along it; square to the flow, it is all."""
    world, v = make_water(), np.tile([0.0, 0.0, 0.7], (4, 1))
    body = make_body(SQUARE, np.ones(4), [], [], [], [], [(0, 1, 2, 3)])
    _, damping = Evaluator(body, world).jacobian(np.zeros(0), SQUARE, v)
    close(Block(("water",), body, world, h=1.0).set(SQUARE, v).matrix("add_damping"), damping)


@given(seeds, bodies)
def test_internal_forces_have_no_force_and_no_torque(seed, name):
    """Elastic and viscous forces sum to zero force and zero torque: they can neither push nor turn the whole body."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng, displacement=0.1)
    rest = fish.body.springs.rest_length * rng.uniform(0.5, 1.5, 91)
    f = force("springs", fish.body, VACUUM, x, v, rest)
    size = np.abs(f).sum()
    assert np.abs(f.sum(axis=0)).max() <= 1e-14 * size
    assert np.abs(np.cross(x, f).sum(axis=0)).max() <= 1e-14 * size * fish.length


@given(seeds, bodies)
def test_damping_only_takes_energy_away(seed, name):
    """The viscous part of the units never adds energy, and leaves a rigid motion alone."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng, displacement=0.1)
    relaxed = fish.body._replace(springs=fish.body.springs._replace(stiffness=np.zeros(91)))
    rest = fish.body.springs.rest_length
    assert np.sum(force("springs", relaxed, VACUUM, x, v, rest) * v) < 0
    rigid = rng.normal(size=3) + np.cross(rng.normal(size=3), x)
    f = force("springs", relaxed, VACUUM, x, rigid, rest)
    assert np.abs(f).max() <= 1e-13 * fish.body.springs.damping.max() * np.abs(rigid).max()


@pytest.mark.parametrize("law", LAWS)
@given(
    name=bodies,
    displacement=hnp.arrays(float, (23, 3), elements=st.floats(-0.3, 0.3)),
    velocity=hnp.arrays(float, (23, 3), elements=st.floats(-10, 10)),
    current=hnp.arrays(float, 3, elements=st.floats(-3, 3)),
)
def test_water_only_takes_energy_away(law, name, displacement, velocity, current):
    """The water's force never does positive work on the motion through it, however the body is bent and moves."""
    fish = FISH[name]
    world = world_of(fish, law, current)
    x = fish.body.position + fish.length * displacement
    v = fish.length / fish.contraction_time * velocity
    f = force("water", fish.body, world, x, v)
    work = f * (v - world.current)
    assert work.sum() <= 1e-14 * np.abs(work).sum()


@pytest.mark.parametrize("law", LAWS)
@given(
    corners=hnp.arrays(float, (4, 3), elements=st.floats(-1, 1)),
    velocity=hnp.arrays(float, (4, 3), elements=st.floats(-2, 2)),
)
def test_one_sided(law, corners, velocity):
    """A face feels nothing while it moves inward, and a push against its normal while it moves outward."""
    world = make_water(law=law)
    area, mean = naive.area_vector(corners), velocity.mean(axis=0)
    f = force("water", plate(corners), world, corners, velocity)
    if area @ mean <= -1e-12:
        assert not f.any()
    if area @ mean >= 1e-12:
        assert np.all(f @ area < 0)
        assert np.abs(np.cross(f, area)).max() <= 1e-12 * np.linalg.norm(f) * np.linalg.norm(area)


@pytest.mark.parametrize(
    "faces", [[(0, 1, 2, 3)], [(0, 1, 2, 2), (0, 2, 3, 3)]], ids=["quadrilateral", "two triangles"]
)
@given(seed=seeds, size=st.floats(0.1, 10), speed=st.floats(1e-3, 1e3), outward=st.booleans())
def test_flat_plate(faces, seed, size, speed, outward):
    """A plate moving along its normal at speed U is pushed back with half rho C_d A U^2; the other way, not at all."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    corners, normal = size * SQUARE @ turn.T, turn[:, 2]
    v = np.tile(normal * speed * (1 if outward else -1), (4, 1))
    body = plate(corners, faces)
    density, drag_coefficient = 998.0, 1.17
    f = force("water", body, make_water(density, drag_coefficient), corners, v)
    wanted = 0.5 * density * drag_coefficient * size**2 * speed**2 if outward else 0.0
    np.testing.assert_allclose(f.sum(axis=0), -wanted * normal, rtol=0, atol=1e-12 * wanted)
    f = force("water", body, make_water(drag_coefficient=drag_coefficient, law="linear"), corners, v)
    wanted = drag_coefficient * size**2 * speed if outward else 0.0
    np.testing.assert_allclose(f.sum(axis=0), -wanted * normal, rtol=0, atol=1e-12 * wanted)


@pytest.mark.parametrize("name", naive.TU)
def test_pushed_on_the_leading_side(name):
    """A straight fish moved bodily is held back; moved sideways or up, only the nodes of its leading side feel it."""
    fish = FISH[name]
    world = world_of(fish, current=(0, 0, 0))
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        f = force("water", fish.body, world, fish.body.position, np.tile(direction * fish.length, (23, 1)))
        assert f.sum(axis=0) @ direction < 0
        if direction[0] == 0:
            trailing = fish.body.position @ direction < 0
            assert np.abs(f[trailing]).max() <= 1e-12 * np.abs(f).max()


@given(seeds, bodies, st.sampled_from(LAWS))
def test_only_velocity_through_the_water_counts(seed, name, law):
    """Adding one velocity to the current and to all nodes leaves the water's force as it is."""
    fish, rng = FISH[name], np.random.default_rng(seed)
    x, v = naive.random_state(fish, rng)
    world = world_of(fish, law)
    drift = fish.length / fish.contraction_time * rng.uniform(-1, 1, 3)
    f = force("water", fish.body, world, x, v)
    moved = force("water", fish.body, world._replace(current=world.current + drift), x, v + drift)
    close(moved, f)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", naive.TU)
def test_force_turns_with_the_fish(name, law):
    """Turning positions, velocities and current together turns the water's force with them."""
    fish, rng = FISH[name], np.random.default_rng(3)
    x, v = naive.random_state(fish, rng)
    world = world_of(fish, law)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    f = force("water", fish.body, world, x, v)
    turned = world._replace(current=turn @ world.current)
    close(force("water", fish.body, turned, x @ turn.T, v @ turn.T), f @ turn.T)


@pytest.mark.parametrize("name", naive.TU)
def test_vacuum_and_water_at_rest(name):
    """Vacuum pushes on nothing, and neither does water that moves with the fish."""
    fish = FISH[name]
    x, v = naive.random_state(fish, np.random.default_rng(4))
    assert not force("water", fish.body, VACUUM, x, v).any()
    for law in LAWS:
        world = world_of(fish, law)
        moving = np.abs(force("water", fish.body, world, x, v)).max()
        carried = np.abs(force("water", fish.body, world, x, np.tile(world.current, (23, 1)))).max()
        assert carried <= 1e-14 * moving


@pytest.mark.parametrize("name", naive.TU)
def test_stretch(name):
    """A spring is torn beyond STRETCH_LIMIT times its natural length, and no sooner."""
    fish = FISH[name]
    x, v = naive.random_state(fish, np.random.default_rng(5), displacement=0.1)
    springs = fish.body.springs
    ends = x[springs.nodes]
    ratio = (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / springs.rest_length).max()
    for part, torn in ((1 - 1e-12, False), (1 + 1e-12, True)):
        body = fish.body._replace(
            springs=springs._replace(rest_length=springs.rest_length * ratio / (part * STRETCH_LIMIT))
        )
        assert bool(Block(("springs",), body, VACUUM).set(x, v).number("failed")) == torn


def test_make_water():
    """Water holds the coefficient of its law and no other: half density times drag coefficient, or the linear one."""
    quadratic = make_water(998.0, 1.2, current=(1, 2, 3))
    assert (quadratic.linear, quadratic.quadratic) == (0.0, 0.5 * 998.0 * 1.2)
    np.testing.assert_array_equal(quadratic.current, [1.0, 2.0, 3.0])
    linear = make_water(drag_coefficient=3.0, law="linear")
    assert (linear.linear, linear.quadratic) == (3.0, 0.0)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"law": "cubic"}, "unknown water law 'cubic'; choose 'quadratic' or 'linear'"),
        ({"density": -1.0}, "density is -1.0"),
        ({"density": float("nan")}, "density is nan"),
        ({"density": [1.0]}, "density is"),
        ({"drag_coefficient": float("inf")}, "drag_coefficient is inf"),
        ({"current": (0.0, 0.0)}, r"current \(m/s\) has shape \(2,\); give shape \(3,\)"),
        ({"current": (0.0, float("nan"), 0.0)}, r"current \(m/s\) is nan at \(1,\)"),
        ({"current": "fast"}, "current .* is 'fast'"),
    ],
)
def test_make_water_refuses(arguments, text):
    """Water with an unknown law or a number it cannot have is refused, saying what is allowed."""
    with pytest.raises(ValueError, match=text):
        make_water(**arguments)
