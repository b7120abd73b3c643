"""Keywords, options and states act in the same way on every path: however an environment was made and set.

Conditions of its tank, and keywords that are set while it runs, act as in a bare tank and as in an environment that was
made so, bit for bit, or are refused and change nothing.
"""

import copy
import functools
import itertools
import json
import pickle
import warnings
from contextlib import closing
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gliding import ID, GlidingEnv, GlidingVectorEnv
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from moving import tiered

from fish_env import Tank, make_sb3_vec_env
from fish_env import __main__ as command_line
from fish_env.control import (
    as_controller,
    compare,
    evaluate,
    export_policy,
    load_policy,
    make_eval_env,
    make_policy_env,
    record,
    replay,
)
from fish_env.envs import FishVectorEnv
from fish_env.envs.episode import Episodes
from fish_env.tasks.left_after_right import LeftAfterRightTask
from fish_env.tasks.options import keywords_of
from fish_env.training import report

vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from trainings import train_short

SWIM, STUB, TURNS = "FishEnv/Swim-v0", "FishEnv/Stub-v0", ID["left_after_right"]
REFUSED = (ValueError, AttributeError)


class Empty(gym.Wrapper):
    """A wrapper that does nothing."""


MAKERS = {
    "one": gym.make,
    "wrapped": lambda id, **options: Empty(gym.make(id, **options)),
    "Monitor": lambda id, **options: Monitor(gym.make(id, **options)),
    "copied": lambda id, **options: copy.deepcopy(gym.make(id, **options)),
    "batch": lambda id, **options: gym.make_vec(id, 2, **options),
    "wrapped batch": lambda id, **options: gym.wrappers.vector.RecordEpisodeStatistics(gym.make_vec(id, 2, **options)),
    "pickled": lambda id, **options: pickle.loads(pickle.dumps(gym.make_vec(id, 2, **options).unwrapped)),
    "SyncVectorEnv": lambda id, **options: SyncVectorEnv([lambda: gym.make(id, **options)] * 2),
    "SB3": lambda id, **options: make_sb3_vec_env(id, 2, monitor=False, **options),
    "SB3, monitored": lambda id, **options: make_sb3_vec_env(id, 2, **options),
    "DummyVecEnv": lambda id, **options: vec_env.DummyVecEnv([lambda: Monitor(gym.make(id, **options))] * 2),
}
"""Ways to make an environment of one or two fish."""


def fish_of(env) -> list[FishVectorEnv]:
    """The batches of fish within an environment."""
    while not isinstance(env, FishVectorEnv):
        if hasattr(env, "envs"):
            return [fish for each in env.envs for fish in fish_of(each)]
        env = next(getattr(env, name) for name in ("fish", "venv", "env", "unwrapped") if getattr(env, name, None))
    return [env]


def begin(env, seed):
    """Reset with a seed: observations and infos."""
    if isinstance(env, vec_env.VecEnv):
        env.seed(seed)
        return env.reset(), list(env.reset_infos)
    return env.reset(seed=seed)


def change(env, name, value):
    """Set an option in the way that an environment has for it."""
    if isinstance(env, vec_env.DummyVecEnv):
        env.env_method("set_wrapper_attr", name, value)
    elif isinstance(env, vec_env.VecEnv):
        env.set_attr(name, value)
    elif isinstance(env, gym.Env):
        env.set_wrapper_attr(name, value)
    else:
        env.unwrapped.set_attr(name, [value] * 2)


# Conditions of the tank


def sway(t: float) -> tuple[float, float, float]:
    """A displacement after a time, m."""
    return 0.0, 0.02 * np.sin(20.0 * t), 0.0


def pull(tank: Tank, **options) -> None:
    """A spring draws the nose aside."""
    tank.grab(0, tank.position[0, 0] + 0.05, 40.0, 0.1, **options)


def let_go(tank: Tank) -> None:
    """All that was given is taken away again."""
    tank.fix([0])
    pull(tank)
    tank.release([0])
    tank.release()


CONDITIONS = {
    "hold": lambda tank: tank.fix([0, 1]),
    "hold softly": lambda tank: tank.fix([0], method="penalty"),
    "lead": lambda tank: tank.move([0, 21], (0.05, 0.0, 0.0), "xy"),
    "sway": lambda tank: tank.move([0], sway),
    "sway softly": lambda tank: tank.move([0], sway, method="penalty"),
    "pull": pull,
    "tow": lambda tank: pull(tank, velocity=(0.1, 0.0, 0.0)),
    "let go": let_go,
}
WHEN = ("at once", "later", "released")


