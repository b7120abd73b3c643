"""The environments keep Gymnasium's and Stable-Baselines3's contracts, and a batch of fish is so many single fish."""

import copy
import json
import pickle
import subprocess
import sys
import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_gymnasium
from gymnasium.vector import AutoresetMode

import fish_env
from fish_env import make_sb3_vec_env
from fish_env.envs import FishVectorEnv, episode

IDS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))


def actions(env, steps, seed=0):
    """Random actions for so many steps of a batch."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


def test_ids():
    """Every task of the table, and the stub, is registered."""
    assert set(IDS) == {f"FishEnv/{task.title().replace('_', '')}-v0" for task in fish_env.TASKS} | {"FishEnv/Stub-v0"}


@pytest.mark.parametrize("limit", [3, 7, -1])
def test_info_comes_with_another_time_limit(limit, monkeypatch):
    """The summary is in the `info` of the step that `max_episode_steps` truncates, and of no other."""
    monkeypatch.setattr(gym.spec("FishEnv/Stub-v0"), "max_episode_steps", 5)
    env = gym.make("FishEnv/Stub-v0", max_episode_steps=limit)
    for _ in range(2):
        env.reset(seed=0)
        steps = [env.step(env.action_space.sample()) for _ in range(8 if limit < 0 else limit)]
        assert [bool(info) for *_, info in steps] == [truncated for *_, truncated, _ in steps]
        assert steps[-1][3] == (limit > 0)
    assert limit < 0 or steps[-1][4]["seconds"] == pytest.approx(0.02 * limit)
    longer = gym.wrappers.TimeLimit(gym.make("FishEnv/Stub-v0", max_episode_steps=4), 6)
    longer.reset(seed=0)
    assert [bool(longer.step(env.action_space.sample())[4]) for _ in range(4)] == [False, False, False, True]
    inside = gym.make_vec("FishEnv/Stub-v0", 2, vectorization_mode="sync", max_episode_steps=3)
    inside.reset(seed=0)
    assert ["terms" in inside.step(inside.action_space.sample())[4] for _ in range(3)] == [False, False, True]


def test_threads_of_one_fish():
    """`gym.make` takes `threads` as `gym.make_vec` does, checks it, and refuses a number of fish."""
    assert gym.make("FishEnv/Swim-v0", threads=2).unwrapped.tank.threads == 2
    assert gym.make("FishEnv/Swim-v0").unwrapped.tank.threads == 1
    with pytest.raises(ValueError, match="threads is 0"):
        gym.make("FishEnv/Swim-v0", threads=0)
    with pytest.raises(ValueError, match=r"num_envs is for batches \(gym.make_vec\)"):
        gym.make("FishEnv/Swim-v0", num_envs=2)


@pytest.mark.parametrize("error", [TypeError, ValueError])
def test_unknown_keywords_are_unknown_to_others_too(error):
    """An unknown keyword is Python's TypeError in words and kind, which libraries that try keywords look for."""
    with pytest.raises(error, match="unexpected keyword argument 'frameskip'"):
        gym.make("FishEnv/Swim-v0", frameskip=1)
    with pytest.raises(error, match="unexpected keyword argument 'frameskip'"):
        FishVectorEnv(2, frameskip=1)


def test_refused_environments_are_closed_in_silence():
    """An environment whose options were refused may be closed, as some versions of Gymnasium do when it is deleted."""
    made = []

    class Remembered(FishVectorEnv):
        def __init__(self, **options):
            made.append(self)
            super().__init__(**options)

    for options in ({"body": "whale"}, {"render_mode": "x"}, {"autoreset_mode": "x"}):
        with pytest.raises(ValueError, match="unknown"):
            Remembered(**options)
        made[-1].close()
    assert len(made) == 3


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_checkers(id, groups, monkeypatch):
    """Gymnasium's environment checker passes without a single warning."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make(id, muscle_groups=groups)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_gymnasium(env.unwrapped)


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_checker_of_stable_baselines3(id, groups):
    """Stable-Baselines3's environment checker passes without a single warning."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gym.make(id, muscle_groups=groups).unwrapped)


