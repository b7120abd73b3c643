"""Scenes on which methods are compared, their reference solutions, and the fish made stiffer, softer, heavier."""

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from fish_env import INTEGRATORS, Fish, Tank, World, make_fish
from fish_env.control import Gait
from fish_env.control.chart import DISTURBANCE, NotConvergedError, converge
from fish_env.physics import body
from fish_env.physics.world import VACUUM
from fish_env.soft.adaptive import solve

LEAD, RIGHT, LEFT, REST = 26, 10, 10, 54  # control intervals of the manoeuvre: swimming, right, left, swimming on
BEAT = 13  # control intervals of a tail beat
AMPLITUDE, LAG = (
    (0.5439, 0.8077, 0.7836),
    (0.0, 0.8347, 5.453),
)  # of a gait: fixed here so that the scenes stay the same
FIXED = [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"]  # methods with given steps
CONVERGED = 2e-9  # body lengths: how little halving its steps may change a reference


@dataclass(frozen=True)
class Problem:
    """A fish, what surrounds it, how it starts and what its muscles are told."""

    name: str
    title: str
    fish: Fish
    world: World
    contraction: np.ndarray
    """(K,M) the muscles' goals in [0, 1], one row a control interval."""
    velocity: np.ndarray | None = None
    """(N,3) m/s at the start; None for rest."""


def scaled(fish: Fish, stiffness=1.0, damping=1.0, mass=1.0) -> Fish:
    """The fish with its springs' stiffness and damping and its nodes' masses multiplied."""
    return replace(fish, body=body.scale_body(fish.body, stiffness, damping, mass))


def swimming(fish: Fish, intervals: int) -> np.ndarray:
    """A good gait of the default fish, (intervals, M), its beat taking BEAT control intervals of any fish."""
    gait = Gait(1.0 / (BEAT * fish.control_interval), AMPLITUDE, LAG)
    return gait.contraction(fish, fish.control_interval * np.arange(1, intervals + 1))


def left_after_right(fish: Fish, right=RIGHT, left=LEFT) -> np.ndarray:
    """The abrupt manoeuvre, (K,M): swim, pull all right muscles, and before that turn is over all left ones, swim on.

    The pulls are bang-bang: full contraction of one side, none of the other, as fast as the muscles can. The default
    fish bends through them without buckling: see `magnified`.
    """
    contraction = swimming(fish, LEAD + right + left + REST)
    contraction[LEAD : LEAD + right] = fish.sides < 0
    contraction[LEAD + right : LEAD + right + left] = fish.sides > 0
    return contraction


def vibration(fish: Fish) -> Problem:
    """Free vibration in vacuum for 50 control intervals: muscles idle, a bending motion at the start."""
    position = fish.body.position
    along = 2 * np.pi * (position[:, 0] - position[0, 0]) / fish.length
    velocity = np.zeros_like(position)
    velocity[:, 1] = 0.25 * fish.length / fish.contraction_time * np.cos(along)
    velocity[:, 2] = 0.05 * fish.length / fish.contraction_time * np.sin(along)
    return Problem("vibration", "free vibration in vacuum", fish, VACUUM, np.zeros((50, fish.num_muscles)), velocity)


@cache
def problems() -> dict[str, Problem]:
    """Every scene of the work-precision charts."""
    fish = make_fish()

    def turn(name, title, stiffness=1.0, damping=1.0):
        changed = scaled(fish, stiffness, damping)
        return Problem(name, title, changed, fish.water, left_after_right(changed))

    return {
        problem.name: problem
        for problem in (
            vibration(fish),
            Problem("gait", "swimming", fish, fish.water, swimming(fish, 100)),
            turn("turn", "left after right"),
            turn("turn_x10", "left after right, 10 times as stiff", 10.0),
            turn("turn_x10_damped", "left after right, 10 times as stiff and as damped", 10.0, 10.0),
            turn("turn_x100", "left after right, 100 times as stiff", 100.0),
            turn("turn_x1000", "left after right, 1000 times as stiff", 1000.0),
            turn("turn_damped", "left after right, 20 times as damped", 1.0, 20.0),
        )
    }


def tank_of(problem: Problem, integrator: str, substeps: int, num_fish=1, refine=np.inf, **options) -> Tank:
    """A tank with the fish of the problem at its start, `substeps` steps a control interval, none of them refined.

    `options` are further ones of `Tank`. With `refine`, an interval is taken again in shorter steps where need be.
    """
    dt = problem.fish.control_interval / substeps
    tank = Tank(problem.fish, num_fish, integrator, dt, problem.world, threads=1, refine=refine, **options)
    if problem.velocity is not None:
        tank.velocity[:] = problem.velocity
    return tank


def run(problem: Problem, integrator: str, substeps: int, moved=0.0, **options) -> tuple[np.ndarray, Tank]:
    """Positions at the end of every control interval, (K,N,3), and the tank. A fish that fails stays where it was.

    `moved` (N,3) m is added to the start; `options` as for `tank_of`.
    """
    tank = tank_of(problem, integrator, substeps, **options)
    tank.position[0] += moved
    path = np.empty((len(problem.contraction), *tank.position.shape[1:]))
    for k, goal in enumerate(problem.contraction):
        tank.drive(goal[None], substeps)
        path[k] = tank.position[0]
    return path, tank


def distance(fish: Fish, path: np.ndarray, other: np.ndarray) -> float:
    """Largest distance of any node at any time between two paths (K,N,3), body lengths."""
    return float(np.linalg.norm(path - other, axis=-1).max() / fish.length)


def magnified(problem: Problem, reference_path: np.ndarray, substeps: int) -> float:
    """How many times a scene magnifies a small random displacement of the nodes at the start; the largest of three.

    Where it is a million, no method and no step tells where the fish ends: it has buckled one way or the other.
    """
    fish, apart = problem.fish, []
    for seed in range(3):
        noise = np.random.default_rng(seed).normal(size=fish.body.position.shape)
        path, _ = run(problem, "rk4", substeps, DISTURBANCE * fish.length * noise)
        apart.append(distance(fish, path, reference_path) / DISTURBANCE)
    return max(apart)


def reference(problem: Problem, fewest=1024, most=131_072) -> tuple[np.ndarray, int, float]:
    """The reference solution (K,N,3), its steps a control interval and the last change, body lengths."""

    def apart(fine, coarse) -> float:
        alive = fine[1].alive[0] and coarse[1].alive[0]
        return distance(problem.fish, fine[0], coarse[0]) if alive else np.inf

    solve = partial(run, problem, "rk4")
    (path, _), substeps, change = converge(problem.name, solve, apart, (fewest, most), CONVERGED)
    return path, substeps, change


def independent(problem: Problem, method="DOP853", tolerance=1e-11) -> np.ndarray:
    """The path (K,N,3) by a method of scipy, which shares nothing with `reference` but the forces.

    Raises:
        NotConvergedError: if that method gives up.
    """
    tank = tank_of(problem, "dop853", 1)
    path = np.empty((len(problem.contraction), *tank.position.shape[1:]))
    for k, goal in enumerate(problem.contraction):
        tank.command(goal[None], tank.dt)
        solve(problem.fish.body, problem.world, tank.state, tank.control, tank.dt, method, tolerance)
        path[k] = tank.position[0]
    if not tank.alive[0]:
        raise NotConvergedError(f"{problem.name}: {method} gave up at tolerance {tolerance:g}: {tank.failure[0]}")
    return path
