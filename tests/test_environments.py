"""The environments keep Gymnasium's and Stable-Baselines3's contracts, and a batch of fish is so many single fish.

One fish, a batch and the `VecEnv` give the same answers: to seeds, limits and calls, and in infos.
"""

import copy
import json
import subprocess
import sys
import warnings
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from gliding import ID
from gymnasium import wrappers
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as batched
from moving import tiered

import fish_env
from fish_env import BODIES, INTEGRATORS, make_fish, make_sb3_vec_env
from fish_env.envs import VARIATIONS, FishVectorEnv, episode
from fish_env.envs.stub import StubVectorEnv

IDS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))
SWIM, STUB = "FishEnv/Swim-v0", "FishEnv/Stub-v0"
each_mode = pytest.mark.parametrize("mode", list(AutoresetMode))
each_id = pytest.mark.parametrize("id", tiered([*ID.values(), *IDS], [*ID.values(), SWIM, STUB]))
"""Every task without physics; with physics one in every run, those of others are slow."""


def actions(env, steps, seed=0):
    """Random actions for so many steps of a batch."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)).astype(np.float32)


def sb3(id=STUB, num_envs=3, **options):
    """A `VecEnv` without a monitor."""
    pytest.importorskip("stable_baselines3")
    return make_sb3_vec_env(id, num_envs, monitor=False, **options)


def begun(id=SWIM, seed=0, **options):
    """A single environment at the beginning of an episode."""
    env = gym.make(id, **options)
    env.reset(seed=seed)
    return env


def begun_batch(num_envs=2, seed=0, make=FishVectorEnv, **options):
    """A batch at the beginning of its episodes."""
    env = make(num_envs, **options)
    env.reset(seed=seed)
    return env


@pytest.mark.parametrize("id", IDS)
def test_ids(id):
    """Every task of the table, and the stub, is registered, with a spec that can be written as JSON and read back."""
    names = {task.title().replace("_", "") for task in fish_env.TASKS} | {"Target3D"}
    assert set(IDS) == {f"FishEnv/{name}-v0" for name in names} | {STUB}
    spec = gym.spec(id)
    assert json.loads(spec.to_json())["id"] == id
    assert gym.make(type(spec).from_json(spec.to_json())).observation_space == gym.make(id).observation_space
    elsewhere = copy.deepcopy(spec)
    elsewhere.id = "Elsewhere/Fish-v0"
    assert gym.make(elsewhere).observation_space == gym.make(id).observation_space, "it need not be registered"


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
def test_unknown_keywords_are_unknown_to_others_too(error):
    """An unknown keyword is Python's TypeError in words and kind, which libraries that try keywords look for."""
    for make in (gym.make, gym.make_vec):
        with pytest.raises(error, match="unexpected keyword argument 'frameskip'"):
            make(SWIM, frameskip=1)


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


@each_id
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_batch_equals_singles(id, mode):
    """A batch seeded s is Gymnasium's batch of single fish seeded s + i, bit for bit, over a restart."""
    batch = gym.make_vec(id, 3, max_episode_steps=6, autoreset_mode=mode)
    mode = batch.metadata["autoreset_mode"]
    singles = gym.vector.SyncVectorEnv([lambda: gym.make(id, max_episode_steps=6)] * 3, autoreset_mode=mode)
    np.testing.assert_array_equal(batch.reset(seed=11)[0], singles.reset(seed=11)[0])
    ends = 0
    for action in actions(batch, 10):
        *found, infos = batch.step(action)
        *expected, wanted = singles.step(action)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
        assert infos.keys() == wanted.keys()
        ends += np.count_nonzero(found[2] | found[3])
    assert ends >= 3, "no episode ended: the restart was not tested"


@each_id
def test_observations(id):
    """Observations are finite, fresh, float32, inside their space, and no element is constant."""
    env, seen, swims = gym.make(id), [], id in IDS and id != STUB
    for seed in range(4):  # an episode may lack what a task only sometimes has, such as an obstacle that moves
        seen.append(env.reset(seed=seed)[0])
        for action in actions(env, gym.spec(id).max_episode_steps - 1 if swims else 3, seed):
            seen.append(env.step(action)[0])
    assert all(env.observation_space.contains(obs) for obs in seen)
    assert not any(np.shares_memory(a, b) for a, b in pairwise(seen))
    if swims:  # others are stiff
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


