"""The three measures of strain of the tetrahedra beside one another: rotation, extension, bending, and what they cost.

    python -m benchmarks.accuracy.strain_measures           CSVs and chart (about 3 min)
    python -m benchmarks.accuracy.strain_measures --draw    the chart again, from the CSVs

A block is turned, a bar is drawn out and pressed with its sides free to move, the beam of `benchmarks/common/beam.py`
is bent by an end load of fixed direction. What is known without a mesh stands beside each: no force, the law of the
material, the elastica. Costs are those of a force evaluation and of a step of `linearly_implicit`, over linear strain,
of the beam with 615 nodes; repeats alternate, ratios are medians.
"""

import argparse
import time

import numpy as np

from benchmarks.accuracy.beam_bending import bend, elastica, volume
from benchmarks.common.beam import LENGTH, YOUNG, cantilever, loose, solid, tip
from benchmarks.common.charts import BLUE, GREY, ORANGE, panels, save
from benchmarks.common.tables import IMAGES, read_table, write_csv
from fish_env import Tank, statics
from fish_env.bodies.mesh import box
from fish_env.elements import STRAINS
from fish_env.forces.evaluate import Evaluator, compiled
from fish_env.world import VACUUM

COMMAND = "python -m benchmarks.accuracy.strain_measures"
ANGLES = tuple(range(0, 181, 15))  # degrees
STRETCHES = (0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5)
LOADS = tuple(range(1, 11))  # P L^2 / E I
THROUGH = 8  # cells through the thickness of the beam that is bent
SIDE = 0.1  # m, of the block and of the bar
REPEATS, CALLS, STEPS = 21, 40, 10
NAMES = {"linear": "linear", "corotational": "corotational", "green_lagrange": "Green-Lagrange"}
STYLES = {
    "linear": (ORANGE, {"linestyle": "--", "marker": "s", "markersize": 4}),
    "corotational": (BLUE, {"linestyle": "-", "marker": "o", "markersize": 6, "fillstyle": "none"}),
    "green_lagrange": ("#009E73", {"linestyle": "-.", "marker": "^", "markersize": 4}),
}


def rotated(strain: str) -> list[dict]:
    """Energy and largest force of a block that is turned about z, over E V and E times the area of a side."""
    position, nodes = box((SIDE, SIDE, SIDE), (3, 3, 3))
    body, rows = solid(position, nodes, 0.3, strain=strain), []
    for angle in ANGLES:
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        x = position @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
        force = Evaluator(body, VACUUM).force(np.zeros(0), x, 0.0 * x)
        stored = Evaluator(body, VACUUM).energies(np.zeros(0), x, 0.0 * x)
        rows.append({
            "strain": strain, "degrees": angle, "energy": (sum(stored.values())) / (YOUNG * SIDE**3),
            "force": np.abs(force).max() / (YOUNG * SIDE**2),
        })  # fmt: skip
    return rows


def law(strain: str, stretch: float) -> float:
    """The force on a bar of Poisson's ratio 0, over E times its area at rest."""
    return 0.5 * stretch * (stretch**2 - 1.0) if strain == "green_lagrange" else stretch - 1.0


def drawn(strain: str) -> list[dict]:
    """The force on the end of a bar, over E times its area at rest, at each stretch, beside the law of the material."""
    position, nodes = box((SIDE, SIDE / 2, SIDE / 2), (4, 2, 2))
    whole = solid(position, nodes, 0.0, strain=strain)
    end = position[:, 0] == position[:, 0].max()
    rows = []
    for stretch in STRETCHES:
        x = position * [stretch, 1.0, 1.0]
        force = Evaluator(whole, VACUUM).force(np.zeros(0), x, 0.0 * x)
        rows.append({
            "strain": strain, "stretch": stretch, "force": -force[end, 0].sum() / (YOUNG * SIDE**2 / 4),
            "law": law(strain, stretch),
        })  # fmt: skip
    return rows


