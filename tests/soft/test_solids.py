"""Solid bodies: their meshes, finite elements against theory, statics and vibrations, and how they move."""

from collections import Counter
from dataclasses import replace
from itertools import combinations

import naive
import numpy as np
import pytest
from moving import tiered
from scipy.optimize import brentq
from small_bodies import bar_task

from benchmarks.common import beam
from benchmarks.common.tables import read_table
from benchmarks.objects import finite_elements
from benchmarks.objects.scenes import SCENES, watched
from benchmarks.objects.solids import METHODS, released
from benchmarks.stability import cases, mistreatment, stress, stress_search, survey
from fish_env import BODIES, INTEGRATORS, Tank, make_fish, make_water, make_world
from fish_env.bodies.mass_spring import LAYERS
from fish_env.physics.body import fix, make_body
from fish_env.physics.failures import FAILURES, STRETCH_LIMIT
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.records import Body
from fish_env.physics.world import VACUUM
from fish_env.soft import sparse, statics
from fish_env.soft.conditions import make_anchors
from fish_env.soft.distorted import invert, twist
from fish_env.soft.elements import STRAINS, make_barriers, make_compartments, make_tets
from fish_env.soft.mesh import box, grid, lumped_mass
from fish_env.soft.objects import OBJECTS, SOLIDS, make_ring
from fish_env.soft.solids import SOFT, STIFF, SolidMaterial, make_ball, make_beam, make_block, make_two_materials
from fish_env.soft.statics import NoEquilibrium, equilibrium, linear_deflection, modes, prescribed_displacement

plain = pytest.mark.usefixtures("kernels")


def test_elements_take_shorter_steps():
    """The largest steps of symplectic Euler on the fish of springs and on that of tetrahedra, in drag."""
    for body, limit in (("mass_spring", 0.79e-3), ("tetrahedral", 0.15e-3)):
        fish = make_fish(body, water="drag")
        assert INTEGRATORS["symplectic_euler"].limit(fish.body, fish.water) == pytest.approx(limit, rel=0.04)


# Elements in theory


def deformation(body: Body, x) -> np.ndarray:
    """Deformation gradients (T,3,3) of the elements at x (N,3)."""
    return np.einsum("tac,tad->tcd", x[body.tets.nodes], body.tets.gradient)


TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # a rotation by about 74 degrees
SOFT_YOUNG, SHEAR = 2e5, 2e5 / 2.6


def volumes(position, tets):
    """Volumes (T,) of the tetrahedra."""
    return np.linalg.det(position[tets[:, 1:]] - position[tets[:, :1]]) / 6


def irregular(strain, cells=4):
    """A block of cells whose inner nodes lie where they happen to, and the mask of its inner nodes."""
    position, nodes = box((0.1, 0.1, 0.1), (cells, cells, cells))
    inner = (np.abs(position - [0.05, 0, 0]).max(axis=1) < 0.049)[:, None]
    position = position + inner * np.random.default_rng(0).uniform(-0.004, 0.004, position.shape)
    return beam.solid(position, nodes, 0.3, strain=strain), inner[:, 0]


