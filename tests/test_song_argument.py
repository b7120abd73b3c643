"""One layer beside two: balance at rest, closed-form expansion, collapse without gas; densities and damping."""

import numpy as np
import pytest
from scipy.optimize import brentq

from benchmarks.objects.layers import HEAVY, collapse, enclosed, impact
from fish_env import Tank
from fish_env.bodies.objects import OBJECTS, RING, make_ring, make_sphere, make_uniform_sphere
from fish_env.bodies.skins import KINDS
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.statics import equilibrium, modes
from fish_env.physics.world import VACUUM

SONG = ("ring", "sphere", "uniform sphere")


@pytest.mark.parametrize("name", SONG)
def test_one_layer_is_built_at_rest(name):
    """The outer layer alone: its springs balance the gas to 1e-12, and no node is an inner one."""
    thing, both = OBJECTS[name].make(layers=1), OBJECTS[name].make()
    body, still = thing.body, np.zeros_like(thing.body.position)
    f, gas = (Evaluator(body, VACUUM, names).force(body.springs.rest_length, body.position, still)
              for names in (None, ("pressure",)))  # fmt: skip
    assert np.abs(f).max() <= 1e-12 * np.abs(gas).max()
    assert thing.inner.size == 0 and body.barriers is None and list(thing.kinds) == ["outer"]
    np.testing.assert_array_equal(body.position, both.body.position[both.outer])
    np.testing.assert_array_equal(body.springs.nodes, both.body.springs.nodes[both.kinds["outer"]])


def test_one_layer_swells_as_in_closed_form():
    """A ring whose springs start unstretched swells to the radius at which n k (2 r s - l) 2 s = g / r, s = sin(pi/n).

    The energy of n springs of length 2 r s and of gas with p A = g, whose area is proportional to r^2.
    """
    n, k, gas = 12, RING.stiffness, 0.6
    thing = make_ring(n, layers=1)
    body = thing.body
    s, length = np.sin(np.pi / n), 2 * 0.1 * np.sin(np.pi / n)
    body = body._replace(compartments=body.compartments._replace(gas=np.array([gas])))
    expected = brentq(lambda r: n * k * (2 * r * s - length) * 2 * s - 2 * gas / r, 0.1, 0.2, xtol=1e-15)
    found = equilibrium(body, rest_length=np.full(n, length), tolerance=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), expected, rtol=1e-10)


def test_collapse_and_what_pressure_restores():
    """On the floor a ring of one layer keeps no area without gas and nine tenths with it; two layers stand without."""
    kept = {(layers, p): collapse("ring", layers, p)["kept"] for layers, p in ((1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0))}
    assert abs(kept[1, 0.0]) < 0.01 and kept[1, 1.0] > 0.85
    assert 0.5 < kept[2, 0.0] < kept[2, 1.0] and kept[2, 1.0] > 0.9


def test_enclosed():
    """The area of a regular polygon and the volume of an octahedron."""
    ring, ball = make_ring(7), make_uniform_sphere(0, correction=False)
    assert enclosed(ring, ring.body.position) == pytest.approx(3.5 * 0.01 * np.sin(2 * np.pi / 7), rel=1e-13)
    assert enclosed(ball, ball.body.position) == pytest.approx(4 / 3 * 0.1**3, rel=1e-13)


@pytest.mark.parametrize("layers", [1, 2])
def test_densities(layers):
    """A density gives each node its share of the faces, so that the mass is density times area."""
    edge = 2 * np.sin(np.pi / 9)
    inner = {"inner_density": 3.0} if layers == 2 else {}
    ring = make_ring(9, layers=layers, density=2.0, **inner)
    expected = [2.0 * 0.1 * edge, 3.0 * 0.07 * edge][:layers]
    np.testing.assert_allclose(ring.body.mass, np.repeat(expected, 9), rtol=1e-13)
    octahedron = make_uniform_sphere(0, correction=False, layers=layers, density=2.0, stiffness=1e3)
    np.testing.assert_allclose(octahedron.body.mass[octahedron.outer], 2.0 * 8 * np.sqrt(3) / 2 * 0.01 / 6, rtol=1e-13)
    globe = make_sphere(8, 6, layers=layers, density=2.0).body.mass[:42]
    finer = make_sphere(24, 16, layers=1, density=2.0, stiffness=1e4).body.mass.sum()
    assert globe[0] < 0.7 * globe[17] and globe[0] == pytest.approx(globe[-1])  # the nodes at the poles have less
    assert finer == pytest.approx(2.0 * 4 * np.pi * 0.01, rel=2e-2)


