"""Errors and costs of methods on random held-out scenes, in drag and in reactive water.

Scenes, errors and costs are those of `fish_env/control/chart.py`. The abrupt turn of `benchmarks/common/problems.py`
stands beside them.
"""

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import legend_below, panels, save
from benchmarks.common.problems import left_after_right
from benchmarks.common.tables import RESULTS, publish, read_table, select
from fish_env import make_fish
from fish_env.control.chart import Line, Reference, Setting, draw_errors, lines, measure, random_scenes, reference

BODIES = {"mass_spring": 256, "planar": 256, "two_layer": 65, "tetrahedral": 65}
"""Each body, and the fish in a batch: all scenes once where a body is slow."""
SETTINGS = [("reactive", body) for body in ("mass_spring", "planar")] + [("drag", body) for body in BODIES]
"""Waters and bodies. References of the other bodies in reactive water would take most of an hour."""


def setting(body: str, water: str) -> Setting:
    """A body that is calibrated for a water, in it, with its scenes, and the abrupt turn as the last."""
    fish = make_fish(body, water=water, **({"level": 1} if body == "tetrahedral" else {}))
    scenes = random_scenes(fish, fish.water)
    turn = left_after_right(fish)[None, : scenes.goals.shape[1]]
    return scenes._replace(goals=np.concatenate([scenes.goals, turn]))


def row_of(body: str, water: str, scenes: Setting, truth: Reference, line: Line) -> dict:
    """A row of `measure`, and the error of the turn."""
    row, error = measure(scenes, truth, line, BODIES[body])
    return {"body": body, "water": water, **row, "turn": float(error[-1])}


def measure_all() -> list[dict]:
    """The rows of every setting."""
    rows = []
    for water, body in SETTINGS:
        scenes = setting(body, water)
        truth, tried = reference(scenes), lines(scenes.fish, scenes.world)
        rows += [row_of(body, water, scenes, truth, line) for line in tqdm(tried, f"{body}, {water}")]
    return rows


def least_expensive(rows: list[dict], accuracy: float, key: str) -> dict:
    """The least expensive row without failures whose error, that of `key`, is at most `accuracy` body lengths."""
    return min((row for row in rows if not row["failed"] and row[key] <= accuracy), key=lambda r: r["us_per_interval"])


def draw() -> None:
    """One panel a body and water: geometric mean against price, and lines up to the worst scene, a tick at 90 %."""
    rows = read_table("held_out.csv")
    cases = list(dict.fromkeys((row["water"], row["body"]) for row in rows))
    figure, axes = panels(3, 7.0, len(cases) // 3, sharey=True)
    for panel, (water, body) in zip(axes, cases, strict=True):
        draw_errors(panel, select(rows, water=water, body=body))
        panel.set_title(f"{body.replace('_', '-')} fish, {water}")
    axes[-2].set_xlabel("processor time of a control interval, µs")
    figure.supylabel("error, body lengths (hollow: some failed)")
    legend_below(figure, 3)
    save(figure, RESULTS / "held_out.svg")


if __name__ == "__main__":
    publish(__doc__, {"held_out.csv": measure_all}, draw)
