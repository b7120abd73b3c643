"""Training, its files and its commands: a run can be trusted, and an unusable request is an error that says why."""

import errno
import json
import os
import pkgutil
import shutil
import subprocess
import types
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import tqdm.std
import yaml
from pages import ROOT
from trainings import SHORT, torch, train_short, training

import fish_env
from agents import train_all
from benchmarks.common.tables import read_rows
from fish_env.control import evaluate, evaluation_options, load_policy, make_eval_env, policy_controller
from fish_env.control.equivariant import reflection_of
from fish_env.training import callbacks, report
from fish_env.training.build import export_policy, make_env, make_model
from fish_env.training.config import CONFIGS, PARENT, settings_of
from fish_env.training.run_measures import read_run
from fish_env.training.saved_run import CURVE
from fish_env.training.synergy import synergies

LONGER = {"timesteps": 2048}


def shaken_model(config, num_envs, amount):
    """A learner whose parameters are not those of the beginning."""
    model = make_model(config, make_env(config, num_envs, seed=0), seed=0)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(amount * torch.randn_like(parameter))
    return model


@pytest.mark.parametrize(("task", "symmetric"), [*((task, True) for task in CONFIGS), ("swim", False), ("turn", False)])
def test_exported_policy_acts_like_the_model(task, symmetric):
    """The exported numpy policy gives the model's deterministic actions on raw observations, and is symmetric."""
    model = shaken_model(replace(CONFIGS[task], symmetric=symmetric), 4, 0.1)
    env = model.get_env()
    env.reset()
    for _ in range(5):
        obs, *_ = env.step(np.random.default_rng(0).uniform(-1, 1, (4, env.action_space.shape[0])))
    expected = model.predict(obs, deterministic=True)[0] @ synergies(env.unwrapped.fish).T
    policy = export_policy(model, {})
    np.testing.assert_allclose(policy(obs), np.clip(expected, -1, 1), atol=2e-5)
    place, sign, swap = reflection_of(env.unwrapped.fish)
    mirrored = policy((obs[:, place] * sign).astype(np.float32))
    assert np.allclose(mirrored, policy(obs)[:, swap], atol=2e-5) == symmetric
    assert np.abs(policy(obs) - policy(obs)[:, swap]).max() > 0.05


@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_a_slower_policy_moves_the_same_in_shorter_steps(groups):
    """A policy for steps of 40 ms moves the fish alike in environments with steps of 40 ms and of 20 ms."""
    options = {"muscle_groups": groups, "control_interval": 0.04, "max_episode_steps": 125}
    config = replace(CONFIGS["turn"], env_options=options, training_options={})
    policy = export_policy(shaken_model(config, 2, 0.4), {"env_options": options})
    places = []
    for chosen in (options, evaluation_options(options)):
        env = make_eval_env(config.env_id, 2, chosen)
        act, (obs, _), seen = policy_controller(policy, env), env.reset(seed=3), []
        while env.tank.time[0] < 0.4 - 1e-9:
            obs, *_ = env.step(act(obs, float(env.tank.time[0])))
            seen.append(env.tank.position.copy())
        places.append(seen)
    moved = np.abs(places[0][-1] - places[0][0]).max()
    assert len(places[1]) == 2 * len(places[0]) and moved > 0.002  # chance commands: it moves, 1 % of its length
    np.testing.assert_allclose(places[1][1::2], places[0], atol=1e-3 * moved)
    with pytest.raises(ValueError, match=r"acts every 0.04 s, the environment every 0.03"):
        policy_controller(policy, make_eval_env(config.env_id, 1, {"muscle_groups": groups, "control_interval": 0.03}))


