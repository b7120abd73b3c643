"""Training, its files and its commands: a run can be trusted, and an unusable request is an error that says why."""

import errno
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
record_writer = pytest.importorskip("tensorboard.summary.writer.record_writer")

import fish_env
from agents import callbacks, jobs, report, statistics, train_all
from agents import train as training
from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS, RESULTS, settings_of
from agents.run_measures import read_run
from agents.synergy import synergies
from benchmarks.common import tables
from benchmarks.common.tables import read_rows
from benchmarks.learning import integrators, publish
from fish_env.control import evaluate, evaluation_options, load_policy, make_eval_env, policy_controller, shipped_policy
from fish_env.control.equivariant import reflection_of

ROOT = Path(__file__).parent.parent
SHORT = {"timesteps": 1024, "num_envs": 8}


def train(task, seed=None, changes=SHORT, **options):
    """A run with these changed settings."""
    return training.train(training.Request(task, seed, changes=changes, **options))


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch):
    """Reports of a few episodes only."""
    monkeypatch.setattr(report, "EPISODES", 3)


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("task", CONFIGS)
def test_exported_policy_acts_like_the_model(task, symmetric):
    """The exported numpy policy gives the model's deterministic actions on raw observations, and is symmetric."""
    config = replace(CONFIGS[task], symmetric=symmetric)
    env = make_env(config, 4, seed=0)
    model = make_model(config, env, seed=0)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
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
    model = make_model(config, make_env(config, 2, seed=0), seed=0)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.8 * torch.randn_like(parameter))
    policy = export_policy(model, {"env_options": options})
    slow, fast = (make_eval_env(config.env_id, 2, chosen) for chosen in (options, evaluation_options(options)))
    places = []
    for env in (slow, fast):
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


def test_run_leaves_everything_behind(tmp_path, capsys):
    """A training run leaves model, policy, configuration, curve, pictures and video, and prints what to do next."""
    folder = train("swim", seed=3, root=tmp_path)
    for name in ("model.zip", "policy.npz", "config.json", "results.json", "curve.csv", "report.html"):
        assert (folder / name).stat().st_size > 0, name
    assert list((folder / "tensorboard").rglob("events.*"))
    record = json.loads((folder / "config.json").read_text())
    assert record["seed"] == 3 and record["config"]["timesteps"] == 1024 and record["versions"]["torch"]
    read = read_run(folder)  # what a report asks of a run
    assert read.task == "swim" and read.seed == 3 and read.curve["timesteps"][-1] == 1024
    printed = capsys.readouterr().out
    assert f"python train.py play {folder / 'policy.npz'}" in printed
    assert "best open-loop gait" in printed and "untrained policy" in printed


def test_same_seed_same_policy(tmp_path, monkeypatch):
    """Two runs with one seed give the same policy bits; another seed gives another policy."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    runs = [train("swim", seed=seed, root=tmp_path) for seed in (0, 0, 1)]
    one, same, other = (np.load(run / "policy.npz")["weight0"] for run in runs)
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_ctrl_c_saves_the_model_and_resume_continues(tmp_path, monkeypatch, capsys):
    """Ctrl-C saves model and policy and says how to resume; --resume continues to the end."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    interrupt = training.Progress._on_rollout_end

    def press(self):
        interrupt(self)
        if self.num_timesteps >= 512:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(training.Progress, "_on_rollout_end", press)
        with pytest.raises(training.Stopped):
            train("swim", folder=tmp_path / "run")
    folder, printed = tmp_path / "run", capsys.readouterr().out
    assert f"--resume {folder}" in printed and load_policy(folder / "policy.npz")
    assert train("swim", resume=folder, changes={}) == folder
    model = training.PPO.load(folder / "model.zip", device="cpu")
    assert model.num_timesteps == 1024


