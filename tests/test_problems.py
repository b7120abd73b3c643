"""The scenes on which methods are compared: contents, references, and the error of the default on the hardest."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.accuracy import held_out, work_precision
from benchmarks.common import problems
from benchmarks.common.charts import METHOD_STYLE
from fish_env import Tank, make_fish
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


def test_left_after_right():
    """All muscles of the right side pull and none of the left, then the other way round; two seconds in all."""
    fish, goal = TURN.fish, TURN.contraction
    np.testing.assert_array_equal(goal[problems.LEAD], fish.sides < 0)
    np.testing.assert_array_equal(goal[problems.LEAD + problems.RIGHT], fish.sides > 0)
    assert len(goal) * fish.control_interval == pytest.approx(2.0)
    assert goal.min() >= 0 and goal.max() <= 1
    assert set(METHOD_STYLE) == set(problems.FIXED)  # charts tell the methods apart


@pytest.mark.slow
def test_references():
    """The path of the free vibration by halved RK4 steps is that of scipy's DOP853; too few steps are an error."""
    scene = problems.problems()["vibration"]
    path, substeps, change = problems.reference(scene)
    assert change <= problems.CONVERGED and substeps >= 2048
    assert problems.distance(scene.fish, problems.independent(scene), path) < 1e-9
    for steps, text in (((8, 16), r"turn: RK4 with 16 .* differs by .* allow more steps"), ((1, 2), "differs by inf")):
        with pytest.raises(problems.NotConvergedError, match=text):
            problems.reference(TURN, *steps)


@pytest.mark.slow
def test_turn(truth):
    """On the turn the default, and Tu's method with half its own step, are accurate to 1 % of a body length.

    The turn magnifies a disturbance less than a thousandfold, so an error on it is the method's. Tu's method is of
    first order. A step of half a control interval tears the fish unless it is refined.
    """
    fish, default = TURN.fish, TURN.fish.integrator
    assert error(truth, default, problems.steps_of(fish), refine=fish.refine) <= work_precision.ACCURATE
    assert error(truth, default, 8) <= work_precision.ACCURATE
    assert error(truth, default, 2) == np.inf > error(truth, default, 2, refine=fish.refine)
    assert 1.0 < problems.magnified(TURN, truth, 128) < 1000.0
    own = round(fish.control_interval / Tank(fish, 1, "semi_implicit").dt)
    assert error(truth, "semi_implicit", own) <= 2.0 * work_precision.ACCURATE
    assert error(truth, "semi_implicit", 2 * own) <= work_precision.ACCURATE
    assert error(truth, "semi_implicit", 20) == np.inf


@pytest.mark.slow
def test_single_precision():
    """The default in float32 stays within 5e-6 body lengths of float64 over the abrupt manoeuvre."""
    steps = problems.steps_of(FISH)
    double, single = (problems.run(TURN, FISH.integrator, steps, refine=FISH.refine, dtype=dtype)[0]
                      for dtype in ("float64", "float32"))  # fmt: skip
    assert 0.0 < problems.distance(FISH, single, double) <= 5e-6


@pytest.mark.slow
@pytest.mark.parametrize(("frequency", "by_default", "by_midpoint"), [(4.0, 0.0053, 0.000025), (5.0, 0.0115, 0.000134)])
def test_fast_strokes(frequency, by_default, by_midpoint):
    """Errors of the best gait and of the same at 5 Hz, as the page gives them; midpoint with 96 steps is better."""
    goal = replace(best_gait(), frequency=frequency).contraction(FISH, FISH.control_interval * np.arange(1, 101))
    scene = problems.Problem("fast", "a fast stroke", FISH, FISH.water, goal)
    reference = problems.run(scene, "rk4", 64)[0]
    for name, steps, off in ((FISH.integrator, problems.steps_of(FISH), by_default), ("midpoint", 96, by_midpoint)):
        path, _ = problems.run(scene, name, steps)
        assert problems.distance(FISH, path, reference) == pytest.approx(off, rel=0.1)


def test_rows(truth):
    """A row has an error and work, or a reason."""
    row = work_precision.measure(TURN, "rk4", 32, truth, seconds=False)
    assert (row["scene"], row["integrator"], row["substeps"]) == ("turn", "rk4", 32)
    assert row["error"] < 1e-3 and row["forces_per_interval"] == 128 and row["failure"] == ""
    failed = work_precision.measure(TURN, "rk4", 2, truth, seconds=False)
    assert np.isinf(failed["error"]) and np.isnan(failed["forces_per_interval"]) and failed["failure"]


def test_held_out(monkeypatch):
    """The turn among the held-out scenes has the bits it has alone; scenes that magnify more than allowed are counted.

    The errors of a row are those of the others.
    """
    whole = held_out.setting("mass_spring", "reactive")
    assert whole.goals.shape == (65, 100, 12) and whole.goals.min() >= 0.0 and whole.goals.max() <= 1.0
    assert len({goals.tobytes() for goals in whole.goals}) == 65
    scenes = whole._replace(goals=whole.goals[-9:, :30])
    moved = held_out.move(scenes, FISH.integrator, 6, batch=20)
    alone, _ = problems.run(replace(TURN, contraction=scenes.goals[-1]), FISH.integrator, 6)
    np.testing.assert_array_equal(moved.path[:, -1], alone)
    monkeypatch.setattr(held_out, "FEWEST", 32)
    monkeypatch.setattr(held_out, "FAMILIES", ((held_out.sprints, 8),))
    magnified = np.sort(held_out.magnification(scenes, 32)[:-1])
    monkeypatch.setattr(held_out, "MAGNIFIED", magnified[4])
    row = held_out.measure("mass_spring", "reactive", scenes, held_out.reference(scenes), (FISH.integrator, 6, np.inf))
    assert (row["scenes"], row["unpredictable"], row["failed"], row["worst_of"]) == (8, 3, 0, "sprints")
    assert 0.0 < row["geometric_mean"] < row["ninety_percent"] < row["worst"] < 0.01