def some(*choices, every):
    """All combinations of the choices; slow, but for those whose numbers add up to a multiple of `every`."""
    cases = itertools.product(*(enumerate(each) for each in choices))
    return [
        pytest.param(*(value for _, value in case), marks=[pytest.mark.slow] * (sum(i for i, _ in case) % every > 0))
        for case in cases
    ]


@pytest.mark.soft
@pytest.mark.parametrize(("condition", "path", "when"), some(CONDITIONS, MAKERS, WHEN, every=9))
def test_conditions(condition, path, when):
    """A condition acts as in a bare tank with the same commands; after its release, as if it had never been."""
    options = {"variation": {"stiffness": 1.1}} if path == "batch" else {}
    env, fresh = (MAKERS[path](SWIM, **options) for _ in range(2))
    begin(env, 5)
    fish = fish_of(env)[0]
    own, free = (Tank(fish.tank.fish, fish.num_envs, water=fish.tank.world) for _ in range(2))
    actions = np.random.default_rng(3).uniform(-1, 1, (6, *fish.single_action_space.shape)).astype(np.float32)
    shape = env.action_space.shape if isinstance(env, gym.Env) else (2, *fish.single_action_space.shape)
    for step, action in enumerate(actions):
        if step == (0 if when == "at once" else 2):
            for tank in (own, free):
                tank.set_state(fish.tank.get_state())
            if fish.num_envs > 1 and "softly" in condition:  # a penalty draws all to one place
                with pytest.raises(ValueError):
                    CONDITIONS[condition](fish.tank)
                return
            for tank in (fish.tank, own):
                CONDITIONS[condition](tank)
        if step == 4 and when == "released":
            for tank in (fish.tank, own):
                tank.release(np.arange(tank.position.shape[1]))
                tank.release()
        env.step(np.broadcast_to(action, shape))
        if step >= 2 or when == "at once":
            for tank in (own, free):
                tank.swim(action.astype(float), fish.control_interval)
            np.testing.assert_array_equal(fish.tank.position, own.position, err_msg=f"step {step}")
    assert condition == "let go" or np.abs(own.position - free.position).max() > 1e-6, "the condition acts"
    if when == "released":
        assert episode(env) == episode(fresh)


# Keywords

KEYWORDS = sorted({*keywords_of(Episodes), *keywords_of(FishVectorEnv), *keywords_of(LeftAfterRightTask)})
ANOTHER = {
    "angle": 1.5, "severity": 0.2, "part": 0.9, "dwell": 0.5, "wait": 3.0, "reversals": 2, "alignment_weight": 1.0,
    "effort_weight": 0.7, "sway_weight": 0.9, "overshoot_weight": 3.0, "max_episode_steps": 2,
    "variation": {"mass": 1.3},
    "failure_penalty": 3.0, "info_every_step": True,
}  # fmt: skip
"""Values of those that can be set while it runs: other than the defaults, and allowed."""
WRONG = object()
"""A value that no keyword may have."""
FIXED = {"dt": 0.001, "water": "drag", "action_noise": 0.5, "history": 2, "body": "planar", "render_mode": "rgb_array"}
"""Good values of some of the others."""


