"""A closed room: objects thrown by every method, how far they get behind a wall; energy of many falls of the ring.

python -m benchmarks.objects.closed     both tables (about 2 min)
"""

import numpy as np

from benchmarks.common.tables import RESULTS, write_csv
from benchmarks.objects.scenes import SCENES, play
from fish_env import INTEGRATORS, Tank
from fish_env.bodies.objects import GRAVITY, OBJECTS, RING, Layered, make_ring, room

COMMAND = "python -m benchmarks.objects.closed"
SIZE = 0.3  # m from the middle to every wall
SPEED = 2.0  # m/s, standard deviation of each component of the velocity
THROWS = 6
FALLS = 40
VARIED = 0.02  # standard deviation of the factors on the masses of the layers


def thrown(thing: Layered, name: str, seed: int, dt: float | None = None, seconds=0.5, restitution=0.5) -> dict:
    """A throw: the failure, the furthest that a node was behind a wall, and that a node moved in one step, m."""
    world = room(thing.down, SIZE, restitution, closed=True)
    tank = Tank(thing, integrator=name, dt=dt, water=world, threads=1)
    tank.velocity[0] = SPEED * np.random.default_rng(seed).normal(size=3) * (thing.body.inverse_mass > 0)
    depth = travel = 0.0
    while tank.alive[0] and tank.time[0] < seconds:
        before = tank.position[0].copy()
        tank.advance(1)
        if tank.alive[0]:
            depth = max(depth, float((np.abs(tank.position[0]) - SIZE).max()))
            travel = max(travel, float(np.linalg.norm(tank.position[0] - before, axis=1).max()))
    return {"failure": tank.failure[0], "depth": depth, "travel": travel, "step": tank.dt}


def survey(kind: str, name: str) -> dict:
    """A row: THROWS throws of an object by a method, at its own step or a shorter one.

    Linear theory without tension promises explicit Euler six times the step that it survives on the ring.
    """
    thing = OBJECTS[kind].make()
    part = 0.05 if name == "explicit_euler" else 0.25
    dt = min(part * INTEGRATORS[name].limit(thing.body), thing.time_step)
    throws = [thrown(thing, name, seed, dt) for seed in range(THROWS)]
    return {"object": kind, "integrator": name, "step_ms": 1e3 * throws[0]["step"], "throws": THROWS,
            "failed": sum(bool(throw["failure"]) for throw in throws),
            "depth_mm": 1e3 * max(throw["depth"] for throw in throws),
            "depth_over_travel": max(throw["depth"] / throw["travel"] for throw in throws)}  # fmt: skip


def fall(seed: int) -> dict:
    """A row: how much the energy of a ring grows in a fall on a floor that reflects, over the energy of the fall.

    The masses of the layers are those of the default ring times normal factors, and every node starts displaced.
    """
    outer, inner = 1.0 + VARIED * np.random.default_rng(seed).normal(size=2)
    thing = make_ring(mass=outer * RING.mass, inner_mass=inner * RING.inner_mass)
    lowest, growth = np.inf, 0.0
    for now in play(thing, SCENES["dropped"], seed=seed):
        lowest = min(lowest, now.energy)
        growth = max(growth, now.energy - lowest)
    height = -thing.water.planes[0, 3] - 0.5 * thing.length
    return {"seed": seed, "growth": growth / (thing.body.mass.sum() * GRAVITY * height)}


def main() -> None:
    """Write the tables. Methods that choose their own steps do not know walls, and are left out."""
    names = [name for name, method in INTEGRATORS.items() if method.kind != "adaptive"]
    rows = [survey("ring", name) for name in names]
    rows += [survey(kind, "leapfrog_chebyshev") for kind in OBJECTS if kind in ("string", "sphere", "uniform sphere")]
    write_csv("song_room.csv", rows, COMMAND)
    write_csv("song_falls.csv", [fall(seed) for seed in range(FALLS)], COMMAND)
    print(f"written to {RESULTS}/song_room.csv and song_falls.csv")


if __name__ == "__main__":
    main()