def test_a_run_whose_starter_is_gone_stops_and_is_saved(tmp_path):
    """A run of `train.py all` ends when that program was killed: saved, resumable, with the exit status of Ctrl-C."""
    command = [
        sys.executable,
        str(ROOT / "train.py"),
        "swim",
        "--timesteps",
        "8192",
        "--num-envs",
        "8",
        "--no-pictures",
    ]
    folder = tmp_path / "run"
    environment = os.environ | {jobs.PARENT: "1"}  # another program than the one that starts it here
    done = subprocess.run([*command, "--folder", folder], env=environment, capture_output=True, text=True)
    assert done.returncode == 130 and f"--resume {folder}" in done.stdout and "Traceback" not in done.stderr
    assert 0 <= training.PPO.load(folder / "model.zip", device="cpu").num_timesteps < 8192
    with pytest.raises(ValueError, match="begun with --seed 0, not 3"):
        train("swim", 3, resume=folder)


def test_training_everything_can_be_stopped_and_resumed(tmp_path, monkeypatch):
    """`train.py all` leaves finished runs unchanged, resumes stopped ones, and publishes the results of all."""
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], **SHORT)})
    monkeypatch.setattr(train_all, "RESULTS", {"swim": RESULTS["swim"]._replace(seeds=2)})
    started = []

    def ended():
        process = subprocess.Popen(["true"])
        process.wait()
        return process

    def start(self, processor):
        started.append((self.seed, (self.folder / "model.zip").exists()))
        resume = self.folder if started[-1][1] else None
        folder = None if resume else self.folder
        train("swim", self.seed, resume=resume, folder=folder, pictures=False)
        self.process = ended()

    monkeypatch.setattr(train_all.Job, "start", start)
    folders = train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert started == [(0, False), (1, False)] and all((run / "results.json").exists() for run in folders)
    before = (folders[0] / "policy.npz").read_bytes()
    (folders[1] / "results.json").unlink()
    train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert started[2:] == [(1, True)] and (folders[0] / "policy.npz").read_bytes() == before
    job = train_all.Job("swim", 0, folders[0], train_all.CONFIGS["swim"])
    assert job.command()[-2:] == ["--resume", str(folders[0])] and Path(job.command()[1]) == ROOT / "train.py"
    (folders[1] / "results.json").unlink()
    monkeypatch.setattr(train_all.Job, "start", lambda self, processor: setattr(self, "process", ended()))
    with pytest.raises(RuntimeError, match=r"1 of 2 runs failed; see .*seed_1"):
        train_all.train_all(tmp_path, ["swim"], jobs=1)
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], epochs=3)})
    with pytest.raises(ValueError, match="was trained with other settings"):
        train_all.train_all(tmp_path, ["swim"])
    with pytest.raises(ValueError, match="jobs is 0"):
        train_all.train_all(tmp_path, ["swim"], jobs=0)


def test_another_integrator_for_all(tmp_path, monkeypatch):
    """With another integrator, every task has at most three seeds; each run is told method and step, or resumed."""
    started = []

    def start(self, processor):
        started.append(self.command())
        self.folder.mkdir(parents=True)
        (self.folder / "results.json").write_text("{}")
        self.process = subprocess.Popen(["true"])

    monkeypatch.setattr(train_all.Job, "start", start)
    train_all.train_all(tmp_path, ["swim", "turn"], 1, "semi_implicit", 0.001)
    assert [(words[2], words[4]) for words in started] == [(t, str(k)) for k in range(3) for t in ("swim", "turn")]
    for words in started:
        assert words[words.index("--integrator") + 1] == "semi_implicit" and words[words.index("--dt") + 1] == "0.001"
    job = train_all.Job("swim", 0, tmp_path / "swim/seed_0", CONFIGS["swim"])
    (job.folder / "model.zip").touch()
    assert "--integrator" not in job.command() and job.command()[-2] == "--resume"
    with pytest.raises(ValueError, match="unknown integrator 'euler'"):
        train_all.train_all(tmp_path, ["swim"], 1, "euler")


