"""Training, its files and its commands: a run can be trusted, and what is not a policy is refused."""

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from scipy import stats

import fish_env
from agents import integrators, records, report, results, train_all
from agents import train as training
from agents.build import Tanh, export_policy, make_env, make_model
from agents.config import CONFIGS, RESULTS, settings_of
from agents.controllers import Gait, best_gait
from agents.evaluate import evaluate, gait_controller, make_eval_env, measuring, policy_controller
from agents.mirror import mirror_of
from agents.policy import Policy, load_policy
from agents.synergy import synergies
from fish_env.envs import FishVectorEnv

ROOT = Path(__file__).parent.parent
SHORT = {"timesteps": 1024, "num_envs": 8}


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch):
    """Reports of a few episodes only."""
    monkeypatch.setattr(report, "EPISODES", 3)


@pytest.fixture
def policy():
    """A small policy of no particular use."""
    rng = np.random.default_rng(0)
    sizes = (156, 8, 6)
    weights = [rng.normal(size=pair).astype(np.float32) for pair in pairwise(sizes)]
    return Policy(tuple(weights), tuple(np.zeros(n, np.float32) for n in sizes[1:]), {"env_id": "FishEnv/Swim-v0"})


def test_policy_file_round_trip(policy, tmp_path):
    """A policy read back from its file acts the same, bit for bit."""
    policy.save(tmp_path / "policy.npz")
    obs = np.random.default_rng(1).normal(size=(5, 156))
    np.testing.assert_array_equal(load_policy(tmp_path / "policy.npz", "FishEnv/Swim-v0")(obs), policy(obs))


def test_bad_policy_files_are_refused(policy, tmp_path):
    """Missing, truncated, pickled, foreign, ill-fitting and non-finite files are refused with a reason."""
    good = tmp_path / "good.npz"
    policy.save(good)

    def refused(content, message, error=ValueError):
        path = tmp_path / "bad.npz"
        path.unlink(missing_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content is not None:
            np.savez(path, **content)
        with pytest.raises(error, match=message):
            load_policy(path, "FishEnv/Swim-v0")

    refused(None, "no policy file", FileNotFoundError)
    refused(good.read_bytes()[:-200], "not a policy file, or is damaged or pickled")
    refused(b"", "not a policy file")
    refused(b"hello", "not a policy file")
    whole = dict(np.load(good))
    refused(whole | {"weight0": np.array([{"pickled": 1}], dtype=object)}, "damaged or pickled")
    refused({key: value for key, value in whole.items() if key != "bias1"}, "not a policy file")
    refused(whole | {"format": 99}, "format 99")
    refused(whole | {"weight1": whole["weight1"][:-1]}, "do not fit together")
    refused(whole | {"bias1": whole["bias1"] * np.nan}, "not finite")
    refused(whole | {"about": json.dumps({"env_id": "FishEnv/Other-v0"})}, "trained for FishEnv/Other-v0")
    refused(whole | {"about": "{}"}, "does not say which environment it is for")


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
    place, sign, swap = mirror_of(env.unwrapped.fish)
    mirrored = policy((obs[:, place] * sign).astype(np.float32))
    assert np.allclose(mirrored, policy(obs)[:, swap], atol=2e-5) == symmetric
    assert np.abs(policy(obs) - policy(obs)[:, swap]).max() > 0.05


@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_a_slower_policy_moves_the_same_when_seen_more_often(groups):
    """A policy for decisions every 40 ms swims alike in an environment of such decisions and, carried on, of 20 ms."""
    options = {"muscle_groups": groups, "control_interval": 0.04, "max_episode_steps": 125}
    config = replace(CONFIGS["turn"], env_options=options, training_options={})
    model = make_model(config, make_env(config, 2, seed=0), seed=0)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.4 * torch.randn_like(parameter))
    policy = export_policy(model, {"env_options": options})
    slow, fast = (make_eval_env(config.env_id, 2, chosen) for chosen in (options, measuring(options)))
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
    with pytest.raises(ValueError, match=r"decides every 0.04 s, the environment every 0.03"):
        policy_controller(policy, make_eval_env(config.env_id, 1, {"muscle_groups": groups, "control_interval": 0.03}))


def test_tanh_is_tanh():
    """The quick one is torch's to rounding, and so is its gradient."""
    x = torch.linspace(-30.0, 30.0, 6001, requires_grad=True)
    quick, slow = Tanh()(x), torch.tanh(x)
    weights = torch.linspace(0.5, 2.0, 6001)
    gradients = [torch.autograd.grad((y * weights).sum(), x)[0] for y in (quick, slow)]
    assert (quick - slow).abs().max() < 3e-7
    assert (gradients[0] - gradients[1]).abs().max() < 2e-6
    assert torch.autograd.gradcheck(Tanh(), torch.randn(7, dtype=torch.float64, requires_grad=True))


