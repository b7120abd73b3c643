"""Swim gaits side by side and measure what is measured of living fish: speed, and the sway along the midline.

Stations are the middles of the default fish's seven layers, nose to tail tips, by the landmarks that all bodies share.
"""

from dataclasses import dataclass

import numpy as np

from fish_env import Fish, Tank
from fish_env.bodies import mass_spring as tu
from fish_env.control import Gait

INTERVAL = 0.01  # s between two commands, and between two samples
NOISE, PUSH = 0.05, 0.4  # node velocities, body lengths/s, and body lengths a beat at the start of `swim_gait`
BEATS, MEASURED = 14, 6


@dataclass(frozen=True)
class Midline:
    """What a gait achieved over its last beats."""

    frequency: float
    """Hz."""
    speed: float
    """Of the centre of mass along its path, body lengths/s; negative backwards."""
    amplitude: np.ndarray
    """(7,) half the peak-to-peak sway of each station across the path, body lengths."""
    phase: np.ndarray
    """(7,) lag of each station's sway behind the tail tip's, beats: negative ahead of it."""
    wobble: float
    """Largest sway of the tail's upper tip against the lower one, over the sweep: a fish that rolls shows it."""
    failure: str
    work: float = np.nan
    """Net work of the muscles, J for each kg and metre; nan unless it was asked for."""
    lost: float = np.nan
    """Part of it that is lost in the body's damping; nan unless it was asked for."""
    thrust: float = np.nan
    """Work of the thrust, J for each kg and metre; nan unless it was asked for."""

    @property
    def sweep(self) -> float:
        """Peak to peak of the tail tip, body lengths."""
        return 2.0 * float(self.amplitude[-1])

    @property
    def nose(self) -> float:
        """Sway of the nose over that of the tail tip."""
        return float(self.amplitude[0] / self.amplitude[-1])

    @property
    def strouhal(self) -> float:
        """Frequency times sweep over speed."""
        return self.frequency * self.sweep / abs(self.speed) if self.speed else np.inf

    @property
    def stride(self) -> float:
        """Body lengths a beat."""
        return self.speed / self.frequency


def swim_midlines(
    fish: Fish, gaits: list[Gait], start, seconds: float, beats: int, noise=0.0, energy=False, **method
) -> list[Midline]:
    """Swim gaits side by side, and measure the last beats.

    Args:
        fish: any that has the default one's landmarks.
        gaits: G of them.
        start: speeds (G,) at the start, body lengths/s.
        seconds: how long they swim.
        beats: how many are measured.
        noise: of the node velocities at the start, body lengths/s, so that an unstable gait has something to grow from.
        energy: whether work, thrust and losses are measured too.
        method: the fish's own, unless `integrator` and `dt`, the longest step, s, are given.
    """
    steps = int(np.ceil(INTERVAL / method.get("dt", fish.time_step) - 1e-9))
    own = {"refine": np.inf if method else fish.refine, "integrator": method.get("integrator"), "energy": energy}
    tank = Tank(fish, len(gaits), dt=INTERVAL / steps, water=fish.water, threads=1, **own)
    shaken = np.random.default_rng(0).normal(0.0, noise * fish.length, tank.velocity[0].shape)
    tank.velocity[:] += shaken * (fish.body.inverse_mass > 0.0)
    tank.velocity[:, :, 0] += np.asarray(start)[:, None] * fish.length
    count = round(seconds / INTERVAL)
    times = INTERVAL * np.arange(1, count + 1)
    contraction = np.stack([gait.contraction(fish, times) for gait in gaits], axis=1)
    stations, tips, centre, work, lost, thrust = [], [], [], [], [], []
    mass = fish.body.mass / fish.body.mass.sum()
    layer = np.zeros((7, 23))
    for k, nodes in enumerate(tu.LAYERS):
        layer[k, nodes] = 1.0 / len(nodes)
    keep = count - int(np.ceil((beats + 1) / min(g.frequency for g in gaits) / INTERVAL))
    for k in range(count):
        tank.drive(contraction[k], steps)
        if not tank.alive.any():
            break
        if k >= keep:
            points = fish.points(tank.position)
            stations.append(np.einsum("ln,bnk->blk", layer, points))
            tips.append(points[:, tu.TAIL[0]] - points[:, tu.TAIL[1]])
            centre.append(mass @ tank.position)
            work.append(tank.work.copy())
            for flow, name in ((lost, "damping"), (thrust, "thrust")):
                flow.append(tank.flows[name].copy() if energy else np.full(len(gaits), np.nan))
    found = []
    for i, gait in enumerate(gaits):
        if not tank.alive[i] or not centre:
            found.append(Midline(gait.frequency, 0.0, np.full(7, np.inf), np.zeros(7), np.inf, str(tank.failure[i])))
            continue
        last = round(beats / gait.frequency / INTERVAL) + 1
        samples = (np.array(rows)[-last:, i] for rows in (stations, tips, centre, work, lost, thrust))
        found.append(_measured(fish, gait, *samples))
    return found


def swim_gait(fish: Fish, gait: Gait, **method) -> Midline:
    """Measure the cruise that a gait settles into; `method` as for `swim_midlines`."""
    start, seconds = [PUSH * gait.frequency], BEATS / gait.frequency
    return swim_midlines(fish, [gait], start, seconds, MEASURED, NOISE, **method)[0]


def _measured(fish, gait, stations, tips, centre, work, lost, thrust) -> Midline:
    """The midline of one fish, of samples (S,7,3), (S,3), (S,3) m, and (S,) J thrice over a whole number of beats."""
    path = centre[-1] - centre[0]
    along = path * (1.0, 1.0, 0.0) / np.linalg.norm(path[:2])
    across = np.cross([0.0, 0.0, 1.0], along)
    time = INTERVAL * (len(centre) - 1)
    sway = (stations - centre[0]) @ across / fish.length
    angle = 2 * np.pi * gait.frequency * INTERVAL * np.arange(len(sway))
    basis = np.stack([np.ones_like(angle), angle, angle**2, np.cos(angle), np.sin(angle)], axis=1)
    fit, *_ = np.linalg.lstsq(basis, sway, rcond=None)
    swung = sway - basis[:, :3] @ fit[:3]
    wave = fit[3] - 1j * fit[4]
    phase = -np.angle(wave / wave[-1]) / (2 * np.pi)
    forward = np.sign(path @ (stations[-1, 0] - stations[-1, -1]))
    wobble = np.ptp(tips @ across / fish.length) / np.ptp(swung[:, -1])
    speed = forward * np.linalg.norm(path[:2]) / time / fish.length
    done, way = work[-1] - work[0], fish.body.mass.sum() * np.linalg.norm(path[:2])
    return Midline(
        gait.frequency, float(speed), 0.5 * np.ptp(swung, axis=0), phase, float(wobble), "", float(done / way),
        float((lost[-1] - lost[0]) / done), float((thrust[-1] - thrust[0]) / way),
    )  # fmt: skip
