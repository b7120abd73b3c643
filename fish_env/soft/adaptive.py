"""Methods with error control, of scipy: DOP853 (Hairer, Norsett & Wanner 1993) and Radau IIA (Hairer & Wanner 1996).

They serve for reference solutions and are slow, because Python calls every force evaluation. Radau uses the exact
Jacobian, and LAPACK, the number of whose threads changes the last bits: OPENBLAS_NUM_THREADS=1 avoids that.

Legend: x, v positions and velocities of one body; f forces; y both, flattened.
"""

from functools import cache, partial
from typing import Any

import numpy as np

from fish_env.checks import check_names, real
from fish_env.physics.failures import NO_CONVERGENCE, NON_FINITE
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import FACTORISATIONS, FORCES, Body, State, World

METHODS = ("DOP853", "Radau")
TOLERANCE = 1e-10  # default of the entries in INTEGRATORS
LOWEST, HIGHEST = 1e-13, 1e-2  # below, rounding decides; above, error control does not hold
MOST_EVALUATIONS = 200_000  # per call: some seconds of computing, enough for ten seconds of swimming


class Motion:
    """Motion of body b for scipy: dy/dt and its Jacobian; FloatingPointError if one is not finite."""

    def __init__(self, body: Body, evaluator, control, b):
        self.evaluator, self.inverse_mass, self.evaluations = evaluator, body.inverse_mass, 0
        self.start, self.rate = control.rest_length[b], control.rate[b]

    def at(self, t, y):
        """Arguments of the forces at a time within the call: rest lengths (E,) m, x and v (N,3)."""
        return self.start + t * self.rate, *y.reshape(2, -1, 3)  # (1)

    def work(self, body: Body, t, y) -> float:
        """Work of the driven springs, J, over steps that end at the times t (S,) in the states y (6N,S)."""
        # Simpson's rule, with the cubic of Hermite through positions and velocities at both ends of a step.
        driven, h = np.flatnonzero(self.rate), np.diff(t)
        first, second = body.springs.nodes[driven].T
        r, u = (part[second] - part[first] for part in y.reshape(2, -1, 3, len(t)))
        middle = 0.5 * (r[..., :-1] + r[..., 1:]) + h / 8.0 * (u[..., :-1] - u[..., 1:])
        rest = [self.start[driven, None] + self.rate[driven, None] * at for at in (t, t[:-1] + 0.5 * h)]
        ends, inside = (np.linalg.norm(way, axis=1) - own for way, own in zip((r, middle), rest, strict=True))
        mean = (ends[:, :-1] + 4.0 * inside + ends[:, 1:]) / 6.0
        return float(-(body.springs.stiffness * self.rate)[driven] @ mean @ h)  # (55)

    def slope(self, t, y):
        """Time derivative of y, (6N,)."""
        self.evaluations += 1
        rest_length, x, v = self.at(t, y)
        acceleration = finite(self.evaluator.force(rest_length, x, v, t) * self.inverse_mass)
        if self.evaluations > MOST_EVALUATIONS:
            raise FloatingPointError
        return np.concatenate([v.ravel(), acceleration.ravel()])

    def jacobian(self, t, y):
        """Jacobian of `slope` with respect to y, (6N,6N)."""
        stiffness, damping = self.evaluator.jacobian(*self.at(t, y), t)
        inverse = self.inverse_mass.reshape(-1, 1)
        return finite(np.block([[0.0 * stiffness, np.eye(inverse.size)], [-stiffness * inverse, -damping * inverse]]))


@cache
def make_radau() -> Any:  # scipy accepts a class, though its annotations require a name
    """Make a subclass of scipy's Radau that raises FloatingPointError, not ValueError, if a system is not finite."""
    from scipy.integrate import Radau

    class Finite(Radau):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            factorise, solve = self.lu, self.solve_lu
            self.lu = lambda matrix: factorise(finite(matrix))
            self.solve_lu = lambda factors, load: solve(factors, finite(load))

    return Finite


def finite(array):
    """Return the array; FloatingPointError if not all of it is finite."""
    if not np.isfinite(array).all():
        raise FloatingPointError
    return array