def bent(strain: str) -> list[dict]:
    """Tip and volume of the beam under each load, beside the elastica's tip."""
    body, rows = cantilever(THROUGH, strain=strain), []
    try:
        for load, x in bend(body, LOADS):
            wanted, here = elastica(load)[-1], tip(body, x) / LENGTH
            rows.append({
                "strain": strain, "load": load, "x": here[0], "z": here[2], "elastica_x": wanted[0],
                "elastica_z": wanted[1], "apart": float(np.hypot(*(here[[0, 2]] - wanted))), "volume": volume(body, x),
            })  # fmt: skip
            print(rows[-1], flush=True)
    except statics.NoEquilibrium as error:
        print(f"{strain}: none under {load + 1}: {error}")
    return rows


def costs() -> list[dict]:
    """Microseconds of a force evaluation and of a step of `linearly_implicit`, and both over those of linear strain."""
    bodies = {strain: cantilever(4, strain=strain, relaxation_time=0.002) for strain in STRAINS}
    tanks = {name: Tank(loose(body, 0.002), 1, "linearly_implicit", 0.002, threads=1) for name, body in bodies.items()}
    evaluators = {name: Evaluator(body, VACUUM) for name, body in bodies.items()}
    taken: dict[str, dict] = {"force": {}, "step": {}}
    for name, tank in tanks.items():
        evaluators[name].force(np.zeros(0), tank.position[0], tank.velocity[0])
        tank.advance(STEPS)
    for _ in range(REPEATS):
        for name, evaluator in evaluators.items():
            call, block = compiled(evaluator.names, "add_force"), evaluator._block
            begin = time.perf_counter()
            for _ in range(CALLS):
                call(block)
            taken["force"].setdefault(name, []).append((time.perf_counter() - begin) / CALLS)
        for name, tank in tanks.items():
            begin = time.perf_counter()
            tank.advance(STEPS)
            taken["step"].setdefault(name, []).append((time.perf_counter() - begin) / STEPS)
    rows = []
    for what, by_name in taken.items():
        for name, times in by_name.items():
            ratio = np.array(times) / np.array(by_name["linear"])
            rows.append({
                "what": what, "strain": name, "nodes": len(bodies[name].mass),
                "tetrahedra": len(bodies[name].tets.nodes), "us": round(1e6 * float(np.median(times)), 1),
                "over_linear": round(float(np.median(ratio)), 3), "quarter": round(float(np.quantile(ratio, 0.25)), 3),
                "three_quarters": round(float(np.quantile(ratio, 0.75)), 3),
            })  # fmt: skip
            print(rows[-1], flush=True)
    return rows


def draw() -> None:
    """Energy of the turned block, force on the bar, and the error of the beam's tip."""
    turned, bar, beam = (read_table(f"strain_{name}.csv") for name in ("rotation", "extension", "bending"))
    figure, axes = panels(3, (13.0, 4.2))
    for strain, (colour, style) in STYLES.items():
        for panel, rows, x, y in zip(
            axes, (turned, bar, beam), ("degrees", "stretch", "load"), ("energy", "force", "apart"), strict=True
        ):
            mine = [row for row in rows if row["strain"] == strain]
            panel.plot([row[x] for row in mine], [row[y] for row in mine], color=colour, label=NAMES[strain], **style)
    axes[0].set(xlabel="rotation of the block, degrees", ylabel="energy, over E V", xticks=range(0, 181, 45))
    axes[1].axhline(0.0, color=GREY, linewidth=0.8)
    axes[1].set(xlabel="length of the bar, over that at rest", ylabel="force, over E A")
    axes[2].set(xlabel="end load, EI/L$^2$", ylabel="distance of the tip from the elastica's, over L", yscale="log")
    for panel in axes:
        panel.legend(frameon=False, fontsize=8)
    save(figure, IMAGES / "strain_measures.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSVs")
    if not parser.parse_args().draw:
        write_csv("strain_rotation.csv", [row for strain in STRAINS for row in rotated(strain)], COMMAND)
        write_csv("strain_extension.csv", [row for strain in STRAINS for row in drawn(strain)], COMMAND)
        write_csv("strain_costs.csv", costs(), COMMAND)
        write_csv("strain_bending.csv", [row for strain in STRAINS for row in bent(strain)], COMMAND)
    draw()


if __name__ == "__main__":
    main()
