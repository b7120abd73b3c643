"""Kinematics of a mackerel and of an eel imposed on their bodies: the bending torque along them.

Ming, Jin, Song, Luo, Du & Ding (2019, PLoS Comput. Biol. 15:e1006883) solve the Navier-Stokes equations round bodies of
given curvature that swim freely. Curvature, proportions, torques and speeds were measured in the files of
github.com/jbw15/fish_code_data, which has no licence and is not shipped; here are the numbers alone. Length, period and
density are 1. Half the depth of the mackerel's forked fin is half the sum of its two lobes, as in their added mass.
The files do not say the viscosity; the Reynolds number below is assumed, and matters to the speed only.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.common.charts import GREY, legend_below, panels, save
from benchmarks.common.tables import RESULTS, publish, read_table
from benchmarks.validation.waters import PLACES, along, by_curvature, off, waters
from fish_env import make_fish, prescribe

LENGTH, DENSITY, REYNOLDS = 0.3, 1000.0, 3000.0  # m, kg/m3; the period is 1 s
UNIT = 1e-4 * DENSITY * LENGTH**5  # N m, and W


@dataclass(frozen=True)
class Swimmer:
    """What is given of one of them, and what was found. Lengths are in body lengths."""

    curvature: Callable
    """Of the midline, (S,) rad a body length, at places (S,) and a time in periods."""
    outline: tuple[tuple[float, ...], ...]
    """Place, half width and half depth, (3,S)."""
    speed: float
    """A period."""
    torque: tuple[float, ...]
    """Half of the swing of the torque in a period, (21,) evenly spaced, 10^-4 density length^5 / period^2."""
    peak_at: float


SWIMMERS = {
    "mackerel": Swimmer(
        lambda s, t: (1.0 - 3.2 * s + 5.6 * s**2) * np.sin(2.0 * np.pi * (s - t)),
        ((0, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.26, 0.32, 0.38, 0.44, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.845,
          0.87, 0.89, 0.91, 0.93, 0.95, 0.975, 1),
         (0, 0.0149, 0.0226, 0.0307, 0.0396, 0.0495, 0.0583, 0.0666, 0.0711, 0.0721, 0.071, 0.068, 0.0634, 0.0564,
          0.0478, 0.0386, 0.0293, 0.0199, 0.0099, 0.002, 0.002, 0.002, 0.002, 0.002, 0.002, 0),
         (0, 0.0209, 0.0301, 0.0404, 0.0521, 0.0652, 0.0766, 0.087, 0.092, 0.0926, 0.0906, 0.0865, 0.0808, 0.0722,
          0.0611, 0.0484, 0.0355, 0.0237, 0.0153, 0.0243, 0.0394, 0.0535, 0.0561, 0.0379, 0.0164, 0.006)),
        0.249,
        (0.005, 0.097, 0.169, 0.314, 0.619, 1.045, 1.577, 2.141, 2.615, 2.958, 3.246, 3.397, 3.491, 3.395, 3.017,
         2.423, 1.729, 1.013, 0.377, 0.084, 0.0),
        0.6,
    ),
    "eel": Swimmer(
        lambda s, t: 11.41 * np.exp(s - 1.0) * np.sin(2.0 * np.pi * (s / 0.59 - t)),
        ((0, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1),
         (0, 0.0222, 0.0255, 0.0273, 0.0289, 0.0336, 0.0332, 0.0241, 0.0247, 0.0225, 0.0193, 0.0154, 0.0129, 0.0119,
          0.0102, 0.0078, 0.0056, 0),
         (0, 0.0163, 0.0223, 0.0252, 0.0287, 0.0321, 0.0342, 0.0321, 0.0322, 0.0325, 0.0312, 0.0301, 0.0382, 0.0293,
          0.0223, 0.0173, 0.0151, 0.006)),
        0.285,
        (0.0, 0.103, 0.31, 0.601, 0.946, 1.265, 1.61, 1.918, 2.12, 2.16, 2.009, 1.873, 1.571, 1.236, 0.989, 0.736,
         0.492, 0.3, 0.165, 0.07, 0.0),
        0.44,
    ),
}  # fmt: skip


def swim(name: str) -> list[dict]:
    """A row of every level of water."""
    given, rows = SWIMMERS[name], []
    fish = make_fish("tetrahedral", level=4, length=LENGTH, outline=np.transpose(given.outline))
    for level, water in waters(fish, given.speed * LENGTH**2 / REYNOLDS).items():
        swum = prescribe(fish, by_curvature(given.curvature), 1.0, water=water)
        torque = 0.5 * np.ptp(swum.torque, axis=0) / UNIT
        peak = int(torque.argmax())
        rows.append({
            "animal": name, "water": level, "torque": round(torque[peak], 3), "published_torque": max(given.torque),
            "off_percent": off(torque[peak], max(given.torque)), "peak_at": round(swum.station[peak], 3),
            "published_peak_at": given.peak_at, "speed_bl_period": round(swum.relative_speed, 3),
            "published_speed": given.speed, "power": round(swum.power.mean() / UNIT, 4),
            **{f"torque_{k}": round(value, 3) for k, value in enumerate(torque[::2])},
        })  # fmt: skip
    return rows


def measure() -> list[dict]:
    """The rows of all of them."""
    return [row for name in SWIMMERS for row in swim(name)]


def draw() -> None:
    """Half the swing of the torque along both bodies, of every level of water and published."""
    figure, axes = panels(2, 4.2)
    for panel, (name, given) in zip(axes, SWIMMERS.items(), strict=True):
        panel.plot(PLACES, given.torque, color=GREY, lw=3, label="Ming et al. 2019")
        along(panel, read_table("validation/torque.csv", animal=name), "torque")
        panel.set(title=name, xlabel="from the nose, BL", ylim=(0, None))
    axes[0].set_ylabel("half the torque's swing, 1e-4 density L⁵/T²")
    legend_below(figure, 5)
    save(figure, RESULTS / "validation" / "torque.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/torque.csv": measure}, draw)
