"""A body swum by a given midline: its speed, the force of the water, the bending torque and the power.

Every node keeps its place along the midline and its offsets across it and upward. The frame of the midline moves freely
in the plane, by the balance of momentum and of angular momentum, or it is towed.

Legend: q place, m, and angle, rad, of the frame; u its velocity; p nodes in the frame, m; B mass and added mass.
"""

from typing import NamedTuple

import numpy as np

from fish_env.checks import as_floats, positive_array, real
from fish_env.physics import forces
from fish_env.physics.fish import Fish
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import World
from fish_env.physics.world import checked_water

INSTANTS = 128  # at which a period is sampled; a step of the Runge-Kutta method spans two of them
PLACES = np.linspace(0.0, 1.0, 101)  # along the body, at which a function is sampled
STATIONS = np.linspace(0.0, 1.0, 41)  # at which the torque is reported
STRETCH = 0.05  # of the length, that the points of a midline may be off
SETTLED = 1e-5  # body lengths a period, by which the velocity may still change from one period to the next
MOST = 1000  # periods


class Prescribed(NamedTuple):
    """Motion of a body swum by a given midline, and what acts on it, at T instants of one period and K stations.

    Axes point forward along the mean heading, to the left of it, and upward.
    """

    speed: float
    """Mean speed of the centre of mass along the mean heading, m/s; negative if it is backward."""
    relative_speed: float
    """The same, body lengths/s."""
    strouhal: float
    """Strouhal number: frequency times the sweep of the tail over the speed; infinite at rest."""
    time: np.ndarray
    """(T,) s."""
    position: np.ndarray
    """(T,N,3) m, of the nodes."""
    force: np.ndarray
    """(T,2) N, of the water on the body."""
    power: np.ndarray
    """(T,) W, that the bending puts in."""
    station: np.ndarray
    """(K,) body lengths from the nose."""
    sweep: np.ndarray
    """(K,) body lengths, peak to peak, of each station across the mean path."""
    torque: np.ndarray
    """(T,K) N m, bending torque about the vertical: the body before a station exerts it on the body behind it."""


def prescribe(fish: Fish, midline, period: float, water: World | None = None, speed: float | None = None) -> Prescribed:
    """Swim a body by a midline until its motion is periodic.

    Args:
        fish: any body.
        midline: offsets to the left, body lengths, at places from 0, the nose, to 1, the tail. A function of the
            places (S,) and the time, s, or an array (T,S) of evenly spaced instants of a period and places. Places are
            along the body, which keeps its length. With a last axis of 2, it has points: backward, to the left.
        period: s.
        water: None takes the fish's own. Of all forces, only those of the water and a user's own act.
        speed: at which the frame of the midline is towed forward, without sway or yaw, m/s; None lets it move freely.

    Raises:
        ValueError: for a midline that is not finite, not periodic, of another shape or stretches the body, for a
            period that is not positive, and a speed that is not finite.
        ArithmeticError: if the motion does not become periodic, or the water is too heavy for the steps taken.
    """
    period = float(positive_array(period, (), "period (s)"))
    if speed is not None and not np.isfinite(real(speed)):
        raise ValueError(f"speed is {speed!r}; give a finite number of m/s, or None")
    water = fish.water if water is None else checked_water(water, fish.water)
    swimmer = _Swimmer(fish, _angles(_given(midline, period)), period, water)
    if speed is not None:
        return swimmer.report(np.array([speed, 0.0, 0.0]), free=False)
    u, size, change = swimmer.at_rest(), np.array([1.0, 1.0, fish.length]), np.inf
    for _ in range(MOST):
        q, after = swimmer.swim(u)[-1]
        after = np.append(_turned(after[:2], -q[2]), after[2])
        change, u = (np.abs(after - u) * size).max(), after
        if not np.isfinite(change):
            why = f"the water is too heavy for {INSTANTS // 2} steps in a period of {period:g} s"
            raise ArithmeticError(f"the velocity grows without limit: {why}; give a shorter period, or lighter water")
        if change * period <= SETTLED * fish.length:
            return swimmer.report(u)
    raise ArithmeticError(f"the motion is not periodic after {MOST} periods: the velocity changes by {change:g} m/s")


