"""Equilibrium, small deflections and natural frequencies against what can be worked out by hand."""

import numpy as np
import pytest

from fish_env import make_fish, make_water, make_world
from fish_env.bodies.mesh import box, grid, lumped_mass
from fish_env.physics import statics
from fish_env.physics.body import fix, make_body
from fish_env.physics.elements import make_barriers, make_compartments, make_tets
from fish_env.physics.forces import sparse
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.world import VACUUM, make_anchors

NO_FACES = np.zeros((0, 4), dtype=int)


def chain(positions, stiffness, rest_length, mass=1.0):
    """Masses joined one after the other by springs."""
    n = len(positions)
    pairs = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    constant = np.full(n - 1, stiffness)
    return make_body(
        positions, np.full(n, mass), pairs, constant, np.zeros(n - 1), np.full(n - 1, rest_length), NO_FACES
    )


def block(cells=(3, 2, 2), poisson=0.3, **options):
    """A free block of tetrahedra, 0.1 m across."""
    position, nodes = box(0.1 * np.array(cells) / cells[-1], cells)
    mass = lumped_mass(position, nodes, 1000.0)
    return make_body(position, mass, [], [], [], [], [], tets=make_tets(position, nodes, 1e4, poisson), **options)


def everything():
    """A body with elements of every kind, a world with all that pulls, and a state in which they all act."""
    stations = np.linspace(0.0, 0.3, 5)
    mesh = grid(stations, np.full(5, 0.05), np.full(5, 0.05), 2, 2)
    x, rng = mesh.position, np.random.default_rng(3)
    edges = np.unique(np.sort(mesh.tets[:, [0, 1]], axis=1), axis=0)
    natural = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    inner = mesh.number[1:-1, 1, 1]
    outer = [mesh.number[i, 2, 1] for i in (1, 2, 3)], [mesh.number[i + 1, 2, 1] for i in (1, 2, 3)]
    top = [mesh.number[i, 2, 2] for i in (1, 2, 3)]
    watched = np.stack([*outer, top], axis=1)
    body = make_body(
        x, lumped_mass(x, mesh.tets, 1000.0), edges, np.full(len(edges), 30.0), np.zeros(len(edges)), 0.9 * natural,
        mesh.faces, tets=make_tets(x, mesh.tets, 1e4, 0.3),
        compartments=make_compartments(x, [mesh.faces], 200.0, 150.0),
        barriers=make_barriers(x, watched[:, ::-1] if _behind(x, watched, inner) < 0 else watched, inner, 0.1),
    )  # fmt: skip
    anchors = make_anchors([0, 7], [[0.1, 0.2, 0.3], [-0.1, 0.0, 0.2]], [20.0, 30.0], rest_length=[0.0, 0.1])
    world = make_world((0.0, 0.0, -9.81), water=make_water(current=(0.2, 0.3, -0.1)))._replace(anchors=anchors)
    moved = x + 0.002 * rng.normal(size=x.shape)
    moved[inner] += 0.8 * (x[watched].mean(axis=1) - x[inner])  # so near the faces that the barriers push
    return body, world, moved


def _behind(x, faces, inner):
    p, q, r = (x[faces[0, k]] - x[inner[0]] for k in range(3))
    return np.dot(p, np.cross(q, r))


def test_sparse_tangent_is_the_jacobian(monkeypatch):
    """Worked out a few elements at a time, the stiffness of a body with all kinds of them is that of the whole."""
    body, world, x = everything()
    size, rest = x.size, body.springs.rest_length
    still, evaluator = np.zeros_like(x), Evaluator(body, world)
    assert np.abs(Evaluator(body, world, ("barriers",)).force(rest, x, still)).max() > 0
    wanted, _ = evaluator.jacobian(rest, x, still)
    assert wanted.shape == (size, size)
    monkeypatch.setattr(rates, "DENSE", 0)
    monkeypatch.setattr(sparse, "PIECE", 7)
    found = sparse.tangent(body, world, rest, x)
    np.testing.assert_allclose(found.toarray(), wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())
    for k in (0, 25, 80):  # and the whole is the derivative of the force
        sides = []
        for sign in (1, -1):
            moved = x.copy()
            moved.ravel()[k] += sign * 1e-7
            sides.append(evaluator.force(rest, moved, still).ravel())
        slope = (sides[1] - sides[0]) / 2e-7
        np.testing.assert_allclose(found[:, [k]].toarray()[:, 0], slope, rtol=0, atol=1e-6 * np.abs(wanted).max())