def stresses(body, x):
    """Stress (T,3,3) Pa of every element in its own frame, by numpy."""
    f, turn = deformation(body, x), np.eye(3)
    if body.tets.quadratic:
        strain = 0.5 * (np.swapaxes(f, 1, 2) @ f - np.eye(3))
    else:
        if body.tets.rotating:
            u, _, vt = np.linalg.svd(f)
            turn = u @ vt
            assert np.all(np.linalg.det(turn) > 0)
        strain = np.swapaxes(turn, -1, -2) @ f - np.eye(3)
        strain = 0.5 * (strain + np.swapaxes(strain, 1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
    return 2 * body.tets.shear[:, None, None] * strain + body.tets.dilation[:, None, None] * trace * np.eye(3)


@pytest.mark.parametrize("kind", STRAINS)
def test_patch(kind):
    """A linear field on the boundary is found inside an irregular mesh, and the stress is the same everywhere.

    For elements that may turn the strained body is turned by a large angle too.
    """
    body, inner = irregular(kind)
    strain = np.array([[0.02, 0.01, -0.015], [0.01, -0.03, 0.005], [-0.015, 0.005, 0.01]])
    gradient = (np.eye(3) if kind == "linear" else TURN) @ (np.eye(3) + strain)
    wanted = body.position @ gradient.T + [0.3, -0.2, 0.1]
    start = np.where(inner[:, None], wanted + 0.003 * np.sin(np.arange(wanted.size)).reshape(-1, 3), wanted)
    x = statics.equilibrium(fix(body, ~inner), start=start, tolerance=1e-15)
    assert np.abs(start - wanted).max() > 0.002
    np.testing.assert_allclose(x, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())
    if kind == "green_lagrange":
        strain = strain + 0.5 * strain @ strain
    expected = 2 * SHEAR * strain + SOFT_YOUNG * 0.3 / (1.3 * 0.4) * np.trace(strain) * np.eye(3)
    for found in stresses(body, x):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_cantilever_converges():
    """Deflection and first frequency converge to those of the theory of beams with the square of the elements' size.

    With equal masses for all nodes the end of the beam is too heavy by half a layer: that error goes with the size.
    """
    cells, deflection, frequency, even = (2, 4, 8), [], [], []
    for n in cells:
        body = beam.cantilever(n)
        force = 1e-4 * beam.rigidity(body) / beam.LENGTH**2
        scale = force * beam.LENGTH**3 / (3 * beam.rigidity(body))
        deflection.append(beam.tip(body, statics.linear_deflection(body, beam.tip_load(body, force)))[2] / scale)
        frequency.append(beam.vertical(body)[0] / beam.first_frequency(body))
        even.append(beam.vertical(beam.cantilever(n, rule="uniform"))[0] / beam.first_frequency(body))
    missing = 1 / np.array(deflection) - 1 / (1 + beam.SHEAR)
    assert finite_elements.order(cells, missing) == pytest.approx(2.0, abs=0.1)
    assert abs(deflection[-1] / (1 + beam.SHEAR) - 1) < 0.06
    assert finite_elements.order(cells, np.array(frequency) ** 2 - 1) == pytest.approx(2.0, abs=0.2)
    assert abs(frequency[-1] - 1) < 0.02 and abs(even[-1] - 1) < 0.02
    np.testing.assert_allclose(np.array(even) / frequency, 1 - 0.5 / (beam.RATIO * np.array(cells)), atol=0.003)


@pytest.mark.slow
def test_large_bending():
    """Bent through 80 degrees, the corotational beam is an elastica and keeps its volume, as does the quadratic one."""
    ends, grown = {}, {}
    for strain in STRAINS:
        body = beam.cantilever(2 if strain == "linear" else 4, strain=strain)
        *_, (_, x) = finite_elements.bend(body, (10.0,))
        ends[strain], grown[strain] = beam.tip(body, x) / beam.LENGTH, finite_elements.volume(body, x) - 1
    softer = 10.0 * 0.8274 / (1 + beam.SHEAR)  # these elements bend 17 % less than they should under a small load
    np.testing.assert_allclose(ends["corotational"][[0, 2]], finite_elements.elastica(softer)[-1], atol=0.02)
    assert np.linalg.norm(ends["corotational"] - ends["green_lagrange"]) < 0.01
    assert abs(grown["corotational"]) < 0.03 and abs(grown["green_lagrange"]) < 0.002 and grown["linear"] > 0.2


def test_extension_and_reflection():
    """A bar pulls by E e, or by E (s^2 - 1) s / 2 of its stretch s with quadratic strain, which sees no reflection.

    Its bar resists most at 1 / sqrt 3 of its length; inside out its block is at rest, where others push back.
    """
    reflected = {}
    for strain in STRAINS:
        for stretch in finite_elements.CASES["extension"][::4]:
            wanted = finite_elements.law(strain, stretch)
            assert finite_elements.extended(strain, stretch) == pytest.approx(wanted, abs=1e-13)
        body, _ = irregular(strain)
        f = Evaluator(body, make_world()).force(np.zeros(0), body.position * [1, 1, -1], 0 * body.position)
        reflected[strain] = np.abs(f).max() / (SOFT_YOUNG * 0.1**2)
    assert reflected["green_lagrange"] < 1e-14 and min(reflected["linear"], reflected["corotational"]) > 1e-2
    stretch = np.linspace(0.3, 0.9, 601)
    hardest = stretch[np.argmin([finite_elements.law("green_lagrange", s) for s in stretch])]
    assert hardest == pytest.approx(1 / np.sqrt(3), abs=1e-3)


# Meshes


def test_mesh_conforms():
    """Cells of a fish's loft fill it: every inner triangle has two elements, the others lie on the surface."""
    mesh = grid(-np.linspace(0, 0.3, 7), [0, 2, 3, 3, 2, 1, 0], [0, 3, 4, 4, 3, 2, 3], 4, 2)
    assert np.all(volumes(mesh.position, mesh.tets) > 0)
    sides = Counter(tuple(sorted(side)) for tet in mesh.tets.tolist() for side in combinations(tet, 3))
    outer = {side for side, count in sides.items() if count == 1}
    assert set(sides.values()) == {1, 2}
    patches = [frozenset(face) for face in mesh.faces.tolist()]
    assert all(any(set(side) <= patch for patch in patches) for side in outer)
    assert len(outer) == sum(len(patch) - 2 for patch in patches)
    assert {node for side in outer for node in side} == set(mesh.faces.ravel().tolist())
    assert set(mesh.number.ravel().tolist()) == set(range(len(mesh.position))) == set(mesh.tets.ravel().tolist())
    assert len(np.unique(mesh.position, axis=0)) == len(mesh.position)
    assert len(set(mesh.number[0].ravel())) == 1 and len(set(mesh.number[-1].ravel())) == 3
    x = mesh.position[mesh.number]
    np.testing.assert_allclose(x[3, :, 0, 1], [-3, -1.5, 0, 1.5, 3])
    np.testing.assert_allclose(x[:, 2, :, 2][3], [-4, 0, 4])


def test_mirrored_mesh():
    """Reflected in y or z, a mirrored mesh is the same set of nodes and elements; one that is not, is not."""
    for position, tets, mirrored in ((*box((2, 1, 1), (2, 4, 2), True), True), (*box((2, 1, 1), (2, 4, 2)), False)):
        for axis in (1, 2):
            image = position * np.where(np.arange(3) == axis, -1, 1)
            where = {tuple(np.round(p, 9) + 0.0): i for i, p in enumerate(position)}
            swap = np.array([where[tuple(np.round(p, 9) + 0.0)] for p in image])
            once = {frozenset(tet) for tet in tets.tolist()}
            assert ({frozenset(tet) for tet in swap[tets].tolist()} == once) == mirrored
    s = np.linspace(0.0, 1.0, 7)
    mesh = grid(-0.3 * s, 0.03 * np.sqrt(s) * (1.0 - s), 0.05 * np.sqrt(s) * (1.0 - 0.7 * s), 4, 4)
    mass = lumped_mass(mesh.position, mesh.tets, 1000.0)
    np.testing.assert_allclose(mass @ mesh.position[:, 1:], 0, atol=1e-16)


def test_box_and_lumped_mass():
    """A box has six elements a cell of the same volume; a quarter of each element's mass goes to each corner."""
    position, tets = box((0.3, 0.2, 0.1), (3, 2, 1))
    assert len(position) == 4 * 3 * 2 and len(tets) == 36
    np.testing.assert_allclose(volumes(position, tets), 0.006 / 36, rtol=1e-12)
    np.testing.assert_allclose([position.min(axis=0), position.max(axis=0)], [[0, -0.1, -0.05], [0.3, 0.1, 0.05]])
    density, wanted = np.linspace(500.0, 1500.0, len(tets)), np.zeros(len(position))
    mass, even = (lumped_mass(position, tets, density, *rule) for rule in ((), ("uniform",)))
    for tet, volume, rho in zip(tets, volumes(position, tets), density, strict=True):
        wanted[tet] += rho * volume / 4
    np.testing.assert_allclose(mass, wanted, rtol=1e-14)
    assert np.ptp(even) == 0 and even.sum() == pytest.approx(mass.sum(), rel=1e-14)
    for arguments, text in (((tets, 0.0), "density"), ((tets, -1.0), "density"), ((tets, np.nan), "density"),
                            ((tets, density[:-1]), "density"), ((tets, 1.0, "half"), "unknown rule"),
                            ((tets[:, [2, 3, 1, 0]], 1.0), "tetrahedron 0 has the volume")):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            lumped_mass(position, *arguments)


ONES = np.ones(3)


@pytest.mark.parametrize(("make", "arguments", "text"), [
    (box, ((1, 1, 0), (1, 1, 1)), "size"), (box, ((1, 1, 1), (1, 0, 1)), "cells along y"),
    (box, ((1, 1, 1), (1, 3, 2), True), "even"), (grid, ([0, 1, 1], ONES, ONES, 2, 2), "number 2"),
    (grid, ([0, 1, 0.5], ONES, ONES, 2, 2), "number 2"),
    (grid, ([0, 1, 2], [1, 0, 0], ONES, 2, 2), "widths are zero at stations 1 and 2"),
    (grid, ([0, 1, 2], ONES, [0, 0, 1], 2, 2), "depths are zero at stations 0 and 1"),
    (grid, ([0, 1, 2], ONES, [1, -1, 1], 2, 2), "depths"), (grid, ([0, 1, 2], ONES[:2], ONES, 2, 2), "widths"),
    (grid, ([0], [1], [1], 2, 2), "at least two"), (grid, ([0, 1, 2], ONES, ONES, 2, 3), "even"),
])  # fmt: skip
def test_refused_meshes(make, arguments, text):
    """Sizes, cells and cross-sections that make no mesh raise errors that name them."""
    with pytest.raises(ValueError, match=text):
        make(*arguments)


# Statics

WEIGHT = make_world((0.0, 0.0, -9.81))
YOUNG, SIZE = 1e5, 0.05
each_way = pytest.mark.parametrize("method", ["elimination", "penalty"])


@pytest.fixture(params=["dense", "sparse"])
def algebra(request, monkeypatch):
    """Dense matrices, and sparse ones for bodies that would have dense ones."""
    if request.param == "sparse":
        monkeypatch.setattr(rates, "DENSE", 0)


def chain(positions, stiffness, rest_length, mass=1.0):
    """Masses joined one after the other by springs."""
    n = len(positions)
    pairs, ones = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1), np.ones(n - 1)
    return make_body(positions, np.full(n, mass), pairs, stiffness * ones, 0 * ones, rest_length * ones, [])


def three(rest_length, stiffness=10.0, mass=3.0):
    """Three masses in a row, 1 m apart, of which the first and the last are fixed."""
    return fix(chain([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]], stiffness, rest_length, mass), [0, 2])


