"""The environments keep Gymnasium's and Stable-Baselines3's contracts, and a batch of fish is so many single fish."""

import copy
import json
import pickle
import subprocess
import sys
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import fish_env
from fish_env import make_sb3_vec_env
from fish_env.envs import FishVectorEnv, episode

IDS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))
SWIM, STUB = "FishEnv/Swim-v0", "FishEnv/Stub-v0"
each_mode = pytest.mark.parametrize("mode", list(AutoresetMode))


def actions(env, steps, seed=0):
    """Random actions for so many steps of a batch."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


def begun(id=SWIM, seed=0, **options):
    """A single environment at the beginning of an episode."""
    env = gym.make(id, **options)
    env.reset(seed=seed)
    return env


def begun_batch(num_envs=2, seed=0, **options):
    """A batch at the beginning of its episodes."""
    env = FishVectorEnv(num_envs, **options)
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize("id", IDS)
def test_ids(id):
    """Every task of the table, and the stub, is registered, with a spec that can be written as JSON and read back."""
    assert set(IDS) == {f"FishEnv/{task.title().replace('_', '')}-v0" for task in fish_env.TASKS} | {STUB}
    spec = gym.spec(id)
    assert json.loads(spec.to_json())["id"] == id
    assert gym.make(type(spec).from_json(spec.to_json())).observation_space == gym.make(id).observation_space
    elsewhere = copy.deepcopy(spec)
    elsewhere.id = "Elsewhere/Fish-v0"
    assert gym.make(elsewhere).observation_space == gym.make(id).observation_space, "it need not be registered"


@pytest.mark.parametrize("limit", [3, 7, -1])
def test_info_comes_with_another_time_limit(limit, monkeypatch):
    """The summary is in the `info` of the step that `max_episode_steps` truncates, and of no other."""
    monkeypatch.setattr(gym.spec(STUB), "max_episode_steps", 5)
    env = gym.make(STUB, max_episode_steps=limit)
    for _ in range(2):
        env.reset(seed=0)
        steps = [env.step(env.action_space.sample()) for _ in range(8 if limit < 0 else limit)]
        assert [bool(info) for *_, info in steps] == [truncated for *_, truncated, _ in steps]
        assert steps[-1][3] == (limit > 0)
    assert limit < 0 or steps[-1][4]["seconds"] == pytest.approx(0.02 * limit)
    longer = gym.wrappers.TimeLimit(gym.make(STUB, max_episode_steps=4), 6)
    longer.reset(seed=0)
    assert [bool(longer.step(env.action_space.sample())[4]) for _ in range(4)] == [False, False, False, True]
    inside = gym.make_vec(STUB, 2, vectorization_mode="sync", max_episode_steps=3)
    inside.reset(seed=0)
    assert ["terms" in inside.step(inside.action_space.sample())[4] for _ in range(3)] == [False, False, True]


def test_threads_of_one_fish():
    """`gym.make` takes `threads` as `gym.make_vec` does, checks it, and refuses what is for batches."""
    assert gym.make(SWIM, threads=2).unwrapped.tank.threads == 2
    assert gym.make(SWIM).unwrapped.tank.threads == 1
    for keyword, value, message in (
        ("threads", 0, "threads is 0"),
        ("num_envs", 2, r"num_envs is for batches \(gym.make_vec\)"),
        ("autoreset_mode", "Disabled", "autoreset_mode is for batches"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make(SWIM, **{keyword: value})


@pytest.mark.parametrize("error", [TypeError, ValueError])
@pytest.mark.parametrize("make", [lambda **options: gym.make(SWIM, **options), FishVectorEnv])
def test_unknown_keywords_are_unknown_to_others_too(make, error):
    """An unknown keyword is Python's TypeError in words and kind, which libraries that try keywords look for."""
    with pytest.raises(error, match="unexpected keyword argument 'frameskip'"):
        make(frameskip=1)


def test_refused_environments_are_closed_in_silence():
    """An environment whose options were refused may be closed, as some versions of Gymnasium do when it is deleted."""
    FishVectorEnv.__new__(FishVectorEnv).close()


