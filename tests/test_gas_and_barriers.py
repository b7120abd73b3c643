"""Gas in closed compartments, barriers, and what counts as a failure of the elements."""

import naive
import numpy as np
import pytest
import small_bodies
from kernels import Block, force
from small_bodies import ALL, close

from fish_env import Tank
from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack
from fish_env.physics.body import make_body
from fish_env.physics.elements import make_compartments
from fish_env.physics.failures import ESCAPED, FAILURES, NON_FINITE, STRETCH_LIMIT, TORN
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces import barriers
from fish_env.physics.volume import add_volume, volume_of
from fish_env.physics.world import VACUUM

# Gas


@njit
def volume(block):
    """Volume of each lane; its gradient is added to `block.slope`."""
    block.volume[0] = add_volume(block.faces, 0, block.faces.shape[0], block.x, block.slope, 0)


def compiled_volume(faces, x):
    """What the compiled kernel makes of faces (Q,4) at x (N,3): the volume, and its gradient (N,3)."""
    kind = Kind(1)
    block = Pack("block", faces=np.asarray(faces), x=kind.rows(x), slope=kind.vectors(len(x)), volume=np.zeros(1))
    volume(block)
    return block.volume[0], block.slope.memory


def test_volume_of_spheres():
    """The volume of a finer and finer polyhedron converges to that of its sphere at second order."""
    errors, lengths = [], []
    for levels in range(1, 6):
        points, faces = small_bodies.subdivided(levels)
        errors.append(4 / 3 * np.pi - compiled_volume(faces, points)[0])
        lengths.append(2.0**-levels)
    assert errors[-1] < 2e-3 * 4 / 3 * np.pi
    assert abs(np.polyfit(np.log(lengths[2:]), np.log(errors[2:]), 1)[0] - 2) < 0.02


def test_volume_far_from_the_origin():
    """A compartment 1000 km away encloses what it does at home, to rounding, and pushes the same; compiled or not."""
    points, faces = small_bodies.subdivided(1)
    points = np.round(points * 2**24) / 2**24  # so that no digit of a position is lost on the way
    near, far, plain = (
        compiled_volume(faces, points),
        compiled_volume(faces, points + 2.0**20),
        volume_of(faces, points),
    )
    for found in (far, plain):
        assert found[0] == pytest.approx(near[0], rel=1e-14)
        close(found[1], near[1], 1e-14)


@pytest.mark.parametrize("name", ["two layers", "rings", "compartment"])
def test_volume_equals_its_reference(name):
    """Volume, or area of a ring, and gradient are those of signed simplices; at rest the pressure is what was asked."""
    body = small_bodies.BODIES[name]
    x, _ = small_bodies.bent(name, np.random.default_rng(8))
    for c in range(body.compartments.gas.size):
        faces = body.compartments.faces[body.compartments.first[c] : body.compartments.first[c + 1]]
        wanted, slope = naive.gas_volume(body.compartments, c, x)
        found, gradient = compiled_volume(faces, x)
        assert found == pytest.approx(wanted, rel=1e-12)
        close(gradient, slope)
    if name == "two layers":
        volumes = [
            volume_of(part, body.position)[0]
            for part in np.split(body.compartments.faces, body.compartments.first[1:-1])
        ]
        np.testing.assert_allclose(body.compartments.gas / volumes, [500.0, 450.0], rtol=1e-14)


def test_closed_compartments_push_all_round():
    """A sphere's gas pushes outward everywhere, with pressure times area; twice as wide, it has an eighth of it."""
    points, faces = small_bodies.subdivided(2)
    body = make_body(
        points, np.ones(len(points)), [], [], [], [], [], compartments=make_compartments(points, [faces], 7.0, 2.0)
    )
    f, g = (force("pressure", body, VACUUM, x, 0 * x) for x in (points, 2 * points))
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
    np.testing.assert_allclose([energy, first, second], np.transpose([naive.barrier_law(value) for value in s]),
                               rtol=1e-12, atol=1e-15)  # fmt: skip


def test_beyond_a_barrier():
    """Where a node has got out it is pushed back and told of; where gas has no volume left, it does nothing."""
    out, empty, still = ALL.position.copy(), ALL.position.copy(), np.zeros((20, 3))
    out[8, 0] -= 0.04
    empty[8:16] = empty[8:16].mean(axis=0) - 1e-3 * (empty[8:16] - empty[8:16].mean(axis=0))  # turned inside out
    beyond = Block(("barriers",), ALL, VACUUM).set(out, still)
    assert any(s <= 0 for _, _, s, _ in naive.barrier_shares(ALL.barriers, out))
    close(beyond.add("add_force"), naive.barrier_force(ALL.barriers, out))
    assert beyond.number("energy") == pytest.approx(naive.barrier_energy(ALL.barriers, out), rel=1e-12)
    assert beyond.add("add_force")[8, 0] > 0.0  # back to where it came from
    gas = Block(("pressure",), ALL, VACUUM).set(empty, still)
    pressed = make_body(ALL.position, ALL.mass, [], [], [], [], [], compartments=ALL.compartments._replace(
        first=ALL.compartments.first[1:], gas=ALL.compartments.gas[1:],
        ambient=ALL.compartments.ambient[1:]))  # fmt: skip
    close(gas.add("add_force"), force("pressure", pressed, VACUUM, empty, still))  # that of the other compartment
    assert [part.number("failed") for part in (beyond, gas)] == [ESCAPED, ESCAPED]


