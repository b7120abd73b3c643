"""Tetrahedra against theory: patches, beams, rotations, inversion and damping; and their meshes."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import soft_bodies
from moving import tiered

from benchmarks.accuracy import finite_elements
from benchmarks.common import beam
from fish_env import Tank, make_world
from fish_env.physics.body import fix
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.soft import statics
from fish_env.soft.elements import STRAINS, make_compartments
from fish_env.soft.mesh import box, grid, lumped_mass
from fish_env.soft.volume import volume_of

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # a rotation by about 74 degrees
YOUNG, SHEAR = 2e5, 2e5 / 2.6


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
    f, turn = soft_bodies.deformation(body, x), np.eye(3)
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
    expected = 2 * SHEAR * strain + YOUNG * 0.3 / (1.3 * 0.4) * np.trace(strain) * np.eye(3)
    for stress in stresses(body, x):
        np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


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
        reflected[strain] = np.abs(f).max() / (YOUNG * 0.1**2)
    assert reflected["green_lagrange"] < 1e-14 and min(reflected["linear"], reflected["corotational"]) > 1e-2
    stretch = np.linspace(0.3, 0.9, 601)
    hardest = stretch[np.argmin([finite_elements.law("green_lagrange", s) for s in stretch])]
    assert hardest == pytest.approx(1 / np.sqrt(3), abs=1e-3)


# Motion

EVERY_RUN = {("reflected", "leapfrog_chebyshev"), ("scrambled", "linearly_implicit")}


@pytest.mark.parametrize(("how", "method"), [
    pytest.param(how, method, marks=() if (how, method) in EVERY_RUN else pytest.mark.slow)
    for how in ("reflected", "flattened", "scrambled") for method in soft_bodies.STEPS
])  # fmt: skip
def test_inverted_bodies_recover(how, method):
    """A block turned inside out, flattened or scrambled returns to its shape, and no tank fails."""
    body, lowest = soft_bodies.damped_block((6, 2, 2))
    start = soft_bodies.deformed_start(body, how, seed=1)
    result = soft_bodies.recover(body, lowest, start, method)
    assert result["inverted_at_start"] == 1.0 if how == "reflected" else result["inverted_at_start"] > 0.3
    assert result["failure"] == "" and result["out_of_shape"] < 1e-6


@pytest.mark.parametrize(("relaxation", "steps"), [(0.0, 200), (0.01, 20)])
def test_implicit_method_is_implicit_euler(relaxation, steps):
    """On the beam's first mode `linearly_implicit` turns and decays as implicit Euler: to the frequency as h goes to 0.

    At 20 steps a period five sixths of the energy are gone after one, and 96 % at ten.
    """
    body = beam.cantilever(2, relaxation_time=relaxation / beam.vertical(beam.cantilever(2))[0])
    places, energy = soft_bodies.ringing(body, "linearly_implicit", 1.5, steps)
    found = soft_bodies.rates_of(places, steps)
    assert found == pytest.approx(soft_bodies.implicit_euler(relaxation, steps), rel=1e-6)
    assert abs(found[0] / (2 * np.pi) - 1) < (0.05 if steps == 20 else 0.002)
    assert steps == 200 or energy[20] / energy[0] < 0.16
    assert np.exp(-2 * soft_bodies.implicit_euler(0.0, 10)[1]) == pytest.approx(0.04, abs=0.005)  # at ten steps


def test_decay_of_the_first_mode():
    """It decays at half the relaxation time times the square of its angular frequency, to a thousandth."""
    period = 1.0 / beam.vertical(beam.cantilever(2))[0]
    body = beam.cantilever(2, relaxation_time=0.01 * period)
    places, _ = soft_bodies.ringing(body, "leapfrog_chebyshev", 2.0, 500)
    assert soft_bodies.rates_of(places, 500)[1] == pytest.approx(0.5 * 0.01 * (2 * np.pi) ** 2, rel=1e-3)


@pytest.mark.parametrize("method", tiered(soft_bodies.STEPS, ("leapfrog_chebyshev",)))
def test_drag_of_the_air_only_slows(method):
    """One step on small motions about rest of a strongly damped body in thick air has no eigenvalue beyond 1."""
    body, lowest = soft_bodies.damped_block((12, 2, 2))
    step, size, small = 0.02 / lowest, body.position.size, 1e-9
    air = make_world(viscosity=0.2 * lowest * float(body.mass.mean()))
    tank = Tank(beam.loose(body, step), 2 * size, method, step, air, threads=1, lanes="xyz")
    for k in range(size):
        tank.position[k].ravel()[k] += small
        tank.velocity[size + k].ravel()[k] += small
    tank.advance(1)
    change = [(a - b).reshape(2 * size, size) for a, b in ((tank.position, body.position), (tank.velocity, 0.0))]
    largest = np.abs(np.linalg.eigvals(np.concatenate(change, axis=1) / small)).max()
    assert 1 - 1e-9 < largest < 1 + 1e-4


@pytest.mark.parametrize("method", tiered(["linearly_implicit_projected", "leapfrog_chebyshev"]))
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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_surface_encloses_the_elements(sign):
    """The surface is closed and outward; where cross-sections stay rectangles in proportion it holds their volume."""
    mesh = grid(sign * np.array([0, 0.1, 0.3]), [0.05, 0.03, 0.02], [0.1, 0.06, 0.04], 2, 4)
    compartments = make_compartments(mesh.position, [mesh.faces], 1.0)  # refuses an open one
    enclosed = volume_of(compartments.faces, mesh.position)[0]
    assert enclosed == pytest.approx(volumes(mesh.position, mesh.tets).sum(), rel=1e-12)


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
