"""Mass, centre and moments of inertia of every body beside those of the continuum that fills the fish's outline.

python -m benchmarks.bodies.inertia     table and results/inertia.csv (a second)

Of a flat fish only what matters in its plane is compared.
"""

import argparse

from benchmarks.bodies.fidelity import every_fish
from benchmarks.common.tables import write_csv
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.masses import Moments, continuum, moments

COMMAND = "python -m benchmarks.bodies.inertia"
UNITS = {"mass": "kg", "centre": "BL", "yaw": "kg m2", "pitch": "kg m2", "roll": "kg m2"}
"""What is compared: the mass, the distance of its centre from the nose, and moments of inertia about the centre."""


def named(found: Moments, length: float) -> dict[str, float]:
    """Moments as the quantities of UNITS."""
    roll, pitch, yaw = found.inertia
    return dict(zip(UNITS, map(float, (found.mass, -found.centre / length, yaw, pitch, roll)), strict=True))


def measure() -> list[dict]:
    """A row for each body and quantity."""
    p = tu.MassSpringParameters(**tu.calibrated())
    wanted, rows = named(continuum(p), p.length), []
    for (name, level), fish in every_fish().items():
        for quantity, value in named(moments(fish.body.mass, fish.body.position), fish.length).items():
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