def plain(value):
    """Arrays of infos as lists, for `repr`; without the time that monitors measure."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items() if key not in ("episode", "_episode")}
    return [plain(each) for each in value] if isinstance(value, list | tuple) else np.asarray(value).tolist()


def episode(env):
    """An episode of four steps as text, in the third of which the fish fail; and what the task has drawn."""
    shape, seen = env.action_space.shape, []
    if isinstance(env, vec_env.VecEnv):
        shape = (env.num_envs, *shape)
    for seed in (2, 3):  # which between them use all that the task draws
        seen.append(begin(env, seed))
        for fish in fish_of(env):
            course = getattr(fish.task, "course", ())
            weights = [getattr(fish.task.pack, name) for name in fish.task.weights]
            seen.append(copy.deepcopy((*course, fish.tank.variation, weights)))
    for step in range(4):
        if step == 2:
            for fish in fish_of(env):
                fish.tank.state.failure[:] = 1
        seen.extend(env.step(np.full(shape, 0.5 - step % 2, np.float32)))
        if isinstance(env, gym.Env) and (seen[-3] or seen[-2]):
            break
    return repr([plain(each) for each in seen])


@functools.cache
def default(path):
    """An episode of an environment that is told nothing."""
    return episode(MAKERS[path](TURNS))


def test_all_keywords_are_in_the_table():
    """What can be set is what has a value in this table: a new keyword must be entered, or is refused everywhere."""
    assert set(ANOTHER) == set(gym.make_vec(TURNS, 2).unwrapped.settable) and set(ANOTHER) <= set(KEYWORDS)
    assert set(gym.make(TURNS).unwrapped.settable) == set(ANOTHER) - {"max_episode_steps"}


@pytest.mark.parametrize(("name", "path"), some(ANOTHER, MAKERS, every=4))
def test_what_is_set(name, path):
    """A good value acts from the next episode on as in an environment that was made with it."""
    env, wanted = MAKERS[path](TURNS), MAKERS[path](TURNS, **{name: ANOTHER[name]})
    own = name == "max_episode_steps" and fish_of(env)[0].spec is None
    change(env, "_max_episode_steps" if own else name, ANOTHER[name])
    assert episode(env) == episode(wanted) != default(path)
    assert own or all(fish.changed == {name: ANOTHER[name]} for fish in fish_of(env))


@pytest.mark.parametrize("path", MAKERS)
def test_what_is_refused(path):
    """A bad value, a misspelt name, what cannot be set, and plain assignment are refused, and change nothing."""
    env = MAKERS[path](TURNS)
    for name in KEYWORDS:
        for wrong, value in ((name, WRONG), (name[1:] + "_", ANOTHER.get(name))):
            with pytest.raises(REFUSED):
                change(env, wrong, value)
        if name not in ANOTHER:
            with pytest.raises(AttributeError):
                change(env, name, FIXED.get(name))
        (fish, *_), of_task = fish_of(env), name in keywords_of(LeftAfterRightTask)
        bare = [env.unwrapped] if hasattr(env.unwrapped, "settable") else []
        for owner in (*bare, fish, *[fish.task] * of_task):
            with pytest.raises(AttributeError, match=f"'{name}' cannot be assigned; (call|make)"):
                setattr(owner, name, ANOTHER.get(name, FIXED.get(name)))
    assert episode(env) == default(path)


def test_misspelt_names():
    """The nearest name that can be set is told; of a keyword that an environment is made with, that."""
    env, vec = gym.make(TURNS), gym.make_vec(TURNS, 2)
    for set_attr in (env.set_wrapper_attr, vec.set_attr):
        with pytest.raises(AttributeError, match=r"\(did you mean 'severity'\?\); make a new environment, or"):
            set_attr("severty", 0.5)
    for get in (vec.get_attr, make_sb3_vec_env(TURNS, 2).get_attr, vec.call):
        with pytest.raises(AttributeError):
            get("severty")
    typos = {"control_intervall": "control_interval", "n_envs": "num_envs", "sverity": "severity"}
    for make, (given, wanted) in itertools.product((gym.make, gym.make_vec), typos.items()):
        with pytest.raises(ValueError, match=rf"'{given}' \(did you mean '{wanted}'\?\)|n_envs is for batches"):
            make(TURNS, **{given: 0.02})
    with pytest.raises(AttributeError, match="give '_max_episode_steps'"):
        env.set_wrapper_attr("max_episode_steps", 2)
    with pytest.raises(AttributeError, match=r"'wiat' cannot be set .*, or choose from") as refused:
        env.set_wrapper_attr("wiat", 2)
    assert "max_episode_steps" not in str(refused.value)


def test_other_processes():
    """Workers of Gymnasium set and refuse as well; those of Stable-Baselines3 set by `env_method`."""
    env = AsyncVectorEnv([lambda: gym.make(TURNS)])
    env.set_attr("severity", 0.2)
    assert env.get_attr("severity") == (0.2,)
    with warnings.catch_warnings(), pytest.raises(AttributeError, match="did you mean 'severity'"):
        warnings.simplefilter("ignore")
        env.set_attr("severty", 0.2)
    own = vec_env.SubprocVecEnv([lambda: gym.make(TURNS)], "fork")
    own.env_method("set_wrapper_attr", "severity", 0.2)
    assert own.get_attr("severity") == [0.2]
    own.close()


def test_copies_keep_what_was_set():
    """Pickles and copies of an environment have what was set, and refuse as it does."""
    env = gym.make_vec(TURNS, 2).unwrapped
    env.set_attr("effort_weight", 0.7)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert other.changed == {"effort_weight": 0.7} and episode(other) == episode(env)
        for owner in (other, other.task):
            with pytest.raises(AttributeError, match="cannot be assigned; call set_wrapper_attr"):
                owner.effort_weight = 1.0


OF_TASKS = {
    "swim": {"heading_error": 0.0},
    "turn": {"angle": 0.5, "wait": 3.0},
    "target": {"distance": 4.0, "bearing": 0.1},
    "fast_start": {"angle": 1.5, "speed": 2.5, "wait": 3.0},
    "avoid": {"gap": 4.0, "aside": 0.0, "drift": 2.5, "sweeping": 1.0, "turning": 1.0, "angle": 0.3, "wait": 5.0},
}


def drawn(env):
    """What the task of a batch has drawn for its fish, as bytes."""
    return pickle.dumps({k: v for k, v in vars(env.task).items() if isinstance(v, np.ndarray | tuple)})


@pytest.mark.parametrize("task", OF_TASKS)
def test_options_of_tasks(task):
    """What is set of the other tasks counts from the next episodes on, bit for bit."""
    for name, value in OF_TASKS[task].items():
        env, wanted = GlidingVectorEnv(4, task=task), GlidingVectorEnv(4, task=task, **{name: value})
        assert name in env.settable
        env.reset(seed=2)
        before = drawn(env)
        env.set_attr(name, [value] * 4)
        assert env.get_attr(name) == wanted.get_attr(name)
        env.reset(seed=2)
        wanted.reset(seed=2)
        assert drawn(env) == drawn(wanted) != before


def test_what_would_change_the_observation():
    """What an observation depends on cannot be set; what depends on the number of dimensions can."""
    swim, spatial = FishVectorEnv(2), FishVectorEnv(2, task="target", dimensions=3)
    with pytest.raises(ValueError, match="would change the observation"):
        swim.set_attr("speed", 1.0)
    spatial.set_attr("elevation", 0.1)
    assert spatial.task.elevation == 0.1


def test_attributes_of_subclasses():
    """What a subclass keeps may be set as in any environment; a batch names it in `LIVE`."""

    class Weighted(GlidingEnv):
        def __init__(self, **options):
            super().__init__(**options)
            self.weight = 1.0

    class Batch(GlidingVectorEnv):
        LIVE = (*GlidingVectorEnv.LIVE, "weight")

    env, batch = SyncVectorEnv([Weighted] * 2), Batch(2)
    for each in (env, batch):
        each.set_attr("weight", 2.0)
        assert each.get_attr("weight") == (2.0, 2.0)
        with pytest.raises(AttributeError, match="choose from"):
            each.set_attr("weigth", 2.0)


@pytest.mark.parametrize("delayed", ["observation_delay", "action_delay"])
def test_limits_below_a_delay(delayed):
    """An episode is longer than its delays, however its limit is set."""
    single, vec = gym.make(STUB, **{delayed: 5}), gym.make_vec(STUB, 2, **{delayed: 5})
    with pytest.raises(ValueError, match=f"{delayed} is .* an episode has 3 steps"):
        vec.set_attr("max_episode_steps", 3)
    single.set_wrapper_attr("_max_episode_steps", 3)
    with pytest.raises(ValueError, match=f"{delayed} is .*; give a whole number .* from 0 to 2"):
        single.reset(seed=0)
    vec.set_attr("max_episode_steps", 6)
    single.set_wrapper_attr("_max_episode_steps", "3")
    with pytest.raises(ValueError, match="max_episode_steps is '3'; give a whole number, at least 1"):
        single.reset(seed=0)


# Recordings


MUTABLE = {
    "variation": ({"mass": [0.9, 1.1]}, lambda d: d["mass"].__setitem__(0, 0.5)),
    "variation, a key": ({"mass": (0.9, 1.1)}, lambda d: d.update(mass=(2.0, 2.0))),
    "variation, an array": ({"mass": np.array([0.9, 1.1])}, lambda d: d["mass"].fill(2.0)),
    "water": ({"density": 900.0}, lambda d: d.update(density=0.0)),
    "water, nested": ({"current": [0.1, 0.0, 0.0]}, lambda d: d["current"].__setitem__(0, 0.9)),
    "heading_error": (np.array(0.3), lambda a: a.fill(3.0)),
    "speed": ([0.5, 1.0], lambda r: r.__setitem__(0, 0.9)),
}


@pytest.mark.parametrize("case", MUTABLE)
def test_recordings_keep_what_was_given(case):
    """What becomes of the caller's keywords after `gym.make` does not change a recording, nor the specification."""
    value, mutate = copy.deepcopy(MUTABLE[case])
    name, wanted = case.split(",")[0], repr(value)
    env, batch = gym.make(STUB, **{name: value}), gym.make_vec(STUB, 2, **{name: value})
    mutate(value)
    assert replay(record(env, np.zeros((2, 12)), 3)).same
    assert repr(env.unwrapped.spec.kwargs[name]) == repr(batch.spec.kwargs[name]) == wanted


