"""One object in the laboratory: its tank, made again when a number changes, with actions on it and measurements."""

import inspect
import time
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import BODIES, Fish, fitted
from fish_env.bodies.detail import carry_over
from fish_env.bodies.objects import OBJECTS, Layered
from fish_env.checks import is_whole
from fish_env.control.gait import best_gait
from fish_env.lab.geometry import Surface, enclosed_volume, spring_strain, surfaces, tet_strain
from fish_env.lab.hand import Hand
from fish_env.lab.settings import checked_choice
from fish_env.physics.body import scale_body, with_rates
from fish_env.physics.fish import ElasticObject
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.integrators import INTEGRATORS
from fish_env.physics.records import Body, World
from fish_env.physics.tank import Tank
from fish_env.physics.tank_options import own_step
from fish_env.physics.world import make_world

PULL = 0.4  # drag spring: its pull, over the object's weight on Earth, at a distance of the object's length
DAMPING = 0.05  # s, damping of the drag spring over its stiffness
LARGEST = 1100  # nodes of an object that is moved as it is looked at
FINEST = 24  # of a whole number that an object is made with
TRIAL = 0.02  # s of processor time for the measurement of a cost
STEPS = 16  # whose cost is measured at once
ROOM = 1.5  # half the width of a closed room, in lengths of an object that has no walls of its own


class Entry(NamedTuple):
    """Choice of an object in the laboratory."""

    thing: str  # a key of BODIES or OBJECTS
    integrator: str = ""  # a key of INTEGRATORS; "" for the object's own
    level: tuple[tuple[str, int], ...] = ()  # whole numbers that it is made with, such as ("level", 2)


class Readings(NamedTuple):
    """Measurements of an object at one time; NaN where there is nothing to measure."""

    time: float  # s
    energy: float  # of motion and of all that stores any, J
    work: float  # of the muscles so far, J
    volume: float  # over that at rest
    strain: float  # largest of a spring or tetrahedron


TABLE: dict[str, Any] = {**BODIES, **OBJECTS}


def level_of(name: str) -> dict[str, int]:
    """Whole numbers that an object is made with, and their defaults."""
    parameters = inspect.signature(TABLE[name].make).parameters.values()
    return {each.name: each.default for each in parameters if type(each.default) is int}


def make_thing(entry: Entry) -> ElasticObject:
    """The object of an entry; ValueError for a name or a number that is not allowed."""
    checked_choice(entry.thing, TABLE, "object")
    unknown = [name for name, _ in entry.level if name not in level_of(entry.thing)]
    if unknown:
        known = ", ".join(level_of(entry.thing)) or "no number"
        raise ValueError(f"{entry.thing!r} is made with {known}, and not with {unknown[0]!r}; give one of these")
    return make_once(entry.thing, entry.level)


@lru_cache(maxsize=8)
def make_once(name: str, level: tuple[tuple[str, int], ...]) -> ElasticObject:
    """An object that all who choose it share: it is not changed."""
    return TABLE[name].make(**dict(level))


def checked_entry(entry: Entry) -> Entry:
    """An entry whose names exist and whose numbers are in their range, or ValueError."""
    if entry.integrator:
        checked_choice(entry.integrator, INTEGRATORS, "integrator")
    for name, value in entry.level:
        if not is_whole(value) or not 0 <= value <= FINEST:
            raise ValueError(f"{name} is {value!r}; give a whole number from 0 to {FINEST}")
    thing = make_thing(entry)
    if thing.body.mass.size > LARGEST:
        raise ValueError(
            f"{entry.thing} would have {thing.body.mass.size} nodes; the laboratory moves at most {LARGEST}: give "
            f"smaller numbers than {', '.join(f'{name} {value}' for name, value in chain(entry.level))}"
        )
    return entry


def change_body(thing: ElasticObject, numbers: dict[str, float]) -> Body:
    """Apply the numbers of the settings to the body of an object, and return the new body."""
    body = scale_body(thing.body, numbers["stiffness"], numbers["damping"], numbers["density"])
    gas, inner = body.compartments, getattr(thing, "inner", np.zeros(0, np.int64))
    if gas is not None and numbers["pressure"] != 1.0:
        factor = numbers["pressure"]
        weaker = gas._replace(gas=gas.gas * factor, ambient=gas.ambient * factor) if factor else None  # may be flat
        body = body._replace(compartments=weaker)
    if len(inner) and numbers["inner_density"] != 1.0:
        mass, inverse = body.mass.copy(), body.inverse_mass.copy()
        mass[inner] *= numbers["inner_density"]
        inverse[inner] /= numbers["inner_density"]
        body = body._replace(mass=mass, inverse_mass=inverse)
    return with_rates(body) if numbers["pressure"] != 1.0 or numbers["inner_density"] != 1.0 else body


def down_of(thing: ElasticObject) -> np.ndarray:
    """Direction of gravity for an object, a unit vector (3,)."""
    return np.asarray(getattr(thing, "down", (0.0, 0.0, -1.0)), dtype=float)


def room_size(thing: ElasticObject) -> float:
    """Distance of the walls of an object from the origin, m."""
    planes = thing.water.planes
    return ROOM * thing.length if planes is None else float(-planes[:, 3].min())


