"""Training on another body, with another integrator, or from another run's policy."""

import json
from dataclasses import replace

import numpy as np
import pytest
from trainings import SHORT, torch, train_short

from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.control import evaluate, load_policy, make_policy_env
from fish_env.physics.tank_options import own_step
from fish_env.training.build import export_policy, make_env, make_model, start_from
from fish_env.training.config import CONFIGS, FINE_TUNING, change_simulation

FISH = make_fish()


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
    np.testing.assert_allclose(muscles, pairs[:, FISH.grouping("pairs")], atol=1e-5)
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


def test_train_with_another_simulation(tmp_path):
    """Body, method and step are in the settings, the command and the policy; a run resumes so, and another goes on."""
    chosen = {"body": "planar", "integrator": "symplectic_euler", "dt": 0.00025}
    same = train_short(folder=tmp_path / "keywords", env_options=chosen)
    first = train_short(folder=tmp_path / "flat", **chosen)
    record, policy = json.loads((first / "config.json").read_text()), load_policy(first / "policy.npz")
    assert json.loads((same / "config.json").read_text()) == record
    options = chosen | {"muscle_groups": "pairs"}
    assert record["config"]["env_options"] == policy.about["env_options"] == options
    assert record["command"].endswith("--body planar --integrator symplectic_euler --dt 0.00025")
    env = make_policy_env(policy, 2)
    assert env.tank.fish.flat and env.tank.integrator.name == "symplectic_euler" and env.tank.dt == 0.00025
    env = make_policy_env(policy, 2, body="mass_spring")
    assert not env.tank.fish.flat and env.single_action_space.shape == (6,)
    assert np.isfinite(evaluate(env, policy)["speed"]).all()
    train_short(resume=first, changes={"timesteps": 2048})
    again = json.loads((first / "config.json").read_text())
    assert again["config"]["env_options"] == options and again["resumed"] == 1
    second = train_short(folder=tmp_path / "solid", body="mass_spring", start=first)
    record = json.loads((second / "config.json").read_text())
    assert record["command"].endswith(f"--body mass_spring --start-from {first}") and record["start"] == str(first)
    assert {name: record["config"][name] for name in FINE_TUNING} == FINE_TUNING | SHORT
    train_short(resume=second, changes={"timesteps": 2048})
    assert json.loads((second / "config.json").read_text())["start"] == str(first)


def test_what_does_not_go_together_is_refused(trained, tmp_path):
    """A run that is resumed keeps its body and method, and another task or an empty folder is no start."""
    for asked in ({"body": "planar"}, {"integrator": "rk4"}, {"dt": 0.001}, {"start": trained}):
        with pytest.raises(ValueError, match="has its environment and its starting point"):
            train_short(resume=trained, **asked)
    with pytest.raises(FileNotFoundError, match="to start from"):
        train_short(root=tmp_path, start=tmp_path)
    with pytest.raises(ValueError, match="is a run of task 'swim', not 'turn'"):
        train_short("turn", root=tmp_path, start=trained)


def test_a_method_takes_its_own_step():
    """Without a step it is the method's own; with a step alone it is that of the default method."""
    assert change_simulation(CONFIGS["swim"]) is CONFIGS["swim"]
    assert change_simulation(CONFIGS["swim"], integrator="rk4").env_options == {"integrator": "rk4"}
    assert change_simulation(CONFIGS["turn"], dt=0.002).env_options["dt"] == 0.002


@pytest.mark.parametrize("name", ["semi_implicit", "rk4"])
def test_own_step(name):
    """A method that is given no step takes half of its largest stable one, or a little less."""
    limit = INTEGRATORS[name].base(FISH.body)
    step = own_step(FISH, INTEGRATORS[name])
    assert limit / 3 < step <= limit / 2 and Tank(FISH, integrator=name).dt == step
