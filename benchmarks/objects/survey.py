"""Elastic objects measured: scenes against their bars, Song's methods, her estimates, round balls (Song 2009, ch. 3-5).

python -m benchmarks.objects.survey             all tables and charts (about 5 min)
python -m benchmarks.objects.survey --draw      the charts again, from the tables
python -m benchmarks.objects.survey --frames    pictures a second with drawing, and against real time
python -m benchmarks.objects.survey --pictures  the strips of pictures of docs/elastic-objects.md
"""

import argparse
import time
from statistics import median

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import METHOD_STYLE, pyplot, save
from benchmarks.common.tables import IMAGES, RESULTS, read_table, write_csv
from benchmarks.objects.methods import METHODS, largest_stable, sweep
from benchmarks.objects.scenes import FRAME, SCENES, play, watched
from benchmarks.objects.shapes import estimates, roundness
from fish_env import Tank
from fish_env.bodies.objects import OBJECTS, SONG

COMMAND = "python -m benchmarks.objects.survey"
FRAMES = 300  # pictures of each object that are timed
MOMENTS = {"dropped": (0.0, 0.2, 0.28, 0.36, 0.5, 0.7), "thrown": (0.05, 0.12, 0.2, 0.3, 0.45, 0.8),
           "dragged": (0.3, 0.6, 0.8, 1.15, 1.25, 1.6)}  # fmt: skip


def scenes() -> list[dict]:
    """Every object in every scene at its own step and half of it, then without damping, to see energy conserved."""
    rows = []
    for kind, record in SONG.items():
        for damped in (True, False):
            thing = record.make() if damped else record.make(relaxation_time=0.0)
            for name in SCENES if damped else ["dropped"]:
                for part in (1, 2) if damped else (1, 2, 4):
                    row = watched(thing, SCENES[name], dt=thing.time_step / part)
                    rows.append({"object": kind, "damped": damped, **{k: v for k, v in row.items() if k != "object"}})
    return rows


def measure() -> None:
    """Write every table."""
    names = list(SONG)
    with tqdm(total=5, unit="table") as bar:
        for name, rows in (
            ("song_estimates.csv", estimates),
            ("song_round.csv", lambda: [roundness(level, even) for level in (1, 2, 3) for even in (False, True)]),
            ("song_scenes.csv", scenes),
            ("song_stable.csv", lambda: [largest_stable(OBJECTS[n].make(), m) for n in names for m in METHODS]),
        ):
            bar.set_postfix_str(name)
            write_csv(name, rows(), COMMAND)
            bar.update()
        bar.set_postfix_str("song_methods.csv")
        rows, references = sweep(names)
        write_csv("song_methods.csv", rows, COMMAND)
        write_csv("song_references.csv", references, COMMAND)
        bar.update()


def draw() -> None:
    """Every chart, from the tables."""
    plt = pyplot()

    draw_methods(plt)
    draw_estimates(plt)


def draw_methods(plt) -> None:
    """Error against step, and against cost, a column an object; a hollow mark on top where a method fails."""
    rows = read_table("song_methods.csv")
    stable = {(row["object"], row["integrator"]): float(row["stable_ms"]) for row in read_table("song_stable.csv")}
    figure, panels = plt.subplots(2, len(SONG), figsize=(15, 7.4), sharey=True, layout="constrained")
    top, bottom = 3.0, 1e-10
    for column, kind in zip(panels.T, SONG, strict=True):
        for name in METHODS:
            colour, marker = METHOD_STYLE[name]
            line = [row for row in rows if row["object"] == kind and row["integrator"] == name]
            valid = [row for row in line if float(row["error"]) < top]
            failed = [float(row["step_ms"]) for row in line if not float(row["error"]) < top]
            for panel, across in zip(column, ("step_ms", "ms"), strict=True):
                panel.loglog([float(row[across]) for row in valid], [float(row["error"]) for row in valid],
                             color=colour, marker=marker, markersize=4.5, linewidth=1.2, label=name)  # fmt: skip
            column[0].plot(failed, [top] * len(failed), linestyle="", color=colour, marker=marker, fillstyle="none")
            if stable[kind, name] < 99:
                column[0].axvline(stable[kind, name], color=colour, linewidth=0.8, linestyle=":")
        column[0].set(title=kind, xlabel="step, ms (dotted: the largest stable one)", ylim=(bottom, 2 * top))
        column[1].set(xlabel="computing 0.2 s of motion, ms")
        for panel in column:
            panel.grid(alpha=0.2)
            panel.xaxis.set_minor_formatter("")
    for row in panels:
        row[0].set_ylabel("error, object's lengths (hollow: failed)")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    save(figure, RESULTS / "song_methods.svg")