def change_world(thing: ElasticObject, numbers: dict[str, float], walls: str) -> World:
    """Apply the numbers of the settings and the walls that are chosen to the world of an object; the new world."""
    own, size = thing.water, room_size(thing)
    planes = [] if own.planes is None else [(row[:3], row[3], numbers["restitution"]) for row in own.planes]
    if walls == "none":
        planes = []
    elif walls == "closed room":
        axes = np.eye(3)[: 2 if thing.flat else 3]
        planes = [(side * axis, -size, numbers["restitution"]) for axis in axes for side in (1.0, -1.0)]
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
        ValueError: for what is not allowed, or a method that cannot move the object there.
    """

    def __init__(self, entry: Entry, numbers: dict[str, float], walls: str, step: float):
        self.entry, self.thing, self.fixed = entry, make_thing(entry), []
        self.surfaces: list[Surface] = surfaces(self.thing)
        self.rest_volume = enclosed_volume(self.thing, self.surfaces, self.thing.body.position)
        self.swimming, self._gait = False, best_gait(fitted.level_of(self.thing.water))
        self.numbers, self.walls, self.step = numbers, walls, step
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
        body = change_body(self.thing, numbers)
        thing = replace(self.thing, body=body)
        world = change_world(self.thing, numbers, walls)
        name = self.entry.integrator or None
        own = step == 1.0 and name in (None, thing.integrator)
        tank = Tank(thing, integrator=name, dt=None if own else step * self.own_step(thing), water=world, threads=1)
        self.tank: Tank[Any] = tank
        self.numbers, self.walls, self.step, self.fixed = numbers, walls, step, fixed
        self._evaluator: Evaluator | None = None

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
        if self.fixed:
            self.tank.fix(self.fixed)

    def at_level(self, level: int) -> "Specimen":
        """This object with another level of detail, in the same motion, nothing fixed; ValueError without layers."""
        numbers = dict(self.entry.level) | {"level": level}
        entry = checked_entry(self.entry._replace(level=tuple(numbers.items())))
        other = Specimen(entry, self.numbers, self.walls, self.step)
        before, after = self.thing, other.thing
        if not (isinstance(before, Layered) and isinstance(after, Layered)):
            raise ValueError(
                f"{self.entry.thing!r} has no layers, whose motion could be carried over; give one that has"
            )
        other.tank.position[0] = carry_over(before, after, self.position)
        other.tank.velocity[0] = carry_over(before, after, self.tank.velocity[0])
        other.tank.time[0] = self.tank.time[0]
        return other

    def toggle(self, node: int) -> None:
        """Fix a node where it is, or let go of one that is fixed."""
        self.change(fixed=sorted(set(self.fixed) ^ {node}))

    def reset(self, velocity=(0.0, 0.0, 0.0)) -> None:
        """Put it back to rest at the middle of its room, or give all nodes a velocity (3,) m/s there."""
        self.tank.reset()
        self.tank.velocity[0] = np.where(self.tank.fish.body.inverse_mass > 0.0, velocity, 0.0)

    def place(self, position: np.ndarray) -> None:
        """Put its nodes, which are at rest, at positions (N,3) m; those that are fixed are fixed there."""
        self.tank.position[0] = position
        if self.fixed:
            self.tank.fix(self.fixed)

    def pull(self, hand: Hand, strength: float, damping: float = DAMPING) -> None:
        """Let a hand pull at its node, or take the node along if that is fixed."""
        if hand.node in self.fixed:
            self.tank.move([hand.node], hand.velocity)
            return
        mass = float(self.tank.fish.body.mass.sum())
        stiffness = strength * mass * 9.81 / (PULL * self.thing.length)
        self.tank.grab(hand.node, hand.start, stiffness, damping * stiffness, velocity=hand.velocity)

    def let_go(self) -> None:
        """End the pull."""
        if self.fixed:
            self.tank.fix(self.fixed)
        if self.tank.world.anchors is not None:
            self.tank.release()

    def advance(self, until: float) -> None:
        """Move on by whole steps to a time, s, or to just before it."""
        steps = int((until - self.time) / self.tank.dt + 1e-6)
        if steps < 1 or not self.tank.alive[0]:
            return
        if self.swimming and isinstance(self.thing, Fish):
            then = self.time + steps * self.tank.dt
            self.tank.command(self._gait.contraction(self.thing, np.array([then])), steps * self.tank.dt)
        self.tank.advance(steps)

    def spring_strain(self) -> np.ndarray:
        """Strain of every spring (E,)."""
        return spring_strain(self.tank.fish.body.springs, self.tank.rest_length[0], self.position)

    def tet_strain(self) -> np.ndarray:
        """Strain of every tetrahedron (T,)."""
        tets = self.tank.fish.body.tets
        return np.zeros(0) if tets is None else tet_strain(tets, self.position)

    def forces(self) -> np.ndarray:
        """The force on every node, (N,3) N."""
        return self._evaluate().force(self.tank.rest_length[0], self.position, self.tank.velocity[0])

    def readings(self) -> Readings:
        """Current measurements."""
        state = (self.tank.rest_length[0], self.position, self.tank.velocity[0])
        energy = sum(self._evaluate().energies(*state).values())
        volume = enclosed_volume(self.thing, self.surfaces, self.position) / self.rest_volume
        strains = (self.spring_strain(), self.tet_strain())
        strain = max((float(np.abs(each).max()) for each in strains if each.size), default=np.nan)
        return Readings(self.time, energy, float(self.tank.work[0]), volume, strain)

    def _evaluate(self) -> Evaluator:
        if self._evaluator is None:
            world = self.tank.world._replace(anchors=None)  # the hand is outside of what is measured
            self._evaluator = Evaluator(self.tank.fish.body, world)
        return self._evaluator


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
