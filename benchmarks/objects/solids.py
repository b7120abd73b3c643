"""Objects of finite elements: scenes, and every method that serves them, error against cost and where each fails.

    python -m benchmarks.objects.solids             CSVs and chart (about 15 min)
    python -m benchmarks.objects.solids --draw      the chart again, from the CSVs
    python -m benchmarks.objects.solids --picture   the strip of pictures of docs/elastic-objects.md

Scenes are those of Song's objects, and two more: a solid is let go twisted about its long axis, or turned inside out.
The methods move a beam in free flight against a reference; then each starts from harder states with longer and longer
steps, until it fails or gains energy. Costs are seconds of the processor.
"""

import argparse
import time

import numpy as np

from benchmarks.common.charts import METHOD_STYLE, panels, save
from benchmarks.common.tables import IMAGES, RESULTS, read_table, write_csv
from benchmarks.objects.methods import ACCURATE, STEPS, largest_stable, one, reference, swing
from benchmarks.objects.scenes import SCENES, play, watched
from fish_env import Tank
from fish_env.bodies.distorted import inverted, out_of_shape, twisted
from fish_env.bodies.objects import SOLIDS
from fish_env.bodies.room import InRoom
from fish_env.bodies.solids import make_ball, make_beam
from fish_env.forces.evaluate import Evaluator
from fish_env.world import VACUUM

COMMAND = "python -m benchmarks.objects.solids"
METHODS = ("explicit_euler", "midpoint", "rk4", "symplectic_euler", "leapfrog_chebyshev", "linearly_implicit",
           "rosenbrock")  # fmt: skip
OWN = ("leapfrog_chebyshev", "linearly_implicit")
"""Methods that let a twisted or inverted solid go."""
LONGEST, HALVINGS = 1 / 15, 14  # s; steps that are tried for robustness, each half of the one before
WATCHED, CHECKS, GAIN = (
    1.0,
    20,
    0.01,
)  # s, times at which the energy is looked at, what it may gain of that at the start
SETTLED = 3.0  # s
STARTS = {"swing": "o", "twisted": "s", "inverted": "^"}
MOMENTS = (0.2, 0.32, 0.4, 0.5, 0.8, 1.2)  # s, of the pictures


def started(thing: InRoom, how: str, name: str, dt: float) -> Tank:
    """A solid by itself, about to swing as in the chart of errors, twisted, or inside out."""
    tank = Tank(thing, integrator=name, dt=dt, water=VACUUM, threads=1)
    if how == "swing":
        tank.velocity[0] = swing(thing, 0.5)
    else:
        tank.position[0] = {"twisted": twisted, "inverted": inverted}[how](thing)
    return tank


def recovered(thing: InRoom, how: str, name: str) -> dict:
    """How far a solid is from its shape some seconds after it was let go."""
    tank = started(thing, how, name, thing.time_step)
    tank.advance(round(SETTLED / tank.dt))
    return {"object": thing.name, "scene": how, "integrator": name, "step_ms": 1e3 * tank.dt,
            "out_of_shape": out_of_shape(thing.body, tank.position[0]), "failure": tank.failure[0]}  # fmt: skip


def survives(thing: InRoom, how: str, name: str, dt: float) -> tuple[bool, float]:
    """Whether a solid lasts a second with steps of dt s without gaining energy, and the ms that the second took."""
    tank, evaluator = started(thing, how, name, dt), Evaluator(thing.body, VACUUM)
    begun = spent = 0.0
    for check in range(CHECKS + 1):
        stored = evaluator.energies(tank.rest_length[0], tank.position[0], tank.velocity[0])
        level = sum(stored.values())
        begun = level if check == 0 else begun
        if not (tank.alive[0] and level <= (1.0 + GAIN) * begun):
            return False, np.nan
        if check < CHECKS:
            begin = time.process_time()
            tank.advance(max(1, round(WATCHED / dt / CHECKS)))
            spent += time.process_time() - begin
    return True, 1e3 * spent / float(tank.time[0])


def longest_step(thing: InRoom, strain: str, how: str, name: str) -> dict:
    """A row: the longest step that a solid survives, and with it two halves of it; what a second costs with it."""
    steps = [LONGEST / 2**k for k in range(HALVINGS)]
    started(thing, how, name, steps[-1]).advance(1)  # compiles
    found = [survives(thing, how, name, steps[0])]
    for dt in steps[1:]:
        if len(found) >= 3 and all(good for good, _ in found[-3:]):
            break
        found.append(survives(thing, how, name, dt))
    good = next((k for k in range(len(found)) if all(ok for ok, _ in found[k:])), None)
    row = {"object": thing.name, "strain": strain, "start": how, "integrator": name}
    if good is None:
        return row | {"longest_ms": np.nan, "ms_a_second": np.nan}
    return row | {"longest_ms": 1e3 * steps[good], "ms_a_second": round(found[good][1], 3)}


