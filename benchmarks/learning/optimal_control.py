"""How much faster could the fish swim? Optimal control with a receding horizon, beside gait and trained policy.

    python -m benchmarks.learning.optimal_control              results/optimal_control.csv (half an hour on a core)
    python -m benchmarks.learning.optimal_control --feedback   recorded commands of the policy, changed by little:
                                                               results/optimal_control_feedback.csv (seconds)

The commands of every segment's sides, for every 20 ms of the next 0.4 to 1 s, are variables of their own: no stroke is
repeated and no waveform is assumed. L-BFGS-B maximises the distance from where the episode of 5 s began, with gradients
by differences of one batch of fish; the fish carries the first 0.1 s out, and the rest is planned again from where it
is then. Searches begin with what the trained policy commands, with the gait, and with random commands.

Why not all 5 s in one search? Fast strokes are unstable without feedback: the recorded commands of the policy, changed
by a hundred-thousandth, are slower by some per cent after 5 s, so that differences say nothing about the slope. The
fish would have to swim by commands that nobody corrects. Planning again is a feedback, as the policy is one.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

from benchmarks.common.tables import write_csv
from fish_env import Tank
from fish_env.control import best_gait, load_policy, make_policy_env, policy_controller, shipped_policy

COMMAND = "python -m benchmarks.learning.optimal_control"
SECONDS = 5.0  # of an episode
STEADY = 2.5  # s, after which a fish swims steadily
HORIZONS = (0.4, 0.6, 0.8, 1.0)  # s
AGAIN = 0.1  # s, until plans are made again
RANDOM = 3  # searches that begin with random commands
DIFFERENCE = 1e-2  # of a command, by which the gradient is taken
DEVIATIONS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2, 0.1)  # standard deviations of a change of recorded commands
REPLAYS = 100

Continuation = Callable[[int], np.ndarray]
"""What a search begins with: commands (count,6) from where the fish of the episode is."""


class Episode:
    """A fish from rest that executes commands (6,) of the sides of its segments, observed as a policy observes it."""

    def __init__(self):
        self.policy = load_policy(shipped_policy("swim"))
        self.env = make_policy_env(self.policy, 1, max_episode_steps=100_000)
        self.tank, self.fish = self.env.tank, self.env.tank.fish
        self.pairs = self.fish.grouping("pairs")
        self.mass = self.fish.body.mass / self.fish.body.mass.sum()
        self.control = policy_controller(self.policy, self.env)
        self.begin()

    def begin(self) -> None:
        """Put the fish back to rest; the small disturbance of an episode's start is taken away."""
        self.obs, _ = self.env.reset(seed=0, options={"yaw": 0.0, "heading": 0.0})
        self.tank.reset()
        self.periods, self.last = 0, np.zeros(6)

    def execute(self, command: np.ndarray) -> None:
        """Swim for one control interval."""
        action = (2.0 * command[self.pairs] - 1.0).astype(np.float32)
        self.obs, *_ = self.env.step(action[None])
        self.periods, self.last = self.periods + 1, command

    @contextmanager
    def imagined(self) -> Iterator[None]:
        """Put the fish back afterwards to where it is now."""
        state, obs, periods, last = self.tank.get_state(), self.obs, self.periods, self.last
        yield
        self.tank.set_state(state)
        self.obs, self.periods, self.last = obs, periods, last

    def by_policy(self, count: int) -> np.ndarray:
        """What the trained policy would command next, the same for upper and lower muscles."""
        commands = np.empty((count, 6))
        with self.imagined():
            for k in range(count):
                commands[k] = self.of_sides((self.control(self.obs, 0.0)[0] + 1) / 2)
                self.execute(commands[k])
        return commands

    def by_gait(self, count: int) -> np.ndarray:
        """What the fastest gait commands next."""
        times = self.fish.control_interval * (self.periods + np.arange(1, count + 1))
        return np.array([self.of_sides(contraction) for contraction in best_gait().contraction(self.fish, times)])

    def of_sides(self, values: np.ndarray) -> np.ndarray:
        """Means (6,) of values (12,) over the upper and the lower muscle of every side."""
        return np.clip([values[self.pairs == side].mean() for side in range(6)], 0.0, 1.0)

    def distance(self) -> float:
        """From where the fish began to where it is, body lengths."""
        return float(distances(self.tank, self.mass)[0])


def distances(tank: Tank, mass: np.ndarray) -> np.ndarray:
    """Level distances (B,) from a fish at rest to those of a tank, body lengths."""
    way = mass @ (tank.position - tank.fish.body.position)
    return np.linalg.norm(way[:, :2], axis=1) / tank.fish.length


