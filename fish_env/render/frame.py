"""Frame: all that a picture may know of one fish. Draw it from an environment, or from a log with `_replace`."""

from typing import NamedTuple

import numpy as np

from fish_env.tasks import TASKS

FAR, FURTHEST = 20.0, 1e9  # body lengths, from the fish and from the origin


class Frame(NamedTuple):
    """One fish at one moment. N landmarks, F faces, M muscles, K past places, C commands, S spheres."""

    position: np.ndarray  # (N,3) m
    rest: np.ndarray  # (N,3) positions at rest, m: nose towards +x, left +y, up +z
    faces: np.ndarray  # (F,4) corners, all the same way round; a triangle gives its third node twice
    muscles: np.ndarray  # (M,2) the two nodes of each muscle
    contraction: np.ndarray  # (M,) 0 natural, 1 full
    length: float  # nose to tail tip, m
    path: np.ndarray  # (K,3) or (K,2) centres of mass so far, m, the present one last; K may be 0
    commands: np.ndarray  # (C,3) commands of the fish, world vectors of any length; C may be 0
    time: float  # s
    speed: float  # of the centre of mass, body lengths per second
    caption: str = ""  # a short remark
    task: str = ""  # name of the task
    spheres: np.ndarray = np.zeros((0, 4))  # (S,4) what else is in the water: centres, m, and radii, body lengths
    touchable: bool = False  # whether the spheres are targets, to be touched, or obstacles


def task_name(task) -> str:
    """The name of a task: its key in TASKS, or of what class it is."""
    return next((name for name, kind in TASKS.items() if type(task) is kind), type(task).__name__)


def make_frame(env, i: int = 0, path: np.ndarray | None = None) -> Frame:
    """The frame of fish i of a `FishVectorEnv`; path is (K,3) m, or None for only the place it is at."""
    tank, pose = env.tank, env._pose
    fish = tank.fish
    spheres = getattr(env.task, "spheres", None)
    return Frame(
        position=fish.points(tank.position[i]),
        rest=fish.points(fish.body.position),
        faces=fish.landmarks.faces,
        muscles=fish.landmarks.muscles,
        contraction=np.clip(tank.contraction[i], 0.0, 1.0),
        length=fish.length,
        path=pose.centre[i : i + 1].copy() if path is None else np.asarray(path, dtype=float),
        # a task's further vectors are observations, not directions to swim in
        commands=env._vectors[i, :1].copy(),
        time=float(tank.time[i]),
        speed=float(np.linalg.norm(pose.velocity[i]) / fish.length),
        caption=str(tank.failure[i]).partition(":")[0] if env.picture["panel"] else "",
        task=task_name(env.task),
        spheres=np.zeros((0, 4)) if spheres is None else spheres(i),
        touchable=getattr(env.task, "touchable", False),
    )


def clip_positions(frame: Frame) -> Frame:
    """The frame with places far off drawn nearer, and zero for what is no number: painters work in whole pixels.

    A node further than FAR from the fish is off the picture there, too; a fish is at most FURTHEST away.
    """
    reach = FURTHEST * frame.length
    for name in ("position", "path", "commands", "contraction"):
        numbers = getattr(frame, name)
        if not np.abs(numbers).max(initial=0.0) <= reach:  # nor where one is no number
            frame = frame._replace(**{name: np.clip(np.nan_to_num(numbers), -reach, reach)})
    reach, place = FAR * frame.length, place_of(frame)

    def near(points: np.ndarray) -> np.ndarray:
        middle = place[: points.shape[1]]
        return np.clip(points, middle - reach, middle + reach)

    return frame._replace(position=near(frame.position), path=near(frame.path))


def place_of(frame: Frame) -> np.ndarray:
    """Position of the fish, (3,) m: the last place of its path, or the mean of its nodes."""
    middle = frame.position.mean(axis=0)
    if len(frame.path):
        middle[: frame.path.shape[1]] = frame.path[-1]
    return middle
