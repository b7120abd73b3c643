"""A body of one's own: an eel of as many segments as wanted, which swims with a travelling wave.

    python custom_body.py                  eight segments
    python custom_body.py --segments 12

The eel is a chain of square cross-sections that springs join, between a nose and the two tips of a tail. Springs along
the four edges of every segment are its muscles. x points forward, y to the left, z up; units are SI.
"""

import argparse
from functools import partial
from itertools import combinations

import gymnasium as gym
import numpy as np

import fish_env
from fish_env.bodies import BodyKind
from fish_env.physics.body import make_body

DENSITY = 1000.0  # kg/m3, that of the water
THICKNESS = 0.08  # of the widest cross-section, body lengths
RELAXATION = 0.003  # s, damping over stiffness


def cross_sections(segments: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the cross-sections, (segments + 1,4,3) m, and the width of each, (segments + 1,) m.

    The corners are upper left, upper right, lower right, lower left.
    """
    place = np.linspace(0.1, 0.85, segments + 1)
    width = THICKNESS * length * (1.0 - 0.6 * (place - place[0]))
    square = 0.5 * np.array([(0.0, 1.0, 1.0), (0.0, -1.0, 1.0), (0.0, -1.0, -1.0), (0.0, 1.0, -1.0)])
    corners = width[:, None, None] * square
    corners[:, :, 0] = -length * place[:, None]
    return corners, width


def surface(segments: int) -> list[tuple[int, int, int, int]]:
    """Faces, counter-clockwise seen from outside; a triangle gives its third node twice."""
    faces = []
    for k in range(4):
        following = (k + 1) % 4
        faces.append((0, 1 + k, 1 + following, 1 + following))  # the head
        for s in range(segments):
            a, b = 1 + 4 * s, 5 + 4 * s  # the first corners of the cross-sections in front and behind
            faces.append((a + k, b + k, b + following, a + following))
    last, tail = 1 + 4 * segments, 5 + 4 * segments
    upper_left, upper_right, lower_right, lower_left = range(last, last + 4)
    faces += [(upper_right, upper_left, tail, tail), (lower_left, lower_right, tail + 1, tail + 1)]
    return [*faces, (upper_left, lower_left, tail + 1, tail), (lower_right, upper_right, tail, tail + 1)]


def make_eel(segments: int = 8, length: float = 0.3, stiffness: float = 60.0) -> fish_env.Fish:
    """Build an eel.

    Args:
        segments: how many, at least 2.
        length: from the nose to the tips of the tail, m.
        stiffness: of every spring, N/m.

    Raises:
        ValueError: for a number that is not allowed.
    """
    if segments < 2:
        raise ValueError(f"segments is {segments}; give at least 2")
    corners, width = cross_sections(segments, length)
    fin = 0.6 * width[0] * np.array([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]) - (length, 0.0, 0.0)
    position = np.concatenate([np.zeros((1, 3)), corners.reshape(-1, 3), fin])
    mass = np.concatenate([[0.0], np.repeat(DENSITY * width**2 * 0.75 * length / segments / 4.0, 4), [0.0, 0.0]])
    mass[[0, -2, -1]] = 0.5 * mass[-3]
    first = [1 + 4 * s for s in range(segments + 1)]
    pairs = {(0, 1 + k) for k in range(4)} | {tuple(pair) for a in first for pair in combinations(range(a, a + 4), 2)}
    pairs |= {(a + i, a + 4 + j) for a in first[:-1] for i in range(4) for j in range(4)}
    pairs |= {(a, b) for a in range(first[-1], first[-1] + 4) for b in (first[-1] + 4, first[-1] + 5)}
    pairs = np.array([*sorted(pairs), (first[-1] + 4, first[-1] + 5)])
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    constants = np.full(len(pairs), stiffness)
    faces = surface(segments)
    body = make_body(position, mass, pairs, constants, RELAXATION * constants, natural, faces)
    number = {tuple(pair): e for e, pair in enumerate(pairs.tolist())}
    left, right = ([a + k for a in first for k in side] for side in ((0, 3), (1, 2)))
    mirror = np.arange(len(position))
    mirror[left], mirror[right] = right, left
    return fish_env.Fish(
        name="eel",
        body=body,
        length=length,
        time_step=0.02 / 6,
        control_interval=0.02,
        water=fish_env.make_water(),
        muscles=np.array([number[a + k, a + 4 + k] for a in first[:-1] for k in range(4)]),
        sides=np.tile([1, -1, -1, 1], segments),
        segments=np.repeat(np.arange(segments), 4),
        contracted=np.full(4 * segments, 0.75),
        contraction_time=0.1,
        nose=0,
        tail=np.array([first[-1] + 4, first[-1] + 5]),
        left=np.array(left),
        right=np.array(right),
        mirror=mirror,
    )


def travelling_wave(fish: fish_env.Fish, time: float, frequency: float = 2.0, waves: float = 1.0) -> np.ndarray:
    """Actions (M,) of a wave of contraction that travels from the head to the tail, `waves` of them on the body."""
    phase = 2.0 * np.pi * (frequency * time - waves * fish.segments / (fish.segments.max() + 1))
    return fish.sides * np.sin(phase)


def main() -> None:
    """Swim for some seconds, print how far, and show that the environments take the eel."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--segments", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=4.0)
    args = parser.parse_args()

    fish = make_eel(args.segments)
    tank = fish_env.Tank(fish, water=fish.water)
    start = tank.position[0].mean(axis=0)
    for step in range(round(args.seconds / fish.control_interval)):
        tank.swim(travelling_wave(fish, step * fish.control_interval), fish.control_interval)
    way = (tank.position[0].mean(axis=0) - start) / fish.length
    print(f"{fish.num_muscles} muscles: {way[0]:.2f} body lengths forward in {args.seconds} s")

    fish_env.BODIES["eel"] = BodyKind("eel", "a chain of square cross-sections", partial(make_eel, args.segments))
    env = gym.make("FishEnv/Swim-v0", body="eel", muscle_groups="pairs")
    print(f"FishEnv/Swim-v0: actions {env.action_space.shape}, observations {env.observation_space.shape}")
    env.close()


if __name__ == "__main__":
    main()
