"""One object in the laboratory: its tank, made again when a number changes, with actions on it and measurements."""

import inspect
import time
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import BODIES, Fish, fitted, make_fish
from fish_env.control.gait import best_gait
from fish_env.lab.hand import Hand
from fish_env.lab.measures import enclosed_volume, most_strained, spring_strain, tet_strain, tone
from fish_env.physics.body import scale_body, with_rates
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import INTEGRATORS
from fish_env.physics.records import Body, World
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import own_step
from fish_env.scene.look import look_of
from fish_env.soft.detail import carry_over
from fish_env.soft.objects import OBJECTS, Layered
from fish_env.soft.room import make_world

PULL = 0.4  # drag spring: its pull, over the object's weight on Earth, at a distance of the object's length
DAMPING = 0.05  # s, damping of the drag spring over its stiffness
LARGEST = 1100  # nodes of an object that is moved as it is looked at
TRIAL, STEPS = 0.02, 16  # s of processor time for the measurement of a cost, and steps that are measured at once
MOTIONS = ("rest", "gait", "abrupt turns", "by hand")
"""What a fish does: nothing, the best gait of its water, all muscles of one side and then the other, or sliders."""
RIGHT, LEFT, REPEATED = 0.2, 0.3, 1.6  # s of the abrupt turns, and after which they begin again
ROOM = 1.5  # half the width of a closed room, in lengths of an object that has no walls of its own
TABLE: dict[str, Any] = {**BODIES, **OBJECTS}


class Entry(NamedTuple):
    """Choice of an object in the laboratory."""

    thing: str  # a key of BODIES or OBJECTS
    integrator: str = ""  # a key of INTEGRATORS; "" for the object's own
    level: tuple[tuple[str, int], ...] = ()  # whole numbers that it is made with, such as ("level", 2)
    water: str = ""  # of a fish: "drag" or "reactive", which it is calibrated for; "" for the default


def level_of(name: str) -> dict[str, int]:
    """Whole numbers that an object is made with, and their defaults."""
    parameters = inspect.signature(TABLE[name].make).parameters.values()
    return {each.name: each.default for each in parameters if type(each.default) is int}


@lru_cache(maxsize=8)
def make_thing(name: str, level: tuple[tuple[str, int], ...], water: str) -> ElasticObject:
    """An object that all who choose it share: it is not changed; ValueError for one with too many nodes."""
    thing = make_fish(name, water=water, **dict(level)) if water else TABLE[name].make(**dict(level))
    if thing.body.mass.size > LARGEST:
        raise ValueError(
            f"{name} would have {thing.body.mass.size} nodes; the laboratory moves at most {LARGEST}: give smaller "
            f"numbers than {', '.join(f'{number} {value}' for number, value in level)}"
        )
    return thing


def change_body(thing: ElasticObject, numbers: dict[str, float]) -> Body:
    """Apply the numbers of the settings to the body of an object, and return the new body."""
    body = scale_body(thing.body, numbers["stiffness"], numbers["damping"], numbers["density"])
    gas, inner, factor = body.compartments, getattr(thing, "inner", np.zeros(0, np.int64)), numbers["pressure"]
    if gas is not None and factor != 1.0:
        weaker = gas._replace(gas=gas.gas * factor, ambient=gas.ambient * factor) if factor else None  # may be flat
        body = body._replace(compartments=weaker)
    if len(inner) and numbers["inner_density"] != 1.0:
        mass, inverse = body.mass.copy(), body.inverse_mass.copy()
        mass[inner] *= numbers["inner_density"]
        inverse[inner] /= numbers["inner_density"]
        body = body._replace(mass=mass, inverse_mass=inverse)
    return with_rates(body) if factor != 1.0 or numbers["inner_density"] != 1.0 else body


def down_of(thing: ElasticObject) -> np.ndarray:
    """Direction of gravity for an object, a unit vector (3,)."""
    return np.asarray(getattr(thing, "down", (0.0, 0.0, -1.0)), dtype=float)


def room_size(thing: ElasticObject) -> float:
    """Distance of the walls of an object from the origin, m."""
    planes = thing.water.planes
    return ROOM * thing.length if planes is None else float(-planes[:, 3].min())


