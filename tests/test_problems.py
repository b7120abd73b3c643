"""The scenes on which methods are compared: contents, references, and the error of the default on the hardest."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy import refinement, work_precision
from benchmarks.common import problems
from benchmarks.common.actions import actions
from benchmarks.common.charts import METHOD_STYLE
from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.control import best_gait

TURN, FISH = problems.problems()["turn"], make_fish()


@pytest.fixture(scope="module")
def truth():
    """The abrupt manoeuvre, to 1e-6 of a body length."""
    return problems.run(TURN, "rk4", 128)[0]


def error(truth, name, steps, **options):
    """Distance of the manoeuvre by a method with so many steps a control interval, inf if the fish fails."""
    path, tank = problems.run(TURN, name, steps, **options)
    return problems.distance(TURN.fish, path, truth) if tank.alive[0] else np.inf


def test_scene():
    """Scaled, it is the same fish with other constants; the turn is all muscles of the right side, then of the left."""
    fish, goal = TURN.fish, TURN.contraction
    other = problems.scaled(fish, stiffness=4.0, damping=3.0, mass=2.0)
    for found, wanted in ((other.body.springs.stiffness, 4.0 * fish.body.springs.stiffness),
                          (other.body.springs.damping, 3.0 * fish.body.springs.damping),
                          (other.body.mass, 2.0 * fish.body.mass), (other.muscles, fish.muscles)):  # fmt: skip
        np.testing.assert_array_equal(found, wanted)
    assert other.body.max_stiffness_eigenvalue == pytest.approx(2.0 * fish.body.max_stiffness_eigenvalue, rel=1e-12)
    assert other.body.max_damping_eigenvalue == pytest.approx(1.5 * fish.body.max_damping_eigenvalue, rel=1e-12)
    np.testing.assert_array_equal(goal[problems.LEAD], fish.sides < 0)
    np.testing.assert_array_equal(goal[problems.LEAD + problems.RIGHT], fish.sides > 0)
    assert len(goal) * fish.control_interval == pytest.approx(2.0)
    assert goal.min() >= 0 and goal.max() <= 1
    assert set(METHOD_STYLE) == {n for n, record in INTEGRATORS.items() if record.kind != "adaptive"}


def test_references():
    """The path of the free vibration by halved RK4 steps is that of scipy's DOP853; too few steps are an error."""
    scene = problems.problems()["vibration"]
    path, substeps, change = problems.reference(scene)
    assert change <= problems.CONVERGED and substeps >= 2048
    assert problems.distance(scene.fish, problems.independent(scene), path) < 1e-9
    for steps, text in (((8, 16), r"turn: RK4 with 16 .* differs by .* allow more steps"), ((1, 2), "differs by inf")):
        with pytest.raises(problems.NotConvergedError, match=text):
            problems.reference(TURN, *steps)


def test_turn(truth):
    """On the turn the default is accurate to 1 % of a body length, also with five steps a control interval.

    It magnifies a disturbance less than a thousandfold, so an error on it is the method's. Tu's method fails with 20
    steps, and is accurate with its own; with twice as many, its error halves.
    """
    fish = TURN.fish
    assert error(truth, fish.integrator, problems.steps_of(fish), refine=fish.refine) <= work_precision.ACCURATE
    assert error(truth, "leapfrog_chebyshev", 5) <= work_precision.ACCURATE
    assert 1.0 < problems.magnified(TURN, truth, 128) < 1000.0
    own = round(fish.control_interval / Tank(fish, 1, "semi_implicit").dt)
    assert error(truth, "semi_implicit", 20) == np.inf > error(truth, "semi_implicit", 28)
    assert error(truth, "semi_implicit", own) <= 0.5 * work_precision.ACCURATE
    assert error(truth, "semi_implicit", 2 * own) <= 0.3 * work_precision.ACCURATE
    assert error(truth, "semi_implicit", round(own / 3)) > work_precision.ACCURATE


@pytest.mark.parametrize(("frequency", "by_default", "by_midpoint"), [(4.0, 0.0093, 0.0001), (5.0, 0.069, 0.002)])
def test_fast_strokes(frequency, by_default, by_midpoint):
    """Errors of the best gait and of the same at 5 Hz, as the page gives them; midpoint with 24 steps is better."""
    goal = replace(best_gait(), frequency=frequency).contraction(FISH, FISH.control_interval * np.arange(1, 101))
    scene = problems.Problem("fast", "a fast stroke", FISH, FISH.water, goal)
    reference = problems.run(scene, "rk4", 64)[0]
    for name, steps, off in ((FISH.integrator, problems.steps_of(FISH), by_default), ("midpoint", 24, by_midpoint)):
        path, _ = problems.run(scene, name, steps)
        assert problems.distance(FISH, path, reference) == pytest.approx(off, rel=0.1)


def test_rows(truth):
    """A row has an error and work, or a reason; the least expensive one is accurate at finer steps, too."""
    row = work_precision.measure(TURN, "rk4", 16, truth, seconds=False)
    assert (row["scene"], row["integrator"], row["substeps"]) == ("turn", "rk4", 16)
    assert row["error"] < 1e-3 and row["forces_per_interval"] == 64 and row["failure"] == ""
    failed = work_precision.measure(TURN, "symplectic_euler", 4, truth, seconds=False)
    assert np.isinf(failed["error"]) and np.isnan(failed["forces_per_interval"]) and failed["failure"]
    rows = [
        {"scene": "s", "integrator": "a", "refine": np.inf, "substeps": k, "error": off, "us_per_interval": float(k)}
        for k, off in ((1, 0.001), (2, 0.5), (4, 0.009), (8, 0.002))
    ]
    rows.append(rows[0] | {"integrator": "b", "error": np.inf, "us_per_interval": np.nan})
    rows.append(rows[0] | {"refine": 0.1, "substeps": 3, "us_per_interval": 5.0})
    assert work_precision.least_expensive(rows, "s", ["a", "b"])["substeps"] == 4


# Refined intervals


def test_meter():
    """Steps are counted with the repeated ones: two force evaluations each where the longest need no more."""
    steps = 40
    tank = Tank(FISH, 16, water=FISH.water, dt=FISH.control_interval / steps, refine=0.003)
    meter = refinement.Meter(tank)
    for action in actions(FISH, "random")[:20]:
        tank.swim(action, FISH.control_interval)
        meter.read(steps)
    row = meter.row()
    assert 0.1 < row["intervals_refined"] < 1.0 and row["steps_taken"] > 1.2 * steps
    assert row["forces_per_interval"] == pytest.approx(2.0 * row["steps_taken"], rel=1e-4)


def test_refinement(truth):
    """The default is as accurate in float32; steps of a whole interval tear the fish unless they are refined.

    The error, that of float32, and the margin of the step on fish half to twice as stiff are as published.
    """
    double, _ = problems.run(TURN, FISH.integrator, problems.steps_of(FISH), refine=FISH.refine)
    row = refinement.measure(TURN, problems.steps_of(FISH), FISH.refine, double, dtype="float32")
    assert 0.0 < row["error"] <= refinement.SINGLE and row["against"] == "float64"
    assert refinement.measure(TURN, 1, np.inf, truth)["error"] == np.inf
    assert refinement.measure(TURN, 1, FISH.refine, truth)["error"] < np.inf
    fixed, refined = (refinement.stable(FISH, "turn", refine) for refine in (np.inf, FISH.refine))
    assert fixed["fewest_steps"] > 1 and fixed["beyond"].startswith("torn")
    assert refined["largest_stable_ms"] == pytest.approx(20.0) and not refined["beyond"]
    assert refinement.bars()
