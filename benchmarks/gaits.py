"""Swim a gait and measure it as a biologist would: stride, Strouhal number, tail sweep."""

from dataclasses import dataclass

import numpy as np

from agents.controllers import Gait
from fish_env.bodies import Fish
from fish_env.body import World
from fish_env.tank import Tank


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
    failure: str


def swim(fish: Fish, gait: Gait, water: World, dt=None, integrator="semi_implicit", beats=14, measured=6,
         decisions=24) -> Swum:  # fmt: skip
    """Swim `beats` beats from rest with `decisions` control points a beat, and measure the last `measured`."""
    dt = fish.time_step if dt is None else dt
    steps = max(1, round(1 / (gait.frequency * decisions * dt)))
    tank = Tank(fish, 1, integrator, 1 / (gait.frequency * decisions * steps), water)
    period = 1 / gait.frequency
    mass = fish.body.mass / fish.body.mass.sum()
    centre, tail = [], []
    contraction = gait.contraction(fish, period / decisions * np.arange(1, decisions + 1))[:, None]
    tank.velocity[:, :, 0] = 0.4 * fish.length * gait.frequency  # a push start: it shortens the approach to cruising
    for beat in range(beats):
        for k in range(decisions):
            tank.drive(contraction[k], steps)
            if beat >= beats - measured - 1:
                centre.append(mass @ tank.position[0])
                tail.append(tank.position[0, fish.tail].mean(axis=0))
        if not tank.alive[0]:
            return Swum(0.0, 0.0, 0.0, np.inf, tank.failure[0])
    centre, tail = np.array(centre)[decisions - 1 :], np.array(tail)[decisions - 1 :]
    path = centre[-1] - centre[0]
    distance = np.linalg.norm(path)
    across = np.cross([0.0, 0.0, 1.0], path / distance)
    offset = (tail - centre[0]) @ across
    sweep = np.mean([np.ptp(offset[k * decisions : (k + 1) * decisions + 1]) for k in range(measured)]) / fish.length
    stride = distance / (measured * fish.length)
    # a fish that is pushed backwards has swum a negative distance
    ahead = tank.position[0, fish.front].mean(axis=0) - tank.position[0, fish.rear].mean(axis=0)
    stride = float(np.copysign(stride, path @ ahead))
    return Swum(stride * gait.frequency, stride, float(sweep), float(sweep / abs(stride)), "")