def free_block(cells=(3, 2, 2), poisson=0.3):
    """A free block of tetrahedra, 0.1 m across."""
    position, nodes = box(0.1 * np.array(cells) / cells[-1], cells)
    mass = lumped_mass(position, nodes, 1000.0)
    return make_body(position, mass, [], [], [], [], [], tets=make_tets(position, nodes, 1e4, poisson))


def cube(poisson=0.3, strain="corotational"):
    """A free cube of tetrahedra of 5 cm, 27 nodes."""
    body = bar_task((2, 2, 2), SIZE / 2).body
    tets = make_tets(body.position, body.tets.nodes, YOUNG, poisson, strain=strain)
    return make_body(body.position, body.mass, [], [], [], [], [], tets=tets)


def everything():
    """A body with elements of every kind, a world with everything that pulls, and a state in which they all act."""
    mesh = grid(np.linspace(0.0, 0.15, 3), np.full(3, 0.05), np.full(3, 0.05), 2, 2)
    x, rng = mesh.position, np.random.default_rng(3)
    edges = np.unique(np.sort(mesh.tets[:, [0, 1]], axis=1), axis=0)
    natural = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    inner = mesh.number[1:-1, 1, 1]
    faces = np.stack([mesh.number[1:2, 2, 1], mesh.number[2:3, 2, 1], mesh.number[1:2, 2, 2]], axis=1)
    p, q, r = (x[faces[0, k]] - x[inner[0]] for k in range(3))
    body = make_body(
        x, lumped_mass(x, mesh.tets, 1000.0), edges, np.full(len(edges), 30.0), np.zeros(len(edges)), 0.9 * natural,
        mesh.faces, tets=make_tets(x, mesh.tets, 1e4, 0.3),
        compartments=make_compartments(x, [mesh.faces], 200.0, 150.0),
        barriers=make_barriers(x, faces[:, ::-1] if np.dot(p, np.cross(q, r)) < 0 else faces, inner, 0.1),
    )  # fmt: skip
    anchors = make_anchors([0, 7], [[0.1, 0.2, 0.3], [-0.1, 0.0, 0.2]], [20.0, 30.0], rest_length=[0.0, 0.1])
    world = make_world((0.0, 0.0, -9.81), water=make_water(current=(0.2, 0.3, -0.1), friction=9.0))._replace(
        anchors=anchors
    )
    bent = x + 0.002 * rng.normal(size=x.shape)
    bent[inner] += 0.8 * (x[faces].mean(axis=1) - x[inner])  # so near the faces that the barriers push
    return body, world, bent


def flat():
    """A ring of two layers in a plane, whose barriers have two nodes outside, and a state in which these act."""
    body = make_ring().body
    _, _, _, inside = body.barriers.nodes.T
    x = body.position + 0.001 * np.random.default_rng(4).normal(size=body.position.shape) * [1, 1, 0]
    x[inside] += 0.7 * (x[body.barriers.nodes[:, :2]].mean(axis=1) - x[inside])
    return body, VACUUM, x


