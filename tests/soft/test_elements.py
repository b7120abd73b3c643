"""Forces of soft bodies in detail: nearest rotations, tetrahedra, gas, barriers, failures, walls, air and anchors."""

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from moving import Block, close, force, read, write
from naive.forces import constrain
from small_bodies import ALL, BODIES, completed, world_with_all

from fish_env import Tank, make_fish
from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack
from fish_env.physics import forces
from fish_env.physics.body import fix, make_body
from fish_env.physics.failures import ESCAPED, FAILURES, NON_FINITE, STRETCH_LIMIT, TORN
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces import FORCES
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_compartments
from fish_env.soft.forces import barriers
from fish_env.soft.forces.polar import make_scratch, rotation
from fish_env.soft.room import make_world
from fish_env.soft.volume import add_volume, volume_of

pytestmark = pytest.mark.usefixtures("kernels")
seeds = st.integers(0, 2**32 - 1)
WORLD = world_with_all(ALL)
FIXED = fix(fix(ALL, [1, 18]), [3], "xz")
FAILING = ("tets", "pressure", "barriers")

# Nearest rotations

HARD = [
    (1, 1, 0), (1, 0.5, 0), (1, 0, 0), (0, 0, 0), (1, 1, -1), (1, 0.6, -0.2), (1, 1, -0.999999),
    (1e-200, 1e-200, 1e-200), (1, 1e-7, 1e-7), (1, 6e-5, 6e-5), (1, 2e-3, 2e-3), (1, 0.5, -0.496), (1, 1e-3, -1e-9),
    (2, 2, -2), (1e70, 1e69, 1e68),
]  # fmt: skip
"""Singular values, the last with the sign of the determinant."""


@njit
def rotate(block):
    """Compute the rotation of the matrix of each lane."""
    f, r = block.f, block.r
    r[0], r[1], r[2] = rotation(f[0], f[1], f[2], block.scratch)


def rotations(matrices, kind):
    """The kernel's rotations (W,3,3) of matrices (W,3,3) side by side."""
    block = Pack("block", f=kind.vectors(3), r=kind.vectors(3), scratch=make_scratch(kind))
    write(block.f, np.swapaxes(matrices, 1, 2))
    rotate(block)
    return np.swapaxes(read(block.r), 1, 2)


def check_rotation(matrix):
    """The kernel's rotation, as near as any: tr(R^T F) = s1 + s2 + s3, s3 negative where F is inverted; and the gap."""
    turn = rotations(matrix[None], Kind(1))[0]
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), rtol=0, atol=2e-12)
    assert np.linalg.det(turn) > 0
    values = np.linalg.svd(matrix, compute_uv=False)
    values[2] *= 1.0 if np.linalg.det(matrix) >= 0 else -1.0
    np.testing.assert_allclose(np.sum(turn * matrix), values.sum(), rtol=0, atol=1e-12 * values[0])
    return turn, (values[1] + values[2]) / max(values[0], np.finfo(float).tiny)


@settings(max_examples=200)
@given(hnp.arrays(float, (3, 3), elements=st.floats(-10, 10, width=32)))
def test_rotation_of_any_matrix(matrix):
    """The nearest rotation of any matrix, regular, flat, inverted or null; where it is unique, the SVD's."""
    turn, gap = check_rotation(matrix)
    if gap > 1e-3:
        np.testing.assert_allclose(turn, naive.nearest_rotation(matrix), rtol=0, atol=1e-13 / gap**2)


@settings(max_examples=200)
@given(seed=seeds, exponent=st.floats(-16, -0.5), values=st.sampled_from(HARD))
def test_rotation_of_hard_cases(seed, exponent, values):
    """Near a rotation every digit is right; flat, inverted, tiny and huge matrices have one, too."""
    rng = np.random.default_rng(seed)
    matrix = naive.turned(rng) @ (np.eye(3) + 10**exponent * rng.uniform(-1, 1, (3, 3)))
    found, _ = check_rotation(matrix)
    np.testing.assert_allclose(found.T @ found, np.eye(3), rtol=0, atol=4e-15)
    np.testing.assert_allclose(found, naive.nearest_rotation(matrix), rtol=0, atol=1e-14)  # as exact as that one is
    check_rotation(naive.turned(rng) @ np.diag(np.array(values, float)) @ naive.turned(rng))