def scenes() -> tuple[list[dict], list[dict]]:
    """Every solid in every scene, at its own step and half of it; and what comes back to its shape."""
    rows, back = [], []
    for kind, record in SOLIDS.items():
        thing = record.make()
        for scene in SCENES.values():
            for part in (1, 2):
                rows.append({"object": kind, **watched(thing, scene, dt=thing.time_step / part)})
                print(rows[-1], flush=True)
        for how in ("twisted", "inverted"):
            for name in OWN:
                back.append(recovered(thing, how, name))
                print(back[-1], flush=True)
    return rows, back


def things() -> dict[tuple[str, str], InRoom]:
    """A beam and a ball, by name and measure of strain."""
    made = (("beam", make_beam), ("ball", make_ball))
    return {(kind, strain): make(strain=strain) for kind, make in made for strain in ("linear", "corotational")}


def measure() -> None:
    """Write every table."""
    rows, back = scenes()
    write_csv("solid_scenes.csv", rows, COMMAND)
    write_csv("solid_recovery.csv", back, COMMAND)
    rows, stable, robust, references = [], [], [], []
    for (kind, strain), thing in things().items():
        exact, apart = reference(thing)
        references.append({"object": kind, "strain": strain, "rk4_apart": apart})
        for name in METHODS:
            one(thing, name, STEPS[0], exact)  # compiles
            for steps in STEPS:
                rows.append({"strain": strain, **one(thing, name, steps, exact, 3, time.process_time)})
                if rows[-1]["error"] < ACCURATE:
                    break
            stable.append({"strain": strain, **largest_stable(thing, name)})
            print(rows[-1], stable[-1], flush=True)
            for how in STARTS:
                if strain == "corotational":
                    robust.append(longest_step(thing, strain, how, name))
                    print(robust[-1], flush=True)
    for name, table in (("methods", rows), ("stable", stable), ("robust", robust), ("references", references)):
        write_csv(f"solid_{name}.csv", table, COMMAND)


def draw() -> None:
    """Error against cost of the beam, linear and corotational, and the longest step of each start against its cost."""
    rows, robust = read_table("solid_methods.csv"), read_table("solid_robust.csv")
    figure, (left, middle, right) = panels(3, (15.0, 5.0))
    for name in METHODS:
        colour, marker = METHOD_STYLE[name]
        for panel, strain in ((left, "linear"), (middle, "corotational")):
            line = [row for row in rows if (row["object"], row["strain"], row["integrator"]) == ("beam", strain, name)]
            line = [row for row in line if float(row["error"]) < 1.0]
            panel.loglog([row["ms"] for row in line], [row["error"] for row in line], color=colour, marker=marker,
                         markersize=4.5, linewidth=1.2, label=name)  # fmt: skip
        for how, mark in STARTS.items():
            mine = [row for row in robust if (row["object"], row["integrator"], row["start"]) == ("beam", name, how)]
            mine = [row for row in mine if row["longest_ms"] == row["longest_ms"]]
            right.loglog([row["longest_ms"] for row in mine], [row["ms_a_second"] for row in mine], linestyle="",
                         color=colour, marker=mark, markersize=8, fillstyle="none", markeredgewidth=1.6)  # fmt: skip
    for panel, strain in ((left, "linear"), (middle, "corotational")):
        panel.set(title=f"beam, {strain} strain", xlabel="computing 0.2 s of motion, ms", ylim=(1e-10, 1.0))
        panel.set_ylabel("error, beam's lengths")
    right.set(title="beam, corotational: the longest step that lasts", xlabel="step, ms",
              ylabel="computing a second with it, ms")  # fmt: skip
    marks = [right.plot([], [], linestyle="", color="#444444", marker=mark, fillstyle="none")[0]
             for mark in STARTS.values()]  # fmt: skip
    right.legend(marks, list(STARTS), frameon=False, title="starts")
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(METHODS), frameon=False)
    save(figure, RESULTS / "solid_methods.svg")


def picture() -> None:
    """A row for each solid, thrown, at six moments."""
    from PIL import Image

    from fish_env.render.elastic_object import Painter

    strip = []
    for record in SOLIDS.values():
        thing = record.make()
        painter, wanted, row = Painter(thing), list(MOMENTS), []
        for now in play(thing, SCENES["thrown"]):
            if wanted and now.time >= wanted[0] - 1e-9:
                wanted.pop(0)
                row.append(painter.picture(now.position)[:, 90:550])
        strip.append(np.concatenate(row, axis=1))
    together = Image.fromarray(np.concatenate(strip))
    together = together.resize((1080, round(1080 * together.height / together.width)), Image.Resampling.LANCZOS)
    path = IMAGES / "objects_solids.png"
    together.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="the chart again, from the tables")
    action.add_argument("--picture", action="store_true", help="the strip of the documentation")
    chosen = parser.parse_args()
    if chosen.picture:
        picture()
        return
    if not chosen.draw:
        measure()
    draw()


if __name__ == "__main__":
    main()
