"""Node masses that move a body as the continuum inside its outline moves: same mass, centre and moments of inertia.

Between two stations of the outline (`fish_env/bodies/outline.py`) half width and half depth are straight. Its integrals
are exact by Gauss' rule, since they are polynomials of low degree between the stations. Masses lumped by
shape functions have the continuum's mass and centre, but too much inertia, since the nodes lie on the outside of what
they stand for. `match_moments` changes them as little as it can.
"""

from typing import NamedTuple

import numpy as np

from fish_env.bodies.outline import outline_of, stations_of

WATER_DENSITY = 1000.0  # kg/m3; the fish displaces its own mass of it
MOST_STEPS, TOLERANCE = 60, 1e-12  # of Newton's method, and of what is left over the total
ROUNDING = 1e-14  # of the potential, which is about one: no step is shortened for a rise that small
LARGEST = 20.0  # logarithm of a factor on a mass
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(6)  # exact for polynomials of degree 11


class Moments(NamedTuple):
    """Moments of a body that is symmetric about the xz plane and whose axis is the x axis."""

    mass: float  # kg
    centre: float  # x of the centre of mass, m
    squares: np.ndarray  # (3,) sums of mass times the square of each coordinate's distance from the centre, kg m2


def _points(p):
    """Mass (R,6) kg, place, half width and half depth (R,6) m of the Gauss points between R + 1 stations."""
    whole, (stations, _) = outline_of(p), stations_of(p)
    rows = stations, whole.half_width(stations), whole.half_depth(stations)
    place, width, depth = (row[:-1, None] + 0.5 * (1.0 + POINTS) * np.diff(row)[:, None] for row in rows)
    step = 0.5 * WEIGHTS * np.diff(stations)[:, None]
    return WATER_DENSITY * whole.fullness * width * depth * step, place, width, depth


def continuum(p) -> Moments:
    """The moments of the outline of a fish of these parameters, filled with matter of the density of water."""
    mass, place, width, depth = _points(p)
    total, thin = mass.sum(), outline_of(p).flatness
    centre = -(mass * place).sum() / total
    squares = [(mass * part).sum() for part in ((-place - centre) ** 2, width**2 / thin, depth**2 / thin)]
    return Moments(float(total), float(centre), np.array(squares))


def layer_masses(p) -> np.ndarray:
    """Masses of the seven layers, (7,) kg: every section's matter, by linear shape functions along the body."""
    mass, (_, at) = _points(p)[0], stations_of(p)
    section = at[:-1].astype(int)
    share = (at[:-1] - section)[:, None] + 0.5 * (1.0 + POINTS) * np.diff(at)[:, None]
    layer = np.zeros(7)
    np.add.at(layer, section, (mass * (1.0 - share)).sum(axis=1))
    np.add.at(layer, section + 1, (mass * share).sum(axis=1))
    return layer


def match_moments(mass, position, wanted: Moments, solid: bool) -> np.ndarray:
    """Change masses (N,) kg at positions (N,3) m to have wanted mass, centre and inertia; ValueError if none have."""
    # Each is multiplied by the exponential of a polynomial of second degree in its position: of all masses with these
    # moments they are the nearest to those given, in relative entropy, and they are positive. Positions are symmetrical
    # about the xz plane. Unless `solid`, only the yaw inertia is: a body whose nodes all lie on its outline cannot have
    # more.
    x, y, z = (position - (wanted.centre, 0.0, 0.0)).T
    along, across, upward = wanted.squares
    sums = [(np.ones_like(x), wanted.mass), (x, 0.0)]
    sums += [(x**2, along), (y**2, across), (z**2, upward)] if solid else [(x**2 + y**2, along + across)]
    rows = np.array([row / np.abs(row).max() for row, _ in sums])
    goal = np.array([value / np.abs(row).max() for row, value in sums]) / wanted.mass
    share = mass / wanted.mass
    factors = np.zeros(len(rows))

    def potential(factors):  # convex; its gradient is what is missing of the moments
        return (share * np.exp(factors @ rows)).sum() - factors @ goal

    for _ in range(MOST_STEPS):
        if np.abs(factors @ rows).max() > LARGEST:
            break
        now = share * np.exp(factors @ rows)
        off = rows @ now - goal
        if np.abs(off).max() < TOLERANCE:
            return now * wanted.mass
        step = np.linalg.solve((rows * now) @ rows.T, off)
        part = 1.0
        while potential(factors - part * step) > potential(factors) + ROUNDING and part > 1e-6:
            part *= 0.5
        factors = factors - part * step
    raise ValueError(
        "no masses of these nodes have the inertia of the outline; give an outline that changes less in depth and "
        "width from layer to layer, with its layers nearer to evenly spaced"
    )
