"""The fastest gait against the length of the fish: frequency, speed and power of muscles, beside living fish.

Living fish: the frequency at a speed of trout of 0.055 to 0.56 m (Webb, Kostecki & Stevens 1984, J. Exp. Biol. 109:77),
and the speed at a frequency of dace, trout and goldfish up to 0.3 m (Bainbridge 1958, J. Exp. Biol. 35:109). The power
is beside the most that fast muscle of cod of 0.1 to 0.6 m gives in cycles, a kilogram of muscle (Anderson & Johnston
1992, J. Exp. Biol. 170:143).
"""

import numpy as np

from benchmarks.common.charts import BLUE, GREY, ORANGE, legend_below, panels, save
from benchmarks.common.tables import RESULTS, columns, publish, read_table
from fish_env import Fish, Tank, make_fish
from fish_env.bodies.fitted import level_of
from fish_env.control import Gait
from fish_env.control.gait import best_gait

LENGTHS = (0.05, 0.1, 0.2, 0.4, 0.6)  # m
FREQUENCIES = 10.0 * np.geomspace(0.08, 1.25, 28)  # Hz, for a fish of 0.2 m; for others in proportion to 1/length
BEATS, MEASURED = 14, 6
FISH = ("drag", "reactive")  # the levels of water that they are calibrated for


def webb_frequency(length, speed):
    """Tail beats a second of trout of a length, m, at a speed, body lengths/s."""
    return 3.19 * (100.0 * length) ** (-1.0 / 3.0) + 1.29 * speed


def bainbridge_speed(frequency):
    """Speed, body lengths/s, of fish that beat so often a second; measured above 5 Hz."""
    return 0.25 * (3.0 * frequency - 4.0)


def muscle_power(length):
    """Most net power of fast muscle of cod of a length, m, in cycles at 8 degrees, W a kilogram of muscle."""
    return 27.5 * (np.asarray(length) / 0.1) ** -0.29


def swim(fish: Fish, frequencies) -> list[dict]:
    """Swim the best gait's strokes at frequencies (G,) Hz side by side; measure the last beats of those that survive.

    Power is the net work of the muscles, over the time and the mass of the fish.
    """
    known = best_gait(level_of(fish.water))
    gaits = [Gait(float(f), known.amplitude, known.lag) for f in frequencies]
    tank = Tank(fish, len(gaits), water=fish.water)
    steps, interval = 3, 3 * tank.dt
    count = int(np.ceil(BEATS / min(frequencies) / interval))
    contraction = np.stack([gait.contraction(fish, interval * np.arange(1, count + 1)) for gait in gaits], axis=1)
    share = fish.body.mass / fish.body.mass.sum()
    centre, tail, work = [], [], []
    for command in contraction:
        tank.drive(command, steps)
        centre.append(share @ tank.position)
        tail.append(tank.position[:, fish.tail].mean(axis=1))
        work.append(tank.work.copy())
    centre, tail, work = np.array(centre), np.array(tail), np.array(work)
    rows = []
    for i, frequency in enumerate(frequencies):
        last = round(MEASURED / frequency / interval) + 1
        path, seconds = centre[-1, i] - centre[-last, i], (last - 1) * interval
        speed = float(np.hypot(*path[:2])) / seconds / fish.length
        across = np.array([-path[1], path[0], 0.0]) / np.hypot(*path[:2])
        sway = (tail[-last:, i] - centre[-last:, i]) @ across / fish.length
        power = float(work[-1, i] - work[-last, i]) / seconds / fish.body.mass.sum()
        rows.append({"frequency_hz": frequency, "speed": speed, "sweep": np.ptp(sway), "power_w_kg": power})
    return [row for row, alive in zip(rows, tank.alive, strict=True) if alive]


def fastest(name: str, length: float) -> dict:
    """A row of the table: the fastest of a fish's gaits, and living fish of its length, speed and frequency."""
    frequencies = FREQUENCIES * 0.2 / length
    swum = swim(make_fish(length=length, water=name), frequencies)
    best = max(swum, key=lambda row: row["speed"])
    return {
        "fish": name, "length_m": length, **{key: round(float(value), 4) for key, value in best.items()},
        "strouhal": round(best["frequency_hz"] * best["sweep"] / best["speed"], 3),
        "webb_frequency_hz": round(float(webb_frequency(length, best["speed"])), 3),
        "bainbridge_speed": round(float(bainbridge_speed(best["frequency_hz"])), 3),
        "muscle_w_kg": round(float(muscle_power(length)), 2), "from_hz": round(float(frequencies[0]), 3),
        "to_hz": round(float(frequencies[-1]), 3), "failed": len(frequencies) - len(swum),
    }  # fmt: skip


def measure() -> list[dict]:
    """A row for each fish and length."""
    return [fastest(name, length) for name in FISH for length in LENGTHS]


def draw() -> None:
    """Draw frequency, speed and power against length from the table."""
    figure, (left, middle, right) = panels(3, 4.8)
    for name, colour in zip(FISH, (BLUE, ORANGE), strict=True):
        own = read_table("validation/sizes.csv", fish=name)
        for panel, key in ((left, "frequency_hz"), (middle, "speed"), (right, "power_w_kg")):
            panel.loglog(*columns(own, "length_m", key), "o-", color=colour, label=f"fastest gait, {name}")
        webb = columns(own, "length_m", "webb_frequency_hz")
        left.loglog(*webb, ":", color=colour, label=f"living fish (Webb, Bainbridge) for {name}")
        bainbridge = columns([row for row in own if row["frequency_hz"] >= 5.0], "length_m", "bainbridge_speed")
        middle.loglog(*bainbridge, ":", color=colour)
    right.loglog(LENGTHS, muscle_power(LENGTHS), ":", color=GREY, label="muscle of cod (Anderson & Johnston)")
    for panel, text in ((left, "tail beats, Hz"), (middle, "speed, BL/s"), (right, "net power of muscles, W/kg")):
        panel.minorticks_off()
        panel.set(xlabel="length, m", ylabel=text, xticks=LENGTHS, xticklabels=LENGTHS)
    legend_below(figure, 2)
    save(figure, RESULTS / "validation" / "sizes.svg")


if __name__ == "__main__":
    publish(__doc__, {"validation/sizes.csv": measure}, draw)
