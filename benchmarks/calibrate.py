"""The whole calibration of a level of water, from the outline to the motor controllers, each step on those before it.

    python -m benchmarks.calibrate --water reactive

The finest body and three gaits to living fish; then, fitted in motion to it, the other bodies; then the best gait and
the tables of the motor controllers. The files of the bodies say by which commit they were made. What a search found is
kept in `runs/calibration` until what it depends on changes: a calibration that was interrupted goes on after the last
search that ended. Bit for bit on one kind of processor.
"""

import time
from collections.abc import Callable
from functools import partial

from benchmarks.calibration import finest, fit, gait_search, motor_controllers
from benchmarks.common.tables import make_parser

STEPS: dict[str, Callable[[str], None]] = {
    "the finest body": finest.calibrate,
    "mass_spring": partial(fit.fit, "mass_spring"),
    "planar": partial(fit.fit, "planar"),
    "the best gait": gait_search.calibrate,
    "motor controllers": motor_controllers.calibrate,
    "two_layer": partial(fit.fit, "two_layer"),
}
"""What is calibrated, in order."""


def main() -> None:
    """The command line."""
    parser = make_parser(__doc__)
    parser.add_argument("--water", choices=finest.START, default="reactive", help="the level of water")
    water = parser.parse_args().water
    for number, (name, calibrate) in enumerate(STEPS.items(), start=1):
        begin = time.monotonic()
        print(f"{number} of {len(STEPS)}: {name}", flush=True)
        calibrate(water)
        print(f"{name}: {(time.monotonic() - begin) / 60:.1f} min", flush=True)


if __name__ == "__main__":
    main()