def _given(midline, period: float) -> np.ndarray:
    """The midline as offsets (INSTANTS,S) or points (INSTANTS,S,2), body lengths."""
    from scipy.signal import resample  # imported here, because it takes 0.3 s and only a table needs it

    asked = "give a function of places (S,) and time, or an array (T,S), of offsets, or of points with a last axis of 2"
    time = np.arange(INSTANTS + 1) * (period / INSTANTS)
    try:
        given = as_floats([midline(PLACES, t) for t in time] if callable(midline) else midline)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"midline is not an array of numbers ({error}); {asked}") from error
    if given.ndim not in (2, 3) or given.shape[2:] not in ((), (2,)) or given.shape[1] < 4 or len(given) == 0:
        raise ValueError(f"midline has shape {given.shape}; {asked}, at four places or more")
    if not np.isfinite(given).all():
        k, place = (int(i) for i in np.argwhere(~np.isfinite(given))[0][:2])
        raise ValueError(f"midline is not finite at instant {k}, place {place}; give finite body lengths")
    if not callable(midline):
        return np.asarray(resample(given, INSTANTS))
    gap = np.abs(given[-1] - given[0]).max()
    if gap > 1e-6:
        raise ValueError(f"midline changes by {gap:.3g} body lengths from one period of {period:g} s to the next; "
                         "give one that repeats itself, or its period")  # fmt: skip
    return given[:-1]


