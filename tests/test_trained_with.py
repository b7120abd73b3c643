"""What a policy was trained with goes with it: its interval, its muscles, its episodes; and what failed is said."""

import json
from contextlib import closing
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor, VecNormalize
from trainings import train_short

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import as_controller, compare, evaluate, load_policy, make_eval_env, make_policy_env, record
from fish_env.control.equivariant import export_policy
from fish_env.training import report

SWIM, SLOW = "FishEnv/Swim-v0", {"control_interval": 0.04, "max_episode_steps": 50}


@pytest.fixture
def registered():
    """Registers Swim-v0 with other keywords, and forgets it."""
    made = []

    def register(**keywords):
        made.append(f"Registered/Swim{len(made)}-v0")
        swim = gym.spec(SWIM)
        gym.register(made[-1], swim.entry_point, vector_entry_point=swim.vector_entry_point, max_episode_steps=100,
                     kwargs=swim.kwargs | keywords)  # fmt: skip
        return made[-1]

    yield register
    for id in made:
        del gym.registry[id]


def model_of(env, **settings):
    """A learner with actions of all sizes, without training."""
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu", seed=0, **settings)
    model.policy.action_net.weight.data *= 30.0
    return model


def single(*wrappers, id=SWIM, **options):
    """A maker of one fish of `gym.make` in wrappers."""

    def make():
        env = gym.make(id, **options)
        for wrap in wrappers:
            env = wrap(env)
        return env

    return make


SOURCES = {
    "batch": lambda id, options: fish_env.make_sb3_vec_env(id, 2, **options),
    "normalised": lambda id, options: VecNormalize(fish_env.make_sb3_vec_env(id, 2, **options)),
    "one by one": lambda id, options: DummyVecEnv([single(id=id, **options)]),
    "watched": lambda id, options: VecMonitor(
        DummyVecEnv(
            [single(Monitor, gym.wrappers.RecordEpisodeStatistics, gym.wrappers.NormalizeReward, id=id, **options)]
        )
    ),
    "processes": lambda id, options: SubprocVecEnv([single(Monitor, id=id, **options)], "fork"),
}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("given", ["keyword", "registration"])
def test_a_policy_and_its_model_keep_their_interval(given, source, registered, tmp_path):
    """Wherever the training had it from: in shorter steps both move the fish as in those of their training."""
    id, options = (SWIM, SLOW) if given == "keyword" else (registered(**{"control_interval": 0.04}), {})
    with closing(SOURCES[source](id, options)) as env:
        model = model_of(env)
        export_policy(model, {"env_id": SWIM}).save(tmp_path / "policy.npz")
        policy = load_policy(tmp_path / "policy.npz")
        assert policy.about["trained"]["control_interval"] == 0.04
        for late in (0, 1):
            places = [
                [places_of(act, interval, steps * late) for interval, steps in ((0.04, 1), (0.02, 2))]
                for act in (model, policy)
            ]
            moved = np.abs(places[0][0][-1] - places[0][0][0]).max()
            assert moved > 0.001
            for slow, fast in places:
                np.testing.assert_allclose(fast[1::2], slow, rtol=0, atol=2e-3 * moved)
            np.testing.assert_allclose(places[0][1], places[1][1], rtol=0, atol=2e-3 * moved)
        with pytest.raises(ValueError, match=r"acts every 0.04 s, the environment every 0.03 s"):
            evaluate(make_eval_env(SWIM, 1, {"control_interval": 0.03}), model)


def places_of(policy, interval, delay):
    """Positions after each step of half a second."""
    options = {"control_interval": interval, "action_delay": delay, "variation": {"strength": 0.8}}
    with closing(make_eval_env(SWIM, 2, options)) as env:
        act, (obs, _), seen = as_controller(policy, env), env.reset(seed=3), []
        while env.tank.time[0] < 0.48 - 1e-9:
            obs, *_ = env.step(np.clip(act(obs, float(env.tank.time[0])), -1, 1))
            seen.append(env.tank.position.copy())
        return seen


def test_muscle_groups_are_those_of_the_training():
    """Others are refused by their name, also if there are as many."""
    pairs = {"muscle_groups": "pairs"}
    many, few = (model_of(fish_env.make_sb3_vec_env(SWIM, 2, **options)) for options in ({}, pairs))
    for model, options, name in ((many, pairs, "muscles"), (few, {}, "pairs")):
        for act in (model, export_policy(model, {"env_id": SWIM})):
            with pytest.raises(ValueError, match=f"give it muscle_groups='{name}'"):
                evaluate(make_eval_env(SWIM, 1, options), act)
    policy = export_policy(many, {"env_id": SWIM})
    about = policy.about | {"trained": policy.about["trained"] | pairs}
    with pytest.raises(ValueError, match="give it muscle_groups='pairs'"):
        evaluate(make_eval_env(SWIM, 1, {}), replace(policy, about=about))
    for bad in ([], {"control_interval": 0.04}, about["trained"] | {"control_interval": -1.0}):
        with pytest.raises(ValueError, match=r"trained is|control_interval is"):
            make_policy_env(replace(policy, about={"env_id": SWIM, "trained": bad}), 1)


class Reversed(gym.Wrapper):
    """Actions the other way round."""

    def step(self, action):
        return self.env.step(-action)


