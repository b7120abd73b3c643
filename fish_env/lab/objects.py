"""Objects that a pointer pulls, up to three side by side, under settings that may change while they move."""

import inspect
import time
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import BODIES, fitted
from fish_env.control.gait import best_gait
from fish_env.lab.scene import Control, Scene
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import INTEGRATORS
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import own_step
from fish_env.scene.frame import NOTHING, Arrow, Frame
from fish_env.scene.frame import Body as ShownBody
from fish_env.scene.look import look_of
from fish_env.soft.changes import change_body, change_world
from fish_env.soft.distorted import distort
from fish_env.soft.objects import OBJECTS
from fish_env.soft.room import GRAVITY, room

KINDS: dict[str, Any] = {**OBJECTS, **BODIES}
MOTIONS = ("rest", "gait", "abrupt turns")
"""Motions of a fish: none, the best gait of its water, all muscles of one side and then the other."""
WALLS = ("own", "none", "closed room")  # the walls that the object comes with, none, or walls on all sides
PULL, DAMPING = 0.4, 0.05  # drag spring: pull over weight at a distance of one length; damping over stiffness, s
MOST_NODES = 1100  # of an object that is simulated in real time
REPEATS, STEPS = 10, 16  # of the measurement of a cost: calls, and steps a call
RIGHT, LEFT, REPEATED = 0.2, 0.3, 1.6  # s of the abrupt turns, and after which they begin again
ROOM = 1.5  # half the width of a closed room, in lengths of an object that has no walls of its own
SCALE = 0.3  # strain at the ends of the colour scale
MOST_OBJECTS = 3
FINEST = {"level": 4, "layers": 2, "nodes": 64, "slices": 24, "stacks": 16, "cells": 18, "across": 6}
"""Largest whole numbers that an object is made with; cells of what has as many in all directions are 9 at most."""
MANY = 600  # nodes of an object that one processor does not move in real time by steps of its own
LONGER, DRIVEN = 4.0, 2.0  # times its own: the step of such an object, and of such a fish, if its method is stabilised
TURNS = {
    (0.0, 0.0, -1.0): np.eye(3),
    (0.0, -1.0, 0.0): np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)]),
    (1.0, 0.0, 0.0): np.array([(0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)]),
}
"""Rotations that show upright what falls in a direction."""
SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
DISTORTED = (
    ("twisted", "Twist", "at rest, turned by half a turn from end to end"),
    ("inverted", "Invert", "at rest, turned inside out"),
)
DEFAULT, NONE = "its own", "none"


class Entry(NamedTuple):
    """Choice of an object."""

    kind: str  # a key of KINDS
    integrator: str = ""  # a key of INTEGRATORS; "" for the object's own
    resolution: tuple[tuple[str, int], ...] = ()  # whole numbers that it is made with, such as ("level", 2)
    water: str = ""  # of a fish: "drag" or "reactive", which it is calibrated for; "" for the default


class Setting(NamedTuple):
    """A setting of all objects, which may change while they move: a switch, a choice or a slider by its default."""

    group: str
    label: str
    default: bool | str | float
    low: float = 0.0
    high: float = 0.0
    help: str = ""
    options: tuple[str, ...] = ()


SETTINGS: dict[str, Setting] = {
    "motion": Setting("Act", "The fish", "rest", options=MOTIONS),
    "strength": Setting("Act", "Strength of a drag", 1.0, 0.1, 20.0),
    "same_cost": Setting("Objects", "Steps of the same cost", False, help="a second costs as much of the processor"),
    "stiffness": Setting("Body", "stiffness", 1.0, 0.05, 5.0, "of springs, tetrahedra and gas, over the object's own"),
    "damping": Setting("Body", "damping", 1.0, 0.0, 5.0, "of all springs and tetrahedra, over the object's own"),
    "pressure": Setting("Body", "pressure", 1.0, 0.0, 3.0, "of the gas, over the object's own; 0 for none"),
    "density": Setting("Body", "density", 1.0, 0.05, 5.0, "mass of all nodes, over the object's own"),
    "inner_density": Setting("Body", "inner density", 1.0, 0.05, 5.0, "mass of the inner layer, over its own"),
    "gravity": Setting("Surroundings", "gravity (m/s2)", 0.0, -20.0, 20.0, "downward"),
    "restitution": Setting("Surroundings", "restitution", 0.5, 0.0, 1.0, "part of a node's speed that a wall leaves"),
    "walls": Setting("Surroundings", "Walls", "own", options=WALLS),
    "step": Setting("Method", "step", 1.0, 0.1, 50.0, "over the method's own step"),
}


