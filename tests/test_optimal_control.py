"""Optimal control of the swimming fish: what is imagined leaves no trace, and plans are what they are said to be."""

import numpy as np
import pytest

from benchmarks.learning.optimal_control import DIFFERENCE, Episode, Search, planned, swum


@pytest.fixture(scope="module")
def episode():
    """An episode of a single fish."""
    return Episode()


def everything(episode: Episode) -> list[np.ndarray]:
    """The state of the fish, what it observes, and what it remembers."""
    return [*episode.tank.get_state().values(), episode.obs, episode.last, np.array(episode.periods)]


def test_what_is_imagined_leaves_no_trace(episode):
    """Asking the policy, and swimming in imagination, leave the fish and what it observes, bit for bit."""
    episode.begin()
    for command in episode.by_policy(5):
        episode.execute(command)
    before = [array.copy() for array in everything(episode)]
    asked = episode.by_policy(20)
    with episode.imagined():
        for command in asked:
            episode.execute(command)
        assert episode.distance() > 0.1
    for had, has in zip(before, everything(episode), strict=True):
        np.testing.assert_array_equal(had, has)
    np.testing.assert_array_equal(asked, episode.by_policy(20))


def test_gradient_of_the_distance(episode):
    """Gradients by a batch of fish are those by single fish, and searches never return less than they began with."""
    episode.begin()
    for command in episode.by_policy(10):
        episode.execute(command)
    search = Search(6, episode, threads=1)
    commands = np.random.default_rng(0).uniform(size=(6, 6))
    state = {name: np.repeat(v, 37, axis=0) for name, v in episode.tank.get_state().items()}

    def after(commands: np.ndarray) -> float:
        with episode.imagined():
            for command in commands:
                episode.execute(command)
            return episode.distance()

    shortfall, gradient = search.shortfall(commands.ravel(), state)
    assert -shortfall == pytest.approx(after(commands), abs=1e-6)  # actions of environments are float32
    changed = commands.copy()
    changed[2, 3] += DIFFERENCE if commands[2, 3] <= 0.5 else -DIFFERENCE
    expected = (after(changed) - after(commands)) / (changed - commands)[2, 3]
    assert -gradient.reshape(6, 6)[2, 3] == pytest.approx(expected, abs=2e-4)
    better = search.improved(commands, 5)
    assert after(better) > after(commands) and better.min() >= 0.0 and better.max() <= 1.0


def test_plans_are_carried_out(episode, monkeypatch):
    """Planned commands swim no slower than the policy that they begin with, and no faster than what was measured."""
    monkeypatch.setattr("benchmarks.learning.optimal_control.SECONDS", 1.0)
    monkeypatch.setattr("benchmarks.learning.optimal_control.STEADY", 0.5)
    alone, steady = swum(episode, lambda: episode.by_policy(1), "policy")
    assert 0 < alone < steady < 3.0
    episode.begin()
    search = Search(20, episode, threads=1)
    plan = planned(episode, search, episode.by_policy(20), episode.by_policy, 2)
    assert alone < swum(episode, plan, "planned")[0] < 3.0