def test_another_integrator_is_published(tmp_path, monkeypatch, capsys):
    """What was trained with another integrator is measured under it and under the default, in a table of its own."""
    runs = tmp_path / "runs"
    folder = train("swim", folder=runs / "swim/seed_0", pictures=False, integrator="semi_implicit", dt=0.002)
    assert json.loads((folder / "config.json").read_text())["config"]["env_options"]["integrator"] == "semi_implicit"
    monkeypatch.setattr(publish, "EPISODES", 3)
    monkeypatch.setattr(statistics, "RESAMPLES", 20)
    capsys.readouterr()
    monkeypatch.setattr(tables, "trajectories", dict)
    publish.publish_method(runs, "semi_implicit", ["swim"])
    rows = read_rows(runs / "trained_with_semi_implicit.csv")
    assert [row["moved_by"] for row in rows] == ["semi_implicit"] * 3 + ["the default"] * 3
    assert {row["dt"] for row in rows} == {"0.002"} and {row["seeds"] for row in rows} == {"1"}
    text = (runs / "trained_with_semi_implicit.csv").read_text()
    assert "# command: python train.py all --integrator semi_implicit --dt 0.002\n" in text
    out = capsys.readouterr().out
    assert out.count("| swim | speed, BL/s |") == 1
    assert len([line for line in out.splitlines() if line.startswith("| swim") and line.count("|") == 6]) == 3
    with pytest.raises(FileNotFoundError, match="no run of turn"):
        publish.publish_method(runs, "semi_implicit", ["turn"])


def test_a_folder_takes_one_run(tmp_path, monkeypatch):
    """A folder with a run in it, or in which another program trains, stays as it is; the curve is cut to the model."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = train("swim", folder=tmp_path / "run")
    with pytest.raises(ValueError, match="holds a run; resume it with"):
        train("swim", folder=folder)
    with training.locked(folder), pytest.raises(RuntimeError, match="another program is training"):
        train("swim", resume=folder, changes={"timesteps": 2048})
    with (folder / "curve.csv").open("a") as file:
        file.write("999999,9.0,1,0.0,0.0\n")
    train("swim", resume=folder, changes={"timesteps": 2048})
    steps = [int(row["timesteps"]) for row in read_rows(folder / "curve.csv")]
    assert steps == sorted(steps) and steps[-1] == 2048
    record = json.loads((folder / "config.json").read_text())
    assert record["resumed"] == 1 and settings_of(record["config"]) == replace(
        CONFIGS["swim"], num_envs=8, timesteps=2048
    )


def test_interquartile_mean_and_interval(monkeypatch):
    """The interquartile mean is scipy's trimmed mean where a quarter is whole; its interval mostly has the true one."""
    monkeypatch.setattr(statistics, "RESAMPLES", 400)
    rng = np.random.default_rng(0)
    values = rng.normal(size=12)
    assert statistics.interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))
    assert statistics.interquartile_mean(np.array([1.0, 2.0, np.nan])) == pytest.approx(1.5)
    inside = 0
    for _ in range(40):
        levels = rng.normal(3.0, 0.5, 10)
        scores = [{"return": rng.normal(level, 1.0, 50)} for level in levels]
        value, low, high = statistics.interval(scores, "return", rng)
        assert low < value < high
        inside += low < 3.0 < high
    assert inside >= 32
    inside = 0
    for _ in range(40):  # all seeds play the same episodes, some of which are hard for all
        hard, levels = rng.normal(0.0, 1.0, 50), rng.normal(3.0, 0.1, 5)
        scores = [{"return": level + hard + rng.normal(0.0, 0.3, 50)} for level in levels]
        _, low, high = statistics.interval(scores, "return", rng)
        inside += low < 3.0 < high
    assert inside >= 34


