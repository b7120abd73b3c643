"""Time-stepping methods on elastic objects: their error in free flight, and the largest steps that they survive."""

from collections.abc import Callable

import numpy as np

from fish_env import INTEGRATORS, Tank
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.world import VACUUM
from fish_env.soft.adaptive import solve
from fish_env.soft.room import InRoom, make_world

DURATION = 0.2  # s of free flight, oscillating: before any impact
SPEED = 0.5  # m/s, largest velocity of the oscillation at the start
STEPS = [10 * 2**k for k in range(9)]
TOLERANCE = 1e-12  # of the reference solution
LONGEST, SHORTEST = 0.1, 1e-5  # s, between which the largest stable step is sought
WATCHED = 3.0  # s that a step is tried for
CONFIRMED = 3  # successive steps that must survive before the search for the largest one ends


def swing(thing: InRoom, speed: float) -> np.ndarray:
    """Velocities (N,3) m/s that stretch an object along x and flatten it along its vertical, as its free nodes can."""
    x = thing.body.position
    axis = int(np.argmax(np.abs(thing.down)))
    velocity = np.zeros_like(x)
    velocity[:, axis] -= x[:, axis]
    velocity[:, 0] += x[:, 0] if axis else 2.0 * x[:, 0]
    return speed * velocity / np.abs(x).max() * (thing.body.inverse_mass > 0)


def start(thing: InRoom, name: str, dt: float, gravity=True) -> Tank:
    """Tank with the object in free flight, oscillating."""
    world = make_world(9.81 * thing.down) if gravity else VACUUM
    tank = Tank(thing, integrator=name, dt=dt, water=world, threads=1)
    tank.velocity[0] = swing(thing, SPEED)
    return tank


def reference(thing: InRoom) -> np.ndarray:
    """Positions (N,3) m after DURATION by DOP853.

    Raises:
        ArithmeticError: if that method fails.
    """
    tank = start(thing, "rk4", DURATION)
    solve(thing.body, tank.world, tank.state, tank.control, DURATION, "DOP853", TOLERANCE)
    if not tank.alive[0]:
        raise ArithmeticError(f"the reference of {thing.name} failed: {tank.failure[0]}")
    return tank.position[0].copy()


def error(thing: InRoom, name: str, steps: int, exact: np.ndarray) -> float:
    """Largest distance of a node from the reference after so many steps, over the object's length; inf if it fails."""
    tank = start(thing, name, DURATION / steps)
    tank.advance(steps)
    return float(np.linalg.norm(tank.position[0] - exact, axis=1).max() / thing.length) if tank.alive[0] else np.inf


def column(what: str, steps: int) -> str:
    """Name of a column: a quantity for so many steps in DURATION, by the length of a step."""
    return f"{what}_{1e3 * DURATION / steps:g}_ms"


def errors(thing: InRoom, name: str, exact: np.ndarray) -> dict[str, float]:
    """Error of a method with every number of steps, by the name of its column."""
    return {column("error", steps): error(thing, name, steps, exact) for steps in STEPS}


def line_of(row: dict, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Steps, ms, and a quantity in the row of a table, where it is below 1."""
    found = np.array([(float(key.split("_")[1]), row[key]) for key in row if key.startswith(what)], dtype=float)
    return tuple(found[found[:, 1] < 1.0].T)


def energy_over_rest(tank: Tank) -> float:
    """Energy, J, over that at rest."""
    body, rest = tank.fish.body, tank.rest_length[0]
    evaluator = Evaluator(body, VACUUM)
    now, then = (evaluator.energies(rest, x, v) for x, v in
                 ((tank.position[0], tank.velocity[0]), (body.position, np.zeros_like(body.position))))  # fmt: skip
    return sum(now.values()) - sum(then.values())


def is_stable(thing: InRoom, name: str, dt: float) -> bool:
    """Return True if a small oscillation does not grow in WATCHED seconds."""
    tank = start(thing, name, dt, gravity=False)
    noise = 1e-3 * np.random.default_rng(0).normal(size=tank.velocity[0].shape)
    tank.velocity[0] = 0.02 * tank.velocity[0] + noise * (thing.body.inverse_mass > 0)
    before = energy_over_rest(tank)
    tank.advance(round(WATCHED / dt))
    return bool(tank.alive[0] and energy_over_rest(tank) <= before)


def largest_stable(thing: InRoom, name: str) -> dict[str, float]:
    """Largest stable step, ms, to 2 %, by bisection; for explicit methods also that of linear theory."""
    method = INTEGRATORS[name]
    theory = method.limit(thing.body, VACUUM) if method.kind == "explicit" else np.nan
    low, high = SHORTEST, LONGEST
    if is_stable(thing, name, high):
        low = high
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if is_stable(thing, name, middle) else (low, middle)
    return {"stable_ms": 1e3 * low, "theory_ms": 1e3 * theory}


def largest_surviving(survives: Callable[[float], bool], steps) -> float:
    """Largest of these falling steps, s, that survives and is followed by CONFIRMED survivors at most; 0 if none."""
    run: list[float] = []
    for step in steps:
        run = [*run, step] if survives(step) else []
        if len(run) == CONFIRMED:
            break
    return run[0] if run else 0.0
