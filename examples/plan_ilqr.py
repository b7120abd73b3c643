"""Plan a turn without learning: iLQR with the exact derivatives of a step, beside random shooting.

    python plan_ilqr.py

A gliding fish is to point to its left after 0.24 s. iLQR (Li & Todorov 2004) improves a plan by the derivatives of its
steps; random shooting takes the best of the bends that it can try in the same time.
"""

import argparse
import time

import numpy as np

import fish_env

HORIZON, ROUNDS = 12, 12  # environment steps that are planned, and improvements of the plan
WEIGHT, EFFORT, DAMPING = 100.0, 0.001, 0.1  # of the error at the end, of actions, and of changes of them
SIZES = 0.5 ** np.arange(8)  # of a change, of which the best is taken


class Problem:
    """A fish, the state where it begins, and the direction where its axis is to point."""

    def __init__(self, seed: int):
        self.env = fish_env.FishEnv(task="swim")
        self.env.reset(seed=seed, options={"yaw": 0.0})
        self.line, self.tank = self.env.tank.fish.line, self.env.tank
        self.tank.velocity[:, :, 0] += self.tank.fish.length  # a body length per second
        self.begin, self.goal = self.env.get_state(), np.array([0.0, 1.0, 0.0])
        self.fibres = np.unique(self.tank.fish.fibres)

    def state(self) -> np.ndarray:
        """Positions, velocities and rest lengths, in the order of the derivatives."""
        parts = self.tank.position[0], self.tank.velocity[0], self.tank.rest_length[0, self.fibres]
        return np.concatenate([part.ravel() for part in parts])

    def error(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axis of the fish minus the direction, (3,), and its derivatives (3,S)."""
        nodes = state[: 3 * len(self.line)].reshape(-1, 3)
        size = np.linalg.norm(self.line @ nodes)
        axis = self.line @ nodes / size
        slope = np.zeros((3, state.size))
        slope[:, : nodes.size] = np.kron(self.line, np.eye(3) - np.outer(axis, axis)) / size
        return axis - self.goal, slope

    def run(self, actions, states=(), gains=None, derivatives=False):
        """Cost, states, actions taken and Jacobians of a plan, with feedback on the distance from other states."""
        self.env.set_state(self.begin)
        found, taken, linear, cost = [self.state()], [], [], 0.0
        for k, action in enumerate(actions):
            if gains is not None:
                action = action + gains[k] @ (found[-1] - states[k])
            action = np.clip(action, -1.0, 1.0)
            if derivatives:
                linear.append(self.env.linearise(action))
            _, _, over, _, _ = self.env.step(action)
            cost += np.inf if over else 0.5 * EFFORT * action @ action
            found.append(self.state())
            taken.append(action)
        error, _ = self.error(found[-1])
        return cost + 0.5 * WEIGHT * error @ error, found, taken, linear

    def angle(self, states) -> float:
        """Angle between the axis at the end and the direction, degrees."""
        error, _ = self.error(states[-1])
        return float(np.degrees(2.0 * np.arcsin(min(1.0, 0.5 * np.linalg.norm(error)))))


def improve(problem: Problem, actions):
    """One round of iLQR: changes (T,A) and gains (T,A,S) of the quadratic model of the cost, from the end backwards."""
    _, states, actions, linear = problem.run(actions, derivatives=True)
    error, slope = problem.error(states[-1])
    value, curvature, changes, gains = WEIGHT * slope.T @ error, WEIGHT * slope.T @ slope, [], []
    for action, (by_state, by_action) in zip(actions[::-1], linear[::-1], strict=True):
        push = EFFORT * action + by_action.T @ value
        inner = by_action.T @ curvature
        solve = np.linalg.inv(inner @ by_action + (EFFORT + DAMPING) * np.eye(len(action)))
        changes.append(-solve @ push)
        gains.append(-solve @ inner @ by_state)
        value = by_state.T @ (value + curvature @ by_action @ changes[-1])
        curvature = by_state.T @ curvature @ (by_state + by_action @ gains[-1])
    return states, np.array(actions), np.array(changes[::-1]), np.array(gains[::-1])


def ilqr(problem: Problem) -> float:
    """Angle that is left after the best plan."""
    plan = -0.9 * np.ones((HORIZON, problem.tank.fish.num_muscles))
    best, states, plan, _ = problem.run(plan)
    for _ in range(ROUNDS):
        states, plan, changes, gains = improve(problem, plan)
        tried = [problem.run(plan + size * changes, states, gains) for size in SIZES]
        cost, after, taken, _ = min(tried, key=lambda one: one[0])
        if cost >= best:
            break
        best, states, plan = cost, after, taken
        print(f"  iLQR: cost {cost:.2f}, {problem.angle(states):.1f} degrees left")
    return problem.angle(states)


def shoot(problem: Problem, seconds: float, generator: np.random.Generator) -> float:
    """Angle that is left after the best of random bends, of random sizes and times, found in this time."""
    sides, best, end = problem.tank.fish.sides, (np.inf, 0.0), time.perf_counter() + seconds
    while time.perf_counter() < end:
        first, second = np.sort(generator.integers(0, HORIZON + 1, 2))
        size = generator.uniform(-1.0, 1.0, (3, 1))
        bend = size[np.digitize(np.arange(HORIZON), [first, second])]
        cost, states, _, _ = problem.run(np.clip(bend * sides, -1.0, 1.0))
        best = min(best, (cost, problem.angle(states)))
    return best[1]


def main() -> None:
    """Plan from some states, and print what is left to turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=3)
    for seed in range(parser.parse_args().plans):
        problem = Problem(seed)
        problem.env.linearise(np.zeros(problem.tank.fish.num_muscles))  # compiles
        begin = time.perf_counter()
        planned = ilqr(problem)
        seconds = time.perf_counter() - begin
        shot = shoot(problem, seconds, np.random.default_rng(seed))
        print(f"plan {seed}: iLQR leaves {planned:.1f} of 90 degrees after {seconds:.1f} s, shooting {shot:.1f}")


if __name__ == "__main__":
    main()
