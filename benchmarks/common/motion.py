"""What a body makes of commands, and how far two bodies' motions are apart.

S scenes, K control intervals, M muscles.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.common.measures import pose_of
from fish_env import Fish, Tank
from fish_env.bodies import mass_spring as tu
from fish_env.control import scripted
from fish_env.envs import FishVectorEnv
from fish_env.soft.volume import volume_of

SECONDS = 3.0  # of a scene
SETTLED = 1.0  # s at the start that no mean is taken over


class Motion(NamedTuple):
    """What a body made of scenes."""

    centre: np.ndarray  # (S,K,3) body lengths, of the centre of mass; relative to the start
    yaw: np.ndarray  # (S,K) rad, unwrapped, since the start
    tail: np.ndarray  # (S,K) body lengths, of the tail tip from the line of best fit, sideways
    volume: np.ndarray  # (S,K) inside the surface of the landmarks, over that at rest; ones if it was not asked for
    failure: list[str]
    kept: np.ndarray | None = None  # (S,4) least part of its area that a section between square layers kept


def record(task: str, seeds: int, first_seed: int, water: str | None = None) -> np.ndarray:
    """Contractions (S,K,M) commanded by the motor controllers in a task, on the default fish: a scene for each seed."""
    env = FishVectorEnv(seeds, task=task, water=water, max_episode_steps=10_000)
    control = scripted(env)
    obs, _ = env.reset(seed=first_seed)
    steps, found = round(SECONDS / env.control_interval), []
    for k in range(steps):
        obs, *_ = env.step(control(obs, k * env.control_interval))
        found.append(env._contraction.copy())
    env.close()
    return np.array(found).transpose(1, 0, 2)


LEFT, RIGHT = (np.array([layer[k] for layer in tu.LAYERS[1:6]]) for k in (0, 1))  # upper nodes of the layers
BELOW = tu.LAYERS[1][3] - tu.LAYERS[1][0]  # from an upper node on the left to the one below it


def areas(points: np.ndarray) -> np.ndarray:
    """Areas (B,4) of the sections between the square layers, from above, of landmarks (B,23,3); negative: inverted."""
    left, right = points[:, LEFT], points[:, RIGHT]
    up = left - points[:, LEFT + BELOW]
    up = up[:, 1:] + up[:, :-1]
    across = np.cross(left[:, :-1] - right[:, 1:], left[:, 1:] - right[:, :-1])
    return 0.5 * (across * up).sum(axis=2) / np.linalg.norm(up, axis=2)


def play(fish: Fish, contractions: np.ndarray, dt=None, volumes=False, threads=1) -> Motion:
    """Play contractions (S,K,M), a control interval each, to fish of one kind that start at rest, heading along x."""
    seeds, steps, _ = contractions.shape
    tank = Tank(fish, seeds, dt=dt, water=fish.water, threads=threads)
    substeps, faces = round(fish.control_interval / tank.dt), fish.landmarks.faces
    natural = volume_of(faces, fish.points(fish.body.position))[0]
    centre, yaw, tail, volume = [], [], [], []
    area = areas(fish.points(fish.body.position[None]))
    kept = np.ones((seeds, area.shape[1]))
    for k in range(steps):
        tank.drive(contractions[:, k], substeps)
        pose = pose_of(tank)
        centre.append(pose.centre / fish.length)
        yaw.append(np.arctan2(pose.axes[:, 0, 1], pose.axes[:, 0, 0]))
        tips = tank.position[:, fish.tail].mean(axis=1) - pose.centre
        tail.append((tips * pose.axes[:, 1]).sum(axis=1) / fish.length)
        kept = np.minimum(kept, areas(fish.points(tank.position)) / area)
        volume.append(
            [volume_of(faces, points)[0] / natural for points in fish.points(tank.position)]
            if volumes
            else np.ones(seeds)
        )
    tank.close()
    start = fish.body.mass @ fish.body.position / fish.body.mass.sum() / fish.length
    return Motion(
        np.array(centre).transpose(1, 0, 2) - start, np.unwrap(np.array(yaw).T), np.array(tail).T, np.array(volume).T,
        tank.failure.tolist(), kept,
    )  # fmt: skip


FAILED = 2.0  # residual of what is not finite, and the largest there is


def residuals(found: Motion, finest: Motion, interval: float) -> np.ndarray:
    """What least squares are taken of so that `errors` are small, (S,2+3K): a quarter of a row's squares is all^2.

    Speed and sweep have their relative errors, heading and path one for every control interval, with its sign. The
    heading counts by its root mean square here, and by its mean in `errors`.
    """
    late, root = slice(round(SETTLED / interval), None), np.sqrt(found.yaw.shape[1])
    speed, wanted = (_speed(m, late, interval) for m in (found, finest))
    way = np.linalg.norm(np.diff(finest.centre, axis=1), axis=2).cumsum(axis=1).mean(axis=1)
    turned = np.maximum(np.abs(finest.yaw).max(axis=1), np.pi / 2)
    apart = (found.centre - finest.centre)[:, :, :2] / way[:, None, None] / root
    rows = [
        (speed / wanted - 1.0)[:, None],
        (found.tail[:, late].std(axis=1) / finest.tail[:, late].std(axis=1) - 1.0)[:, None],
        (found.yaw - finest.yaw) / turned[:, None] / root,
        apart[:, :, 0],
        apart[:, :, 1],
    ]
    return np.clip(np.nan_to_num(np.concatenate(rows, axis=1), nan=FAILED), -FAILED, FAILED)


def _speed(motion: Motion, late: slice, interval: float) -> np.ndarray:
    """Mean speed (S,) body lengths/s of the centre along its path."""
    return np.linalg.norm(np.diff(motion.centre[:, late], axis=1), axis=2).mean(axis=1) / interval


def errors(found: Motion, finest: Motion, interval: float) -> dict[str, np.ndarray]:
    """How far a motion is from the finest body's, (S,) of each quantity, 1 being all of it.

    speed: mean after SETTLED seconds. turn: heading over time, over the largest turn of the finest body, at least a
    quarter turn. path: distance between the centres, over the way swum, both meant over time. sweep: standard deviation
    of the tail tip. volume: largest change, absolute. all: root mean square of the first four. "finest" may be any
    motion.
    """
    late = slice(round(SETTLED / interval), None)

    apart = np.linalg.norm(found.centre - finest.centre, axis=2)
    way = np.linalg.norm(np.diff(finest.centre, axis=1), axis=2).cumsum(axis=1)
    turned = np.maximum(np.abs(finest.yaw).max(axis=1), np.pi / 2)
    sweep, wanted = found.tail[:, late].std(axis=1), finest.tail[:, late].std(axis=1)
    change = [np.abs(m.volume - 1.0).max(axis=1) for m in (found, finest)]
    off = {
        "speed": np.abs(_speed(found, late, interval) / _speed(finest, late, interval) - 1.0),
        "turn": np.abs(found.yaw - finest.yaw).mean(axis=1) / turned,
        "path": apart[:, 1:].mean(axis=1) / way.mean(axis=1),
        "sweep": np.abs(sweep / wanted - 1.0),
        "volume": np.abs(change[0] - change[1]),
    }
    four = [off[name] ** 2 for name in ("speed", "turn", "path", "sweep")]
    return off | {"all": np.sqrt(np.mean(four, axis=0))}
