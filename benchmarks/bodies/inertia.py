"""Mass, centre and inertia of every body beside those of its outline's continuum, and how far it rolls in strong gaits.

python -m benchmarks.bodies.inertia     table and results/inertia.csv (a minute; level 3 does not swim)

Of a flat fish only what matters in its plane is compared. Roll is the largest in 16 strong gaits, each begun with a
small disturbance (`benchmarks.common.roll`).
"""

import argparse

import numpy as np

from benchmarks.bodies.fidelity import FINEST, every_fish
from benchmarks.common.roll import roll
from benchmarks.common.tables import write_csv
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.masses import Moments, continuum, moments

UNITS = {"mass": "kg", "centre": "BL", "yaw": "kg m2", "pitch": "kg m2", "roll": "kg m2"}
"""What is compared: the mass, the distance of its centre from the nose, and moments of inertia about the centre."""


def quantities(found: Moments, length: float) -> dict[str, float]:
    """Moments as the quantities of UNITS."""
    roll, pitch, yaw = found.inertia
    return dict(zip(UNITS, map(float, (found.mass, -found.centre / length, yaw, pitch, roll)), strict=True))


def measure(swimming: bool = True) -> list[dict]:
    """A row for each body and quantity; with the roll of those that swim."""
    p = tu.MassSpringParameters(**tu.calibrated())
    wanted, rows = quantities(continuum(p), p.length), []
    for key, fish in every_fish().items():
        about = {"body": key[0], "level": key[1], "nodes": fish.body.mass.size}
        for quantity, value in quantities(moments(fish.body.mass, fish.body.position), fish.length).items():
            if not (fish.flat and quantity in ("pitch", "roll")):
                off = 100 * (value / wanted[quantity] - 1)
                rows.append(about | {
                    "quantity": quantity, "unit": UNITS[quantity], "value": f"{value:.5g}",
                    "continuum": f"{wanted[quantity]:.5g}", "off_percent": f"{off:.1f}",
                })  # fmt: skip
        if swimming and not fish.flat and key != FINEST:
            angles = np.degrees(roll(fish))
            for quantity, value in (("median roll", np.median(angles)), ("largest roll", angles.max())):
                rows.append(about | {"quantity": quantity, "unit": "degrees", "value": f"{value:.3g}",
                                     "continuum": "", "off_percent": ""})  # fmt: skip
    return rows


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = measure()
    for row in rows:
        print(f"{row['body']:12}{row['level']!s:3}{row['quantity']:14}{row['value']:>12} {row['unit']:8}"
              f"{row['off_percent']:>8}")  # fmt: skip
    print(write_csv("inertia.csv", rows, "python -m benchmarks.bodies.inertia"))


if __name__ == "__main__":
    main()
