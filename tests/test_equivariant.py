"""The policy for Stable-Baselines3 that is equivariant under the left-right reflection."""

import importlib
import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")
stable_baselines3 = pytest.importorskip("stable_baselines3")

import fish_env
from fish_env.control.equivariant import EquivariantPolicy, equivariant_options, export_policy, reflection_of
from fish_env.envs import FishVectorEnv


def test_mirror_is_the_fish_seen_in_a_mirror():
    """Observations of a mirrored fish are the mirrored observations, and mirroring twice changes nothing."""
    env = FishVectorEnv(2, task="avoid")
    fish = env.tank.fish
    place, sign, swap = reflection_of(env)
    np.testing.assert_array_equal(place[place], np.arange(len(place)))
    np.testing.assert_array_equal(swap[swap], np.arange(len(swap)))
    for i, side in enumerate((1, -1)):
        options = {"yaw": 0.0, "turn": side * 0.9, "wait": 0.1, "gap": 0.5, "aside": side * 0.3, "drift": side * 0.5}
        env.reset(seed=0, options={**options, "reset_mask": np.arange(2) == i})
    env.tank.position[1] = (env.tank.position[0] * [1, -1, 1])[fish.mirror]
    env.tank.velocity[1] = (env.tank.velocity[0] * [1, -1, 1])[fish.mirror]
    env._measure()
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 12)):
        obs, *_ = env.step(np.stack([action, action[swap]]))
        np.testing.assert_allclose(obs[1], obs[0][place] * sign, atol=1e-5)
    assert np.abs(obs[0] - obs[1]).max() > 0.1


@pytest.mark.parametrize(("id", "body", "groups"), [("Target", "mass_spring", "muscles"), ("Stub", "planar", "pairs")])
def test_policy_is_equivariant(id, body, groups):
    """Its action for a reflected observation is the reflected action, the value is the same; exported it acts alike."""
    id = f"FishEnv/{id}-v0"
    env = fish_env.make_sb3_vec_env(id, num_envs=4, seed=0, body=body, muscle_groups=groups)
    options = equivariant_options(env.unwrapped.fish) | {"activation_fn": torch.nn.Tanh}
    model = stable_baselines3.PPO(
        EquivariantPolicy, env, n_steps=4, batch_size=8, policy_kwargs=options, device="cpu", seed=0
    )
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    place, sign, swap = reflection_of(env.unwrapped.fish)
    obs = env.reset()
    other = (obs[:, place] * sign).astype(np.float32)
    (one, _), (reflected, _) = (model.predict(seen, deterministic=True) for seen in (obs, other))
    np.testing.assert_allclose(reflected, one[:, swap], atol=1e-5)
    assert np.abs(one - one[:, swap]).max() > 0.01
    values = [model.policy.predict_values(torch.as_tensor(seen)).detach().numpy() for seen in (obs, other)]
    np.testing.assert_allclose(*values, atol=1e-5)
    policy = export_policy(model, {"env_id": id})
    np.testing.assert_allclose(policy(obs), np.clip(one, -1, 1), atol=2e-5)


@pytest.mark.parametrize("module", ["fish_env.control.equivariant", "fish_env.envs.sb3"])
def test_it_says_what_to_install(module, monkeypatch):
    """Without torch and Stable-Baselines3 a module that needs them says what is to be installed."""
    for name in ("torch", "stable_baselines3", "stable_baselines3.common.vec_env"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, module, raising=False)
    with pytest.raises(ImportError, match=r'pip install "fish_env\[train\]"'):
        importlib.import_module(module)
