"""The bench: up to three objects side by side, pulled by a hand and measured."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fish_env.bodies import BODIES, Fish
from fish_env.lab.hand import Hand
from fish_env.lab.measures import arrows
from fish_env.lab.settings import BODY, SETTINGS, WALLS
from fish_env.lab.specimen import MOTIONS, Entry, Specimen, cost_of_step, down_of, level_of, room_size
from fish_env.lab.stage import Control, Plot, Pointer, Stage, muscle_names, sliders
from fish_env.physics.integrators import INTEGRATORS
from fish_env.scene.frame import NOTHING, Arrow, Body, Frame
from fish_env.soft.detail import LevelOfDetail
from fish_env.soft.distorted import distort, out_of_shape
from fish_env.soft.objects import OBJECTS

MOST = 3  # objects side by side
FINEST = {"level": 4, "layers": 2, "nodes": 64, "slices": 24, "stacks": 16, "cells": 18, "across": 6}
"""Largest whole numbers that an object is made with; cells of what has as many in all directions are 9 at most."""
MANY = 600  # nodes of an object that one processor does not move in real time by steps of its own
LONGER, DRIVEN = 4.0, 2.0  # times its own: the step of such an object, and of such a fish, if its method is stabilised
SETTLED = 3.0  # s after which what was distorted is to be back in its shape
BACK = 0.3  # of its size: what lies on the floor by its weight is out of shape by up to half of this
UPRIGHT = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
HANGING = np.array([(0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)])
"""Turn what falls along -y, and what hangs along x, upright."""
DETAILED = "uniform sphere"
"""The object whose level of detail its distance from the camera can choose."""
OWN, NONE = "its own", "none"
MEASURES: dict[str, Callable[[Specimen], float]] = {
    "energy since the start (J)": Specimen.gained, "largest strain": Specimen.strain,
    "volume over rest": Specimen.volume,
}  # fmt: skip
"""Plots with a line for each object."""
FLOWS, APART = "energy of the first (J)", "distance from the first (lengths)"
"""Plots of energy flows, and of distances from the first object."""


class Bench(Stage):
    """One to three objects that are looked at and touched, all under the same conditions.

    Args:
        entries: the objects.
        title, hint: of the scene.
        motion: what fish do, one of MOTIONS.
        same_cost: whether the others take steps that cost as much as the first one's.
    """

    def __init__(self, entries: Sequence[Entry] = (Entry("uniform sphere"),), title="Soft objects", hint="",
                 motion="rest", same_cost=False):  # fmt: skip
        self.title, self.hint, self.motion = title, hint, motion
        self.same_cost, self.strength, self.fixing = bool(same_cost), 1.0, False
        self.show = {"skin": True, "springs": False, "nodes": False, "strain": False, "forces": False}
        self.hand: Hand | None = None
        self.by_distance, self.version = False, 0
        self.choose(entries)

    def choose(self, entries: Sequence[Entry]) -> None:
        """Put other objects on the bench, at rest; ValueError, and the bench is as before, for too many nodes."""
        numbers = {name: setting.default for name, setting in SETTINGS.items()}
        specimens = [Specimen(entry, numbers, "own", 1.0) for entry in entries]
        gravity = specimens[0].thing.water.gravity
        numbers["gravity"] = 0.0 if gravity is None else round(float(np.linalg.norm(gravity)), 6)
        if any(len(each.position) > MANY for each in specimens) and all(
            each.tank.integrator.kind == "stabilised" for each in specimens
        ):
            numbers["step"] = DRIVEN if any(each.is_fish for each in specimens) else LONGER
        self.specimens, self.numbers, self.walls = specimens, numbers, "own"
        self.defaults, self.hand = dict(numbers), None
        self._detail = LevelOfDetail(radius=0.5 * specimens[0].thing.length)
        self.looks, self.upright = [each.look for each in specimens], bool(abs(down_of(specimens[0].thing)[2]) < 0.5)
        self._set_steps()
        self.move(self.motion)
        self._arrange()
        self.reset()
        self.version += 1

    def _arrange(self) -> None:
        """Set camera and plots for what is on the bench."""
        first = self.specimens[0]
        near = 1.9 if first.is_fish else 1.8 * room_size(first.thing) / self.length
        self.distance = near + 0.8 * (len(self.specimens) - 1) * self.spacing / self.length
        self.yaw, self.pitch = (-np.pi / 2, 0.12) if self.upright else (-2.0, 0.45)
        names = [
            f"{k}. {each.thing.name}, {f'water: {each.entry.water}' if each.entry.water else each.method}"
            for k, each in enumerate(self.specimens, 1)
        ]
        solid = all(np.isfinite(each.rest_volume) for each in self.specimens)
        self.plots = [Plot(title, names) for title in MEASURES if solid or title != "volume over rest"]
        self.plots.append(Plot(FLOWS, ["motion", "stored", *(["muscles' work"] if first.is_fish else []), "lost"]))
        if len(self.specimens) > 1:
            self.plots.append(Plot(APART, names[1:]))

    @property
    def spacing(self) -> float:
        """Distance between objects that are shown side by side, m."""
        size = max(each.thing.length if each.is_fish else 2.2 * room_size(each.thing) for each in self.specimens)
        return 0.9 * size if self.specimens[0].is_fish else size

    def set(self, name: str, value: float) -> None:
        """Change a number while the objects move; ValueError, and nothing has changed, if that is not possible."""
        numbers = self.numbers | {name: float(value)}
        self._change_all(lambda specimen: specimen.change(numbers=numbers))
        self.numbers = numbers
        if name in BODY or name == "step":
            self._set_steps()

    def set_walls(self, walls: str) -> None:
        """Choose the walls, one of WALLS."""
        self._change_all(lambda specimen: specimen.change(walls=walls))
        self.walls = walls

    def move(self, motion: str) -> None:
        """Let fish do one of MOTIONS."""
        self.motion, first = motion, self.specimens[0].by_hand
        for specimen in self.specimens:
            specimen.motion = motion
            specimen.by_hand = first if specimen.by_hand.size == first.size else specimen.by_hand

    def grab(self, number: int, point) -> int:
        """Take hold of the node of an object nearest to a point (3,) m; returns the node."""
        node = self.specimens[number].tank.nearest(point)
        self.let_go()
        self.hand = Hand(number, node, self.specimens[number].position[node])
        return node

    def let_go(self) -> None:
        """End a drag."""
        if self.hand is not None:
            for specimen in self.specimens:
                specimen.let_go()
        self.hand = None

    def fix(self, number: int, point) -> int:
        """Fix the node of an object nearest to a point, or release it, in all objects that have it; returns it."""
        node = self.specimens[number].tank.nearest(point)
        self.let_go()
        for each in self._matching(number):
            each.toggle(node)
        return node

    def release_all(self) -> None:
        """Release every fixed node."""
        self.let_go()
        self._change_all(lambda specimen: specimen.change(fixed=[]))

    def reset(self, velocity=(0.0, 0.0, 0.0)) -> None:
        """Start again at rest, or with a velocity (3,) m/s."""
        self.let_go()
        for specimen in self.specimens:
            specimen.reset(velocity)
        self.time, self.failure, self.failed, self.note, self._distorted = 0.0, "", (-1, -1), "", ""

    def throw(self) -> None:
        """Start again with a velocity obliquely upward, five lengths of the object a second."""
        up, along = -down_of(self.specimens[0].thing), np.array([1.0, 0.0, 0.0])
        self.reset(self.length * (5.0 * along + 8.0 * up * (abs(up @ along) < 0.5)))

    def distort(self, how: str) -> None:
        """Start again at rest, but twisted or inverted, one of DISTORTIONS; ValueError, and nothing changes, if not."""
        poses = [distort(specimen.thing, how) for specimen in self.specimens]
        self.reset()
        for specimen, pose in zip(self.specimens, poses, strict=True):
            specimen.place(pose)
        self._distorted = how

    def can_distort(self, how: str) -> bool:
        """Return True if the objects can be twisted, or inverted."""
        try:
            return bool([distort(specimen.thing, how) for specimen in self.specimens])
        except ValueError:
            return False

    def advance(self, seconds: float) -> None:
        """Move on by a part of a second."""
        self.time += seconds
        if self.hand is not None:
            self.hand.advance(seconds)
            for specimen in self._matching(self.hand.specimen):
                specimen.pull(self.hand, self.strength)
        for number, specimen in enumerate(self.specimens):
            specimen.advance(self.time)
            if not specimen.tank.alive[0] and not self.failure:
                self.failure, self.failed = self.explain(specimen), (number, specimen.worst_node())
        if self._distorted and self.time >= SETTLED:
            self._report_shapes()

    def step(self) -> None:
        """Move on by one step of the first object."""
        self.advance(self.specimens[0].tank.dt)

    def halve_step(self) -> None:
        """Halve the step of every object, and start again."""
        self.set("step", max(0.5 * self.numbers["step"], SETTINGS["step"].low))
        self.reset()

    def seen(self, away: float, focal: float) -> None:
        """Give a uniform sphere the level for a camera so many lengths away, of a focal length in pixels, if asked to.

        A node that is dragged or fixed keeps the level.
        """
        first = self.specimens[0]
        if not self.by_distance or first.entry.thing != DETAILED or self.hand is not None or first.fixed:
            return
        level = self._detail.choose(away * self.length, focal)
        if level != (level_of(DETAILED) | dict(first.entry.level))["level"]:
            self.specimens[0] = first.at_level(level)
            self.looks[0], self.version = self.specimens[0].look, self.version + 1

    def explain(self, specimen: Specimen) -> str:
        """Explanation of the failure of an object, in one sentence."""
        tank = specimen.tank
        limit, kind = tank.integrator.limit(tank.fish.body, tank.world), tank.integrator.kind
        about = f"; the largest step that is stable at rest is {1e3 * limit:.3g} ms" if np.isfinite(limit) else ""
        if kind not in ("explicit", "semi-implicit"):
            about = f"; a {kind} method of order {tank.integrator.order}"
        return (
            f"{tank.integrator.name} failed on the {specimen.thing.name} after {specimen.time:.2f} s: "
            f"{tank.failure[0]} (step {1e3 * tank.dt:.3g} ms{about})"
        )

    def _report_shapes(self) -> None:
        """Report the objects that have not returned to their shape."""
        for specimen in self.specimens:
            off = out_of_shape(specimen.thing.body, specimen.position)
            if off > BACK:
                self.note += (
                    f"The {specimen.thing.name} was {self._distorted} and has not come back to its shape after "
                    f"{SETTLED:g} s by {specimen.method}: a node is {off:.2f} of its size from its place. "
                )
        self._distorted = ""

    def distance_of(self, number: int) -> float:
        """Distance of an object from the first one, in lengths of the first.

        Root mean square over landmarks of fish or over as many nodes; of other objects, between the centres of mass.
        """
        first, other = self.specimens[0], self.specimens[number]
        a, b = ((each.look.marks(each.position) if each.is_fish else each.position) for each in (first, other))
        if len(a) != len(b):
            a, b = (np.average(each.position, 0, each.thing.body.mass)[None] for each in (first, other))
        return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())) / self.length

    def _matching(self, number: int) -> list[Specimen]:
        """The object and those with as many nodes: what is done to a node of one is done to that of all."""
        nodes = len(self.specimens[number].position)
        return [specimen for specimen in self.specimens if len(specimen.position) == nodes]

    def _change_all(self, change: Callable[[Specimen], None]) -> None:
        """Change every object, or none if one of them cannot be changed."""
        self.let_go()
        before = [(each, each.numbers, each.walls, each.step, each.fixed) for each in self.specimens]
        try:
            for specimen in self.specimens:
                change(specimen)
        except ValueError:
            for specimen, *old in before:
                specimen.change(*old)
            raise

    def _set_steps(self) -> None:
        """Give every object its step: the method's own times the setting, or one that costs as much as the first's."""
        self._change_all(lambda specimen: specimen.change(step=self.numbers["step"]))
        if not self.same_cost or len(self.specimens) == 1:
            return
        budget = cost_of_step(self.specimens[0]) / self.specimens[0].tank.dt
        for specimen in self.specimens[1:]:
            specimen.change(step=cost_of_step(specimen) / budget / specimen.own_step())

    # For the page

    def point(self, pointer: Pointer) -> None:
        """Drag a node, or fix it."""
        if pointer.phase == "end":
            self.let_go()
        number = pointer.body if self.hand is None or pointer.phase == "start" else self.hand.specimen
        place = (pointer.point - self._offset(number)) @ self._turn()
        if pointer.phase == "start" and number >= 0:
            (self.fix if self.fixing else self.grab)(number, place)
        elif pointer.phase == "move" and self.hand is not None:
            self.hand.aim(place)

    def _offset(self, number: int) -> np.ndarray:
        """Offset (3,) m at which object `number` is shown: side by side, fish across their way."""
        place = (number - 0.5 * (len(self.specimens) - 1)) * self.spacing
        return np.array([0.0, -place, 0.0] if self.specimens[0].is_fish else [place, 0.0, 0.0])

    def _turn(self) -> np.ndarray:
        down = down_of(self.specimens[0].thing)
        return HANGING if down[0] > 0.5 else UPRIGHT if self.upright else np.eye(3)

    def _shown(self, number: int, points: np.ndarray) -> np.ndarray:
        return points @ self._turn().T + self._offset(number)

    def frame(self) -> Frame:
        """Every object, forces, the hand, fixed nodes and walls; followed are fish, or the lower half of a room."""
        bodies, found_arrows, balls, walls = [], [], [], []
        for k, each in enumerate(self.specimens):
            x = self._shown(k, each.position)
            tone = each.tone() if self.show["strain"] or self.show["springs"] else NOTHING
            bodies.append(Body(each.look, x, each.contraction(), tone))
            if self.show["forces"]:
                nodes, ways = arrows(each.forces(), each.tank.fish.body.mass)
                ways = each.thing.length * ways @ self._turn().T
                found_arrows += [Arrow(x[n], way, "force", 0.4) for n, way in zip(nodes, ways, strict=True)]
            balls += [(x[n], 0.03, "node") for n in each.fixed]
            if self.hand is not None and self.hand.specimen == k:
                point = self._shown(k, self.hand.point)
                balls.append((point, 0.035, "hand"))
                found_arrows.append(Arrow(x[self.hand.node], point - x[self.hand.node], "hand", 0.5))
            walls += self._walls(k)
        first, size = self.specimens[0], room_size(self.specimens[0].thing)
        middle = np.mean([body.position.mean(axis=0) for body in bodies], axis=0)
        return Frame(
            bodies, middle if first.is_fish else np.array([0.0, 0.0, -0.55 * size]), found_arrows, balls=tuple(balls),
            walls=tuple(walls), floor=-0.5 * self.length if first.is_fish else -size - 0.002 * self.length,
            show=self.shown(), time=self.time,
        )  # fmt: skip

    def _walls(self, number: int) -> list[np.ndarray]:
        """Corners (4,3) m of each wall of an object but its floor."""
        planes, turn, sheets = self.specimens[number].tank.world.planes, self._turn(), []
        size, depth = room_size(self.specimens[number].thing), 0.4 if self.upright else 1.0
        for plane in planes if planes is not None else []:
            inward = turn @ plane[:3]
            if inward[2] > 0.5:
                continue
            across = depth * np.array([0.0, 1.0, 0.0]) if abs(inward[0]) > 0.5 else np.array([1.0, 0.0, 0.0])
            up = np.array([0.0, 0.0, 1.0]) if abs(inward[2]) < 0.5 else np.array([0.0, 1.0, 0.0])
            middle = inward * plane[3] + self._offset(number)
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ (size * np.array([across, up]))
            sheets.append(middle + corners)
        return sheets

    def readings(self) -> list[list[float]]:
        """Measurements of every object, in the order of the plots."""
        first, found = self.specimens[0], [[MEASURES[plot.title](each) for each in self.specimens]
                                           for plot in self.plots if plot.title in MEASURES]  # fmt: skip
        motion, total, work = first.kinetic(), first.gained(), [first.work()] if first.is_fish else []
        found.append([motion, total - motion, *work, sum(work) - total])
        return found + [[self.distance_of(k) for k in range(1, len(self.specimens))]] * (len(self.specimens) > 1)

    def controls(self) -> list[Control]:
        """Those that apply to what is on the bench."""
        first, fish = self.specimens[0], any(each.is_fish for each in self.specimens)
        found = [
            Control("choice", "motion", "The fish", self.move, value=self.motion, default="rest", options=list(MOTIONS))
            if fish else Control("button", "throw", "Throw", lambda _: self.throw(), key="t")
        ]  # fmt: skip
        found += [
            Control("button", how, name, lambda _, how=how: self.distort(how), help=words)
            for how, name, words in (("twisted", "Twist", "at rest, turned by half a turn from end to end"),
                                     ("inverted", "Invert", "at rest, turned inside out"))
            if self.can_distort(how)
        ]  # fmt: skip
        found += [
            Control("switch", "fixing", "Press fixes a node", self._assign("fixing"), value=self.fixing, default=False,
                    help="or lets it go again; else a press drags it"),
            Control("slider", "strength", "Strength of the hand", self._assign("strength"), value=self.strength,
                    default=1.0, low=0.1, high=20.0, step=0.1),
        ]  # fmt: skip
        if self.failure:
            found.append(Control("button", "halve", "Halve the step", lambda _: self.halve_step(), "Time"))
        if any(each.fixed for each in self.specimens):
            found.append(Control("button", "release", "Let all nodes go", lambda _: self.release_all()))
        for number in range(min(len(self.specimens) + 1, MOST)):
            found += self._choices(number)
        if first.entry.thing == DETAILED:
            found.append(Control("switch", "by_distance", "Level by distance", self._assign("by_distance"), "Objects",
                                 self.by_distance, False, help="as coarse as nobody sees from the camera"))  # fmt: skip
        if len(self.specimens) > 1:
            found.append(Control("switch", "same_cost", "Steps of the same cost", self._share, "Objects",
                                 self.same_cost, False, help="a second costs as much of the processor"))  # fmt: skip
        found += [
            Control("slider", name, setting.label, lambda value, name=name: self.set(name, value),
                    "Body" if name in BODY else "Method" if name == "step" else "Surroundings", self.numbers[name],
                    self.defaults[name], setting.low, setting.high, help=setting.meaning)
            for name, setting in SETTINGS.items() if self._applies(name)
        ]  # fmt: skip
        if all(each.thing.water.added_mass is None for each in self.specimens):  # water with inertia knows no walls
            found.append(Control("choice", "walls", "Walls", self.set_walls, "Surroundings", self.walls, "own",
                                 options=list(WALLS)))  # fmt: skip
        if self.motion == "by hand" and isinstance(first.thing, Fish):
            found += sliders(muscle_names(first.thing), first.by_hand)
        return found + self.view_controls()

    def _assign(self, name: str) -> Callable[[Any], None]:
        return lambda value: setattr(self, name, value)

    def _share(self, on: bool) -> None:
        self.same_cost = on
        self._set_steps()

    def _applies(self, name: str) -> bool:
        """Return True if a number changes anything on the bench."""
        things = [each.thing for each in self.specimens]
        wet = any(np.any(thing.water.quadratic) or np.any(thing.water.linear) for thing in things)
        return {
            "pressure": any(thing.body.compartments is not None for thing in things),
            "inner_density": any(len(getattr(thing, "inner", ())) for thing in things),
            "water": wet, "current_x": wet, "current_y": wet,
            "restitution": self.walls == "closed room" or (self.walls == "own" and things[0].water.planes is not None),
        }.get(name, True)  # fmt: skip

    def _choices(self, number: int) -> list[Control]:
        """The controls that choose an object, its method and its resolution; of one that is not there, the first."""
        entries = [each.entry for each in self.specimens]
        entry = entries[number] if number < len(entries) else None

        def thing(name: str) -> None:
            self.choose(entries[:number] if name == NONE else [*entries[:number], Entry(name), *entries[number + 1 :]])

        def change(**changes) -> None:
            chosen = [each._replace(**changes) if k == number else each for k, each in enumerate(entries)]
            self.choose(chosen)

        label, kinds = f"The {('first', 'second', 'third')[number]}", [*([NONE] * (number > 0)), *OBJECTS, *BODIES]
        found = [Control("choice", f"thing {number}", label, thing, "Objects", entry.thing if entry else NONE,
                         options=kinds)]  # fmt: skip
        if entry is None:
            return found
        found.append(
            Control("choice", f"integrator {number}", "  its method",
                    lambda value: change(integrator="" if value == OWN else value), "Objects",
                    entry.integrator or OWN, OWN, options=[OWN, *INTEGRATORS])
        )  # fmt: skip
        defaults, level = level_of(entry.thing), dict(entry.level)
        found += [
            Control("slider", f"{name} {number}", f"  its {name}",
                    lambda value, name=name: change(level=tuple((level | {name: int(value)}).items())), "Objects",
                    level.get(name, default), default, 0,
                    9 if entry.thing in ("block", "ball") else FINEST.get(name, 24), 1)
            for name, default in defaults.items()
        ]  # fmt: skip
        return found
