"""Families of commands: each draws the contractions of one scene, (K,M), from a generator, at times (K,) s.

The upper muscle of a side contracts as the lower one does.
"""

import numpy as np

from fish_env.control.chart import for_pairs, gaits, piecewise


def held(fish, generator, times):
    """Each side of each segment holds a random contraction for up to 0.6 s."""
    return for_pairs(fish, piecewise(generator, len(times), 30, lambda g: g.uniform())[None])[0]


def reversals(fish, generator, times):
    """One side of the whole fish contracts, then the other, each for 0.06 to 0.5 s, in part or fully."""
    strength = generator.uniform(0.3, 1.0, 3)
    side, found, k = generator.choice([-1, 1]), np.zeros((len(times), 6)), 0
    while k < len(times):
        pause = int(generator.integers(3, 26))
        found[k : k + pause, (0 if side > 0 else 1) :: 2] = strength
        side, k = -side, k + pause
    return for_pairs(fish, found[None])[0]


def chirp(fish, generator, times):
    """A gait whose frequency rises from 1 to 4.5 Hz, or falls."""
    lag = np.cumsum([0.0, *generator.uniform(0.0, 2.0, 2)])
    low, high = generator.permutation([1.0, 4.5])
    angle = 2 * np.pi * (low * times + 0.5 * (high - low) * times**2 / times[-1])[:, None] - lag
    wave = np.stack([np.sin(angle), -np.sin(angle)], axis=2).reshape(1, len(times), 6)
    return for_pairs(fish, 0.5 * generator.uniform(0.4, 1.0) * (1.0 + wave))[0]


def wandering(fish, generator, times):
    """Each side of each segment follows an Ornstein-Uhlenbeck process of 0.15 s, within its limits."""
    found, now = np.empty((1, len(times), 6)), generator.uniform(0.0, 1.0, 6)
    keep = np.exp(-(times[1] - times[0]) / 0.15)
    for k in range(len(times)):
        now = 0.4 + keep * (now - 0.4) + 0.4 * np.sqrt(1.0 - keep**2) * generator.standard_normal(6)
        found[0, k] = now
    return for_pairs(fish, found)[0]


def bends(fish, generator, times):
    """A bend to one side, held, released, and a gait afterwards, as in a turn from rest."""
    hold = int(generator.integers(5, 40))
    found = gaits(fish, generator, times, 4.5) * (np.arange(len(times)) >= hold)[:, None]
    strength = generator.uniform(0.2, 1.0, 3)[fish.segments] * (fish.sides == generator.choice([-1, 1]))
    return np.where((np.arange(len(times)) < hold)[:, None], strength, found)