def test_module_id():
    """An id with its module works where the package was not imported, and policies act, with numpy alone."""
    code = """import sys, gymnasium as gym; env = gym.make("fish_env:FishEnv/Swim-v0")
from fish_env.control import load_policy, shipped_policy
print(load_policy(shipped_policy("swim"))(env.reset(seed=0)[0]).shape)
print({"torch", "stable_baselines3", "pygame", "matplotlib", "websockets", "moviepy"} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["(12,)", "set()"]


def test_stub_compiles_nothing(monkeypatch):
    """A whole stub episode calls no compiled kernel."""
    dispatcher = pytest.importorskip("numba.core.registry").CPUDispatcher

    def refuse(self, *given):
        raise AssertionError(f"compiled {self.py_func.__name__}")

    for name in ("_compile_for_args", "__call__"):  # the first time, and with what was compiled before
        monkeypatch.setattr(dispatcher, name, refuse)
    with pytest.raises(AssertionError, match="compiled "):
        begun()
    env, batch = begun(STUB), gym.make_vec(STUB, num_envs=3, max_episode_steps=20)
    batch.reset(seed=0)
    for _ in range(30):
        env.step(env.action_space.sample())
        batch.step(batch.action_space.sample())


@pytest.mark.parametrize("id", IDS)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_batch_equals_singles(id, mode):
    """A batch seeded s is Gymnasium's batch of single fish seeded s + i, bit for bit, over 50 steps and a restart."""
    batch = gym.make_vec(id, 3, max_episode_steps=30, autoreset_mode=mode)
    mode = batch.metadata["autoreset_mode"]
    singles = gym.vector.SyncVectorEnv([lambda: gym.make(id, max_episode_steps=30)] * 3, autoreset_mode=mode)
    np.testing.assert_array_equal(batch.reset(seed=11)[0], singles.reset(seed=11)[0])
    ends = 0
    for action in actions(batch, 50):
        *found, infos = batch.step(action)
        *expected, wanted = singles.step(action)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        assert infos.keys() == wanted.keys()
        ends += np.count_nonzero(found[2] | found[3])
    assert ends >= 3, "no episode ended: the restart was not tested"


def test_same_seed_same_bits():
    """The same seed and actions give the same bits, whatever the number of threads; another seed differs."""

    def play(seed, threads):
        env = begun_batch(64, seed, threads=threads)
        return np.array([env.step(action)[0] for action in actions(env, 5)])

    np.testing.assert_array_equal(play(3, 1), play(3, 3))
    assert (play(3, 1) != play(4, 1)).any()


@pytest.mark.parametrize("id", IDS)
def test_observations(id):
    """Observations are finite, fresh, float32, inside their space, and no element is constant."""
    env, seen = gym.make(id), []
    for seed in range(4):  # an episode may lack what a task only sometimes has, such as an obstacle that moves
        seen.append(env.reset(seed=seed)[0])
        for action in actions(env, 3 if id == STUB else gym.spec(id).max_episode_steps - 1, seed):
            seen.append(env.step(action)[0])
    assert all(env.observation_space.contains(obs) for obs in seen)
    assert not any(np.shares_memory(a, b) for a, b in pairwise(seen))
    if id != STUB:  # the stub is stiff
        assert (np.ptp(seen, axis=0) > 0).all()


def test_reward_is_progress_less_effort():
    """The rewards of an episode add up to the body lengths along the heading less the named effort; `info` says so."""
    env = gym.make(SWIM)
    info = env.reset(seed=2)[1]
    tank, fish = env.unwrapped.tank, env.unwrapped.tank.fish
    heading = env.unwrapped.fish.task.vectors(tank, env.unwrapped.fish._pose)[0, 0].copy()
    mass = fish.body.mass / fish.body.mass.sum()
    start, total, over = mass @ tank.position[0], 0.0, False
    while not over:
        assert info == {}, "it is empty until the end"
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        over, total = terminated or truncated, total + reward
    covered = (mass @ tank.position[0] - start) @ heading / fish.length
    assert info == env.unwrapped.episode_info() and info["failure"] == ""
    assert info["terms"]["progress"] == pytest.approx(covered, rel=1e-9)
    assert info["terms"]["effort"] < 0 == info["terms"]["failure"]
    assert sum(info["terms"].values()) == pytest.approx(total, rel=1e-9)
    assert info["speed"] == pytest.approx(covered / info["seconds"], rel=1e-9)
    env = begun(info_every_step=True)
    assert {"step_terms", "term_effort", "position", "heading"} <= set(env.step(env.action_space.sample())[4])


def test_still_fish_pays_nothing():
    """A fish that keeps its muscles relaxed makes no effort and hardly moves."""
    env = begun()
    rewards = [env.step(-np.ones(12, dtype=np.float32))[1] for _ in range(20)]
    assert np.abs(rewards).max() < 1e-3


