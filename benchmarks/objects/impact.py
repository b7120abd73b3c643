"""Song's three methods through impact and drag, what a step of each costs, and the forces of spheres (ch. 3.5.3, 5.3).

python -m benchmarks.objects.impact           the tables and the charts (about 15 min)
python -m benchmarks.objects.impact --costs   what a step costs, alone
python -m benchmarks.objects.impact --draw    the charts again, from the tables
"""

import argparse
import time
from dataclasses import replace
from itertools import product
from statistics import median

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import METHOD_STYLE, pyplot, save
from benchmarks.common.tables import RESULTS, read_table, write_csv
from benchmarks.objects.methods import METHODS, start
from benchmarks.objects.scenes import FRAME, SCENES, outside, play
from fish_env.bodies.objects import GRAVITY, OBJECTS, SONG
from fish_env.bodies.skins import Skin, evened, globe, octasphere, subdivided
from fish_env.elements import make_compartments
from fish_env.volume import volume_of

COMMAND = "python -m benchmarks.objects.impact"
PARTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # steps of a sixtieth of a second
FINER = (64, 96, 128)  # those of explicit Euler besides
FINE = 128
DURATION = 1.3  # s
SURVIVES = 0.01  # of the energy of the fall, by which that of a method that survives may grow
REPEATS = 101


def track(kind: str, scene: str, name: str, parts: int) -> dict:
    """The mean position after each picture (K,3) m, the failure, the growth of energy over the fall, and escapes."""
    thing = OBJECTS[kind].make()
    height = -thing.water.planes[0, 3] - 0.5 * thing.length
    path, failure, lowest, growth, escapes = [], "", np.inf, 0.0, 0
    try:
        for k, now in enumerate(play(thing, replace(SCENES[scene], seconds=DURATION), name, FRAME / parts), 1):
            lowest = min(lowest, now.energy - now.work)
            growth = max(growth, now.energy - now.work - lowest)
            if k % parts == 0:
                path.append(now.position[thing.outer].mean(axis=0))
                escapes += outside(thing, now.position)
    except ArithmeticError as error:
        failure = str(error).split(": ", 1)[1]
    growth /= thing.body.mass.sum() * GRAVITY * height
    return {"path": np.array(path) / thing.length, "failure": failure, "growth": growth, "escapes": escapes}


def passages(kind: str, scene: str) -> list[dict]:
    """Rows of every method and step through a scene of an object: whether it survives, how far its middle is off."""
    exact, rows = track(kind, scene, "rk4", FINE)["path"], []
    for name in METHODS:
        for parts in PARTS + FINER * (name == "explicit_euler"):
            found = track(kind, scene, name, parts)
            survives = not found["failure"] and found["growth"] < SURVIVES and not found["escapes"]
            off = np.linalg.norm(found["path"] - exact, axis=1).max() if survives else np.inf
            rows.append({"object": kind, "scene": scene, "integrator": name, "step_ms": 1e3 * FRAME / parts,
                         "survives": survives, "error": off, "growth": found["growth"],
                         "escapes": found["escapes"], "failure": found["failure"]})  # fmt: skip
    return rows


def longest(rows: list[dict], kind: str, scene: str, name: str) -> float:
    """The longest step, ms, from which on a method survives with every shorter one; 0 if it does with none."""
    line = [row for row in rows if (row["object"], row["scene"], row["integrator"]) == (kind, scene, name)]
    step = 0.0
    for row in sorted(line, key=lambda row: row["step_ms"]):
        if str(row["survives"]) != "True":
            break
        step = row["step_ms"]
    return step


def costs(kind: str, steps=400) -> list[dict]:
    """Rows: what a step of Song's methods costs in free fall, us, by turns in one run, and over explicit Euler."""
    thing, taken = OBJECTS[kind].make(), {name: [] for name in METHODS[:3]}
    for _ in range(REPEATS):
        for name, times in taken.items():
            tank = start(thing, name, 1e-5)
            tank.advance(1)
            begin = time.perf_counter()
            tank.advance(steps)
            times.append(1e6 * (time.perf_counter() - begin) / steps)
    ratios = {name: median(np.divide(times, taken["explicit_euler"])) for name, times in taken.items()}
    return [{"object": kind, "integrator": name, "us_per_step": median(times), "over_euler": ratios[name]}
            for name, times in taken.items()]  # fmt: skip


