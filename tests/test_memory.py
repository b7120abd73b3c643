"""How much memory a batch takes is known before it is made, and what the machine or its container has is asked."""

import tracemalloc

import numpy as np
import pytest

from fish_env import BODIES, TASKS, Tank, checks, make_fish
from fish_env.envs import FishVectorEnv
from fish_env.envs.layout import bytes_of_episode
from fish_env.physics.tank_options import bytes_of

FEW, MORE = 32, 160


def measured(make) -> float:
    """Bytes a fish at the most while a tank, or a batch, of a number of fish is made and its state copied."""
    make(8)  # kernels
    peaks = []
    for count in (FEW, MORE):
        tracemalloc.start()
        kept = make(count)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        peaks.append(peak)
        del kept
    return (peaks[1] - peaks[0]) / (MORE - FEW)


@pytest.mark.parametrize("body", BODIES)
def test_a_tank_takes_what_is_estimated(body):
    """The estimate for a fish of a tank holds what is measured, and is not far above it."""
    fish = make_fish(body)

    def make(count):
        tank = Tank(fish, count, water=fish.water, threads=1, lanes="xyz")
        return tank, tank.get_state()

    assert 0.7 * bytes_of(fish.body) < measured(make) <= bytes_of(fish.body)


@pytest.mark.parametrize(
    ("body", "task"), [(body, "swim") for body in BODIES] + [("mass_spring", task) for task in TASKS]
)
def test_a_batch_takes_what_is_estimated(body, task):
    """The same of an environment of every body, and of every task."""
    fish = make_fish(body)

    def make(count):
        env = FishVectorEnv(count, body=fish, task=task, threads=1, lanes="xyz")
        env.reset(seed=0)
        obs = env.step(np.zeros(env.action_space.shape, np.float32))[0]
        return env, obs, env.tank.get_state()

    estimate = bytes_of(fish.body) + bytes_of_episode(fish)
    assert 0.6 * estimate < measured(make) <= estimate


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("memory.max", "2000000000\n", 2_000_000_000),
        ("memory/memory.limit_in_bytes", "400000000", 400_000_000),
        ("memory.max", "max\n", 16 * 2**30),
        ("memory.max", "999999999999999\n", 16 * 2**30),
        ("other", "1", 16 * 2**30),
    ],
)
def test_limits_of_containers(name, text, wanted, tmp_path, monkeypatch):
    """The limit of a container counts, if it is below the memory of the machine."""
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(text)
    monkeypatch.setattr(checks.os, "sysconf", {"SC_PHYS_PAGES": 2**22, "SC_PAGE_SIZE": 4096}.__getitem__)
    assert checks.available_memory(tmp_path) == wanted


def test_what_does_not_fit_is_named_as_it_was_given(monkeypatch):
    """A batch is refused by the name its user gave, for the container's memory, and the advice fits."""
    monkeypatch.setattr(checks, "available_memory", lambda: 10 * 2**20)
    for make, name in ((lambda count: Tank(make_fish(), count), "num_fish"), (FishVectorEnv, "num_envs")):
        with pytest.raises(ValueError, match=rf"{name} is 10000, which .* has 0.00977 GiB") as error:
            make(10_000)
        make(int(str(error.value).rsplit(" ", 1)[1])).close()