class SimulatedObject:
    """An object that moves, and actions on it; ValueError for too many nodes, or a method that cannot move it there."""

    def __init__(self, entry: Entry, settings: dict[str, Any]):
        given = {"water": entry.water} if entry.water else {}
        self.entry, self.original = entry, KINDS[entry.kind].make(**dict(entry.resolution), **given)
        nodes = len(self.original.body.mass)
        if nodes > MOST_NODES:
            raise ValueError(f"{entry.kind} would have {nodes} nodes, of at most {MOST_NODES}; give smaller numbers")
        self.look, self.length = look_of(self.original), self.original.length
        self.is_fish = self.original.num_muscles > 0
        self.faces = self.original.landmarks.faces if self.is_fish else self.original.skin
        self.down = np.asarray(getattr(self.original, "down", (0.0, 0.0, -1.0)), dtype=float)
        planes = self.original.water.planes
        self.room = ROOM * self.length if planes is None else float(-planes[:, 3].min())
        """Distance of the walls from the origin, m."""
        self._first_energy = 0.0
        self._make(settings, settings["step"])

    def _make(self, settings: dict[str, Any], step: float) -> None:
        """Make the tank, with a step over the method's own, other gravity and walls."""
        self.settings, self.step, own = settings, step, self.original.water
        closed = room(self.down, self.room, closed=True).planes
        planes = {"own": own.planes, "none": None, "closed room": closed}[settings["walls"]]
        part = None if planes is None else settings["restitution"]
        world = change_world(own._replace(planes=planes), settings["gravity"] * self.down, part)
        factors = [settings[name] for name in ("stiffness", "damping", "density")]
        factors.append(settings["inner_density"] if len(getattr(self.original, "inner", ())) else 1.0)
        factors.append(settings["pressure"] if self.original.body.compartments is not None else 1.0)
        made = replace(self.original, body=change_body(self.original, *factors))
        name = self.entry.integrator or made.integrator
        self.own_step = own_step(made, INTEGRATORS[name])
        dt = None if step == 1.0 else step * self.own_step
        self.tank: Tank[Any] = Tank(made, integrator=name, dt=dt, water=world, threads=1)
        self._evaluator = Evaluator(made.body, world)  # without the drag spring, whose energy is not counted

    def changed(self, settings: dict[str, Any], step: float) -> "SimulatedObject":
        """This object in the same motion with other settings; ValueError if that is not possible."""
        other = copy(self)
        other._make(settings, step)
        for new, old in zip(other.tank.state, self.tank.state, strict=True):
            new[...] = old
        other.tank.rest_length[...] = self.tank.rest_length
        return other

    @property
    def position(self) -> np.ndarray:
        """Node positions, (N,3) m."""
        return self.tank.position[0]

    def cost_of_step(self) -> float:
        """Time of a step of its method, s, on a copy."""
        tank, found = self.changed(self.settings, self.step).tank, []
        for _ in range(REPEATS):  # the first one compiles
            tank.reset()
            begin = time.perf_counter()
            tank.advance(STEPS)
            found.append(time.perf_counter() - begin)
        return min(found) / STEPS

    def drag(self, node: int, point) -> None:
        """Pull a node towards a point (3,) m."""
        weight = GRAVITY * float(self.tank.fish.body.mass.sum())
        stiffness = self.settings["strength"] * weight / (PULL * self.length)
        self.tank.grab(node, point, stiffness, DAMPING * stiffness)

    def reset(self, velocity=(0.0, 0.0, 0.0), position: np.ndarray | None = None) -> None:
        """Start again with a velocity (3,) m/s at positions (N,3) m, or in the middle of the room."""
        self.tank.reset()
        self.tank.velocity[0] = np.where(self.tank.fish.body.inverse_mass > 0.0, velocity, 0.0)
        if position is not None:
            self.tank.position[0] = position
        self._first_energy += self.energies()[1]

    def advance(self, until: float) -> None:
        """Move on by whole steps to a time, s, or to just before it."""
        now, motion = self.tank.time[0], self.settings["motion"]
        steps = int((until - now) / self.tank.dt + 1e-6)
        if steps < 1 or not self.tank.alive[0]:
            return
        if motion != "rest" and self.is_fish:
            then = now + steps * self.tank.dt
            since = then % REPEATED
            side = -1.0 if since < RIGHT else 1.0 if since < RIGHT + LEFT else 0.0
            turn = np.where(self.original.sides == side, 1.0, 0.0)
            gait = best_gait(fitted.level_of(self.original.water))
            contraction = gait.contraction(self.original, then) if motion == "gait" else turn
            self.tank.command(contraction[None], steps * self.tank.dt)
        self.tank.advance(steps)

    def energies(self) -> tuple[float, float]:
        """Energy of motion, without that of the water's inertia, and the whole energy over that at the start, J."""
        found = self._evaluator.energies(self.tank.rest_length[0], self.position, self.tank.velocity[0])
        return found["kinetic"], sum(found.values()) - self._first_energy

    def volume(self) -> float:
        """Volume inside the outer surface over that at rest; of a ring its area."""
        now, rest = (self.look.marks(x) for x in (self.position, self.original.body.position))
        return signed_volume(now, self.faces) / signed_volume(rest, self.faces)

    def strains(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (K,n) of tetrahedra or else springs, and their strains (K,)."""
        # That of a tetrahedron is the principal stretch that differs most from 1, less 1.
        body, x = self.tank.fish.body, self.position
        if body.tets is None:
            nodes = body.springs.nodes
            return nodes, np.linalg.norm(x[nodes[:, 1]] - x[nodes[:, 0]], axis=1) / self.tank.rest_length[0] - 1.0
        nodes = body.tets.nodes
        gradient = np.matmul(body.tets.gradient[:, 1:].transpose(0, 2, 1), x[nodes[:, 1:]] - x[nodes[:, :1]])
        stretch = np.linalg.svd(gradient, compute_uv=False) - 1.0
        high, low = stretch[:, 0], stretch[:, -1]
        return nodes, np.where(np.abs(high) >= np.abs(low), high, low)

    def largest_strain(self) -> tuple[float, int]:
        """The largest strain by magnitude, and a node of that element."""
        nodes, strain = self.strains()
        size = np.abs(np.nan_to_num(strain))
        return float(size.max()), int(nodes[size.argmax(), 0])

    def tone(self) -> np.ndarray:
        """Mean strain at every node (N,), from -1, shortened, to 1, stretched, on a scale of roots."""
        # So a strain of one percent is visible next to one of thirty, at the end of the scale.
        nodes, strain = self.strains()
        count = np.bincount(nodes.ravel(), minlength=len(self.position))
        total = np.bincount(nodes.ravel(), np.repeat(strain, nodes.shape[1]), minlength=len(self.position))
        mean = np.clip(np.nan_to_num(total / np.maximum(count, 1)), -SCALE, SCALE)
        return np.sign(mean) * np.sqrt(np.abs(mean) / SCALE)


def signed_volume(x: np.ndarray, faces: np.ndarray) -> float:
    """Volume inside faces (Q,4) or (Q,3) of points x (N,3), m3; area inside edges (Q,2) of a ring, m2."""
    if faces.shape[1] == 2:
        p, q = x[faces.T]
        return 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    a, b, c, d = x[faces[:, [0, 1, 2, -1]].T] - x[faces[0, 0]]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) + np.einsum("ij,ij->", a, np.cross(c, d))) / 6.0


class ObjectScene(Scene):
    """One to three objects that are looked at and touched, under the same conditions: SETTINGS, or those given."""

    def __init__(self, entries: Sequence[Entry], title="", hint="", **settings):
        self.title, self.hint = title, hint
        self.settings: dict[str, Any] = {name: setting.default for name, setting in SETTINGS.items()} | settings
        self.show = {"skin": True, "springs": False, "nodes": False, "strain": False}
        self.choose(entries)

    def choose(self, entries: Sequence[Entry]) -> None:
        """Show other objects, at rest; ValueError, and the scene is as before, for too many nodes."""
        defaults: dict[str, Any] = {name: setting.default for name, setting in SETTINGS.items()}
        objects = [SimulatedObject(entry, defaults) for entry in entries]
        first, gravity = objects[0], objects[0].original.water.gravity
        if gravity is not None:
            defaults["gravity"] = round(float(np.linalg.norm(gravity)), 6)
        methods = {each.tank.integrator.kind for each in objects}
        if max(len(each.position) for each in objects) > MANY and methods == {"stabilised"}:
            defaults["step"] = DRIVEN if any(each.is_fish for each in objects) else LONGER
        kept = {name: self.settings[name] for name, each in SETTINGS.items() if each.group in ("Act", "Objects")}
        self.objects = with_settings(objects, defaults | kept)
        self.defaults, self.settings, self.dragged = defaults, defaults | kept, None
        self.looks = [each.look for each in objects]
        self._turn, self.upright = TURNS[tuple(first.down.tolist())], bool(first.down[2] == 0.0)
        room = max(each.length if each.is_fish else 2.2 * each.room for each in objects)
        self.spacing = 0.9 * room if first.is_fish else room
        self.yaw, self.pitch = (-np.pi / 2, 0.12) if self.upright else (-2.0, 0.45)
        names = names_of(objects)
        self.labels = names if len(objects) > 1 else ()
        self.plots = {"energy since the start (J)": names, "largest strain": names}
        if all(len(each.faces) for each in objects):
            self.plots["volume over rest"] = names
        work = ["muscles' work"] if first.is_fish else []
        self.plots["energy of the first (J)"] = ["motion", "stored", *work, "lost"]
        if len(objects) > 1:
            self.plots["distance from the first (BL)"] = names[1:]
        self.reset()

    def set(self, name: str, value: Any) -> None:
        """Change one of SETTINGS while the objects move; ValueError, and nothing has changed, if that is impossible."""
        # After a failure they start again.
        settings = self.settings | {name: value}
        self.objects, self.settings, self.dragged = with_settings(self.objects, settings), settings, None
        if self.failure:
            self.reset()

    def reset(self, velocity=(0.0, 0.0, 0.0), how: str = "") -> None:
        """Start again at rest, with a velocity (3,) m/s, or twisted or inverted: `how`, one of DISTORTIONS."""
        positions = [distort(each.original, how) if how else None for each in self.objects]
        self.let_go()
        for each, position in zip(self.objects, positions, strict=True):
            each.reset(velocity, position)
        self.time, self.failure, self.failed = 0.0, "", (-1, -1)

    def throw(self) -> None:
        """Start again with a velocity obliquely upward, five lengths of the object a second."""
        up, along = -self.objects[0].down, np.array([1.0, 0.0, 0.0])
        self.reset(self.length * (5.0 * along + 8.0 * up * (abs(up @ along) < 0.5)))

    def advance(self, seconds: float) -> None:
        """Move on by a part of a second."""
        self.time += seconds
        for number, each in enumerate(self.objects):
            each.advance(self.time)
            if not each.tank.alive[0] and not self.failure:
                method, name, when = each.tank.integrator.name, each.original.name, each.tank.time[0]
                why = f"{each.tank.failure[0]} (step {1e3 * each.tank.dt:.3g} ms)"
                self.failure = f"{method} failed on the {name} after {when:.2f} s: {why}"
                self.failed = (number, each.largest_strain()[1])

    def step(self) -> None:
        """Move on by one step of the first object."""
        self.advance(self.objects[0].tank.dt)

    def distance_of(self, number: int) -> float:
        """Distance of an object from the first one, in lengths of the first."""
        # Root mean square over landmarks of fish or over as many nodes; of other objects, between the centres of mass.
        first, other = self.objects[0], self.objects[number]
        a, b = (each.look.marks(each.position) for each in (first, other))
        if len(a) != len(b):
            a, b = (np.average(each.position, 0, each.original.body.mass)[None] for each in (first, other))
        return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())) / self.length

    def point(self, phase: str, point: np.ndarray, body: int) -> None:
        """Drag a node of the surface, that of all objects with as many nodes."""
        if phase in ("start", "end"):
            self.let_go()
        if phase == "start" and body >= 0:
            first = self.objects[body]
            place = (point - self._offset(body)) @ self._turn
            self.dragged = body, first.tank.nearest(place, getattr(first.original, "outer", None))
        if phase in ("start", "move") and self.dragged is not None:
            number, node = self.dragged
            self._point = (point - self._offset(number)) @ self._turn
            for each in self.objects:
                if len(each.position) == len(self.objects[number].position):
                    each.drag(node, self._point)

    def let_go(self) -> None:
        """End a drag."""
        for each in self.objects if self.dragged is not None else []:
            each.tank.release()
        self.dragged = None

    def _offset(self, number: int) -> np.ndarray:
        """Offset (3,) m at which object `number` is shown: side by side, fish across their way."""
        place = (number - 0.5 * (len(self.objects) - 1)) * self.spacing
        return np.array([0.0, -place, 0.0] if self.objects[0].is_fish else [place, 0.0, 0.0])

    def frame(self) -> Frame:
        """Every object, a drag and walls; the camera follows fish, or sees the lower half of a room."""
        bodies, arrows, balls, walls = [], [], (), []
        for k, each in enumerate(self.objects):
            x = each.position @ self._turn.T + self._offset(k)
            tone = each.tone() if self.show["strain"] or self.show["springs"] else NOTHING
            bodies.append(ShownBody(each.look, x, np.clip(each.tank.contraction[0], 0.0, 1.0), tone))
            if self.dragged is not None and self.dragged[0] == k:
                point, node = self._point @ self._turn.T + self._offset(k), x[self.dragged[1]]
                balls = ((point, 0.035, "pointer"),)
                arrows.append(Arrow(node, point - node, "pointer", 0.5))
            walls += self._walls(k)
        first = self.objects[0]
        middle = np.mean([body.position.mean(axis=0) for body in bodies], axis=0)
        return Frame(
            bodies, middle if first.is_fish else np.array([0.0, 0.0, -0.55 * first.room]), arrows, balls=balls,
            walls=tuple(walls), floor=-0.5 * self.length if first.is_fish else -first.room - 0.002 * self.length,
        )  # fmt: skip

    def _walls(self, number: int) -> list[np.ndarray]:
        """Corners (4,3) m of each wall of an object but its floor, and but those before and behind a ring."""
        planes, sheets = self.objects[number].tank.world.planes, []
        sides = self.objects[number].room * np.diag([1.0, 0.4 if self.upright else 1.0, 1.0])
        for plane in planes if planes is not None else []:
            inward = self._turn @ plane[:3]
            if inward[2] < 0.5 and not (self.upright and abs(inward[1]) > 0.5):
                sheets.append(inward * plane[3] + self._offset(number) + SQUARE @ sides[np.abs(inward) < 0.5])
        return sheets

    def readings(self) -> list[list[float]]:
        """Measurements of every object, in the order of the plots."""
        first, energies = self.objects[0], [each.energies() for each in self.objects]
        found = [[total for _, total in energies], [each.largest_strain()[0] for each in self.objects]]
        if "volume over rest" in self.plots:
            found.append([each.volume() for each in self.objects])
        (motion, total), work = energies[0], [float(first.tank.work[0])] if first.is_fish else []
        found.append([motion, total - motion, *work, sum(work) - total])
        return found + [[self.distance_of(k) for k in range(1, len(self.objects))]] * (len(self.objects) > 1)

    def controls(self) -> list[Control]:
        """Those that apply to the objects."""
        fish = any(each.is_fish for each in self.objects)
        found = [] if fish else [Control("button", "throw", "Throw", lambda _: self.throw(), key="t")]
        for how, label, text in DISTORTED:
            with suppress(ValueError):  # of objects in a plane, and of springs that are at rest inside out too
                _ = [distort(each.original, how) for each in self.objects]
                found.append(Control("button", how, label, lambda _, how=how: self.reset(how=how), help=text))
        if self.failure:
            half = max(0.5 * self.settings["step"], SETTINGS["step"].low)
            found.append(Control("button", "halve", "Halve the step", lambda _: self.set("step", half), "Time"))
        for number in range(min(len(self.objects) + 1, MOST_OBJECTS)):
            found += self._choices(number)
        kinds = {bool: "switch", str: "choice", float: "slider"}
        found += [
            Control(kinds[type(each.default)], name, each.label, lambda value, name=name: self.set(name, value),
                    each.group, self.settings[name], self.defaults[name], each.low, each.high,
                    options=list(each.options), help=each.help)
            for name, each in SETTINGS.items() if self._applies(name)
        ]  # fmt: skip
        return found + super().controls()

    def _applies(self, name: str) -> bool:
        """Return True if a setting changes anything in the scene."""
        objects, walls = [each.original for each in self.objects], self.settings["walls"]
        return {
            "motion": any(each.is_fish for each in self.objects), "same_cost": len(objects) > 1,
            "pressure": any(each.body.compartments is not None for each in objects),
            "inner_density": any(len(getattr(each, "inner", ())) for each in objects),
            "restitution": walls == "closed room" or (walls == "own" and objects[0].water.planes is not None),
            "walls": all(each.water.added_mass is None for each in objects),  # water with inertia has no walls
        }.get(name, True)  # fmt: skip

    def _choices(self, number: int) -> list[Control]:
        """The controls that choose an object, its method and its resolution; of one that is not there, the first."""
        entries = [each.entry for each in self.objects]
        entry = entries[number] if number < len(entries) else None

        def change(new: Entry | None) -> None:
            self.choose([*entries[:number], *([] if new is None else [new, *entries[number + 1 :]])])

        label, kinds = f"The {('first', 'second', 'third')[number]}", [*([NONE] * (number > 0)), *KINDS]
        found = [
            Control("choice", f"object {number}", label, lambda kind: change(None if kind == NONE else Entry(kind)),
                    "Objects", entry.kind if entry else NONE, options=kinds)
        ]  # fmt: skip
        if entry is None:
            return found
        found.append(
            Control("choice", f"integrator {number}", "  its method",
                    lambda name: change(entry._replace(integrator="" if name == DEFAULT else name)), "Objects",
                    entry.integrator or DEFAULT, DEFAULT, options=[DEFAULT, *INTEGRATORS])
        )  # fmt: skip
        parameters = inspect.signature(KINDS[entry.kind].make).parameters.values()
        for name, default in ((each.name, each.default) for each in parameters if type(each.default) is int):
            others = [pair for pair in entry.resolution if pair[0] != name]
            words = "cells across" if name == "across" else name
            found.append(
                Control("slider", f"{name} {number}", f"  its {words}", lambda value, name=name, others=others: change(
                        entry._replace(resolution=(*others, (name, int(value))))), "Objects",
                        dict(entry.resolution).get(name, default), default, 0,
                        9 if entry.kind in ("block", "ball") else FINEST.get(name, 24), 1)
            )  # fmt: skip
        return found


def names_of(objects: Sequence[SimulatedObject]) -> list[str]:
    """A number for each object, and what of kind, method, water and resolution is not the same in all."""
    parts = [
        (each.original.name, each.tank.integrator.name, each.entry.water and f"water: {each.entry.water}",
         " ".join(f"{name} {value}" for name, value in each.entry.resolution))
        for each in objects
    ]  # fmt: skip
    differ = [k for k in range(len(parts[0])) if len({row[k] for row in parts}) > 1]
    names = [", ".join(row[k] for k in differ if row[k]) or row[0] for row in parts]
    return [f"{number}. {name}" for number, name in enumerate(names, 1)]


def with_settings(objects: list[SimulatedObject], settings: dict[str, Any]) -> list[SimulatedObject]:
    """The objects in the same motion with other settings, and steps of the same cost if these say so."""
    first, *others = (each.changed(settings, settings["step"]) for each in objects)
    if settings["same_cost"] and others:
        budget = first.cost_of_step() / first.tank.dt
        others = [each.changed(settings, each.cost_of_step() / budget / each.own_step) for each in others]
    return [first, *others]
