"""What it is worth that the drag spring has the hand's velocity: a hand that moves, beside one that jumps.

python -m benchmarks.objects.hand     results/song_hand.csv (some seconds)

A hand drags a node of an object that floats along a circle, and is told to the tank so many times a second. Between
two times it moves straight on, or it stands still and jumps; the reference is told of it at every step.
"""

import argparse

import numpy as np
from tqdm import tqdm

from benchmarks.common.tables import write_csv
from benchmarks.objects.scenes import DRAG_SPRING
from fish_env import Tank
from fish_env.bodies.objects import OBJECTS
from fish_env.world import VACUUM

COMMAND = "python -m benchmarks.objects.hand"
KINDS = ("ring", "sphere", "uniform sphere")
RATES = (10, 20, 40, 80)  # times a second
SECONDS, RADIUS, TURN = 1.0, 0.1, 2.0 * np.pi  # s; m; rad/s


def place(start, along, across, time: float) -> np.ndarray:
    """Where the hand is, (3,) m: on a circle through `start`."""
    angle = TURN * time
    return start + RADIUS * (np.sin(angle) * along + (1.0 - np.cos(angle)) * across)


def dragged(kind: str, rate: float | None, moves: bool, dt: float) -> np.ndarray:
    """The nodes at every tenth of a second, (10,N,3) m; rate None: told at every step.

    Raises:
        ArithmeticError: if the object fails.
    """
    thing = OBJECTS[kind].make()
    tank = Tank(thing, dt=dt, water=VACUUM, threads=1)
    along, across = np.array([1.0, 0.0, 0.0]), -thing.down
    node = tank.nearest(tank.position[0].mean(axis=0) + thing.length * along, thing.outer)
    start, steps, found = tank.position[0, node].copy(), round(SECONDS / dt), []
    each = 1 if rate is None else round(1.0 / (rate * dt))
    for k in range(0, steps, each):
        here, next_one = (place(start, along, across, j * dt) for j in (k, k + each))
        tank.grab(node, here, *DRAG_SPRING, velocity=(next_one - here) / (each * dt) if moves else np.zeros(3))
        for j in range(k, min(k + each, steps)):
            tank.advance(1)
            if (j + 1) % round(0.1 / dt) == 0:
                found.append(tank.position[0].copy())
    if not tank.alive[0]:
        raise ArithmeticError(f"{kind}, dragged: {tank.failure[0]}")
    return np.array(found)


def compare(kind: str) -> list[dict]:
    """Rows of every rate, the hand moving or jumping: the largest distance of a node from the reference, in lengths."""
    length, dt, rows = OBJECTS[kind].make().length, 1.0 / 3840.0, []
    exact = dragged(kind, None, True, dt)
    for rate in RATES:
        for moves in (True, False):
            off = float(np.linalg.norm(dragged(kind, rate, moves, dt) - exact, axis=2).max() / length)
            rows.append(
                {"object": kind, "told_per_s": rate, "hand": "moves" if moves else "jumps", "error": float(off)}
            )
    return rows


def main() -> None:
    """Write the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows = [row for kind in tqdm(KINDS) for row in compare(kind)]
    print(write_csv("song_hand.csv", rows, COMMAND))
    for row in rows:
        print(row)


if __name__ == "__main__":
    main()
