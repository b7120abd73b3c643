"""The bound by optimal control: what it measures is what the tasks measure, and what is found is never worse."""

import numpy as np
import pytest

from benchmarks.learning import bound
from benchmarks.learning.bound import GOALS, Search, Swum, find_starts, measure_latency, measure_rewarded, recorded
from fish_env.control import scripted
from fish_env.envs import FishVectorEnv

TURNS = ("turn", "left_after_right")
FISH = 16


@pytest.fixture(scope="module", params=GOALS)
def scene(request):
    """A task, its batch, and the start of an episode."""
    few, env = (FishVectorEnv(count, task=request.param, threads=1) for count in (2, FISH))
    return request.param, env, find_starts(few, scripted(few))[1]


def random_search(env, start, measure=measure_latency):
    """A search over all that is measured, and points for it."""
    steps = len(start.commands)
    search = Search(env, start, recorded(start.commands, env.control_interval), measure, steps, steps)
    points = np.random.default_rng(0).normal(0.0, 0.4, (FISH, -(-steps // 2) * 3))
    return search, points * (np.arange(FISH) > 0)[:, None]


def test_measures_are_those_of_the_tasks(scene):
    """Latency, rounded up to a control interval, and distances equal the metrics of the same fish."""
    task, env, start = scene
    search, points = random_search(env, start)
    env.set_state(start.state)
    before = env.task.metrics(env.tank, 0, 1.0)
    swum = search.swim(points)
    after = [env.task.metrics(env.tank, i, 1.0) for i in range(FISH)]
    np.testing.assert_array_equal(swum.commands, start.commands)
    if task in TURNS:
        value, _ = measure_latency(swum, start.wanted)
        assert np.isfinite(value).sum() > FISH // 2
        rounded_up = np.ceil(value / swum.interval - 1e-9) * swum.interval
        np.testing.assert_allclose(rounded_up, [metrics["latency"] for metrics in after], atol=1e-9)
    elif task == "fast_start":
        np.testing.assert_allclose(swum.way[-1], [metrics["escape_distance"] for metrics in after], atol=1e-12)
    else:
        np.testing.assert_allclose(swum.way[-1], [m["speed"] - before["speed"] for m in after], atol=1e-12)


def ramp(*degrees):
    """A fish whose heading is at these degrees after 0, 1, 2, ... environment steps of 20 ms, and then stays."""
    turned = np.radians([*degrees, *([degrees[-1]] * 13)])[:, None]
    return Swum(turned, np.zeros_like(turned), 0.02, np.zeros((len(turned) - 1, 12)), -turned[1:])


@pytest.mark.parametrize(
    ("degrees", "wanted", "latency"),
    [
        ((0, 40, 80, 100), 100, 0.05),
        ((0, -40, -80, -100), -100, 0.05),
        ((0, -200, -260), 100, 0.11 / 3),  # the other way round
        ((0, 45, 80, 100), 50, 0.02),
        ((0, 40, 80, 85), 100, np.nan),
    ],
)
def test_latency(degrees, wanted, latency):
    """It is interpolated, to either side; a turn that is not made costs more; a short motion has no return."""
    swum, wanted = ramp(*degrees), np.radians(wanted)
    value, cost = measure_latency(swum, wanted)
    np.testing.assert_allclose(value, latency, atol=1e-12)
    assert cost == value if np.isfinite(latency) else cost > 0.02 * (len(swum.turned) - 1)
    assert np.isnan(measure_rewarded(swum, wanted)[1])
    long = swum._replace(rewards=np.arange(100.0)[:, None])
    assert measure_rewarded(long, wanted)[1] == -sum(range(60))


def test_what_is_found_is_better_and_repeated(scene):
    """Few generations find better commands than none; the same seed finds the same, bit for bit, and another others."""
    pytest.importorskip("cma")
    task, env, start = scene
    measure = bound.measure_way if task == "swim" else next(iter(GOALS[task].values()))
    search, _ = random_search(env, start, measure)
    search = search._replace(control=lambda obs, time: np.zeros(12))
    found, again, other = (search.best(8, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(found, again)
    assert not np.array_equal(found, other)
    _, known = measure(search.swim(0.0 * found[None]), start.wanted)
    swum = search.swim(found[None])
    _, better = measure(swum, start.wanted)
    assert (better < known).all() and np.abs(swum.commands).max() <= 1.0
    np.testing.assert_array_equal(better, better[0])


@pytest.mark.parametrize("task", TURNS)
def test_the_largest_return(task):
    """The search changes the first commands only, and earns more than the controller that goes on after them."""
    pytest.importorskip("cma")
    few, env = (FishVectorEnv(count, task=task, threads=1) for count in (1, FISH))
    (start,) = find_starts(few, scripted(few))
    control = scripted(env)
    swum = bound.search(env, start, control, measure_rewarded, 4, 1)
    alone = bound.drive(env, start.state, control, len(swum.commands))
    own, found = (measure_rewarded(each, start.wanted)[1][0] for each in (alone, swum))
    assert np.isfinite(own) and found < own
    assert len(swum.commands) == 60 and np.any(swum.commands[:20] != alone.commands[:20], axis=1).any()
    assert own == -alone.rewards.sum(axis=0)[0]


@pytest.mark.parametrize("task", ["turn", "fast_start", pytest.param("swim", marks=pytest.mark.slow)])
def test_rows(task, monkeypatch):
    """A row for each quantity, the bound no worse than motor controllers and policy; the same again."""
    pytest.importorskip("cma")
    monkeypatch.setattr(bound, "POPULATION", FISH)
    monkeypatch.setattr(bound, "CRUISE", 1.6)
    rows, again = (bound.rows_of(task, 1, 1, 2, threads=1) for _ in range(2))
    assert rows == again and [row["quantity"] for row in rows] == 2 * list(GOALS[task])
    for row in rows:
        sign = 1 if task == "turn" else -1
        known = [row[who] for who in ("motor_controllers", "policy") if row[who] != ""]
        rewarded = row["quantity"] == bound.REWARDED  # where a latency may be longer
        assert known and (rewarded or all(sign * row["bound"] <= sign * value for value in known))
        assert row["seeds_apart"] == "" or row["seeds_apart"] >= 0.0
