"""Equilibrium, small deflections, prescribed displacements and natural frequencies, against results by hand."""

import numpy as np
import pytest
import small_bodies
from small_bodies import bar_task

from fish_env import make_fish, make_water, make_world
from fish_env.physics.body import fix, make_body
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.world import VACUUM
from fish_env.soft import sparse, statics
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_barriers, make_compartments, make_tets
from fish_env.soft.mesh import box, grid, lumped_mass
from fish_env.soft.objects import make_ring
from fish_env.soft.statics import NoEquilibrium, equilibrium, linear_deflection, modes, prescribed_displacement

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


def block(cells=(3, 2, 2), poisson=0.3):
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
    mesh = grid(np.linspace(0.0, 0.3, 5), np.full(5, 0.05), np.full(5, 0.05), 2, 2)
    x, rng = mesh.position, np.random.default_rng(3)
    edges = np.unique(np.sort(mesh.tets[:, [0, 1]], axis=1), axis=0)
    natural = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    inner = mesh.number[1:-1, 1, 1]
    faces = np.stack([mesh.number[1:4, 2, 1], mesh.number[2:5, 2, 1], mesh.number[1:4, 2, 2]], axis=1)
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


def test_springs_under_weight():
    """A chain hangs from springs stretched by the weights below them; one started sideways swings down."""
    body = fix(chain([[0, 0, 0], [0, 0, -1], [0, 0, -2.0]], stiffness=50.0, rest_length=1.0), [0])
    x = equilibrium(body, WEIGHT, tolerance=1e-13)
    np.testing.assert_allclose(x[:, 2], [0, -1 - 2 * 9.81 / 50, -2 - 3 * 9.81 / 50], rtol=1e-12)
    np.testing.assert_allclose(x[:, :2], 0, atol=1e-14)
    body = fix(chain([[0, 0, 0], [1, 0, -0.2]], stiffness=1000.0, rest_length=1.0), [0])
    np.testing.assert_allclose(equilibrium(body, WEIGHT)[1], [0, 0, -1 - 9.81 / 1000], atol=1e-10)


def test_rest_lengths_shape_a_free_fish():
    """With one side's muscles contracted the free fish bends until no force is left, and does not turn or drift."""
    fish = make_fish()
    body, rest = fish.body, fish.body.springs.rest_length.copy()
    rest[fish.muscles[fish.sides > 0]] *= 0.9
    x = equilibrium(body, rest_length=rest)
    f = Evaluator(body, VACUUM).force(rest, x, np.zeros_like(x))
    assert np.abs(f).max() < 1e-9 * (body.springs.stiffness * rest).max()
    assert np.abs(x - body.position).max() > 0.01 * fish.length
    assert np.abs((x - body.position).mean(axis=0)).max() < 1e-12


def test_gas_in_a_free_block():
    """A free block around gas of more than the outer pressure swells until every force vanishes."""
    mesh = grid(np.linspace(0, 0.1, 3), np.full(3, 0.05), np.full(3, 0.05), 2, 2)
    body = make_body(
        mesh.position, lumped_mass(*mesh[:2], 1000.0), [], [], [], [], [], tets=make_tets(*mesh[:2], 1e4, 0.3),
        compartments=make_compartments(mesh.position, [mesh.faces], 2000.0, 1000.0),
    )  # fmt: skip
    x = equilibrium(body)
    assert np.abs(Evaluator(body, VACUUM).force(np.zeros(0), x, np.zeros_like(x))).max() < 1e-9
    assert np.ptp(x[:, 0]) > 1.01 * 0.1
    frequency, _ = modes(body, 7, position=x)
    assert np.all(frequency[:6] < 1e-3 * frequency[6])


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
    body = block()
    body = fix(body, body.position[:, 0] == 0)
    load = np.zeros_like(body.position)
    load[-1] = [0.0, 1e-4, 2e-4]
    u = linear_deflection(body, load)
    assert np.abs(u).max() > 1e-6 and not u[body.position[:, 0] == 0].any()
    bent = equilibrium(body, load=load) - body.position
    np.testing.assert_allclose(bent, u, rtol=0, atol=50 * np.abs(u).max() ** 2 / 0.1)
    body = block((4, 2, 2), poisson=0.0)
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


