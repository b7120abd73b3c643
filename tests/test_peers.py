"""MuJoCo, which is timed beside this package, moves the same springs to the same places; costs are taken in turn."""

import pytest

from benchmarks.common import timing
from benchmarks.speed import peers


@pytest.mark.parametrize("num_fish", [1, 3])
def test_mujoco_agrees(num_fish):
    """MuJoCo, where it is installed, moves the masses as this package does; springs of other lengths are found out."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install -e '.[peers]'")
    scene = peers.make_scene(num_fish)
    assert peers.disagreement(peers.Mujoco(scene), 20) <= peers.TOLERANCE
    assert peers.disagreement(peers.Mujoco(scene._replace(rest_length=0.999 * scene.rest_length)), 20) > 1e-6


def test_costs_are_measured_in_turn(monkeypatch):
    """Runs take turns; preparation is not timed; the first round does not count; ratios are to the first run."""
    clock, order = [0.0], []

    def spend(name, seconds):
        clock[0] += seconds * (10.0 if len(order) < 4 else 1.0)
        order.append(name)

    monkeypatch.setattr(timing.time, "process_time", lambda: clock[0])
    a = (lambda: spend("prepare", 5.0), lambda: spend("a", 1.0), 2)
    b = (lambda: spend("prepare", 5.0), lambda: spend("b", 3.0), 3)
    first, second = timing.interleaved([a, b], 4)
    assert order == ["prepare", "a", "prepare", "b"] * 5
    assert first.time == pytest.approx(5e5) and second.time == pytest.approx(1e6)
    assert first.ratio == pytest.approx(1.0) and second.ratio == pytest.approx(2.0)
