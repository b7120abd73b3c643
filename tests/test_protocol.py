"""The protocol by which learners are compared: trials, files that are checked, scores, and the table."""

import json
import re

import numpy as np
import pytest

from fish_env.__main__ import main
from fish_env.control import EPISODES, FIRST_SEED, load_policy, protocols
from fish_env.control.statistics import interquartile_mean

pytest.importorskip("stable_baselines3", reason='needs pip install -e ".[train]"')

from fish_env.training import benchmark as runner

CALLS = []


def still(trial):
    """A learner that learns nothing."""
    CALLS.append((trial.task, trial.level, trial.steps, trial.seed))
    return lambda obs, time: np.full((len(obs), 12), -1.0)


def stopped(trial):
    """A learner that is interrupted in its second trial."""
    if trial.seed:
        raise KeyboardInterrupt
    return still(trial)


class Greedy:
    """A model that took more steps than it was allowed."""

    num_timesteps = 1_000_000


def greedy_function(trial):
    """A learner that took more steps than it was allowed, and returns no model."""
    trial.curve.num_timesteps = 20_000
    return still(trial)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder, few episodes, and this module as that of the learner."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runner, "EPISODES", 4)
    monkeypatch.setattr(protocols, "HELD_OUT_EPISODES", 2)
    CALLS.clear()
    return tmp_path


SHORT = ["--tasks", "swim", "--levels", "easy", "medium", "--steps", "300"]


def test_a_learner_of_ones_own(here, capsys):
    """A file gives the rows of the table; trials that the file has are not run again; others are added to it."""
    words = ["benchmark", "test_protocol:still", *SHORT, "--save", "mine.json", "--seeds"]
    assert main([*words, "0"]) == 0
    assert CALLS == [("swim", "easy", 300, 0), ("swim", "medium", 300, 0)]
    assert main([*words, "0", "1", "1"]) == 0  # a seed that is named twice is run once
    assert CALLS[2:] == [("swim", "easy", 300, 1), ("swim", "medium", 300, 1)]
    capsys.readouterr()
    assert main(["benchmark", "mine.json"]) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2 and "score" in head and "test_protocol:still" in rows[0]
    found = runner.read_result("mine.json")
    row = runner.score_rows(found)[0]
    known = protocols.references()["swim"]["easy"]
    mean = interquartile_mean(np.array([np.mean(run["returns"]) for run in found["runs"] if run["level"] == "easy"]))
    assert row["score"] == pytest.approx((mean - known["random"]) / (known["reference"] - known["random"]), abs=1e-3)
    assert row["low"] <= row["score"] <= row["high"] and row["seeds"] == 2


def test_ctrl_c_keeps_the_trials(here, capsys):
    """The file has what was finished, and it is said how to go on."""
    with pytest.raises(KeyboardInterrupt):
        runner.benchmark("test_protocol:stopped", "mine.json", ["swim"], ["easy"], [300], [0, 1])
    assert "the same command goes on" in capsys.readouterr().out
    assert len(runner.read_result("mine.json")["runs"]) == 1


def another_process(trial):
    """A learner that another process runs for another seed meanwhile."""
    if not trial.seed:
        runner.benchmark("test_protocol:another_process", "mine.json", ["swim"], ["easy"], [300], [1])
    return still(trial)


def test_two_processes_share_a_file(here):
    """Trials that another process has added meanwhile are kept."""
    runner.benchmark("test_protocol:another_process", "mine.json", ["swim"], ["easy"], [300], [0])
    assert sorted(run["seed"] for run in runner.read_result("mine.json")["runs"]) == [0, 1]


def test_package_ppo(here):
    """The package's own PPO learns from a trial, with a curve within its budget, and its seed decides all."""
    one, other = (runner.run_trial(runner.ppo, "turn", "hard", 8192, seed) for seed in (0, 0))
    assert {**one, "processor_seconds": 0} == {**other, "processor_seconds": 0}
    assert len(one["returns"]) == 4 and not one["failed"]
    assert one["curve"] and all(0 < trained <= 8192 for trained, *_ in one["curve"])