class Search:
    """Searches for commands (P,6) that take a fish as far as possible, P control intervals of a horizon."""

    def __init__(self, periods: int, episode: Episode, threads: int):
        self.episode, self.periods, self.size = episode, periods, 6 * periods
        self.tank = Tank(episode.fish, 1 + self.size, water=episode.fish.water, threads=threads)
        self.steps = round(episode.fish.control_interval / self.tank.dt)

    def shortfall(self, point: np.ndarray, state: dict) -> tuple[float, np.ndarray]:
        """Minus the distance after the horizon, and its gradient; differences go inward at the bounds."""
        sign = np.where(point > 0.5, -1.0, 1.0)
        points = np.concatenate([point[None], point + DIFFERENCE * np.diag(sign)]).reshape(-1, self.periods, 6)
        self.tank.set_state(state)
        for k in range(self.periods):
            self.tank.drive(points[:, k, self.episode.pairs], self.steps)
        found = np.where(self.tank.alive, distances(self.tank, self.episode.mass), 0.0)
        return -found[0], -(found[1:] - found[0]) / (DIFFERENCE * sign)

    def improved(self, commands: np.ndarray, iterations: int) -> np.ndarray:
        """Better commands (P,6) than these, from where the fish of the episode is."""
        state = {name: np.repeat(v, 1 + self.size, axis=0) for name, v in self.episode.tank.get_state().items()}
        found = minimize(
            self.shortfall, commands.ravel(), args=(state,), jac=True, method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * self.size, options={"maxiter": iterations, "maxfun": 4 * iterations},
        )  # fmt: skip
        return found.x.reshape(commands.shape)


def swum(episode: Episode, plan: Callable[[], np.ndarray], progress: str) -> tuple[float, float]:
    """Speed of a whole episode and of its steady part, body lengths/s, under commands planned again and again."""
    interval = episode.fish.control_interval
    episode.begin()
    with tqdm(total=round(SECONDS / interval), desc=progress, mininterval=10) as bar:
        while bar.n < bar.total:
            for command in plan():
                if bar.n == round(STEADY / interval):
                    half = episode.distance()
                episode.execute(command)
                bar.update()
    whole = episode.distance()
    return whole / SECONDS, (whole - half) / (SECONDS - STEADY)


def planned(episode: Episode, search: Search, plan: np.ndarray, extend: Continuation, iterations: int) -> Callable:
    """A function that returns the commands of the next 0.1 s; every plan begins with what is left of the last one."""
    again = round(AGAIN / episode.fish.control_interval)

    def of_next() -> np.ndarray:
        nonlocal plan
        better = search.improved(plan, iterations)
        with episode.imagined():
            for command in better:
                episode.execute(command)
            plan = np.concatenate([better[again:], extend(again)])
        return better[:again]

    return of_next


def feedback_rows(episode: Episode) -> list[dict]:
    """Speeds under what the policy commanded in an episode, every command changed at random, with nobody to correct."""
    interval, generator, rows = episode.fish.control_interval, np.random.default_rng(0), []
    episode.begin()
    commands = episode.by_policy(round(SECONDS / interval))
    tank = Tank(episode.fish, REPLAYS, water=episode.fish.water)
    for deviation in DEVIATIONS:
        changed = commands + deviation * generator.standard_normal((REPLAYS, *commands.shape))
        changed = np.clip(changed, 0.0, 1.0)
        tank.reset()
        for k in range(len(commands)):
            tank.drive(changed[:, k, episode.pairs], round(interval / tank.dt))
        speed = distances(tank, episode.mass) / SECONDS
        rows.append({
            "deviation": deviation, "speed": f"{speed.mean():.4g}", "least": f"{speed.min():.4g}",
            "most": f"{speed.max():.4g}", "failed": int((~tank.alive).sum()), "replays": REPLAYS,
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=15, help="at most, of each search (15)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--feedback", action="store_true", help="only what becomes of the policy's recorded commands")
    chosen = parser.parse_args()
    episode, rows = Episode(), []
    if chosen.feedback:
        print(write_csv("optimal_control_feedback.csv", feedback_rows(episode), f"{COMMAND} --feedback"))
        return

    def note(name: str, horizon: float | str, speeds: tuple[float, float]) -> None:
        rows.append({"begun_with": name, "horizon": horizon, "speed": f"{speeds[0]:.4g}", "steady": f"{speeds[1]:.4g}"})
        print(rows[-1], flush=True)

    def random(seed: int) -> Continuation:
        """Random commands to begin a search with, and the last command of a plan, held, to extend it."""
        generator = np.random.default_rng(seed)
        return lambda count: (
            np.repeat(episode.last[None], count, axis=0) if episode.periods else generator.uniform(size=(count, 6))
        )

    known = {"trained policy": episode.by_policy, "gait": episode.by_gait}
    for name, extend in known.items():
        note(f"{name}, nothing planned", "", swum(episode, lambda extend=extend: extend(1), name))
    for horizon in HORIZONS:
        periods = round(horizon / episode.fish.control_interval)
        search = Search(periods, episode, chosen.threads)
        for name, extend in (known | {f"random commands {k + 1}": random(k) for k in range(RANDOM)}).items():
            episode.begin()
            plan = planned(episode, search, extend(periods), extend, chosen.iterations)
            note(name, horizon, swum(episode, plan, f"{name}, {horizon} s"))
    print(write_csv("optimal_control.csv", rows, COMMAND))


if __name__ == "__main__":
    main()
