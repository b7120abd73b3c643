"""A force of one's own: one file and one entry of the list make it act under every method, in lanes and alone."""

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soft_floor
from moving import tiered
from scipy.sparse import issparse
from soft_floor import Floor

from fish_env import INTEGRATORS, Tank, make_fish, make_world
from fish_env.kernels.compile import part
from fish_env.physics import forces, statics
from fish_env.physics.body import make_body
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces import sparse
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import leapfrog_chebyshev
from fish_env.physics.linalg import rates
from fish_env.physics.world import VACUUM, make_anchors

FISH = 8
SPEEDS = -np.linspace(0.5, 1.0, FISH)
FLOOR = Floor(height=0.0, stiffness=50.0)
MASS = 0.02
QUICK = ("leapfrog_chebyshev", "radau")
"""Methods that are tried in every run; the others take long to compile."""


@pytest.fixture(autouse=True)
def registered():
    """The floor is in the list, after everything else, and is taken out again."""
    forces.FORCES["floor"] = soft_floor
    yield
    del forces.FORCES["floor"]


def pair():
    """Two points that a level spring joins."""
    body = make_body([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [MASS, MASS], [[0, 1]], [5.0], [0.1], [1.0], [])
    return ElasticObject(name="pair", body=body, length=1.0, time_step=1e-5, control_interval=0.01)


def thrown(name, lanes, steps):
    """A pair thrown onto the floor at different speeds, after some steps of 1e-5 s: heights and speeds (FISH,)."""
    world = VACUUM._replace(extra={"floor": FLOOR})
    options = {} if INTEGRATORS[name].kind == "adaptive" else {"lanes": lanes}
    tank = Tank(pair(), FISH, name, 1e-5, water=world, threads=1, **options)
    tank.velocity[:, :, 2] = SPEEDS[:, None]
    tank.vary(3, mass=2.0)
    tank.advance(steps)
    assert tank.alive.all(), tank.failure
    return tank.position[:, 1, 2].copy(), tank.velocity[:, 1, 2].copy()


@pytest.mark.parametrize("name", tiered(INTEGRATORS, QUICK))
def test_every_method(name):
    """A pair on the floor swings back as on a spring, whatever moves it; the same bits one by one and in lanes."""
    time, steps = 0.02, 2000
    rate = np.sqrt(FLOOR.stiffness / (MASS * np.where(np.arange(FISH) == 3, 2.0, 1.0)))
    assert np.all(rate * time < np.pi)  # it is still in the floor
    heights, speeds = thrown(name, "xyz", steps)
    np.testing.assert_allclose(heights, SPEEDS / rate * np.sin(rate * time), rtol=2e-3)
    np.testing.assert_allclose(speeds, SPEEDS * np.cos(rate * time), rtol=2e-3, atol=2e-3)
    if INTEGRATORS[name].kind != "adaptive":
        np.testing.assert_array_equal(thrown(name, FISH, steps), (heights, speeds))


def test_fish_on_a_soft_floor():
    """The default fish, thrown onto the floor under the default method, is held up: the same bits in eight lanes."""
    fish, found = make_fish(), []
    lowest = float(fish.body.position[:, 2].min())
    for lanes, height in (("xyz", lowest), (8, lowest), ("xyz", lowest - 100.0)):
        world = fish.water._replace(extra={"floor": Floor(height, 2.0)})
        tank = Tank(fish, FISH, water=world, threads=1, lanes=lanes)
        tank.velocity[:, :, 2] = -0.2 * fish.length * np.arange(1, FISH + 1)[:, None]
        for k in range(10):
            tank.swim(np.sin(k + np.arange(12.0)), fish.control_interval)
        assert tank.alive.all()
        found.append(tank.get_state())
    for key, value in found[0].items():
        np.testing.assert_array_equal(found[1][key], value, err_msg=key)
    assert np.all((found[0]["x"] - found[2]["x"])[:, :, 2].mean(axis=1) > 1e-3 * fish.length)


def test_evaluated():
    """Its force is in the sum, and the derivatives of the sum have its own, which it does not state."""
    body = pair().body
    x, still, rest = body.position, np.zeros((2, 3)), body.springs.rest_length
    world = VACUUM._replace(extra={"floor": Floor(height=0.1, stiffness=3.0)})
    evaluator = Evaluator(body, world)
    assert evaluator.names == ("springs", "floor")
    np.testing.assert_allclose(evaluator.force(rest, x, still), [[0.0, 0.0, 0.3]] * 2, rtol=1e-15)
    assert evaluator.energies(rest, x, still) == {"kinetic": 0.0, "springs": 0.0} and not evaluator.failures(rest, x)
    stiffness, damping = evaluator.jacobian(rest, x, still)
    alone = Evaluator(body, world, ("springs",)).jacobian(rest, x, still)
    np.testing.assert_allclose(stiffness - alone[0], np.diag([0.0, 0.0, 3.0] * 2), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(damping, alone[1])


def test_sparse():
    """The stiffness of a large body, assembled sparse, has the floor's once, not once for each piece or strip."""
    count = rates.DENSE // 3 + 50
    position = np.stack([0.1 * np.arange(count), 0.02 * np.sin(np.arange(count)), np.full(count, -0.01)], axis=1)
    position[::7, 2] = 0.01  # these are above the floor
    pairs = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    body = make_body(position, np.full(count, MASS), pairs, np.full(count - 1, 5.0), np.zeros(count - 1),
                     np.full(count - 1, 0.09), [])  # fmt: skip
    world = make_world((0.0, 0.0, -9.8), [((0, 0, 1), -1.0, 0.5)])._replace(extra={"floor": FLOOR})
    world = world._replace(anchors=make_anchors([3, 3, count - 1], np.zeros((3, 3)), 7.0))
    found = sparse.tangent(body, world, body.springs.rest_length, position)
    assert issparse(found) and len(forces.present(body, world)) == 5
    wanted, _ = Evaluator(body, world).jacobian(body.springs.rest_length, position, np.zeros_like(position))
    np.testing.assert_allclose(found.toarray(), wanted, rtol=0, atol=1e-12)
    without = sparse.tangent(body, world._replace(extra=None), body.springs.rest_length, position)
    floor = (found - without).toarray()
    np.testing.assert_allclose(floor, np.diag(np.diag(floor)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diag(floor)[2::3], np.where(position[:, 2] < 0.0, FLOOR.stiffness, 0.0), atol=1e-12)


def test_it_resists_shifts():
    """Statics does not take shifts out of the motions of a free body that lies on such a floor: it comes to rest."""
    world = make_world((0.0, 0.0, -9.8))._replace(extra={"floor": FLOOR})
    x = statics.equilibrium(pair().body, world, start=pair().body.position - [0.0, 0.0, 0.02])
    np.testing.assert_allclose(x[:, 2], -9.8 * MASS / FLOOR.stiffness, rtol=1e-9)


def test_walls_take_from_it():
    """The walls jump and so act last: they take what presses a node further behind them from the floor's force too."""
    body, still = pair().body, np.zeros((2, 3))
    for normal, wanted in (((0, 0, 1), 0.3), ((0, 0, -1), 0.0)):
        planes = np.array([[*normal, 1.0 if normal[2] > 0 else 0.0, 0.5]])
        world = VACUUM._replace(extra={"floor": Floor(0.1, 3.0)}, planes=planes)
        found = Evaluator(body, world).force(body.springs.rest_length, body.position, still)
        np.testing.assert_allclose(found[:, 2], wanted, rtol=1e-15)


def test_taken_out_again():
    """Where the world has no such floor, no kernel is compiled with it."""
    assert forces.present(pair().body, VACUUM) == ("springs",)


EDITED = Path(soft_floor.__file__).read_text().replace("(world.floor.stiffness", "(3.0 * world.floor.stiffness")


def replaced():
    """A cell of a notebook that is run again: another force under the same name."""
    forces.FORCES["floor"] = module = ModuleType("soft_floor")
    exec(EDITED, module.__dict__)


def reloaded():
    """`importlib.reload` after an edit: the same module with other functions."""
    exec(EDITED, forces.FORCES["floor"].__dict__)


@pytest.mark.parametrize("change", [replaced, reloaded])
def test_defined_again(change, monkeypatch):
    """New tanks and new evaluators have the force as it is defined now, and those of before go on as they were."""
    first = ModuleType("soft_floor")
    first.__dict__.update(soft_floor.__dict__)
    monkeypatch.setitem(forces.FORCES, "floor", first)
    world, still = VACUUM._replace(extra={"floor": FLOOR}), np.zeros((2, 3))
    body, sunk = pair().body, pair().body.position - [0.0, 0.0, 0.01]

    def made():
        tank, evaluator = Tank(pair(), 1, "leapfrog_chebyshev", 1e-5, water=world, threads=1), Evaluator(body, world)
        tank.position[...] = sunk
        return tank, evaluator

    def pushed(tank, evaluator):
        before = tank.velocity[0, 0, 2]
        tank.position[...] = sunk
        tank.advance(1)
        force = evaluator.force(body.springs.rest_length, sunk, still)[0, 2]
        return (tank.velocity[0, 0, 2] - before) * MASS / 1e-5, force

    old = made()
    np.testing.assert_allclose(pushed(*old), 0.01 * FLOOR.stiffness, rtol=1e-4)
    change()
    np.testing.assert_allclose(pushed(*made()), 3 * 0.01 * FLOOR.stiffness, rtol=1e-4)
    np.testing.assert_allclose(pushed(*old), 0.01 * FLOOR.stiffness, rtol=1e-4)


def test_a_method_defined_again(monkeypatch):
    """So it is with a user's method: its kernels are those that it has now."""
    method = ModuleType("own_method")
    method.__dict__.update({name: getattr(leapfrog_chebyshev, name) for name in ("plan", "costs", "make_work")})
    method.make_run = leapfrog_chebyshev.make_run
    record = replace(INTEGRATORS["leapfrog_chebyshev"], name="own", method=method)
    monkeypatch.setitem(INTEGRATORS, "own", record)

    def fallen():
        tank = Tank(pair(), 1, "own", 1e-3, water=make_world((0.0, 0.0, -9.8)), threads=1)
        tank.advance(10)
        return tank.velocity[0, 0, 2]

    np.testing.assert_allclose(fallen(), -0.098, rtol=1e-9)

    def stands(names):
        @part
        def run(body, world, control, x, v, work, cache, n):
            pass

        return run

    method.make_run = stands
    assert fallen() == 0.0
