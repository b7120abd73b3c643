"""Other simulators, where they are installed, move the same springs to the same places: their speed may be compared."""

import math
from importlib import import_module

import pytest

from benchmarks.common import timing
from benchmarks.speed import scene

STEPS = 20  # at least: some take many at a time


@pytest.mark.parametrize("num_fish", [1, 3])
@pytest.mark.parametrize("package", ["mujoco", "newton"])
def test_peer_agrees(package, num_fish):
    """Every way in which a peer computes the springs ends where ours does."""
    pytest.importorskip(package, reason=f"{package} is not installed: pip install -e '.[peers]'")
    for peer in import_module(f"benchmarks.speed.{package}_springs").peers(num_fish):
        steps = peer.chunk * math.ceil(STEPS / peer.chunk)
        assert scene.disagreement(peer, steps) <= scene.TOLERANCE[peer.precision]


class Shorter(scene.Ours):
    """Springs that are a thousandth shorter."""

    def start(self):
        super().start()
        self.tank.rest_length[:] *= 0.999


def test_other_springs_are_found_out():
    """What computes other springs is not timed."""
    same = scene.make_scene(3)
    assert scene.disagreement(scene.Ours(same), STEPS) == 0.0
    with pytest.raises(ValueError, match="BL from fish_env after 20 steps"):
        scene.disagreement(Shorter(same), STEPS)


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
