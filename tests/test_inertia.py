"""Masses and moments of inertia: those of the outline by another way, and what the bodies have."""

import numpy as np
import pytest

from benchmarks.bodies import inertia
from benchmarks.bodies.fidelity import every_fish
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.mesh import grid, lumped_mass

PARAMETERS = tu.MassSpringParameters(**tu.calibrated())


def tetrahedra(cells):
    """Moments of the outline cut into tetrahedra, whose own moments are exact: mass, centre, and squares (3,)."""
    length, stations = PARAMETERS.length, np.arange(6 * cells + 1) / cells
    rows = ([0.0, *PARAMETERS.layer_position, 1.0], [0.0, *PARAMETERS.half_width, 0.0],
            [0.0, *PARAMETERS.half_depth, PARAMETERS.tail_half_span])  # fmt: skip
    along, width, depth = (length * np.interp(stations, np.arange(7), row) for row in rows)
    mesh = grid(-along, width, depth, 4, 4)
    corners = mesh.position[mesh.tets]
    mass = tu.WATER_DENSITY * np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    total = mass.sum()
    middle = np.einsum("t,tk->k", mass, corners.mean(axis=1)) / total
    away = corners - middle
    squares = np.einsum("t,tk->k", mass, ((away.sum(axis=1)) ** 2 + (away**2).sum(axis=1)) / 20)  # of a tetrahedron
    assert lumped_mass(mesh.position, mesh.tets, tu.WATER_DENSITY).sum() == pytest.approx(total, rel=1e-12)
    return total, -middle[0] / length, squares


@pytest.mark.parametrize("cells", [1, 3])
def test_the_continuum_is_that_of_tetrahedra(cells):
    """The outline has flat sides, so that tetrahedra fill it: their exact moments are those of Gauss' rule."""
    assert inertia._named(*tetrahedra(cells)) == pytest.approx(inertia.continuum(PARAMETERS), rel=1e-12)


def test_bodies_have_the_mass_and_the_centre_of_the_outline():
    """Every body floats: it has the mass of the water that it displaces, and the centre of that water to 1 %."""
    wanted = inertia.continuum(PARAMETERS)
    for name, fish in every_fish().items():
        found = inertia.found(fish)
        assert found["mass"] == pytest.approx(wanted["mass"], rel=1e-9), name
        assert found["centre"] == pytest.approx(wanted["centre"], rel=0.01), name


def test_rows():
    """Every body in every quantity that matters to it, beside the continuum."""
    rows = inertia.measure()
    assert len(rows) == 2 * 3 + 5 * 5 and {(row["body"], row["level"]) for row in rows} == set(every_fish())
    for row in rows:
        ratio = float(row["value"]) / float(row["continuum"])
        assert 100 * (ratio - 1) == pytest.approx(float(row["off_percent"]), abs=0.06)