def test_disabled_autoreset():
    """An episode that has ended waits for a reset by `reset_mask`, which leaves the other fish where they are."""
    env = begun_batch(3, max_episode_steps=4, autoreset_mode="Disabled")
    assert env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    for action in actions(env, 4):
        obs, _, terminated, truncated, infos = env.step(action)
    assert truncated.all() and not terminated.any() and infos["_seconds"].all()
    with pytest.raises(gym.error.ResetNeeded, match="reset_mask"):
        env.step(env.action_space.sample())
    mask = np.array([True, False, True])
    after, _ = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[1], obs[1])
    assert (env.tank.time[mask] == 0).all() and env.tank.time[1] > 0


@each_mode
def test_blown_up_fish_leaves_its_neighbours_alone(mode):
    """A state that blows up ends that fish's episode with a reason, a finite observation and the penalty, no more."""

    def play(speed):
        env, seen = begun_batch(4, autoreset_mode=mode), []
        for k, action in enumerate(actions(env, 6)):
            if speed and k == 3:
                env.tank.velocity[2, 5] = speed
            seen.append(env.step(action))
            if mode is AutoresetMode.DISABLED and seen[-1][2].any():
                env.reset(options={"reset_mask": seen[-1][2]})
        return seen

    calm = play(0.0)
    for wild in (play(np.nan), play(1e6)):
        for a, b in zip(calm, wild, strict=True):
            np.testing.assert_array_equal(np.delete(a[0], 2, axis=0), np.delete(b[0], 2, axis=0))
            np.testing.assert_array_equal(np.delete(a[1], 2), np.delete(b[1], 2))
            assert np.isfinite(b[0]).all() and np.isfinite(b[1]).all()
        _, reward, terminated, truncated, infos = wild[3]
        assert terminated.tolist() == [False, False, True, False] and not truncated.any()
        assert reward[2] < -episode.FAILURE_PENALTY + 1
        failure = (infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos)["failure"][2]
        assert failure.split(":")[0] in ("non-finite", "torn", "untrusted solve")
        assert not wild[5][2].any()


def test_single_failure():
    """The single environment reports a failure of the physics in `info`, with a finite last observation."""
    env = begun(failure_penalty=3.0)
    env.unwrapped.tank.velocity[0, 3, 1] = np.inf
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert terminated is True and truncated is False and info["failure"].startswith("non-finite")
    assert np.isfinite(obs).all() and np.isfinite(reward)
    assert info["terms"]["failure"] == -3.0


def test_sb3_vec_env():
    """The native VecEnv hands over terminal observations and time limits as Stable-Baselines3 wants them."""
    pytest.importorskip("stable_baselines3")
    env = make_sb3_vec_env(SWIM, num_envs=3, seed=4, max_episode_steps=5, monitor=False)
    reference = gym.make_vec(SWIM, num_envs=3, max_episode_steps=5, autoreset_mode="SameStep")
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
    env.fish.tank.velocity[1] = np.nan
    _, _, done, infos = env.step(np.zeros((3, 12), dtype=np.float32))
    assert done.tolist() == [False, True, False]
    assert infos[1]["TimeLimit.truncated"] is False and infos[1]["failure"].startswith("non-finite")


