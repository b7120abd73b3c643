"""Measure the best open-loop gait of the default fish against its bars.

python -m benchmarks.calibration.check     table and results/gait.csv; exit 1 if a bar is missed
"""

import argparse
import sys

import numpy as np

from benchmarks.calibration.gaits import swim
from benchmarks.common.tables import write_csv
from fish_env import make_fish
from fish_env.control import best_gait
from fish_env.tank import Tank

COMMAND = "python -m benchmarks.calibration.check"


def largest_stable_step(fish, gait, integrator, seconds=3.0) -> float:
    """Largest step, to 2 %, at which the gait and 32 fish jerked at random all survive; in seconds."""

    def survives(steps_per_beat):
        dt = 1 / (gait.frequency * steps_per_beat)
        if swim(fish, gait, fish.water, dt, integrator, points=max(1, steps_per_beat // 10)).failure:
            return False
        steps = max(1, round(fish.control_interval / dt))
        tank = Tank(fish, 32, integrator, dt, fish.water)
        generator = np.random.default_rng(0)
        for k in range(round(seconds / (steps * dt))):
            if k % 4 == 0:
                jerk = generator.choice([0.0, 1.0], (32, fish.num_muscles))
            tank.drive(jerk, steps)
        return bool(tank.alive.all())

    fails, survived = 10, 2000
    while survived > fails * 1.02 + 1:
        middle = round(np.sqrt(fails * survived))
        fails, survived = (fails, middle) if survives(middle) else (middle, survived)
    return 1 / (gait.frequency * survived)


def check() -> bool:
    """Measure the best open-loop gait of the default fish against the bars; write gait.csv; True if all are met."""
    fish, gait = make_fish("mass_spring"), best_gait()
    swum, exact = swim(fish, gait, fish.water), swim(fish, gait, fish.water, fish.time_step / 8, "rk4")
    tu = largest_stable_step(fish, gait, "semi_implicit")
    half = 2 / (gait.frequency * tu)
    rows = [
        ("stride, BL a beat", swum.stride, exact.stride, 0.5, np.inf),
        ("Strouhal number", swum.strouhal, exact.strouhal, 0.2, 0.42),
        ("tail sweep, BL", swum.sweep, exact.sweep, 0.1, 0.25),
        ("speed, BL/s", swum.speed, exact.speed, 1.0, np.inf),
        ("beat frequency, Hz", gait.frequency, gait.frequency, 0.0, 4.0),
        ("drag coefficient", fish.water.quadratic / 500.0, fish.water.quadratic / 500.0, 1.0, 2.0),
        ("steps a beat at half Tu's largest stable step", half, np.nan, 0.0, 400.0),
    ]
    table = [
        {
            "quantity": name, "ours": round(float(value), 4), "reference": round(float(reference), 4),
            "lowest": low, "highest": high, "met": bool(low <= value <= high),
        }
        for name, value, reference, low, high in rows
    ]  # fmt: skip
    path = write_csv("gait.csv", table, COMMAND)
    print(f"{'':46}{'ours':>9}{'RK4/8':>9}   bar")
    for row in table:
        print(f"{row['quantity']:46}{row['ours']:9.3f}{row['reference']:9.3f}"
              f"   {row['lowest']:g} to {row['highest']:g} {'met' if row['met'] else 'MISSED'}")  # fmt: skip
    print(
        f"largest stable step of Tu's method {tu * 1e3:.3f} ms; the default method's own is {fish.time_step * 1e3:g} ms"
    )
    print(f"written to {path}")
    return all(row["met"] for row in table)


def main() -> int:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    return 0 if check() else 1


if __name__ == "__main__":
    sys.exit(main())
