"""Options of a tank: input validation, default values, and the records that kernels read."""

import inspect
import math
import os
from collections.abc import Mapping

import numpy as np

from fish_env.checks import as_floats, check_names, finite_array, fits_memory, is_whole, positive_array, real
from fish_env.kernels.simd import LANES, Kind
from fish_env.physics.body import scale_body
from fish_env.physics.failures import FAILURES
from fish_env.physics.fish import ElasticObject
from fish_env.physics.integrators import INTEGRATORS, Integrator
from fish_env.physics.integrity import check_objects
from fish_env.physics.records import Body, World

TESTED = 12 / 11  # of a fish's own step in water with inertia: the longest at which no tested fish fails, unrefined
REFINED = ("leapfrog_chebyshev",)  # methods that check the rate of change of their springs
MOST_STEPS = 2**53  # per call: a float64 clock cannot count more
SHORTEST = 1e-12  # s: a shorter step is lost in the rounding of an episode's clock
LONGEST = 1e9  # s: the square of a step must be finite
FACTORS = (1e-9, 1e9)  # range of the factors of `Tank.vary`: products with them must be finite
FISH_FOR_LANES = 3  # fewer fish are faster one by one
NOT_FOR_TANKS = {"dual": "moves nothing", "thread": "is for the threads of a GPU"}


def method_for(fish: ElasticObject, integrator: str | None, dt, refine) -> tuple[Integrator, float, float]:
    """Integrator of a fish, its step, s, and the strain in a step above which it is refined; ValueError if invalid."""
    if not isinstance(fish, ElasticObject):
        raise ValueError(f"fish is a {type(fish).__name__}; give a Fish, as fish_env.make_fish() makes one")
    integrator = fish.integrator if integrator is None else integrator
    check_names("unknown integrator", INTEGRATORS, integrator)
    if refine is None:
        refine = fish.refine if integrator == fish.integrator else np.inf
    dt = own_step(fish, INTEGRATORS[integrator]) if dt is None else dt
    if not real(refine) > 0:
        raise ValueError(f"refine is {refine!r}; give a positive number (this fish's own is {fish.refine}), or inf")
    if np.isfinite(real(refine)) and integrator not in REFINED:
        raise ValueError(f"{integrator!r} cannot refine its steps; give refine=inf, or choose from {REFINED}")
    if not SHORTEST <= real(dt) <= LONGEST:
        raise ValueError(
            f"dt is {dt!r}; give a positive number of seconds, at least {SHORTEST:g} and at most {LONGEST:g} (this "
            f"fish's own is {fish.time_step})"
        )
    return INTEGRATORS[integrator], real(dt), real(refine)


def checked_count(value, name: str) -> int:
    """Return `value` as a Python int, whose products cannot overflow; ValueError unless it is at least 1."""
    if not (is_whole(value) and value >= 1):
        raise ValueError(f"{name} is {value!r}; give a whole number, at least 1")
    return int(value)


def check_scene(fish: ElasticObject, world: World, integrator: Integrator, energy=False, count=1) -> None:
    """Raise ValueError if fish or world are inconsistent, or if the method cannot move so many bodies there."""
    check_objects(fish, world)
    if (world.added_mass is not None or world.righting) and fish.body.sections is None:
        raise ValueError(
            f"{fish.name!r} has no sections, on which the inertia of the water and the righting couple act; give water "
            "without them, or a body made with make_sections"
        )
    if world.added_mass is not None and world.planes is not None:
        raise ValueError("water has no model of inertia beside walls; give water without inertia, or no planes")
    if not isinstance(energy, bool | np.bool_):
        raise ValueError(f"energy is {energy!r}; give True or False")
    method, reason = integrator.method, integrator.refuses(fish.body, world)
    if not reason and energy and (method is None or "flows" not in inspect.signature(method.make_run).parameters):
        reason = "it does not measure energy flows"
    if reason:
        raise integrator_error(fish, integrator, reason)
    fits_memory(count, bytes_of(fish.body), "num_fish")


def longest_step(fish: ElasticObject, world: World, integrator: Integrator) -> float:
    """Longest stable step of a method on a body in a world, s: by linear theory, and TESTED; nan if it is unknown."""
    tested = world.added_mass is not None and integrator.name == fish.integrator
    return min(integrator.limit(fish.body, world), TESTED * fish.time_step if tested else math.inf)


