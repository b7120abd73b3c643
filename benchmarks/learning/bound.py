"""What is the best that the muscles can do? Commands by optimal control, beside motor controllers and shipped policy.

A start is a fish that the motor controllers, or the shipped policy, have swum with until the last command of an
evaluation episode, in Swim until it is steady. From this state both go on, and CMA-ES searches for commands. It begins
with the better ones of the two, which it never falls behind, and changes them every 40 ms in each segment, to the left
or to the right. Fast strokes are unstable without feedback. In fast starts the controller therefore goes on under the
changes, which end soon. A steady swimmer executes only the beginning of a plan, and plans again from there (a receding
horizon); the controller that it began with goes on after the plan.

A search shows what can be reached. How far its seeds are apart tells how far it may be from the best. For turns, one
more search looks for the largest return of the next time, by the weights of the policy's training, in which the
controller goes on after the changes: its latency is what the reward asks for.
"""

from collections.abc import Callable
from itertools import chain
from typing import NamedTuple

import numpy as np

from benchmarks.common.search import minimise
from benchmarks.common.statistics import interval_of, rounded
from benchmarks.common.tables import make_parser, replace_rows
from fish_env.control import FIRST_SEED, Controller, as_controller, load_policy, scripted, shipped_policies
from fish_env.envs import FishState, FishVectorEnv
from fish_env.tasks.fast_start import FastStartTask
from fish_env.tasks.rewards import wrap_angle
from fish_env.tasks.turns import COMPLETE, CommandedTurns
from fish_env.training.config import CONFIGS

COMMAND, CSV = "python -m benchmarks.learning.bound", "learning/bound.csv"
POPULATION = 256  # fish that try commands, each its own
HELD = 0.04  # s for which a change of the commands is held
SPREAD, MOST = 0.5, 2.0  # of the changes of actions: standard deviation at first; bound, from one end to the other
LONGEST = 2.0  # s after its command that a turn is followed
CRUISE, STEADY = 2.5, 1.5  # s that a fish swims before and after the start; at their end those that are measured
HORIZON, PLANNED, AGAIN = 1.0, 0.4, 0.12  # s that a plan looks ahead, that it changes, and that are executed of it
SHARE = 0.1  # of the budget, for each plan
RETURNS, NEXT = 1.2, 0.4  # s after a command whose rewards are summed; in which commands are changed for them


class Start(NamedTuple):
    """A fish at its command."""

    seed: int  # of the episode
    state: FishState
    commands: np.ndarray  # (K,A) actions of its controller from there on, as long as is measured
    wanted: float  # rad, the commanded turn, positive to the left; NaN if none is commanded


class Swum(NamedTuple):
    """What B fish have done in K control intervals from a start; NaN for those that the physics failed."""

    turned: np.ndarray  # (K+1,B) rad
    way: np.ndarray  # (K+1,B) body lengths along the commanded heading
    interval: float  # s
    commands: np.ndarray  # (K,A) actions of the first fish
    rewards: np.ndarray  # (K,B)


Found = tuple[np.ndarray, np.ndarray]
"""A quantity of B fish, (B,), NaN where it is not reached, and what a search minimises in its place, (B,)."""


def measure_latency(swum: Swum, wanted: float) -> Found:
    """Time to 90 % of the turn as the task measures it, s, interpolated within the control interval."""
    left = np.abs(wrap_angle(wanted - swum.turned))
    part = np.maximum(swum.turned / wanted, 1.0 - left / abs(wanted))
    first, each = (part >= COMPLETE).argmax(axis=0), np.arange(part.shape[1])
    before, after = part[first - 1, each], part[first, each]
    steps = np.where(first > 0, first - (after - COMPLETE) / np.where(first > 0, after - before, 1.0), np.nan)
    lacking = (len(part) - 1) * swum.interval + COMPLETE - part.max(axis=0)
    return steps * swum.interval, np.where(first > 0, steps * swum.interval, lacking)


def measure_rewarded(swum: Swum, wanted: float) -> Found:
    """The latency of fish whose return is what a search looks for."""
    steps = round(RETURNS / swum.interval)
    total = swum.rewards[:steps].sum(axis=0)
    return measure_latency(swum, wanted)[0], -total if len(swum.rewards) >= steps else np.full(total.shape, np.nan)