def icosphere(level: int) -> Skin:
    """An icosahedron divided in four `level` times: twelve nodes with 5 neighbours, all others with 6."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    place = [np.array(p) for k in range(3) for p in
             (np.roll((0.0, a, b * golden), k) for a in (-1.0, 1.0) for b in (-1.0, 1.0))]  # fmt: skip
    near = [[j for j in range(12) if j != i and np.linalg.norm(place[i] - place[j]) < 2.1] for i in range(12)]
    faces = [(i, j, k) for i in range(12) for j in near[i] for k in near[i] if i < j < k and k in near[j]]
    faces = [face if np.linalg.det([place[n] for n in face]) > 0 else face[::-1] for face in faces]
    return subdivided([point / np.linalg.norm(point) for point in place], faces, level)


def force_error(kind: str, skin: Skin, factor=1.0) -> dict:
    """A row: how unequal the forces on the nodes of a swollen sphere are, where a smooth sphere has equal ones.

    Springs of one stiffness, times factor (E,), unstretched at the unit radius, are swollen by 1 %. The force on a
    node, over its share of the faces, is compared with the mean one, along the radius: root mean square, and largest.
    """
    place, (a, b) = skin.place, skin.edges.T
    load = volume_of(make_compartments(place, [skin.faces], 1.0).faces, place)[1]
    share = np.sum(load * place, axis=1)
    pull = 0.01 * np.broadcast_to(factor, len(a))[:, None] * (place[b] - place[a])
    force = np.zeros_like(place)
    np.add.at(force, a, pull)
    np.add.at(force, b, -pull)
    force /= share[:, None]
    mean = -np.sum(share * np.sum(force * place, axis=1)) / share.sum()
    off = np.linalg.norm(force + mean * place, axis=1) / mean
    return {"kind": kind, "nodes": len(place), "springs": len(a), "rms": np.sqrt(np.sum(share * off**2) / share.sum()),
            "largest": off.max(), "smallest_area_over_largest": share.min() / share.max()}  # fmt: skip


def force_errors() -> list[dict]:
    """Rows of spheres of circles of latitude, subdivided octahedra, with the correction and without, and icosahedra."""
    rows = [force_error("circles of latitude", globe(n, 2 * n // 3)) for n in (6, 12, 24, 48)]
    rows += [force_error("octahedron", octasphere(n)) for n in range(1, 5)]
    rows += [force_error("octahedron, corrected", octasphere(n), evened(octasphere(n).edges)) for n in range(1, 5)]
    return rows + [force_error("icosahedron", icosphere(n)) for n in range(1, 4)]


def draw() -> None:
    """Error of the middle of each object through each scene, hollow marks where a method fails; forces of spheres."""
    rows = read_table("song_impact.csv")
    figure, axes = pyplot().subplots(len(SONG), len(SCENES), figsize=(11.5, 12.5), sharex=True, sharey=True,
                                     layout="constrained")  # fmt: skip
    for panel, (kind, scene) in zip(axes.flat, product(SONG, SCENES), strict=True):
        for name in METHODS:
            colour, marker = METHOD_STYLE[name]
            line = [row for row in rows if (row["object"], row["scene"], row["integrator"]) == (kind, scene, name)]
            good = [row for row in line if np.isfinite(row["error"])]
            bad = [row["step_ms"] for row in line if not np.isfinite(row["error"])]
            panel.loglog([row["step_ms"] for row in good], [row["error"] for row in good], color=colour, marker=marker,
                         markersize=4.5, linewidth=1.1, label=name)  # fmt: skip
            panel.plot(bad, [3.0 * 1.8 ** METHODS.index(name)] * len(bad), linestyle="", marker=marker, color=colour,
                       markersize=4.5, fillstyle="none")  # fmt: skip
        panel.set_title(f"{kind}, {scene}")
        panel.grid(alpha=0.2)
    for panel in axes[-1]:
        panel.set_xlabel("step, ms")
    for panel in axes[:, 0]:
        panel.set_ylabel("error of the middle, lengths\n(hollow: fails)")
    axes[0, 0].legend(frameon=False, fontsize=8)
    save(figure, RESULTS / "song_impact.svg")
    forces = read_table("song_forces.csv")
    figure, panel = pyplot().subplots(figsize=(6.0, 4.2), layout="constrained")
    for kind, marker in zip(dict.fromkeys(row["kind"] for row in forces), "osvD", strict=True):
        line = [row for row in forces if row["kind"] == kind]
        panel.loglog([row["springs"] for row in line], [row["rms"] for row in line], marker=marker, label=kind)
    panel.set(title="forces of a swollen sphere", xlabel="springs of the skin", ylabel="error, root mean square")
    panel.grid(alpha=0.2)
    panel.legend(frameon=False, fontsize=8)
    save(figure, RESULTS / "song_forces.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="the charts again, from the tables")
    parser.add_argument("--costs", action="store_true", help="what a step costs, alone")
    chosen = parser.parse_args()
    if chosen.costs or not chosen.draw:
        write_csv("song_costs.csv", [row for kind in SONG for row in costs(kind)], COMMAND)
    if not (chosen.costs or chosen.draw):
        write_csv("song_forces.csv", force_errors(), COMMAND)
        rows = [row for kind, scene in tqdm(list(product(SONG, SCENES))) for row in passages(kind, scene)]
        write_csv("song_impact.csv", rows, COMMAND)
    draw()
    rows = read_table("song_impact.csv")
    for kind, scene in product(SONG, SCENES):
        print(f"{kind}, {scene}:", ", ".join(f"{name} {longest(rows, kind, scene, name):.2g} ms" for name in METHODS))
    for kind, name in product(SONG, METHODS):
        off = [row["error"] for row in rows if (row["object"], row["integrator"]) == (kind, name)]
        print(f"{kind}, {name}: median error where it survives {median(filter(np.isfinite, off)):.2g} lengths")
    print(f"written to {RESULTS}: song_impact.csv, song_costs.csv, song_forces.csv, and the charts beside them")


if __name__ == "__main__":
    main()