@pytest.mark.parametrize("name", ["two layers", "rings"])
def test_bound_of_the_barriers(name):
    """The rate that a step is chosen for is that of all barriers at work together, their volumes as at rest."""
    body = small_bodies.BODIES[name]
    matrix = naive.barrier_stiffness(body.barriers, body.position)
    assert not matrix.any()  # none is at work at rest
    slopes = [(k, nodes, slope) for k, nodes, _, slope in naive.barrier_shares(body.barriers, body.position)]
    root, most = np.sqrt(body.inverse_mass), naive.barrier_law(0.0)[2]
    matrix = np.zeros((len(root), 3, len(root), 3))
    for k, nodes, slope in slopes:
        for p, first in zip(nodes, slope, strict=True):
            for q, second in zip(nodes, slope, strict=True):
                matrix[p, :, q] += most * body.barriers.energy[k] * np.outer(root[p] * first, root[q] * second)
    highest = np.linalg.eigvalsh(matrix.reshape(root.size, root.size))[-1]
    assert barriers.bounds(body, VACUUM) == (pytest.approx(highest, rel=1e-12), 0.0)


# Failures


def failure(body, x):
    """The code that the forces of a body give its positions."""
    return int(Block(None, body, VACUUM).set(x, 0 * x).number("failed"))


def test_failures_of_the_elements():
    """A torn tetrahedron, an emptied compartment and a node that got out are found out, each by its name."""
    valid = ALL.position
    assert failure(ALL, valid) == 0
    torn, empty, out = valid.copy(), valid.copy(), valid.copy()
    torn[18] += [0.0, 0.0, 0.6]
    assert Block(("tets",), ALL, VACUUM).set(torn, 0 * torn).number("failed") == TORN == failure(ALL, torn)
    empty[8:16] = empty[8:16].mean(axis=0) - 1e-3 * (empty[8:16] - empty[8:16].mean(axis=0))  # turned inside out
    assert Block(("pressure",), ALL, VACUUM).set(empty, 0 * empty).number("failed") == ESCAPED == failure(ALL, empty)
    out[8, 0] -= 0.04
    assert Block(("pressure",), ALL, VACUUM).set(out, 0 * out).number("failed") == 0
    assert Block(("barriers",), ALL, VACUUM).set(out, 0 * out).number("failed") == ESCAPED == failure(ALL, out)


@pytest.mark.parametrize("others", [(1.0, 1.0), (0.05, 0.05), (2.9, 2.9), (-2.9, 0.3), (2.9, -0.01)])
def test_torn_by_the_largest_stretch(others):
    """A tetrahedron is torn beyond STRETCH_LIMIT along any direction, whatever along the others, and no sooner."""
    rng, body = np.random.default_rng(9), small_bodies.block(cells=1)
    for part, torn in ((1 - 1e-9, False), (1 + 1e-9, True)):
        stretch = np.diag(rng.permutation([part * STRETCH_LIMIT, *others]))
        for _ in range(5):
            x = body.position @ (small_bodies.turned(rng) @ stretch @ small_bodies.turned(rng)).T
            assert (failure(body, x) == TORN) == torn


@pytest.mark.parametrize("lanes", [pytest.param("xyz", marks=pytest.mark.slow), 4])
def test_a_squeezed_out_node_is_an_escape(lanes):
    """A node thrown through the outer layer, and gas pressed out, fail as "escaped", not as "non-finite"."""
    thing = ElasticObject(name="layers", body=ALL, length=0.1, time_step=1e-3, control_interval=0.02)
    for name, motion in (("node", np.array([-60.0, 0.0, 0.0])), ("gas", None)):
        tank = Tank(thing, 4, "symplectic_euler", 1e-4, lanes=lanes, threads=1)
        if name == "node":
            tank.velocity[2, 8] = motion
        else:
            inner = ALL.position[8:16]
            tank.velocity[2, 8:16] = -1500.0 * (inner - inner.mean(axis=0))
        tank.advance(8)
        assert tank.failure.tolist() == ["", "", FAILURES[ESCAPED], ""], name
    tank.velocity[1, 3] = np.nan
    tank.advance(1)
    assert tank.failure[1] == FAILURES[NON_FINITE]
