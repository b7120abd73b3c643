"""Tetrahedra against theory: a cantilever under refinement; three measures of strain in rotation, extension, bending.

The beam is that of `benchmarks/common/beam.py`. What is known without a mesh stands beside each: the theory of beams,
no energy, the law of the material, the elastica.
"""

import numpy as np
from scipy.integrate import solve_bvp

from benchmarks.common import beam
from benchmarks.common.charts import BLUE, GREY, ORANGE, own_legend, panels, save
from benchmarks.common.tables import IMAGES, columns, read_table
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import Body
from fish_env.physics.world import VACUUM
from fish_env.soft import statics
from fish_env.soft.elements import STRAINS
from fish_env.soft.mesh import box

REFINED = (2, 4, 8, 16)  # cells through the thickness
BENDING = 8  # cells through the thickness of the beam that is bent far
SIDE = 0.1  # m, of the block and of the bar
CASES = {
    "rotation": tuple(range(0, 181, 15)),
    "extension": tuple(np.arange(8, 31) / 20),
    "bending": tuple(range(1, 11)),
}
"""Angles, degrees; lengths of a bar over that at rest; end loads P L^2 / E I."""
STYLES = {"linear": (ORANGE, "--s"), "corotational": (BLUE, "-o"), "green_lagrange": ("#009E73", "-.^")}


def order(cells, error) -> float:
    """Slope of the errors' line of best fit against the size of the elements, both logarithmic."""
    return float(-np.polyfit(np.log(cells), np.log(np.abs(error)), 1)[0])


def refined() -> list[dict]:
    """Rows of deflection under a small end load and first frequency over those of the Euler-Bernoulli beam."""
    rows = []
    for n in REFINED:
        body, even = beam.cantilever(n), beam.cantilever(n, rule="uniform")
        force = 1e-4 * beam.rigidity(body) / beam.LENGTH**2
        deflection = beam.tip(body, statics.linear_deflection(body, beam.tip_load(body, force)))[2]
        rows.append({
            "cells": n, "nodes": len(body.mass),
            "deflection": deflection / (force * beam.LENGTH**3 / (3.0 * beam.rigidity(body))),
            "frequency": beam.vertical(body)[0] / beam.first_frequency(body),
            "frequency_equal_masses": beam.vertical(even)[0] / beam.first_frequency(body),
        })  # fmt: skip
    return rows


def elastica(load: float, points=201) -> np.ndarray:
    """Shape (points,2), over the length, of a thin clamped beam under an end force P L^2 / E I of fixed direction.

    The angle t along the beam obeys t'' = -load cos t, t(0) = 0, t'(1) = 0 (Euler 1744).
    """
    s = np.linspace(0.0, 1.0, points)
    found = solve_bvp(
        lambda s, y: np.stack([y[1], -load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
        lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
        s, np.zeros((4, points)), tol=1e-10, max_nodes=100_000,
    )  # fmt: skip
    return found.sol(s)[2:].T


def volume(body: Body, x) -> float:
    """Volume of all tetrahedra at x, over that at rest."""
    edges = x[body.tets.nodes[:, 1:]] - x[body.tets.nodes[:, :1]]
    return float(np.linalg.det(edges).sum() / 6 / body.tets.volume.sum())


def bend(body: Body, loads):
    """Positions (N,3) of the beam at rest under each end load P L^2 / E I, one after the other."""
    x = None
    for load in loads:
        x = statics.equilibrium(body, start=x, load=beam.tip_load(body, load * beam.rigidity(body) / beam.LENGTH**2))
        yield load, x


def rotated(strain: str, degrees: float) -> float:
    """Energy of a block that is turned about z, over E V."""
    position, nodes = box((SIDE, SIDE, SIDE), (3, 3, 3))
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x = position @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    stored = Evaluator(beam.solid(position, nodes, 0.3, strain=strain), VACUUM).energies(np.zeros(0), x, 0.0 * x)
    return sum(stored.values()) / (beam.YOUNG * SIDE**3)


def law(strain: str, stretch: float) -> float:
    """The force on a bar of Poisson's ratio 0, over E times its area at rest."""
    return 0.5 * stretch * (stretch**2 - 1.0) if strain == "green_lagrange" else stretch - 1.0


def extended(strain: str, stretch: float) -> float:
    """The force on the end of a bar of Poisson's ratio 0, over E times its area at rest."""
    position, nodes = box((SIDE, SIDE / 2, SIDE / 2), (4, 2, 2))
    x = position * [stretch, 1.0, 1.0]
    force = Evaluator(beam.solid(position, nodes, 0.0, strain=strain), VACUUM).force(np.zeros(0), x, 0.0 * x)
    return float(-force[position[:, 0] == position[:, 0].max(), 0].sum() / (beam.YOUNG * SIDE**2 / 4))


def strains() -> list[dict]:
    """Rows of each measure of strain and case: energy, force, or distance of the tip from the elastica's and volume."""
    rows = []
    for strain in STRAINS:
        for case, measure in (("rotation", rotated), ("extension", extended)):
            rows += [{"case": case, "strain": strain, "at": at, "value": measure(strain, at), "volume": ""}
                     for at in CASES[case]]  # fmt: skip
        body = beam.cantilever(BENDING, strain=strain)
        for load, x in bend(body, CASES["bending"]):
            off = np.linalg.norm(beam.tip(body, x)[[0, 2]] / beam.LENGTH - elastica(load)[-1])
            rows.append({"case": "bending", "strain": strain, "at": load, "value": off, "volume": volume(body, x)})
    return rows


def draw() -> None:
    """Draw the errors under refinement and the three cases of the measures of strain."""
    rows = read_table("elements_beam.csv")
    figure, (refinement, *axes) = panels(2, 8.4, 2)
    cells, deflection, frequency = map(np.array, columns(rows, "cells", "deflection", "frequency"))
    for label, colour, errors in (
        ("deflection, from Timoshenko's", BLUE, 1.0 + beam.SHEAR - deflection),
        ("first frequency, from Euler's", ORANGE, frequency - 1.0),
    ):
        refinement.loglog(cells, np.abs(errors), "o-", color=colour, label=label)
    refinement.loglog(cells, 1.7 / cells**2, "--", color=GREY, label="second order")
    refinement.set_xticks(cells, [f"{n:g}" for n in cells])
    refinement.set_xticks([], minor=True)
    refinement.set(xlabel="cells through the beam's thickness", ylabel="relative error")
    for strain, (colour, style) in STYLES.items():
        for panel, case in zip(axes, CASES, strict=True):
            line = columns(read_table("elements_strains.csv", case=case, strain=strain), "at", "value")
            panel.plot(
                *line, style, color=colour, fillstyle="none", label=strain.replace("green_lagrange", "Green-Lagrange")
            )
    axes[0].set(xlabel="rotation of a block, degrees", ylabel="energy, over E·V", xticks=range(0, 181, 45))
    axes[1].set(xlabel="length of a bar, over that at rest", ylabel="force, over E·A")
    axes[2].set(xlabel="end load on the beam, EI/L²", ylabel="distance of the tip from theory, L", yscale="log")
    own_legend(refinement)
    own_legend(axes[0])
    save(figure, IMAGES / "elements.svg")