def test_weight_on_a_spring():
    """A mass that hangs from a spring stretches it by its weight over the stiffness; a chain adds the weights up."""
    body = fix(chain([[0, 0, 0], [0, 0, -1], [0, 0, -2.0]], stiffness=50.0, rest_length=1.0), [0])
    x = statics.equilibrium(body, make_world((0.0, 0.0, -9.81)), tolerance=1e-13)
    np.testing.assert_allclose(x[:, 2], [0, -1 - 2 * 9.81 / 50, -2 - 3 * 9.81 / 50], rtol=1e-12)
    np.testing.assert_allclose(x[:, :2], 0, atol=1e-14)


def test_far_from_the_start():
    """A slack pendulum started sideways swings down: steps that are too long are shortened."""
    body = fix(chain([[0, 0, 0], [1, 0, -0.2]], stiffness=1000.0, rest_length=1.0), [0])
    x = statics.equilibrium(body, make_world((0.0, 0.0, -9.81)))
    np.testing.assert_allclose(x[1], [0, 0, -1 - 9.81 / 1000], atol=1e-10)


def test_rest_lengths_shape_a_free_fish():
    """With one side's muscles contracted the free fish settles where no force is left, and does not turn or drift."""
    fish = make_fish()
    body = fish.body
    rest = body.springs.rest_length.copy()
    rest[fish.muscles[fish.sides > 0]] *= 0.9
    x = statics.equilibrium(body, rest_length=rest)
    f = Evaluator(body, VACUUM).force(rest, x, np.zeros_like(x))
    assert np.abs(f).max() < 1e-9 * (body.springs.stiffness * rest).max()
    assert np.abs(x - body.position).max() > 0.01 * fish.length
    assert np.abs((x - body.position).mean(axis=0)).max() < 1e-12


@pytest.mark.parametrize("dense", [True, False])
def test_small_load_deflects_linearly(dense, monkeypatch):
    """Under a small load equilibrium is the linear deflection, up to the square of it, dense or sparse."""
    if not dense:
        monkeypatch.setattr(rates, "DENSE", 0)
    body = block()
    body = fix(body, body.position[:, 0] == 0)
    load = np.zeros_like(body.position)
    load[-1] = [0.0, 1e-4, 2e-4]
    u = statics.linear_deflection(body, load)
    moved = statics.equilibrium(body, load=load) - body.position
    assert np.abs(u).max() > 1e-6
    np.testing.assert_allclose(moved, u, rtol=0, atol=50 * np.abs(u).max() ** 2 / 0.1)
    assert not u[body.position[:, 0] == 0].any()


@pytest.mark.parametrize("dense", [True, False])
def test_balanced_load_on_a_free_body(dense, monkeypatch):
    """Pulled at both ends a free block of Poisson's ratio 0 stretches by force over area and stiffness, and stays."""
    if not dense:
        monkeypatch.setattr(rates, "DENSE", 0)
    body = block((4, 2, 2), poisson=0.0)
    x = body.position
    load = np.zeros_like(x)
    for end, sign in ((0.0, -1.0), (0.2, 1.0)):
        for tet in body.tets.nodes:
            side = tet[np.isclose(x[tet, 0], end)]
            if len(side) == 3:
                area = 0.5 * np.linalg.norm(np.cross(x[side[1]] - x[side[0]], x[side[2]] - x[side[0]]))
                load[side, 0] += sign * 100.0 * area / 3
    u = statics.linear_deflection(body, load)
    wanted = np.zeros_like(x)
    wanted[:, 0] = (x[:, 0] - 0.1) * 100.0 / 1e4  # 100 Pa on what has 10 kPa
    np.testing.assert_allclose(u, wanted, atol=1e-12)


def test_pressed_compartment_is_in_balance():
    """A free block around gas of more than the outer pressure swells until every force vanishes."""
    mesh = grid(np.linspace(0, 0.1, 3), np.full(3, 0.05), np.full(3, 0.05), 2, 2)
    body = make_body(
        mesh.position, lumped_mass(*mesh[:2], 1000.0), [], [], [], [], [], tets=make_tets(*mesh[:2], 1e4, 0.3),
        compartments=make_compartments(mesh.position, [mesh.faces], 2000.0, 1000.0),
    )  # fmt: skip
    x = statics.equilibrium(body)
    f = Evaluator(body, VACUUM).force(np.zeros(0), x, np.zeros_like(x))
    assert np.abs(f).max() < 1e-9
    assert np.ptp(x[:, 0]) > 1.01 * 0.1
    frequency, _ = statics.modes(body, 7, position=x)
    assert np.all(frequency[:6] < 1e-3 * frequency[6])