@plain
@pytest.mark.parametrize("make", [everything, flat])
def test_sparse_tangent_is_the_jacobian(make, monkeypatch):
    """Computed for a few elements at a time, the stiffness of a body with all kinds of them is that of the whole."""
    body, world, x = make()
    rest, still, evaluator = body.springs.rest_length, np.zeros_like(x), Evaluator(body, world)
    assert np.abs(Evaluator(body, world, ("barriers",)).force(rest, x, still)).max() > 0
    wanted, _ = evaluator.jacobian(rest, x, still)
    assert wanted.shape == (x.size, x.size)
    monkeypatch.setattr(rates, "DENSE", 0)
    monkeypatch.setattr(sparse, "PIECE", 7)
    found = sparse.tangent(body, world, rest, x)
    np.testing.assert_allclose(found.toarray(), wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
    for k in (0, 25, 61):  # and the whole is the derivative of the force
        shift = 1e-7 * (np.arange(x.size) == k).reshape(x.shape)
        sides = [evaluator.force(rest, x + sign * shift, still).ravel() for sign in (1, -1)]
        slope = (sides[1] - sides[0]) / 2e-7
        np.testing.assert_allclose(found[:, [k]].toarray()[:, 0], slope, rtol=0, atol=1e-6 * np.abs(wanted).max())


# Equilibrium


@plain
def test_springs_under_weight():
    """A chain hangs from springs stretched by the weights below them; one started sideways swings down."""
    body = fix(chain([[0, 0, 0], [0, 0, -1], [0, 0, -2.0]], stiffness=50.0, rest_length=1.0), [0])
    x = equilibrium(body, WEIGHT, tolerance=1e-13)
    np.testing.assert_allclose(x[:, 2], [0, -1 - 2 * 9.81 / 50, -2 - 3 * 9.81 / 50], rtol=1e-12)
    np.testing.assert_allclose(x[:, :2], 0, atol=1e-14)
    body = fix(chain([[0, 0, 0], [1, 0, -0.2]], stiffness=1000.0, rest_length=1.0), [0])
    np.testing.assert_allclose(equilibrium(body, WEIGHT)[1], [0, 0, -1 - 9.81 / 1000], atol=1e-10)


@plain
def test_no_equilibrium_beyond_a_barrier():
    """A node drawn to a point beyond its barrier comes to rest before it."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -0.3]])
    barrier = make_barriers(x, [[0, 1, 2]], [3], 1.0)
    body = fix(fix(make_body(x, np.ones(4), [], [], [], [], [], barriers=barrier), [0, 1, 2]), [3], "xy")
    world = VACUUM._replace(anchors=make_anchors([3], [[0.2, 0.2, 0.3]], 10.0))
    found = equilibrium(body, world)
    assert -0.2 < found[3, 2] < 0.0
    pushed = Evaluator(body, world, ("barriers",)).force(np.zeros(0), found, 0 * found)
    np.testing.assert_allclose(pushed[3, 2], -10.0 * (0.3 - found[3, 2]), rtol=1e-8)


def test_reactions_of_a_hanging_body():
    """At the equilibrium of a large displacement, the fixed nodes bear the weight of the body and nothing else."""
    body = fix(cube(), [0, 1, 2])
    found = statics.reactions(body, equilibrium(body, WEIGHT), WEIGHT)
    np.testing.assert_allclose(found.sum(axis=0), [0, 0, 9.81 * body.mass.sum()], rtol=1e-8, atol=1e-7)
    assert not found[3:].any()


# Small deflections and prescribed displacements


def test_small_load(algebra):
    """Under a small load equilibrium is the linear deflection; a balanced one stretches a free block by Young's law."""
    body = free_block()
    body = fix(body, body.position[:, 0] == 0)
    load = np.zeros_like(body.position)
    load[-1] = [0.0, 1e-4, 2e-4]
    u = linear_deflection(body, load)
    assert np.abs(u).max() > 1e-6 and not u[body.position[:, 0] == 0].any()
    bent = equilibrium(body, load=load) - body.position
    np.testing.assert_allclose(bent, u, rtol=0, atol=50 * np.abs(u).max() ** 2 / 0.1)
    body = free_block((4, 2, 2), poisson=0.0)
    x, load = body.position, np.zeros_like(body.position)
    for end, sign in ((0.0, -1.0), (0.2, 1.0)):
        for tet in body.tets.nodes:
            side = tet[np.isclose(x[tet, 0], end)]
            if len(side) == 3:
                area = 0.5 * np.linalg.norm(np.cross(x[side[1]] - x[side[0]], x[side[2]] - x[side[0]]))
                load[side, 0] += sign * 100.0 * area / 3
    wanted = (x[:, :1] - 0.1) * [100.0 / 1e4, 0.0, 0.0]  # 100 Pa on a body of 10 kPa
    np.testing.assert_allclose(linear_deflection(body, load), wanted, atol=1e-12)


@pytest.mark.parametrize("strain", ["linear", "corotational"])
@each_way
def test_uniaxial_tension(method, strain):
    """A pulled block without contraction: exact strain everywhere, and the stress of Young's modulus."""
    body = cube(poisson=0.0, strain=strain)
    x, left = body.position, np.flatnonzero(body.position[:, 0] == 0.0)
    for nodes, axis in ((left, "x"), (left[x[left, 1] == 0.0], "y"), (left[x[left, 2] == 0.0], "z")):
        body = fix(body, nodes, axis)  # it is free to become thinner
    right, by = np.flatnonzero(x[:, 0] == x[:, 0].max()), 1e-3 * SIZE
    multiple, tolerance = (1e9, 1e-7) if method == "penalty" else (1.0, 1e-11)
    found, bearing = prescribed_displacement(body, right, (by, 0, 0), method=method, multiple=multiple)
    np.testing.assert_allclose(found, x * [by / SIZE, 0, 0], rtol=0, atol=tolerance * by)
    force = YOUNG * by / SIZE * SIZE**2
    np.testing.assert_allclose(bearing[right].sum(axis=0), [force, 0, 0], rtol=tolerance, atol=1e-9)
    np.testing.assert_allclose(bearing.sum(axis=0), 0.0, atol=1e-9 * force)


# Natural frequencies


@plain
def test_two_masses_on_a_spring(algebra):
    """The free pair vibrates at sqrt(2 c / m); its five rigid motions, and none other, do not."""
    body = chain([[0, 0, 0], [1, 0, 0.0]], stiffness=8.0, rest_length=1.0, mass=2.0)
    frequency, shapes = modes(body, 6)
    np.testing.assert_allclose(frequency, [0, 0, 0, 0, 0, np.sqrt(2 * 8.0 / 2.0) / (2 * np.pi)], atol=1e-7)
    np.testing.assert_allclose(np.abs(shapes[-1, :, 0]), 0.5, rtol=1e-12)


@plain
def test_taut_and_pressed_springs():
    """A mass between taut springs vibrates across them at sqrt(2 T / (l m)); between pressed ones it is unstable."""
    frequency, _ = modes(three(rest_length=0.75), 3)
    across, along = np.sqrt(2 * 2.5 / 3.0), np.sqrt(2 * 10.0 / 3.0)
    np.testing.assert_allclose(2 * np.pi * frequency, [across, across, along], rtol=1e-12)
    pressed = three(rest_length=1.25)
    np.testing.assert_array_equal(equilibrium(pressed), pressed.position)
    with pytest.raises(NoEquilibrium, match="unstable"):
        modes(pressed, 1)


def test_modes_are_the_same_dense_or_sparse(monkeypatch):
    """Frequencies agree; shapes are orthonormal in the masses and solve the eigenproblem; rigid ones come first."""
    body = free_block((3, 3, 2))
    dense, _ = modes(body, 10)
    stiffness = statics.tangent(body, VACUUM, np.zeros(0), body.position)
    monkeypatch.setattr(rates, "DENSE", 0)
    found, shapes = modes(body, 10)
    np.testing.assert_allclose(found[6:], dense[6:], rtol=1e-9)
    assert np.all(found[:6] < 1e-4 * found[6]) and np.all(dense[:6] < 1e-4 * dense[6])
    np.testing.assert_allclose(np.einsum("anc,n,bnc->ab", shapes, body.mass, shapes), np.eye(10), atol=1e-9)
    for f, shape in zip(found, shapes, strict=True):
        left, right = stiffness @ shape.ravel(), (2 * np.pi * f) ** 2 * np.repeat(body.mass, 3) * shape.ravel()
        scale = body.max_stiffness_eigenvalue * np.abs(shape).max() * body.mass.max()
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-8 * scale)