def measure_way(swum: Swum, wanted: float) -> Found:
    """Distance along the commanded heading, body lengths."""
    return swum.way[-1], -swum.way[-1]


def measure_speed(swum: Swum, wanted: float) -> Found:
    """Speed along the commanded heading of a fish that has swum steadily for a while, body lengths/s."""
    begin, end = (round(time / swum.interval) for time in (CRUISE - STEADY, CRUISE))
    speed = (swum.way[end] - swum.way[begin]) / STEADY
    return speed, -speed


Measure = Callable[[Swum, float], Found]
REWARDED = "latency of the largest return"
TURNS: dict[str, Measure] = {"latency": measure_latency, REWARDED: measure_rewarded}
GOALS: dict[str, dict[str, Measure]] = {
    "turn": TURNS,
    "left_after_right": TURNS,
    "fast_start": {"escape distance": measure_way},
    "swim": {"speed": measure_speed},
}
"""What is measured in each task."""


def find_starts(env: FishVectorEnv, controller: Controller) -> list[Start]:
    """The starts of the first evaluation episodes, one a fish, under a controller.

    Raises:
        ArithmeticError: if the physics fails.
    """
    task, interval, actions, begun = env.task, env.control_interval, [], {}
    turns = isinstance(task, CommandedTurns)
    length = round((LONGEST if turns else CRUISE + HORIZON) / interval)
    obs, _ = env.reset(seed=FIRST_SEED)
    while len(begun) < env.num_envs or len(actions) < max(end for _, end, *_ in begun.values()):
        k = len(actions)
        told = task.course.stage == task.course.count if turns else [k >= round(CRUISE / interval)] * env.num_envs
        for i in set(np.flatnonzero(told).tolist()) - begun.keys():
            end = task.episode_steps if isinstance(task, FastStartTask) else k + length
            wanted = float(task.course.angle[i, task.course.count[i] - 1]) if turns else np.nan
            begun[i] = k, end, env.get_state([i]), wanted
        actions.append(controller(obs, k * interval))
        obs, _, terminated, *_ = env.step(actions[-1])
        if terminated.any():
            raise ArithmeticError(f"the physics fails before the command: {env.tank.failure}")
    commands = np.array(actions)
    return [
        Start(FIRST_SEED + i, state, commands[k:end, i], wanted) for i, (k, end, state, wanted) in sorted(begun.items())
    ]


def drive(env: FishVectorEnv, state: FishState, control: Controller, steps: int) -> Swum:
    """Let all fish go on from a state by a controller, whose time begins with it."""
    obs, interval, pose = env.set_state(state), env.control_interval, env._pose
    failed, begin, heading = np.zeros(env.num_envs, dtype=bool), pose.centre.copy(), env._vectors[:, 0].copy()
    yaw, way, commands, rewards = [], [], [], []
    for k in range(steps + 1):
        yaw.append(np.arctan2(pose.axes[:, 0, 1], pose.axes[:, 0, 0]))
        way.append(((pose.centre - begin) * heading).sum(axis=1) / env.tank.fish.length)
        if k < steps:
            action = np.broadcast_to(control(obs, k * interval), env.action_space.shape)
            commands.append(action[0].copy())
            obs, reward, terminated, *_ = env.step(action)
            rewards.append(reward.copy())
            failed |= terminated
    turned = np.unwrap(yaw, axis=0)
    turned, way, total = (np.where(failed, np.nan, values) for values in (turned - turned[0], way, np.array(rewards)))
    return Swum(turned, way, interval, np.array(commands), total)


def recorded(commands: np.ndarray, interval: float) -> Controller:
    """The controller that gives commands (K,A) by the time alone."""
    return lambda obs, time: commands[round(time / interval)]