def test_levels_and_references():
    """Every level can be made and differs from the next; in the table random actions have 0, the best known 1."""
    learners = pytest.importorskip("benchmarks.learning.learners")
    table = learners.read_table(learners.TABLE)
    for task, (id, metric) in protocols.TASKS.items():
        options = [protocols.level_options(task, level) for level in protocols.LEVELS]
        assert options[0] == {} and options[1] != options[2]
        for level, each in zip(protocols.LEVELS, options, strict=True):
            env = protocols.make_eval_env(id, 2, each)
            env.reset(seed=0)
            assert np.isfinite(env.step(env.action_space.sample())[0]).all()
            assert metric in env.unwrapped.episode_info(0)
            by, *steps = protocols.references()[task][level]["by"].removesuffix(" steps").split(", ")
            rows = learners.select(table, task=task, level=level)
            scores = {(row["learner"], row["steps"]): row["score"] for row in rows}
            best = scores[by, int("".join(steps).replace(",", "") or 0)]
            assert scores["random", 0] == 0.0 and (best == 1.0 or (best > 0.5 and steps))  # of a learner, its best seed
            env.close()
    names = {condition.name for condition in protocols.HELD_OUT}
    assert names >= set(protocols.HELD_OUT_NAMES)


def test_options_of_a_trial_are_its_own():
    """What a learner changes in them changes neither another trial nor the evaluation."""
    trial, before = runner.Trial("swim", "medium", 300, 0, runner.Curve(300, "speed")), protocols.TRAINING["variation"]
    trial.options["variation"].clear()
    assert before and trial.options == protocols.level_options("swim", "medium") and trial.options["variation"]


def test_policy_that_is_shipped(here):
    """The score of the shipped Swim policy is near 1 where it was trained; under other conditions it is smaller."""
    found = runner.measure(lambda env: load_policy("swim"), "swim", "easy")
    score, held_out = (protocols.normalised_score("swim", "easy", value)
                       for value in (np.mean(found["returns"]), found["held_out"]))  # fmt: skip
    assert 0.9 < score < 1.1 and 0.2 < held_out < score


