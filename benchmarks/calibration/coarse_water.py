"""What coarse faces do to a fish whose solid is fine: the distance to the finest body with the water on other faces.

python -m benchmarks.calibration.coarse_water     table and results/coarse_water.csv (minutes)

The solid is that of tetrahedra at level 2. The water acts on its own faces; on the 24 faces between the landmarks,
which are the default fish's, in the middle of each; or at two points of each, so placed that mean and variance of the
place along the section are exact.
"""

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.calibration.commands import recorded
from benchmarks.calibration.fit import finest_motion
from benchmarks.common.motion import errors, play
from benchmarks.common.tables import write_csv
from fish_env import TASKS, make_fish
from fish_env.bodies import Fish
from fish_env.body import make_body

COMMAND = "python -m benchmarks.calibration.coarse_water"
EACH = 3  # recorded scenes of each task
SHORTER = 5  # times shorter steps, where the water pushes a few light nodes


def two_points(position, faces) -> tuple[np.ndarray, np.ndarray]:
    """Faces (2F,4) and shares (2F,4): each face twice, felt at two points of equal weight along the body."""
    nodes, shares = [], []
    for face in faces:
        x = position[face, 0]
        front = x > 0.5 * (x.max() + x.min())
        ahead, behind = (np.ptp(position[face[side]], axis=0) for side in (front, ~front))
        ahead, behind = np.linalg.norm(ahead), np.linalg.norm(behind)  # the face's extent there, which is its weight
        mean = (ahead + 2.0 * behind) / (3.0 * (ahead + behind))
        square = (ahead + 3.0 * behind) / (6.0 * (ahead + behind))
        for place in mean + np.sqrt(square - mean**2) * np.array([-1.0, 1.0]):
            nodes.append(face)
            shares.append(np.where(front, (1.0 - place) / front.sum(), place / (~front).sum()))
    return np.array(nodes), np.array(shares)


def variants() -> dict[str, Fish]:
    """The same solid with the water on its own faces, and on coarse ones."""
    fish = make_fish("tetrahedral", level=2)
    marks = fish.landmarks
    coarse = np.ascontiguousarray(marks.node[marks.faces])
    middle = np.where(coarse[:, 2:3] == coarse[:, 3:4], [[1 / 3, 1 / 3, 1 / 6, 1 / 6]], 0.25)
    solid, springs = fish.body, fish.body.springs

    def on(nodes, share, drag):
        body = make_body(
            solid.position, solid.mass, springs.nodes, springs.stiffness, springs.damping, springs.rest_length, nodes,
            share=share, drag=np.full(len(nodes), drag), tets=solid.tets,
        )  # fmt: skip
        return replace(fish, body=body, time_step=fish.time_step / SHORTER)

    return {
        "its own faces": fish,
        "24 faces, felt in the middle": on(coarse, middle, 1.0),
        "24 faces, felt at two points": on(*two_points(fish.body.position, coarse), 0.5),
    }


def main() -> None:
    """The command line."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    scenes, rows = recorded()[-1], []
    contractions = scenes.reshape(len(TASKS), -1, *scenes.shape[1:])[:, :EACH].reshape(-1, *scenes.shape[1:])
    finest = finest_motion(contractions)
    tasks = list(TASKS)
    for name, fish in variants().items():
        motion = play(fish, contractions)
        off = errors(motion, finest, fish.control_interval)
        for k, task in enumerate(tasks):
            part = slice(EACH * k, EACH * (k + 1))
            rows.append({"faces": name, "task": task, "failed": sum(map(bool, motion.failure[part]))} | {
                quantity: f"{off[quantity][part].mean():.4g}" for quantity in ("speed", "turn", "path", "sweep", "all")
            })  # fmt: skip
            print(rows[-1], flush=True)
    write_csv("coarse_water.csv", rows, COMMAND)


if __name__ == "__main__":
    main()
