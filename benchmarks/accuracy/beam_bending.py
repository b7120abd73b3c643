"""The beam at rest: small deflections and frequencies under refinement, and bending far beyond linear theory."""

import numpy as np
from scipy.integrate import solve_bvp

from benchmarks.common.beam import LENGTH, cantilever, first_frequency, rigidity, tip, tip_load, vertical
from fish_env import statics
from fish_env.body import Body
from fish_env.elements import STRAINS

REFINED = (2, 4, 8, 16, 32)
BENDING = 8  # cells through the thickness of the beam that is bent far
LOADS = tuple(np.arange(1, 21) / 2)  # P L^2 / E I
SHOWN = 10.0  # the load at which shapes are drawn


def converging() -> list[dict]:
    """Deflection under a small end load and first frequency over those of Euler's beam, as the mesh is refined."""
    rows = []
    for n in REFINED:
        body = cantilever(n)
        force = 1e-4 * rigidity(body) / LENGTH**2
        deflection = tip(body, statics.linear_deflection(body, tip_load(body, force)))[2]
        even = cantilever(n, rule="uniform")
        rows.append({
            "cells": n, "nodes": len(body.mass), "tetrahedra": len(body.tets.nodes),
            "deflection": deflection / (force * LENGTH**3 / (3.0 * rigidity(body))),
            "frequency_quarter": vertical(body)[0] / first_frequency(body),
            "frequency_uniform": vertical(even)[0] / first_frequency(body),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def order(cells, error) -> float:
    """Slope of the errors' line of best fit against the size of the elements, both logarithmic."""
    return float(-np.polyfit(np.log(cells), np.log(np.abs(error)), 1)[0])


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
        x = statics.equilibrium(body, start=x, load=tip_load(body, load * rigidity(body) / LENGTH**2))
        yield load, x


def bending() -> tuple[list[dict], list[dict]]:
    """Tip and volume of the beam, corotational and linear, beside the elastica's tip; then the shapes at SHOWN."""
    rows, shapes = [], {}
    turned, fixed = (cantilever(BENDING, strain=strain) for strain in STRAINS[:2])
    for (load, x), (_, y) in zip(bend(turned, LOADS), bend(fixed, LOADS), strict=True):
        wanted = elastica(load)[-1]
        here, there = tip(turned, x) / LENGTH, tip(fixed, y) / LENGTH
        rows.append({
            "load": load, "elastica_x": wanted[0], "elastica_z": wanted[1],
            "corotational_x": here[0], "corotational_z": here[2], "corotational_volume": volume(turned, x),
            "linear_x": there[0], "linear_z": there[2], "linear_volume": volume(fixed, y),
        })  # fmt: skip
        shapes[load] = x, y
    middle = np.flatnonzero(np.abs(turned.position[:, 1]) < 1e-9)
    outline = [
        {"x": p[0], "z": p[2], "corotational_x": x[0], "corotational_z": x[2], "linear_x": y[0], "linear_z": y[2]}
        for p, x, y in zip(*(a[middle] / LENGTH for a in (turned.position, *shapes[SHOWN])), strict=True)
    ]
    return rows, outline