@pytest.mark.parametrize("id", IDS)
def test_checker_logger_is_silent(id, capsys):
    """Gymnasium's logger, which does not go through `warnings`, has nothing to say either."""
    env = gym.make(id)
    check_gymnasium(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert "WARN" not in capsys.readouterr().err


@pytest.mark.parametrize("id", IDS)
def test_spec_is_plain(id):
    """The registered spec can be written as JSON and read back."""
    spec = gym.spec(id)
    assert json.loads(spec.to_json())["id"] == id
    assert gym.make(type(spec).from_json(spec.to_json())).observation_space == gym.make(id).observation_space


def test_module_id():
    """`gym.make("fish_env:FishEnv/Swim-v0")` works in a process that has not imported the package."""
    code = "import gymnasium as gym; print(gym.make('fish_env:FishEnv/Stub-v0').reset(seed=0)[0].shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(156,)"


def test_import_is_light():
    """Importing the package loads neither torch, Stable-Baselines3, pygame, matplotlib, viser nor moviepy."""
    code = """import sys, gymnasium as gym, fish_env; gym.make("FishEnv/Swim-v0").reset(seed=0)
print({"torch", "stable_baselines3", "pygame", "matplotlib", "viser", "moviepy"} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_stub_compiles_nothing():
    """A whole stub episode calls no compiled kernel."""
    code = """import gymnasium as gym, fish_env, numba
from numba.core.registry import CPUDispatcher
def refuse(self, *args): raise AssertionError("compiled " + self.py_func.__name__)
CPUDispatcher._compile_for_args = refuse
env = gym.make("FishEnv/Stub-v0"); env.reset(seed=0)
vec = gym.make_vec("FishEnv/Stub-v0", num_envs=3); vec.reset(seed=0)
for _ in range(500): env.step(env.action_space.sample()); vec.step(vec.action_space.sample())
print("ok")"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "ok", done.stderr


@pytest.mark.parametrize("id", IDS)
def test_batch_equals_singles(id):
    """Fish i of a batch seeded s is the single environment seeded s + i, bit for bit, over 200 steps and a reset."""
    count, steps, seed = 5, 200, 11
    batch = gym.make_vec(id, num_envs=count, max_episode_steps=150)
    singles = [gym.make(id, max_episode_steps=150) for _ in range(count)]
    obs, _ = batch.reset(seed=seed)
    np.testing.assert_array_equal(obs, [env.reset(seed=seed + i)[0] for i, env in enumerate(singles)])
    over, ends = [False] * count, 0
    for action in actions(batch, steps):
        obs, reward, terminated, truncated, _ = batch.step(action)
        for i, env in enumerate(singles):
            if over[i]:
                expected = (env.reset()[0], 0.0, False, False)
            else:
                expected = env.step(action[i])[:4]
            np.testing.assert_array_equal(obs[i], expected[0])
            assert (reward[i], terminated[i], truncated[i]) == expected[1:]
            over[i] = expected[2] or expected[3]
            ends += over[i]
    assert ends >= count, "no episode ended: the restart was not tested"


def test_threads_do_not_matter():
    """The number of threads changes no bit."""
    results = []
    for threads in (1, 3):
        env = gym.make_vec("FishEnv/Swim-v0", num_envs=64, threads=threads)
        env.reset(seed=0)
        results.append([env.step(a)[:2] for a in actions(env, 5)])
        env.close()
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_same_seed_same_bits():
    """Two environments with the same seed and actions agree bit for bit; another seed differs."""

    def play(seed):
        env = gym.make("FishEnv/Swim-v0")
        first, _ = env.reset(seed=seed)
        return np.array([first, *(env.step(a)[0] for a in actions(env, 30))])

    np.testing.assert_array_equal(play(3), play(3))
    assert (play(3) != play(4)).any()


@pytest.mark.parametrize("id", IDS)
def test_observations(id):
    """Observations are finite, fresh, float32, inside their space, and no element is constant."""
    env = gym.make(id)
    seen = []
    for seed in range(4):  # an episode may lack what a task only sometimes has, such as an obstacle that moves
        seen.append(env.reset(seed=seed)[0])
        for action in actions(env, gym.spec(id).max_episode_steps - 1, seed):
            seen.append(env.step(action)[0])
    assert all(env.observation_space.contains(obs) for obs in seen)
    assert not any(np.shares_memory(a, b) for a, b in pairwise(seen))
    if id != "FishEnv/Stub-v0":  # the stub is stiff
        assert (np.ptp(seen, axis=0) > 0).all()


def test_reward_is_progress_less_effort():
    """The rewards of an episode add up to the body lengths covered along the heading less the named effort."""
    env = gym.make("FishEnv/Swim-v0")
    env.reset(seed=2)
    tank, fish = env.unwrapped.tank, env.unwrapped.tank.fish
    heading = env.unwrapped.fish.task.vectors(tank, env.unwrapped.fish._pose)[0, 0].copy()
    mass = fish.body.mass / fish.body.mass.sum()
    start, total, over = mass @ tank.position[0], 0.0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        over, total = terminated or truncated, total + reward
    covered = (mass @ tank.position[0] - start) @ heading / fish.length
    assert info["terms"]["progress"] == pytest.approx(covered, rel=1e-9)
    assert info["terms"]["effort"] < 0 == info["terms"]["failure"]
    assert sum(info["terms"].values()) == pytest.approx(total, rel=1e-9)
    assert info["speed"] == pytest.approx(covered / info["seconds"], rel=1e-9)


def test_still_fish_pays_nothing():
    """A fish that keeps its muscles relaxed makes no effort and hardly moves."""
    env = gym.make("FishEnv/Swim-v0")
    env.reset(seed=0)
    rewards = [env.step(-np.ones(12, dtype=np.float32))[1] for _ in range(20)]
    assert np.abs(rewards).max() < 1e-3


def test_info_is_empty_until_the_end():
    """`info` holds nothing in the hot path, everything at the end, and something each step on request."""
    env = gym.make("FishEnv/Swim-v0")
    _, info = env.reset(seed=0)
    steps = [(None, 0.0, False, False, info)]
    while not steps[-1][3]:
        steps.append(env.step(env.action_space.sample()))
    assert all(step[4] == {} for step in steps[:-1])
    assert {"terms", "speed", "seconds"} <= set(steps[-1][4]) and steps[-1][4]["failure"] == ""
    assert steps[-1][4] == env.unwrapped.episode_info()
    env = gym.make("FishEnv/Swim-v0", info_every_step=True)
    env.reset(seed=0)
    assert {"step_terms", "position", "heading"} <= set(env.step(env.action_space.sample())[4])


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_autoreset(id, mode):
    """Each of the three autoreset modes does what Gymnasium says it does."""
    env = gym.make_vec(id, num_envs=3, max_episode_steps=4, autoreset_mode=mode.value)
    assert env.metadata["autoreset_mode"] is mode
    env.reset(seed=0)
    for _ in range(4):
        obs, _, terminated, truncated, infos = env.step(env.action_space.sample())
    assert truncated.all() and not terminated.any()
    if mode is AutoresetMode.SAME_STEP:
        assert infos["_final_obs"].all() and infos["_final_info"].all()
        assert not np.array_equal(infos["final_obs"][0], obs[0])
        assert infos["final_info"]["seconds"] == pytest.approx([4 * env.unwrapped.control_interval] * 3)
        assert (env.unwrapped.tank.time == 0).all()
        return
    assert infos["_seconds"].all() and infos["seconds"].shape == (3,)
    if mode is AutoresetMode.NEXT_STEP:
        fresh, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert (reward == 0).all() and not truncated.any() and (env.unwrapped.tank.time == 0).all()
        assert not np.array_equal(fresh, obs)
        return
    with pytest.raises(gym.error.ResetNeeded, match="reset_mask"):
        env.step(env.action_space.sample())
    mask = np.array([True, False, True])
    after, _ = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[1], obs[1])
    assert (env.unwrapped.tank.time[mask] == 0).all() and env.unwrapped.tank.time[1] > 0


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_blown_up_fish_leaves_its_neighbours_alone(mode):
    """A state that blows up ends that fish's episode with a reason, a finite observation and the penalty, no more."""

    def play(blow_up):
        env = gym.make_vec("FishEnv/Swim-v0", num_envs=4, autoreset_mode=mode.value)
        env.reset(seed=0)
        seen = []
        for k, action in enumerate(actions(env, 6)):
            if blow_up and k == 3:
                env.unwrapped.tank.velocity[2, 5] = np.nan if blow_up == "nan" else 1e6
            seen.append(env.step(action))
            if mode is AutoresetMode.DISABLED and seen[-1][2].any():
                env.reset(options={"reset_mask": seen[-1][2]})
        return seen

    calm = play(False)
    for how in ("nan", "fast"):
        wild = play(how)
        others = [0, 1, 3]
        for a, b in zip(calm, wild, strict=True):
            np.testing.assert_array_equal(a[0][others], b[0][others])
            np.testing.assert_array_equal(a[1][others], b[1][others])
            assert np.isfinite(b[0]).all() and np.isfinite(b[1]).all()
        _, reward, terminated, truncated, infos = wild[3]
        assert terminated.tolist() == [False, False, True, False] and not truncated.any()
        assert reward[2] < -episode.FAILURE_PENALTY + 1
        failure = (infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos)["failure"][2]
        assert failure.split(":")[0] in ("non-finite", "torn", "untrusted solve")
        assert not wild[5][2].any()