def _angles(given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (T,P) rad of the midline to the backward axis at PLACES, and the place (T,2) of the nose, body lengths."""
    from scipy.interpolate import CubicSpline  # imported here for the same reason

    if given.ndim == 2:
        slope = CubicSpline(np.linspace(0.0, 1.0, given.shape[1]), given, axis=1)(PLACES, 1)
        if (steepest := np.abs(slope).max()) >= 1.0:
            raise ValueError(f"midline stretches the body: its offset changes by {steepest:.3g} body lengths a body "
                             "length; give less than 1")  # fmt: skip
        return np.arcsin(slope), np.stack([np.zeros(len(given)), given[:, 0]], axis=1)
    chord = np.linalg.norm(np.diff(given, axis=1), axis=2)
    length = chord.sum(axis=1)
    worst = length[np.abs(length - 1.0).argmax()]
    if abs(worst - 1.0) > STRETCH or not chord.all():
        raise ValueError(f"midline stretches the body: its points are {worst:.3g} body lengths long; "
                         f"give different points, 1 body length long to {STRETCH:g}")  # fmt: skip
    slopes = np.array([
        CubicSpline(np.append(0.0, np.cumsum(row)) / row.sum(), points)(PLACES, 1)
        for row, points in zip(chord, given, strict=True)
    ])  # fmt: skip
    return np.unwrap(np.arctan2(slopes[..., 1], slopes[..., 0]), axis=1), given[:, 0]


def _turned(vectors: np.ndarray, angle: float) -> np.ndarray:
    """Vectors (...,2 or 3) turned to the left about the vertical, by an angle in rad."""
    (x, y), c, s = np.moveaxis(vectors[..., :2], -1, 0), np.cos(angle), np.sin(angle)
    return np.concatenate([np.stack([c * x - s * y, s * x + c * y], axis=-1), vectors[..., 2:]], axis=-1)


def _across(vectors: np.ndarray) -> np.ndarray:
    """Horizontal parts of vectors (...,3), turned to the left by a right angle."""
    return np.stack([-vectors[..., 1], vectors[..., 0], np.zeros(vectors.shape[:-1])], axis=-1)


def _effect(r: np.ndarray) -> np.ndarray:
    """Velocity (3,N,3) of places r (N,3) when the frame moves along x, along y, and turns, at 1 m/s or 1 rad/s."""
    return np.stack([np.broadcast_to(axis, r.shape) for axis in np.eye(3)[:2]] + [_across(r)])


def _balance(effect: np.ndarray, heavy: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Multiples (3,) of the motions of the frame whose inertia `heavy` (3,N,3) leaves no resultant of a load (N,3)."""
    return -np.linalg.solve(np.tensordot(effect, heavy, ([1, 2], [1, 2])), np.tensordot(effect, load, 2))


class _Instant(NamedTuple):
    """The body at one instant."""

    x: np.ndarray  # (N,3) m
    line: np.ndarray  # (K,3) m, of the stations
    bending: np.ndarray  # (N,3) m/s, of the nodes in the frame
    held: np.ndarray  # (N,3) N, by which the bent body moves its nodes
    water: np.ndarray  # (N,3) N, force of the water
    change: np.ndarray  # (3,) acceleration of the frame


class _Swimmer:
    """A body that is bent, in the frame of its midline, and the water around it."""

    def __init__(self, fish: Fish, midline: tuple[np.ndarray, np.ndarray], period: float, water: World):
        from scipy.interpolate import CubicSpline

        x, y, z = fish.body.position.T
        self.fish, self.period, self.mass, (angle, nose) = fish, period, fish.body.mass[:, None], midline
        around = {"water", "reactive", *(water.extra or {})}
        names = tuple(name for name in forces.present(fish.body, water) if name in around)
        self.water, self.place = Evaluator(fish.body, water, names), (x.max() - x) / np.ptp(x)
        place = np.append(self.place, STATIONS)
        aside, up = (np.append(values, np.zeros(STATIONS.size)) for values in (y, z))
        cos, sin = (CubicSpline(PLACES, part(angle), axis=1) for part in (np.cos, np.sin))
        along, left = nose.T[:, :, None] + np.stack([part.antiderivative()(place) for part in (cos, sin)])
        self.p = np.stack([
            -fish.length * along + aside * sin(place), fish.length * left + aside * cos(place),
            np.broadcast_to(up, along.shape),
        ], axis=2)  # fmt: skip
        rate = 2j * np.pi / period * np.arange(INSTANTS // 2 + 1)[:, None, None]
        rate[-1] = 0.0  # of the highest frequency only the cosine is known
        waves = np.fft.rfft(self.p, axis=0)
        self.first, self.second = (np.fft.irfft(waves * rate**order, INSTANTS, axis=0) for order in (1, 2))

    def at_rest(self) -> np.ndarray:
        """Velocity (3,) of the frame at the first instant with which the body has no momentum."""
        n = len(self.mass)
        effect = _effect(self.p[0, :n])
        return _balance(effect, self.mass * effect, self.mass * self.first[0, :n])

    def at(self, k: int, q, u, free: bool = True) -> _Instant:
        """The body at instant k, and the acceleration that balances momentum and angular momentum if it is free."""
        p, first, second = (_turned(part[k % INSTANTS], q[2]) for part in (self.p, self.first, self.second))
        n, here = len(self.mass), (q[0], q[1], 0.0)
        r, bending = p[:n], first[:n]
        effect = _effect(r)
        x, v = r + here, bending + np.tensordot(u, effect, 1)
        a = second[:n] + 2.0 * u[2] * _across(bending) + u[2] ** 2 * _across(_across(r))
        held, change = self.mass * a + self.water.inertia(x, a) - self.push(x, v), np.zeros(3)
        if free:
            heavy = self.mass * effect + np.array([self.water.inertia(x, motion) for motion in effect])
            change = _balance(effect, heavy, held)
            held = held + np.tensordot(change, heavy, 1)
        return _Instant(
            x, p[n:] + here, bending, held, self.mass * (a + np.tensordot(change, effect, 1)) - held, change
        )

    def push(self, x, v) -> np.ndarray:
        """Force of the water on the nodes (N,3) N, but for its resistance to their acceleration."""
        f = self.water.force(self.fish.body.springs.rest_length, x, v)
        return f + self.water.inertia(x, self.fish.body.inverse_mass * f)

    def swim(self, u, free: bool = True) -> list:
        """Place and velocity of the frame, (3,) each, at every second instant of a period and at its end."""
        q, h, motion = np.zeros(3), 2.0 * self.period / INSTANTS, []
        for k in range(0, INSTANTS, 2):
            motion.append((q, u))
            first = self.at(k, q, u, free).change
            second = self.at(k + 1, q + 0.5 * h * u, u + 0.5 * h * first, free).change
            third = self.at(k + 1, q + 0.5 * h * u + 0.25 * h * h * first, u + 0.5 * h * second, free).change
            fourth = self.at(k + 2, q + h * u + 0.5 * h * h * second, u + h * third, free).change
            q = q + h * u + h * h / 6.0 * (first + second + third)
            u = u + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        return [*motion, (q, u)]

    def report(self, u, free: bool = True) -> Prescribed:
        """The period that begins with the velocity u (3,) of the frame."""
        instants = [self.at(2 * k, q, v, free) for k, (q, v) in enumerate(self.swim(u, free))]
        x, line, bending, held, water = (np.array(part) for part in list(zip(*instants, strict=True))[:5])
        forward, path = (line[:-1, 0] - line[:-1, -1]).mean(axis=0), ((x[-1] - x[0]) * self.mass).sum(axis=0)
        path /= self.mass.sum()
        moved = np.copysign(np.hypot(*path[:2]), path @ forward)
        toward = path * moved if abs(moved) > SETTLED * self.fish.length else forward
        heading = np.arctan2(toward[1], toward[0]) if free else 0.0
        x, line, bending, held, water = (_turned(part[:-1], -heading) for part in (x, line, bending, held, water))
        sweep = np.ptp(line[..., 1], axis=0) / self.fish.length
        behind = (self.place[:, None] > STATIONS).astype(float)  # (N,K)
        moment = (x[..., 0] * held[..., 1] - x[..., 1] * held[..., 0]) @ behind
        torque = moment - line[..., 0] * (held[..., 1] @ behind) + line[..., 1] * (held[..., 0] @ behind)
        speed = moved / self.period
        return Prescribed(
            speed, speed / self.fish.length, sweep[-1] * self.fish.length / abs(moved) if moved else np.inf,
            np.arange(len(x)) * 2.0 * self.period / INSTANTS, x, water.sum(axis=1)[:, :2],
            np.einsum("tnc,tnc->t", held, bending), STATIONS, sweep, torque,
        )  # fmt: skip
