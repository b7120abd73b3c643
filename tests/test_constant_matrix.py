"""The system matrix of linear elasticity is factored once, and again when what it is made of changes, and only then."""

from itertools import product

import numpy as np
import pytest
from small_bodies import block

from benchmarks.common.beam import loose
from fish_env import Tank, make_water, make_world
from fish_env.physics import forces
from fish_env.physics.body import fix, make_body
from fish_env.physics.failures import FAILURES, UNTRUSTED_SOLVE
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import grid, lumped_mass

STEP = 0.002  # s
AIR = make_world(gravity=(0.0, 0.0, -9.81), viscosity=1e-3)._replace(anchors=make_anchors([], np.zeros((0, 3)), 1.0))
"""Without anchors, but with the kernels of anchors, which all tests here share."""
METHODS = ("linearly_implicit", "linearly_implicit_projected", "rosenbrock")
MANY = {"count": 11}
OPTIONS = ({}, MANY, {"count": 3, "dtype": "float32"})
QUICK = (("linearly_implicit", {}), ("linearly_implicit", MANY), ("rosenbrock", {}))


def made(count=1, name="linearly_implicit", world=AIR, strain="linear", clamped=True, **options) -> Tank:
    """Blocks of eight cells, their nodes displaced at random."""
    body = block(strain, cells=2)
    body = fix(body, body.position[:, 0] == body.position[:, 0].min()) if clamped else body
    tank = Tank(loose(body, STEP), count, name, STEP, world, **({"threads": 1} | options))
    shift = np.random.default_rng(0).normal(scale=1e-3, size=tank.position[0].shape)
    tank.position[:] += shift * (body.inverse_mass > 0)
    return tank


def refactoring(tank: Tank) -> Tank:
    """The tank, told that its matrix changes with the motion: it factors one a step, as for other bodies."""
    for each in tank._engine.blocks:
        each.control.set(constant=False)
    return tank


def factored(tank: Tank, steps: int) -> list[int]:
    """How many factorisations each body was counted while it took so many steps."""
    before = tank.counters["factorisations"].copy()
    tank.advance(steps)
    return (tank.counters["factorisations"] - before).tolist()


def same(one: Tank, other: Tank, i=slice(None), k=slice(None)) -> bool:
    """Whether bodies i of a tank move as bodies k of another one, bit for bit."""
    return all(a[i].tobytes() == b[k].tobytes() for a, b in zip(one.state[:2], other.state[:2], strict=True))


@pytest.mark.parametrize(
    ("name", "options"),
    [pytest.param(*case, marks=[] if case in QUICK else pytest.mark.slow) for case in product(METHODS, OPTIONS)],
    ids=str,
)
def test_same_bits_as_with_refactorisation(name, options):
    """The factors that are used again give the trajectory of a new factorisation a step, bit for bit."""
    tank, other = made(name=name, **options), refactoring(made(name=name, **options))
    for _ in range(4):
        tank.advance(10)
        other.advance(10)
    assert tank.alive.all() and np.ptp(tank.position - tank.fish.body.position) > 1e-3 and same(tank, other)
    assert tank.counters["factorisations"].sum() == min(tank.num_fish, tank.kind.width)  # those of the first block
    assert (other.counters["factorisations"] == 40).all()
    assert np.array_equal(tank.counters["solves"], other.counters["solves"])


def test_factored_again_when_it_changes():
    """Another stiffness, mass, boundary condition or penalty is a new matrix; positions and drag are none."""
    tank = made()
    assert factored(tank, 20) == [1]
    assert factored(tank, 20) == [0]
    tank.reset()
    assert factored(tank, 5) == [0]
    last = tank.position.shape[1] - 1
    for change in (
        lambda: tank.vary(0, stiffness=2.0), lambda: tank.vary(0, stiffness=2.0, mass=0.5), lambda: tank.vary(0),
        lambda: tank.fix([last], "xy"), lambda: tank.move([last], (0.0, 0.0, 0.1)), lambda: tank.release([last]),
        lambda: tank.fix([last], method="penalty"), lambda: tank.release([last]),
        lambda: tank.grab(last, (0.3, 0.0, 0.0), 5.0, 0.1, 0.0),
    ):  # fmt: skip
        change()
        assert factored(tank, 7) == [1]
    tank.grab(last, (0.0, 0.3, 0.0), 5.0, 0.1, 0.0)  # the hand has moved, the spring is the same
    assert factored(tank, 7) == [0]
    tank.grab(last, (0.0, 0.3, 0.0), 5.0, 0.1, 0.05)  # a spring with a length turns, and its stiffness with it
    assert factored(tank, 7) == [7]


@pytest.mark.parametrize("change", [{"stiffness": 3.0}, {"mass": 0.4}, {"stiffness": 0.5, "mass": 0.5}], ids=str)
def test_fish_that_differ_have_matrices_of_their_own(change):
    """In a batch of bodies some of which differ, in the first and in the second block, each moves as by itself."""
    batch = made(**MANY)
    for i in (1, 9):
        batch.vary(i, **change)
    batch.advance(15)
    batch.advance(15)
    plain, varied = refactoring(made()), refactoring(made())
    varied.vary(0, **change)
    plain.advance(30)
    varied.advance(30)
    assert all(same(batch, varied if i in (1, 9) else plain, i, 0) for i in range(11))


def test_what_is_not_constant():
    """Elements of another measure of strain, and water that is taken implicitly, are factored a step."""
    for strain in ("linear", "corotational", "green_lagrange"):
        assert forces.constant_system(block(strain), AIR) == (strain == "linear")
    mesh = grid(np.linspace(0.0, 0.2, 3), np.full(3, 0.05), np.full(3, 0.05), 2, 2)
    tets = make_tets(mesh.position, mesh.tets, 2e4, 0.3, strain="linear")
    mass = lumped_mass(mesh.position, mesh.tets, 1000.0)
    wet = loose(make_body(mesh.position, mass, [], [], [], [], mesh.faces, tets=tets), STEP)
    assert factored(Tank(wet, 1, "linearly_implicit_water", STEP, make_water(), threads=1), 9) == [9]


@pytest.mark.slow
@pytest.mark.parametrize("strain", ["corotational", "green_lagrange"])
def test_other_measures_of_strain(strain):
    """So the engine does."""
    assert factored(made(strain=strain), 9) == [9]


def test_anchors_without_length_are_constant():
    """A body on anchors without length has one matrix, and swings as it does with a new factorisation a step."""
    world = AIR._replace(anchors=make_anchors([0, 1], np.zeros((2, 3)), 40.0, 0.1, 0.0))
    tank, other = made(world=world, clamped=False), refactoring(made(world=world, clamped=False))
    assert factored(tank, 30) == [1] and factored(other, 30) == [30] and same(tank, other)


def test_a_matrix_that_cannot_be_trusted_is_not_kept():
    """A free body beside whose stiffness its mass is lost fails; afterwards it moves as if nothing had been."""
    tank, other = made(clamped=False), made(clamped=False)
    tank.vary(0, stiffness=1e9, mass=1e-9)
    tank.advance(5)
    assert tank.failure[0] == FAILURES[UNTRUSTED_SOLVE]
    tank.vary(0)
    tank.reset()
    other.reset()
    assert factored(tank, 5) == [1] and factored(other, 5) == [1] and same(tank, other)
