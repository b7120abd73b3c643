"""The benchmarks of methods that were tried and of refined intervals: what they publish is what is found again."""

import csv

import numpy as np
import pytest
from moving import tiered

from benchmarks.accuracy import refinement
from benchmarks.accuracy.rejected_methods import REJECTED_METHODS, survey
from benchmarks.common import problems
from benchmarks.common.actions import actions
from benchmarks.common.tables import RESULTS
from fish_env import INTEGRATORS, Tank, make_fish

TURN, FISH = problems.problems()["turn"], make_fish()
QUICK = ("semi_implicit_leapfrog",)
AT = 16  # steps a control interval


@pytest.fixture(scope="module")
def truth():
    """The abrupt manoeuvre, to 1e-6 of a body length."""
    return problems.run(TURN, "rk4", 128)[0]


def published(name):
    """A row of what was published of a method."""
    with (RESULTS / "ideas.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return next(row for row in rows if (row["scene"], row["method"], row["substeps"]) == ("turn", name, str(AT)))


@pytest.mark.parametrize("name", tiered(REJECTED_METHODS, QUICK))
def test_rejected_methods(name, truth):
    """Every method has the error and the cost that were published; it leaves the package's list alone."""
    found, before = survey.measure(TURN, name, AT, truth), dict(INTEGRATORS)
    wanted = published(name)
    assert before == INTEGRATORS and name not in INTEGRATORS
    assert found["error"] == pytest.approx(float(wanted["error"]), rel=0.02)
    for cost in ("forces_per_interval", "factorisations_per_interval", "solves_per_interval"):
        assert found[cost] == pytest.approx(float(wanted[cost]), rel=0.02)


def test_a_rejected_method_moves_one_lane():
    """What is kept from step to step belongs to one fish: lanes are refused."""
    with pytest.raises(ValueError, match="lanes is 8; a rejected method takes 1"):
        REJECTED_METHODS["velocity_verlet"].make_work(FISH.body, Tank(FISH, 8, lanes=8).kind)


def test_meter():
    """Steps are counted with those that were thrown away: two force evaluations each where the longest need no more."""
    steps = 40
    tank = Tank(FISH, 16, water=FISH.water, dt=FISH.control_interval / steps, refine=0.003)
    meter = refinement.Meter(tank)
    for action in actions(FISH, "random")[:20]:
        tank.swim(action, FISH.control_interval)
        meter.read(steps)
    row = meter.row()
    assert 0.1 < row["intervals_refined"] < 1.0 and row["steps_taken"] > 1.2 * steps
    assert row["forces_per_interval"] == pytest.approx(2.0 * row["steps_taken"], rel=1e-4)


def test_a_row_of_refinement(truth):
    """In float32 the default is as it is in float64, to its bar; steps of a whole interval tear it unrefined."""
    steps = problems.steps_of(FISH)
    double, _ = problems.run(TURN, FISH.integrator, steps, refine=FISH.refine)
    row = refinement.measure(TURN, steps, FISH.refine, double, dtype="float32")
    assert 0.0 < row["error"] <= refinement.SINGLE and row["against"] == "float64"
    assert refinement.measure(TURN, 1, np.inf, truth)["error"] == np.inf
    assert refinement.measure(TURN, 1, FISH.refine, truth)["error"] < np.inf


def test_largest_stable():
    """Unrefined, the turn tears the fish at a step of 20 ms; refined it does not."""
    fixed, refined = (refinement.stable(FISH, "turn", refine) for refine in (np.inf, FISH.refine))
    assert fixed["fewest_steps"] > 1 and fixed["beyond"].startswith("torn")
    assert refined["largest_stable_ms"] == pytest.approx(20.0) and not refined["beyond"]


def test_front():
    """Cheapest first, each better than all before it; settings without their margin are left out."""
    rows = [{"steps": n, "forces_per_interval": f, "error": e}
            for n, f, e in ((2, 4, 0.1), (4, 8, 0.5), (6, 12, 0.2), (8, 16, 0.3), (9, 18, 0.1))]  # fmt: skip
    assert [row["steps"] for row in refinement.front(rows, 4)] == [4, 6, 9]
    assert [row["steps"] for row in refinement.front(rows, 0)] == [2]