@pytest.mark.parametrize("name", [name for name, record in INTEGRATORS.items() if record.kind != "adaptive"])
def test_default_steps_divide_any_control_interval(name):
    """They are those of the fish's own interval there, and no longer elsewhere."""
    own = fish_env.Tank(make_fish(), integrator=name).dt
    for interval in (0.01, 0.02, 0.03, 0.05, 0.25):
        env = FishVectorEnv(1, integrator=name, control_interval=interval)
        assert env._substeps * env.tank.dt == pytest.approx(interval, rel=1e-12) and env.tank.dt < 1.1 * own
        if interval == 0.02:
            assert env.tank.dt == own


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
        ({"water": {"salt": 1.0}}, "make_water has no keyword 'salt'; choose from 'density'"),
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
        ({"variation": {"depth": 1.0}}, "unknown variation 'depth' .*; choose from 'stiffness'"),
        ({"variation": {"mass": 0.0}}, "give a number from 0.5 to 2"),
        ({"variation": 0}, "variation is 0; give a dict"),
        ({"autoreset_mode": "foo"}, "unknown autoreset_mode 'foo'; choose from 'NextStep', 'SameStep', 'Disabled'"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"num_envs": 0}, "num_envs is 0; give a whole number, at least 1"),
        ({"max_episode_steps": 2**70}, "max_episode_steps is 1180591620717411303424; give a whole number"),
        ({"control_interval": 1e308}, "give at most 9007199254740992 steps"),
        ({"control_interval": 10**400}, "control_interval is 10+; give a positive number"),
        ({"water": {"density": 1e308, "drag_coefficient": 1e308}}, "is infinite; give less"),
        ({"dt": 1e300}, "dt is 1e.300; give a positive number of seconds, at least 1e-12 and at most 1e.09"),
        ({"dt": 10**400}, "dt is 10+; give"),
        ({"lanes": 8.0}, "lanes is 8.0"),
        ({"speed": np.array(0.5 + 1j)}, "speed is .*give finite numbers"),
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
    """A `VecEnv` refuses an autoreset mode and other environments."""
    pytest.importorskip("stable_baselines3")
    with pytest.raises(ValueError, match="autoreset_mode cannot be chosen"):
        make_sb3_vec_env(SWIM, num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ValueError, match="'CartPole-v1' is a CartPoleVectorEnv; give an environment whose batches"):
        make_sb3_vec_env("CartPole-v1", num_envs=2)


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


def test_no_limit(monkeypatch):
    """-1 means no limit, as `gym.make` has it."""
    monkeypatch.setattr(gym.spec(STUB), "max_episode_steps", 5)
    for env in (gym.make_vec(STUB, 2, max_episode_steps=-1), SyncVectorEnv([lambda: gym.make(STUB, -1)] * 2)):
        env.reset(seed=0)
        assert not any(env.step(env.action_space.sample())[3].any() for _ in range(8))
    assert gym.make_vec(STUB, 2, max_episode_steps=-1).unwrapped.max_episode_steps is None


def test_calls():
    """`call`, `get_attr` and `set_attr` of the batch answer as Gymnasium's batch of single fish does."""
    batch, own = gym.make_vec(STUB, 3), SyncVectorEnv([lambda: gym.make(STUB)] * 3)
    for env in (batch, own):
        env.reset(seed=4)
    for name in ("observation_space", "action_space", "render_mode", "np_random_seed"):
        assert batch.get_attr(name) == own.get_attr(name) == batch.call(name)
    assert batch.call("episode_info") == own.call("episode_info")
    begun = [env.call("reset", seed=7, options={"yaw": 0.5}) for env in (batch, own)]
    for one, other in zip(*begun, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1] == {}
    for env in (batch, own):
        with pytest.raises(ValueError, match="value"):
            env.set_attr("heading_error", [0.1, 0.2])
    with pytest.raises(ValueError, match="give one value, or 3 that are the same"):
        batch.set_attr("heading_error", (0.1, 0.2, 0.3))


def test_attributes_of_a_vec_env_are_not_called():
    """`get_attr` and `has_attr` return a method, and do not restart or close the batch by it."""
    env = sb3()
    env.seed(0)
    env.reset()
    env.step(np.ones((3, 12)))
    before = env.fish.tank.time.copy()
    assert env.has_attr("reset") and env.has_attr("close") and not env.has_attr("nothing")
    assert [method.__name__ for method in env.get_attr("step", [0, 2])] == ["step"] * 2
    np.testing.assert_array_equal(env.fish.tank.time, before)


