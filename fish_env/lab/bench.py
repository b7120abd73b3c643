"""The bench: up to three objects side by side, pulled by a hand, measured, and started again when one fails.

It knows nothing of the page; all requests of the page are checked here.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from fish_env.bodies import Fish
from fish_env.bodies.distorted import DISTORTIONS, distort, out_of_shape
from fish_env.checks import is_whole
from fish_env.lab.hand import Hand
from fish_env.lab.settings import BODY, SETTINGS, WALLS, checked_choice, checked_point, checked_setting
from fish_env.lab.specimen import Entry, Readings, Specimen, checked_entry, cost_of_step, down_of, make_thing, room_size

MOST = 3  # objects side by side
MANY = 600  # nodes of an object that one processor does not move in real time by steps of its own
LONGER, DRIVEN = 4.0, 2.0  # times its own: the step of such an object, and of such a fish, if its method is stabilised
KEPT = 400  # readings
BETWEEN = 0.05  # s of the simulation between two readings
SETTLED = 3.0  # s after which what was distorted is to be back in its shape
BACK = 0.3  # of its size: what lies on the floor by its weight is out of shape by up to half of this
FAR = 100.0  # lengths of the object: a point of the page further away is not accepted


class Bench:
    """One to three objects that are looked at and touched, all under the same conditions."""

    def __init__(self, entries: Sequence[Entry] = (Entry("uniform sphere"),)):
        self.same_cost, self.strength = False, 1.0
        self.hand: Hand | None = None
        self.messages: deque[str] = deque(maxlen=20)
        """Messages to the user: the method that failed, and the reason."""
        self.choose(entries)

    def choose(self, entries: Sequence[Entry], same_cost: bool | None = None) -> None:
        """Put other objects on the bench, at rest; ValueError, and the bench is as before, for what is not allowed."""
        if not 1 <= len(entries) <= MOST:
            raise ValueError(f"{len(entries)} objects; give 1 to {MOST}")
        same_cost = self.same_cost if same_cost is None else bool(same_cost)
        thing = make_thing(checked_entry(entries[0]))
        numbers = {name: setting.default for name, setting in SETTINGS.items()}
        gravity = thing.water.gravity
        numbers["gravity"] = 0.0 if gravity is None else round(float(np.linalg.norm(gravity)), 6)
        specimens = [Specimen(checked_entry(entry), numbers, "own", 1.0) for entry in entries]
        if any(len(each.position) > MANY for each in specimens) and all(
            each.tank.integrator.kind == "stabilised" for each in specimens
        ):
            numbers["step"] = DRIVEN if any(each.is_fish for each in specimens) else LONGER
        self.specimens, self.numbers, self.walls, self.same_cost = specimens, numbers, "own", same_cost
        self.hand, self.clock = None, 0.0
        self._set_steps()
        self._clear()

    def warm(self) -> None:
        """Have compiled, or read, what a drag needs, so that the first one does not wait."""
        for specimen in self.specimens:
            copy = Specimen(specimen.entry, specimen.numbers, specimen.walls, specimen.step)
            copy.pull(Hand(0, 0, copy.position[0]), self.strength)
            copy.tank.advance(1)

    @property
    def nodes(self) -> int:
        """Number of nodes of all objects together."""
        return sum(len(specimen.position) for specimen in self.specimens)

    @property
    def reach(self) -> float:
        """Largest distance of a point of the page from the origin, m."""
        return FAR * max(specimen.thing.length for specimen in self.specimens)

    @property
    def spacing(self) -> float:
        """Distance between objects that are shown side by side, m."""
        return 2.2 * max(room_size(specimen.thing) for specimen in self.specimens)

    def set_detail(self, number: int, level: int) -> None:
        """Make an object of layers again with another level of detail, while it moves."""
        self.let_go()
        self.specimens[number] = self._specimen(number).at_level(level)

    def set(self, name, value) -> None:
        """Change a number while the objects move; ValueError, and nothing has changed, for one that is not allowed."""
        numbers = self.numbers | {name: checked_setting(name, value)}
        self._change_all(lambda specimen: specimen.change(numbers=numbers))
        self.numbers = numbers
        if name in BODY or name == "step":
            self._set_steps()

    def set_walls(self, walls) -> None:
        """Choose the walls, one of WALLS."""
        walls = checked_choice(walls, WALLS, "walls")
        self._change_all(lambda specimen: specimen.change(walls=walls))
        self.walls = walls

    def set_strength(self, value) -> None:
        """Set the strength of the hand, a factor from 0.1 to 20."""
        if not (isinstance(value, int | float) and 0.1 <= value <= 20.0):
            raise ValueError(f"strength of the hand is {value!r}; give a number from 0.1 to 20")
        self.strength = float(value)

    def swim(self, swimming) -> None:
        """Let fish beat their tails by the open-loop gait, or not."""
        for specimen in self.specimens:
            specimen.swimming = bool(swimming)

    def grab(self, number: int, point) -> int:
        """Take hold of the node of an object nearest to a point (3,) m; returns the node."""
        specimen = self._specimen(number)
        node = specimen.tank.nearest(checked_point(point, self.reach))
        self.let_go()
        self.hand = Hand(number, node, specimen.position[node])
        return node

    def drag(self, point) -> None:
        """Have the hand follow the pointer, which is now at a point (3,) m."""
        if self.hand is not None:
            self.hand.aim(checked_point(point, self.reach))

    def let_go(self) -> None:
        """End a drag."""
        if self.hand is not None:
            for specimen in self.specimens:
                specimen.let_go()
        self.hand = None

    def fix(self, number: int, point) -> int:
        """Fix the node of an object nearest to a point, or release it, in all objects that have it; returns it."""
        specimen = self._specimen(number)
        node = specimen.tank.nearest(checked_point(point, self.reach))
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
        velocity = checked_point(velocity, 1e6)
        self.let_go()
        for specimen in self.specimens:
            specimen.reset(velocity)
        self.clock = 0.0
        self._clear()

    def throw(self) -> None:
        """Start again with a velocity obliquely upward, five lengths of the object a second."""
        thing = self.specimens[0].thing
        up, along = -down_of(thing), np.array([1.0, 0.0, 0.0])
        self.reset(thing.length * (5.0 * along + 8.0 * up * (abs(up @ along) < 0.5)))

    def distort(self, how: str) -> None:
        """Start again at rest, but twisted or inverted, one of DISTORTIONS; ValueError, and nothing changes, if not."""
        checked_choice(how, DISTORTIONS, "pose")
        poses = [distort(specimen.thing, how) for specimen in self.specimens]
        self.reset()
        for specimen, pose in zip(self.specimens, poses, strict=True):
            specimen.place(pose)
        self._distorted = how

    def advance(self, seconds: float) -> None:
        """Move on by a part of a second; what fails is named, and all start again."""
        self.clock += seconds
        if self.hand is not None:
            self.hand.advance(seconds)
            for specimen in self._matching(self.hand.specimen):
                specimen.pull(self.hand, self.strength)
        for specimen in self.specimens:
            specimen.advance(self.clock)
        failed = [specimen for specimen in self.specimens if not specimen.tank.alive[0]]
        if failed:
            self.messages.extend(self.explain(specimen) for specimen in failed)
            self.reset()
            return
        if self.clock >= self._measured + BETWEEN:
            self.measure()
        if self._distorted and self.clock >= SETTLED:
            self._report_shapes()

    def explain(self, specimen: Specimen) -> str:
        """Explanation of the failure of an object, in one sentence."""
        tank = specimen.tank
        limit = tank.integrator.limit(tank.fish.body)
        about = f"the largest step that is stable at rest is {1e3 * limit:.3g} ms" if np.isfinite(limit) else ""
        if tank.integrator.kind not in ("explicit", "semi-implicit"):
            about = f"a {tank.integrator.kind} method of order {tank.integrator.order}"
        return (
            f"{tank.integrator.name} failed on the {specimen.thing.name} after {specimen.time:.2f} s: "
            f"{tank.failure[0]} (step {1e3 * tank.dt:.3g} ms; {about}). All objects start again."
        )

    def _report_shapes(self) -> None:
        """Report the objects that have not returned to their shape."""
        for specimen in self.specimens:
            off = out_of_shape(specimen.thing.body, specimen.position)
            if off > BACK:
                self.messages.append(
                    f"The {specimen.thing.name} was {self._distorted} and has not come back to its shape after "
                    f"{SETTLED:g} s by {specimen.method}: a node is {off:.2f} of its size from its place. It may be in "
                    "another equilibrium; Drop starts again at rest."
                )
        self._distorted = ""

    def measure(self) -> None:
        """Record the readings of every object, and how far the others are from the first."""
        self._measured = self.clock
        self.history.append([specimen.readings() for specimen in self.specimens])
        self.distances.append([self.distance(k) for k in range(1, len(self.specimens))])

    def distance(self, number: int) -> float:
        """Distance of an object from the first one, in lengths of the first.

        Root mean square over landmarks of fish or over as many nodes; of other objects, between the centres of mass.
        """
        first, other = self.specimens[0], self._specimen(number)
        if isinstance(first.thing, Fish) and isinstance(other.thing, Fish):
            a, b = first.thing.points(first.position), other.thing.points(other.position)
        elif len(first.position) == len(other.position):
            a, b = first.position, other.position
        else:
            a, b = ((each.tank.fish.body.mass @ each.position)[None] for each in (first, other))
            a, b = a / first.tank.fish.body.mass.sum(), b / other.tank.fish.body.mass.sum()
        return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean())) / first.thing.length

    def _specimen(self, number) -> Specimen:
        if not (is_whole(number) and 0 <= number < len(self.specimens)):
            raise ValueError(f"object is {number!r}; give a whole number from 0 to {len(self.specimens) - 1}")
        return self.specimens[number]

    def _matching(self, number: int) -> list[Specimen]:
        """The object and those with as many nodes: what is done to a node of one is done to that of all."""
        nodes = len(self.specimens[number].position)
        return [specimen for specimen in self.specimens if len(specimen.position) == nodes]

    def _change_all(self, change) -> None:
        """Change every object, or none if one of them cannot be changed."""
        self.let_go()
        before = [(each, each.numbers, each.walls, each.step, each.fixed) for each in self.specimens]
        try:
            for specimen in self.specimens:
                change(specimen)
        except ValueError:
            for specimen, numbers, walls, step, fixed in before:
                specimen.change(numbers, walls, step, fixed)
            raise

    def _set_steps(self) -> None:
        """Give every object its step: the method's own times the setting, or one that costs as much as the first's."""
        self._change_all(lambda specimen: specimen.change(step=self.numbers["step"]))
        if not self.same_cost or len(self.specimens) == 1:
            return
        costs = [cost_of_step(specimen) for specimen in self.specimens]
        budget = costs[0] / self.specimens[0].tank.dt
        steps = [cost / budget / specimen.own_step() for cost, specimen in zip(costs, self.specimens, strict=True)]
        for specimen, step in zip(self.specimens[1:], steps[1:], strict=True):
            specimen.change(step=step)

    def _clear(self) -> None:
        self.history: deque[list[Readings]] = deque(maxlen=KEPT)
        self.distances: deque[list[float]] = deque(maxlen=KEPT)
        self._measured, self._distorted = -np.inf, ""

    def series(self, name: str) -> list[np.ndarray]:
        """The readings of a name over time, one row for each object, and first their times, s.

        "power", W, is the mean of the muscles' power since the reading before.
        """
        if name == "power":
            times, *rows = self.series("work")
            return [times[1:], *(np.diff(row) / np.diff(times) for row in rows)]
        rows = list(self.history)
        times = np.array([row[0].time for row in rows])
        return [times, *(np.array([getattr(row[k], name) for row in rows]) for k in range(len(self.specimens)))]