MISTAKES = {
    "no JSON": ("{", "no result"),
    "an array": ("[1]", "no result"),
    "another version": ({"protocol": 0}, "version 0"),
    "no learner": ({"learner": None}, "no learner"),
    "a trial twice": ({"twice": True}, "twice"),
    "an unknown task": ({"task": "swimm"}, "swim"),
    "a return too few": ({"returns": [0.0] * 3}, "give 4"),
    "a return that is not finite": ({"returns": [float("nan")] * 4}, "not finite"),
    "no time": ({"processor_seconds": None}, "no result"),
    "no trial": ({"runs": []}, "none"),
    "steps that are a text": ({"steps": "many"}, "whole"),
    "a curve of pairs": ({"curve": [[1, 2]]}, "three"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_damaged_files(here, mistake, capsys):
    """A file that is no result is refused by one line, which says why."""
    change, said = MISTAKES[mistake]
    run = {"task": "swim", "level": "easy", "steps": 300, "seed": 0, "returns": [0.0] * 4, "metrics": [None] * 4,
           "failed": 0.0, "held_out": 0.0, "processor_seconds": 1.0, "curve": []}  # fmt: skip
    good = {"protocol": 1, "learner": "mine:learn", "versions": {}, "runs": [run]}
    (here / "mine.json").write_text(json.dumps(good))
    assert runner.read_result("mine.json") == good
    if isinstance(change, dict):
        runs = [run | {key: value for key, value in change.items() if key in run}] * (2 if "twice" in change else 1)
        change = json.dumps(good | {"runs": runs} | {key: change[key] for key in change if key in good})
    (here / "mine.json").write_text(change)
    assert main(["benchmark", "mine.json"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_mistakes_of_the_command(here, capsys):
    """Each is answered before anything is trained."""
    runner.benchmark("test_protocol:still", "mine.json", ["swim"], ["easy"], [300], [0])
    CALLS.clear()
    for words, said in (
        (["nothing:learn"], "cannot be imported"), (["test_protocol"], "module:function"),
        (["test_protocol:CALLS"], "module:function"), (["test_protocol:still", "--tasks", "swimm"], "did you mean"),
        (["test_protocol:still", "--levels", "esy"], "easy"), (["test_protocol:still", "--steps", "0"], "steps"),
        (["test_protocol:still", "--seeds", "-1"], "seed is -1"),
        (["test_protocol:still", "--seeds", "200000"], "less than 100000"),
        (["test_protocol:stopped", "--save", "mine.json"], "is of the learner test_protocol:still"),
        (["none.json"], "none.json"), (["ppo", "--save", "mine.txt"], ".json"),
        (["mine.json", "--tasks", "swim"], "leave out"), (["test_protocol:nothing"], "module:function"),
    ):  # fmt: skip
        assert main(["benchmark", *words]) == 2, words
        assert said in capsys.readouterr().err, words
    assert not CALLS
    with pytest.raises(ValueError, match="1,000,000 environment steps, and the budget is 300"):
        runner.run_trial(lambda trial: Greedy(), "swim", "easy", 300, 0)
    with pytest.raises(ValueError, match="20,000 environment steps, and the budget is 300"):
        runner.run_trial(greedy_function, "swim", "easy", 300, 0)


def test_rows_are_added_to_the_table(monkeypatch, tmp_path):
    """New rows are put after the others, and replace those of the same trial; curves too."""
    learners = pytest.importorskip("benchmarks.learning.learners")
    monkeypatch.setattr("benchmarks.common.tables.RESULTS", tmp_path)
    run = {"task": "swim", "level": "easy", "steps": 300, "seed": 0, "metrics": [1.0] * 4, "failed": 0.0,
           "held_out": 0.0, "processor_seconds": 1.0, "curve": [[100, 1.0, None]]}  # fmt: skip
    for learner, total in (("one", 1.0), ("other", 2.0), ("one", 3.0)):
        learners.add([{"learner": learner, "runs": [run | {"returns": [total] * 4}]}], "a test")
    rows = learners.read_table(learners.TABLE)
    assert [(row["learner"], row["return"]) for row in rows] == [("other", 2.0), ("one", 3.0)]
    assert len(learners.read_table(learners.CURVES)) == 2


def test_page():
    """The table follows from the CSV, and the protocol is told as it is."""
    learners = pytest.importorskip("benchmarks.learning.learners")
    text = learners.PAGE.read_text("utf-8")
    assert learners.table() in text
    for said in (
        f"version {protocols.VERSION}", f"{EPISODES} episodes, seeds from {FIRST_SEED:,}", "0 to 4 of the learner",
        f"{protocols.HELD_OUT_EPISODES} episodes, seeds from {protocols.FIRST_SEED:,}", "in each of seven conditions",
        "trains from seed *s* + *i*", "100,000 and 1 million steps",
        *(id.removeprefix("FishEnv/").removesuffix("-v0") for id, _ in protocols.TASKS.values()),
    ):  # fmt: skip
        assert said in text, said
    assert protocols.SEEDS == (0, 1, 2, 3, 4) and protocols.BUDGETS == (100_000, 1_000_000)
    for name in protocols.HELD_OUT_NAMES:
        what, value = name.split()
        assert len(protocols.HELD_OUT_NAMES) == 7 and re.search(rf"{what}\b[^,]*{value}", text), name


def test_learners_of_the_table():
    """The settings of every learner of the table name its tasks, in the format of RL Baselines3 Zoo."""
    pytest.importorskip("sb3_contrib")
    pytest.importorskip("yaml")
    learners, published = (pytest.importorskip(name) for name in ("agents.learners", "benchmarks.learning.learners"))
    for name, tasks, levels, budgets in published.TRIALS:
        assert callable(runner.find_learner(name)) and set(levels) <= set(protocols.LEVELS)
        if name != "ppo":
            for task in tasks:
                trial = runner.Trial(task, levels[0], budgets[0], 0, runner.Curve(1, "speed"))
                assert learners.settings(name.partition(":")[2], trial)["n_timesteps"] == budgets[0]


@pytest.mark.parametrize("name", ["sac", "tqc", "recurrent_ppo"])
def test_learners_train(name, here):
    """Each trains a little, and commands all muscles."""
    pytest.importorskip("sb3_contrib")
    pytest.importorskip("yaml")
    learner = runner.find_learner(f"agents.learners:{name}")
    found = runner.run_trial(learner, "left_after_right", "easy", 2048 + 64, 0)
    assert np.isfinite(found["returns"]).all() and np.isfinite(found["held_out"])