def test_single_failure():
    """The single environment reports a failure of the physics in `info`, with a finite last observation."""
    env = gym.make("FishEnv/Swim-v0")
    env.reset(seed=0)
    env.unwrapped.tank.velocity[0, 3, 1] = np.inf
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert terminated is True and truncated is False and info["failure"].startswith("non-finite")
    assert np.isfinite(obs).all() and np.isfinite(reward)
    assert info["terms"]["failure"] == -episode.FAILURE_PENALTY


def test_sb3_vec_env():
    """The native VecEnv hands over terminal observations and time limits as Stable-Baselines3 wants them."""
    pytest.importorskip("stable_baselines3")
    env = make_sb3_vec_env("FishEnv/Swim-v0", num_envs=3, seed=4, max_episode_steps=5, monitor=False)
    reference = gym.make_vec("FishEnv/Swim-v0", num_envs=3, max_episode_steps=5, autoreset_mode="SameStep")
    np.testing.assert_array_equal(env.reset(), reference.reset(seed=4)[0])
    for action in actions(reference, 12):
        obs, reward, done, infos = env.step(action)
        expected = reference.step(action)
        np.testing.assert_array_equal(obs, expected[0])
        np.testing.assert_array_equal(reward, expected[1].astype(np.float32))
        np.testing.assert_array_equal(done, expected[2] | expected[3])
        for i in np.flatnonzero(done):
            np.testing.assert_array_equal(infos[i]["terminal_observation"], expected[4]["final_obs"][i])
            assert infos[i]["TimeLimit.truncated"] is True
        assert all(info == {} for info, over in zip(infos, done, strict=True) if not over)
    assert env.get_attr("control_interval") == [reference.unwrapped.control_interval] * 3
    assert env.env_is_wrapped(gym.Wrapper) == [False] * 3


