"""Prescribed displacements by a penalty against those by elimination: errors and costs.

    python -m benchmarks.accuracy.boundary            the CSV and the chart (seconds)
    python -m benchmarks.accuracy.boundary --draw     the chart again, from the CSV

A fish of springs and a bar of tetrahedra are fixed at one end, by elimination, and moved at the other. The penalty is
an anchor without length on every moved node; its size is a multiple of the largest entry of the stiffness matrix.
"""

import argparse
import sys
from itertools import permutations, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.common.charts import pyplot, save
from benchmarks.common.tables import IMAGES, read_table, write_csv
from fish_env import Tank, make_fish
from fish_env.bodies.fish import ElasticObject
from fish_env.body import Body, fix, make_body
from fish_env.conditions import PENALTY, largest_entry
from fish_env.elements import make_tets
from fish_env.prescribed import prescribed_displacement
from fish_env.world import VACUUM, Anchors, make_anchors

COMMAND = "python -m benchmarks.accuracy.boundary"
CSV = "boundary.csv"
CHART = IMAGES / "boundary.svg"
PENALTIES = 10.0 ** np.arange(0, 15)
TEXTBOOK = PENALTY  # the multiple that textbooks recommend
MOST = 1e5  # in time: beyond, the default method would need more stages than it is allowed
BODIES = {"fish": ("fish of springs", "#0072B2", "o"), "bar": ("bar of tetrahedra", "#D55E00", "s")}


class Task(NamedTuple):
    """A body fixed at one end, the nodes at its other end, and how far each is to move, (K,3) m."""

    body: Body
    nodes: np.ndarray
    displacement: np.ndarray


def fish_task() -> Task:
    """The fish, its head fixed, its tail bent to a side by a twentieth of its length."""
    fish = make_fish()
    head = fish.body.position[:, 0] >= np.sort(fish.body.position[:, 0])[-5]
    return Task(fix(fish.body, head), fish.tail, np.tile([0.0, 0.05 * fish.length, 0.0], (2, 1)))


def bar_task(cells=(6, 2, 2), size=0.05) -> Task:
    """A bar of cubes of five-centimetre edges, six tetrahedra each, one end fixed, the other pulled and bent."""
    grid = np.array(list(product(*(range(n + 1) for n in cells))))
    number = {tuple(corner): i for i, corner in enumerate(grid.tolist())}
    nodes = []
    for cube in product(*map(range, cells)):
        for order in permutations(np.eye(3, dtype=int)):
            path = np.array(cube) + np.vstack([np.zeros(3, int), np.cumsum(order, axis=0)])
            path = path if np.linalg.det(path[1:] - path[0]) > 0 else path[[1, 0, 2, 3]]
            nodes.append([number[tuple(corner)] for corner in path.tolist()])
    position = size * grid
    shape = make_tets(position, nodes, 1e5, 0.3)
    body = make_body(position, np.full(len(grid), 0.1), [], [], [], [], [], tets=shape)
    end = np.flatnonzero(grid[:, 0] == cells[0])
    return Task(fix(body, grid[:, 0] == 0), end, np.tile([0.01, 0.02, 0.0], (end.size, 1)))


TASKS = {"fish": fish_task, "bar": bar_task}


def present_lengths(body: Body) -> np.ndarray:
    """Lengths of the springs at rest, (E,) m: taken for the rest lengths, they leave no force at rest."""
    ends = body.position[body.springs.nodes]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def tensionless(body: Body) -> Body:
    """The body without forces at rest: its springs have the lengths that they have there."""
    return body._replace(springs=body.springs._replace(rest_length=present_lengths(body)))


def by_elimination(task: Task) -> np.ndarray:
    """Displacement (N,3) m of all nodes, those to be moved being fixed where they are to go."""
    return prescribed_displacement(tensionless(task.body), task.nodes, task.displacement)[0]


def by_penalty(task: Task, multiple: float) -> np.ndarray:
    """Displacement (N,3) m of all nodes, those to be moved being pulled by a penalty."""
    body = tensionless(task.body)
    return prescribed_displacement(body, task.nodes, task.displacement, method="penalty", multiple=multiple)[0]