def change_world(thing: ElasticObject, numbers: dict[str, float], walls: str) -> World:
    """Apply the numbers of the settings and the walls that are chosen to the world of an object; the new world."""
    own, bounce = thing.water, numbers["restitution"]
    planes = [] if own.planes is None or walls == "none" else [(row[:3], row[3], bounce) for row in own.planes]
    if walls == "closed room":
        axes = np.eye(3)[: 2 if thing.flat else 3]
        planes = [(side * axis, -room_size(thing), bounce) for axis in axes for side in (1.0, -1.0)]
    current = thing.length * np.array([numbers["current_x"], numbers["current_y"], 0.0])
    water = own._replace(
        linear=own.linear * numbers["water"], quadratic=own.quadratic * numbers["water"],
        friction=own.friction * numbers["water"], current=own.current + current,
    )  # fmt: skip
    return make_world(numbers["gravity"] * down_of(thing), planes, own.viscosity, water)


class Specimen:
    """An object that moves, and actions on it.

    Args:
        entry: choice of the object.
        numbers: of all SETTINGS.
        walls: one of WALLS.
        step: the integrator's step over its own.

    Raises:
        ValueError: for too many nodes, or a method that cannot move the object there.
    """

    def __init__(self, entry: Entry, numbers: dict[str, float], walls: str, step: float):
        self.entry, self.thing = entry, make_thing(entry.thing, entry.level, entry.water)
        self.look = look_of(self.thing)
        self._at_first = 0.0
        self.rest_volume = enclosed_volume(self.thing, self.look, self.thing.body.position)
        self.motion, self.by_hand = "rest", np.zeros(0)
        if isinstance(self.thing, Fish):
            self.by_hand, self._gait = np.zeros(self.thing.num_muscles), best_gait(fitted.level_of(self.thing.water))
        self._make(numbers, walls, step, [])

    @property
    def is_fish(self) -> bool:
        return isinstance(self.thing, Fish)

    @property
    def method(self) -> str:
        """Name of its integrator."""
        return self.tank.integrator.name

    @property
    def position(self) -> np.ndarray:
        """Node positions, (N,3) m."""
        return self.tank.position[0]

    @property
    def time(self) -> float:
        """Its clock, s."""
        return float(self.tank.time[0])

    def _make(self, numbers, walls, step, fixed) -> None:
        """Make the tank; nothing is changed if that cannot be done."""
        thing, name = replace(self.thing, body=change_body(self.thing, numbers)), self.entry.integrator or None
        world = change_world(self.thing, numbers, walls)
        own = step == 1.0 and name in (None, thing.integrator)
        tank = Tank(thing, integrator=name, dt=None if own else step * self.own_step(thing), water=world, threads=1)
        self.tank: Tank[Any] = tank
        self.numbers, self.walls, self.step, self.fixed = numbers, walls, step, fixed
        self._evaluator = Evaluator(thing.body, world)  # without the hand, which is outside of what is measured

    def own_step(self, thing: ElasticObject | None = None) -> float:
        """The step of its method if none is given, s."""
        body: ElasticObject = self.tank.fish if thing is None else thing
        return own_step(body, INTEGRATORS[self.entry.integrator or body.integrator])

    def change(self, numbers=None, walls=None, step=None, fixed=None) -> None:
        """Continue the same motion with other numbers; ValueError, and nothing is changed, if that is not possible."""
        old = self.tank
        self._make(
            self.numbers if numbers is None else numbers, self.walls if walls is None else walls,
            self.step if step is None else step, self.fixed if fixed is None else list(fixed),
        )  # fmt: skip
        for new, kept in zip(self.tank.state, old.state, strict=True):
            new[...] = kept
        self.tank.rest_length[...] = old.rest_length
        self._hold()

    def _hold(self) -> None:
        if self.fixed:
            self.tank.fix(self.fixed)

    def at_level(self, level: int) -> "Specimen":
        """This object of two layers with another level of detail, in the same motion, nothing fixed."""
        numbers = dict(self.entry.level) | {"level": level}
        other = Specimen(self.entry._replace(level=tuple(numbers.items())), self.numbers, self.walls, self.step)
        before, after = self.thing, other.thing
        assert isinstance(before, Layered) and isinstance(after, Layered)
        other.tank.position[0] = carry_over(before, after, self.position)
        other.tank.velocity[0] = carry_over(before, after, self.tank.velocity[0])
        other.tank.time[0] = self.tank.time[0]
        other._at_first = other.energy() - self.gained()
        return other

    def toggle(self, node: int) -> None:
        """Fix a node where it is, or let go of one that is fixed."""
        self.change(fixed=sorted(set(self.fixed) ^ {node}))

    def reset(self, velocity=(0.0, 0.0, 0.0)) -> None:
        """Put it back to rest at the middle of its room, or give all nodes a velocity (3,) m/s there."""
        self.tank.reset()
        self.tank.velocity[0] = np.where(self.tank.fish.body.inverse_mass > 0.0, velocity, 0.0)
        self._at_first = self.energy()

    def place(self, position: np.ndarray) -> None:
        """Put its nodes, which are at rest, at positions (N,3) m; those that are fixed are fixed there."""
        self.tank.position[0] = position
        self._hold()
        self._at_first = self.energy()

    def pull(self, hand: Hand, strength: float) -> None:
        """Let a hand pull at its node, or take the node along if that is fixed."""
        if hand.node in self.fixed:
            self.tank.move([hand.node], hand.velocity)
            return
        stiffness = strength * float(self.tank.fish.body.mass.sum()) * 9.81 / (PULL * self.thing.length)
        self.tank.grab(hand.node, hand.start, stiffness, DAMPING * stiffness, velocity=hand.velocity)

    def let_go(self) -> None:
        """End the pull."""
        self._hold()
        if self.tank.world.anchors is not None:
            self.tank.release()

    def advance(self, until: float) -> None:
        """Move on by whole steps to a time, s, or to just before it."""
        steps = int((until - self.time) / self.tank.dt + 1e-6)
        if steps < 1 or not self.tank.alive[0]:
            return
        if self.motion != "rest" and isinstance(self.thing, Fish):
            then = self.time + steps * self.tank.dt
            self.tank.command(self._contraction(self.thing, then)[None], steps * self.tank.dt)
        self.tank.advance(steps)

    def _contraction(self, fish: Fish, then: float) -> np.ndarray:
        """Contraction (M,) that is commanded at a time, s."""
        if self.motion == "by hand":
            return self.by_hand
        if self.motion == "gait":
            return self._gait.contraction(fish, then)
        since = then % REPEATED
        side = -1.0 if since < RIGHT else 1.0 if since < RIGHT + LEFT else 0.0
        return np.where(fish.sides == side, 1.0, 0.0)

    def strains(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (K,n) of what is strained, tetrahedra or else springs, and its strains (K,)."""
        body = self.tank.fish.body
        if body.tets is not None:
            return body.tets.nodes, tet_strain(body.tets, self.position)
        return body.springs.nodes, spring_strain(body.springs, self.tank.rest_length[0], self.position)

    def strain(self) -> float:
        """The largest strain."""
        return float(np.abs(self.strains()[1]).max(initial=0.0))

    def tone(self) -> np.ndarray:
        """Strain at every node (N,), from -1, shortened, to 1, stretched."""
        return tone(len(self.position), *self.strains())

    def contraction(self) -> np.ndarray:
        """Contraction (M,) of the muscles of a fish, 0 natural, 1 full; none of other objects."""
        return np.clip(self.tank.contraction[0], 0.0, 1.0) if self.is_fish else np.zeros(0)

    def forces(self) -> np.ndarray:
        """The force on every node, (N,3) N."""
        return self._evaluator.force(self.tank.rest_length[0], self.position, self.tank.velocity[0])

    def energy(self) -> float:
        """Energy of motion and of all that stores any, J."""
        return sum(self._evaluator.energies(self.tank.rest_length[0], self.position, self.tank.velocity[0]).values())

    def kinetic(self) -> float:
        """Energy of motion, J; of the water's inertia none."""
        return 0.5 * float(self.tank.fish.body.mass @ (self.tank.velocity[0] ** 2).sum(axis=1))

    def gained(self) -> float:
        """Energy over that at the start, J."""
        return self.energy() - self._at_first

    def work(self) -> float:
        """Work of the muscles so far, J."""
        return float(self.tank.work[0])

    def volume(self) -> float:
        """Volume over that at rest."""
        return enclosed_volume(self.thing, self.look, self.position) / self.rest_volume

    def worst_node(self) -> int:
        """The node at which it failed: of what is strained most; -1 without strains."""
        return most_strained(*self.strains())


def cost_of_step(specimen: Specimen) -> float:
    """Processor time of a step of an object's method, s, on a copy at rest."""
    copy = Specimen(specimen.entry, specimen.numbers, specimen.walls, specimen.step)
    copy.tank.advance(STEPS)  # compiled, or read from the disk
    found: list[float] = []
    while len(found) < 5 or (sum(found) < TRIAL and len(found) < 1000):
        copy.tank.reset()
        begin = time.process_time()
        copy.tank.advance(STEPS)
        found.append(time.process_time() - begin)
    return max(min(found), 1e-9) / STEPS