def test_run_leaves_everything_behind(tmp_path, monkeypatch, capsys):
    """A training run leaves model, policy, configuration, curve and report, and prints what to do next."""
    monkeypatch.setattr(report, "EPISODES", 3)
    folder = train_short(seed=3, root=tmp_path, report=True, pictures=True)
    for name in ("model.zip", "policy.npz", "config.json", "results.json", "curve.csv", "report.html"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").rglob("events.*"))
    record = json.loads((folder / "config.json").read_text())
    assert record["seed"] == 3 and record["config"]["timesteps"] == 1024 and record["versions"]["torch"]
    assert record["threads"]["torch"] == 1
    read = read_run(folder)  # what a report asks of a run
    assert read.task == "swim" and read.seed == 3 and read.curve["timesteps"][-1] == 1024
    printed = capsys.readouterr().out
    assert f"fish_env play {folder}" in printed
    assert "best open-loop gait" in printed


def test_same_seed_same_policy_whatever_the_clock_says(trained, tmp_path, monkeypatch):
    """One seed gives the same bits, also with a clock that jumps by days; another seed gives another policy."""
    looks = count()

    def jumping() -> float:
        return 1.7e9 + 1e5 * (-1) ** next(looks)

    monkeypatch.setattr("time.time", jumping)
    monkeypatch.setattr("time.time_ns", lambda: int(1e9 * jumping()))
    monkeypatch.setattr(tqdm.std, "time", jumping)
    monkeypatch.setattr("time.strftime", lambda form: "2020-01-01_00-00-00")
    runs = [train_short(seed=seed, root=tmp_path) for seed in (0, 1)]
    assert [run.name for run in runs] == ["2020-01-01_00-00-00", "2020-01-01_00-00-00_2"] and next(looks) > 10
    one, same, other = (np.load(run / "policy.npz")["weight0"] for run in (trained, *runs))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    seconds = [float(row["seconds"]) for run in runs for row in read_rows(run / "curve.csv")]
    assert seconds and all(0.0 <= value < 1000.0 for value in seconds)


def test_ctrl_c_saves_the_model_and_resume_continues(tmp_path, monkeypatch, capsys):
    """Ctrl-C saves model and policy and says how to resume; --resume continues to the end."""
    advance = training.Progress._on_rollout_end

    def press(self):
        advance(self)
        if self.num_timesteps >= 512:
            raise KeyboardInterrupt

    folder = tmp_path / "run"
    with monkeypatch.context() as patch, pytest.raises(training.Stopped):
        patch.setattr(training.Progress, "_on_rollout_end", press)
        train_short(folder=folder)
    assert f"--resume {folder}" in capsys.readouterr().out and load_policy(folder / "policy.npz")
    assert train_short(resume=folder, changes={}) == folder
    assert training.PPO.load(folder / "model.zip", device="cpu").num_timesteps == 1024


def test_a_run_whose_starter_is_gone_stops_and_is_saved(tmp_path, monkeypatch, capsys):
    """A run of `train.py all` ends when that program was killed: saved and resumable."""
    monkeypatch.setenv(PARENT, "1")  # another program than the one that starts it here
    with pytest.raises(training.Stopped):
        train_short(folder=tmp_path / "run")
    assert f"--resume {tmp_path / 'run'}" in capsys.readouterr().out
    assert training.PPO.load(tmp_path / "run/model.zip", device="cpu").num_timesteps == 0


# All tasks


@pytest.fixture
def started(monkeypatch):
    """The commands of the jobs that are started; they end at once, without results."""
    found = []

    def start(self, processor):
        found.append(self.command())
        self.folder.mkdir(parents=True, exist_ok=True)
        self.process = subprocess.Popen(["true"])
        self.process.wait()

    monkeypatch.setattr(train_all, "POLL", 0.01)
    monkeypatch.setattr(train_all.Job, "start", start)
    return found


def test_training_everything_can_be_stopped_and_resumed(started, trained, tmp_path, monkeypatch):
    """`train.py all` leaves finished runs unchanged, resumes stopped ones, and names those that fail."""
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], **SHORT)})
    for seed in range(2):
        shutil.copytree(trained, tmp_path / f"swim/seed_{seed}")
    (tmp_path / "swim/seed_0/results.json").write_text("{}")
    with pytest.raises(RuntimeError, match=r"2 of 3 runs failed; see .*seed_1.*seed_2"):
        train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert [words[-2:] for words in started] == [["--resume", str(tmp_path / "swim/seed_1")],
                                                 ["--folder", str(tmp_path / "swim/seed_2")]]  # fmt: skip
    assert all(Path(words[1]) == ROOT / "train.py" for words in started)
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], epochs=3)})
    with pytest.raises(ValueError, match="was trained with other settings"):
        train_all.train_all(tmp_path, ["swim"])
    with pytest.raises(ValueError, match="jobs is 0"):
        train_all.train_all(tmp_path, ["swim"], jobs=0)


def test_another_integrator_for_all(started, tmp_path):
    """With another integrator, each run is told method and step, or resumed."""
    with pytest.raises(RuntimeError, match="6 of 6 runs failed"):
        train_all.train_all(tmp_path, ["swim", "turn"], 1, "semi_implicit", 0.001)
    assert [(words[2], words[4]) for words in started] == [(t, str(k)) for k in range(3) for t in ("swim", "turn")]
    for words in started:
        assert words[words.index("--integrator") + 1] == "semi_implicit" and words[words.index("--dt") + 1] == "0.001"
    job = train_all.Job("swim", 0, tmp_path / "swim/seed_0", CONFIGS["swim"])
    (job.folder / "model.zip").touch()
    assert "--integrator" not in job.command() and job.command()[-2] == "--resume"
    with pytest.raises(ValueError, match="unknown integrator 'euler'"):
        train_all.train_all(tmp_path, ["swim"], 1, "euler")