def test_the_action_of_a_fish_that_restarts_is_ignored():
    """In the step after the end of an episode, whatever it is."""
    env = begun_batch(make=StubVectorEnv, max_episode_steps=1)
    env.step(np.zeros((2, 12)))
    assert not env.step(np.full((2, 12), np.nan))[1].any()
    with pytest.raises(ValueError, match="action"):
        env.step(np.full((2, 12), np.nan))


def test_the_last_step_has_a_summary_whatever_set_the_limit():
    """A limit that is set while an episode runs, and a state that is later than the limit."""
    env, late = begun(STUB), begun(STUB, max_episode_steps=3)
    for _ in range(3):
        env.step(np.zeros(12))
    late.unwrapped.set_state(env.unwrapped.get_state())
    env.set_wrapper_attr("_max_episode_steps", 4)
    for each in (env, late):
        *_, truncated, info = each.step(np.zeros(12))
        assert truncated and "speed" in info


def test_an_episode_is_summed_up_after_a_reset_only():
    """Before it there is none, and nothing has succeeded."""
    for env in (gym.make(ID["turn"]).unwrapped, gym.make_vec(ID["turn"], 2)):
        with pytest.raises(gym.error.ResetNeeded, match="has no episode before reset"):
            env.call("episode_info") if hasattr(env, "call") else env.episode_info()


def test_stub_observes_its_commands():
    """The rest lengths that its fish observe are those of the action."""
    env, action = begun(STUB), np.linspace(-1, 1, 12)
    np.testing.assert_allclose(env.unwrapped.layout.read(env.step(action)[0], "rest length"), action, atol=1e-6)


def test_methods_of_some_fish():
    """`env_method` acts on the fish that are meant alone, or is refused."""
    env = sb3()
    env.seed(0)
    env.reset()
    env.step(np.ones((3, 12)))
    before = env.fish.tank.time.copy()
    ((obs, info),) = env.env_method("reset", indices=[1], seed=5)
    assert env.fish.tank.time.tolist() == [before[0], 0.0, before[2]] and info == {}
    np.testing.assert_array_equal(obs, gym.make(STUB).reset(seed=5)[0])
    assert len(env.env_method("episode_info", indices=[0, 2])) == 2
    for name in ("stagger", "close", "observe"):
        with pytest.raises(ValueError, match=f"{name} acts on all fish"):
            env.env_method(name, indices=[1])
        assert len(env.env_method(name)) == 3
    with pytest.raises(ValueError, match="share their attributes"):
        env.set_attr("heading_error", 0.1, indices=[1])


@pytest.mark.parametrize("seed", [np.int64(3), np.uint8(3), 3, True, 0, 2**80])
def test_seeds(seed):
    """A whole number is a seed everywhere, and the same one."""
    single, batch, vec = gym.make(STUB), gym.make_vec(STUB, 1), sb3(num_envs=1)
    vec.seed(seed)
    wanted = gym.make(STUB).reset(seed=int(seed))[0]
    for found in (single.reset(seed=seed)[0], batch.reset(seed=seed)[0][0], vec.reset()[0],
                  batch.reset(seed=[seed])[0][0]):  # fmt: skip
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("seed", [-1, np.int64(-1), 1.5, np.array(3), "3", np.bool_(True), np.timedelta64(3), {}, 3j])
def test_seeds_that_are_not_allowed(seed):
    """Anything else is refused with one error, and the generators stay."""
    single, batch, vec = gym.make(STUB), gym.make_vec(STUB, 2), sb3(num_envs=2)
    for env, seeded, fish in ((single, single.reset, single.unwrapped.fish), (batch, batch.reset, batch.unwrapped),
                              (vec, vec.seed, vec.fish)):  # fmt: skip
        env.reset()
        before = repr([generator.bit_generator.state for generator in fish.np_random])
        for error in (gym.error.Error, ValueError):
            with pytest.raises(error, match=r"seed is .*; give .*whole number, zero or more"):
                seeded(seed=seed)
        assert repr([generator.bit_generator.state for generator in fish.np_random]) == before
    with pytest.raises(gym.error.Error, match="seed is"):
        batch.reset(seed=[0, seed])


# Infos


def reset_ended(envs, over):
    """Reset the fish of batches whose episodes are over, if they do not restart by themselves."""
    for env in envs:
        if env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and over.any():
            env.reset(options={"reset_mask": over})


