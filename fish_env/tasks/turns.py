"""Commanded turns: when each is commanded, how well it is followed, and what it costs. Four tasks are made of them.

Legend: b fish; k turn or axis; angles positive to the left.
"""

import math
from typing import NamedTuple

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Pack, Vectors, dot, sqrt, vec3
from fish_env.physics.pose import FORWARD
from fish_env.physics.tank import Tank
from fish_env.tasks import rewards
from fish_env.tasks.base import CompiledTask
from fish_env.tasks.options import Direction, Option, weight
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.start import heading_vector, place

ALIGNMENT_WEIGHT = weight(5.0, "weight of pointing across the commanded heading, body lengths/s")
OVERSHOOT_WEIGHT = weight(10.0, "weight of having turned a right angle too far, body lengths/s")
COMPLETE = 0.9  # part of a turn after which it counts as made
LEAST_TURN = math.radians(1.0)  # a smaller turn has no radius
SETTLED = math.radians(10.0)  # largest heading error at which a turn has settled, on average over a beat
MEAN_TIME = 0.26  # s, about a beat: headings are averaged over the whole environment steps nearest to it
PATIENCE = 3.0  # s: a turn whose predecessor is never as far along as it should be is commanded then

ANGLE = Option(math.radians(10.0), math.pi, "a commanded turn, rad")
ANGLE_SIGNED = Option(-math.pi, math.pi, "commanded turn, rad, positive to the left")
WAIT = Option(0.0, 10.0, "time until a command, s")


class Course(NamedTuple):
    """Turns commanded to B fish, at most K each, and how far each fish is with the last one."""

    angle: np.ndarray  # (B,K) rad; once commanded, from where the fish pointed then
    wait: np.ndarray  # (B,K) s after the command before (or the start) at which it is commanded at the latest
    part: np.ndarray  # (B,K) of the turn before, after which it is commanded already; infinite: by time alone
    count: np.ndarray  # (B,) turns that will be commanded
    stage: np.ndarray  # (B,) turns commanded so far
    heading: np.ndarray  # (B,) commanded heading, rad
    since: np.ndarray  # (B,) s since the last command
    yaw: np.ndarray  # (B,) where the fish points, rad
    facing: np.ndarray  # (B,) the same, counted on beyond pi
    origin: np.ndarray  # (B,) facing at the last command
    history: np.ndarray  # (B,2W-1) facing after the last environment steps, W of them a beat
    steps: np.ndarray  # (B,) since the start


class Record(NamedTuple):
    """Measurements of the last commanded turn; NaN until measured."""

    latency: np.ndarray  # (B,) s from command to 90 % of the turn
    overshoot: np.ndarray  # (B,) rad beyond the commanded heading, the oscillation with the tail beat removed
    path: np.ndarray  # (B,) m swum from command to 90 % of the turn
    radius: np.ndarray  # (B,) m, path over angle turned by then
    rate: np.ndarray  # (B,) rad/s, the fastest turning within an environment step since the first command
    before: np.ndarray  # (B,) m/s at the first command
    after: np.ndarray  # (B,) m/s at 90 % of the last turn


def make_records(kind, shapes):
    """A NamedTuple of zeros: floats, or whole numbers where the shape is given as a list."""
    return kind(*(np.zeros(s, dtype=np.int64 if isinstance(s, list) else float) for s in shapes))


@kernel
def track_commands(pose, task, b):
    """Measure where fish b points, and command its next turn if it is due."""
    course, record, interval = task.course, task.record, task.interval
    window = course.history.shape[1]
    forward, velocity = pose.axes[b, FORWARD], pose.velocity[b]
    yaw = math.atan2(forward.y, forward.x)
    turn = wrap_angle(yaw - course.yaw[b])
    course.yaw[b] = yaw
    course.facing[b] += turn
    course.history[b, course.steps[b] % window] = course.facing[b]
    course.steps[b] += 1
    course.since[b] += interval
    most = course.angle.shape[1]  # whatever a user writes into the course
    turned, wanted, stage = course.facing[b] - course.origin[b], 0.0, min(course.stage[b], most)
    if stage > 0:
        wanted = course.angle[b, stage - 1]
        side = 1.0 if wanted > 0.0 else -1.0
        record.rate[b] = max(record.rate[b], abs(turn) / interval)
        if math.isnan(record.latency[b]):
            way = pose.centre[b] - task.before[b]
            record.path[b] += math.hypot(way.x, way.y)
            left = abs(wrap_angle(course.heading[b] - yaw))  # to turn, whichever way round it came
            if side * turned >= COMPLETE * abs(wanted) or left <= (1.0 - COMPLETE) * abs(wanted):
                record.latency[b] = course.since[b]
                record.radius[b] = record.path[b] / abs(turned) if abs(turned) > LEAST_TURN else math.nan  # (53)
                record.after[b] = math.hypot(velocity.x, velocity.y)
                record.overshoot[b] = 0.0
        elif course.since[b] >= window * interval - 1e-9:  # no heading from before the command is in the average
            beyond = side * (steady_facing(course, b) - course.origin[b]) - abs(wanted)
            record.overshoot[b] = max(record.overshoot[b], beyond)
    if 0 <= stage < min(course.count[b], most):
        due = stage > 0 and turned * wanted >= course.part[b, stage] * wanted * wanted
        if due or course.since[b] >= course.wait[b, stage] - 1e-9:
            if stage == 0:
                record.before[b] = math.hypot(velocity.x, velocity.y)
                commanded = course.angle[b, 0]
                course.angle[b, 0] = commanded + wrap_angle(course.heading[b] - yaw)
                course.heading[b] = wrap_angle(course.heading[b] + commanded)
            else:
                course.heading[b] = wrap_angle(yaw + course.angle[b, stage])
            course.stage[b] += 1
            course.since[b] = 0.0
            course.origin[b] = course.facing[b]
            record.latency[b] = record.overshoot[b] = record.radius[b] = record.after[b] = math.nan
            record.path[b] = 0.0