# Files


def test_a_folder_takes_one_run(run_copy):
    """A folder with a run in it, or in which another program trains, stays as it is; the curve is cut to the model."""
    with pytest.raises(ValueError, match="holds a run; resume it with"):
        train_short(folder=run_copy)
    with training.lock_folder(run_copy), pytest.raises(RuntimeError, match="another program is training"):
        train_short(resume=run_copy, changes=LONGER)
    with (run_copy / "curve.csv").open("a") as file:
        file.write("999999,9.0,1,0.0,0.0\n")
    train_short(resume=run_copy, changes=LONGER)
    steps = [int(row["timesteps"]) for row in read_rows(run_copy / "curve.csv")]
    assert steps == sorted(steps) and steps[-1] == 2048
    record = json.loads((run_copy / "config.json").read_text())
    assert record["resumed"] == 1
    assert settings_of(record["config"]) == replace(CONFIGS["swim"], num_envs=8, timesteps=2048)


@pytest.mark.parametrize("answers", [None, [], ["", ""], ["elsewhere"]], ids=["nobody", "end", "again", "another"])
def test_a_full_disk_at_the_end_keeps_the_model(answers, tmp_path, monkeypatch):
    """A person frees space or names another place; without one, or when input ends, the model goes where it fits."""
    folder, answered, asked = tmp_path / "run", list(answers or []), []
    save = training.save_model

    def full(model, path):
        if path.parent == folder and (answers != ["", ""] or len(asked) < 2):
            raise OSError(errno.ENOSPC, "No space left on device")
        save(model, path)

    def answer(text):
        asked.append(text)
        if not answered:
            raise EOFError
        return answered.pop(0)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(training, "save_model", full)
    monkeypatch.setattr(training, "ELSEWHERE", (str(tmp_path / "run" / "model.json"), str(tmp_path / "temporary")))
    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr("sys.stdin", types.SimpleNamespace(isatty=lambda: answers is not None))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.json").write_text("a file, and no folder")
    if answers == ["", ""]:
        assert train_short(folder=folder) == folder
        found = folder
    else:
        with pytest.raises(RuntimeError, match=r"are saved in .*: free some space, copy them to .*run and resume"):
            train_short(folder=folder)
        (found,) = (tmp_path / ("elsewhere" if answers else "temporary")).glob("fish_env-*")
    assert {"model.zip", "policy.npz"} <= set(os.listdir(found)) and load_policy(found / "policy.npz")
    assert len(asked) == (0 if answers is None else max(1, len(answers)))


def test_a_failed_run_leaves_the_saved_model(run_copy, tmp_path, monkeypatch):
    """If saving fails half way, the model and the policy that were there are still there, whole."""
    before = {name: (run_copy / name).read_bytes() for name in ("model.zip", "policy.npz")}

    def fail(self, path, *rest, **options):
        Path(path).write_bytes(b"half")
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(training.PPO, "save", fail)
        patch.setattr(training, "ELSEWHERE", (str(tmp_path),))
        with pytest.raises(RuntimeError, match=r"could not be saved in .*no space left.*free some space there and"):
            train_short(resume=run_copy, changes=LONGER)
    assert not any(tmp_path.glob("fish_env-*/*"))
    assert {name: (run_copy / name).read_bytes() for name in before} == before
    assert not list(run_copy.glob(".*"))
    assert train_short(resume=run_copy, changes=LONGER) == run_copy


def test_a_diverged_training_ends_with_advice(run_copy, monkeypatch):
    """Parameters that are not finite end the run with an error, and the model that was saved stays."""
    before = (run_copy / "model.zip").read_bytes()

    def diverge(self):
        with torch.no_grad():
            self.policy.log_std[0] = np.nan

    monkeypatch.setattr(training.PPO, "train", diverge)
    for steps in (1280, 2048):  # at the end of the training, and before
        with pytest.raises(ValueError, match="not finite; resume the run from its last checkpoint"):
            train_short(resume=run_copy, changes={"timesteps": steps})
    assert (run_copy / "model.zip").read_bytes() == before