def test_mirror_is_the_fish_seen_in_a_mirror():
    """Observations of a mirrored fish are the mirrored observations, and mirroring twice changes nothing."""
    env = FishVectorEnv(2, task="avoid")
    fish = env.tank.fish
    place, sign, swap = mirror_of(env)
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


def test_run_leaves_everything_behind(tmp_path, capsys):
    """A training run leaves model, policy, configuration, curve, pictures and video, and prints what to do next."""
    folder = training.train("swim", seed=3, root=tmp_path, **SHORT)
    for name in ("model.zip", "policy.npz", "config.json", "results.json", "curve.csv", "curve.png", "path.png"):
        assert (folder / name).stat().st_size > 0, name
    assert (folder / "swim.mp4").stat().st_size > 10_000
    assert list((folder / "tensorboard").rglob("events.*"))
    record = json.loads((folder / "config.json").read_text())
    assert record["seed"] == 3 and record["config"]["timesteps"] == 1024 and record["versions"]["torch"]
    printed = capsys.readouterr().out
    assert f"python train.py play {folder / 'policy.npz'}" in printed
    assert "best open-loop gait" in printed and "untrained policy" in printed


def test_same_seed_same_policy(tmp_path, monkeypatch):
    """Two runs with one seed give the same policy bits; another seed gives another policy."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    runs = [training.train("swim", seed=seed, root=tmp_path, **SHORT) for seed in (0, 0, 1)]
    one, same, other = (np.load(run / "policy.npz")["weight0"] for run in runs)
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_ctrl_c_keeps_what_was_learnt_and_resume_goes_on(tmp_path, monkeypatch, capsys):
    """Ctrl-C saves model and policy and says how to go on; --resume goes on from there to the end."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    interrupt = training.Progress._on_rollout_end

    def press(self):
        interrupt(self)
        if self.num_timesteps >= 512:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(training.Progress, "_on_rollout_end", press)
        folder = training.train("swim", root=tmp_path, **SHORT)
    printed = capsys.readouterr().out
    assert f"--resume {folder}" in printed and load_policy(folder / "policy.npz")
    assert training.train("swim", resume=folder) == folder
    model = training.PPO.load(folder / "model.zip", device="cpu")
    assert model.num_timesteps == 1024


def test_training_everything_can_be_stopped_and_goes_on(tmp_path, monkeypatch):
    """`train.py all` leaves finished runs alone, goes on with stopped ones, and publishes what all of them found."""
    monkeypatch.setattr(train_all, "CONFIGS", {"swim": replace(CONFIGS["swim"], **SHORT)})
    monkeypatch.setattr(train_all, "RESULTS", {"swim": replace(RESULTS["swim"], seeds=2)})
    started = []

    def ended():
        process = subprocess.Popen(["true"])
        process.wait()
        return process

    def start(self, processor):
        started.append((self.seed, (self.folder / "model.zip").exists()))
        resume = self.folder if started[-1][1] else None
        folder = None if resume else self.folder
        training.train("swim", self.seed, resume=resume, folder=folder, pictures=False, **SHORT)
        self.process = ended()

    monkeypatch.setattr(train_all.Job, "start", start)
    folders = train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert started == [(0, False), (1, False)] and all((run / "results.json").exists() for run in folders)
    before = (folders[0] / "policy.npz").read_bytes()
    (folders[1] / "results.json").unlink()
    train_all.train_all(tmp_path, ["swim"], jobs=1)
    assert started[2:] == [(1, True)] and (folders[0] / "policy.npz").read_bytes() == before
    job = train_all.Job("swim", 0, folders[0])
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


def test_a_folder_takes_one_run(tmp_path, monkeypatch):
    """A folder with a run in it, or in which another program trains, is left alone; the curve is cut to the model."""
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = training.train("swim", folder=tmp_path / "run", **SHORT)
    with pytest.raises(ValueError, match="holds a run; go on with"):
        training.train("swim", folder=folder, **SHORT)
    with training.locked(folder), pytest.raises(RuntimeError, match="another program is training"):
        training.train("swim", resume=folder, timesteps=2048)
    with (folder / "curve.csv").open("a") as file:
        file.write("999999,9.0,1,0.0,0.0\n")
    training.train("swim", resume=folder, timesteps=2048)
    steps = [int(row["timesteps"]) for row in results.read_rows(folder / "curve.csv")]
    assert steps == sorted(steps) and steps[-1] == 2048
    record = json.loads((folder / "config.json").read_text())
    assert record["resumed"] == 1 and settings_of(record["config"]) == replace(
        CONFIGS["swim"], num_envs=8, timesteps=2048
    )


