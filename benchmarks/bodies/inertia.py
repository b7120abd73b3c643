"""Mass, centre and moments of inertia of every body beside those of the continuum that fills the fish's outline.

python -m benchmarks.bodies.inertia     table and results/inertia.csv (a second)

The outline is lofted: between two stations, half width and half depth are straight, and a cross-section is a full
rectangle. Its integrals are exact by Gauss' rule, since they are polynomials of low degree between stations. Of a flat
fish only what matters in its plane is compared.
"""

import argparse

import numpy as np

from benchmarks.bodies.fidelity import every_fish
from benchmarks.common.tables import write_csv
from fish_env.bodies import Fish
from fish_env.bodies import mass_spring as tu

COMMAND = "python -m benchmarks.bodies.inertia"
UNITS = {"mass": "kg", "centre": "BL", "yaw": "kg m2", "pitch": "kg m2", "roll": "kg m2"}
"""What is compared: the mass, the distance of its centre from the nose, and moments of inertia about the centre."""
DEGREE = 6  # points of Gauss' rule: exact for polynomials of degree 11


def continuum(p: tu.MassSpringParameters) -> dict[str, float]:
    """The same quantities of the outline of these parameters, filled with matter of the density of water."""
    along = p.length * np.array([0.0, *p.layer_position, 1.0])
    width = p.length * np.array([0.0, *p.half_width, 0.0])
    depth = p.length * np.array([0.0, *p.half_depth, p.tail_half_span])
    points, weights = np.polynomial.legendre.leggauss(DEGREE)
    share, step = 0.5 * (1.0 + points), np.diff(along)[:, None]
    x, w, d = (row[:-1, None] + share * np.diff(row)[:, None] for row in (along, width, depth))
    mass = tu.WATER_DENSITY * 4.0 * w * d * 0.5 * weights * step
    total = mass.sum()
    centre = (mass * x).sum() / total
    squares = [(mass * part).sum() for part in ((x - centre) ** 2, w**2 / 3.0, d**2 / 3.0)]
    return _named(total, centre / p.length, squares)


def found(fish: Fish) -> dict[str, float]:
    """The quantities of a body at rest, of its nodes' masses."""
    mass, x = fish.body.mass, fish.body.position
    total = mass.sum()
    centre = mass @ x / total
    return _named(total, -centre[0] / fish.length, mass @ (x - centre) ** 2)


def _named(mass, centre, squares) -> dict[str, float]:
    x, y, z = squares
    return dict(zip(UNITS, map(float, (mass, centre, x + y, x + z, y + z)), strict=True))


def measure() -> list[dict]:
    """A row for each body and quantity."""
    wanted, rows = continuum(tu.MassSpringParameters(**tu.calibrated())), []
    for (name, level), fish in every_fish().items():
        for quantity, value in found(fish).items():
            if fish.flat and quantity in ("pitch", "roll"):
                continue
            rows.append({
                "body": name, "level": level, "nodes": fish.body.mass.size, "quantity": quantity,
                "unit": UNITS[quantity], "value": f"{value:.5g}", "continuum": f"{wanted[quantity]:.5g}",
                "off_percent": f"{100 * (value / wanted[quantity] - 1):.1f}",
            })  # fmt: skip
    return rows


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = measure()
    for row in rows:
        print(f"{row['body']:12}{row['level']!s:3}{row['quantity']:8}{row['value']:>12} {row['unit']:6}"
              f"{row['off_percent']:>8} % off")  # fmt: skip
    print(write_csv("inertia.csv", rows, COMMAND))


if __name__ == "__main__":
    main()