def plain(infos):
    """The infos of a batch, their arrays as texts with the types of objects; NaN equals NaN there."""
    if isinstance(infos, dict):
        return {key: plain(value) for key, value in infos.items()}
    return f"{infos.dtype} {[(type(each), np.asarray(each).tolist()) for each in infos]}"


@each_mode
@pytest.mark.parametrize("every", [False, True])
@pytest.mark.parametrize("id", [STUB, ID["avoid"], ID["target"]])
def test_infos(id, every, mode):
    """The infos of the batch are those of Gymnasium's own batch of single fish, key by key, over ends of episodes."""
    native = gym.make_vec(id, 3, info_every_step=every, autoreset_mode=mode)
    own = SyncVectorEnv([lambda: gym.make(id, max_episode_steps=10**6, info_every_step=every)] * 3, autoreset_mode=mode)
    for i, (steps, env) in enumerate(zip((3, 5, 4), own.envs, strict=True)):
        env.set_wrapper_attr("_max_episode_steps", steps)
        native.unwrapped._limit[i] = steps
    obs, begun = zip(*(env.reset(seed=1) for env in (native, own)), strict=True)
    assert plain(begun[0]) == plain(begun[1]) and bool(begun[0]) == every
    native.unwrapped._limit[:] = 3, 5, 4
    ended = 0
    for action in np.random.default_rng(0).uniform(-1, 1, (5, *native.action_space.shape)).astype(np.float32):
        (*one, infos), (*other, wanted) = native.step(action), own.step(action)
        for mine, its in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, its)
        assert plain(infos) == plain(wanted)
        ended += np.sum(one[2] | one[3])
        reset_ended((native, own), one[2] | one[3])
        native.unwrapped._limit[:] = 3, 5, 4  # one limit a fish
    assert ended >= 3 and len(obs) == 2


@pytest.mark.parametrize("id", ID.values())
def test_infos_of_one_shape(id):
    """With `info_every_step`, every reset and step has all keys but numbers that do not exist yet, of the same types.

    A `VecEnv` adds what Stable-Baselines3 wants at the end of an episode. There every path says why it failed, "" if it
    did not, and whether it succeeded, where a task says so.
    """

    def shape(info):
        own = info.keys() - {"terminal_observation", "TimeLimit.truncated"}
        return {
            key: shape(info[key]) if isinstance(info[key], dict) else np.asarray(info[key]).dtype.kind for key in own
        }

    options = {"max_episode_steps": 3, "info_every_step": True}
    one, vec, shapes = gym.make(id, **options), sb3(id, 2, **options), []
    for _ in range(2):
        shapes.append(shape(one.reset()[1]))
        shapes += [shape(one.step(one.action_space.sample())[4]) for _ in range(3)]
    assert one.reset()[1]["term_progress"] == 0.0
    vec.reset()
    for step in range(7):
        infos = vec.step(np.zeros((2, 12), dtype=np.float32))[3]
        shapes += [shape(info) for info in (*infos, *vec.reset_infos)]
        assert infos[0]["seconds"] == pytest.approx(0.02 * (step % 3 + 1)) and vec.reset_infos[0]["seconds"] == 0.0
        assert infos[0]["term_effort"] == infos[0]["step_terms"]["effort"]
        if step % 3 == 2:
            one = infos[1]
            assert one["failure"] == "" and one.get("is_success") == one.get("success")
    assert shapes[0]["failure"] == "U" and shapes[3].keys() == set().union(*shapes)  # at the end all, NaN among them
    for each in shapes:
        assert each.items() <= shapes[3].items() and {shapes[3][key] for key in shapes[3].keys() - each} <= {"f"}


# Water


WATERS = {  # what is named, and the fields of the fish's own water that it changes
    "nothing": ({}, set()),
    "what is there": ({"current": (0, 0, 0), "inertia": True, "density": 1000}, set()),
    "drag": ({"drag_coefficient": 2.0}, {"quadratic"}),
    "no inertia": ({"inertia": False}, {"added_mass", "righting"}),
    "upright": ({"inertia": False, "righting": 0.01}, {"added_mass", "righting"}),
    "density": ({"density": 500}, {"quadratic", "added_mass", "friction"}),
    "no friction": ({"friction": 0.0}, {"friction"}),
    "viscosity": ({"viscosity": 4e-6}, {"friction"}),
    "law": ({"law": "linear"}, {"quadratic", "linear", "oblique"}),
    "all flow": ({"law": "quadratic"}, {"oblique"}),
    "thinning": ({"thinning": 2.0}, {"thinning"}),
    "current": ({"current": (0.1, 0.0, 0.0)}, {"current"}),
}


