"""Fish of other lengths: the same tissue, slower muscles, and every environment swims them."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from fish_env import Tank, make_fish
from fish_env.bodies.sizes import ALLOWED, MEANT, SLOWNESS
from fish_env.soft import statics

BODIES = ("mass_spring", "planar", "two_layer", "tetrahedral")
each_body = pytest.mark.parametrize("body", BODIES)


@each_body
@pytest.mark.parametrize("length", MEANT)
def test_the_tissue_is_the_same(body, length):
    """Moduli, pressures, relaxation times and densities are; so vibrations take as many times as long as it is long."""
    fish, other = make_fish(body), make_fish(body, length=length)
    ratio = length / fish.length
    for power, part in ((3, "mass"), (1, "position")):
        np.testing.assert_allclose(getattr(other.body, part), ratio**power * getattr(fish.body, part), rtol=1e-9)
    for power, part in ((1, "stiffness"), (1, "damping"), (1, "rest_length")):
        found, own = (getattr(body.springs, part) for body in (other.body, fish.body))
        np.testing.assert_allclose(found, ratio**power * own, rtol=1e-12)
    np.testing.assert_array_equal(other.contracted, fish.contracted)
    if body == "tetrahedral":
        for part in ("shear", "dilation", "relaxation_time"):
            found, own = (getattr(body.tets, part) for body in (other.body, fish.body))
            np.testing.assert_allclose(found, own, rtol=1e-9)  # softened by quotients of integrals
    if body == "two_layer":
        np.testing.assert_array_equal(other.body.compartments.ambient, fish.body.compartments.ambient)
        np.testing.assert_allclose(other.body.barriers.energy, ratio**3 * fish.body.barriers.energy)
    found, own = (statics.modes(each.body, count=8)[0][-1] for each in (other, fish))
    assert found == pytest.approx(own / ratio, rel=1e-6) and own > 1.0


@each_body
@pytest.mark.parametrize("length", ALLOWED)
@pytest.mark.filterwarnings("ignore:a fish of")
def test_the_ends_of_the_range_swim(body, length):
    """A second of square waves from side to side, a few contractions long each, leaves the fish sound and moving."""
    fish = make_fish(body, length=length)
    assert fish.contraction_time == pytest.approx(make_fish().contraction_time * (length / 0.2) ** SLOWNESS)
    tank = Tank(fish, 1, water=fish.water)
    steps, half = round(fish.control_interval / tank.dt), max(1, round(2 * fish.contraction_time / 0.02))
    assert steps * tank.dt == pytest.approx(fish.control_interval, rel=1e-12)
    for k in range(50):
        tank.drive(np.where(fish.sides > 0, k // half % 2, 1 - k // half % 2).astype(float)[None], steps)
    assert tank.alive[0] and np.abs(tank.position[0] - fish.body.position).max() > 0.01 * length


@pytest.mark.filterwarnings("ignore:a fish of")
def test_environments_swim_fish_of_any_length():
    """A task takes steps with the shortest and the longest fish; its observations stay in their box."""
    for length in ALLOWED:
        env = gym.make("FishEnv/Swim-v0", body=make_fish(length=length))
        obs, _ = env.reset(seed=0)
        for action in np.random.default_rng(0).uniform(-1, 1, (10, *env.action_space.shape)).astype(np.float32):
            obs, _, terminated, _, _ = env.step(action)
        assert not terminated and env.observation_space.contains(obs)


def test_lengths_out_of_range():
    """They are warned of, or refused, saying what is allowed; times that are given are kept at every length."""
    with pytest.warns(
        UserWarning, match=r"a fish of 1 m is outside the range in which the model is meant, 0\.05 to 0\.6"
    ):
        make_fish(length=1.0)
    for length in (0.019, 1.1, 1e300):
        with pytest.raises(ValueError, match=r"length is .* m; give 0\.02 to 1 m, best 0\.05 to 0\.6 m"):
            make_fish("planar", length=length)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fish = make_fish(length=0.05, contraction_time=0.05, time_step=0.001, activation_time=(0.02, 0.04))
    assert (fish.contraction_time, fish.time_step, fish.activation_time) == (0.05, 0.001, (0.02, 0.04))
    slower = make_fish(length=0.4, activation_time=(0.02, 0.04)).contraction_time / make_fish().contraction_time
    assert slower == pytest.approx(2.0**SLOWNESS)