def test_sb3_failure_is_not_a_time_limit():
    """A blown-up fish is done without `TimeLimit.truncated`."""
    pytest.importorskip("stable_baselines3")
    env = make_sb3_vec_env("FishEnv/Swim-v0", num_envs=2, seed=0, monitor=False)
    env.reset()
    env.fish.tank.velocity[1] = np.nan
    _, _, done, infos = env.step(np.zeros((2, 12), dtype=np.float32))
    assert done.tolist() == [False, True]
    assert infos[1]["TimeLimit.truncated"] is False and infos[1]["failure"].startswith("non-finite")


@pytest.mark.parametrize("task", fish_env.TASKS)
def test_returned_arrays_are_the_callers(task):
    """What a caller does to the arrays that `step` returned does not come back."""
    env = FishVectorEnv(2, task=task)
    env.reset(seed=0)
    for action in actions(env, 3):
        _, reward, terminated, truncated, _ = env.step(action)
        assert not terminated.any() and not truncated.any() and np.isfinite(reward).all()
        terminated[:], truncated[:], reward[:] = True, True, np.nan


def test_unregistered_spec():
    """An environment made from a spec that is not registered works."""
    spec = copy.deepcopy(gym.spec("FishEnv/Stub-v0"))
    spec.id = "Elsewhere/Stub-v0"
    assert gym.make(spec).reset(seed=0)[0].shape == (156,)


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("id", IDS)
def test_clone_goes_on_alike(id, clone):
    """A pickled or copied environment, in the middle of an episode, goes on bit for bit like the original."""
    env = gym.make_vec(id, num_envs=2)
    env.reset(seed=0)
    moves = actions(env, 10)
    for action in moves[:5]:
        env.step(action)
    twin = clone(env)
    for action in moves[5:]:
        np.testing.assert_array_equal(env.step(action)[0], twin.step(action)[0])
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"body": "shark"}, "unknown body 'shark'; choose from 'mass_spring'"),
        ({"integrator": "magic"}, "unknown integrator 'magic'; choose from 'semi_implicit'"),
        ({"task": "sleep"}, "unknown task 'sleep'; choose from 'swim'"),
        ({"depth": 3}, "unknown option .* 'depth'"),
        ({"dt": 0.0}, "dt is 0.0; give a positive"),
        ({"dt": -1e-3}, "dt is -0.001"),
        ({"dt": float("nan")}, "dt is nan"),
        ({"control_interval": 0.0}, "control_interval is 0.0"),
        ({"control_interval": 0.0201}, "whole multiple"),
        ({"water": {"law": "cubic"}}, "unknown water law 'cubic'"),
        ({"water": {"density": -1.0}}, "density is -1.0"),
        ({"water": {"salt": 1.0}}, "give keywords of fish_env.make_water"),
        ({"water": "deep"}, "give keywords of fish_env.make_water"),
        ({"muscle_groups": "all"}, "unknown muscle grouping 'all'"),
        ({"render_mode": "ascii"}, "unknown render_mode 'ascii'"),
        ({"heading_error": 9.0}, "heading_error is 9; give a number from 0 to 3.14159"),
        ({"speed": 9.0}, "speed is 9; give a number from 0.1 to 3"),
        ({"speed": (2.0, 1.0)}, "lowest first"),
        ({"task": "turn", "angle": 4.0}, "angle is 4; give a number from 0.174533 to 3.14159"),
        ({"task": "left_after_right", "severity": 3.0}, "severity is 3; give a number from 0.1 to 2"),
        ({"task": "left_after_right", "reversals": 3}, "reversals is 3; give 1 or 2"),
        ({"task": "target", "dimensions": 4}, "dimensions is 4; give 2 or 3"),
        ({"task": "target", "distance": 0.3}, "distance is 0.3; give a number from 0.8 to 5"),
        ({"task": "avoid", "gap": (0.0, 1.0)}, "gap is 0; give a number from 0.2 to 5"),
        ({"variation": {"depth": 1.0}}, "unknown variation 'depth'; choose from stiffness"),
        ({"variation": {"mass": 0.0}}, "give a number from 0.5 to 2"),
        ({"variation": 3}, "variation is 3; give a dict"),
        ({"variation": 0}, "variation is 0; give a dict"),
        ({"speed": True}, "speed is True; give a number"),
        ({"task": "turn", "angle": "x"}, "angle is 'x'; give a number"),
        ({"task": "target", "dimensions": 2.0}, "dimensions is 2.0; give 2 or 3"),
        ({"task": "left_after_right", "reversals": True}, "reversals is True; give 1 or 2"),
        ({"task": ["swim"]}, "unknown task"),
        ({"autoreset_mode": "foo"}, "unknown autoreset_mode 'foo'; choose from 'NextStep', 'SameStep', 'Disabled'"),
        ({"max_episode_steps": True}, "max_episode_steps is True"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"num_envs": 0}, "num_envs is 0; give a whole number, at least 1"),
        ({"threads": 0}, "threads is 0"),
    ],
)
def test_bad_options_are_refused(options, message):
    """Whatever is not allowed is refused when the environment is made, saying what is."""
    with pytest.raises(ValueError, match=message):
        FishVectorEnv(**options)


