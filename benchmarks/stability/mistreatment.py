"""Ways of mistreating fish: families of starts, of changed bodies, and of commands."""

from dataclasses import dataclass

import numpy as np

from benchmarks.stability.linear import modes
from fish_env import Fish
from fish_env.bodies.mass_spring import LAYERS

INTERVALS = 500  # control intervals a fish is driven: 10 s of the default
LEVELS = 255  # goals are whole numbers of them, so that a sequence is stored in bytes


@dataclass(frozen=True)
class Family:
    """Fish that are mistreated in the same way; `share` is their part of all that are driven at random."""

    name: str
    share: float
    kind: str
    start: str = "rest"
    stiffness: float = 1.0
    mass: float = 1.0


def families() -> list[Family]:
    """Every way of mistreating a fish."""
    found = [Family(kind, 0.2, kind) for kind in GOALS]
    found += [Family(f"{start}, {kind}", 0.025, kind, start) for start in STARTS if start != "rest"
              for kind in ("random", "bang-bang")]  # fmt: skip
    factors = [(0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5), (0.5, 1.5), (1.5, 0.5), (0.5, 0.5), (1.5, 1.5)]
    share = (1.0 - sum(family.share for family in found)) / (2 * len(factors))
    found += [Family(f"stiffness x{c:g}, mass x{m:g}, {kind}", share, kind, "rest", c, m) for c, m in factors
              for kind in ("random", "bang-bang")]  # fmt: skip
    return found


# Starts: positions (B,N,3) m and velocities (B,N,3) m/s of a family, from a generator


def at_rest(fish, count, generator):
    """Relaxed and still."""
    return np.repeat(fish.body.position[None], count, 0), np.zeros((count, *fish.body.position.shape))


def noise(fish, size, count, generator):
    """Random vectors (B,N,3), of `size` along each axis in which a node is free: a flat fish stays in its plane."""
    return size * generator.normal(size=(count, *fish.body.position.shape)) * (fish.body.inverse_mass > 0.0)


def perturbed(fish, count, generator):
    """Nodes out of place by 2 % of a body length, each way."""
    x, v = at_rest(fish, count, generator)
    return x + noise(fish, 0.02 * fish.length, count, generator), v


def fast(fish, count, generator):
    """Moving at up to 10 body lengths a tail beat, spinning, every node with a velocity of its own."""
    x, v = at_rest(fish, count, generator)
    rate = fish.length / (10 * fish.control_interval)  # a body length in ten control intervals
    v += 2 * rate * generator.uniform(-1, 1, (count, 1, 3)) + noise(fish, 0.3 * rate, count, generator)
    spin = generator.normal(size=(count, 1, 3)) / (10 * fish.control_interval)
    v += np.cross(spin, x - x.mean(axis=1, keepdims=True))
    return x, v * (fish.body.inverse_mass > 0.0)


def crumpled(fish, count, generator):
    """Shrunk to 0.6 of its size, with nodes out of place by 1 % of a body length."""
    x, v = at_rest(fish, count, generator)
    return 0.6 * x + noise(fish, 0.01 * fish.length, count, generator), v


def inverted(fish, count, generator):
    """Partly turned inside out: left and right exchanged in one to three of the five cross-sections."""
    (x, v), sections = at_rest(fish, count, generator), cross_sections(fish)
    for b in range(count):
        for k in generator.choice(5, generator.integers(1, 4), replace=False):
            x[b, sections[k], 1] *= -1.0
    return x + noise(fish, 0.002 * fish.length, count, generator), v


def cross_sections(fish: Fish) -> list[np.ndarray]:
    """The nodes nearest to each of the five square layers of landmarks; those nearest to nose or tail are in none."""
    marks = fish.points(fish.body.position)[:, 0]
    place = np.array([marks[nodes].mean() for nodes in LAYERS])
    nearest = np.abs(fish.body.position[:, :1] - place).argmin(axis=1)
    return [np.flatnonzero(nearest == k) for k in range(1, 6)]


def beginning(start: str, fish: Fish, count: int, generator) -> list[np.ndarray]:
    """Positions and velocities (B,N,3) of a kind of start, rounded to what a stored case holds."""
    return [part.astype(np.float32).astype(float) for part in STARTS[start](fish, count, generator)]


STARTS = {"rest": at_rest, "perturbed": perturbed, "fast": fast, "crumpled": crumpled, "inverted": inverted}


# Actions: goals (K,B,M) in whole numbers of 1/255


def natural_periods(fish: Fish) -> np.ndarray:
    """Control intervals that a vibration of the body takes, those of 2 and more, and the gait's beat."""
    periods = 2 * np.pi / np.sqrt(modes(fish.body)[0]) / fish.control_interval
    return np.append(periods[periods >= 2.0], 13.0)


def random_goals(fish, count, generator):
    """A new goal for every muscle and control interval."""
    return generator.integers(0, LEVELS + 1, (INTERVALS, count, fish.num_muscles), dtype=np.uint8)


def bang_bang_goals(fish, count, generator):
    """All or nothing, at one of the body's own frequencies a fish, a phase for each segment and side."""
    period = generator.choice(natural_periods(fish), count)
    groups = fish.grouping("pairs")
    phase = generator.uniform(0, 1, (count, groups.max() + 1))[:, groups]
    turns = np.arange(INTERVALS)[:, None, None] / period[:, None] + phase
    return (LEVELS * (turns % 1.0 < 0.5)).astype(np.uint8)


def oscillating_goals(fish, count, generator):
    """Left against right at 1 to 12 Hz, in step or as a wave that travels along the fish: a sine, or all or nothing."""
    frequency, begin = generator.uniform(1.0, 12.0, count), generator.uniform(0.0, 1.0, count)
    strength, lag = generator.uniform(0.5, 1.0, count), generator.uniform(-0.5, 0.5, count)
    lag[generator.random(count) < 0.5] = 0.0
    turns = np.arange(INTERVALS)[:, None] * fish.control_interval * frequency + begin
    wave = np.sin(2 * np.pi * (turns[..., None] - lag[:, None] * fish.segments))
    wave = np.where(generator.random((count, 1)) < 0.5, np.sign(wave), wave)
    return np.rint(LEVELS * 0.5 * (1.0 + strength[:, None] * fish.sides * wave)).astype(np.uint8)


GOALS = {"random": random_goals, "bang-bang": bang_bang_goals, "oscillating": oscillating_goals}