class Search(NamedTuple):
    """A search for changes of what a controller commands from a start.

    A point (N,) has a number for each segment and each time of HELD: positive ones contract the left side, and relax
    the right one.
    """

    env: FishVectorEnv
    start: Start
    control: Controller
    measure: Measure
    steps: int  # control intervals that are swum
    changed: int  # the first of them, in which commands are changed

    def swim(self, points: np.ndarray) -> Swum:
        """Swim with the changes of points (B,N), or (1,N) for all fish."""
        fish, first, interval = self.env.tank.fish, self.env.first_muscle_of_group, self.env.control_interval
        change = np.reshape(points, (len(points), -1, fish.segments.max() + 1)).swapaxes(0, 1)
        change = fish.sides[first] * change[..., fish.segments[first]]

        def act(obs: np.ndarray, time: float) -> np.ndarray:
            action, k = self.control(obs, time), round(time / interval)
            return np.clip(action + change[int(k * interval / HELD + 1e-9)], -1.0, 1.0) if k < self.changed else action

        return drive(self.env, self.start.state, act, self.steps)

    def best(self, budget: int, seed: int, begin: np.ndarray | None = None) -> np.ndarray:
        """The best point that is found, or the one to begin with; without it, nothing is changed at first."""
        if begin is None:
            times = int(np.ceil(self.changed * self.env.control_interval / HELD - 1e-9))
            begin = np.zeros(times * (self.env.tank.fish.segments.max() + 1))

        def costs(points) -> np.ndarray:
            return np.nan_to_num(self.measure(self.swim(np.array(points)), self.start.wanted)[1], nan=1e3)

        point, least = minimise(
            costs, begin, SPREAD, budget, seed, self.env.num_envs,
            each=lambda costs, points: costs(points), bounds=[-MOST, MOST],
        )  # fmt: skip
        return point if least < costs([begin])[0] else begin


def swim_planned(env: FishVectorEnv, start: Start, control: Controller, budget: int, seed: int) -> Swum:
    """Swim by plans: changes of the next commands with which a fish comes farthest if the controller then goes on."""
    interval = env.control_interval
    total, horizon, changed, again = (round(time / interval) for time in (CRUISE, HORIZON, PLANNED, AGAIN))
    commands, state, point = [], start.state, None
    while len(commands) < total:
        begun = len(commands) * interval
        plan = Search(
            env, start._replace(state=state), lambda obs, time, begun=begun: control(obs, begun + time), measure_way,
            horizon, changed,
        )  # fmt: skip
        point = plan.best(max(1, round(SHARE * budget)), seed, point)
        commands += list(plan._replace(steps=again).swim(point[None]).commands)
        state, past = env.get_state([0]), round(point.size * AGAIN / PLANNED)
        point = np.append(point[past:], np.zeros(past))
    return drive(env, start.state, recorded(np.array(commands), interval), total)


def search(env: FishVectorEnv, start: Start, control: Controller, measure: Measure, budget: int, seed: int) -> Swum:
    """Swim as well as a search finds, which begins with what a controller commands from a start."""
    if measure is measure_speed:
        return swim_planned(env, start, control, budget, seed)
    steps = changed = len(start.commands)
    if measure is measure_rewarded:
        steps, changed = (round(time / env.control_interval) for time in (RETURNS, NEXT))
    elif measure is measure_way:
        changed = round(PLANNED / env.control_interval)
    elif measure is measure_latency:
        swum = drive(env, start.state, control, steps)
        control, latency = recorded(swum.commands, env.control_interval), measure_latency(swum, start.wanted)[0][0]
        if np.isfinite(latency):  # what comes later does not count
            steps = changed = min(steps, int(np.ceil(latency / env.control_interval - 1e-9)))
    found = Search(env, start, control, measure, steps, changed)
    return found.swim(found.best(budget, seed)[None])


def score(swum: Swum, measure: Measure, wanted: float) -> tuple[float, float]:
    """Cost and value of the first fish."""
    value, cost = measure(swum, wanted)
    return float(np.nan_to_num(cost[0], nan=1e3)), float(value[0])


