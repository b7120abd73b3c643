"""The benchmarks of speed: what they time is what they say, and comparisons begin with a ratio of one."""

import subprocess

import numpy as np
import pytest

from benchmarks.speed import scaling, throughput
from fish_env import make_fish

FISH = make_fish()


def test_swimming_fish_are_alike_until_they_are_varied():
    """Fish that have swum are where one has swum, wherever they are; varied ones differ by a fifth at most."""
    one, many = (throughput.swimming(FISH, count) for count in (1, 9))
    assert one.time[0] == pytest.approx(1.0) and one.counters["force_evaluations"][0] == 0
    np.testing.assert_array_equal(many.position, np.repeat(one.position, 9, axis=0))
    assert one.position[0, FISH.nose, 0] > FISH.body.position[FISH.nose, 0] + FISH.length
    varied = throughput.vary(many).variation
    assert len(np.unique(varied[:, 0])) == 9 and np.abs(varied[:, :3] - 1.0).max() <= throughput.SPREAD
    work = throughput.Swim(many)
    work.run(3)
    assert len(np.unique(many.position[:, 0, 0])) == 9
    work.start()
    np.testing.assert_array_equal(many.position, np.repeat(one.position, 9, axis=0))


def test_ratios():
    """The first thing's ratio is one; four fish take more than two intervals of one fish and less than four."""
    found = throughput.costs(
        lambda: [throughput.Swim(throughput.swimming(FISH, count, lanes="xyz")) for count in (1, 4)], 3, 1
    )
    np.testing.assert_array_equal(found[0].ratio, 1.0)
    assert 0.3 < found[1].ratio[1] < 1.5 and found[1].time[0] <= found[1].time[1] <= found[1].time[2]


def test_bodies_of_the_scaling():
    """The bars swing, and grow to ten thousand nodes."""
    ((name, work),) = scaling.bodies(levels=(), through=(2,))
    assert name == "bar"
    assert len(work.tank.fish.body.mass) == 189
    assert work.tank.velocity[0, :, 2].max() == scaling.SPEED
    work.run(3)
    moved = np.abs(work.tank.position[0] - work.tank.fish.body.position).max()
    assert 0.9 < moved / (3 * scaling.STEP * scaling.SPEED) <= 1.0
    n = scaling.THROUGH[-1]
    assert (10 * n + 1) * 3 * (n + 1) > 10_000


def test_in_process(tmp_path):
    """A fresh process says how much memory an environment takes, with its kernels in a folder; it hides no error."""
    code = throughput.MEMORY.replace("Swim", "Stub") + "from fish_env.kernels import cache\n"
    code += f"assert cache._FOLDER.startswith({str(tmp_path)!r}), cache._FOLDER\n"
    assert 30.0 < throughput.in_process(code, str(tmp_path)) < 2000.0  # MB
    with pytest.raises(subprocess.CalledProcessError):
        throughput.in_process("print(1 / 0)")