def test_publishing_fills_in_page_and_files(tmp_path, monkeypatch):
    """Publishing writes seeds, methods and curves, ships the median seed, and fills in the table of the page."""
    monkeypatch.setattr(publish, "LEARNING", tmp_path / "learning")
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(tables, "trajectories", dict)
    monkeypatch.setattr(publish, "PRETRAINED", tmp_path / "pretrained")
    monkeypatch.setattr(publish, "EPISODES", 4)
    monkeypatch.setattr(statistics, "RESAMPLES", 20)
    monkeypatch.setattr(publish, "RESULTS", {"swim": RESULTS["swim"]._replace(seeds=2)})
    page = tmp_path / "results.md"
    page.write_text("before <!-- swim --> old <!-- end --> after")
    monkeypatch.setattr(publish, "PAGE", page)
    monkeypatch.setattr(publish, "README", tmp_path / "README.md")
    publish.README.write_text("<!-- summary -->\nold\n<!-- end -->")
    for seed in range(2):
        train("swim", seed, folder=tmp_path / "runs" / "swim" / f"seed_{seed}", pictures=False)
    publish.publish(tmp_path / "runs", ["swim"])
    assert (
        "| PPO, 2 seeds |" in page.read_text() and "old" not in page.read_text() and page.read_text().endswith("after")
    )
    assert "[`Swim-v0`](docs/envs/swim.md)" in publish.README.read_text() and "old" not in publish.README.read_text()
    assert load_policy(tmp_path / "pretrained" / "swim" / "policy.npz")
    assert [row["seed"] for row in publish.stored("seeds")] == ["0", "1"]
    publish.replace_rows("seeds", "turn", [{"seed": 5, "latency": 0.5}])
    publish.replace_rows("seeds", "swim", [{"seed": 7, "speed": 2.0}])
    found = [(row["task"], row["seed"], row["latency"], row["speed"]) for row in publish.stored("seeds")]
    assert found == [("swim", "7", "", "2.0"), ("turn", "5", "0.5", "")]
    with pytest.raises(FileNotFoundError, match=r"no run of swim in .* is finished"):
        publish.publish(tmp_path / "nowhere", ["swim"])


def test_the_pages_hold_what_the_tables_hold():
    """The tables of the page of results and of the README are those of the CSV file; no trained policy has failed."""
    page = publish.PAGE.read_text()
    assert publish.filled(page) == page and all(f"<!-- {task} -->" in page for task in CONFIGS)
    assert f"<!-- summary -->\n{publish.summary()}<!-- end -->" in publish.README.read_text()
    assert {float(row["value"]) for row in publish.stored("methods") if row["metric"] == "failed"} == {0.0}


def test_integrator_check_sees_a_difference(tmp_path, monkeypatch):
    """A policy replayed with the same method does the same; a coarse step shows in return and path."""
    path = shipped_policy("swim")
    fine = integrators.replay(path, ("rk4", 0.00125, None), 3)
    assert integrators.differences(*fine, *fine)["path_difference"] == 0.0
    found = integrators.differences(*integrators.replay(path, ("semi_implicit", 0.000625, None), 3), *fine)
    assert found["failed"] == 0 and found["path_difference"] > 0.01
    fish = fish_env.make_fish()
    names = [name for name, _, _ in integrators.settings(fish)]
    assert (fish.integrator, fish.time_step, fish.refine) in integrators.settings(fish)
    fixed = {name for name, record in fish_env.INTEGRATORS.items() if record.kind != "adaptive"}
    assert names[0] == "rk4" and set(names) == fixed


def test_bad_training_requests_are_refused(tmp_path):
    """Unknown tasks, counts below one, folders that hold no run or cannot be written to are errors."""
    with pytest.raises(ValueError, match="unknown task 'fly'"):
        train("fly", root=tmp_path)
    with pytest.raises(ValueError, match="num_envs is 0"):
        train("swim", root=tmp_path, changes={"num_envs": 0})
    with pytest.raises(FileNotFoundError, match="to resume"):
        train("swim", resume=tmp_path)
    (tmp_path / "file").write_text("not a folder")
    for place in ({"folder": tmp_path / "file" / "run"}, {"root": tmp_path / "file"}):
        with pytest.raises(ValueError, match="no file can be written in the folder"):
            train("swim", **place)
    assert (tmp_path / "file").read_text() == "not a folder"