def test_no_equilibrium_beyond_a_barrier():
    """A node drawn to a point beyond its barrier comes to rest before it: a Newton step to the point is no step."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -0.3]])
    barrier = make_barriers(x, [[0, 1, 2]], [3], 1.0)
    body = fix(fix(make_body(x, np.ones(4), [], [], [], [], [], barriers=barrier), [0, 1, 2]), [3], "xy")
    world = VACUUM._replace(anchors=make_anchors([3], [[0.2, 0.2, 0.3]], 10.0))
    found = statics.equilibrium(body, world)
    assert -0.2 < found[3, 2] < 0.0
    pushed = Evaluator(body, world, ("barriers",)).force(np.zeros(0), found, 0 * found)
    np.testing.assert_allclose(pushed[3, 2], -10.0 * (0.3 - found[3, 2]), rtol=1e-8)


@pytest.mark.parametrize("dense", [True, False])
def test_two_masses_on_a_spring(dense, monkeypatch):
    """The free pair vibrates at sqrt(2 c / m); its five rigid motions, and none other, do not."""
    if not dense:
        monkeypatch.setattr(rates, "DENSE", 0)
    body = chain([[0, 0, 0], [1, 0, 0.0]], stiffness=8.0, rest_length=1.0, mass=2.0)
    frequency, shapes = statics.modes(body, 6)
    np.testing.assert_allclose(frequency, [0, 0, 0, 0, 0, np.sqrt(2 * 8.0 / 2.0) / (2 * np.pi)], atol=1e-7)
    np.testing.assert_allclose(np.abs(shapes[-1, :, 0]), 0.5, rtol=1e-12)


def test_taut_string():
    """A mass between two taut springs vibrates across them at sqrt(2 T / (l m)), T the tension, l the length."""
    body = fix(chain([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]], stiffness=10.0, rest_length=0.75, mass=3.0), [0, 2])
    frequency, _ = statics.modes(body, 3)
    across, along = np.sqrt(2 * 2.5 / 3.0), np.sqrt(2 * 10.0 / 3.0)
    np.testing.assert_allclose(2 * np.pi * frequency, [across, across, along], rtol=1e-12)


def test_pressed_springs_are_unstable():
    """The same springs under pressure give way sideways: that place is an equilibrium, and refused as unstable."""
    body = fix(chain([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]], stiffness=10.0, rest_length=1.25, mass=3.0), [0, 2])
    np.testing.assert_array_equal(statics.equilibrium(body), body.position)
    with pytest.raises(statics.NoEquilibrium, match="unstable"):
        statics.modes(body, 1)


def test_modes_are_the_same_dense_or_sparse(monkeypatch):
    """Frequencies agree; shapes are orthonormal in the masses and solve the eigenproblem; rigid ones come first."""
    body = block((3, 3, 2))
    dense, _ = statics.modes(body, 10)
    stiffness = statics.tangent(body, VACUUM, np.zeros(0), body.position)
    monkeypatch.setattr(rates, "DENSE", 0)
    found, shapes = statics.modes(body, 10)
    np.testing.assert_allclose(found[6:], dense[6:], rtol=1e-9)
    assert np.all(found[:6] < 1e-4 * found[6]) and np.all(dense[:6] < 1e-4 * dense[6])
    gram = np.einsum("anc,n,bnc->ab", shapes, body.mass, shapes)
    np.testing.assert_allclose(gram, np.eye(10), atol=1e-9)
    for f, shape in zip(found, shapes, strict=True):
        left, right = stiffness @ shape.ravel(), (2 * np.pi * f) ** 2 * np.repeat(body.mass, 3) * shape.ravel()
        np.testing.assert_allclose(
            left, right, rtol=0, atol=1e-8 * body.max_stiffness_eigenvalue * np.abs(shape).max() * body.mass.max()
        )


def test_what_has_no_answer_is_refused():
    """Walls, falling bodies, loads that move a free body, mechanisms and bad arguments are refused, saying why."""
    body = block()
    load = np.zeros_like(body.position)
    load[0] = [0.0, 0.0, 1.0]
    with pytest.raises(ValueError, match="walls"):
        statics.equilibrium(body, make_world(planes=[((0, 0, 1), 0.0, 0.5)]))
    with pytest.raises(ValueError, match="tolerance"):
        statics.equilibrium(body, tolerance=0.0)
    with pytest.raises(ValueError, match="load"):
        statics.equilibrium(body, load=load[:3])
    with pytest.raises(statics.NoEquilibrium, match="fix or anchor"):
        statics.equilibrium(body, make_world((0.0, 0.0, -9.81)))
    for tied in (body, fix(body, [5])):
        with pytest.raises(ValueError, match="resultant"):
            statics.linear_deflection(tied, load)
    with pytest.raises(statics.NoEquilibrium, match="every motion"):
        slack = fix(chain([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]], stiffness=10.0, rest_length=1.0), [0, 2])
        statics.linear_deflection(slack, np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 0]]))
    for count in (0, body.position.size + 1, 1.5):
        with pytest.raises(ValueError, match="count"):
            statics.modes(body, count)
