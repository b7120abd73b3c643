"""A computed eel's midline imposed on its body: the speed at which it swims.

Shape, midline and viscosity are those of Kern & Koumoutsakos (2006, J. Exp. Biol. 209:4841), who solve the
Navier-Stokes equations: length and period are 1, the viscosity is 1.4e-4. Their speed, 0.40, is quoted from memory.
Their abstract says that eels swim 0.26 to 0.5 body lengths a beat.
"""

import numpy as np

from benchmarks.common.charts import panels, save
from benchmarks.common.tables import RESULTS, publish, read_table
from benchmarks.validation.waters import along, bars, off, waters
from fish_env import make_fish, prescribe

SPEED, VISCOSITY = 0.40, 1.4e-4  # body lengths a beat; squared body lengths a beat
LENGTH, PERIOD = 0.3, 1.0  # m, s: any will do, because the viscosity follows them
PLACES = np.array(
    [0.0, 0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.975, 1]
)


def outline() -> np.ndarray:
    """Place, half width and half depth of the sections, which are ellipses, (19,3)."""
    s, head, tail, fin = PLACES, 0.04, 0.01, 0.95
    width = np.select(
        [s < head, s < fin],
        [np.sqrt(np.maximum(2.0 * head * s - s**2, 0.0)), head - (head - tail) * ((s - head) / (fin - head)) ** 2],
        tail * (1.0 - s) / (1.0 - fin),
    )
    return np.stack([s, width, 0.08 * np.sqrt(1.0 - (s / 0.51 - 1.0) ** 2)], axis=1)


def midline(places, time):
    """Offset of the midline (S,), body lengths."""
    return 4.0 / 33.0 * (places + 0.03125) * np.sin(2.0 * np.pi * (places - time / PERIOD))


def measure() -> list[dict]:
    """A row for each level of water."""
    fish, rows = make_fish("tetrahedral", level=4, length=LENGTH, outline=outline()), []
    for name, water in waters(fish, VISCOSITY * LENGTH**2 / PERIOD).items():
        swum = prescribe(fish, midline, PERIOD, water=water)
        rows.append({
            "water": name, "speed_bl_beat": round(swum.relative_speed * PERIOD, 3), "published": SPEED,
            "off_percent": off(swum.relative_speed * PERIOD, SPEED), "strouhal": round(swum.strouhal, 3),
            **{f"sweep_{k}": round(sweep, 4) for k, sweep in enumerate(swum.sweep[::2])},
        })  # fmt: skip
    return rows


def draw() -> None:
    """Sweep along the body and speed, of every level of water and of the computed eel."""
    rows = read_table("validation/eel.csv")
    figure, (left, right) = panels(2, (10.0, 3.8))
    along(left, rows, "sweep")
    left.set(xlabel="from the nose, BL", ylabel="sweep, BL", ylim=(0, None))
    left.legend(frameon=False, fontsize=8)
    bars(right, rows, "speed_bl_beat", SPEED, "speed, BL a beat (band: 10 %)")
    save(figure, RESULTS / "validation" / "eel.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/eel.csv": measure}, draw)
