"""Training with another integrator: what is asked for is checked at the door, recorded, trained with, and resumed."""

import json

import pytest

import agents.train as training
from agents.config import CONFIGS, change_simulation
from agents.train import Request, train
from fish_env import INTEGRATORS, Tank, make_fish
from fish_env.control import load_policy, make_policy_env
from fish_env.physics.tank_options import own_step

SHORT = {"timesteps": 512, "num_envs": 4}
FISH = make_fish()


@pytest.fixture
def quick(monkeypatch):
    """Training without a report."""
    monkeypatch.setattr(training, "report", lambda *arguments: None)


def test_a_run_says_what_it_is_trained_with(tmp_path, quick):
    """Method and step are in the settings, the command and the policy, which is replayed so; a run resumes so."""
    folder = train(Request("swim", folder=tmp_path / "run", integrator="symplectic_euler", dt=0.0005, changes=SHORT))
    record = json.loads((folder / "config.json").read_text())
    chosen = {"integrator": "symplectic_euler", "dt": 0.0005}
    assert record["config"]["env_options"] == load_policy(folder / "policy.npz").about["env_options"] == chosen
    assert record["command"].endswith("--integrator symplectic_euler --dt 0.0005")
    env = make_policy_env(load_policy(folder / "policy.npz"), 2)
    assert env.tank.integrator.name == "symplectic_euler" and env.tank.dt == 0.0005
    env.close()
    train(Request("swim", resume=folder, changes={"timesteps": 1024}))
    again = json.loads((folder / "config.json").read_text())
    assert again["config"]["env_options"] == chosen and again["resumed"] == 1
    for asked in ({"integrator": "rk4"}, {"dt": 0.001}):
        with pytest.raises(ValueError, match="has its body, its integrator"):
            train(Request("swim", resume=folder, changes=SHORT, **asked))


def test_a_method_takes_its_own_step():
    """Without a step it is the method's own; with a step alone it is that of the default method."""
    assert change_simulation(CONFIGS["swim"]) is CONFIGS["swim"]
    assert change_simulation(CONFIGS["swim"], None, "rk4", None).env_options == {"integrator": "rk4"}
    assert change_simulation(CONFIGS["turn"], None, None, 0.002).env_options["dt"] == 0.002


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"integrator": "euler"}, "unknown integrator 'euler'; choose from 'semi_implicit'"),
        ({"dt": -1.0}, "dt is -1.0; give a positive number of seconds"),
        ({"dt": 0.003}, "the control interval is 0.02 s; give a whole multiple of dt = 0.003 s"),
        ({"integrator": "semi_implicit", "body": "planar", "dt": 0.03}, "the control interval is 0.02 s"),
    ],
    ids=str,
)
def test_refused_before_anything_is_made(tmp_path, asked, text):
    """A method or a step that cannot be is refused, and no folder is made."""
    with pytest.raises(ValueError, match=text):
        train(Request("swim", root=tmp_path / "runs", changes=SHORT, **asked))
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["semi_implicit", "rk4"])
def test_own_step(name):
    """A method that is given no step takes half of its largest stable one, or a little less."""
    limit = INTEGRATORS[name].limit(FISH.body)
    step = own_step(FISH, INTEGRATORS[name])
    assert limit / 3 < step <= limit / 2 and Tank(FISH, integrator=name).dt == step
