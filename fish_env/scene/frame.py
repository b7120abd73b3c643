"""Frame: all that a picture may know of one moment. The window, videos and the laboratory draw it."""

from typing import Any, NamedTuple

import numpy as np

from fish_env.scene.look import PALETTE, Look, look_of
from fish_env.tasks import TASKS

FAR, FURTHEST = 20.0, 1e9  # body lengths, from the fish and from the origin
AHEAD, REACH = 0.56, 0.2  # body lengths: where the arrow of a command begins ahead of the fish, and its length
NOTHING = np.zeros(0)


class Body(NamedTuple):
    """A body of N nodes and M muscles."""

    look: Look
    position: np.ndarray  # (N,3) m, where it is shown
    contraction: np.ndarray = NOTHING  # (M,) 0 natural, 1 full
    tone: np.ndarray = NOTHING  # (N,) strain from -1, shortened, to 1, stretched; (0,) where it is not shown


class Arrow(NamedTuple):
    """A command, or the pull of a pointer."""

    start: np.ndarray  # (3,) m
    way: np.ndarray  # (3,) m
    colour: str = "command"  # a key of PALETTE
    thick: float = 1.0


class Frame(NamedTuple):
    """Bodies and what is around them; lengths in body lengths are those of the first body."""

    bodies: list[Body]
    middle: np.ndarray  # (3,) m, what the camera follows
    arrows: list[Arrow]
    path: np.ndarray = np.zeros((0, 3))  # (K,3) m, places so far, the present one last
    spheres: np.ndarray = np.zeros((0, 4))  # (S,4) targets or obstacles: centres, m, and radii, body lengths
    touchable: bool = False  # whether the spheres are targets, to be touched, or obstacles
    balls: tuple[tuple[np.ndarray, float, str], ...] = ()  # marks: place, m, radius, body lengths, key of PALETTE
    walls: tuple[np.ndarray, ...] = ()  # corners (4,3) m of each
    floor: float = -np.inf  # height, m; -inf: half a body length below the middle
    show: tuple[str, ...] = ("skin",)  # of "skin", "springs", "nodes", "strain"
    time: float = 0.0  # s
    speed: float = 0.0  # of the centre of mass, body lengths per second
    caption: str = ""  # a short remark
    task: str = ""  # name of the task

    @property
    def length(self) -> float:
        """Length of the first body, m."""
        return self.bodies[0].look.length


def task_name(task) -> str:
    """The name of a task: its key in TASKS, or of what class it is."""
    return next((name for name, kind in TASKS.items() if type(task) is kind), type(task).__name__)


def command_arrows(middle, command, length, spheres=(), touchable=False) -> list[Arrow]:
    """The arrow of a command (3,) of any length ahead of a fish; none for a null vector, or from beyond a target."""
    size = float(np.linalg.norm(command))
    away = [np.linalg.norm(sphere[:3] - middle) / length - sphere[3] for sphere in spheres if touchable]
    if not 0.0 < size < np.inf or min(away, default=np.inf) < AHEAD + REACH:
        return []
    way = length / size * np.asarray(command, dtype=float)
    return [Arrow(middle + AHEAD * way, REACH * way)]


def make_frame(env, i: int = 0, path: np.ndarray | None = None, look: Look | None = None) -> Frame:
    """The frame of fish i of a `FishVectorEnv`, with the path (K,3) m to where it is, and a look worked out before."""
    tank, pose, fish = env.tank, env._pose, env.tank.fish
    spheres, touchable = getattr(env.task, "spheres", None), bool(getattr(env.task, "touchable", False))
    balls = np.zeros((0, 4)) if spheres is None else spheres(i)
    middle = pose.centre[i].copy()
    return Frame(
        [Body(look_of(fish) if look is None else look, tank.position[i], np.clip(tank.contraction[i], 0.0, 1.0))],
        middle,
        # a task's further vectors are observations, not directions to swim in
        command_arrows(middle, env._vectors[i, 0], fish.length, balls, touchable) if env._vectors.shape[1] else [],
        path=middle[None] if path is None else np.asarray(path, dtype=float),
        spheres=balls,
        touchable=touchable,
        time=float(tank.time[i]),
        speed=float(np.linalg.norm(pose.velocity[i]) / fish.length),
        caption=str(tank.failure[i]).partition(":")[0] if env.picture["panel"] else "",
        task=task_name(env.task),
    )


def clip_positions(frame: Frame) -> Frame:
    """The frame with places far off drawn nearer, and zero for what is no number: renderers work in whole pixels."""
    # A node further than FAR from the fish is off the picture there, too; a fish is at most FURTHEST away.
    furthest, far = FURTHEST * frame.length, FAR * frame.length
    middle = np.clip(np.nan_to_num(frame.middle), -furthest, furthest)

    def near(points: np.ndarray) -> np.ndarray:
        return np.clip(np.nan_to_num(points), middle - far, middle + far)

    bodies = [
        body._replace(position=near(body.position), contraction=np.clip(np.nan_to_num(body.contraction), 0.0, 1.0))
        for body in frame.bodies
    ]
    arrows = [one._replace(start=near(one.start[None])[0], way=np.nan_to_num(one.way)) for one in frame.arrows]
    return frame._replace(bodies=bodies, middle=middle, arrows=arrows, path=near(frame.path))


def pack_frame(frame: Frame, looks: list[Look]) -> tuple[dict[str, Any], np.ndarray]:
    """A frame for `renderer.js`, in body lengths: what is JSON, and the numbers of the bodies, float32, in one row."""
    # Bodies give the number of their look, and how many nodes, muscles and strains they have.
    scale = 1.0 / frame.length
    floor = frame.middle[2] - 0.5 * frame.length if np.isinf(frame.floor) else frame.floor
    number = {id(look): k for k, look in enumerate(looks)}
    header = {
        "bodies": [[number[id(b.look)], len(b.position), len(b.contraction), len(b.tone)] for b in frame.bodies],
        "middle": (scale * frame.middle).tolist(), "floor": scale * float(floor), "time": frame.time,
        "arrows": [{"from": (scale * a.start).tolist(), "way": (scale * a.way).tolist(), "colour": PALETTE[a.colour],
                    "thick": a.thick} for a in frame.arrows],
        "path": (scale * frame.path[::-1]).round(4).tolist(),
        "spheres": (frame.spheres * (scale, scale, scale, 1.0)).tolist(), "touchable": frame.touchable,
        "balls": [{"at": (scale * at).tolist(), "radius": radius, "colour": PALETTE[colour]}
                  for at, radius, colour in frame.balls],
        "walls": [(scale * wall).tolist() for wall in frame.walls], "show": {name: True for name in frame.show},
    }  # fmt: skip
    parts = [part.ravel() for b in frame.bodies for part in (scale * b.position, b.contraction, b.tone)]
    return header, np.nan_to_num(np.concatenate(parts), nan=0.0, posinf=0.0, neginf=0.0).astype("<f4")