def too_long(fish: ElasticObject, world: World, integrator: Integrator, dt: float) -> str:
    """Reason that a step of dt s of a method fails on a body in a world; "" if it is stable, or its limit unknown."""
    limit = longest_step(fish, world, integrator)
    return "" if not dt > limit else f"its stable steps are at most {limit:.3g} s, and dt is {dt:.3g} s"


def integrator_error(fish: ElasticObject, integrator: Integrator, reason: str) -> ValueError:
    """Error to raise if a method cannot move a fish in its world."""
    return ValueError(f"{integrator.name!r} cannot move {fish.name!r} here: {reason}; choose another integrator")


def checked_steps(steps) -> int:
    """Return a valid number of steps of one call as an int; ValueError otherwise."""
    if not (is_whole(steps) and 0 <= steps <= MOST_STEPS):
        raise ValueError(f"steps is {steps!r}; give a whole number from 0 to {MOST_STEPS}")
    return int(steps)


def checked_action(action, shape: tuple[int, int]) -> np.ndarray:
    """Actions (B,M) in [-1, 1], from (B,M) or from (M,) for all fish; ValueError for invalid ones."""
    try:
        found = as_floats(action)
    except (TypeError, OverflowError, RecursionError):
        finite_array(action, shape, "action")  # raises the specific error
        raise
    if found.shape == shape[1:]:
        found = np.broadcast_to(found, shape)
    if found.shape != shape or not np.abs(found).max() <= 1.0:
        found = finite_array(found, shape, "action")
        raise ValueError(f"action reaches {np.abs(found).max():g}; give values in [-1, 1] (clip them first)")
    return found