@pytest.mark.parametrize("case", WATERS)
def test_water_changes_what_it_names(case):
    """A dictionary of water keeps, bit for bit, what it does not name of the fish's own water."""
    given, changed = WATERS[case]
    own, found = make_fish().water, gym.make(SWIM, water=given).unwrapped.tank.world
    assert {name for name in own._fields if not np.array_equal(getattr(own, name), getattr(found, name))} == changed
    if case == "density":
        for name in changed:
            np.testing.assert_allclose(getattr(found, name), 0.5 * np.asarray(getattr(own, name)), rtol=1e-15)


def test_water_that_changes_nothing():
    """A keyword that would have no effect is refused."""
    for given in ({"added_mass": (2.0, 1.0), "inertia": False}, {"viscosity": 4e-6, "friction": 0.0},
                  {"thinning": 1.0, "friction": 0.0}):  # fmt: skip
        with pytest.raises(ValueError, match="changes nothing in water without"):
            gym.make(SWIM, water=given)


# Checks by others

IDS_OTHER_CHECKS = sorted(id for id in gym.registry if id.startswith("FishEnv/"))
OPTIONS = {
    "variation": {"variation": {name: (option.low, option.high) for name, option in VARIATIONS.items()}},
    "interval": {"control_interval": 0.04},
    "limit": {"max_episode_steps": 2},
    "linear water": {"water": {"law": "linear", "drag_coefficient": 500.0, "current": (0.1, 0.0, 0.0)}},
    "vacuum": {"water": {"density": 0.0}},
    "float32": {"dtype": "float32"},
    "one lane": {"lanes": 1},
    "threads": {"threads": 2},
    "no refinement": {"refine": float("inf")},
}
"""Keywords that every environment takes, one at a time."""
OF_TASKS = {
    "speed": ("FishEnv/Swim-v0", {"speed": (0.5, 1.5)}),
    "angle": ("FishEnv/Turn-v0", {"angle": 1.0}),
    "severity": ("FishEnv/LeftAfterRight-v0", {"severity": 1.0, "reversals": 2}),
    "dimensions": ("FishEnv/Target-v0", {"dimensions": 3, "radius": 0.3}),
    "sweeping": ("FishEnv/Avoid-v0", {"sweeping": 1.0, "drift": 2.0, "turning": 0.0}),
}
"""Keywords of single tasks."""
CASES = {f"Swim-v0 {name}": ("FishEnv/Swim-v0", keywords) for name, keywords in OPTIONS.items()}
CASES |= {f"Swim-v0 {name}": ("FishEnv/Swim-v0", {"body": name}) for name in BODIES}
CASES |= {f"Swim-v0 {name}": ("FishEnv/Swim-v0", {"integrator": name}) for name in INTEGRATORS}
CASES |= {f"{id[8:]} pairs": (id, {"muscle_groups": "pairs"}) for id in IDS_OTHER_CHECKS}
CASES |= {f"{id[8:]} info": (id, {"info_every_step": True}) for id in IDS_OTHER_CHECKS}
CASES |= {f"{id[8:]} {name}": (id, keywords) for name, (id, keywords) in OF_TASKS.items()}
SURE = [f"Swim-v0 {name}" for name in ("variation", "limit", "threads", "speed", "mass_spring")]
SURE += [f"{id[8:]} {name}" for id in IDS_OTHER_CHECKS for name in ("pairs", "info")]
"""Those that other tests compile the kernels of anyway."""


each_case = pytest.mark.parametrize("case", tiered(CASES, SURE))
each_id_of_other_checks = pytest.mark.parametrize("id", tiered(IDS_OTHER_CHECKS, ("FishEnv/Swim-v0",)))


def made(case):
    """The environment of a case."""
    id, keywords = CASES[case]
    try:
        return gym.make(id, **keywords, disable_env_checker=True)
    except ValueError as error:
        pytest.skip(str(error))  # a method that has no stable step on a body, or a flat fish that is to roll


@each_case
@pytest.mark.parametrize("checker", ["gymnasium.utils", "stable_baselines3.common"])
def test_checkers(checker, case):
    """The environment checkers of Gymnasium and Stable-Baselines3 have nothing to say: a warning is an error."""
    check = pytest.importorskip(f"{checker}.env_checker").check_env
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(made(case).unwrapped, skip_render_check=case != "Swim-v0 mass_spring")


