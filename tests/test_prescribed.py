"""Nodes moved by given displacements at rest: by elimination and by penalty, with reactions, against exact results."""

import numpy as np
import pytest
import small_bodies
from small_bodies import bar_task

from fish_env import Tank, make_fish, make_world
from fish_env.bodies.objects import make_ring
from fish_env.physics.body import fix, make_body
from fish_env.physics.elements import make_tets
from fish_env.physics.fish import ElasticObject
from fish_env.physics.prescribed import prescribed_displacement, reactions
from fish_env.physics.statics import NoEquilibrium, equilibrium

METHODS = ("elimination", "penalty")
YOUNG, SIZE = 1e5, 0.05


def block(poisson=0.3, cells=2, linear=False):
    """A cube of tetrahedra, (cells+1)^3 nodes."""
    task = bar_task((cells, cells, cells), SIZE / cells)
    tets = task.body.tets
    shape = make_tets(task.body.position, tets.nodes, YOUNG, poisson, strain="linear" if linear else "corotational")
    return make_body(task.body.position, task.body.mass, [], [], [], [], [], tets=shape)


def held(body):
    """Free to become thinner: its left face is fixed along x, and points of it across."""
    x = body.position
    left = np.flatnonzero(x[:, 0] == 0.0)
    body = fix(body, left, "x")
    body = fix(body, left[x[left, 1] == 0.0], "y")
    return fix(body, left[x[left, 2] == 0.0], "z")


@pytest.mark.parametrize("linear", [True, False], ids=["linear", "corotational"])
@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_is_pulled(method, linear):
    """Uniaxial tension of a block without contraction: exact strain everywhere, and the stress of Young's modulus."""
    body = held(block(poisson=0.0, linear=linear))
    right = np.flatnonzero(body.position[:, 0] == body.position[:, 0].max())
    by = 1e-3 * SIZE
    multiple = 1e9 if method == "penalty" else 1.0
    found, bearing = prescribed_displacement(body, right, (by, 0, 0), method=method, multiple=multiple)
    tolerance = 1e-7 if method == "penalty" else 1e-11
    np.testing.assert_allclose(found[:, 0], by * body.position[:, 0] / SIZE, rtol=0, atol=tolerance * by)
    np.testing.assert_allclose(found[:, 1:], 0.0, atol=tolerance * by)
    stress = YOUNG * by / SIZE
    np.testing.assert_allclose(bearing[right].sum(axis=0), [stress * SIZE**2, 0, 0], rtol=tolerance, atol=1e-9)
    np.testing.assert_allclose(bearing.sum(axis=0), 0.0, atol=1e-9 * stress * SIZE**2)


@pytest.mark.parametrize(
    "body", [block(), make_ring(nodes=12).body, small_bodies.two_layers()], ids=["tets", "ring", "all"]
)
def test_penalty_beside_elimination(body):
    """The difference of the two methods falls in proportion to 1 / multiple; reactions and loads balance."""
    rng = np.random.default_rng(3)
    body = fix(body, [0, 1, 2])
    free = np.flatnonzero((body.inverse_mass > 0).all(axis=1))
    flat = not free.size  # a ring is fixed along z everywhere
    moved = np.flatnonzero((body.inverse_mass[:, :2] > 0).all(axis=1))[-2:] if flat else free[-2:]
    given, load = 1e-3 * rng.normal(size=(2, 3)), 1e-3 * rng.normal(size=body.position.shape)
    if flat:
        given[:, 2], load[:, 2] = 0.0, 0.0
    exact, bearing = prescribed_displacement(body, moved, given, load)
    np.testing.assert_array_equal(exact[moved], given)
    off = []
    for multiple in (1e4, 1e6):
        near, pull = prescribed_displacement(body, moved, given, load, method="penalty", multiple=multiple)
        off.append(np.abs(near - exact).max())
        np.testing.assert_allclose(pull, bearing, rtol=0, atol=30 / multiple * np.abs(bearing).max())
        np.testing.assert_allclose(pull.sum(axis=0), bearing.sum(axis=0), atol=1e-2 * np.abs(bearing).max())
    assert off[0] / off[1] == pytest.approx(100.0, rel=1e-2) and off[0] < 1e-3 * np.abs(given).max()


