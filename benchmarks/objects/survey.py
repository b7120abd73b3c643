"""Elastic objects dropped, thrown and dragged, Song's methods on hers (Song 2009, ch. 5 and 7), one layer and two.

Steps that survive are those of a sixtieth of a second divided by a whole number with which an object passes through
all three scenes: nothing fails, no inner node leaves the outer layer, and the energy grows by less than SURVIVES.
"""

import time
from dataclasses import replace

import numpy as np

from benchmarks.common.charts import METHOD_STYLE, legend_below, panels, save, words
from benchmarks.common.tables import RESULTS, publish, read_table
from benchmarks.objects import layers, texts
from benchmarks.objects.methods import errors, largest_stable, largest_surviving, line_of, reference
from benchmarks.objects.scenes import FRAME, SCENES, energy_of_fall, outside, play, stage, watched
from fish_env.soft.objects import OBJECTS, SONG
from fish_env.soft.room import InRoom

METHODS = ("explicit_euler", "midpoint", "rk4", "leapfrog_chebyshev")
PARTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)  # steps of a sixtieth of a second
SECONDS = 1.3  # of a scene that a step is to survive
SURVIVES = 0.01  # of the energy of the fall
FRAMES = 60  # of each object that are timed


def real_time(thing: InRoom, scene) -> float:
    """Median of simulated over processor time at the object's own step."""
    tank, taken = stage(thing, scene), []
    steps = round(FRAME / tank.dt)
    tank.advance(steps)
    for _ in range(FRAMES):
        begin = time.process_time()
        tank.advance(steps)
        taken.append(time.process_time() - begin)
    return round(FRAME / float(np.median(taken)), 1)


def passes() -> list[dict]:
    """Rows of every object in every scene at its own step, the energy also at half of it."""
    rows = []
    for kind, record in OBJECTS.items():
        thing = record.make()
        for scene in SCENES.values():
            row, half = (watched(thing, scene, dt=thing.time_step / part) for part in (1, 2))
            rows.append({"object": kind, "scene": scene.name, "step_ms": 1e3 * thing.time_step,
                         "growth": row["growth"], "growth_at_half_step": half["growth"],
                         "depth_over_travel": row["depth_over_travel"], "escapes": row["escapes"],
                         "times_real_time": real_time(thing, scene)})  # fmt: skip
    return rows


def survives(thing: InRoom, name: str, dt: float) -> bool:
    """Return True if an object passes through all scenes with a method and a step."""
    for scene in SCENES.values():
        lowest = np.inf
        try:
            for k, now in enumerate(play(thing, replace(scene, seconds=SECONDS), name, dt)):
                lowest = min(lowest, now.energy - now.work)
                if now.energy - now.work - lowest > SURVIVES * energy_of_fall(thing):
                    return False
                if k % round(FRAME / dt) == 0 and outside(thing, now.position):
                    return False
        except ArithmeticError:
            return False
    return True


def methods() -> list[dict]:
    """Rows of Song's methods and the default on her objects: largest steps, errors in free flight."""
    rows = []
    for kind, record in SONG.items():
        thing = record.make()
        exact = reference(thing)
        for name in METHODS:
            step = largest_surviving(lambda dt, thing=thing, name=name: survives(thing, name, dt),
                                     [FRAME / part for part in PARTS])  # fmt: skip
            rows.append({"object": kind, "method": name, **largest_stable(thing, name), "scenes_ms": 1e3 * step,
                         **errors(thing, name, exact)})  # fmt: skip
    return rows


def draw() -> None:
    """Draw the error over the step on each object, and the chart of the layers."""
    figure, axes = panels(len(SONG), 4.4, sharey=True)
    for row in read_table("objects_methods.csv"):
        panel, (colour, marker) = axes[list(SONG).index(row["object"])], METHOD_STYLE[row["method"]]
        panel.loglog(*line_of(row, "error"), color=colour, marker=marker, label=words(row["method"]))
        if row["stable_ms"] < 99:
            panel.axvline(row["stable_ms"], color=colour, linewidth=0.8, linestyle=":")
    for panel, kind in zip(axes, SONG, strict=True):
        panel.set(title=kind, xlabel="step, ms", ylim=(1e-11, 1.0))
    axes[0].set_ylabel("error, object's lengths")
    legend_below(figure, 4, title="dotted: largest stable step")
    save(figure, RESULTS / "objects_methods.svg")
    layers.draw()
    texts.draw()


if __name__ == "__main__":
    tables = {"objects_scenes.csv": passes, "objects_methods.csv": methods, "objects_layers.csv": layers.measure,
              "objects_skyline.csv": texts.skyline, "objects_costs.csv": texts.costs}  # fmt: skip
    publish(__doc__, tables, draw)