def test_a_failed_run_leaves_the_saved_model(tmp_path, monkeypatch):
    """If saving fails half way, the model, the policy and the results that were there are still there, whole."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = train("swim", folder=tmp_path / "run")
    before = {name: (folder / name).read_bytes() for name in ("model.zip", "policy.npz")}

    def fail(self, path, *rest, **options):
        Path(path).write_bytes(b"half")
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(training.PPO, "save", fail)
        with pytest.raises(RuntimeError, match=r"could not be saved in .*no space left.*free some space there and"):
            train("swim", resume=folder, changes={"timesteps": 2048})
    assert {name: (folder / name).read_bytes() for name in before} == before
    assert not list(folder.glob(".*"))
    assert train("swim", resume=folder, changes={"timesteps": 2048}) == folder


def test_a_diverged_training_ends_with_advice(tmp_path, monkeypatch):
    """Parameters that are not finite end the run with an error, and the model that was saved stays."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = train("swim", folder=tmp_path / "run")
    before = (folder / "model.zip").read_bytes()

    def diverge(self):
        with torch.no_grad():
            self.policy.log_std[0] = np.nan

    monkeypatch.setattr(training.PPO, "train", diverge)
    for steps in (1280, 2048):  # at the end of the training, and before
        with pytest.raises(ValueError, match="not finite"):
            train("swim", resume=folder, changes={"timesteps": steps})
    assert (folder / "model.zip").read_bytes() == before