# Input validation

ONE_UP = np.array([[0.0, 0, 1], *[[0, 0, 0]] * 35])
SIDEWAYS = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 0]])


@pytest.mark.parametrize(("call", "error", "text"), [
    (lambda: equilibrium(free_block(), make_world(planes=[((0, 0, 1), 0.0, 0.5)])), ValueError, "walls"),
    (lambda: equilibrium(free_block(), tolerance=0.0), ValueError, "tolerance"),
    (lambda: equilibrium(free_block(), load=ONE_UP[:3]), ValueError, "load"),
    (lambda: equilibrium(free_block(), WEIGHT), NoEquilibrium, "fix or anchor"),
    (lambda: linear_deflection(free_block(), ONE_UP), ValueError, "resultant"),
    (lambda: linear_deflection(fix(free_block(), [5]), ONE_UP), ValueError, "resultant"),
    (lambda: linear_deflection(three(rest_length=1.0), SIDEWAYS), NoEquilibrium, "every motion"),
    (lambda: modes(free_block(), 0), ValueError, "count"),
    (lambda: modes(free_block(), 109), ValueError, "count"),
    (lambda: modes(free_block(), 1.5), ValueError, "count"),
    (lambda: prescribed_displacement(cube(), [0], (1e-3, 0, 0)), NoEquilibrium, "does not resist every motion"),
    (lambda: prescribed_displacement(cube(), [0], (1e-3, 0, 0), method="penalty"), NoEquilibrium, "every motion"),
])  # fmt: skip
def test_refused_problems(call, error, text):
    """Walls, falling bodies, loads that move a free body, mechanisms and bad arguments raise errors that say why."""
    with pytest.raises(error, match=text):
        call()


@pytest.mark.parametrize(("change", "text"), [
    ({"nodes": [999]}, "contain node 999"), ({"displacement": (1.0, 2.0)}, "displacement"),
    ({"displacement": np.nan}, "displacement"), ({"method": "glue"}, "elimination"), ({"multiple": 0.0}, "multiple"),
    ({"nodes": [0]}, "free them"),
])  # fmt: skip
def test_refused_displacements(change, text):
    """Invalid prescribed displacements raise errors that name the argument."""
    with pytest.raises(ValueError, match=text):
        prescribed_displacement(
            **({"body": fix(cube(), [0, 1, 2]), "nodes": [5], "displacement": (1e-3, 0, 0)} | change)
        )


# Motion

STEPS = {"linearly_implicit": 0.05, "leapfrog_chebyshev": 0.02}
"""Steps of `recover` by method, over the reciprocal of the lowest angular frequency."""


def ringing(body: Body, method: str, periods: float, steps_a_period: int, amplitude=1e-4):
    """Displacements along the beam's first mode, over the first one, and energies, J, at every step after release."""
    frequency, shape = beam.vertical(body)
    scale = amplitude * beam.LENGTH / np.abs(shape).max()
    step = 1.0 / (frequency * steps_a_period)
    tank, evaluator = Tank(beam.loose(body, step), 1, method, step), Evaluator(body, VACUUM)
    tank.position[0] += scale * shape
    places, energies = [], []
    for _ in range(round(periods * steps_a_period) + 1):
        x, v = tank.position[0], tank.velocity[0]
        places.append(np.einsum("n,nk,nk->", body.mass, shape, x - body.position) / scale)
        energies.append(sum(evaluator.energies(body.springs.rest_length, x, v).values()))
        tank.advance(1)
    return np.array(places), np.array(energies)