def test_recordings_of_what_was_set():
    """What has been set while the environment runs is recorded too."""
    env = gym.make(TURNS, variation={"mass": 1.0})
    record(env, np.zeros((2, 12)), 0)
    for name, value in (("severity", 0.2), ("variation", {"mass": 1.3}), ("_max_episode_steps", 2)):
        env.set_wrapper_attr(name, value)
    kept = record(env, lambda obs, time: np.zeros(12), 0)
    assert replay(kept).same and kept.about["env_options"]["severity"] == 0.2 and kept.steps == 2
    env.unwrapped.fish.set_attr("effort_weight", 0.7)
    kept = record(env, np.zeros((2, 12)), 0)
    assert replay(kept).same and kept.about["env_options"]["effort_weight"] == 0.7


# What a policy was trained with goes with it


SLOW = {"control_interval": 0.04, "max_episode_steps": 50}


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
    "batch": lambda id, options: make_sb3_vec_env(id, 2, **options),
    "normalised": lambda id, options: vec_env.VecNormalize(make_sb3_vec_env(id, 2, **options)),
    "watched": lambda id, options: vec_env.VecMonitor(
        vec_env.DummyVecEnv(
            [single(Monitor, gym.wrappers.RecordEpisodeStatistics, gym.wrappers.NormalizeReward, id=id, **options)]
        )
    ),
    "processes": lambda id, options: vec_env.SubprocVecEnv([single(Monitor, id=id, **options)], "fork"),
}