def test_a_full_disk_does_not_end_the_training(tmp_path, monkeypatch, capsys):
    """Checkpoints and rows of the curve that cannot be written are said once; the rows are written when they can be."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    monkeypatch.setattr(training, "Checkpoint", lambda path: callbacks.Checkpoint(path, seconds=0.0))
    replace_file, calls = os.replace, []

    def full_at_first(source, target):
        if tmp_path in Path(target).parents:  # kernels are stored elsewhere
            calls.append(Path(target).name)
            if 2 < len(calls) < 6:  # the configuration and the head of the curve are the first two
                raise OSError(errno.ENOSPC, "No space left on device")
        replace_file(source, target)

    monkeypatch.setattr(os, "replace", full_at_first)
    monkeypatch.setattr(callbacks.LearningCurve.__init__, "__defaults__", (1,))
    folder = train("swim", folder=tmp_path / "run", changes={"timesteps": 4096, "num_envs": 8})
    assert {"model.zip", "curve.csv"} <= set(calls[2:5])
    assert capsys.readouterr().out.count("could not be written (No space left on device)") == 2
    steps = [int(row["timesteps"]) for row in read_rows(folder / "curve.csv")]
    assert steps == sorted(set(steps)) and len(steps) > 3


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_events_that_cannot_be_written_do_not_end_the_training(tmp_path, monkeypatch, capfd):
    """TensorBoard's writing thread raises: it is said once, with the folder, and the run has all but the events."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    write, calls = record_writer.RecordWriter.write, []

    def full_later(self, data):
        calls.append(len(data))
        if len(calls) > 10:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(self, data)

    monkeypatch.setattr(record_writer.RecordWriter, "write", full_later)
    monkeypatch.setattr(callbacks.LearningCurve.__init__, "__defaults__", (1,))
    folder = train("swim", folder=tmp_path / "run", changes={"timesteps": 2048, "num_envs": 8})
    said = capfd.readouterr()
    assert said.out.count(f"{folder / 'tensorboard' / 'ppo_1'} could not be written (No space left on device)") == 1
    assert "Traceback" not in said.err
    assert (folder / "policy.npz").exists() and read_rows(folder / "curve.csv")[-1]["timesteps"] == "2048"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_disk_that_is_really_full_does_not_end_the_training(tmp_path, monkeypatch, capfd):
    """On a file system of 2 MB that is full for a while: a warning a file, and model, policy and curve at the end."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = shutil.which("mount") and subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if not mounted or mounted.returncode:
        pytest.skip("file systems cannot be mounted here")
    monkeypatch.setattr(training, "report", lambda *args: None)
    monkeypatch.setattr(training, "Checkpoint", lambda path: callbacks.Checkpoint(path, seconds=0.0))
    monkeypatch.setattr(callbacks.LearningCurve.__init__, "__defaults__", (1,))
    update, updates = training.PPO.train, []

    def fill_and_clear(self):
        update(self)
        updates.append(self.num_timesteps)
        if len(updates) == 2:
            with (disk / "big").open("wb", buffering=0) as file, pytest.raises(OSError, match="No space left"):
                while True:
                    file.write(bytes(4096))
        elif len(updates) == 6:
            (disk / "big").unlink()

    monkeypatch.setattr(training.PPO, "train", fill_and_clear)
    try:
        folder = train("swim", folder=disk / "run", changes={"timesteps": 2048, "num_envs": 8})
        said = capfd.readouterr()
        assert said.out.count("could not be written (No space left on device)") == 3 and "Traceback" not in said.err
        assert {"model.zip", "policy.npz", "config.json"} <= set(os.listdir(folder))
        assert [int(row["timesteps"]) for row in read_rows(folder / "curve.csv")] == updates
        with (disk / "big").open("wb", buffering=0) as file, pytest.raises(OSError, match="No space left"):
            while True:
                file.write(bytes(4096))
        with pytest.raises(ValueError, match=r"no file can be written in .*No space left"):
            train("swim", resume=folder, changes={"timesteps": 4096})
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_broken_or_longer_run_is_not_resumed(tmp_path, monkeypatch):
    """Half a model and fewer steps than the run has are errors, and what was counted and set before stays."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = train("swim", folder=tmp_path / "run")
    before = (folder / "config.json").read_bytes()
    with pytest.raises(ValueError, match="trained for 1,024 environment steps already"):
        train("swim", resume=folder, changes={"timesteps": 512})
    whole = (folder / "model.zip").read_bytes()
    (folder / "model.zip").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"model.zip cannot be read"):
        train("swim", resume=folder, changes={"timesteps": 2048})
    assert (folder / "config.json").read_bytes() == before


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    """The folder of a short run that must not be changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "report", lambda *args: None)
        return train("swim", folder=tmp_path_factory.mktemp("run") / "run")


def changed_record(**changes):
    """A function that changes what is in config.json; None takes a field away."""

    def change(folder):
        path = folder / "config.json"
        record = json.loads(path.read_text())
        record["config"] |= changes.pop("config", {})
        path.write_text(json.dumps({k: v for k, v in (record | changes).items() if v is not None}))

    return change


def written(name, text):
    """A function that writes a text file."""
    return lambda folder: (folder / name).write_text(text)


def cut(name):
    """A function that cuts a text file in half, with its last row."""
    return lambda folder: (folder / name).write_text((folder / name).read_text()[:-8])


def with_model(change):
    """A function that saves another model in model.zip."""

    def save(folder):
        model = training.PPO.load(folder / "model.zip", device="cpu")
        change(model)
        model.save(folder / "model.zip")

    return save


def of_other_names(model):
    """A layer of the policy has another name."""
    model.policy.other_net = model.policy.action_net
    del model.policy.action_net


BROKEN = {
    "empty object": (written("config.json", "{}"), r"config.json cannot be used \(it has no 'task'\); restore"),
    "list": (written("config.json", "[]"), r"config.json cannot be used \(it holds \[\], not an object\)"),
    "half": (cut("config.json"), r"config.json cannot be used \(.*(delimiter|Expecting|Unterminated)"),
    "no seed": (changed_record(seed=None), r"config.json cannot be used \(it has no 'seed'\)"),
    "no commit": (changed_record(commit=None), r"config.json cannot be used \(it has no 'commit'\)"),
    "seed": (changed_record(seed="0"), r"config.json cannot be used \('seed' is '0'\)"),
    "fish": (
        changed_record(config={"num_envs": "8"}),
        r"config.json .*num_envs is '8'; give whole numbers, at least 1",
    ),
    "rate": (changed_record(config={"learning_rate": "fast"}), r"config.json .*learning_rate is 'fast'; give a finite"),
    "layers": (
        changed_record(config={"hidden": [64, "x"]}),
        r"config.json .*hidden is \(64, 'x'\); give whole",
    ),
    "setting": (changed_record(config={"speed": 1}), r"config.json .*not those of this version"),
    "other environment": (
        changed_record(task="turn"),
        r"'FishEnv/Swim-v0' is not that of a task 'turn' here\); restore",
    ),
    "other task": (
        changed_record(task="turn", config={"env_id": "FishEnv/Turn-v0"}),
        "is a run of task 'turn', not 'swim'",
    ),
    "names": (
        with_model(of_other_names),
        r"model.zip cannot be read \(ValueError: its tensors .* missing: .'action_net",
    ),
    "row": (
        cut("curve.csv"),
        r"line \d of .*curve.csv is '1024,.*', not timesteps,.*return; delete",
    ),
    "head": (written("curve.csv", "steps\n"), r"line 1 of .*curve.csv is 'steps', not timesteps"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_run_whose_files_are_broken_is_not_resumed(name, short_run, tmp_path):
    """Each file that cannot be used is an error that names it, and no file of the run is changed."""
    folder = tmp_path / "run"
    shutil.copytree(short_run, folder)
    damage, message = BROKEN[name]
    damage(folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=message):
        train("swim", resume=folder, changes={"timesteps": 2048})
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    if name not in ("row", "head"):
        with pytest.raises(ValueError, match=message):
            train("swim", start=folder, root=tmp_path / "new")
        assert not (tmp_path / "new").exists()


def test_a_run_of_other_versions_is_resumed_with_a_warning(short_run, tmp_path, monkeypatch, capsys):
    """What is installed now differs: it is said, the model of before is kept, and the record has both versions."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = tmp_path / "run"
    shutil.copytree(short_run, folder)
    record = json.loads((folder / "config.json").read_text())
    installed = record["versions"]["fish_env"]
    changed_record(versions=record["versions"] | {"fish_env": "0.0.1"})(folder)
    before = (folder / "model.zip").read_bytes()
    train("swim", resume=folder, changes={"timesteps": 2048})
    said = capsys.readouterr().out
    assert f"Warning: the run was trained with fish_env 0.0.1 (now {installed}). Training continues" in said
    assert (folder / "model_before_1.zip").read_bytes() == before != (folder / "model.zip").read_bytes()
    assert json.loads((folder / "config.json").read_text())["versions"]["fish_env"] == f"0.0.1, {installed}"
    train("swim", resume=folder, changes={"timesteps": 3072})
    assert "Warning" not in capsys.readouterr().out and not (folder / "model_before_2.zip").exists()