def rates_of(places, steps_a_period: int) -> tuple[float, float]:
    """Angular frequency and decay rate, times a period, of a damped vibration (Prony's method).

    Samples at equal intervals obey q'' = a q' - b q, which is exact for any method that is linear: no fit of a curve.
    """
    stride = max(1, steps_a_period // 8)
    q = places[::stride]
    a, b = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    exponent = np.log(np.roots([1.0, -a, b]).astype(complex)[0]) * steps_a_period / stride
    return float(abs(exponent.imag)), float(-exponent.real)


def implicit_euler(relaxation: float, steps_a_period: int) -> tuple[float, float]:
    """As `rates_of`, of implicit Euler on a vibration whose relaxation time is given in periods."""
    turn = 2.0 * np.pi / steps_a_period
    damping = turn * 2.0 * np.pi * relaxation
    exponent = np.log(np.roots([1.0 + damping + turn**2, -2.0 - damping, 1.0]).astype(complex)[0]) * steps_a_period
    return float(abs(exponent.imag)), float(-exponent.real)


@pytest.mark.parametrize(("relaxation", "steps"), [(0.0, 200), (0.01, 20)])
def test_implicit_method_is_implicit_euler(relaxation, steps):
    """On the beam's first mode `linearly_implicit` turns and decays as implicit Euler: to the frequency as h goes to 0.

    At 20 steps a period five sixths of the energy are gone after one, and 96 % at ten.
    """
    body = beam.cantilever(2, relaxation_time=relaxation / beam.vertical(beam.cantilever(2))[0])
    places, energy = ringing(body, "linearly_implicit", 1.5, steps)
    found = rates_of(places, steps)
    assert found == pytest.approx(implicit_euler(relaxation, steps), rel=1e-6)
    assert abs(found[0] / (2 * np.pi) - 1) < (0.05 if steps == 20 else 0.002)
    assert steps == 200 or energy[20] / energy[0] < 0.16
    assert np.exp(-2 * implicit_euler(0.0, 10)[1]) == pytest.approx(0.04, abs=0.005)  # at ten steps


def test_decay_of_the_first_mode():
    """It decays at half the relaxation time times the square of its angular frequency, to a thousandth."""
    period = 1.0 / beam.vertical(beam.cantilever(2))[0]
    body = beam.cantilever(2, relaxation_time=0.01 * period)
    places, _ = ringing(body, "leapfrog_chebyshev", 2.0, 500)
    assert rates_of(places, 500)[1] == pytest.approx(0.5 * 0.01 * (2 * np.pi) ** 2, rel=1e-3)


@pytest.mark.parametrize(
    "method", tiered(["linearly_implicit_projected", "leapfrog_chebyshev"], ("leapfrog_chebyshev",))
)
def test_quadratic_strain_in_motion(method):
    """A free block that spins fast and is stretched by it keeps its angular momentum, and its energy does not grow."""
    position, nodes = box((0.1, 0.05, 0.05), (4, 2, 2))
    body = beam.solid(position, nodes, 0.3, strain="green_lagrange", relaxation_time=0.002)
    tank = Tank(beam.loose(body, 0.001), 1, method, 0.001, threads=1)
    tank.velocity[0] = np.cross([0.0, 0.0, 60.0], body.position - body.mass @ body.position / body.mass.sum())
    evaluator, spin, energy, longest = Evaluator(body, tank.world), [], [], []
    for _ in range(100):
        spin.append((body.mass[:, None] * np.cross(tank.position[0], tank.velocity[0])).sum(axis=0)[2])
        energy.append(sum(evaluator.energies(np.zeros(0), tank.position[0], tank.velocity[0]).values()))
        longest.append(np.linalg.norm(np.ptp(tank.position[0], axis=0)))
        tank.advance(5)
    assert tank.alive.all() and max(longest) > 1.05 * longest[0]
    assert np.diff(energy).max() < 1e-3 * energy[0]
    if method == "leapfrog_chebyshev":
        np.testing.assert_allclose(spin, spin[0], rtol=2e-3)


# The solids of the table

each_solid = pytest.mark.parametrize("name", SOLIDS)
each_method = tiered(METHODS, ("leapfrog_chebyshev", "linearly_implicit"))


@each_solid
def test_mesh_and_masses(name):
    """The surface is closed, outward, and holds the elements; the mass is theirs, and its middle on the x axis."""
    thing = OBJECTS[name].make()
    body = thing.body
    assert np.array_equal(thing.outer, np.unique(thing.skin)) and thing.inner.size == 0 and not thing.flat
    compartments = make_compartments(body.position, [thing.skin], 1.0)
    assert len(compartments.faces) == len(thing.skin)
    density = np.array([SOFT.density, STIFF.density])[thing.material]
    assert body.mass.sum() == pytest.approx(density @ body.tets.volume, rel=1e-13)
    assert np.abs(body.mass @ body.position[:, 1:]).max() < 1e-15
    young = body.tets.shear * 2 * (1 + 0.3)
    np.testing.assert_allclose(young, np.array([SOFT.young, STIFF.young])[thing.material], rtol=1e-12)
    if name == "two materials":
        middle = body.position[body.tets.nodes, 0].mean(axis=1)
        assert np.array_equal(thing.material == 1, middle > 0) and (thing.material == 1).mean() == 0.5


@each_solid
def test_at_rest(name):
    """No force acts on it, and nothing but its six rigid motions is free of stiffness."""
    body = OBJECTS[name].make().body
    still = np.zeros_like(body.position)
    evaluator = Evaluator(body, VACUUM)
    stiffness, _ = evaluator.jacobian(body.springs.rest_length, body.position, still)
    assert np.abs(evaluator.force(body.springs.rest_length, body.position, still)).max() < 1e-12 * stiffness.max()
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(values[:6]).max() < 1e-12 * values[-1] and values[6] > 1e-4 * values[-1]


def test_ball_becomes_round():
    """Its volume goes to that of a ball with the square of the cells, and its outer nodes lie on the sphere."""
    missing = []
    for cells in (4, 8):
        ball = make_ball(cells)
        np.testing.assert_allclose(np.linalg.norm(ball.body.position[ball.outer], axis=1), 0.1, rtol=1e-14)
        missing.append(1.0 - ball.body.tets.volume.sum() / (4 / 3 * np.pi * 1e-3))
    assert missing[0] / missing[1] == pytest.approx(4.0, rel=0.05)


def test_ball_breathes_at_its_frequency():
    """The lowest mode that keeps it round is Lamb's (1882) to 2 %: z cot z = 1 - z^2 (1 - nu) / (2 (1 - 2 nu))."""
    ball, nu = make_ball(6), SOFT.poisson
    squared = (1 - nu) / (1 - 2 * nu) / 2.0
    root = brentq(lambda z: z / np.tan(z) - 1.0 + squared * z**2, 1.0, 3.1)
    wave = np.sqrt(SOFT.young * (1 - nu) / ((1 + nu) * (1 - 2 * nu) * SOFT.density))
    wanted = root * wave / (2 * np.pi * 0.1)
    frequencies, shapes = statics.modes(ball.body, 60)
    x, mass = ball.body.position, ball.body.mass
    radial = np.einsum("cnk,nk->cn", shapes, x / np.maximum(np.linalg.norm(x, axis=1), 1e-12)[:, None])
    size = radial**2 @ mass
    share = (radial @ mass) ** 2 / (mass.sum() * size)
    breathing = int(np.argmax(share * size))
    assert share[breathing] > 0.8 and frequencies[breathing] == pytest.approx(wanted, rel=0.02)


def test_clamped_beam_sags_to_its_equilibrium():
    """Under a weight it can bear it comes to rest where statics has it, and its clamped end does not move."""
    beam = make_beam(clamped=True, relaxation_time=0.05, young=2e5)
    tank = Tank(beam, water=beam.water)
    tank.advance(round(5.0 / tank.dt))
    wanted = statics.equilibrium(beam.body, beam.water._replace(planes=None))
    end = beam.body.position[:, 0] == beam.body.position[:, 0].min()
    assert np.array_equal(tank.position[0, end], beam.body.position[end]) and end.sum() == 9
    assert np.ptp(wanted[:, 2]) > 1.2 * 0.08
    np.testing.assert_allclose(tank.position[0], wanted, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("name", "most"), [("beam", 1e-4), ("two materials", 1e-4), ("block", 1e-4), ("ball", 5e-3)])
def test_scene_of_a_solid(name, most):
    """Thrown at the wall and back: energy hardly grows, no node is further behind a wall than a step's travel."""
    row = watched(OBJECTS[name].make(), replace(SCENES["thrown"], seconds=0.5), seed=0)
    assert row["growth"] < most and row["escapes"] == 0 and 0.0 < row["depth_over_travel"] < 1.0


def out_of_shape(body: Body, x) -> float:
    """Largest distance of a node from where it is at rest, over the body's size, once x is turned to fit best."""
    here, there = (a - np.average(a, axis=0, weights=body.mass) for a in (x, body.position))
    u, _, vt = np.linalg.svd((here * body.mass[:, None]).T @ there)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.linalg.norm(here @ turn - there, axis=1).max() / np.ptp(body.position, axis=0).max())


