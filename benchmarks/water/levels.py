"""What each level of water gives a scene, beside living fish: none, drag alone, or drag and inertia.

Each level has the fish that is calibrated for it; that of reactive water is also put into drag. Gaits are searched for
every fish and level: those of least net work a metre at a speed, at the frequency of trout and at any (`scenes.py`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks.common import scenes
from benchmarks.common.charts import BLUE, GREY, ORANGE, legend_below, panels, save
from benchmarks.common.tables import RESULTS, ROOT, filled, markdown, publish, read_table, select
from fish_env import Fish, make_fish
from fish_env.bodies.fitted import WATERS
from fish_env.control import evaluate, make_eval_env, scripted
from fish_env.control.files import write_text
from fish_env.physics.world import VACUUM, change_water

PAGE = ROOT / "docs" / "choosing-the-water.md"
LEVELS = ("none", "drag", "reactive")
CASES = (("drag", "drag"), ("reactive", "reactive"), ("reactive", "drag"), ("reactive", "none"))
"""The level that a fish is calibrated for, and the level that it is in."""
CRUISES = ((1.0, 3.18), (2.0, 4.23))  # body lengths/s, and the tail beats of a trout of 19.6 cm (Drucker & Lauder), Hz


class Living(NamedTuple):
    """What living fish do, as text, and from where."""

    value: str
    source: str


LIVING = {
    ("cruise at 1 BL/s", "sweep"): Living("0.13 to 0.17", "Drucker & Lauder; Webb 1984"),
    ("cruise at 1 BL/s", "Strouhal"): Living("0.41", "Drucker & Lauder"),
    ("cruise at 1 BL/s", "nose over tail"): Living("0.10 to 0.14", "tracks of kfeilich/FishTrackProcessing"),
    ("cruise at 2 BL/s", "sweep"): Living("0.15 to 0.17", "Drucker & Lauder; Webb 1984"),
    ("cruise at 2 BL/s", "Strouhal"): Living("0.31", "Drucker & Lauder"),
    ("cruise at 2 BL/s", "nose over tail"): Living("0.10 to 0.14", "tracks of kfeilich/FishTrackProcessing"),
    ("thriftiest at 1 BL/s", "frequency"): Living("2.5 to 3.2", "Webb 1984; Drucker & Lauder"),
    ("thriftiest at 1 BL/s", "Strouhal"): Living("0.41", "Drucker & Lauder"),
    ("thriftiest at 2 BL/s", "frequency"): Living("3.8 to 4.2", "Webb 1984; Drucker & Lauder"),
    ("thriftiest at 2 BL/s", "Strouhal"): Living("0.31", "Drucker & Lauder"),
    ("turn", "radius"): Living("0.18", "trout (Webb 1983)"),
    ("turn", "rate"): Living("434 to 593", "dogfish, slow, front of the body (Domenici et al. 2004)"),
    ("start", "acceleration"): Living("7.5 to 16.5", "trout, muscles of one side (Johnsrude & Webb 1985)"),
    ("start", "best acceleration"): Living("22.7 to 39.5", "seven species (Webb 1978)"),
    ("coast", "drag coefficient"): Living("0.008 to 0.022", "bluegill at half the speed (Gellman et al.)"),
}
EPISODES, SEED = 32, 2_000_001  # of the motor controllers
CONTROLLED = {  # what the motor controllers achieve in a task: score, unit
    "Swim": ("speed", "BL/s"), "Turn": ("success", ""), "LeftAfterRight": ("success", ""),
    "Target": ("targets", ""), "Avoid": ("success", ""),
}  # fmt: skip
UNITS = {
    "speed": "BL/s", "frequency": "Hz", "sweep": "BL", "nose over tail": "", "Strouhal": "", "work": "J/kg/m",
    "angle": "degrees", "kept": "degrees", "rate": "degrees/s", "radius": "BL", "lag": "s", "way back": "degrees",
    "acceleration": "m/s2", "best angle": "degrees", "best snout": "degrees", "best distance": "BL",
    "best acceleration": "m/s2", "deceleration": "m/s2", "drag coefficient": "", "drift": "BL", "heading": "degrees",
    "carried": "",
}  # fmt: skip


def fish_in(name: str, level: str) -> Fish:
    """The fish that is calibrated for a level, in a level."""
    fish = make_fish(water=name)
    drag, reactive = fish.water._replace(added_mass=None, righting=0.0), change_water(fish.water, inertia=True)
    worlds = {"none": VACUUM, "drag": drag, "reactive": reactive} | {name: fish.water}
    return replace(fish, water=worlds[level])


def scenes_of(fish: Fish, swims: bool) -> dict[str, tuple[dict[str, float], str]]:
    """Quantities of every scene, and the gait of it; where nothing swims, without cruises."""
    found, gait = {}, None
    for speed, frequency in reversed(CRUISES) if swims else ():
        for scene, given in (("thriftiest", None), ("cruise", frequency)):
            gait = scenes.thriftiest(fish, speed, given)
            found[f"{scene} at {speed:g} BL/s"] = scenes.cruises(fish, [gait], speed, 12.0, count=6)[0], str(gait)
    return found | {
        "turn": (scenes.turn(fish, gait), str(gait)),
        "reversal": (scenes.reversal(fish, gait), str(gait)),
        "start": (scenes.start(fish), ""),
        "coast": (scenes.coast(fish), ""),
        "station": (scenes.station(fish, gait), str(gait)),
    }


def controlled() -> list[dict]:
    """Rows of the motor controllers, with the calibrated fish of each level."""
    rows = []
    for level in LEVELS[1:]:
        for task, (score, unit) in CONTROLLED.items():
            env = make_eval_env(f"FishEnv/{task}-v0", EPISODES, {"water": level})
            value = float(np.nanmean(evaluate(env, scripted(env), SEED)[score]))
            rows.append({
                "fish": "calibrated", "water": level, "scene": f"motor controllers, {task}", "quantity": score,
                "unit": unit, "value": round(value, 3), "living": "", "source": "", "gait": "",
            })  # fmt: skip
    return rows


def living_at(scene: str, quantity: str) -> Living:
    """What living fish do; empty if that is not known."""
    return LIVING.get((scene, quantity), Living("", ""))


def measure() -> list[dict]:
    """The rows of all fish, levels and scenes."""
    rows = controlled()
    for name, level in tqdm(CASES):
        for scene, (values, gait) in scenes_of(fish_in(name, level), swims=level != "none").items():
            for quantity, value in values.items():
                rows.append({
                    "fish": name, "water": level, "scene": scene, "quantity": quantity, "unit": UNITS[quantity],
                    "value": float(f"{value:.4g}"), "living": living_at(scene, quantity).value,
                    "source": living_at(scene, quantity).source, "gait": gait,
                })  # fmt: skip
    return rows


ROWS = (  # of the table of the page: scene, quantity, label, digits
    ("cruise at 2 BL/s", "Strouhal", "cruising at 2 BL/s, 4.23 Hz: Strouhal number", 2),
    ("cruise at 2 BL/s", "nose over tail", "nose over tail", 2),
    ("cruise at 2 BL/s", "work", "net work of the muscles, J/kg/m", 2),
    ("turn", "radius", "turning at 1 BL/s, one side for 0.2 s: radius, BL", 2),
    ("turn", "rate", "peak rate, degrees/s", 0),
    ("reversal", "way back", "reversing, then the other side: degrees back after 0.3 s", 0),
    ("start", "acceleration", "from rest, one side for 0.2 s: acceleration, m/s²", 1),
    ("start", "best angle", "from rest, best of two stages: degrees after 0.3 s", 0),
    ("start", "best acceleration", "acceleration, m/s²", 1),
    ("coast", "drag coefficient", "coasting from 2 BL/s: drag coefficient", 3),
)
PRICED = {
    ("drag", "drag"): "drag", ("drag", "none"): "the same fish in vacuum",
    ("drag", "reactive"): "the same in reactive water", ("reactive", "reactive"): "reactive",
}  # fmt: skip
"""Cases of the table of costs; the first is the one of cost 1."""
COLUMNS = {CASES[0]: "drag", CASES[1]: "reactive", CASES[2]: "the fish for reactive water, in drag"}


MISSED = 0.05  # part of its speed by which a cruise must not miss it, else no gait has it


def values_of(rows: list[dict]) -> dict[tuple[str, str, str, str], float]:
    """Values by fish, water, scene and quantity; nan for all but the speed of a cruise that misses its speed."""
    values = {(row["fish"], row["water"], row["scene"], row["quantity"]): row["value"] for row in rows}
    for (fish, water, scene, quantity), value in list(values.items()):
        if quantity == "speed" and " at " in scene and abs(value / float(scene.split()[2]) - 1.0) > MISSED:
            missed = [key for key in values if key[:3] == (fish, water, scene) and key[3] != "speed"]
            values |= dict.fromkeys(missed, np.nan)
    return values


def levels_table(rows: list[dict]) -> str:
    """The page's table: a row for each quantity, a column for each level with its own fish, and living fish."""
    values, lines = values_of(rows), []
    for scene, quantity, label, digits in ROWS:
        cells = (f"{values[level, level, scene, quantity]:.{digits}f}" for level in WATERS)
        lines.append((label, *cells, living_at(scene, quantity).value))
    return markdown(["", *WATERS, "living fish"], lines)


