"""Elastic objects of finite elements: their meshes and masses, theory of solids, scenes, and who moves them."""

from dataclasses import replace

import numpy as np
import pytest
from moving import tiered
from scipy.optimize import brentq
from soft_bodies import deformation

from benchmarks.objects.methods import is_stable
from benchmarks.objects.scenes import SCENES, watched
from benchmarks.objects.solids import METHODS, released, survives
from fish_env import INTEGRATORS, Tank
from fish_env.lab.objects import Entry, ObjectScene
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM
from fish_env.soft import statics
from fish_env.soft.distorted import invert, out_of_shape, twist
from fish_env.soft.elements import STRAINS, make_compartments
from fish_env.soft.objects import OBJECTS, SOLIDS
from fish_env.soft.solids import SOFT, STIFF, SolidMaterial, make_ball, make_beam, make_block, make_two_materials

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


@pytest.mark.parametrize("strain", tiered(STRAINS, ["corotational"]))
@pytest.mark.parametrize("name", each_method)
def test_methods_are_stable_as_promised(name, strain):
    """A small swing of a block does not grow with 0.95 of the step that linear theory allows, or with a long one."""
    block, explicit = make_block(2, strain=strain), INTEGRATORS[name].kind == "explicit"
    assert is_stable(block, name, 0.95 * INTEGRATORS[name].base(block.body) if explicit else 0.05)


@pytest.mark.parametrize("name", each_method)
def test_implicit_euler_is_the_most_robust(name):
    """Turned inside out, a block survives steps of 66 ms with it alone; explicit ones fail with a sixteenth of that."""
    block = make_block(4)
    assert survives(block, "inverted", name, 1 / 15) == (name == "linearly_implicit")
    assert name not in METHODS[:4] or not survives(block, "inverted", name, 1 / 240)


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


@each_solid
def test_in_the_laboratory(name):
    """It is one of the laboratory's objects, and falls there."""
    scene = ObjectScene([Entry(name)])
    tank = scene.objects[0].tank
    before = tank.position[0, :, 2].mean()
    for _ in range(6):
        scene.advance(1 / 60)
    assert tank.alive[0] and tank.position[0, :, 2].mean() < before - 0.02


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: make_beam(0), "cells is 0"), (lambda: make_ball(40), "more than 50000 nodes"),
        (lambda: make_beam(10**12), "more than 50000 nodes"), (lambda: make_beam(across=3), "even"),
        (lambda: make_block(3), "even"),
        (lambda: make_ball(radius=0.0), "radius"), (lambda: make_beam(length=-1.0), "length"),
        (lambda: make_block(side=np.nan), "length"), (lambda: make_ball(youngs=1.0), "unknown field 'youngs'"),
        (lambda: make_beam(poisson=0.5), "poisson"), (lambda: make_beam(density=0.0), "density"),
        (lambda: make_two_materials(3), "even"), (lambda: make_two_materials(stiff=2e5), "stiff is a float"),
        (lambda: make_beam(strain="quadratic"), "strain is 'quadratic'"),
        (lambda: make_two_materials(soft=SolidMaterial(young=-1.0)), "young"),
    ],
)  # fmt: skip
def test_what_is_refused(call, message):
    """Numbers that make no solid are refused, saying which."""
    with pytest.raises(ValueError, match=message):
        call()