@pytest.mark.parametrize("task", fish_env.TASKS)
def test_results_are_the_callers(task):
    """What a caller does to the arrays of `step` does not come back; summaries are Python's own numbers."""
    env = begun_batch(task=task)
    for action in actions(env, 3):
        _, reward, terminated, truncated, _ = env.step(action)
        assert not terminated.any() and not truncated.any() and np.isfinite(reward).all()
        terminated[:], truncated[:], reward[:] = True, True, np.nan
    assert {type(value) for value in env.episode_info(0).values()} <= {float, int, bool, dict, str}


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
        ({"task": ["swim"]}, "unknown task"),
        ({"depth": 3}, "unknown option .* 'depth'"),
        ({"dt": 0.0}, "dt is 0.0; give a positive"),
        ({"control_interval": 0.0201}, "whole multiple"),
        ({"water": {"law": "cubic"}}, "unknown water law 'cubic'"),
        ({"water": {"salt": 1.0}}, "give keywords of fish_env.make_water"),
        ({"muscle_groups": "all"}, "unknown muscle grouping 'all'"),
        ({"render_mode": "ascii"}, "unknown render_mode 'ascii'"),
        ({"heading_error": 9.0}, "heading_error is 9; give a number from 0 to 3.14159"),
        ({"speed": (2.0, 1.0)}, "lowest first"),
        ({"speed": True}, "speed is True; give a number"),
        ({"task": "turn", "angle": 4.0}, "angle is 4; give a number from 0.174533 to 3.14159"),
        ({"task": "left_after_right", "severity": 3.0}, "severity is 3; give a number from 0.1 to 2"),
        ({"task": "left_after_right", "reversals": True}, "reversals is True; give 1 or 2"),
        ({"task": "target", "dimensions": 2.0}, "dimensions is 2.0; give 2 or 3"),
        ({"task": "target", "distance": 0.3}, "distance is 0.3; give a number from 0.8 to 5"),
        ({"task": "avoid", "gap": (0.0, 1.0)}, "gap is 0; give a number from 0.2 to 5"),
        ({"effort_weight": -1.0}, "effort_weight is -1; give a number from 0 to 1000"),
        ({"effort_weight": np.nan}, "effort_weight"),
        ({"failure_penalty": "ten"}, "failure_penalty is 'ten'; give a number from 0 to 1000"),
        (
            {"task": "turn", "touch_penalty": 1.0},
            "'touch_penalty' .*; the task has angle, wait, alignment_weight",
        ),
        ({"variation": {"depth": 1.0}}, "unknown variation 'depth'; choose from stiffness"),
        ({"variation": {"mass": 0.0}}, "give a number from 0.5 to 2"),
        ({"variation": 0}, "variation is 0; give a dict"),
        ({"autoreset_mode": "foo"}, "unknown autoreset_mode 'foo'; choose from 'NextStep', 'SameStep', 'Disabled'"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"num_envs": 0}, "num_envs is 0; give a whole number, at least 1"),
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
    masks = (np.zeros(2, dtype=bool), np.ones(3, dtype=bool), [True, True], np.ones(2))
    for message, keywords in (
        ("unknown reset option 'wind'", {"options": {"wind": 1}}),
        *(("yaw", {"options": {"yaw": yaw}}) for yaw in (np.nan, "north", [1.0, 2.0])),
        (r"seed is .*; give one whole number, zero or more, or 2, one for each fish", {"seed": [1, 2, 3]}),
        (r"seed is 1.5; give a whole number, zero or more, or None", {"seed": 1.5}),
        ("options is 'abc'; give a dict", {"options": "abc"}),
        *(("reset_mask", {"options": {"reset_mask": mask}}) for mask in masks),
    ):
        with pytest.raises(ValueError, match=message):
            env.reset(**keywords)
    for name, value in env.tank.get_state().items():
        np.testing.assert_array_equal(value, before[name])


def test_vec_env_options():
    """A `VecEnv` refuses an autoreset mode and other environments; `info_every_step` fills its infos."""
    pytest.importorskip("stable_baselines3")
    with pytest.raises(ValueError, match="autoreset_mode cannot be chosen"):
        make_sb3_vec_env(SWIM, num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ValueError, match="'CartPole-v1' is a CartPoleVectorEnv; give an environment whose batches"):
        make_sb3_vec_env("CartPole-v1", num_envs=2)
    env = make_sb3_vec_env(SWIM, num_envs=2, seed=0, max_episode_steps=2, info_every_step=True)
    env.reset()
    infos = [env.step(np.zeros((2, 12)))[3][1] for _ in range(2)]
    assert all("step_terms" in info for info in infos) and "terms" in infos[1]


def test_actions_beyond_the_box_are_clipped():
    """An action outside [-1, 1] does what the nearest action inside does."""
    wild = np.linspace(-3, 3, 12)[None]
    np.testing.assert_array_equal(begun_batch(1).step(wild)[0], begun_batch(1).step(np.clip(wild, -1, 1))[0])


def test_pairs_keep_the_fish_level():
    """With left-right pairs a fish that starts without noise stays in its plane."""
    env = begun_batch(1, muscle_groups="pairs")
    env.tank.velocity[:] = 0.0
    for action in actions(env, 30):
        env.step(action)
    x = env.tank.position[0]
    np.testing.assert_allclose(x[[1, 2, 5, 6, 21]] * [1, 1, -1], x[[4, 3, 8, 7, 22]], atol=1e-12)  # upper and lower
