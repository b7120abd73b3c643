"""Scenes of the elastic objects (Song 2009, ch. 7): dropped, thrown, dragged by a mouse; what is watched in them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fish_env import Tank
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.soft.objects import GRAVITY, room
from fish_env.soft.room import InRoom

FRAME = 1 / 60  # s between pictures; the mouse moves as often
NUDGE = 1e-9  # of the object's length
DRAG_SPRING = (60.0, 0.5, 0.05)  # N/m, N s/m, m
GRAB, LET_GO, PULL = 0.5, 1.2, 0.5  # s, s; how far the mouse moves, m a second


@dataclass(frozen=True)
class Scene:
    """How an object starts, in what room, and whether the drag spring pulls it."""

    name: str
    restitution: float
    sideways: float  # m/s along x at the start
    hand: bool
    seconds: float


SCENES = {
    "dropped": Scene("dropped", 1.0, 0.0, False, 2.0),
    "thrown": Scene("thrown", 0.5, 2.5, False, 2.0),
    "dragged": Scene("dragged", 0.5, 0.0, True, 2.5),
}
"""Dropped on a floor that reflects; thrown at a wall, walls and floor damp; dragged by the mouse and let go."""


class Moment(NamedTuple):
    """What a step ended with."""

    energy: float  # of all kinds, J
    work: float  # that the drag spring has done so far, J
    depth: float  # of the node furthest behind a plane, m; negative while none is
    travel: float  # the furthest any node has moved in a step so far, m
    position: np.ndarray  # (N,3) m


def stage(thing: InRoom, scene: Scene, integrator: str | None = None, dt: float | None = None, seed=None) -> Tank:
    """A tank with the object at the start of a scene; with a seed, each node is displaced by NUDGE at random."""
    size = thing.water.planes[0, 3] * -1.0
    tank = Tank(thing, integrator=integrator, dt=dt, water=room(thing.down, size, scene.restitution))
    free = thing.body.inverse_mass > 0
    tank.velocity[0, :, 0] = scene.sideways * free[:, 0]
    if seed is not None:
        tank.position[0] += NUDGE * thing.length * free * np.random.default_rng(seed).normal(size=free.shape)
    return tank


class Energy:
    """The energy of all kinds in a tank, J."""

    def __init__(self, tank: Tank):
        self.tank, self.world, self.evaluator = tank, None, None

    def __call__(self) -> float:
        tank = self.tank
        if self.world is not tank.world:  # the drag spring was attached, or released
            self.world, self.evaluator = tank.world, Evaluator(tank.fish.body, tank.world)
        return sum(self.evaluator.energies(tank.rest_length[0], tank.position[0], tank.velocity[0]).values())


def play(
    thing: InRoom, scene: Scene, integrator: str | None = None, dt: float | None = None, seed: int | None = None
) -> Iterator[Moment]:
    """The scene, a step at a time; the drag spring moves between frames, and its work is the jump of its energy.

    Raises:
        ArithmeticError: if the object fails, with the reason.
    """
    tank = stage(thing, scene, integrator, dt, seed)
    total = Energy(tank)
    each = round(FRAME / tank.dt)
    planes, work, travel, point, node = tank.world.planes, 0.0, 0.0, None, -1
    for k in range(round(scene.seconds / FRAME)):
        time = k * FRAME
        if scene.hand and time >= GRAB - 1e-9:
            before = total()
            if time < LET_GO - 1e-9:
                if point is None:
                    aim = tank.position[0].mean(axis=0) + thing.length * (np.array([1.0, 0, 0]) - thing.down)
                    node = tank.nearest(aim, thing.outer)
                    point = tank.position[0, node].copy()
                point = point + PULL * FRAME * (np.array([0.6, 0.0, 0.0]) - 0.8 * thing.down)
                tank.grab(node, point, *DRAG_SPRING)
            elif point is not None:
                tank.release()
                point = None
            work += total() - before
        for _ in range(each):
            old = tank.position[0].copy()
            tank.advance(1)
            if not tank.alive[0]:
                raise ArithmeticError(f"{thing.name}, {scene.name}: {tank.failure[0]} at {tank.time[0]:.4f} s")
            x = tank.position[0]
            travel = max(travel, float(np.linalg.norm(x - old, axis=1).max()))
            free = thing.body.inverse_mass.any(axis=1)
            depth = float((planes[:, 3, None] - planes[:, :3] @ x[free].T).max())
            yield Moment(total(), work, depth, travel, x.copy())


def outside(thing: InRoom, x) -> int:
    """How many inner nodes are not inside the outer layer at x (N,3): by turns around each, or solid angles."""
    if not len(thing.inner):
        return 0
    inner = x[thing.inner][:, None]
    if thing.skin.shape[1] == 2:
        a, b = (x[thing.skin[:, k]][None] - inner for k in range(2))
        angle = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=2))
        return int(np.sum(np.round(angle.sum(axis=1) / (2 * np.pi)) != 1))
    triangles = np.concatenate([thing.skin[:, [0, 1, 2]], thing.skin[:, [0, 2, 3]]])
    triangles = triangles[triangles[:, 1] != triangles[:, 2]]
    a, b, c = (x[triangles[:, k]][None] - inner for k in range(3))
    p, q, r = (np.linalg.norm(edge, axis=2) for edge in (a, b, c))
    triple = (a * np.cross(b, c)).sum(axis=2)
    beside = p * q * r + (a * b).sum(axis=2) * r + (b * c).sum(axis=2) * p + (c * a).sum(axis=2) * q
    angle = 2.0 * np.arctan2(triple, beside)  # Van Oosterom & Strackee 1983
    return int(np.sum(np.round(angle.sum(axis=1) / (4 * np.pi)) != 1))


def energy_of_fall(thing: InRoom) -> float:
    """Energy, J, that gravity gives an object until it touches the floor."""
    return float(thing.body.mass.sum() * GRAVITY * (-thing.water.planes[0, 3] - 0.5 * thing.length))


def watched(
    thing: InRoom, scene: Scene, integrator: str | None = None, dt: float | None = None, seed: int | None = None
) -> dict:
    """Energy gained beyond the drag spring's work, depth behind planes, escapes of inner nodes."""
    lowest, growth, depth, escapes = np.inf, 0.0, -np.inf, 0
    for k, now in enumerate(play(thing, scene, integrator, dt, seed)):
        lowest = min(lowest, now.energy - now.work)
        growth, depth = max(growth, now.energy - now.work - lowest), max(depth, now.depth)
        if k % 8 == 0:
            escapes += outside(thing, now.position)
    return {"growth": growth / energy_of_fall(thing), "work": now.work / energy_of_fall(thing),
            "depth_over_travel": depth / now.travel, "escapes": escapes}  # fmt: skip
