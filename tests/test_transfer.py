"""Training on one body, resuming on another; and the table of policies on other bodies."""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from agents import train as training
from agents.build import export_policy, make_env, make_model, start_from
from agents.config import CONFIGS, FINE_TUNING, change_simulation
from benchmarks.learning import transfer
from fish_env import make_fish
from fish_env.control import evaluate, load_policy, make_policy_env, policy_controller

SHORT = {"timesteps": 1024, "num_envs": 8}


def train(task, changes=SHORT, **options):
    """A run with these changed settings."""
    return training.train(training.Request(task, changes=changes, **options))


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


def learner(body: str, seed: int, shaken: float = 0.0, task: str = "swim", **settings):
    """A learner on a body, its parameters shaken."""
    config = replace(change_simulation(CONFIGS[task], body), **settings)
    model = make_model(config, make_env(config, 4, seed), seed)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(shaken * torch.randn_like(parameter))
    return model


@pytest.mark.parametrize("symmetric", [True, False])
def test_start_from_another_body(symmetric):
    """What was learnt in pairs on the flat fish moves both muscles of a pair alike on another body, and back again."""
    flat = learner("planar", 0, 0.3, symmetric=symmetric)
    solid, again = (learner(body, 1, symmetric=symmetric) for body in ("mass_spring", "planar"))
    noise = solid.policy.log_std.detach().clone()
    start_from(solid, flat)
    start_from(again, solid)
    obs = np.random.default_rng(0).normal(size=(20, flat.observation_space.shape[0])).astype(np.float32)
    pairs, muscles, back = (export_policy(model, {})(obs) for model in (flat, solid, again))
    np.testing.assert_allclose(muscles, pairs[:, make_fish().grouping("pairs")], atol=1e-5)
    np.testing.assert_allclose(back, pairs, atol=1e-5)
    assert pairs.shape == (20, 6) and np.abs(pairs).max() > 0.1
    both = np.isin(solid.policy.log_std.detach().numpy(), flat.policy.log_std.detach().numpy())
    assert both.sum() == 6 and (solid.policy.log_std.detach()[~both] == noise[~both]).all()
    values = [model.policy.predict_values(torch.as_tensor(obs)).detach().numpy() for model in (flat, solid)]
    np.testing.assert_allclose(*values, atol=1e-5)


def test_a_start_that_does_not_fit_is_refused():
    """Other tasks, networks and kinds of policy are refused, and the learner stays as it was."""
    model = learner("planar", 0)
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    for other in (learner("planar", 1, task="avoid"), learner("mass_spring", 1, hidden=(16, 16)),
                  learner("planar", 1, symmetric=False)):  # fmt: skip
        with pytest.raises(ValueError, match=r"start from a run of the\s+same task"):
            start_from(model, other)
    after = model.policy.state_dict()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_train_on_another_body(tmp_path, monkeypatch):
    """A run on a body says so, is measured there, another goes on from it; what cannot be is refused at the door."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    first = train("swim", folder=tmp_path / "flat", body="planar")
    second = train("swim", folder=tmp_path / "solid", body="mass_spring", start=first)
    record = json.loads((second / "config.json").read_text())
    assert record["command"].endswith(f"--body mass_spring --start-from {first}") and record["start"] == str(first)
    assert {name: record["config"][name] for name in FINE_TUNING} == FINE_TUNING | SHORT
    policy = load_policy(first / "policy.npz")
    assert policy.about["env_options"] == {"body": "planar", "muscle_groups": "pairs"}
    env = make_policy_env(policy, 2, body="mass_spring")
    assert not env.tank.fish.flat and env.single_action_space.shape == (6,)
    assert np.isfinite(evaluate(policy_controller(policy, env), env)["speed"]).all()
    train("swim", resume=second, changes={"timesteps": 2048})
    assert json.loads((second / "config.json").read_text())["start"] == str(first)
    with pytest.raises(ValueError, match="unknown body 'eel'; choose from"):
        train("swim", root=tmp_path, body="eel")
    with pytest.raises(ValueError, match="has its body"):
        train("swim", resume=second, body="planar")
    with pytest.raises(FileNotFoundError, match="to start from"):
        train("swim", root=tmp_path, start=tmp_path)
    with pytest.raises(ValueError, match="is a run of task 'swim', not 'turn'"):
        train("turn", root=tmp_path, start=first)


def test_policies_on_other_bodies(monkeypatch):
    """The shipped policy and the motor controllers are measured on each body, with intervals."""
    monkeypatch.setattr(transfer, "SHIPPED", ("swim",))
    monkeypatch.setattr(transfer, "BODIES", {"planar": 2, "mass_spring": 3})
    rows = transfer.shipped_rows()
    found = [(row["body"], row["who"], row["metric"], row["episodes"]) for row in rows]
    assert found == [(body, who, metric, count) for body, count in (("planar", 2), ("mass_spring", 3))
                     for who in ("policy", "motor controllers") for metric in ("speed", "failed")]  # fmt: skip
    for row in rows:
        assert float(row["low"]) <= float(row["mean"]) <= float(row["high"])
        assert row["mean"] == "0" if row["metric"] == "failed" else float(row["mean"]) > 1.0
