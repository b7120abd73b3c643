"""How much faster could the fish swim? Direct optimal control of a whole episode, beside gait and trained policy.

    python -m benchmarks.learning.optimal_control     writes results/optimal_control.csv (half an hour on a core)

The command of every segment's sides, for every 20 ms of the 5 s of an episode of Swim-v0 from rest, is a variable of
its own, as a policy may set it: no stroke is repeated and no waveform is assumed. L-BFGS-B maximises the distance from
start to end, with gradients by forward differences of one batch of fish, until it no longer improves. It begins with
what the trained policy commands, with the gait, and with random commands; from the best that it found it begins again
several times, every command disturbed.
"""

import argparse

import numpy as np
from scipy.optimize import minimize
from tqdm import tqdm

from benchmarks.common.tables import write_csv
from fish_env import Tank, make_fish
from fish_env.control import best_gait, load_policy, make_policy_env, policy_controller, shipped_policy

COMMAND = "python -m benchmarks.learning.optimal_control"
SECONDS = 5.0  # of an episode
DIFFERENCE = 1e-3  # of a command, by which the gradient is taken
DISTURBED = 0.15  # standard deviation of a disturbance of the commands, all of it being 1


class Episode:
    """Fish from rest under commands (P,6): sides of segments, for every control interval."""

    def __init__(self, threads: int):
        self.fish = make_fish()
        self.periods = round(SECONDS / self.fish.control_interval)
        self.size = 6 * self.periods
        self.muscle = self.fish.grouping("pairs")
        self.tank = Tank(self.fish, 1 + self.size, water=self.fish.water, threads=threads)
        self.steps = round(self.fish.control_interval / self.tank.dt)
        self.mass = self.fish.body.mass / self.fish.body.mass.sum()

    def speeds(self, commands: np.ndarray) -> np.ndarray:
        """Distance between start and end over time, body lengths/s, of commands (B,P,6), B no more than fish."""
        self.tank.reset()
        full = np.zeros((self.tank.num_fish, self.fish.num_muscles))
        for k in range(self.periods):
            full[: len(commands)] = commands[:, k, self.muscle]
            self.tank.drive(full, self.steps)
        way = self.mass @ (self.tank.position - self.fish.body.position)
        speed = np.linalg.norm(way[:, :2], axis=1) / self.fish.length / SECONDS
        return np.where(self.tank.alive, speed, -1.0)[: len(commands)]

    def slowness(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the speed, and its gradient; differences go inward at the bounds."""
        sign = np.where(point > 0.5, -1.0, 1.0)
        points = np.concatenate([point[None], point + DIFFERENCE * np.diag(sign)])
        speed = self.speeds(points.reshape(-1, self.periods, 6))
        return -speed[0], -(speed[1:] - speed[0]) / (DIFFERENCE * sign)


def of_pairs(contraction: np.ndarray) -> np.ndarray:
    """Commands (P,6) of contractions (P,12): the means of the muscles of a side."""
    fish = make_fish()
    first = [int(np.flatnonzero(fish.grouping("pairs") == group)[0]) for group in range(6)]
    pairs = np.stack(
        [contraction[:, fish.grouping("pairs") == group].mean(axis=1) for group in range(len(first))], axis=1
    )
    return np.clip(pairs, 0.0, 1.0)


def starts() -> dict[str, np.ndarray]:
    """Commands (P,6) to begin with."""
    fish, count = make_fish(), round(SECONDS / make_fish().control_interval)
    times = fish.control_interval * np.arange(1, count + 1)
    policy, commanded = load_policy(shipped_policy("swim")), []
    env = make_policy_env(policy, 1)
    control = policy_controller(policy, env)
    obs, _ = env.reset(seed=0)
    for k in range(count):
        obs, *_ = env.step(control(obs, k * fish.control_interval))
        commanded.append(env._contraction[0].copy())
    env.close()
    return {"trained policy": of_pairs(np.array(commanded)), "gait": of_pairs(best_gait().contraction(fish, times))}


def climb(episode: Episode, commands: np.ndarray, iterations: int, name: str) -> tuple[dict, np.ndarray]:
    """A row with what L-BFGS-B makes of commands (P,6), and what they have become."""
    before = float(episode.speeds(commands[None])[0])
    with tqdm(total=iterations, desc=name, mininterval=10) as bar:
        found = minimize(
            episode.slowness, commands.ravel(), jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * episode.size,
            options={"maxiter": iterations, "maxfun": 10**6, "ftol": 1e-6},
            callback=lambda intermediate_result: (
                bar.update(), bar.set_postfix(speed=f"{-intermediate_result.fun:.3f}")
            ),
        )  # fmt: skip
    row = {
        "begun_with": name, "speed_before": f"{before:.4g}", "speed": f"{-found.fun:.4g}", "iterations": found.nit,
        "evaluations": found.nfev, "message": str(found.message),
    }  # fmt: skip
    print(row, flush=True)
    return row, found.x.reshape(commands.shape)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=150, help="at most, of each search (150)")
    parser.add_argument("--again", type=int, default=5, help="searches from the best one's commands, disturbed (5)")
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    episode, random = Episode(chosen.threads), np.random.default_rng(0)
    begun = starts() | {"random commands": random.uniform(size=(episode.periods, 6))}
    found = [climb(episode, commands, chosen.iterations, name) for name, commands in begun.items()]
    for k in range(chosen.again):
        best = max(found, key=lambda each: float(each[0]["speed"]))[1]
        disturbed = np.clip(best + DISTURBED * random.standard_normal(best.shape), 0.0, 1.0)
        found.append(climb(episode, disturbed, chosen.iterations, f"the best, disturbed ({k + 1})"))
    print(write_csv("optimal_control.csv", [row for row, _ in found], COMMAND))


if __name__ == "__main__":
    main()