def test_bad_use_is_refused():
    """Steps before reset, wrong actions, seeds, masks and unknown reset options are refused; nothing moves."""
    env = FishVectorEnv(2)
    with pytest.raises(gym.error.ResetNeeded, match="before reset"):
        env.step(np.zeros((2, 12)))
    env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(gym.error.ResetNeeded, match=r"fish \[1\]"):
        env.step(np.zeros((2, 12)))
    env.reset(seed=0)
    before = env.tank.get_state()
    for bad in (np.zeros((2, 11)), np.zeros(12), np.full((2, 12), np.nan), np.full((2, 12), np.inf), "left"):
        with pytest.raises(ValueError, match="action"):
            env.step(bad)
    with pytest.raises(ValueError, match="unknown reset option 'wind'"):
        env.reset(options={"wind": 1})
    for yaw in (np.nan, "north", [1.0, 2.0]):
        with pytest.raises(ValueError, match="yaw"):
            env.reset(options={"yaw": yaw})
    with pytest.raises(ValueError, match=r"seed is .*; give one whole number, zero or more, or 2, one for each fish"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match=r"seed is 1.5; give a whole number, zero or more, or None"):
        env.reset(seed=1.5)
    with pytest.raises(ValueError, match="options is 'abc'; give a dict"):
        env.reset(options="abc")
    for mask in (np.zeros(2, dtype=bool), np.ones(3, dtype=bool), [True, True], np.ones(2)):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})
    for name, value in env.tank.get_state().items():
        np.testing.assert_array_equal(value, before[name])