def draw_estimates(plt) -> None:
    """Volume over that of the smooth shape, exact and estimated, and the angle of estimated normals, over springs."""
    rows = read_table("song_estimates.csv")
    figure, panels = plt.subplots(1, 3, figsize=(14, 4.3), layout="constrained")
    colours = ("#000000", "#E69F00", "#0072B2", "#D55E00")
    for kind, marker in (("ring", "o"), ("sphere", "s"), ("uniform sphere", "^")):
        for shape, colour in zip(dict.fromkeys(row["shape"] for row in rows), colours, strict=True):
            line = [row for row in rows if row["kind"] == kind and row["shape"] == shape]
            springs = [int(row["springs"]) for row in line]
            label = {
                "color": colour,
                "marker": marker,
                "markersize": 4.5,
                "linewidth": 1.0,
                "label": f"{kind}, {shape}",
            }
            panels[0].loglog(springs, [1.0 - float(row["exact_volume"]) for row in line], **label)
            panels[1].semilogx(springs, [float(row["estimated_volume"]) for row in line], **label)
            panels[2].semilogx(springs, [float(row["mean_angle"]) for row in line], **label)
    panels[0].set(title="exact volume: missing part", xlabel="springs of the skin")
    panels[1].set(title="estimated volume over the true one", xlabel="springs of the skin", ylim=(0.0, 1.5))
    panels[2].set(title="estimated normals: mean angle off, degrees", xlabel="springs of the skin", ylim=(-2, 90))
    for panel in panels:
        panel.grid(alpha=0.2)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    save(figure, RESULTS / "song_estimates.svg")


def frames() -> list[dict]:
    """How long a sixtieth of a second of each object takes to compute and to draw, medians; pictures a second."""
    from fish_env.render.elastic_object import Painter

    rows = []
    for kind, record in OBJECTS.items():
        thing = record.make()
        painter, tank = Painter(thing), Tank(thing, water=thing.water)
        tank.velocity[0, :, 0] = 1.0 * (thing.body.inverse_mass[:, 0] > 0)
        steps, moved, drawn = round(FRAME / tank.dt), [], []
        tank.advance(steps)  # compiles
        for _ in range(FRAMES):
            begin = time.perf_counter()
            tank.advance(steps)
            middle = time.perf_counter()
            painter.picture(tank.position[0])
            drawn.append(time.perf_counter() - middle)
            moved.append(middle - begin)
        both = median(np.add(moved, drawn))
        rows.append({"object": kind, "nodes": thing.body.mass.size, "springs": thing.body.springs.stiffness.size,
                     "steps_a_frame": steps, "physics_ms": round(1e3 * median(moved), 3),
                     "drawing_ms": round(1e3 * median(drawn), 3), "frames_per_s": round(float(1 / both), 1),
                     "physics_over_real_time": round(FRAME / median(moved), 1)})  # fmt: skip
        print(rows[-1])
    return rows


def pictures() -> None:
    """Write a strip for each scene: a row for each object, six moments."""
    from PIL import Image

    from fish_env.render.elastic_object import Painter

    for name, scene in SCENES.items():
        strip = []
        for kind in ("ring", "sphere", "uniform sphere"):
            thing = OBJECTS[kind].make()
            painter, wanted, row = Painter(thing), list(MOMENTS[name]), []
            for now in play(thing, scene):
                if wanted and now.time >= wanted[0] - 1e-9:
                    wanted.pop(0)
                    row.append(painter.picture(now.position, now.hand)[:, 90:550])
            strip.append(np.concatenate(row, axis=1))
        together = Image.fromarray(np.concatenate(strip)).resize((1080, 563), Image.Resampling.LANCZOS)
        path = IMAGES / f"objects_{name}.png"
        together.save(path, optimize=True)
        print(f"{path}: {path.stat().st_size // 1000} kB")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="the charts again, from the tables")
    action.add_argument("--frames", action="store_true", help="pictures a second")
    action.add_argument("--pictures", action="store_true", help="the strips of the documentation")
    chosen = parser.parse_args()
    if chosen.frames:
        print(f"written to {write_csv('song_frames.csv', frames(), COMMAND + ' --frames')}")
    elif chosen.pictures:
        pictures()
    else:
        if not chosen.draw:
            measure()
        draw()
        print(f"written to {RESULTS}/song_*.csv and the charts beside them")


if __name__ == "__main__":
    main()