def penalty(task: Task, multiple: float) -> Anchors:
    """An anchor without length for every node to be moved, whose stiffness is a multiple of the largest entry of K."""
    point = task.body.position[task.nodes] + task.displacement
    return make_anchors(task.nodes, point, multiple * largest_entry(task.body))


def stages(task: Task, multiple: float) -> float:
    """Force evaluations a step of the fish's default method needs, at the fish's own step; 0 takes the penalty away.

    Its stiffness alone decides them, so the nodes are held where they are.
    """
    fish = make_fish()
    thing = ElasticObject(name="fixed fish", body=task.body, length=fish.length, time_step=fish.time_step,
                          control_interval=fish.control_interval)  # fmt: skip
    anchors = penalty(task._replace(displacement=0.0 * task.displacement), multiple) if multiple else None
    world = VACUUM._replace(anchors=anchors)
    tank = Tank(thing, 1, fish.integrator, water=world)
    tank.advance(10)
    assert tank.alive.all(), tank.failure
    return float(tank.counters["force_evaluations"][0]) / 10


def measure(name: str, multiple: float) -> dict:
    """One row: errors of the moved nodes, and of all nodes, as parts of the displacement."""
    task = TASKS[name]()
    found, exact = by_penalty(task, multiple), by_elimination(task)
    length = np.linalg.norm(task.displacement, axis=1).max()
    off = np.linalg.norm(found - exact, axis=1) / length
    return {
        "body": name,
        "penalty": multiple,
        "error_moved_nodes": off[task.nodes].max(),
        "error_all_nodes": off.max(),
        "stages": stages(task, multiple) if name == "fish" and multiple <= MOST else "",
        "stages_without": stages(task, 0.0) if name == "fish" else "",
    }


def draw(rows: list[dict], path: Path) -> None:
    """Error against penalty for both bodies, and the stages that the fish's method needs."""
    plt = pyplot()

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), layout="constrained")
    for name, (label, colour, marker) in BODIES.items():
        line = [row for row in rows if row["body"] == name]
        across, up = [row["penalty"] for row in line], [row["error_moved_nodes"] for row in line]
        left.loglog(across, up, color=colour, marker=marker, markersize=4.5, label=label)
    left.loglog(
        PENALTIES, 0.1 / PENALTIES, color="#999999", linestyle="--", linewidth=0.9, label="proportional to 1/penalty"
    )
    left.set(xlabel="penalty, in largest entries of the stiffness matrix",
             ylabel="error of moved nodes over the displacement",
             title="Static: the error falls as 1/penalty")  # fmt: skip
    left.set_ylim(bottom=1e-17)  # below is the rounding of the positions
    left.legend(frameon=False)
    line = [row for row in rows if row["body"] == "fish" and row["stages"]]
    label, colour, marker = BODIES["fish"]
    right.loglog([row["penalty"] for row in line], [float(row["stages"]) for row in line], color=colour, marker=marker,
                 markersize=4.5, label=f"{label}, penalty")  # fmt: skip
    right.axhline(float(line[0]["stages_without"]), color=colour, linestyle=":", label=f"{label}, elimination")
    right.set(xlabel="penalty, in largest entries of the stiffness matrix", ylabel="force evaluations a step",
              title="In time: an explicit step costs the root of the penalty")  # fmt: skip
    right.legend(frameon=False)
    for panel in (left, right):
        panel.axvline(TEXTBOOK, color="#bbbbbb", linewidth=0.9, zorder=0)
        panel.grid(alpha=0.2)
    save(figure, path)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the chart again from the CSV")
    if not parser.parse_args().draw:
        write_csv(CSV, [measure(name, multiple) for name in TASKS for multiple in PENALTIES], COMMAND)
    rows = read_table(CSV)
    draw(rows, CHART)
    for name in TASKS:
        line = [row for row in rows if row["body"] == name and 1e1 <= row["penalty"] <= 1e8]
        slope = np.polyfit(*np.log([[row[key] for row in line] for key in ("penalty", "error_moved_nodes")]), 1)[0]
        book = next(row for row in line if row["penalty"] == TEXTBOOK)
        print(f"{name}: error {book['error_moved_nodes']:.2g} of the displacement at {TEXTBOOK:g}, slope {slope:.4f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