@pytest.mark.parametrize("task", fish_env.TASKS)
def test_infos_hold_plain_numbers(task):
    """What an episode came to is Python's own numbers, not numpy's."""
    env = FishVectorEnv(1, task=task)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert {type(value) for value in env.episode_info(0).values()} <= {float, int, bool, dict, str}


def test_options_that_would_change_nothing_are_refused():
    """One fish has no autoreset; a `VecEnv` has one of its own."""
    pytest.importorskip("stable_baselines3")
    with pytest.raises(ValueError, match="autoreset_mode is for batches"):
        gym.make("FishEnv/Swim-v0", autoreset_mode="Disabled")
    with pytest.raises(ValueError, match="autoreset_mode cannot be chosen"):
        make_sb3_vec_env("FishEnv/Swim-v0", num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ValueError, match="'CartPole-v1' is a CartPoleVectorEnv; give an environment whose batches"):
        make_sb3_vec_env("CartPole-v1", num_envs=2)
    for seed in ("x", -1, 1.5):
        with pytest.raises(ValueError, match=r"seed is .*; give a whole number, zero or more, or None"):
            make_sb3_vec_env("FishEnv/Swim-v0", num_envs=2, seed=seed)
    env = make_sb3_vec_env("FishEnv/Swim-v0", num_envs=2, seed=0, max_episode_steps=2, info_every_step=True)
    env.reset()
    infos = [env.step(np.zeros((2, 12)))[3][1] for _ in range(2)]
    assert all("step_terms" in info for info in infos) and "terms" in infos[1]


def test_actions_beyond_the_box_are_clipped():
    """An action outside [-1, 1] does what the nearest action inside does."""
    one, other = FishVectorEnv(1), FishVectorEnv(1)
    one.reset(seed=0)
    other.reset(seed=0)
    wild = np.linspace(-3, 3, 12)[None]
    np.testing.assert_array_equal(one.step(wild)[0], other.step(np.clip(wild, -1, 1))[0])


def test_pairs_keep_the_fish_level():
    """With left-right pairs a fish that starts without noise stays in its plane."""
    env = FishVectorEnv(1, muscle_groups="pairs")
    env.reset(seed=0)
    env.tank.velocity[:] = 0.0
    upper_lower = {1: 4, 2: 3, 5: 8, 6: 7, 21: 22}
    for action in actions(env, 30):
        env.step(action)
    x = env.tank.position[0]
    for upper, lower in upper_lower.items():
        np.testing.assert_allclose(x[upper] * [1, 1, -1], x[lower], atol=1e-12)
