"""Methods with error control, of scipy: DOP853 (Hairer, Norsett & Wanner 1993) and Radau IIA (Hairer & Wanner 1996).

For references, not for speed: they are entered from Python for every force. Radau is handed the exact Jacobian. It
solves with LAPACK, whose threads get in each other's way on a busy machine: OPENBLAS_NUM_THREADS=1 ends that.

Legend: x, v positions and velocities of one body; f forces; y both, flattened.
"""

from functools import partial
from numbers import Real

import numpy as np

from fish_env import forces
from fish_env.body import NO_CONVERGENCE, NON_FINITE
from fish_env.integrators._common import count, rest_lengths, settle

METHODS = ("DOP853", "Radau")
TOLERANCE = 1e-10  # of the entries in INTEGRATORS
LOWEST, HIGHEST = 1e-13, 1e-2  # below, rounding decides; above, error control does not hold
MOST_EVALUATIONS = 200_000  # a call: some seconds, in which a sound fish swims for ten; what needs more never ends


class Motion:
    """The motion of one body as scipy takes it: dy/dt and its Jacobian; FloatingPointError where one is not finite."""

    def __init__(self, body, world, control, b):
        self.body, self.world, self.control, self.b = body, world, control, b
        nodes = body.mass.size
        self.shape = (2, nodes, 3)
        self.rest, self.f = np.empty(body.springs.stiffness.size), np.empty((nodes, 3))
        self.stiffness, self.damping = np.empty((3 * nodes, 3 * nodes)), np.empty((3 * nodes, 3 * nodes))
        self.evaluations = 0

    def slope(self, t, y):
        """dy/dt, (6N,)."""
        self.evaluations += 1
        x, v = y.reshape(self.shape)
        rest_lengths(self.control, self.b, t, self.rest)
        forces.total(self.body, self.world, self.rest, x, v, self.f)
        if not np.isfinite(self.f).all() or self.evaluations > MOST_EVALUATIONS:
            raise FloatingPointError
        return np.concatenate([v.ravel(), (self.f * self.body.inverse_mass).ravel()])

    def jacobian(self, t, y):
        """Its derivative with respect to y, (6N,6N)."""
        x, v = y.reshape(self.shape)
        rest_lengths(self.control, self.b, t, self.rest)
        forces.jacobian(self.body, self.world, self.rest, x, v, self.stiffness, self.damping)
        inverse = self.body.inverse_mass.reshape(-1, 1)
        upper = np.hstack([np.zeros_like(self.stiffness), np.eye(inverse.size)])
        matrix = np.vstack([upper, np.hstack([-self.stiffness * inverse, -self.damping * inverse])])
        if not np.isfinite(matrix).all():
            raise FloatingPointError
        return matrix


def allowed_error(body, tolerance) -> np.ndarray:
    """Absolute error a step may make, (6N,): of the body's size, and of the speed its mass has on a mean unit.

    Without units, it is the speed that moves it by its size in a period of its fastest vibration, over 2 pi.
    """
    size = np.ptp(body.position, axis=0).max()
    rate = body.springs.stiffness.mean() / body.mass.sum() if body.springs.stiffness.size else body.elastic_rate
    speed = size * np.sqrt(rate)
    scale = np.repeat([size, speed], 3 * body.mass.size)
    return np.maximum(tolerance * scale, np.finfo(float).tiny)


def solve(body, world, state, control, duration, method="DOP853", tolerance=TOLERANCE) -> None:
    """Move every sound body `duration` seconds with error control; state is changed in place.

    Args:
        body: of every fish.
        world: what surrounds them.
        state: their motion (B bodies).
        control: their rest lengths.
        duration: s, zero or more.
        method: "DOP853" (explicit, order 8) or "Radau" (implicit, order 5).
        tolerance: relative error a step may make; `allowed_error` says what it means for small numbers.

    Raises:
        ValueError: for an unknown method, a tolerance outside 1e-13 to 1e-2, or such a duration.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; choose from {', '.join(map(repr, METHODS))}")
    if not (isinstance(tolerance, Real) and LOWEST <= tolerance <= HIGHEST):
        raise ValueError(f"tolerance is {tolerance!r}; give a number from {LOWEST:g} to {HIGHEST:g}")
    if not (isinstance(duration, Real) and np.isfinite(duration) and duration >= 0):
        raise ValueError(f"duration is {duration!r}; give a finite number of seconds, zero or more")
    for b in np.flatnonzero(state.failure == 0):
        before_x, before_v = state.x[b].copy(), state.v[b].copy()
        failure = move(body, world, state, control, b, duration, method, tolerance) if duration else 0
        settle(body, state, control, b, before_x, before_v, failure, duration)


def move(body, world, state, control, b, duration, method, tolerance) -> int:
    """Positions and velocities of body b after `duration` s > 0, counted; 0, or why there are none."""
    from scipy.integrate import solve_ivp  # 0.3 s that only these methods need

    motion = Motion(body, world, control, b)
    y = np.concatenate([state.x[b].ravel(), state.v[b].ravel()])
    if not np.isfinite(y).all():
        return NON_FINITE
    if method == "Radau":
        options = {"jac": motion.jacobian}
    else:  # DOP853 ends at 6 / frequency anyway; a first trial step far beyond overflows before it is rejected
        options = {"max_step": 6.0 / max(np.sqrt(body.elastic_rate), 6.0 / duration)}
    factorisations = 0
    try:
        with np.errstate(all="ignore"):
            found = solve_ivp(motion.slope, (0.0, duration), y, method=method, rtol=tolerance,
                              atol=allowed_error(body, tolerance), **options)  # fmt: skip
        factorisations, sound = found.nlu, found.status == 0
    except FloatingPointError:
        sound = False
    count(state, b, motion.evaluations, factorisations, 0)  # scipy does not tell its solves
    if not sound:
        return NO_CONVERGENCE
    state.x[b], state.v[b] = found.y[:, -1].reshape(motion.shape)
    return 0


def advance(body, world, state, control, h, n, method) -> None:
    """Move every sound body n h seconds; the length of a step is the method's own choice."""
    solve(body, world, state, control, n * h, method)


advance_dop853 = partial(advance, method="DOP853")
advance_radau = partial(advance, method="Radau")