@pytest.mark.parametrize(
    "lanes", ["xyz", 8, pytest.param(4, marks=pytest.mark.slow), pytest.param(16, marks=pytest.mark.slow)]
)
def test_same_bits_in_lanes(lanes):
    """Beside others, clear and unclear, a matrix has the same rotation, to the last bit."""
    rng, kind = np.random.default_rng(5), Kind(lanes)
    values = [(1 + rng.normal(0, 0.1), 1, 1 + rng.normal(0, 0.01)) for _ in range(49)] + 2 * HARD + [(np.nan, 1, 1)]
    matrices = np.array([naive.turned(rng) @ np.diag(row) @ naive.turned(rng) for row in values])
    rng.shuffle(matrices)
    found = np.concatenate([rotations(matrices[p : p + kind.width], kind) for p in range(0, 80, kind.width)])
    np.testing.assert_array_equal(found, [rotations(matrix[None], Kind(1))[0] for matrix in matrices])


def test_rotation_in_single_precision():
    """In float32 a rotation is one to single precision, and that of the matrix, stretched or all but flat."""
    rng, kind = np.random.default_rng(6), Kind(16, "float32")
    for values in ((1.1, 1.0, 0.9), (3.0, 1.0, 0.2), (1.0, 1.0, 1e-3), (1.0, 1e-3, 1e-3), (1.0, 0.9, -0.5)):
        matrices = [naive.turned(rng) @ np.diag(values) @ naive.turned(rng) for _ in range(16)]
        found = rotations(np.array(matrices, dtype=np.float32), kind).astype(float)
        np.testing.assert_allclose(np.swapaxes(found, 1, 2) @ found, np.tile(np.eye(3), (16, 1, 1)), rtol=0, atol=2e-5)
        traces = np.einsum("wij,wij->w", found, matrices)
        np.testing.assert_allclose(traces, sum(values), rtol=0, atol=2e-6)


# Tetrahedra


@settings(max_examples=20)
@given(seed=seeds)
def test_rigid_motion_costs_nothing(seed):
    """Turned and moved, elements feel nothing; plain linear ones take the rotation for strain."""
    rng = np.random.default_rng(seed)
    turn, shift = naive.turned(rng), rng.uniform(-1, 1, 3)
    for name, part in (("block", "tets"), ("green block", "green_lagrange"), ("linear block", "tets")):
        body = BODIES[name]
        x, stiffness = body.position @ turn.T + shift, np.abs(naive.stiffness_matrix(body)).max()
        size = np.abs(force(part, body, WORLD, x, 0 * x)).max() / (stiffness * np.ptp(body.position))
        assert size > 1e-3 * np.linalg.norm(turn - np.eye(3)) ** 2 if name == "linear block" else size <= 3e-15


@pytest.mark.parametrize("name", ["block", "linear block"])
def test_uniform_strain(name):
    """A block stretched uniformly pulls on its ends with the stress of an isotropic material times their area."""
    body, strain = BODIES[name], np.diag([2e-3, -1e-3, 3e-4])
    x = body.position @ (np.eye(3) + strain).T
    f = force("tets", body, WORLD, x, np.zeros_like(x))
    shear, dilation = 2e4 / 2.6, 2e4 * 0.3 / (1.3 * 0.4)  # of Young's 20 kPa and Poisson's 0.3
    stress = 2 * shear * strain + dilation * np.trace(strain) * np.eye(3)
    found = -f.T @ body.position / body.tets.volume.sum()
    np.testing.assert_allclose(found, stress, rtol=0, atol=1e-11 * np.abs(stress).max())


# Gas


@njit
def volume(block):
    """Compute the volume of each lane; its gradient is added to `block.slope`."""
    block.volume[0] = add_volume(block.faces, 0, block.faces.shape[0], block.x, block.slope, 0)


def compiled_volume(faces, x):
    """Volume inside faces (Q,4) at x (N,3), and its gradient (N,3), by the compiled kernel."""
    kind = Kind(1)
    block = Pack("block", faces=np.asarray(faces), x=kind.rows(x), slope=kind.vectors(len(x)), volume=np.zeros(1))
    volume(block)
    return block.volume[0], block.slope.memory