def test_a_full_disk_ends_the_training_and_keeps_the_model(tmp_path, monkeypatch):
    """A file that cannot be written ends the run; the model goes elsewhere, and the last checkpoint is whole."""
    monkeypatch.setattr(training, "Checkpoint", lambda path: callbacks.Checkpoint(path, seconds=0.0))
    folder, replace_file, written_files = tmp_path / "run", os.replace, []

    def full_after_a_while(source, target):
        if folder in Path(target).parents:  # kernels are stored elsewhere
            written_files.append(Path(target).name)
            if len(written_files) > 4:
                raise OSError(errno.ENOSPC, "No space left on device")
        replace_file(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full_after_a_while)
        patch.setattr(training, "ELSEWHERE", (str(tmp_path / "elsewhere"),))
        with pytest.raises(RuntimeError, match=r"did not take the model after .* are saved in .*elsewhere"):
            train_short(folder=folder, changes={"timesteps": 4096, "num_envs": 8})
    (kept,) = (tmp_path / "elsewhere").glob("fish_env-*/model.zip")
    saved, last = (training.PPO.load(path, device="cpu").num_timesteps for path in (folder / "model.zip", kept))
    assert 0 < saved <= last < 4096 and not list(folder.glob(".*"))
    train_short(resume=folder, changes={})
    assert training.PPO.load(folder / "model.zip", device="cpu").num_timesteps == 4096


def tensors_of(folder):
    """The numbers of a saved policy and of its optimizer, by name."""
    saved = training.PPO.load(folder / "model.zip", device="cpu").get_parameters()
    moments = saved["policy.optimizer"]["state"].items()
    rates = {"rate": torch.tensor([group["lr"] for group in saved["policy.optimizer"]["param_groups"]])}
    return saved["policy"] | {f"{k} {name}": value for k, each in moments for name, value in each.items()} | rates


def test_a_run_goes_on_as_with_stable_baselines(run_copy, tmp_path, monkeypatch):
    """Bit for bit: parameters, optimizer, learning rate and counts are those of a learner that `PPO.load` gave."""
    before = shutil.copytree(run_copy, tmp_path / "before")
    train_short(changes=LONGER, resume=run_copy)
    load = lambda config, env, *rest: training.PPO.load(before / "model.zip", env, device="cpu")  # noqa: E731
    monkeypatch.setattr(training, "make_model", load)
    monkeypatch.setattr(training, "restore", lambda model, path: model)
    train_short(changes=LONGER, resume=before)
    one, other = tensors_of(run_copy), tensors_of(before)
    assert one.keys() == other.keys() and one["rate"] < 1e-3 and len(one) > 20
    for name, value in one.items():
        assert torch.equal(value, other[name]), name
    assert [path.name for path in (run_copy / "tensorboard").iterdir()] == ["ppo_1"]


def changed_record(**changes):
    """A function that changes what is in config.json; None takes a field away."""

    def change(folder):
        path, others = folder / "config.json", dict(changes)
        record = json.loads(path.read_text())
        record["config"] |= others.pop("config", {})
        path.write_text(json.dumps({k: v for k, v in (record | others).items() if v is not None}))

    return change


def written(name, text):
    """A function that writes a text file."""
    return lambda folder: (folder / name).write_text(text)


def cut(name, kept=slice(None, -8)):
    """A function that cuts the end of a file off."""
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[kept])


def rename_a_layer(folder):
    """Save a model in which a layer of the policy has another name."""
    model = training.PPO.load(folder / "model.zip", device="cpu")
    model.policy.other_net = model.policy.action_net
    del model.policy.action_net
    model.save(folder / "model.zip")