@pytest.mark.parametrize("delay", tiered((0, 1), (0,)))
@pytest.mark.parametrize(("source", "given"), some(SOURCES, ("keyword", "registration"), every=2))
def test_a_policy_and_its_model_keep_their_interval(delay, given, source, registered, tmp_path):
    """Wherever the training had it from: in shorter steps both move the fish as in those of their training."""
    id, options = (SWIM, SLOW) if given == "keyword" else (registered(**{"control_interval": 0.04}), {})
    with closing(SOURCES[source](id, options)) as env:
        model = model_of(env)
        exported = export_policy(model, {"env_id": SWIM})
        exported.save(tmp_path / "policy.npz")
        exported.to_onnx(tmp_path / "policy.onnx")
        forms = [model, load_policy(tmp_path / "policy.npz"), load_policy(tmp_path / "policy.onnx")]
        assert forms[1].about["trained"]["control_interval"] == 0.04
        found = [places_of(act, 0.04, delay) for act in forms]
        moved = np.abs(found[0][-1] - found[0][0]).max()
        assert moved > 0.001
        for act, slow in zip(forms, found, strict=True):
            for places in (found[0], places_of(act, 0.02, 2 * delay)[1::2]):
                np.testing.assert_allclose(places, slow, rtol=0, atol=2e-3 * moved)
        with pytest.raises(ValueError, match=r"acts every 0.04 s, the environment every 0.03 s"):
            evaluate(make_eval_env(SWIM, 1, {"control_interval": 0.03}), model)


def places_of(policy, interval, delay):
    """Positions after each step of half a second."""
    options = {"control_interval": interval, "variation": {"strength": 0.8}}
    options |= {"action_delay": delay} if delay else {}
    with closing(make_eval_env(SWIM, 2, options)) as env:
        act, (obs, _), seen = as_controller(policy, env), env.reset(seed=3), []
        while env.tank.time[0] < 0.48 - 1e-9:
            obs, *_ = env.step(np.clip(act(obs, float(env.tank.time[0])), -1, 1))
            seen.append(env.tank.position.copy())
        return seen


