"""The layout of the observation: every number has one name, the environments fill it in, and others read it."""

import pickle
import re

import gymnasium as gym
import numpy as np
import pytest
from pages import ROOT

import fish_env
from fish_env.envs import Layout
from fish_env.tasks import Direction

STUB = "FishEnv/Stub-v0"


@pytest.mark.parametrize(
    ("id", "keywords"),
    [*((f"FishEnv/{name}-v0", {}) for name in ("Turn", "LeftAfterRight", "Target", "Avoid", "FastStart")),
     (STUB, {"speed": 1.0}), (STUB, {"body": "planar"})],
)  # fmt: skip
def test_parts_follow_one_another(id, keywords):
    """The parts fill the observation without gaps, in their shapes, and the bounds are those of the space."""
    env = gym.make_vec(id, 2, **keywords).unwrapped
    layout, obs = env.layout, env.reset(seed=0)[0]
    end = 0
    for part in layout:
        assert part.start == end and part.size == np.prod(part.shape) == len(part.labels)
        assert all(label.startswith(part.name) for label in part.labels)
        assert layout.read(obs, part.name).shape == (2, *part.shape)
        assert np.shares_memory(layout.read(obs, part.name), obs)
        end = part.slice.stop
    assert end == layout.size == env.single_observation_space.shape[0]
    np.testing.assert_array_equal(layout.bounds(), env.single_observation_space.high)
    np.testing.assert_array_equal(-layout.bounds(), env.single_observation_space.low)


def test_parts_are_what_they_say():
    """Positions, velocities, rest lengths and directions are those of the tank in the body's frame."""
    env = gym.make("FishEnv/Swim-v0").unwrapped
    obs, _ = env.reset(seed=5, options={"yaw": 0.7, "heading": 1.2})
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 12)):
        obs = env.step(action)[0]
    tank, fish = env.tank, env.tank.fish
    rows = env.layout.table()
    assert len(rows) == obs.size == env.layout.size == len({name for name, _, _ in rows})
    seen = {part.name: env.layout.read(obs, part.name) for part in env.layout}
    mass = fish.body.mass / fish.body.mass.sum()
    x = tank.position[0] - mass @ tank.position[0]
    forward = fish.line @ x
    forward /= np.linalg.norm(forward)
    np.testing.assert_allclose(seen["position"][:, 0], x @ forward / fish.length, atol=1e-6)
    np.testing.assert_allclose(seen["velocity"][:, 0], tank.velocity[0] @ forward / fish.length, atol=1e-5)
    np.testing.assert_allclose(seen["rest length"], 2 * tank.contraction[0] - 1, atol=1e-6)
    assert seen["vertical"][0] == pytest.approx(forward[2], abs=1e-6)
    assert seen["vertical"] @ seen["vertical"] == pytest.approx(1, abs=1e-6)
    assert seen["commanded heading"][0] == pytest.approx(forward @ [np.cos(1.2), np.sin(1.2), 0], abs=1e-6)
    assert seen["commanded heading"] @ seen["commanded heading"] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("body", fish_env.BODIES)
def test_scaled_observation_of_a_fish_at_rest_is_zero(body):
    """A relaxed fish at rest, level, is seen as zeros but for what the task shows."""
    env = gym.make_vec(STUB, 1, body=body).unwrapped
    env.reset(seed=0)
    env.tank.position[:], env.tank.velocity[:] = env.tank.fish.body.position, 0.0
    env._measure()
    offset, scale = env.layout.scaling()
    scaled = ((env.observe()[0] - offset) / scale)[: env.layout["commanded heading"].start]
    relaxed = env.layout["rest length"]
    np.testing.assert_allclose(scaled[relaxed.slice], -1.0, atol=1e-6)
    scaled[relaxed.slice] = 0.0
    np.testing.assert_allclose(scaled, 0.0, atol=1e-4)


def test_layout_is_asked_by_id():
    """`observation_layout` is the layout of the environment that Gymnasium makes; the stub's is Swim's."""
    asked = fish_env.observation_layout("FishEnv/Avoid-v0")
    env = gym.make("FishEnv/Avoid-v0").unwrapped
    assert asked.table() == env.layout.table() and asked.version == env.layout.version == 1
    swim, stub = (fish_env.observation_layout(f"FishEnv/{name}-v0") for name in ("Swim", "Stub"))
    assert swim.table() == stub.table() and "commanded heading" in swim
    assert "commanded velocity" in fish_env.observation_layout("FishEnv/Swim-v0", speed=1.0)
    assert pickle.loads(pickle.dumps(env.layout)).table() == env.layout.table()
    with pytest.raises(ValueError, match="CartPole-v1 has no observation layout"):
        fish_env.observation_layout("CartPole-v1")
    with pytest.raises(KeyError, match="no part 'speed'; its parts are position, velocity, rest length, vertical"):
        swim["speed"]


def test_parts_need_different_names():
    """A task whose direction has the name of another part is an error."""
    with pytest.raises(ValueError, match="give every direction a name of its own"):
        Layout(fish_env.make_fish(), (Direction("velocity", "body lengths/s", 1.0, 1.0),))


def test_no_observation_is_read_by_number():
    """Nothing in fish_env or agents takes numbers out of an observation by their place: `Layout` has the names."""
    by_number = re.compile(r"\bobs(ervations?)?\[(?!0\])[^\]]*\b\d")  # `obs[0]` is the first fish
    assert all(map(by_number.search, ("obs[:, -9:-6]", "obs[:, 3 * n : 6 * n]", "obs[3]", "obs[:, None, -9:]")))
    assert not by_number.search("obs[0] + obs[:, a]")
    paths = [*ROOT.glob("fish_env/**/*.py"), *ROOT.glob("agents/*.py")]
    assert len(paths) > 50
    assert not [path.name for path in paths if by_number.search(path.read_text())]