@pytest.mark.parametrize("method", ["leapfrog_chebyshev", "linearly_implicit"])
@pytest.mark.parametrize("how", ["twisted", "inverted"])
@pytest.mark.parametrize("name", tiered(SOLIDS, ["two materials"]))
def test_comes_back_to_its_shape(name, how, method):
    """Twisted half round, or turned inside out, a solid comes back to its shape; a ball stays inside out."""
    thing = OBJECTS[name].make()
    assert np.abs(twist(thing) - thing.body.position).max() > 0.05
    assert (np.linalg.det(deformation(thing.body, invert(thing))) < 0).all()
    tank = released(thing, how, method, thing.time_step)
    tank.advance(round(3.0 / tank.dt))
    off = out_of_shape(thing.body, tank.position[0])
    assert tank.alive[0] and (off > 0.5 if (name, how) == ("ball", "inverted") else off < 5e-3)


def test_linear_and_corotational_agree_on_small_motion():
    """The difference between the measures of strain goes with the square of the motion."""
    apart = []
    for size in (1e-3, 1e-4):
        found = []
        for strain in STRAINS:
            thing = make_beam(4, strain=strain)
            tank = Tank(thing, dt=1e-3, water=VACUUM)
            tank.velocity[0] = size * np.sin(20.0 * thing.body.position[:, ::-1])
            tank.advance(100)
            found.append(tank.position[0] - thing.body.position)
        apart.append(max(np.abs(found[0] - other).max() for other in found[1:]) / size)
    assert apart[1] == pytest.approx(0.1 * apart[0], rel=0.1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: make_beam(0), "cells is 0"), (lambda: make_ball(40), "more than 50000 nodes"),
        (lambda: make_beam(10**12), "more than 50000 nodes"), (lambda: make_beam(across=3), "even"),
        (lambda: make_block(3), "even"),
        (lambda: make_ball(radius=0.0), "radius"), (lambda: make_beam(length=-1.0), "length"),
        (lambda: make_block(side=np.nan), "length"), (lambda: make_ball(youngs=1.0), "has no field 'youngs'"),
        (lambda: make_beam(poisson=0.5), "poisson"), (lambda: make_beam(density=0.0), "density"),
        (lambda: make_two_materials(3), "even"), (lambda: make_two_materials(stiff=2e5), "stiff is a float"),
        (lambda: make_beam(strain="quadratic"), "strain is 'quadratic'"),
        (lambda: make_two_materials(soft=SolidMaterial(young=-1.0)), "young"),
    ],
)  # fmt: skip
def test_refused_solids(call, message):
    """Numbers that make no solid are refused, saying which."""
    with pytest.raises(ValueError, match=message):
        call()


# The stress test of soft fish

FISH = make_fish()
CASES = cases.stored()
OTHERS = [pytest.mark.slow]
each_case = pytest.mark.parametrize(
    "case", [pytest.param(case, marks=OTHERS * (case["body"] != FISH.name)) for case in CASES.values()], ids=CASES
)


# The survey