def checked_command(contraction, duration, shape: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Contractions (B,M) and the time for them, s; ValueError for invalid ones."""
    if not SHORTEST <= real(duration) < math.inf:
        raise ValueError(f"duration is {duration!r}; give a positive number of seconds, at least {SHORTEST:g}")
    found = finite_array(contraction, shape, "contraction")  # in C order: numba would compile again for another
    if found.size and not 0.0 <= found.min() <= found.max() <= 1.0:
        low, high = (repr(float(x)).removesuffix(".0") for x in (found.min(), found.max()))  # also 1.0000000000000002
        raise ValueError(f"contraction is from {low} to {high}; give numbers from 0 to 1")
    return found, real(duration)


def bytes_of(body: Body) -> int:
    """Approximate memory of one fish of a tank, in bytes, including one copy of its state."""
    return 8 * (12 * body.mass.size + 3 * body.springs.stiffness.size + 43)


def kind_for(num_fish: int, dtype: str, lanes: str | int | None) -> Kind:
    """Kind of kernel for a number of fish; ValueError for an unsupported precision or number of lanes."""
    if isinstance(lanes, np.integer):
        lanes = int(lanes)
    choice = ", ".join(map(repr, LANES))
    if not isinstance(lanes, str | int | None) or not isinstance(dtype, str):
        raise ValueError(f"lanes is {lanes!r} and dtype {dtype!r}; choose from {choice} and from 'float64', 'float32'")
    if lanes is None:
        many = 16 if dtype == "float32" else 8
        lanes = many if num_fish >= FISH_FOR_LANES else "xyz"
    kind = Kind(lanes, dtype)
    if lanes in NOT_FOR_TANKS:
        raise ValueError(f"lanes is {lanes!r}, which {NOT_FOR_TANKS[str(lanes)]}; choose from {choice}")
    return kind


def apply_variation(body: Body, world: World, row, length=1.0) -> tuple[Body, World]:
    """Apply a row of `Tank.variation`, and a factor on length, to a body and its world."""
    stiffness, mass, drag, viscous = (float(factor) for factor in (*row[:3], row[2] / length))
    return scale_body(body, stiffness, stiffness, mass), world._replace(
        linear=world.linear * viscous, quadratic=world.quadratic * drag, friction=world.friction * viscous,
        righting=float(world.righting / length), current=world.current + row[3:],
    )  # fmt: skip


PART = 0.5  # ratio of the default step to one that is stable


def own_step(fish: ElasticObject, integrator: Integrator, interval: float | None = None) -> float:
    """Default step of a fish, s, a whole part of a control interval; ValueError for a method without a stable step."""
    if integrator.name == fish.integrator:
        return fish.time_step
    base = integrator.base(fish.body)
    if not base > 0:
        others = ", ".join(repr(name) for name, record in INTEGRATORS.items() if record.base(fish.body) > 0)
        why = "not all of its motion is damped" if base == 0 else "it has too many nodes to compute one"
        raise ValueError(
            f"{integrator.name!r} has no known stable step on {fish.name!r}: {why}; give a dt, or choose from {others}"
        )
    interval = fish.control_interval if interval is None else interval
    return interval / max(1, math.ceil(interval / (PART * base)))


def step_within(fish: ElasticObject, integrator: str | None, interval) -> float | None:
    """Default step of another method than a fish's own in a control interval, s; None for its own, or refused ones."""
    if not isinstance(integrator, str) or integrator not in INTEGRATORS or integrator == fish.integrator:
        return None
    return own_step(fish, INTEGRATORS[integrator], real(interval)) if SHORTEST <= real(interval) <= LONGEST else None


def available_processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def whole_steps(duration: float, dt: float, name: str) -> int:
    """Number of steps of dt in the duration; ValueError unless it is a positive whole multiple."""
    seconds = real(duration)
    if not 0.0 < seconds < math.inf:
        raise ValueError(f"{name} is {duration!r}; give a positive number of seconds")
    if seconds / dt > MOST_STEPS:
        raise ValueError(f"{name} is {duration!r} s; give at most {MOST_STEPS} steps of dt = {dt!r} s")
    steps = round(seconds / dt)
    if steps < 1 or abs(steps * dt - seconds) > 1e-9 * seconds:
        raise ValueError(f"{name} is {duration!r} s; give a whole multiple of dt = {dt!r} s")
    return steps


def checked_state(state: dict, target: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays of a state that replace those of `target`; ValueError if one is missing or invalid."""
    if not isinstance(state, Mapping) or set(state) != set(target):
        held = sorted(map(str, state)) if isinstance(state, Mapping) else repr(state)
        raise ValueError(f"state holds {held}; give {sorted(target)}, as get_state returns them")
    checked = {name: finite_array(state[name], array.shape, name) for name, array in target.items()}
    positive_array(checked["rest_length"], checked["rest_length"].shape, "rest_length")
    positive_array(checked["length_variation"], checked["length_variation"].shape, "length_variation")
    for row in checked["variation"]:
        checked_variation(row[0], row[1], row[2], row[3:])
    for row in checked["muscle_variation"]:
        checked_muscle_variation(*row)
    if not np.isin(checked["failure"], range(len(FAILURES))).all():
        raise ValueError(f"failure is {checked['failure']}; give whole numbers from 0 to {len(FAILURES) - 1}")
    counters = checked["counters"]
    if not (np.equal(np.floor(counters), counters) & (counters >= 0) & (counters <= MOST_STEPS)).all():
        raise ValueError(f"counters are {counters}; give whole numbers, zero or more, at most {MOST_STEPS}")
    return checked


def checked_muscle_variation(strength, contraction_time) -> np.ndarray:
    """Row (2,) of `Tank.muscle_variation`; ValueError for invalid values."""
    row = positive_array([strength, contraction_time], (2,), "factors on strength and contraction time")
    if not (0.01 <= row[0] <= 1.5 and 0.01 <= row[1] <= 100.0):
        raise ValueError(
            f"strength and contraction_time are {row}; give factors from 0.01 to 1.5, and from 0.01 to 100"
        )
    return row


def checked_variation(stiffness, mass, drag, current, length=1.0) -> np.ndarray:
    """Row (6,) of `Tank.variation`; ValueError for invalid values."""
    *factors, length = positive_array([stiffness, mass, length], (3,), "factors on stiffness, mass and length")
    if not 0.01 <= length <= 100.0:
        raise ValueError(f"the factor on length is {length:g}; give a number from 0.01 to 100")
    factors[0] /= length**2  # (73)
    drag = positive_array([drag], (1,), "factor on drag", zero=True)
    row = np.concatenate([factors, drag, finite_array(current, (3,), "current (m/s)")])
    low, high = FACTORS
    if not (row[:2].min() >= low and row[:3].max() <= high):
        raise ValueError(f"factors on stiffness, mass and drag are {row[:3]}; give numbers from {low:g} to {high:g}")
    return row