def stability_table(rows: list[dict]) -> str:
    """The page's table of fish that failed, and that rolled, in both waters."""
    lines = []
    for body in dict.fromkeys(row["body"] for row in rows):
        mine = [select(rows, body=body, water=level) for level in WATERS]
        lost = (f"{sum(r['failures'] for r in own)} of {sum(r['fish'] for r in own):,}" for own in mine)
        rolled = (f"{max(row['rolled_percent'] for row in own):.1f} %" for own in mine)
        lines.append((f"`{body}`", *lost, *rolled))
    head = ("", "failed: drag", "reactive", "rolled under the worst commands: drag", "reactive")
    return markdown(head, lines)


TABLES: dict[str, tuple[str, Callable[[list[dict]], str]]] = {
    "levels": ("water_levels.csv", levels_table),
    "stability": ("water_stability.csv", stability_table),
}
"""By the mark on the page, where its table comes from."""


PANELS = (  # of the chart: scene, quantity, title
    ("cruise at 2 BL/s", "Strouhal", "cruising at 2 BL/s:\nStrouhal number"),
    ("cruise at 2 BL/s", "work", "cruising at 2 BL/s:\nnet work, J/kg/m"),
    ("turn", "radius", "turning while cruising:\nradius, BL"),
    ("reversal", "way back", "reversal: turned back\nafter 0.3 s, degrees"),
    ("start", "best angle", "start from rest: turned\nafter 0.3 s, degrees"),
    ("start", "best acceleration", "start from rest:\nacceleration, m/s²"),
)


def draw() -> None:
    """Fill the page, and draw a panel for each quantity: bars for fish and levels, a band for living fish."""
    write_text(
        PAGE, filled(PAGE.read_text("utf-8"), {mark: table(read_table(name)) for mark, (name, table) in TABLES.items()})
    )
    values = values_of(read_table("water_levels.csv"))
    figure, axes = panels(3, 6.4, 2)
    for panel, (scene, quantity, title) in zip(axes, PANELS, strict=True):
        for place, (case, colour) in enumerate(zip(COLUMNS, (ORANGE, BLUE, "#f0c9a0"), strict=True)):
            panel.bar([place], [values[(*case, scene, quantity)]], 0.7, color=colour, label=COLUMNS[case])
        if living := living_at(scene, quantity).value:
            low, *_, high = map(float, [living, living] if " to " not in living else living.split(" to "))
            panel.axhspan(low, high + 1e-9, color=GREY, alpha=0.35, linewidth=1.5, zorder=0, label="living fish")
        panel.set(title=title, xticks=[])
    legend_below(figure, 4)
    save(figure, RESULTS / "water_levels.svg")


if __name__ == "__main__":
    publish(__doc__, {"water_levels.csv": measure}, draw)