@kernel
def mean_facing(course, b):
    """Mean direction of fish b over about the last beat, rad, unwrapped beyond pi."""
    window, now = course.history.shape[1], course.steps[b]
    kept = min(now, (window + 1) // 2)
    total = 0.0
    for k in range(1, kept + 1):  # environment steps ago
        total += course.history[b, (now - k) % window]
    return total / kept if kept > 0 else course.facing[b]


@kernel
def steady_facing(course, b):
    """Mean direction, averaged twice over a beat, rad: the heading error is measured with it."""
    # Nobody beats at exactly this rate: of an oscillation at 3.3 to 4.6 Hz up to a sixth is left by one average, 3 % by
    # two (of environment steps of 20 ms, at which everything is measured).
    window, now = course.history.shape[1], course.steps[b]
    total = weights = 0.0
    for k in range(1, min(now, window) + 1):
        weight = (window + 1) // 2 - abs(k - 1 - window // 2)
        total += weight * course.history[b, (now - k) % window]
        weights += weight
    return total / weights if weights > 0.0 else course.facing[b]


@kernel
def overshoot_angle(task, b):
    """Angle by which fish b has turned beyond its last command, on average over a beat, rad, at most half a turn."""
    # The bound limits the penalty of a fish that spins. The term is 0 before the turn is made, and for a beat after the
    # command: the average is still over the turn before.
    course = task.course
    stage = min(course.stage[b], course.angle.shape[1])
    if stage <= 0 or course.since[b] < task.beat:
        return 0.0
    wanted = course.angle[b, stage - 1]
    turned = (mean_facing(course, b) - course.origin[b]) * (1.0 if wanted > 0.0 else -1.0)
    return min(max(turned - abs(wanted), 0.0), math.pi)


@kernel
def measure_strain(tank, strain, b):
    """Raise strain[b] to the largest |length / natural length - 1| of any spring of fish b."""
    x, nodes = tank.position, tank.spring_nodes
    for e in range(tank.spring_length.size):
        r = x[b, INDEX(nodes[e, 1])] - x[b, INDEX(nodes[e, 0])]
        strain[b] = max(strain[b], abs(sqrt(dot(r, r)) / tank.spring_length[e] - 1.0))


@kernel
def write_vectors(tank, pose, task, b, out):
    """Write the commanded heading, a unit vector."""
    out[b, 0] = task.heading[b]


@kernel
def write_terms(tank, pose, task, b, terms):
    """Write progress along the commanded heading, alignment, effort, overshoot and sway; advance the course."""
    heading = task.heading[b]
    terms[0, b] = rewards.progress(tank, pose, task.before, task.heading, b)  # (46)
    terms[1, b] = rewards.alignment(pose, heading, b) * (task.alignment_weight * task.interval)  # (50)
    terms[2, b] = rewards.effort(tank, task.effort_weight, task.interval, b)  # (48)
    if task.overshoots:
        terms[3, b] = overshoot_angle(task, b) * (-2.0 / math.pi * task.overshoot_weight * task.interval)  # (51)
    if task.sways:
        terms[4, b] = rewards.sway(tank, pose, task.sway_weight, task.interval, b)  # (49)
    measure_strain(tank, task.strain, b)
    track_commands(pose, task, b)
    task.before[b] = pose.centre[b]
    angle = task.course.heading[b]
    task.heading[b] = vec3(math.cos(angle), math.sin(angle), 0.0)


class CommandedTurns(CompiledTask):
    """Swim along a commanded heading that changes: the part that tasks with commanded turns share.

    A task says in `draw_turns` which turns it commands: one of a random `angle`, after a `wait`, or its own.
    """

    most_turns = 1
    angle: tuple[float, float]  # rad, and s before the command: from which the one turn is drawn
    wait: tuple[float, float]
    weights = {
        "alignment_weight": ALIGNMENT_WEIGHT,
        "effort_weight": rewards.EFFORT_WEIGHT,
        "sway_weight": rewards.SWAY_WEIGHT,
        "overshoot_weight": OVERSHOOT_WEIGHT,
    }
    term_names = ("progress", "alignment", "effort", "overshoot", "sway")
    episode_steps = 250
    directions = (Direction("commanded heading", "in the body frame", 1.0, 0.3),)
    write_vectors, write_terms = write_vectors, write_terms

    def prepare(self, tank: Tank, interval):
        """Make the arrays for the fish of a tank."""
        beat = max(1, round(MEAN_TIME / interval))  # environment steps: 13 of 20 ms, 6 of 40 ms
        b, k, w = tank.num_fish, self.most_turns, 2 * beat - 1
        self.interval, self.beat = interval, beat * interval - 1e-9
        self.course = make_records(
            Course, [(b, k), (b, k), (b, k), [b], [b], (b,), (b,), (b,), (b,), (b,), (b, w), [b]]
        )
        self.record = make_records(Record, [(b,)] * 7)
        self.strain = np.zeros(b)  # the largest |length / natural length - 1| of any spring after a step
        self._before, self._start, self._heading = (np.zeros((b, 3)) for _ in range(3))
        self.pack = Pack("turns", **self.fields())

    def fields(self) -> dict:
        """Data that the kernels read and write."""
        return {
            "course": Pack("course", **self.course._asdict()),
            "record": Pack("record", **self.record._asdict()),
            "strain": self.strain,
            "before": Vectors(self._before, Kind(1)),
            "heading": Vectors(self._heading, Kind(1)),
            "interval": float(self.interval),
            "beat": float(self.beat),
            "over": np.zeros(len(self._before), dtype=bool),
            "overshoots": "overshoot" in self.term_names,
            "sways": "sway" in self.term_names,
            "sway_weight": 0.0,
            "overshoot_weight": 0.0,
            **self.weight_values(),
        }

    def start(self, tank: Tank, i, generator, options):
        """Place the fish at the origin with a random yaw, almost at rest, heading where it points; set its turns."""
        yaw = options.get("yaw", generator.uniform(-np.pi, np.pi))
        self._before[i] = self._start[i] = place(tank, i, generator, yaw, options)
        course = self.course
        for array in (*course, *self.record, self.strain):
            array[i] = 0
        self.record.latency[i] = self.record.overshoot[i] = self.record.radius[i] = self.record.after[i] = np.nan
        course.yaw[i] = course.facing[i] = course.origin[i] = course.heading[i] = yaw
        course.part[i] = np.inf
        self.draw_turns(i, generator, options)
        self._heading[i] = heading_vector(yaw)

    def draw_turns(self, i, generator, options) -> None:
        """Set the course of fish i: count, angle, wait and part. Here one turn, commanded by time."""
        angle, side = generator.uniform(*self.angle), generator.choice([-1.0, 1.0])
        self.course.count[i] = 1
        self.course.angle[i, 0] = options.get("turn", side * angle)
        self.course.wait[i, 0] = options.get("wait", generator.uniform(*self.wait))

    def metrics(self, tank: Tank, i, seconds):
        """Metrics of the last commanded turn; angles in degrees, lengths in body lengths."""
        course, record, length = self.course, self.record, tank.fish.length
        error = abs(wrap_angle(course.heading[i] - steady_facing(course, i)))
        made = bool(course.stage[i] == course.count[i] and np.isfinite(record.latency[i]))
        settled = bool(error <= SETTLED)
        return {
            "success": made and settled,
            "settled": settled,
            "heading_error": float(np.degrees(error)),
            "latency": float(record.latency[i]),
            "overshoot": float(np.degrees(record.overshoot[i])),
            "radius": float(record.radius[i] / length),
            "turning_rate": float(np.degrees(record.rate[i])),
            "speed_lost": float(1.0 - record.after[i] / record.before[i]) if record.before[i] > 0 else np.nan,
            "turn": float(np.degrees(course.angle[i, course.stage[i] - 1])) if course.stage[i] else 0.0,
            "peak_strain": float(self.strain[i]),
            "speed": float(np.linalg.norm(self._before[i] - self._start[i]) / length / seconds),
        }