RECORD = r"config.json cannot be used \("
BROKEN = {
    "empty object": (written("config.json", "{}"), RECORD + r"'task' is None\); restore"),
    "list": (written("config.json", "[]"), RECORD + "'list' object is not a mapping"),
    "half": (cut("config.json"), RECORD + ".*(delimiter|Expecting|Unterminated)"),
    "no seed": (changed_record(seed=None), RECORD + r"'seed' is None\)"),
    "seed": (changed_record(seed="0"), RECORD + r"'seed' is '0'\)"),
    "fish": (changed_record(config={"num_envs": "8"}), RECORD + ".*num_envs is '8'; give a whole number, at least 1"),
    "memory": (changed_record(config={"num_envs": 10**9}), RECORD + ".*this machine has"),
    "rate": (changed_record(config={"learning_rate": "fast"}), RECORD + ".*learning_rate is 'fast'; give a finite"),
    "layers": (changed_record(config={"hidden": [64, "x"]}), RECORD + r".*hidden is \(64, 'x'\); give a list of"),
    "setting": (changed_record(config={"speed": 1}), RECORD + ".*not those of this version"),
    "other environment": (changed_record(task="turn"), r"'FishEnv/Swim-v0' is not that of a task 'turn' here\)"),
    "module": (changed_record(config={"env_id": "this:FishEnv/Swim-v0"}), "is not that of a task 'swim' here"),
    "other task": (changed_record(task="turn", config={"env_id": "FishEnv/Turn-v0"}), "of task 'turn', not 'swim'"),
    "other layers": (changed_record(config={"hidden": [8, 8]}), r"model.zip cannot be read \((.|\s)*size mismatch"),
    "names": (rename_a_layer, r"model.zip cannot be read \((.|\s)*action_net"),
    "half a model": (cut("model.zip", slice(5000)), "model.zip cannot be read"),
    "row": (cut("curve.csv"), r"curve.csv cannot be read \(it has a row '1024,.*\); delete"),
    "number": (written("curve.csv", CURVE + "\n1,2,3,4,x\n"), "curve.csv cannot be read"),
    "head": (written("curve.csv", "steps\n"), r"curve.csv cannot be read \(its head is 'steps'"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_run_whose_files_are_broken_is_not_resumed(name, run_copy, tmp_path):
    """Each file that cannot be used is an error that names it, and no file of the run is changed."""
    damage, message = BROKEN[name]
    damage(run_copy)
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=message):
        train_short(resume=run_copy, changes=LONGER)
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before
    if "curve" not in message:
        with pytest.raises(ValueError, match=message):
            train_short(start=run_copy, root=tmp_path / "new")
        assert not (tmp_path / "new").exists()


def test_a_run_of_other_versions_is_resumed_with_a_warning(run_copy, capsys):
    """What is installed now differs: it is said, and the record has both versions."""
    record = json.loads((run_copy / "config.json").read_text())
    installed = record["versions"]["fish_env"]
    changed_record(versions=record["versions"] | {"fish_env": "0.0.1"}, threads=None)(run_copy)
    train_short(resume=run_copy, changes=LONGER)
    said = capsys.readouterr().out
    assert f"Warning: the run was trained with fish_env 0.0.1 (now {installed}). Training continues" in said
    assert json.loads((run_copy / "config.json").read_text())["versions"]["fish_env"] == f"0.0.1, {installed}"
    train_short(resume=run_copy, changes={"timesteps": 3072})
    assert "Warning" not in capsys.readouterr().out


def test_short_training_learns(tmp_path):
    """A short PPO run swims faster than it did before, on the evaluation seeds."""
    config = CONFIGS["swim"]
    env = make_eval_env(config.env_id, 8, config.env_options)
    before = evaluate(env, export_policy(make_model(config, make_env(config, 1, 0), 0), {}))["speed"].mean()
    folder = train_short(root=tmp_path, changes={"timesteps": 65_536, "num_envs": 64})
    after = evaluate(env, load_policy(folder / "policy.npz"))["speed"].mean()
    assert after > before + 0.1


def test_zoo_file_agrees_with_the_settings():
    """agents/rl_zoo3.yml has the settings of CONFIGS, for as many environment steps an update."""
    zoo = yaml.safe_load((ROOT / "agents" / "rl_zoo3.yml").read_text())
    assert set(zoo) == {config.env_id for config in CONFIGS.values()}
    for task in fish_env.TASKS:
        config = CONFIGS[task]
        given, update = zoo[config.env_id], config.num_envs * config.rollout
        assert given["n_envs"] * given["n_steps"] == update and given["n_timesteps"] % update == 0
        assert given["n_timesteps"] == pytest.approx(config.timesteps, abs=update)
        interval = config.env_options.get("control_interval", 0.02)
        assert given["gamma"] == pytest.approx(config.discount(interval), abs=1e-4)
        wanted = (config.batch_size, config.epochs, config.gae_lambda, config.clip_range, config.entropy_weight)
        assert tuple(given[k] for k in ("batch_size", "n_epochs", "gae_lambda", "clip_range", "ent_coef")) == wanted
        assert given["learning_rate"] == f"lin_{config.learning_rate:.0e}".replace("e-0", "e-")
        assert given["policy_kwargs"] == {"net_arch": list(config.hidden), "log_std_init": config.initial_log_std}
        assert given.get("env_kwargs", {}) == config.env_options


@pytest.mark.parametrize("name", [
    "agents.build.falling", "agents.layers.Tanh", "fish_env.training.build.falling",
    "fish_env.control.equivariant.Reflection", "fish_env.control.equivariant.EquivariantPolicy",
])  # fmt: skip
def test_names_in_saved_models(name):
    """What `model.zip` files refer to has its old name, so that `PPO.load` of Stable-Baselines3 reads them."""
    assert isinstance(pkgutil.resolve_name(name), type)
