"""The default fish beside a real trout of 19.6 cm, at the trout's three beat frequencies and swimming speeds.

python -m benchmarks.calibration.trout     table, results/trout.csv and results/trout.svg
"""

import argparse
import json
from dataclasses import dataclass

from scipy.optimize import brentq

from benchmarks.calibration.gaits import swim
from benchmarks.common.charts import pyplot, save
from benchmarks.common.tables import RESULTS, write_csv
from fish_env import make_fish
from fish_env.bodies.mass_spring import CALIBRATED_FILE
from fish_env.control import Gait

COMMAND = "python -m benchmarks.calibration.trout"


@dataclass(frozen=True)
class Trout:
    """One row of a study of the median fins of a 19.6 cm rainbow trout (J. Exp. Biol., after Drucker & Lauder)."""

    speed: float  # body lengths/s
    frequency: float  # Hz
    sweep: float  # body lengths


TROUT_LENGTH = 0.196  # m
TROUT = tuple(Trout(u, f, cm / 19.6) for u, f, cm in ((0.5, 2.48, 1.80), (1.0, 3.18, 2.55), (2.0, 4.23, 2.85)))


def measured() -> list[dict]:
    """Swim at the trout's three beat frequencies, at the amplitude that gives its speed: a row a frequency."""
    fish = make_fish("mass_spring", length=TROUT_LENGTH)
    amplitude, lag = json.loads(CALIBRATED_FILE.read_text())["gait"].values()
    rows = []
    for real in TROUT:

        def swum(scale, real=real):
            gait = Gait(real.frequency, tuple(scale * a for a in amplitude), tuple(lag))
            return swim(fish, gait, fish.water)

        top = 1.0
        scale = top
        if swum(top).speed > real.speed:
            scale = brentq(lambda s, swum=swum, real=real: swum(s).speed - real.speed, 0.05, top, xtol=1e-3)
        ours = swum(scale)
        rows.append(
            {
                "frequency_hz": real.frequency, "amplitude": round(scale, 3),
                "speed_trout": real.speed, "speed_ours": round(ours.speed, 3),
                "speed_off_percent": round(100 * (ours.speed / real.speed - 1), 1),
                "sweep_trout": round(real.sweep, 4), "sweep_ours": round(ours.sweep, 4),
                "sweep_off_percent": round(100 * (ours.sweep / real.sweep - 1), 1),
                "strouhal_trout": round(real.frequency * real.sweep / real.speed, 3),
                "strouhal_ours": round(ours.strouhal, 3),
            }
        )  # fmt: skip
    return rows


def draw_trout(rows) -> None:
    """Speed and sweep against beat frequency, ours beside the trout's."""
    plt = pyplot()

    figure, panels = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
    frequency = [row["frequency_hz"] for row in rows]
    names = {"speed": "speed, BL/s", "sweep": "tail sweep, BL", "strouhal": "Strouhal number"}
    for panel, (quantity, label) in zip(panels, names.items(), strict=True):
        panel.plot(frequency, [row[f"{quantity}_trout"] for row in rows], "o-", color="#4a4a4a", label="trout, 19.6 cm")
        panel.plot(frequency, [row[f"{quantity}_ours"] for row in rows], "s--", color="#0b7a99", label="fish_env")
        panel.set(xlabel="tail beats a second, Hz", ylabel=label, ylim=(0, None))
    panels[0].legend(frameon=False)
    save(figure, RESULTS / "trout.svg")


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = measured()
    path = write_csv("trout.csv", rows, COMMAND)
    for name in rows[0]:
        print(f"{name:20}" + "".join(f"{row[name]:10}" for row in rows))
    draw_trout(rows)
    print(f"written to {path} and {path.with_suffix('.svg')}")


if __name__ == "__main__":
    main()
