"""Swim a gait and measure what biologists measure: stride, Strouhal number, tail sweep."""

from dataclasses import dataclass

import numpy as np

from benchmarks.common.poses import pose_of
from fish_env.bodies import Fish
from fish_env.control import Gait
from fish_env.tank import Tank
from fish_env.world import World


@dataclass(frozen=True)
class Swum:
    """What a gait achieved over its last beats."""

    speed: float
    """Mean speed of the centre of mass along its own path, body lengths per second."""
    stride: float
    """Distance a beat, body lengths."""
    sweep: float
    """Peak-to-peak excursion of the tail tip across the path, body lengths."""
    strouhal: float
    """Frequency times sweep over speed."""
    nose: float
    """Sweep of the nose over that of the tail tip."""
    wobble: float
    """Largest departure of the body's up axis from its mean in a beat, degrees: a fish that rolls shows it here."""
    failure: str


NOISE = 0.05  # body lengths a second: node velocities at the start, so that an unstable gait has something to grow from


def swim(fish: Fish, gait: Gait, water: World, dt=None, integrator=None, beats=14, measured=6,
         points=24, push=0.4, seed=0) -> Swum:  # fmt: skip
    """Swim `beats` beats with `points` commands a beat, and measure the last `measured`.

    The fish starts at `push` body lengths a beat, which shortens the approach to cruising; 0 starts it from rest. Its
    nodes have a little random velocity, from `seed`.
    """
    refine = fish.refine if dt is None and integrator is None else None
    dt = fish.time_step if dt is None else dt
    steps = max(1, round(1 / (gait.frequency * points * dt)))
    tank = Tank(fish, 1, integrator, 1 / (gait.frequency * points * steps), water, refine=refine)
    period = 1 / gait.frequency
    mass = fish.body.mass / fish.body.mass.sum()
    centre, tips, up = [], [], []
    contraction = gait.contraction(fish, period / points * np.arange(1, points + 1))[:, None]
    tank.velocity[0] = np.random.default_rng(seed).normal(0.0, NOISE * fish.length, tank.velocity[0].shape)
    tank.velocity[0] *= fish.body.inverse_mass > 0.0
    tank.velocity[0, :, 0] += push * fish.length * gait.frequency
    for beat in range(beats):
        for k in range(points):
            tank.drive(contraction[k], steps)
            if beat >= beats - measured - 1:
                centre.append(mass @ tank.position[0])
                tips.append([tank.position[0, fish.tail].mean(axis=0), tank.position[0, fish.nose].copy()])
                up.append(pose_of(tank).axes[0, 2])
        if not tank.alive[0]:
            return Swum(0.0, 0.0, 0.0, np.inf, np.inf, 180.0, tank.failure[0])
    centre, tips = np.array(centre)[points - 1 :], np.array(tips)[points - 1 :]
    path = centre[-1] - centre[0]
    distance = np.linalg.norm(path)
    across = np.cross([0.0, 0.0, 1.0], path / distance)
    offset = (tips - centre[0]) @ across / fish.length
    beat = [np.ptp(offset[k * points : (k + 1) * points + 1], axis=0) for k in range(measured)]
    sweep, nose = map(float, np.mean(beat, axis=0))
    stride = distance / (measured * fish.length)
    # a fish that is pushed backwards has swum a negative distance
    stride = float(np.copysign(stride, path @ (fish.line @ tank.position[0])))
    tilt = np.array(up) @ np.mean(up, axis=0) / np.linalg.norm(np.mean(up, axis=0))
    wobble = float(np.degrees(np.arccos(min(1.0, tilt.min()))))
    return Swum(stride * gait.frequency, stride, sweep, sweep / abs(stride), nose / sweep, wobble, "")
