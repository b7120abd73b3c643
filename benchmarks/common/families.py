"""Families of commands: each draws the contractions of one scene, (K,M), from a generator, at times (K,) s.

The upper muscle of a side contracts as the lower one does.
"""

import numpy as np

from fish_env import Fish
from fish_env.control import Gait


def _pairs(fish: Fish, drawn) -> np.ndarray:
    """Contractions (S,K,M) of the muscles, of those (S,K,6) of segments and sides."""
    return np.clip(drawn, 0.0, 1.0)[:, :, fish.grouping("pairs")]


def _held(generator, intervals, longest, draw) -> np.ndarray:
    """(K,6) values, each held for a random time of 1 to `longest` control intervals."""
    found = np.empty((intervals, 6))
    for column in found.T:
        k = 0
        while k < intervals:
            pause = int(generator.integers(1, longest + 1))
            column[k : k + pause] = draw(generator)
            k += pause
    return found


def gaits(fish, generator, times, highest=6.0):
    """Sinusoidal gaits of any frequency from 1 to `highest` Hz, amplitudes and lags."""
    lag = np.cumsum([0.0, *generator.uniform(0.0, 2.5, 2)])
    gait = Gait(generator.uniform(1.0, highest), tuple(generator.uniform(0.2, 1.0, 3)), tuple(lag))
    return gait.contraction(fish, times)


def sprints(fish, generator, times):
    """Gaits as the fastest are: 3.5 to 4 Hz, nearly full contractions, short lags."""
    lag = np.cumsum([0.0, *generator.uniform(-0.1, 0.7, 2)])
    amplitude = 1.0, generator.uniform(0.85, 1.0), generator.uniform(0.6, 1.0)
    return Gait(generator.uniform(3.5, 4.0), amplitude, tuple(lag)).contraction(fish, times)


def held(fish, generator, times):
    """Each side of each segment holds a random contraction for up to 0.6 s."""
    return _pairs(fish, _held(generator, len(times), 30, lambda g: g.uniform())[None])[0]


def bang_bang(fish, generator, times):
    """Each side of each segment is relaxed or contracted fully, for up to 0.3 s."""
    return _pairs(fish, _held(generator, len(times), 15, lambda g: g.choice([0.0, 1.0]))[None])[0]


def reversals(fish, generator, times):
    """One side of the whole fish contracts, then the other, each for 0.06 to 0.5 s, in part or fully."""
    strength = generator.uniform(0.3, 1.0, 3)
    side, found, k = generator.choice([-1, 1]), np.zeros((len(times), 6)), 0
    while k < len(times):
        pause = int(generator.integers(3, 26))
        found[k : k + pause, (0 if side > 0 else 1) :: 2] = strength
        side, k = -side, k + pause
    return _pairs(fish, found[None])[0]


def square(fish, generator, times):
    """Left and right in turn at 1 to 6 Hz, the segments after one another."""
    frequency, lag = generator.uniform(1.0, 6.0), np.cumsum([0.0, *generator.uniform(0.0, 0.35, 2)])
    wave = np.sin(2 * np.pi * (frequency * times[:, None] - lag)) >= 0.0
    strength = generator.uniform(0.3, 1.0)
    return _pairs(fish, strength * np.stack([wave, ~wave], axis=2).reshape(1, len(times), 6))[0]


def chirp(fish, generator, times):
    """A gait whose frequency rises from 1 to 4.5 Hz, or falls."""
    lag = np.cumsum([0.0, *generator.uniform(0.0, 2.0, 2)])
    low, high = generator.permutation([1.0, 4.5])
    angle = 2 * np.pi * (low * times + 0.5 * (high - low) * times**2 / times[-1])[:, None] - lag
    wave = np.stack([np.sin(angle), -np.sin(angle)], axis=2).reshape(1, len(times), 6)
    return _pairs(fish, 0.5 * generator.uniform(0.4, 1.0) * (1.0 + wave))[0]


def wandering(fish, generator, times):
    """Each side of each segment follows an Ornstein-Uhlenbeck process of 0.15 s, within its limits."""
    found, now = np.empty((1, len(times), 6)), generator.uniform(0.0, 1.0, 6)
    keep = np.exp(-(times[1] - times[0]) / 0.15)
    for k in range(len(times)):
        now = 0.4 + keep * (now - 0.4) + 0.4 * np.sqrt(1.0 - keep**2) * generator.standard_normal(6)
        found[0, k] = now
    return _pairs(fish, found)[0]


def bends(fish, generator, times):
    """A bend to one side, held, released, and a gait afterwards, as in a turn from rest."""
    hold = int(generator.integers(5, 40))
    found = gaits(fish, generator, times, 4.5) * (np.arange(len(times)) >= hold)[:, None]
    strength = generator.uniform(0.2, 1.0, 3)[fish.segments] * (fish.sides == generator.choice([-1, 1]))
    return np.where((np.arange(len(times)) < hold)[:, None], strength, found)
