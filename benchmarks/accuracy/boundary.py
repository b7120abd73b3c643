"""Prescribed displacements by a penalty against those by elimination: errors and costs.

    python -m benchmarks.accuracy.boundary            table and chart (seconds)
    python -m benchmarks.accuracy.boundary --draw     the chart again

A fish of springs and a bar of tetrahedra are fixed at one end, by elimination, and moved at the other. The penalty is
an anchor without length on every moved node; its size is a multiple of the largest entry of the stiffness matrix.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.common.charts import BLUE, GREY, ORANGE, panels, save
from benchmarks.common.command import measure_and_draw
from benchmarks.common.tables import IMAGES, read_table, write_csv
from fish_env import Tank, make_fish
from fish_env.bodies.mesh import box
from fish_env.physics.body import fix, make_body
from fish_env.physics.conditions import PENALTY, largest_entry
from fish_env.physics.elements import make_tets
from fish_env.physics.fish import ElasticObject
from fish_env.physics.records import Anchors, Body
from fish_env.physics.statics import prescribed_displacement
from fish_env.physics.world import VACUUM, make_anchors

COMMAND = "python -m benchmarks.accuracy.boundary"
PENALTIES = 10.0 ** np.arange(0, 15)
MOST = 1e4  # in time: with 1e5, the default method fails
BODIES = {"fish": ("fish of springs", BLUE, "o"), "bar": ("bar of tetrahedra", ORANGE, "s")}


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
    position, nodes = box(size * np.array(cells), cells)
    body = make_body(position, np.full(len(position), 0.1), [], [], [], [], [],
                     tets=make_tets(position, nodes, 1e5, 0.3))  # fmt: skip
    end = np.flatnonzero(position[:, 0] == position[:, 0].max())
    return Task(fix(body, position[:, 0] == 0.0), end, np.tile([0.01, 0.02, 0.0], (end.size, 1)))


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


def penalty(task: Task, multiple: float = PENALTY) -> Anchors:
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
    tank = Tank(thing, 1, fish.integrator, water=VACUUM._replace(anchors=anchors))
    tank.advance(10)
    assert tank.alive.all(), tank.failure
    return float(tank.counters["force_evaluations"][0]) / 10


def compare(name: str, multiple: float) -> dict:
    """A row: errors of the moved nodes, and of all nodes, as parts of the displacement; force evaluations a step."""
    task = TASKS[name]()
    length = np.linalg.norm(task.displacement, axis=1).max()
    off = np.linalg.norm(by_penalty(task, multiple) - by_elimination(task), axis=1) / length
    return {
        "body": name, "penalty": multiple, "error_moved_nodes": off[task.nodes].max(), "error_all_nodes": off.max(),
        "stages": stages(task, multiple) if name == "fish" and multiple <= MOST else "",
        "stages_without": stages(task, 0.0) if name == "fish" else "",
    }  # fmt: skip


def measure() -> None:
    """Write the table."""
    write_csv("boundary.csv", [compare(name, multiple) for name in TASKS for multiple in PENALTIES], COMMAND)


def draw() -> None:
    """Draw error against penalty for both bodies, and the stages that the fish's method needs."""
    rows = read_table("boundary.csv")
    figure, (left, right) = panels(2, (10.5, 4.2))
    for name, (label, colour, marker) in BODIES.items():
        line = [(row["penalty"], row["error_moved_nodes"]) for row in rows if row["body"] == name]
        left.loglog(*np.transpose(line), color=colour, marker=marker, markersize=4.5, label=label)
    left.loglog(PENALTIES, 0.1 / PENALTIES, color=GREY, linestyle="--", label="proportional to 1/penalty")
    left.set(ylabel="error of moved nodes over the displacement", ylim=(1e-17, None))  # below is rounding
    line = [row for row in rows if row["body"] == "fish" and row["stages"]]
    right.loglog([row["penalty"] for row in line], [row["stages"] for row in line], "o-", color=BLUE, markersize=4.5,
                 label="fish of springs, penalty")  # fmt: skip
    right.axhline(line[0]["stages_without"], color=BLUE, linestyle=":", label="fish of springs, elimination")
    right.set(ylabel="force evaluations a step of the default method")
    for panel in (left, right):
        panel.axvline(PENALTY, color="#bbbbbb", linewidth=0.9, zorder=0)
        panel.set(xlabel="penalty, in largest entries of the stiffness matrix")
        panel.legend(frameon=False)
    save(figure, IMAGES / "boundary.svg")


def main() -> None:
    """The command line."""
    measure_and_draw(__doc__, measure, draw)


if __name__ == "__main__":
    main()