def test_interquartile_mean_and_interval():
    """The interquartile mean is scipy's trimmed mean where a quarter is whole; the interval mostly holds the truth."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=12)
    assert results.interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))
    assert results.interquartile_mean(np.array([1.0, 2.0, np.nan])) == pytest.approx(1.5)
    held = 0
    for _ in range(40):
        levels = rng.normal(3.0, 0.5, 10)
        scores = [{"return": rng.normal(level, 1.0, 50)} for level in levels]
        value, low, high = results.interval(scores, "return", rng)
        assert low < value < high
        held += low < 3.0 < high
    assert held >= 32
    held = 0
    for _ in range(40):  # all seeds play the same episodes, some of which are hard for all
        hard, levels = rng.normal(0.0, 1.0, 50), rng.normal(3.0, 0.1, 5)
        scores = [{"return": level + hard + rng.normal(0.0, 0.3, 50)} for level in levels]
        _, low, high = results.interval(scores, "return", rng)
        held += low < 3.0 < high
    assert held >= 34


def test_publishing_fills_in_page_and_files(tmp_path, monkeypatch):
    """Publishing writes seeds, methods and curves, ships the median seed, and fills in the table of the page."""
    monkeypatch.setattr(results, "LEARNING", tmp_path / "learning")
    monkeypatch.setattr(records, "RESULTS", tmp_path)
    monkeypatch.setattr(results, "PRETRAINED", tmp_path / "pretrained")
    monkeypatch.setattr(results, "EPISODES", 4)
    monkeypatch.setattr(results, "RESAMPLES", 20)
    monkeypatch.setattr(results, "RESULTS", {"swim": replace(RESULTS["swim"], seeds=2)})
    page = tmp_path / "results.md"
    page.write_text("before <!-- swim --> old <!-- end --> after")
    monkeypatch.setattr(results, "PAGE", page)
    monkeypatch.setattr(results, "README", tmp_path / "README.md")
    results.README.write_text("<!-- summary -->\nold\n<!-- end -->")
    for seed in range(2):
        training.train("swim", seed, folder=tmp_path / "runs" / "swim" / f"seed_{seed}", pictures=False, **SHORT)
    results.publish(tmp_path / "runs", ["swim"])
    assert (
        "| PPO, 2 seeds |" in page.read_text() and "old" not in page.read_text() and page.read_text().endswith("after")
    )
    assert "[`Swim-v0`](docs/envs/swim.md)" in results.README.read_text() and "old" not in results.README.read_text()
    assert load_policy(tmp_path / "pretrained" / "swim" / "policy.npz")
    assert [row["seed"] for row in results.read_rows(tmp_path / "learning" / "swim_seeds.csv")] == ["0", "1"]
    with pytest.raises(FileNotFoundError, match=r"no run of swim in .* is finished"):
        results.publish(tmp_path / "nowhere", ["swim"])


def test_integrator_check_sees_a_difference(tmp_path, monkeypatch):
    """A policy replayed with the same method does the same; a coarse step shows in return and path."""
    path = ROOT / "agents" / "pretrained" / "swim" / "policy.npz"
    fine = integrators.replay(path, ("rk4", 0.00125, None), 3)
    assert integrators.differences(*fine, *fine)["path_difference"] == 0.0
    found = integrators.differences(*integrators.replay(path, ("semi_implicit", 0.00125, None), 3), *fine)
    assert found["failed"] == 0 and found["path_difference"] > 0.01
    fish = fish_env.make_fish()
    names = [name for name, _, _ in integrators.settings(fish)]
    assert (fish.integrator, fish.time_step, fish.refine) in integrators.settings(fish)
    fixed = {name for name, record in fish_env.INTEGRATORS.items() if record.kind != "adaptive"}
    assert names[0] == "rk4" and set(names) == fixed


def test_bad_training_requests_are_refused(tmp_path):
    """Unknown tasks, counts below one and folders that hold no run are refused."""
    with pytest.raises(ValueError, match="unknown task 'fly'"):
        training.train("fly", root=tmp_path)
    with pytest.raises(ValueError, match="num_envs is 0"):
        training.train("swim", root=tmp_path, num_envs=0)
    with pytest.raises(FileNotFoundError, match="to go on with"):
        training.train("swim", resume=tmp_path)


def test_gait_is_what_it_says():
    """Left and right contract exactly out of phase, within [0, amplitude], at the stated frequency."""
    fish, gait = fish_env.make_fish(), Gait(2.0, (0.3, 0.6, 1.0), (0.0, 1.0, 2.0))
    time = np.linspace(0, 1, 101)
    contraction = gait.contraction(fish, time)
    assert contraction.shape == (101, 12)
    amplitude = np.array(gait.amplitude)[fish.segments]
    assert (contraction >= 0).all() and (contraction <= amplitude).all()
    left, right = (contraction[:, fish.sides == side] for side in (1, -1))
    np.testing.assert_allclose(left + right, np.broadcast_to(amplitude[fish.sides == 1], left.shape), atol=1e-12)
    np.testing.assert_allclose(contraction, gait.contraction(fish, time + 0.5), atol=1e-12)
    for bad in ({"frequency": 0.0}, {"amplitude": (1.0, 1.0, 1.5)}, {"lag": (0.0, np.nan, 0.0)}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            replace(gait, **bad)


def test_gait_swims():
    """The best open-loop gait swims along its heading, and far better than random twitching."""
    env = make_eval_env("FishEnv/Swim-v0", 4, {"muscle_groups": "pairs"})
    gait = evaluate(gait_controller(best_gait(), env), env)
    rng = np.random.default_rng(0)
    twitching = evaluate(lambda obs, time: rng.uniform(-1, 1, env.action_space.shape), env)
    assert not gait["failed"].any() and not twitching["failed"].any()
    assert gait["speed"].min() > 1.0 and gait["speed"].min() > 3 * np.abs(twitching["speed"]).max()


def test_evaluation_is_repeatable():
    """Evaluating twice gives the same numbers."""
    env = make_eval_env("FishEnv/Swim-v0", 3, {"muscle_groups": "pairs"})
    one, other = (evaluate(gait_controller(best_gait(), env), env) for _ in range(2))
    np.testing.assert_array_equal(one["speed"], other["speed"])


def test_short_training_learns(tmp_path, monkeypatch):
    """A short PPO run swims faster than it did before, on the evaluation seeds."""
    config = CONFIGS["swim"]
    env = make_eval_env(config.env_id, 8, config.env_options)
    before = evaluate(policy_controller(report.untrained(config, 0), env), env)["speed"].mean()
    monkeypatch.setattr(training, "report", lambda *args: None)
    folder = training.train("swim", root=tmp_path, timesteps=100_000, num_envs=64)
    after = evaluate(policy_controller(load_policy(folder / "policy.npz"), env), env)["speed"].mean()
    assert after > before + 0.1


BARS = {
    "swim": {"speed": 2.2},
    "turn": {"success": 0.98},
    "left_after_right": {"success": 0.95},
    "target": {"targets": 9.5},
    "target_3d": {"success": 0.8},
    "avoid": {"avoided": 0.95},
}
"""What a shipped policy must reach on the mean of the evaluation episodes."""


@pytest.mark.parametrize("task", CONFIGS)
def test_shipped_policy_keeps_its_bar(task):
    """The policy shipped for every task does it well, on the evaluation seeds, and no physics fails."""
    path = ROOT / "agents" / "pretrained" / task / "policy.npz"
    assert path.stat().st_size < 300_000
    policy = load_policy(path, CONFIGS[task].env_id)
    env = make_eval_env(policy.about["env_id"], 100, measuring(policy.about["env_options"]))
    scores = evaluate(policy_controller(policy, env), env)
    assert not scores["failed"].any()
    for metric, bar in BARS[task].items():
        assert scores[metric].mean() >= bar


def test_zoo_file_agrees_with_the_settings():
    """agents/rl_zoo3.yml has the settings of CONFIGS, for as many decisions an update."""
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


def test_command_line(tmp_path):
    """`train.py` evaluates and plays a policy, and answers mistakes in one line without a traceback."""
    video = tmp_path / "swim.mp4"

    def run(*arguments):
        return subprocess.run(
            [sys.executable, "train.py", *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, check=False
        )

    for task in ("left_after_right", "target"):
        video.unlink(missing_ok=True)
        played = run("play", ROOT / "agents" / "pretrained" / task / "policy.npz", "--episodes", 1, "--video", video)
        assert played.returncode == 0 and video.stat().st_size > 10_000, played.stderr
        assert RESULTS[task].metrics[0] in played.stdout
    wrong = run("play", tmp_path / "none.npz")
    assert wrong.returncode == 2 and "no policy file" in wrong.stderr and "Traceback" not in wrong.stderr
    assert run("fly").returncode == 2


def test_policy_needs_only_numpy():
    """A policy file can be run without torch or Stable-Baselines3."""
    code = """import sys; from agents.policy import load_policy; import gymnasium as gym, fish_env
p = load_policy("agents/pretrained/swim/policy.npz"); e = gym.make(p.about["env_id"], **p.about["env_options"])
print(p(e.reset(seed=0)[0]).shape, {"torch", "stable_baselines3"} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "set()"
    assert gym.spec("FishEnv/Swim-v0")