def test_volume():
    """Polyhedra converge to the volume of their sphere; far from the origin and in plain Python nothing changes."""
    errors, lengths = [], []
    for levels in range(1, 6):
        points, faces = small_bodies.subdivided(levels)
        errors.append(4 / 3 * np.pi - compiled_volume(faces, points)[0])
        lengths.append(2.0**-levels)
    assert errors[-1] < 2e-3 * 4 / 3 * np.pi
    assert abs(np.polyfit(np.log(lengths[2:]), np.log(errors[2:]), 1)[0] - 2) < 0.02
    points, faces = small_bodies.subdivided(1)
    points = np.round(points * 2**24) / 2**24  # so that no digit of a position is lost on the way
    near = compiled_volume(faces, points)
    for found in (compiled_volume(faces, points + 2.0**20), volume_of(faces, points)):
        assert found[0] == pytest.approx(near[0], rel=1e-14)
        close(found[1], near[1], 1e-14)


@pytest.mark.parametrize("name", ["two layers", "rings", "compartment"])
def test_volume_equals_its_reference(name):
    """Volume, or area of a ring, and gradient are those of signed simplices; at rest the pressure is as given."""
    gas, (x, _) = BODIES[name].compartments, small_bodies.bent(name, np.random.default_rng(8))
    for c in range(gas.gas.size):
        wanted, slope = naive.gas_volume(gas, c, x)
        found, gradient = compiled_volume(gas.faces[gas.first[c] : gas.first[c + 1]], x)
        assert found == pytest.approx(wanted, rel=1e-12)
        close(gradient, slope)
    if name == "two layers":
        volumes = [volume_of(part, ALL.position)[0] for part in np.split(gas.faces, gas.first[1:-1])]
        np.testing.assert_allclose(gas.gas / volumes, [500.0, 450.0], rtol=1e-14)


def test_gas_pushes_all_round():
    """A sphere's gas pushes outward everywhere, with pressure times area; twice as wide, it has an eighth of it."""
    points, faces = small_bodies.subdivided(2)
    gas = make_compartments(points, [faces], 7.0, 2.0)
    body = small_bodies.completed(make_body(points, np.ones(len(points)), [], [], [], [], [], compartments=gas))
    f, g = (force("pressure", body, WORLD, x, 0 * x) for x in (points, 2 * points))
    areas = [naive.area_vector(points[face]) for face in faces]
    assert np.sum(f * points, axis=1).min() > 0
    wanted = (7 - 2) * sum(area @ points[face[0]] for area, face in zip(areas, faces, strict=True))
    assert np.sum(f * points) == pytest.approx(wanted, rel=1e-12)
    close(g, f * 4 * (7 / 8 - 2) / (7 - 2))


# Barriers