@pytest.mark.parametrize("id", IDS_OTHER_CHECKS)
def test_infos_are_equal(id):
    """With `info_every_step`, infos of the same fish are equal as Gymnasium's tests compare them: none is NaN."""
    make = {"one": gym.make, "batch": lambda id, **options: gym.make_vec(id, 2, **options)}
    for maker in make.values():
        envs = [maker(id, info_every_step=True) for _ in range(2)]
        infos = [env.reset(seed=5)[1] for env in envs]
        for step in range(min(80, gym.spec(id).max_episode_steps - 1)):
            assert data_equivalence(*infos) and infos[0]
            action = np.full(envs[0].action_space.shape, (-1.0) ** (step // 6), dtype=np.float32)
            infos = [env.step(action)[4] for env in envs]


# Wrappers

ZERO, ONE = np.float32([0.0, 1.0])
BASIC = {
    "ClipAction": {}, "ClipReward": {"min_reward": -1.0, "max_reward": 1.0}, "DtypeObservation": {"dtype": np.float16},
    "FlattenObservation": {}, "NormalizeObservation": {}, "NormalizeReward": {}, "RecordEpisodeStatistics": {},
    "RescaleAction": {"min_action": ZERO, "max_action": ONE}, "RescaleObservation": {"min_obs": ZERO, "max_obs": ONE},
}  # fmt: skip
"""Keywords of Gymnasium's wrappers, for one environment and for batches; not those of pictures and functions."""
OF_ONE = BASIC | {
    "Autoreset": {}, "DelayObservation": {"delay": 2}, "DiscretizeAction": {"bins": 2, "multidiscrete": True},
    "DiscretizeObservation": {"bins": 3, "multidiscrete": True}, "FrameStackObservation": {"stack_size": 3},
    "MaxAndSkipObservation": {"skip": 2}, "OrderEnforcing": {}, "PassiveEnvChecker": {},
    "RepeatAction": {"num_repeats": 2}, "StickyAction": {"repeat_action_probability": 0.5}, "TimeAwareObservation": {},
    "TimeLimit": {"max_episode_steps": 3},
}  # fmt: skip
says_lowered = pytest.mark.filterwarnings("ignore:.*precision lowered by casting to float16")


def check_same(answers):
    """Two lists of answers have the same bits."""
    for one, other in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, other)


@says_lowered
@pytest.mark.parametrize("name", [name for name in OF_ONE if hasattr(wrappers, name)])
@each_id_of_other_checks
def test_wrappers(id, name):
    """Wrapped in each, two environments answer alike, within the wrapper's spaces, over the ends of episodes."""
    answers = []
    for _ in range(2):
        env = getattr(wrappers, name)(gym.make(id, max_episode_steps=5), **OF_ONE[name])
        env.action_space.seed(1)
        obs, _ = env.reset(seed=4)
        answers.append([obs])
        for _ in range(12):
            assert env.observation_space.contains(obs), name
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            answers[-1] += [obs, reward, terminated, truncated]
            assert np.isfinite(reward) and np.isfinite(obs).all()
            if (terminated or truncated) and name != "Autoreset":
                obs, _ = env.reset()
    check_same(answers)


@says_lowered
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("name", [*BASIC, "DictInfoToList"])
@each_id_of_other_checks
def test_wrappers_of_batches(id, name, mode):
    """Wrapped in each wrapper for batches, the native batch answers as Gymnasium's own batch of single fish does."""
    answers = []
    native = gym.make_vec(id, 3, max_episode_steps=4, autoreset_mode=mode)
    mode = native.metadata["autoreset_mode"]
    own = gym.vector.SyncVectorEnv([lambda: gym.make(id, max_episode_steps=4)] * 3, autoreset_mode=mode)
    if "Observation" in name and mode is gym.vector.AutoresetMode.SAME_STEP:
        pytest.skip("Gymnasium's wrappers of observations take no batches that restart in the same step")
    for batch in (native, own):
        env = getattr(batched, name)(batch, **BASIC.get(name, {}))
        env.action_space.seed(1)
        wrong = name == "NormalizeObservation" and env.observation_space == batch.observation_space  # Gymnasium 1.2's
        answers.append([env.reset(seed=4)[0]])
        for _ in range(10):
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            assert wrong or env.observation_space.contains(obs)
            answers[-1] += [obs, reward, terminated, truncated]
    check_same(answers)