def test_what_it_was_trained_with_is_checked():
    """What a file says of its training counts: other muscle groups are refused, and what can be none."""
    policy = export_policy(model_of(make_sb3_vec_env(SWIM, 2)), {"env_id": SWIM})
    trained = policy.about["trained"]
    with pytest.raises(ValueError, match="give it muscle_groups='pairs'"):
        about = policy.about | {"trained": trained | {"muscle_groups": "pairs"}}
        evaluate(make_eval_env(SWIM, 1, {}), replace(policy, about=about))
    for bad in ([], {"control_interval": 0.04}, trained | {"control_interval": -1.0}):
        with pytest.raises(ValueError, match=r"trained is|control_interval is"):
            make_policy_env(replace(policy, about={"env_id": SWIM, "trained": bad}), 1)


class Reversed(gym.Wrapper):
    """Actions the other way round."""

    def step(self, action):
        return self.env.step(-action)


class Mine(vec_env.DummyVecEnv):
    """May do anything."""


CHANGED = {
    "reversed": lambda: vec_env.DummyVecEnv([single(), single(Reversed)]),
    "watched": lambda: vec_env.DummyVecEnv([single(Reversed, Monitor)]),
    "in processes": lambda: vec_env.SubprocVecEnv([single(Reversed, Monitor)], "fork"),
    "skipped": lambda: vec_env.DummyVecEnv([single(lambda env: gym.wrappers.MaxAndSkipObservation(env, 2))]),
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
        if isinstance(env, vec_env.DummyVecEnv) and name != "a batch":
            with pytest.raises(ValueError, match=r"has a wrapper (Reversed|MaxAndSkipObservation)"):
                record(env.envs[-1], "swim")


@pytest.mark.parametrize(("given", "interval"), some(("registration", "keyword", "both"), (0.01, 0.03, 0.04), every=4))
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
        for options in ({"effort_weight": 0.7}, {"history": 0, "max_episode_steps": 20, "body": "mass_spring"})
    )
    with pytest.raises(ValueError, match=r"differ in effort_weight \(2.2 and 0.7\); give env, or .* a keyword"):
        compare(swim, drag)
    same = compare(swim, drag, effort_weight=0.7, max_episode_steps=20)
    assert same["return"].difference == (0.0, 0.0, 0.0)
    compare(swim, remembers, max_episode_steps=20)
    with pytest.raises(ValueError, match="an environment is given, and effort_weight too"):
        compare(swim, drag, make_policy_env(swim, 1), effort_weight=0.7)
    swim.save(tmp_path / "swim.npz")
    drag.save(tmp_path / "drag.npz")
    files = [str(tmp_path / "swim.npz"), str(tmp_path / "drag.npz")]
    assert command_line.main(["compare", *files]) == 2 and "by --env-kwargs" in capsys.readouterr().err
    short = ["--env-kwargs", "max_episode_steps=3"]
    assert command_line.main(["compare", *files, *short, "effort_weight=0.7"]) == 0
    assert f"{SWIM} with effort_weight=0.7, max_episode_steps=3: mean" in capsys.readouterr().out
    assert command_line.main(["evaluate", *files, *short, "--episodes", "2"]) == 0
    printed = capsys.readouterr().out
    for file, own in zip(files, ("max_episode_steps=3", "effort_weight=0.7, max_episode_steps=3"), strict=True):
        assert f"{file}: {own}" in printed


def test_failing_episodes_are_said(tmp_path, capsys):
    """Where more than half of the episodes fail, an evaluation and a training say why, and what to do."""
    diverging, said = {"integrator": "rk4", "dt": 0.002}, r"3 of 3 episodes failed \(.+\); give a dt smaller than 0.002"
    with pytest.warns(UserWarning, match=said):
        evaluate(make_policy_env("swim", 3, **diverging), "swim")
    words = ["evaluate", "swim", "--integrator", "rk4", "--dt", "0.002", "--episodes", "3"]
    assert command_line.main(words) == 0
    assert capsys.readouterr().err.count("\nfish_env: 3 of 3 episodes failed (") == 1  # after a line on the step
    train_short(changes={"timesteps": 1024, "num_envs": 8}, root=tmp_path, **diverging)
    assert capsys.readouterr().out.count("episodes failed (") == 1


def test_a_model_is_no_policy_file():
    """It says what to do with it."""
    with pytest.raises(ValueError, match=r"m.zip is a Stable-Baselines3 model: load it and pass it"):
        evaluate(make_eval_env(SWIM, 1, {}), "m.zip")
