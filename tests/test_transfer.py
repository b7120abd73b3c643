"""Learning on one body, going on on another; and the tables of what that saves."""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from agents import report
from agents import train as training
from agents.build import export_policy, make_env, make_model, start_from
from agents.config import CONFIGS, FINE_TUNING
from benchmarks.learning import transfer, transfer_chart, transfer_runs
from fish_env import make_fish
from fish_env.control import evaluate, load_policy, make_eval_env, policy_controller

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
    config = replace(training.on_body(CONFIGS[task], body), **settings)
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
    task, opened, env = report.opened(first / "policy.npz", 2, body="mass_spring")
    assert task == "swim" and not env.tank.fish.flat and env.single_action_space.shape == (6,)
    assert np.isfinite(evaluate(policy_controller(opened, env), env)["speed"]).all()
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


def test_seconds_to_a_score():
    """The seconds to a score are read off between the stops, and a fine-tuning goes on where the learning ended."""
    way = np.array([[0.0, 0.0], [10.0, 1.0], [20.0, 3.0], [30.0, 2.0]])
    assert transfer_chart.reached(way, 2.0) == 15.0
    assert transfer_chart.reached(way, 0.0) == 0.0
    assert transfer_chart.reached(way, 3.5) == np.inf
    row = {"task": "swim", "seed": 0, "metric": "speed"}
    rows = [row | {"learnt_on": body, "fine_tuned": tuned, "decisions": stop, "seconds": time, "score_on_finest": score}
            for body, tuned, stop, time, score in (
                ("tetrahedral", 0, 0, 0, 0.0), ("tetrahedral", 0, 100, 1000, 2.0),
                ("planar", 0, 0, 0, 0.0), ("planar", 0, 100, 50, 1.0),
                ("planar", 1, 0, 50, 1.0), ("planar", 1, 10, 150, 3.0))]  # fmt: skip
    np.testing.assert_array_equal(transfer_chart.ways(rows, "swim", "planar")["0"], [[0, 0], [50, 1], [150, 3]])
    found = {r["learnt_on"]: r for r in transfer_chart.saving_rows(rows, ("planar", "tetrahedral"))
              if r["of_what_the_finest_learns"] == 1.0}  # fmt: skip
    assert found["planar"]["seconds"] == 100.0 and found["tetrahedral"]["seconds"] == 1000.0
    assert found["planar"]["times_faster"] == 10.0


def test_runs_and_their_policies(tmp_path, monkeypatch):
    """A run keeps the policies on its way, a fine-tuning begins where its source ended, and scores are kept."""
    monkeypatch.setattr(transfer_runs, "TASKS", {"swim": 16_384})
    monkeypatch.setitem(FINE_TUNING, "timesteps", 8192)
    learnt, tuned = (transfer_runs.Run("swim", *rest) for rest in (("planar", 0), ("mass_spring", 0, "planar")))
    assert tuned.begun_with() == tuned._replace(seed=3).begun_with() == learnt
    for run in (learnt, tuned):
        transfer_runs.learn(run, tmp_path)
    assert list(transfer_runs.stops_of(learnt, tmp_path)) == [0, 8192, 16_384]
    assert list(transfer_runs.stops_of(tuned, tmp_path)) == [0, 2048, 4096, 6144, 8192]
    end, begin = (
        load_policy(run.folder(tmp_path) / f"policy_{stop}.npz") for run, stop in ((learnt, 16_384), (tuned, 0))
    )
    obs = make_eval_env("FishEnv/Swim-v0", 3, {}).reset(seed=0)[0]
    np.testing.assert_allclose(begin(obs), end(obs)[:, make_fish().grouping("pairs")], atol=1e-5)
    scores = transfer_runs.measured(learnt, tmp_path, 16_384, "mass_spring", None, 2)
    again = transfer_runs.measured(learnt, tmp_path, 16_384, "mass_spring", None, 2)
    np.testing.assert_array_equal(scores["speed"], again["speed"])
    calls = transfer.measurements([learnt], [tuned], tmp_path)
    assert len(calls) == len(set(calls)) and (tuned, tmp_path, 8192, "mass_spring", None, 100) in calls
