"""The whole calibration of a level of water, from the outline to the motor controllers, each step on those before it.

    python -m benchmarks.calibrate --water reactive

The finest body and three gaits to living fish; then, fitted in motion to it, the other bodies; then the best gait and
the tables of the motor controllers. The fish for drag is older: its files say how it was made. What a search found is
kept in `runs/calibration` until what it depends on changes: a calibration that was interrupted goes on after the last
search that ended. Bit for bit on one kind of processor.
"""

import time
from collections.abc import Callable

from benchmarks.calibration import finest, fit, gait_search, motor_controllers
from benchmarks.common.tables import make_parser

STEPS: dict[str, tuple[float, Callable[[str], None]]] = {
    "the finest body": (3.0, finest.calibrate),
    "mass_spring": (8.0, lambda water: fit.fit("mass_spring", water)),
    "planar": (3.0, lambda water: fit.fit("planar", water)),
    "the best gait": (3.0, gait_search.calibrate),
    "motor controllers": (8.0, motor_controllers.calibrate),
    "two_layer": (10.0, lambda water: fit.fit("two_layer", water)),
}
"""What is calibrated, in order: minutes on two cores, about, and how."""


def main() -> None:
    """The command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--water", choices=finest.START, default="reactive", help="the level of water")
    water = parser.parse_args().water
    for number, (name, (minutes, calibrate)) in enumerate(STEPS.items(), start=1):
        left = sum(each for each, _ in list(STEPS.values())[number - 1 :])
        print(f"{number} of {len(STEPS)}: {name}, about {minutes:.0f} min; {left:.0f} min in all", flush=True)
        begin = time.monotonic()
        calibrate(water)
        print(f"{name}: {(time.monotonic() - begin) / 60:.1f} min", flush=True)


if __name__ == "__main__":
    main()