def test_short_training_learns(tmp_path, monkeypatch):
    """A short PPO run swims faster than it did before, on the evaluation seeds."""
    config = CONFIGS["swim"]
    env = make_eval_env(config.env_id, 8, config.env_options)
    before = evaluate(policy_controller(report.untrained_policy(config, 0), env), env)["speed"].mean()
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = train("swim", root=tmp_path, changes={"timesteps": 100_000, "num_envs": 64})
    after = evaluate(policy_controller(load_policy(folder / "policy.npz"), env), env)["speed"].mean()
    assert after > before + 0.1


def test_zoo_file_agrees_with_the_settings():
    """agents/rl_zoo3.yml has the settings of CONFIGS, for as many environment steps an update."""
    zoo = yaml.safe_load((ROOT / "agents" / "rl_zoo3.yml").read_text())
    assert set(zoo) == {config.env_id for config in CONFIGS.values()}
    for task in fish_env.TASKS:
        config = CONFIGS[task]
        given = zoo[config.env_id]
        update = given["n_envs"] * given["n_steps"]
        assert update == config.num_envs * config.rollout
        assert given["n_timesteps"] % update == 0 and given["n_timesteps"] == pytest.approx(
            config.timesteps, abs=update
        )
        assert given["gamma"] == pytest.approx(
            config.discount(config.env_options.get("control_interval", 0.02)), abs=1e-4
        )
        wanted = (config.batch_size, config.epochs, config.gae_lambda, config.clip_range, config.entropy_weight)
        assert tuple(given[k] for k in ("batch_size", "n_epochs", "gae_lambda", "clip_range", "ent_coef")) == wanted
        assert given["learning_rate"] == f"lin_{config.learning_rate:.0e}".replace("e-0", "e-")
        assert given["policy_kwargs"] == {"net_arch": list(config.hidden), "log_std_init": config.initial_log_std}
        assert given.get("env_kwargs", {}) == config.env_options