def allowed_error(body: Body, tolerance) -> np.ndarray:
    """Absolute error tolerance of a step, (6N,): relative to the body's size and to a typical speed."""
    # The speed is the size times the frequency of its mass on a mean spring; without springs, the highest one.
    size, stiffness, rate = np.ptp(body.position, axis=0).max(), body.springs.stiffness, body.max_stiffness_eigenvalue
    if stiffness.size:
        rate = stiffness.mean() / body.mass.sum()
    return np.maximum(tolerance * np.repeat([size, size * np.sqrt(rate)], 3 * body.mass.size), np.finfo(float).tiny)


def solve(body: Body, world: World, state: State, control, duration, method="DOP853", tolerance=TOLERANCE) -> None:
    """Advance every valid body by `duration` seconds with error control; state is changed in place.

    If a body fails, the reason is recorded and its last valid state is restored: that before the call, or the rest
    position if that was invalid. Rest lengths move to the end of the call and stop. The method is "DOP853" (explicit,
    order 8) or "Radau" (implicit, order 5). The tolerance is the relative one of a step.

    Raises:
        ValueError: for an unknown method, a tolerance outside 1e-13 to 1e-2, or an invalid duration.
    """
    check_names("unknown method", METHODS, method)
    if not LOWEST <= real(tolerance) <= HIGHEST:
        raise ValueError(f"tolerance is {tolerance!r}; give a number from {LOWEST:g} to {HIGHEST:g}")
    if not 0.0 <= real(duration) < np.inf:
        raise ValueError(f"duration is {duration!r}; give a finite number of seconds, zero or more")
    evaluator = Evaluator(body, world)
    for b in np.flatnonzero(state.failure == 0):
        before, work = (state.x[b].copy(), state.v[b].copy()), state.work[b]
        failure = move(body, evaluator, state, control, b, duration, method, tolerance) if duration else 0
        control.rest_length[b] += duration * control.rate[b]
        control.rate[b] = 0.0
        wrong = ~np.isfinite(control.rest_length[b])
        control.rest_length[b, wrong] = body.springs.rest_length[wrong]
        failure = failure or failure_of(evaluator, control.rest_length[b], state.x[b], state.v[b])
        if not np.isfinite(state.t[b]):
            failure, state.t[b] = NON_FINITE, 0.0
        if failure:
            broken = failure_of(evaluator, control.rest_length[b], *before)
            state.failure[b], state.work[b] = broken or failure, work
            state.x[b], state.v[b] = (body.position, 0.0) if broken else before
        else:
            state.t[b] += duration


def failure_of(evaluator, rest_length, x, v) -> int:
    """Reason that a body in this state is invalid: an index into FAILURES, zero if it is valid."""
    if not (np.isfinite(x).all() and np.isfinite(v).all()):
        return NON_FINITE
    return min(evaluator.failures(rest_length, x), default=0)


def move(body: Body, evaluator, state: State, control, b, duration, method, tolerance) -> int:
    """Advance body b by `duration` s > 0 and count the work; return 0, or the failure code."""
    from scipy.integrate import solve_ivp  # imported here, because it takes 0.3 s and only these methods need it

    motion, y = Motion(body, evaluator, control, b), np.concatenate([state.x[b].ravel(), state.v[b].ravel()])
    if not np.isfinite(y).all():
        return NON_FINITE
    if method == "Radau":
        solver, options = make_radau(), {"jac": motion.jacobian}
    else:  # steps end at 6 / frequency anyway; a far longer first trial overflows before its rejection
        solver, options = method, {"max_step": 6.0 / max(np.sqrt(body.max_stiffness_eigenvalue), 6.0 / duration)}
    try:
        with np.errstate(all="ignore"):
            found = solve_ivp(motion.slope, (0.0, duration), y, method=solver, rtol=tolerance,
                              atol=allowed_error(body, tolerance), **options)  # fmt: skip
    except FloatingPointError:
        return NO_CONVERGENCE
    finally:
        state.counters[b, FORCES] += motion.evaluations
    state.counters[b, FACTORISATIONS] += found.nlu  # scipy does not report its solves
    if found.status == 0:
        state.x[b], state.v[b] = found.y[:, -1].reshape(2, -1, 3)
        state.work[b] += motion.work(body, found.t, found.y)
    return 0 if found.status == 0 else NO_CONVERGENCE


def advance(body: Body, world: World, state: State, control, h, n, method) -> None:
    """Advance every valid body by n h seconds; the method chooses its own steps."""
    solve(body, world, state, control, n * h, method)


advance_dop853, advance_radau = (partial(advance, method=method) for method in METHODS)