def test_damping_of_each_kind():
    """Damping over stiffness is that of the kind, where it is given, and otherwise the common one."""
    times = {"inner": 0.0, "radius": 0.004, "shear": 0.001}
    thing = make_ring(relaxation_time=0.003, **{f"{kind}_relaxation_time": time for kind, time in times.items()})
    springs = thing.body.springs
    for kind, expected in zip(KINDS, (0.003, 0.0, 0.004, 0.001, 0.001), strict=True):
        which = thing.kinds[kind]
        np.testing.assert_allclose(springs.damping[which], expected * springs.stiffness[which], rtol=1e-15)
    alone = make_uniform_sphere(1, layers=1, outer_relaxation_time=0.005).body.springs
    np.testing.assert_allclose(alone.damping, 0.005 * alone.stiffness, rtol=1e-15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"layers": 3}, "layers is 3; give a whole number, 1 to 2"),
        ({"layers": 1, "inner_mass": 0.1}, "inner_mass is given for one layer, which has none; give layers=2"),
        ({"layers": 1, "shear_stiffness": 0.1}, "shear_stiffness is given for one layer"),
        ({"density": -1.0}, "density is -1.0; give a finite, positive number, or None"),
        ({"density": 1.0, "mass": 1.0}, "mass and density are both given; give one of them"),
        ({"inner_density": 1.0, "inner_mass": 1.0}, "inner_mass and inner_density are both given"),
        ({"radius_relaxation_time": "0.1"}, "radius_relaxation_time is '0.1'; give a finite, positive number or zero"),
        ({"shear_relaxation_time": np.nan}, "shear_relaxation_time is nan; .* or zero, or None"),
        ({"mass": None}, "mass is None; give a finite, positive number$"),
        ({"mass": True}, "mass is True; give a finite, positive number"),
    ],
)
def test_refused(arguments, message):
    """What does not fit is refused with what was given and what is allowed."""
    with pytest.raises(ValueError, match=message):
        make_ring(**arguments)


@pytest.mark.parametrize("relaxation_time", [0.0, 0.002])
def test_layers_turn_against_each_other(relaxation_time):
    """The ring's layers turn against each other at 15 Hz: closed form, natural frequency and simulation agree.

    A turn by a small angle stretches the 24 shear springs only, each by R r sin(2 pi / 12) / length times the angle.
    """
    thing = make_ring(relaxation_time=relaxation_time)
    angle, outer, inner = np.pi / 6, RING.radius, RING.inner_radius
    arm = outer * inner * np.sin(angle) / np.sqrt(outer**2 + inner**2 - 2 * outer * inner * np.cos(angle))
    inertia = 1 / (RING.mass * outer**2) + 1 / (RING.inner_mass * inner**2)
    omega = np.sqrt(24 * RING.shear_stiffness * arm**2 * inertia)
    assert omega / (2 * np.pi) == pytest.approx(15.0743, abs=1e-4)
    frequencies, shapes = modes(thing.body, 48)
    first = int(np.argmin(np.abs(frequencies - omega / (2 * np.pi))))
    assert frequencies[first] == pytest.approx(omega / (2 * np.pi), rel=1e-10)
    assert (shapes[first, thing.outer] * shapes[first, thing.inner]).sum(axis=1).max() < 0.0
    decay = 0.5 * relaxation_time * omega**2
    period = 2 * np.pi / np.sqrt(omega**2 - decay**2)
    tank = Tank(thing, integrator="rk4", dt=period / 400, water=VACUUM, threads=1)
    begin = 1e-6 * shapes[first] / np.abs(shapes[first]).max()
    tank.position[0] += begin
    tank.advance(800)
    left = np.exp(-decay * 2 * period)
    np.testing.assert_allclose(tank.position[0] - thing.body.position, left * begin, rtol=0, atol=1e-6 * left * 1e-3)


def test_layers_move_against_each_other_after_an_impact():
    """A heavy inner layer flies on for 10 ms while the outer one has turned back at a wall; a light one hardly does."""
    opposed = []
    for factor in (1.0, HEAVY):
        time, outer, inner = impact("ring", factor * RING.inner_mass).T
        opposed.append(np.count_nonzero(outer * inner < 0) * (time[1] - time[0]))
    assert opposed[0] < 0.003 and 0.008 < opposed[1] < 0.013
