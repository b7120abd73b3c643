"""Song's integrators on the elastic objects: error against step and cost, and the largest stable step (ch. 5)."""

import time
from statistics import median

import numpy as np

from fish_env import INTEGRATORS, Tank
from fish_env.bodies.objects import OBJECTS
from fish_env.bodies.room import InRoom
from fish_env.forces.evaluate import Evaluator
from fish_env.integrators.adaptive import solve
from fish_env.world import VACUUM, make_world

METHODS = ("explicit_euler", "midpoint", "rk4", "leapfrog_chebyshev")
DURATION = 0.2  # s of free fall, swinging: before any impact
SPEED = 0.5  # m/s at the outer layer, of the swing it starts with
STEPS = [10 * 2**k for k in range(12)]
TOLERANCE = 1e-12  # of the reference
ACCURATE = 1e-9  # of the object's length: smaller steps show the reference's own error
LONGEST, SHORTEST = 0.1, 1e-5  # s, between which the largest stable step is looked for
WATCHED = 3.0  # s that a step is tried for


def swing(thing: InRoom, speed: float) -> np.ndarray:
    """Velocities (N,3) m/s that stretch an object along x and flatten it along its vertical, as its free nodes can."""
    x = thing.body.position
    axis = int(np.argmax(np.abs(thing.down)))
    velocity = np.zeros_like(x)
    velocity[:, axis] -= x[:, axis]
    velocity[:, 0] += x[:, 0] if axis else 2.0 * x[:, 0]
    return speed * velocity / np.abs(x).max() * (thing.body.inverse_mass > 0)


def start(thing: InRoom, name: str, dt: float, gravity=True) -> Tank:
    """The object in free fall, swinging."""
    world = make_world(9.81 * thing.down) if gravity else VACUUM
    tank = Tank(thing, integrator=name, dt=dt, water=world, threads=1)
    tank.velocity[0] = swing(thing, SPEED)
    return tank


def reference(thing: InRoom) -> tuple[np.ndarray, float]:
    """Where the nodes are after DURATION, (N,3) m, and how far rk4 with the smallest step is from that, in lengths."""
    tank = start(thing, "rk4", DURATION)
    solve(thing.body, tank.world, tank.state, tank.control, DURATION, "DOP853", TOLERANCE)
    if not tank.alive[0]:
        raise ArithmeticError(f"the reference of {thing.name} failed: {tank.failure[0]}")
    return tank.position[0].copy(), one(thing, "rk4", 4 * STEPS[-1] // 8, tank.position[0])["error"]


def one(thing: InRoom, name: str, steps: int, exact: np.ndarray, repeats=1, clock=time.perf_counter) -> dict:
    """A row: error of a method with so many steps, in object's lengths, and what it costs, ms; inf where it failed."""
    taken = []
    for _ in range(repeats):
        tank = start(thing, name, DURATION / steps)
        begin = clock()
        tank.advance(steps)
        taken.append(1e3 * (clock() - begin))
    error = np.linalg.norm(tank.position[0] - exact, axis=1).max() / thing.length if tank.alive[0] else np.inf
    forces = int(tank.counters["force_evaluations"][0])
    return {"object": thing.name, "integrator": name, "step_ms": 1e3 * DURATION / steps, "error": error,
            "forces": forces, "ms": round(median(taken), 4), "failure": tank.failure[0]}  # fmt: skip


def sweep(names) -> tuple[list[dict], list[dict]]:
    """Rows of every method and step on every object, and a row an object of how good the reference is."""
    rows, references = [], []
    for kind in names:
        thing = OBJECTS[kind].make()
        exact, apart = reference(thing)
        references.append({"object": kind, "tolerance": TOLERANCE, "rk4_apart": apart})
        for name in METHODS:
            one(thing, name, STEPS[0], exact)  # compiles
            for steps in STEPS:
                rows.append(one(thing, name, steps, exact, 3))
                if rows[-1]["error"] < ACCURATE:
                    break
    return rows, references


def level(tank: Tank) -> float:
    """Energy, J, over that at rest."""
    body, rest = tank.fish.body, tank.rest_length[0]
    evaluator = Evaluator(body, VACUUM)
    now, then = (evaluator.energies(rest, x, v) for x, v in
                 ((tank.position[0], tank.velocity[0]), (body.position, np.zeros_like(body.position))))  # fmt: skip
    return sum(now.values()) - sum(then.values())


def is_stable(thing: InRoom, name: str, dt: float) -> bool:
    """Whether a small swing does not grow in WATCHED seconds."""
    tank = start(thing, name, dt, gravity=False)
    tank.velocity[0] *= 0.02
    tank.velocity[0] += (
        1e-3 * np.random.default_rng(0).normal(size=tank.velocity[0].shape) * (thing.body.inverse_mass > 0)
    )
    before = level(tank)
    tank.advance(round(WATCHED / dt))
    return bool(tank.alive[0] and level(tank) <= before)


def largest_stable(thing: InRoom, name: str) -> dict:
    """A row: the largest stable step, ms, to 2 %, and that of linear theory."""
    low, high = SHORTEST, LONGEST
    if is_stable(thing, name, high):
        low = high
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if is_stable(thing, name, middle) else (low, middle)
    return {"object": thing.name, "integrator": name, "stable_ms": 1e3 * low,
            "promised_ms": 1e3 * INTEGRATORS[name].limit(thing.body)}  # fmt: skip