def rows_of(task: str, starts: int, budget: int, seeds: int, **options) -> list[dict]:
    """A row for each quantity and start of a task; `options` are keywords of the environment.

    Muscles are grouped as the shipped policy commands them; a search changes whole segments of a side anyway. The
    reward has the weights of its training.
    """
    path, rows = shipped_policies().get(task), []
    policy = None if path is None else load_policy(path)
    groups = "muscles" if policy is None else policy.about["env_options"].get("muscle_groups", "muscles")
    weights = {name: value for name, value in CONFIGS[task].training_options.items() if name.endswith("_weight")}
    options = {"muscle_groups": groups} | weights | options
    few, env = (FishVectorEnv(count, task=task, **options) for count in (starts, POPULATION))
    before = {"motor_controllers": scripted(few)}
    if policy is not None:
        before["policy"] = as_controller(policy, few)
    begun = [(who, start) for who, controller in before.items() for start in find_starts(few, controller)]
    for swum_by, start in begun:
        controls = {"motor_controllers": scripted(env)} | (
            {} if policy is None else {"policy": as_controller(policy, env)}
        )
        feedback = dict(controls)
        if swum_by == "motor_controllers":  # which have a memory
            controls[swum_by] = recorded(start.commands, env.control_interval)
        known = {who: drive(env, start.state, control, len(start.commands)) for who, control in controls.items()}
        found = {}
        for quantity, measure in GOALS[task].items():
            better = min(known, key=lambda who: score(known[who], measure, start.wanted))
            control = (feedback if measure in (measure_rewarded, measure_way) else controls)[better]
            found[quantity] = [search(env, start, control, measure, budget, seed + 1) for seed in range(seeds)]
        for quantity, measure in GOALS[task].items():  # what one search finds may be the best for another quantity
            values = {who: score(swum, measure, start.wanted)[1] for who, swum in known.items()}
            everything = [*known.values(), *chain.from_iterable(found.values())]
            values["bound"] = min(score(swum, measure, start.wanted) for swum in everything)[1]
            values["seeds_apart"] = np.ptp([score(swum, measure, start.wanted)[1] for swum in found[quantity]])
            about = {"task": task, "quantity": quantity, "seed": start.seed, "swum_by": swum_by,
                     "turn": rounded(np.degrees(start.wanted))}  # fmt: skip
            rows.append(about | {"policy": ""} | {name: rounded(value) for name, value in values.items()})
    for each in (few, env):
        each.close()
    return rows


def summarise(rows: list[dict]) -> str:
    """A line for each task, quantity and start: the bound's mean with its interval, and others beside it."""
    lines, columns = [], ("bound", "seeds_apart", "motor_controllers", "policy")
    kinds = dict.fromkeys((row["task"], row["quantity"], row["swum_by"]) for row in rows)
    for task, quantity, swum_by in kinds:
        chosen = [row for row in rows if (row["task"], row["quantity"], row["swum_by"]) == (task, quantity, swum_by)]
        table = np.array([[np.nan if row[name] == "" else row[name] for name in columns] for row in chosen], float)
        table = table[np.isfinite(table[:, 0])]
        line = f"{task}, {quantity}, after {swum_by}: reached in {len(table)} of {len(chosen)} starts"
        if len(table):
            line += ", bound {:.3f} ({:.3f} to {:.3f})".format(*interval_of(table[:, 0]))
            line += f", seeds apart by at most {np.fmax.reduce(table[:, 1]):.3f}"
        for name, values in zip(columns[2:], table[:, 2:].T, strict=True):
            if (both := np.isfinite(values)).any():
                ratio = values[both].mean() / table[both, 0].mean()
                line += f"; {name} {values[both].mean():.3f} in {both.sum()}, {ratio:.3f} times the bound"
        lines.append(line)
    return "\n".join(lines)


def main() -> None:
    """The command line."""
    parser = make_parser(__doc__)
    parser.add_argument("tasks", nargs="*", default=list(GOALS), help=f"rows of these again: {', '.join(GOALS)}; all")
    efforts = {"budget": (100, "generations of a search"), "starts": (8, "episodes of each task"),
               "seeds": (2, "searches from each start")}  # fmt: skip
    for name, (usual, text) in efforts.items():
        parser.add_argument(f"--{name}", type=int, default=usual, help=f"{text}, {usual}; with others it only prints")
    chosen = parser.parse_args()
    if unknown := set(chosen.tasks) - GOALS.keys():
        parser.error(f"unknown tasks {', '.join(sorted(unknown))}; choose from {', '.join(GOALS)}")
    rows = []
    for task in chosen.tasks:
        rows += rows_of(task, chosen.starts, chosen.budget, chosen.seeds)
    print(summarise(rows))
    if all(getattr(chosen, name) == usual for name, (usual, _) in efforts.items()):
        print(replace_rows(CSV, rows, GOALS, COMMAND))


if __name__ == "__main__":
    main()