def test_limit_is_below_every_unstable_step():
    """A stable step beyond an unstable one does not count."""
    found = {1.0: False, 0.5: True, 0.3: False, 0.2: True, 0.1: True}
    assert survey.limit(found) == (0.2, 0.3)
    assert survey.limit({0.1: True}) == (0.1, np.inf)
    assert np.isnan(survey.limit({1.0: False})[0])


def test_the_survey_covers_every_body():
    """Every body as it is, and the default one at every stiffness."""
    found = [(name, factor) for name, factor, _ in survey.cases()]
    assert {name for name, factor in found if factor == 1.0} == set(BODIES)
    assert [factor for name, factor in found if name == FISH.name] == list(survey.STIFFNESS)


@pytest.mark.slow
def test_limit_of_tus_method():
    """A sweep finds the limit that the table has."""
    fish = make_fish()
    (row,) = [row for row in read_table("stability_limits.csv") if row["body"] == fish.name and row["stiffness"] == 1.0
              and row["integrator"] == "semi_implicit"]  # fmt: skip
    found = survey.sweep(fish, "semi_implicit", survey.reference_energy(fish))
    assert survey.limit(found) == (row["largest_stable_s"], row["unstable_from_s"])


# The worst that was found


def test_worst_cases_are_there():
    """Every body has survivors, and the kept cases are small."""
    assert {case["body"] for case in CASES.values() if not case["failure"]} == set(BODIES)
    assert cases.WORST.stat().st_size < 100_000


@each_case
def test_replay(case):
    """A survivor survives; a fish that fails says why and keeps a sound state. Alone or among others: the same.

    Whether a fish on the brink fails may hang on the last digit, so a kept failure need not fail again.
    """
    alone, stretch = cases.replay(case)
    batch, stretches = cases.replay(case, copies=33, threads=2)
    batch.close()
    for one, many in zip(alone.state, batch.state, strict=True):
        assert np.isfinite(one).all()
        assert np.array_equal(np.repeat(one, 33, axis=0), many)
    assert np.all(stretches == stretch)
    assert stretch[0] <= STRETCH_LIMIT
    assert alone.alive[0] == (alone.failure[0] == "")
    assert alone.failure[0] in FAILURES
    if not case["failure"]:
        assert alone.alive[0]


@pytest.mark.parametrize(
    "name", [name for name, case in CASES.items() if case["body"] == FISH.name and not case["failure"]]
)
def test_the_worst_at_the_default_step(name):
    """What stretched the default fish most, at the step it has now: it survives, and what it stretches is bounded."""
    tank, stretch = cases.replay(CASES[name], cases.own_settings(FISH))
    assert tank.alive[0] and stretch[0] < 0.9 * STRETCH_LIMIT


@pytest.mark.parametrize("name", BODIES)
def test_every_body_can_be_crumpled(name):
    """Every start moves a body's free axes only; its sections mirror themselves, and are those of the landmarks."""
    fish = make_fish(name)
    free = np.broadcast_to(fish.body.inverse_mass > 0.0, (2, *fish.body.position.shape))
    for start in mistreatment.STARTS:
        x, v = mistreatment.beginning(start, fish, 2, np.random.default_rng(0))
        assert np.isfinite([x, v]).all() and not v[~free].any() and not (fish.flat and x[:, :, 2].any())
    sections = mistreatment.cross_sections(fish)
    assert len(sections) == 5 and all(np.array_equal(np.sort(fish.mirror[nodes]), nodes) for nodes in sections)
    if name in naive.TU:
        np.testing.assert_array_equal(sections, np.sort(LAYERS[1:6], axis=1))


@pytest.mark.parametrize("name", tiered(BODIES, (FISH.name,)))
def test_the_stress_test_from_beginning_to_end(name, monkeypatch):
    """Every family and every search, with few fish and short sequences; a trial writes nothing."""
    monkeypatch.setattr(mistreatment, "INTERVALS", 12)
    monkeypatch.setattr(stress_search, "POPULATION", 3)
    monkeypatch.setattr(stress_search, "SEARCHED", 8)
    monkeypatch.setattr(stress, "write_csv", lambda *_: pytest.fail("a trial is not published"))
    monkeypatch.setattr(stress, "store", lambda *_: pytest.fail("cases of a trial are not stored"))
    rows = stress.stress((name,), fish=100 if name == FISH.name else 100 * stress.OTHERS, evaluations=1)
    assert [row["family"] for row in rows[:-4]] == [family.name for family in mistreatment.families()]
    assert all(row["family"].startswith("search for ") for row in rows[-4:])
    for row in rows:
        assert row["body"] == name and row["fish"] >= 2 and 0 <= row["failures"] <= row["fish"]
        assert row["rerun_with_rk4"] == min(row["failures"], cases.EXPLAINED) >= row["rk4_fails_too"]
        survived = row["worst_stretch"] > 1.0 and row["peak_energy_over_gait"] > 0.0
        assert survived or row["failures"] == row["fish"]
    assert any(row["failures"] == 0 for row in rows)
    stress.report(rows)


def test_stored_cases_are_read_back(tmp_path):
    """What is stored is read back: settings, states to 32 bits, and commands."""
    case = next(iter(CASES.values()))
    cases.store([case, case | {"failure": "torn"}], tmp_path / "worst.npz")
    found = cases.stored(tmp_path / "worst.npz")
    assert [again["failure"] for again in found.values()] == ["", "torn"]
    for again in found.values():
        assert again.keys() == case.keys() and np.array_equal(again["goals"], case["goals"])
        assert np.array_equal(again["position"], case["position"])


def test_statics_without_stiffness_or_freedom():
    """A straight chain, which nothing keeps straight, is refused; where all nodes are displaced, they are there."""
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    chain = make_body(x, np.ones(3), [(0, 1), (1, 2)], np.full(2, 100.0), np.full(2, 0.1), np.ones(2), [])
    with pytest.raises(NoEquilibrium):
        linear_deflection(chain, [[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    found, _ = prescribed_displacement(chain, [0, 1, 2], (0.0, 0.0, 0.1))
    np.testing.assert_array_equal(found, np.tile([0.0, 0.0, 0.1], (3, 1)))
