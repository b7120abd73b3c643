"""Masses and moments of inertia: those of the outline by another way, and what the bodies have."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bodies.fidelity import every_fish
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.masses import WATER_DENSITY, continuum, layer_masses, match_moments, moments
from fish_env.soft.mesh import grid, lumped_mass

PARAMETERS = tu.check_parameters("mass_spring", {})
WANTED = continuum(PARAMETERS)
STRAIGHT = tu.check_parameters("mass_spring", {}, "drag")  # between its layers, with rectangular sections
FISH = every_fish()
SOLIDS = [key for key in FISH if key[0] in ("two_layer", "tetrahedral")]


def tetrahedra(cells):
    """Mass, centre and squares (3,) of the outline cut into tetrahedra, whose own moments are exact; and the mesh."""
    length, stations = STRAIGHT.length, np.arange(6 * cells + 1) / cells
    rows = ([0.0, *STRAIGHT.layer_position, 1.0], [0.0, *STRAIGHT.half_width, 0.0],
            [0.0, *STRAIGHT.half_depth, STRAIGHT.tail_half_span])  # fmt: skip
    along, width, depth = (length * np.interp(stations, np.arange(7), row) for row in rows)
    mesh = grid(-along, width, depth, 4, 4)
    corners = mesh.position[mesh.tets]
    mass = WATER_DENSITY * np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    total = mass.sum()
    middle = np.einsum("t,tk->k", mass, corners.mean(axis=1)) / total
    away = corners - middle
    squares = np.einsum("t,tk->k", mass, ((away.sum(axis=1)) ** 2 + (away**2).sum(axis=1)) / 20)  # of a tetrahedron
    return total, middle[0], squares, mesh


@pytest.mark.parametrize("cells", [1, 3])
def test_the_continuum_is_that_of_tetrahedra(cells):
    """The outline has flat sides, so that tetrahedra fill it: their exact moments are those of Gauss' rule."""
    (total, centre, squares, mesh), wanted = tetrahedra(cells), continuum(STRAIGHT)
    assert (total, centre) == pytest.approx((wanted.mass, wanted.centre), rel=1e-12)
    np.testing.assert_allclose(squares, wanted.squares, rtol=1e-12)
    assert lumped_mass(mesh.position, mesh.tets, WATER_DENSITY).sum() == pytest.approx(total, rel=1e-12)


def test_layers_share_the_mass_of_their_sections():
    """Linear shape functions keep the mass and the centre; by quadrature with a thousand slices a section."""
    slices = 1000
    share = (np.arange(6 * slices) + 0.5) / slices
    stations = STRAIGHT.length * np.array([0.0, *STRAIGHT.layer_position, 1.0])
    rows = ([0.0, *STRAIGHT.half_width, 0.0], [0.0, *STRAIGHT.half_depth, STRAIGHT.tail_half_span])
    width, depth = (STRAIGHT.length * np.interp(share, np.arange(7), row) for row in rows)
    slice_mass = 4 * WATER_DENSITY * width * depth * np.repeat(np.diff(stations) / slices, slices)
    wanted = [slice_mass @ np.maximum(1.0 - np.abs(share - k), 0.0) for k in range(7)]
    layers = layer_masses(STRAIGHT)
    np.testing.assert_allclose(layers, wanted, rtol=1e-5)
    whole = continuum(STRAIGHT)
    assert layers.sum() == pytest.approx(whole.mass, rel=1e-12)
    assert -layers @ stations / layers.sum() == pytest.approx(whole.centre, rel=1e-12)


@pytest.mark.parametrize(
    ("key", "axes"), [*((key, slice(3)) for key in SOLIDS), (("mass_spring", ""), 2), (("planar", ""), 2)], ids=str
)
def test_bodies_have_the_inertia_of_the_outline(key, axes):
    """Mass, centre and moments of inertia; nodes on the outline itself, too far from the axis, have but that of yaw."""
    body = FISH[key].body
    found = moments(body.mass, body.position)
    assert (found.mass, found.centre) == pytest.approx((WANTED.mass, WANTED.centre), rel=1e-9)
    np.testing.assert_allclose(found.inertia[axes], WANTED.inertia[axes], rtol=1e-8)
    assert body.mass.min() > 0.0


def test_roll_and_pitch_of_the_default_fish():
    """They are larger than the outline's, as docs/choosing-a-body.md says."""
    body = FISH["mass_spring", ""].body
    found = moments(body.mass, body.position)
    np.testing.assert_allclose(found.inertia[:2] / WANTED.inertia[:2], [3.2, 1.1], rtol=0.02)


def test_masses_are_the_nearest_in_relative_entropy():
    """Any other masses with the same moments are farther from those given."""
    position, given = tu.shape(PARAMETERS), np.ones(23) / 23 * WANTED.mass
    found = match_moments(given, position, WANTED, solid=False)

    def entropy(mass):
        return (mass * np.log(mass / given)).sum()

    x, y = position[:, 0] - WANTED.centre, position[:, 1]
    rows = np.stack([np.ones(23), x, x**2 + y**2])
    free = np.linalg.svd(rows)[2][3:]
    for direction in np.vstack([free, -free]):
        other = found + 1e-2 * found.min() * direction
        np.testing.assert_allclose(rows @ other, rows @ found, rtol=0, atol=1e-15)
        assert entropy(other) > entropy(found)


def test_masses_are_found_whatever_is_given():
    """Whether masses have the moments depends on where the nodes are, not on the masses to start from."""
    generator = np.random.default_rng(0)
    for factor in np.exp(generator.uniform(np.log(0.25), np.log(4.0), (100, 7))):
        mass = tu.masses(replace(PARAMETERS, mass_factor=tuple(factor)))
        found = moments(mass, tu.shape(PARAMETERS))
        assert found.mass == pytest.approx(WANTED.mass, rel=1e-11) and mass.min() > 0.0
        np.testing.assert_allclose([found.centre, found.inertia[2]], [WANTED.centre, WANTED.inertia[2]], rtol=1e-9)


def test_what_cannot_be_had_is_refused():
    """Nodes on the outline cannot have its roll inertia; nor does any outline do."""
    position = tu.shape(PARAMETERS)
    with pytest.raises(ValueError, match="no masses of these nodes have the inertia of the outline; give an outline"):
        match_moments(tu.masses(PARAMETERS), position, WANTED, solid=True)
    with pytest.raises(ValueError, match="no masses of these nodes"):
        tu.masses(replace(PARAMETERS, layer_position=(0.001, 0.002, 0.003, 0.004, 0.005)))