def test_statics_beside_a_tank_that_has_settled():
    """A tank whose nodes were moved a little and held settles where the linear problem says, with its reactions."""
    task = bar_task((3, 1, 1))
    tets = task.body.tets._replace(relaxation_time=np.full(len(task.body.tets.nodes), 0.02))
    body, by = task.body._replace(tets=tets), np.array([1e-5, 0.0, 0.0])
    wanted, bearing = prescribed_displacement(body, task.nodes, by)
    thing = ElasticObject(name="bar", body=body, length=0.15, time_step=1e-3, control_interval=0.02)
    tank = Tank(thing, 1, "linearly_implicit", 5e-3)
    tank.move(task.nodes, by / 5e-3)
    tank.advance(1)
    tank.fix(task.nodes)
    tank.advance(6000)
    np.testing.assert_allclose(tank.position[0] - body.position, wanted, rtol=0, atol=1e-3 * 1e-5)
    held_now = tank.reactions()[0]
    np.testing.assert_allclose(held_now[task.nodes].sum(axis=0), bearing[task.nodes].sum(axis=0), rtol=1e-3, atol=1e-6)


def test_reactions_of_a_body_that_hangs():
    """At the equilibrium of a large displacement, what holds the body carries its weight and nothing else."""
    body = fix(block(), [0, 1, 2])
    world = make_world((0.0, 0.0, -9.81))
    found = reactions(body, equilibrium(body, world), world)
    np.testing.assert_allclose(found.sum(axis=0), [0, 0, 9.81 * body.mass.sum()], rtol=1e-8, atol=1e-7)
    assert not found[3:].any()


@pytest.mark.parametrize(("change", "said"), [
    ({"nodes": [999]}, "contain node 999"), ({"displacement": (1.0, 2.0)}, "displacement"),
    ({"displacement": np.nan}, "displacement"),
    ({"method": "glue"}, "elimination"), ({"multiple": 0.0}, "multiple"), ({"nodes": [0]}, "free them"),
])  # fmt: skip
def test_refused(change, said):
    """Bad input is refused by name."""
    body = fix(block(), [0, 1, 2])
    with pytest.raises(ValueError, match=said):
        prescribed_displacement(**({"body": body, "nodes": [5], "displacement": (1e-3, 0, 0)} | change))


@pytest.mark.parametrize("method", METHODS)
def test_too_few_are_held(method):
    """A body that can still turn has no solution, and the error says so."""
    with pytest.raises(NoEquilibrium, match="does not resist every motion"):
        prescribed_displacement(block(), [0], (1e-3, 0, 0), method=method)


def test_a_hand_that_moves():
    """Dragged at a steady velocity in one call or in many, a fish moves alike."""
    fish, velocity, point = make_fish(), np.array([0.3, 0.1, 0.0]), None
    tanks = [Tank(fish, threads=1) for _ in range(2)]
    for tank in tanks:
        point = tank.position[0, 4].copy()
        tank.grab(4, point, 5.0, 0.05, velocity=velocity)
    tanks[0].advance(60)
    for _ in range(60):
        tanks[1].advance(1)
    np.testing.assert_allclose(tanks[1].position, tanks[0].position, rtol=0, atol=1e-12)
    seconds = 60 * tanks[0].dt
    np.testing.assert_allclose(tanks[1].world.anchors.point[0], point + velocity * seconds, rtol=1e-12)
    late = Tank(fish, threads=1)  # a hand without velocity that is put where the other one is, before every step
    for k in range(60):
        late.grab(4, point + velocity * k * late.dt, 5.0, 0.05)
        late.advance(1)
    assert np.abs(late.position - tanks[0].position).max() > 1e-6
    with pytest.raises(ValueError, match="velocity"):
        tanks[0].grab(4, point, 5.0, velocity=(0.0, np.inf, 0.0))


def test_a_mass_that_a_hand_drags():
    """Drawn from rest by a spring whose far end moves at v, a mass is at v t - (v / w) sin(w t); energies follow.

    The energy of the mass and the spring is the work that the hand has done: its force times its way.
    """
    mass, stiffness, v, h, n = 0.1, 10.0, 0.3, 1e-3, 400
    w, times = np.sqrt(stiffness / mass), h * np.arange(1, n + 1)
    body = make_body(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.full(2, mass), *[[]] * 5)
    tank = Tank(ElasticObject(name="beads", body=body, length=1.0, time_step=h, control_interval=0.02), 1, None, h)
    tank.grab(0, np.zeros(3), stiffness, velocity=(v, 0.0, 0.0))
    place, speed = np.zeros(n), np.zeros(n)
    for k in range(n):
        tank.advance(1)
        place[k], speed[k] = tank.position[0, 0, 0], tank.velocity[0, 0, 0]
    near = (w * h) ** 2  # the method is of second order
    np.testing.assert_allclose(place, v * times - v / w * np.sin(w * times), rtol=0, atol=near * v * times[-1])
    np.testing.assert_allclose(speed, v - v * np.cos(w * times), rtol=0, atol=near * 2 * v)
    stretch = v * times - place
    energy = 0.5 * mass * speed**2 + 0.5 * stiffness * stretch**2
    force = stiffness * np.concatenate([[0.0], stretch])
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * v * h)
    np.testing.assert_allclose(energy, work, rtol=0, atol=2 * near * energy.max())