class Mine(DummyVecEnv):
    """May do anything."""


CHANGED = {
    "reversed": lambda: DummyVecEnv([single(), single(Reversed)]),
    "watched": lambda: DummyVecEnv([single(Reversed, Monitor)]),
    "in processes": lambda: SubprocVecEnv([single(Reversed, Monitor)], "fork"),
    "skipped": lambda: DummyVecEnv([single(lambda env: gym.wrappers.MaxAndSkipObservation(env, 2))]),
    "a batch": lambda: Mine([single()]),
}


@pytest.mark.parametrize("name", CHANGED)
def test_what_a_wrapper_may_have_changed_is_refused(name):
    """A wrapper that is not known to watch only: in an export, in an evaluation, and round a recorded fish."""
    with closing(CHANGED[name]()) as env:
        model = model_of(env)
        for call in (export_policy, lambda *given: evaluate(make_eval_env(SWIM, 1, {}), model)):
            with pytest.raises(ValueError, match=r"has a (Reversed|MaxAndSkipObservation|Mine), which may change"):
                call(model, {})
        if isinstance(env, DummyVecEnv) and name != "a batch":
            with pytest.raises(ValueError, match=r"has a wrapper (Reversed|MaxAndSkipObservation)"):
                record(env.envs[-1], "swim")


INTERVALS = {"keyword": (0.01, 0.03, 0.04), "registration": (0.01, 0.03, 0.04), "both": (0.04,)}


@pytest.mark.parametrize(("given", "interval"), [(given, one) for given, each in INTERVALS.items() for one in each])
def test_a_training_of_any_interval_ends_in_its_report(given, interval, registered, tmp_path, monkeypatch):
    """It is evaluated in steps of the fish's own where its own are whole multiples of these, else in its own."""
    monkeypatch.setattr(report, "EPISODES", 2)
    option = {"control_interval": interval}
    id = registered(**({} if given == "keyword" else option if given == "registration" else {"control_interval": 0.03}))
    changes = {"timesteps": 64, "num_envs": 2, "rollout": 16, "batch_size": 16, "hidden": (8,)}
    folder = train_short(id, 0, changes, True, root=tmp_path, env_options={} if given == "registration" else option)
    assert json.loads((folder / "results.json").read_text())["rows"]["trained policy"]["failed"] == 0.0
    with closing(make_policy_env(load_policy(folder / "policy.npz"), 1)) as env:
        plain = given == "keyword" and interval == 0.04
        assert env.control_interval == (0.02 if plain else interval) and env.max_episode_steps == 100


def test_policies_meet_the_same_episodes(tmp_path, capsys):
    """Other options are refused by name unless one is given; what a policy sees may differ. The heading says it all."""
    swim = load_policy("swim")
    drag, remembers = (
        replace(swim, about=swim.about | {"env_options": options})
        for options in ({"water": "drag"}, {"history": 0, "max_episode_steps": 20, "body": "mass_spring"})
    )
    with pytest.raises(ValueError, match=r'differ in water \(null and "drag"\); give env, or .* a keyword'):
        compare(swim, drag)
    same = compare(swim, drag, water="drag", max_episode_steps=20)
    assert same["return"].difference == (0.0, 0.0, 0.0)
    compare(swim, remembers, max_episode_steps=20)
    with pytest.raises(ValueError, match="an environment is given, and water too"):
        compare(swim, drag, make_policy_env(swim, 1), water="drag")
    swim.save(tmp_path / "swim.npz")
    drag.save(tmp_path / "drag.npz")
    files = [str(tmp_path / "swim.npz"), str(tmp_path / "drag.npz")]
    assert command_line.main(["compare", *files]) == 2 and "by --env-kwargs" in capsys.readouterr().err
    short = ["--env-kwargs", "max_episode_steps=3"]
    assert command_line.main(["compare", *files, *short, "water=drag"]) == 0
    assert f"{SWIM} with max_episode_steps=3, water='drag': mean" in capsys.readouterr().out
    assert command_line.main(["evaluate", *files, *short, "--episodes", "2"]) == 0
    printed = capsys.readouterr().out
    assert f"{files[0]}: max_episode_steps=3" in printed and f"{files[1]}: max_episode_steps=3, water='drag'" in printed


def test_failing_episodes_are_said(tmp_path, capsys):
    """Where more than half of the episodes fail, an evaluation and a training say why, and what to do."""
    diverging, said = {"integrator": "rk4", "dt": 0.001}, r"3 of 3 episodes failed \(.+\); give a dt smaller than 0.001"
    with pytest.warns(UserWarning, match=said):
        evaluate(make_policy_env("swim", 3, **diverging), "swim")
    words = ["evaluate", "swim", "--integrator", "rk4", "--dt", "0.001", "--episodes", "3"]
    assert command_line.main(words) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.startswith("fish_env: 3 of 3 episodes failed (") for line in lines] == [False, True]  # first, the step
    train_short(changes={"timesteps": 1024, "num_envs": 8}, root=tmp_path, **diverging)
    assert capsys.readouterr().out.count("episodes failed (") == 1


def test_a_model_is_no_policy_file():
    """It says what to do with it."""
    with pytest.raises(ValueError, match=r"m.zip is a Stable-Baselines3 model: load it and pass it"):
        evaluate(make_eval_env(SWIM, 1, {}), "m.zip")