@pytest.mark.parametrize("body", [make_ring(nodes=12).body, small_bodies.two_layers()], ids=["ring", "all"])
def test_penalty_beside_elimination(body):
    """The difference of the two methods falls in proportion to 1 / multiple; reactions and loads balance."""
    rng, body = np.random.default_rng(3), fix(body, [0, 1, 2])
    flat = not (body.inverse_mass > 0).all(axis=1).any()  # a ring is fixed along z everywhere
    nodes = np.flatnonzero((body.inverse_mass[:, : 2 if flat else 3] > 0).all(axis=1))[-2:]
    given, load = 1e-3 * rng.normal(size=(2, 3)), 1e-3 * rng.normal(size=body.position.shape)
    if flat:
        given[:, 2], load[:, 2] = 0.0, 0.0
    exact, bearing = prescribed_displacement(body, nodes, given, load)
    np.testing.assert_array_equal(exact[nodes], given)
    off = []
    for multiple in (1e4, 1e6):
        near, pull = prescribed_displacement(body, nodes, given, load, method="penalty", multiple=multiple)
        off.append(np.abs(near - exact).max())
        np.testing.assert_allclose(pull, bearing, rtol=0, atol=30 / multiple * np.abs(bearing).max())
        np.testing.assert_allclose(pull.sum(axis=0), bearing.sum(axis=0), atol=1e-2 * np.abs(bearing).max())
    assert off[0] / off[1] == pytest.approx(100.0, rel=1e-2) and off[0] < 1e-3 * np.abs(given).max()


# Natural frequencies


def test_two_masses_on_a_spring(algebra):
    """The free pair vibrates at sqrt(2 c / m); its five rigid motions, and none other, do not."""
    body = chain([[0, 0, 0], [1, 0, 0.0]], stiffness=8.0, rest_length=1.0, mass=2.0)
    frequency, shapes = modes(body, 6)
    np.testing.assert_allclose(frequency, [0, 0, 0, 0, 0, np.sqrt(2 * 8.0 / 2.0) / (2 * np.pi)], atol=1e-7)
    np.testing.assert_allclose(np.abs(shapes[-1, :, 0]), 0.5, rtol=1e-12)


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
    body = block((3, 3, 2))
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
    (lambda: equilibrium(block(), make_world(planes=[((0, 0, 1), 0.0, 0.5)])), ValueError, "walls"),
    (lambda: equilibrium(block(), tolerance=0.0), ValueError, "tolerance"),
    (lambda: equilibrium(block(), load=ONE_UP[:3]), ValueError, "load"),
    (lambda: equilibrium(block(), WEIGHT), NoEquilibrium, "fix or anchor"),
    (lambda: linear_deflection(block(), ONE_UP), ValueError, "resultant"),
    (lambda: linear_deflection(fix(block(), [5]), ONE_UP), ValueError, "resultant"),
    (lambda: linear_deflection(three(rest_length=1.0), SIDEWAYS), NoEquilibrium, "every motion"),
    (lambda: modes(block(), 0), ValueError, "count"),
    (lambda: modes(block(), 109), ValueError, "count"),
    (lambda: modes(block(), 1.5), ValueError, "count"),
    (lambda: prescribed_displacement(cube(), [0], (1e-3, 0, 0)), NoEquilibrium, "does not resist every motion"),
    (lambda: prescribed_displacement(cube(), [0], (1e-3, 0, 0), method="penalty"), NoEquilibrium, "every motion"),
])  # fmt: skip
def test_refused(call, error, text):
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
