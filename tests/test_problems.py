"""The scenes methods are compared on: what they hold, their references, and the default's error on the hardest."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy import work_precision
from benchmarks.common import problems
from benchmarks.common.charts import METHOD_STYLE
from fish_env import Tank, make_fish
from fish_env.control import best_gait

TURN, FISH = problems.problems()["turn"], make_fish()


def test_left_after_right():
    """All muscles of the right side pull and none of the left, then the other way round; two seconds in all."""
    fish, goal = TURN.fish, TURN.contraction
    right, left = goal[problems.LEAD], goal[problems.LEAD + problems.RIGHT]
    np.testing.assert_array_equal(right, fish.sides < 0)
    np.testing.assert_array_equal(left, fish.sides > 0)
    assert len(goal) * fish.control_interval == pytest.approx(2.0)
    assert goal.min() >= 0 and goal.max() <= 1


def test_reference_agrees_with_another_method():
    """The path of the free vibration by halved RK4 steps is that of scipy's DOP853."""
    scene = problems.problems()["vibration"]
    truth, substeps, change = problems.reference(scene)
    assert change <= problems.CONVERGED and substeps >= 2048
    assert problems.distance(scene.fish, problems.independent(scene), truth) < 1e-9


def test_a_reference_that_does_not_converge_is_an_error():
    """Too few steps are refused as a reference, naming the scene, what is left and what to do; so is one that fails."""
    with pytest.raises(problems.NotConvergedError, match=r"turn: RK4 with 16 .* differs by .* allow more steps"):
        problems.reference(TURN, 8, 16)
    with pytest.raises(problems.NotConvergedError, match="differs by inf"):
        problems.reference(TURN, 1, 2)


@pytest.fixture(scope="module")
def truth():
    """The abrupt manoeuvre, to 1e-6 of a body length."""
    return problems.run(TURN, "rk4", 128)[0]


def test_default_is_accurate(truth):
    """The default method, refined, and with one step fewer: within 1 % of a body length over the abrupt manoeuvre."""
    fish = TURN.fish
    for steps, refine in ((problems.steps_of(fish), fish.refine), (5, np.inf)):
        path, tank = problems.run(TURN, fish.integrator, steps, refine=refine)
        assert tank.alive[0] and problems.distance(fish, path, truth) <= work_precision.ACCURATE


def test_the_manoeuvre_is_predictable(truth):
    """It magnifies a disturbance less than a thousandfold: an error on it is the method's, not a buckling fish's."""
    assert 1.0 < problems.magnified(TURN, truth, 128) < 1000.0


@pytest.mark.parametrize(("frequency", "by_default", "by_midpoint"), [(4.0, 0.0093, 0.0001), (5.0, 0.069, 0.002)])
def test_fast_strokes(frequency, by_default, by_midpoint):
    """Errors of the best gait and of the same at 5 Hz, as the page gives them; midpoint with 24 steps is better."""
    goal = replace(best_gait(), frequency=frequency).contraction(FISH, FISH.control_interval * np.arange(1, 101))
    scene = problems.Problem("fast", "a fast stroke", FISH, FISH.water, goal)
    reference = problems.run(scene, "rk4", 64)[0]
    for name, steps, error in ((FISH.integrator, problems.steps_of(FISH), by_default), ("midpoint", 24, by_midpoint)):
        path, _ = problems.run(scene, name, steps)
        assert problems.distance(FISH, path, reference) == pytest.approx(error, rel=0.1)


def test_the_step_of_tus_method_is_accurate(truth):
    """Its own step is accurate on this manoeuvre, not only stable, and of first order; one that is longer fails."""
    own = round(TURN.fish.control_interval / Tank(TURN.fish, 1, "semi_implicit").dt)
    for steps, error in ((own, 0.5), (2 * own, 0.3)):
        path, _ = problems.run(TURN, "semi_implicit", steps)
        assert problems.distance(TURN.fish, path, truth) <= error * work_precision.ACCURATE
    assert not problems.run(TURN, "semi_implicit", 20)[1].alive[0]


def test_a_row(truth):
    """A row names scene, method and step; a sound run has an error and work, a failed one a reason and neither."""
    sound = work_precision.measure(TURN, "rk4", 16, truth, seconds=False)
    assert (sound["scene"], sound["integrator"], sound["substeps"]) == ("turn", "rk4", 16)
    assert sound["error"] < 1e-3 and sound["forces_per_interval"] == 64 and sound["failure"] == ""
    failed = work_precision.measure(TURN, "symplectic_euler", 4, truth, seconds=False)
    assert np.isinf(failed["error"]) and np.isnan(failed["forces_per_interval"]) and failed["failure"]


def test_least_expensive():
    """The least expensive accurate row is found only among steps below which everything is accurate."""
    rows = [
        {"scene": "s", "integrator": "a", "refine": np.inf, "substeps": k, "error": error, "us_per_interval": float(k)}
        for k, error in ((1, 0.001), (2, 0.5), (4, 0.009), (8, 0.002))
    ]
    rows.append(rows[0] | {"integrator": "b", "error": np.inf, "us_per_interval": np.nan})
    rows.append(rows[0] | {"refine": 0.1, "substeps": 3, "us_per_interval": 5.0})
    assert work_precision.least_expensive(rows, "s", ["a", "b"])["substeps"] == 4


def test_every_method_has_a_style():
    """Every fixed-step method is told apart in the charts."""
    assert set(METHOD_STYLE) == set(problems.FIXED)


# Refined intervals


def test_single_precision():
    """The default in float32 stays within 5e-6 body lengths of float64 over the abrupt manoeuvre."""
    steps = problems.steps_of(FISH)
    double, single = (problems.run(TURN, FISH.integrator, steps, refine=FISH.refine, dtype=dtype)[0]
                      for dtype in ("float64", "float32"))  # fmt: skip
    assert 0.0 < problems.distance(FISH, single, double) <= 5e-6


def test_refinement_allows_long_steps():
    """A step of a whole control interval tears the fish on the turn, and does not with the default's refinement."""
    for refine, survives in ((np.inf, False), (FISH.refine, True)):
        assert problems.run(TURN, FISH.integrator, 1, refine=refine)[1].alive[0] == survives


@pytest.mark.parametrize("stiffness", [0.5, 2.0])
def test_three_times_the_default_step(stiffness):
    """Under random commands, a fish half or twice as stiff is stable at steps of 10 ms, as docs/ say."""
    fish = problems.scaled(FISH, stiffness)
    tank = Tank(fish, 16, water=fish.water, dt=0.01, refine=FISH.refine, threads=1)
    for goal in np.random.default_rng(0).uniform(size=(150, 16, fish.num_muscles)):
        tank.drive(goal, 2)
    assert tank.alive.all()