def test_barrier():
    """A barrier does nothing while far, then pushes apart, ever harder; nothing jumps, and its stiffness is bounded."""
    s = np.linspace(-0.5, 0.9, 14001)
    energy, first, second = np.array([barriers.barrier(value) for value in s]).T
    near = s < barriers.NEAR
    assert not np.any([energy[~near], first[~near], second[~near]])
    assert np.all(energy[near] > 0) and np.all(first[near] < 0) and np.all(second[near] > 0)
    below = barriers.barrier(barriers.NEAR - 1e-9)
    assert 0 < below[0] < 1e-25 and -1e-16 < below[1] < 0 and below[2] < 1e-7
    assert second.max() == barriers.barrier(barriers.STEEP)[2] == barriers.barrier(-1.0)[2]
    inside = (np.abs(s - barriers.STEEP) > 1e-3) & (np.abs(s - barriers.NEAR) > 1e-3)
    middle = (energy[2:] - energy[:-2]) / (s[2] - s[0])
    np.testing.assert_allclose(middle, first[1:-1], rtol=0, atol=1e-6)
    middle = (first[2:] - first[:-2]) / (s[2] - s[0])
    np.testing.assert_allclose(middle[inside[1:-1]], second[1:-1][inside[1:-1]], rtol=0, atol=1e-5)
    for part in barriers.STEEP + np.array([-1e-7, 1e-7]):
        np.testing.assert_allclose(barriers.barrier(part), barriers.barrier(barriers.STEEP), rtol=1e-5)
    wanted = np.transpose([naive.barrier_law(value) for value in s])
    np.testing.assert_allclose([energy, first, second], wanted, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", ["two layers", "rings"])
def test_bound_of_the_barriers(name):
    """The rate that a step is chosen for is that of all barriers active together, their volumes as at rest."""
    body = BODIES[name]
    assert not naive.barrier_stiffness(body.barriers, body.position).any()  # none is active at rest
    root, most = np.sqrt(body.inverse_mass), naive.barrier_law(0.0)[2]
    matrix = np.zeros((len(root), 3, len(root), 3))
    for k, nodes, _, slope in naive.barrier_shares(body.barriers, body.position):
        for p, first in zip(nodes, slope, strict=True):
            for q, second in zip(nodes, slope, strict=True):
                matrix[p, :, q] += most * body.barriers.energy[k] * np.outer(root[p] * first, root[q] * second)
    highest = np.linalg.eigvalsh(matrix.reshape(root.size, root.size))[-1]
    assert barriers.bounds(body, WORLD) == (pytest.approx(highest, rel=1e-12), 0.0)


# Failures


def failure(x, *names, body=ALL):
    """Code of the failure that these forces find at positions x; all three by default."""
    return int(Block(names or FAILING, body, WORLD).set(x, 0 * x).number("failed"))


def test_failures_of_the_elements():
    """A torn tetrahedron, an emptied compartment and an escaped node are found; forces continue beyond a barrier."""
    rest, still = ALL.position, np.zeros((20, 3))
    torn, empty, out = rest.copy(), rest.copy(), rest.copy()
    torn[18] += [0.0, 0.0, 0.6]
    empty[8:16] = empty[8:16].mean(axis=0) - 1e-3 * (empty[8:16] - empty[8:16].mean(axis=0))  # turned inside out
    out[8, 0] -= 0.04
    assert failure(rest) == failure(out, "pressure") == 0
    assert failure(torn, "tets") == TORN == failure(torn)
    assert failure(empty, "pressure") == ESCAPED == failure(empty)
    assert failure(out, "barriers") == ESCAPED == failure(out)
    assert any(s <= 0 for _, _, s, _ in naive.barrier_shares(ALL.barriers, out))
    pushed = force("barriers", ALL, WORLD, out, still)
    close(pushed, naive.barrier_force(ALL.barriers, out))
    assert pushed[8, 0] > 0.0  # back to where it came from
    gas = ALL.compartments
    second = gas._replace(first=gas.first[1:], gas=gas.gas[1:], ambient=gas.ambient[1:])
    pressed = force("pressure", ALL._replace(compartments=second), WORLD, empty, still)
    close(force("pressure", ALL, WORLD, empty, still), pressed)  # gas without a volume does nothing


@pytest.mark.parametrize("others", [(1.0, 1.0), (0.05, 0.05), (2.9, 2.9), (-2.9, 0.3), (2.9, -0.01)])
def test_torn_by_the_largest_stretch(others):
    """A tetrahedron is torn beyond STRETCH_LIMIT along any direction, whatever along the others, and no sooner."""
    rng, body = np.random.default_rng(9), small_bodies.completed(small_bodies.block(cells=1))
    for part, torn in ((1 - 1e-9, False), (1 + 1e-9, True)):
        stretch = np.diag(rng.permutation([part * STRETCH_LIMIT, *others]))
        for _ in range(5):
            x = body.position @ (naive.turned(rng) @ stretch @ naive.turned(rng)).T
            assert (failure(x, "tets", body=body) == TORN) == torn


@pytest.mark.parametrize("lanes", [pytest.param("xyz", marks=pytest.mark.slow), 4])
def test_a_squeezed_out_node_is_an_escape(lanes):
    """A node thrown through the outer layer, and gas pressed out, fail as "escaped", not as "non-finite"."""
    thing = ElasticObject(name="layers", body=ALL, length=0.1, time_step=1e-3, control_interval=0.02)
    inner = ALL.position[8:16]
    for nodes, motion in ((8, np.array([-60.0, 0.0, 0.0])), (slice(8, 16), -1500.0 * (inner - inner.mean(axis=0)))):
        tank = Tank(thing, 4, "symplectic_euler", 1e-4, lanes=lanes, threads=1)
        tank.velocity[2, nodes] = motion
        tank.advance(8)
        assert tank.failure.tolist() == ["", "", FAILURES[ESCAPED], ""]
    tank.velocity[1, 3] = np.nan
    tank.advance(1)
    assert tank.failure[1] == FAILURES[NON_FINITE]


# Walls, air and anchors


@settings(max_examples=20)
@given(seed=seeds)
def test_walls_and_air(seed):
    """Reactions and impacts of walls are the textbook's; the air leaves exp(-h mu / 2m) of a velocity that is free."""
    rng, h = np.random.default_rng(seed), 0.005
    x, v = small_bodies.shaken(ALL, rng)
    world, f = world_with_all(ALL, offset=0.07), rng.normal(size=x.shape)
    v[0, 2], f[0] = -0.1, [0.0, 0.0, -1.0]  # onto the walls, behind which it is
    walls = Block(("contact",), FIXED, world, h=h).set(x, v)
    for function, wanted in (("add_force", naive.with_reaction(world.planes, x, v, f)),
                             ("constrain", constrain(world.planes, x, v, h, f))):  # fmt: skip
        assert np.abs(wanted - f).max() > 0
        close(walls.add(function, f=f), wanted)
    v[[1, 3, 18], 2], v[[1, 3], 0] = -0.2, 0.05  # fixed nodes keep the velocity they are given
    found = walls.set(x, v).velocities("finish")
    close(found, naive.bounce(FIXED, world, h, x, v))
    assert (found != v).any() and (found == v)[FIXED.inverse_mass == 0.0].all()
    assert np.sum(found**2, axis=1) @ ALL.mass < np.sum(v**2, axis=1) @ ALL.mass
    mass, h = rng.uniform(0.5, 2.0), 0.3
    block = Block(("gravity",), FIXED, world, variation=[1, mass, 1, 0, 0, 0], h=h).set(x, v)
    wanted = np.exp(-0.5 * h * world.viscosity * FIXED.inverse_mass / mass) * v
    close(block.velocities("decay"), wanted, 1e-14)
    assert (wanted == v).sum() == 8
    close(block.add("add_force_cached", "add_force"), ALL.mass[:, None] * world.gravity)
    close(block.matrix("add_system"), h * world.viscosity / mass * np.eye(60))


def test_without_gravity():
    """Walls without gravity reflect everything; a world without a force compiles nothing for it."""
    world = make_world(planes=[((0, 0, 1), 0.0, 0.5)])._replace(gravity=None)
    assert forces.present(ALL, world) == ("springs", "tets", "pressure", "barriers", "contact")
    body = make_body([[0.0, 0.0, -1e-9]], [1.0], [], [], [], [], [])
    assert forces.present(body, VACUUM) == ()
    found = Block(None, body, world, h=0.1).set(body.position, np.array([[1.0, 0.0, -2.0]])).velocities("finish")
    np.testing.assert_array_equal(found, [[1.0, 0.0, 1.0]])


def test_anchor_at_its_point():
    """An anchor with a length whose node is at its very point has no direction, and no force."""
    body, still, names = (
        completed(make_body(np.zeros((1, 3)), [1.0], [], [], [], [], [])),
        np.zeros((1, 3)),
        ("anchors",),
    )
    world = WORLD._replace(anchors=make_anchors([0], np.zeros(3), 5.0, 1.0, 0.3, [1.0, 0.0, 0.0]))
    evaluator = Evaluator(body, world, names)
    assert not evaluator.force(np.zeros(0), still, still).any()
    assert not np.any(evaluator.jacobian(np.zeros(0), still, still))
    block = Block(names, body, world).set(still, still)
    assert not block.add("add_force_cached").any() and not block.add("add_tangent", v=still + 1.0).any()
    assert not block.set(still, still).matrix("add_system").any()


def test_bounds_of_anchors():
    """The node with the stiffest anchors sets the rates, stiffness and damping each."""
    inner, bound = forces.bounds(ALL, WORLD)
    assert inner == FORCES["barriers"].bounds(ALL, WORLD)
    assert bound == pytest.approx(naive.steps.anchor_rates(ALL, WORLD), rel=1e-14)
    assert forces.bounds(ALL, VACUUM) == [inner]


def test_named_forces_are_loaded(monkeypatch, kernels):
    """A force that is asked for by its name acts, however it stands in the table; one without its part is refused."""
    for name, part in (("anchors", "anchors"), ("tets", "tets")):
        monkeypatch.setitem(forces.FORCES, name, f"fish_env.soft.forces.{name}:{part}")
    fish = make_fish()
    pull = make_anchors([0], [fish.body.position[0] + [0.1, 0.0, 0.0]], 5.0)
    world, still, rest = fish.water._replace(anchors=pull), np.zeros((23, 3)), fish.body.springs.rest_length
    force = Evaluator(fish.body, world, ("anchors",)).force(rest, fish.body.position, still)
    np.testing.assert_allclose(force[0], [0.5, 0.0, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="'tets' acts on nothing here"):
        Evaluator(fish.body, world, ("tets",)).force(rest, fish.body.position, still)
