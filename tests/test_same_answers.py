"""One fish, a batch and the `VecEnv` give the same answers: to seeds, limits, attributes, odd arrays, and in infos."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import fish_env
from fish_env import Tank, make_fish, make_sb3_vec_env
from fish_env.control import load_policy, record, replay, shipped_policy
from fish_env.envs import FishEnv, FishVectorEnv

ID = "FishEnv/LeftAfterRight-v0"
STUB = "FishEnv/Stub-v0"
TASK_IDS = [f"FishEnv/{task.title().replace('_', '')}-v0" for task in fish_env.TASKS]
MODES = list(AutoresetMode)


def sb3(id=STUB, num_envs=3, **options):
    """A `VecEnv` without a monitor."""
    pytest.importorskip("stable_baselines3")
    return make_sb3_vec_env(id, num_envs, monitor=False, **options)


# What can be set while it runs


def setters(id=STUB, **options):
    """Each kind of environment, by how one of its options is set."""
    single, batch = gym.make(id, **options), gym.make_vec(id, 3, **options)
    vec, own = sb3(id, **options), SyncVectorEnv([lambda: gym.make(id, **options)] * 3)
    return {
        "single": (single, single.set_wrapper_attr), "batch": (batch, batch.set_attr),
        "VecEnv": (vec, vec.set_attr), "SyncVectorEnv": (own, own.set_attr),
    }  # fmt: skip


OF_TASKS = {
    "Swim": {"heading_error": 0.0},
    "Turn": {"angle": 0.5, "wait": 3.0},
    "LeftAfterRight": {"angle": 1.5, "severity": 0.2, "part": 0.9, "dwell": 0.5, "wait": 3.0, "reversals": 2},
    "Target": {"distance": 4.0, "bearing": 0.1},
    "FastStart": {"angle": 1.5, "speed": 2.5, "wait": 3.0},
    "Avoid": {"gap": 4.0, "aside": 0.0, "drift": 2.5, "sweeping": 1.0, "turning": 1.0, "angle": 0.3, "wait": 5.0},
}


def drawn(env):
    """What the task of a batch has drawn for its fish, as bytes."""
    task = env.unwrapped.fish if hasattr(env.unwrapped, "fish") else env.unwrapped
    return pickle.dumps({k: v for k, v in vars(task.task).items() if isinstance(v, np.ndarray | tuple)})


@pytest.mark.parametrize(("task", "name"), [(task, name) for task, options in OF_TASKS.items() for name in options])
def test_options_of_tasks(task, name):
    """What is set counts from the next episodes on, as if the environment had been made with it, bit for bit."""
    id, value = f"FishEnv/{task}-v0", OF_TASKS[task][name]
    env, wanted = gym.make_vec(id, 4), gym.make_vec(id, 4, **{name: value})
    assert name in env.unwrapped.settable
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


@pytest.mark.parametrize("name", ["severty", "tank", "render_mode", "task", "num_envs", "control_interval", "_limit"])
def test_other_names_are_refused(name):
    """A misspelt name, or one that would change nothing, is refused everywhere, and what can be set is listed."""
    for env, set_attr in setters(ID).values():
        with pytest.raises(AttributeError, match=r"choose from .*'severity'|has no setter"):
            set_attr(name, 1.5)
        env.close()
    for get in (gym.make_vec(ID, 2).get_attr, sb3(ID).get_attr, gym.make_vec(ID, 2).call):
        with pytest.raises(AttributeError):
            get("severty")


def test_attributes_of_subclasses():
    """What a subclass keeps may be set as in any environment; a batch names it in `LIVE`."""

    class Weighted(FishEnv):
        def __init__(self, **options):
            super().__init__(**options)
            self.weight = 1.0

    class Batch(FishVectorEnv):
        LIVE = (*FishVectorEnv.LIVE, "weight")

    env, batch = SyncVectorEnv([Weighted] * 2), Batch(2)
    for each in (env, batch):
        each.set_attr("weight", 2.0)
        assert each.get_attr("weight") == (2.0, 2.0)
        with pytest.raises(AttributeError, match="choose from"):
            each.set_attr("weigth", 2.0)


@pytest.mark.parametrize(("name", "value"), [
    ("severity", 9.0), ("severity", "hard"), ("angle", (2.0, 1.0)), ("variation", {"depth": 1.0}), ("variation", 3),
    ("info_every_step", 1), ("reversals", 3), ("effort_weight", -0.1), ("failure_penalty", np.nan),
])  # fmt: skip
def test_values_that_are_not_allowed(name, value):
    """A value that no environment could be made with is refused, and nothing is changed."""
    for kind, (env, set_attr) in setters(ID).items():
        with pytest.raises(ValueError):
            set_attr(name, [value] * 3 if kind in ("batch", "SyncVectorEnv") else value)
        env.close()


@pytest.mark.parametrize("steps", [0, -5, 1.5, True, "3", 2**70])
def test_limits_that_are_not_allowed(steps):
    """A time limit that is not allowed is refused the same way wherever it is set; of one fish, at the next reset."""
    env, batch, vec, name = gym.make(STUB), gym.make_vec(STUB, 2), sb3(), "max_episode_steps"
    env.set_wrapper_attr("_max_episode_steps", steps)
    if steps != 2**70:  # which one fish may have: it is never reached
        with pytest.raises(ValueError, match="max_episode_steps is"):
            env.reset(seed=0)
    for change in (
        lambda: gym.make_vec(STUB, 2, max_episode_steps=steps), lambda: batch.set_attr(name, steps),
        lambda: vec.set_attr(name, steps), lambda: FishVectorEnv(1, max_episode_steps=4).set_attr(name, steps),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"max_episode_steps is .*; give a whole number, at least 1"):
            change()


def test_limits_that_are_set():
    """Another time limit counts from the next episodes on, in every kind of environment."""
    batch, vec = gym.make_vec(STUB, 3, max_episode_steps=5), sb3(max_episode_steps=5)
    single, own = gym.make(STUB), SyncVectorEnv([lambda: gym.make(STUB)] * 3)
    for env, change, name in ((batch, batch.set_attr, "max_episode_steps"), (vec, vec.set_attr, "max_episode_steps"),
                              (single, single.set_wrapper_attr, "_max_episode_steps"),
                              (own, own.set_attr, "_max_episode_steps")):  # fmt: skip
        change(name, 2)
        env.reset()
        action = np.zeros(12 if env is single else (3, 12))
        over = [np.any(env.step(action)[-2]) for _ in range(2)]
        assert over == [False, True], name
    with pytest.raises(AttributeError, match="give '_max_episode_steps'"):
        single.set_wrapper_attr("max_episode_steps", 2)
    kept = record(single, lambda obs, time: np.zeros(12), 0)
    assert kept.steps == 2


def test_no_limit():
    """-1 means no limit, as `gym.make` has it."""
    for env in (gym.make_vec(STUB, 2, max_episode_steps=-1), SyncVectorEnv([lambda: gym.make(STUB, -1)] * 2)):
        env.reset(seed=0)
        assert not any(env.step(env.action_space.sample())[3].any() for _ in range(260))
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


# Seeds


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


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("every", [False, True])
@pytest.mark.parametrize("id", [STUB, "FishEnv/Avoid-v0", "FishEnv/Target-v0"])
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


@pytest.mark.parametrize("id", TASK_IDS)
def test_infos_of_one_shape(id):
    """With `info_every_step`, every reset and step has all keys but numbers that do not exist yet, of the same types.

    A `VecEnv` adds what Stable-Baselines3 wants at the end of an episode.
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
    assert shapes[0]["failure"] == "U" and shapes[3].keys() == set().union(*shapes)  # at the end all, NaN among them
    for each in shapes:
        assert each.items() <= shapes[3].items() and {shapes[3][key] for key in shapes[3].keys() - each} <= {"f"}


@pytest.mark.parametrize("id", TASK_IDS)
def test_failure_and_success(id):
    """Every end of an episode says why it failed, "" if it did not, and whether it succeeded, where a task says so."""
    options = {"max_episode_steps": 2}
    envs = gym.make(id, **options), gym.make_vec(id, 2, **options), sb3(id, 2, **options)
    for env in envs:
        env.reset()
        for _ in range(2):
            *_, info = env.step(np.zeros(12 if env is envs[0] else (2, 12), dtype=np.float32))
        if env is envs[1]:
            assert info["failure"].tolist() == ["", ""] and info["failure"].dtype == object
        else:
            one = info[1] if env is envs[2] else info
            assert one["failure"] == "" and ("is_success" in one) == ("success" in one)
            assert one.get("is_success") == one.get("success")


def test_a_reason_beside_none():
    """Where one fish fails and another does not, the batch has the reason whole, and "" beside it."""
    env = gym.make_vec("FishEnv/Swim-v0", 3, max_episode_steps=1)
    env.reset(seed=0)
    env.unwrapped.tank.velocity[1] = np.nan
    *_, infos = env.step(np.zeros((3, 12)))
    assert infos["failure"][0] == infos["failure"][2] == "" and infos["failure"][1].startswith("non-finite")
    assert infos["_failure"].all()


def test_monitors_of_stable_baselines3():
    """`VecMonitor` and `Monitor` keep `failure`, and evaluation reports the rate of success."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

    own = DummyVecEnv([lambda: Monitor(gym.make(ID, max_episode_steps=2), info_keywords=("failure", "is_success"))])
    native = VecMonitor(sb3(ID, 2, max_episode_steps=2), info_keywords=("failure", "is_success"))
    for env in (own, native):
        env.reset()
        for _ in range(2):
            *_, infos = env.step(np.zeros((env.num_envs, 12)))
        assert infos[0]["episode"]["failure"] == "" and infos[0]["episode"]["is_success"] is False
    evaluation = EvalCallback(native, n_eval_episodes=2, eval_freq=8, verbose=0)
    model = PPO("MlpPolicy", VecMonitor(sb3(ID, 2)), n_steps=8, batch_size=8, n_epochs=1, device="cpu")
    model.learn(16, evaluation)
    assert evaluation._is_success_buffer == [False, False]


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
    value, change = copy.deepcopy(MUTABLE[case])
    name, wanted = case.split(",")[0], repr(value)
    env, batch = gym.make("FishEnv/Swim-v0", **{name: value}), gym.make_vec("FishEnv/Swim-v0", 2, **{name: value})
    change(value)
    assert replay(record(env, np.zeros((2, 12)), 3)).same
    assert repr(env.unwrapped.spec.kwargs[name]) == repr(batch.spec.kwargs[name]) == wanted


def test_recordings_of_what_was_set():
    """What has been set while the environment runs is recorded too."""
    env = gym.make(ID, variation={"mass": 1.0})
    record(env, np.zeros((2, 12)), 0)
    for name, value in (("severity", 0.2), ("variation", {"mass": 1.3})):
        env.set_wrapper_attr(name, value)
    kept = record(env, np.zeros((2, 12)), 0)
    assert replay(kept).same and kept.about["env_options"]["severity"] == 0.2
    env.unwrapped.fish.set_attr("effort_weight", 0.7)
    kept = record(env, np.zeros((2, 12)), 0)
    assert replay(kept).same and kept.about["env_options"]["effort_weight"] == 0.7
    assert pickle.loads(pickle.dumps(env.unwrapped)).fish.changed == copy.deepcopy(env.unwrapped).fish.changed


# Odd arrays


@pytest.mark.parametrize("name", ["FishEnv.step", "FishVectorEnv.step", "FishVecEnv.step", "Tank.swim", "Tank.drive",
                                  "Policy"])  # fmt: skip
def test_odd_arrays(name):
    """What is under a mask, complex or needs a gradient is refused everywhere by a ValueError; bfloat16 is taken."""
    torch = pytest.importorskip("torch")
    single, batch, vec = gym.make(STUB).unwrapped, FishVectorEnv(1), sb3(num_envs=1)
    for env in (single, batch, vec):
        env.reset()
    tank, policy = Tank(make_fish(), 1), load_policy(shipped_policy("swim"))
    call = {
        "FishEnv.step": lambda a: single.step(a[0]), "FishVectorEnv.step": batch.step, "FishVecEnv.step": vec.step,
        "Tank.swim": lambda a: tank.swim(a, tank.dt), "Tank.drive": lambda a: tank.drive(a, 1), "Policy": policy,
    }[name]  # fmt: skip
    plain = np.full((1, 156 if name == "Policy" else 12), 0.25)
    mask = np.zeros(plain.shape, dtype=bool)
    call(plain)
    call(np.ma.array(plain, mask=mask))
    for dtype in (torch.float32, torch.float64, torch.bfloat16, torch.float16):
        call(torch.from_numpy(plain).to(dtype))
    mask[0, 3] = True
    grad = torch.full(plain.shape, 0.25, requires_grad=True)
    for odd in (np.ma.array(plain, mask=mask), np.ma.array(plain, mask=True), grad, grad * 1.0,
                torch.nn.Parameter(grad.detach()), grad.to(torch.bfloat16), grad.detach().to(torch.complex64),
                grad.detach().to("meta"), grad.detach().to_sparse(), plain + 0j, plain.astype(str)):  # fmt: skip
        with pytest.raises(ValueError):
            call(odd)
    with pytest.raises(ValueError, match="detach"):
        call(grad)


# Pictures


@pytest.mark.parametrize("interval", [0.4, 1.5, 0.02, 1 / 30])
def test_rate_of_pictures(interval):
    """The rate of pictures is the exact inverse of the control interval, in every kind of environment."""
    interval = round(interval / 0.0025) * 0.0025
    for make in (gym.make, lambda id, **options: gym.make_vec(id, 2, **options), sb3):
        assert make(STUB, control_interval=interval).metadata["render_fps"] == 1.0 / interval


@pytest.mark.parametrize("fps", [0.67, 30])
def test_videos_of_any_rate(fps, tmp_path, monkeypatch):
    """Gymnasium's `RecordVideo`, the package's own writer and the window take any rate."""
    moviepy = pytest.importorskip("moviepy")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    from fish_env.control import write_video

    inner = gym.make("FishEnv/Stub-v0", render_mode="rgb_array")
    inner.unwrapped.metadata["render_fps"] = fps
    env = gym.wrappers.RecordVideo(inner, str(tmp_path / "gymnasium"), disable_logger=True)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    frames = [inner.render()] * 3
    env.close()
    for ending in ("mp4", "gif", "webp"):
        write_video(frames, fps, tmp_path / f"own.{ending}")
    assert len(list(tmp_path.rglob("*.mp4"))) == 2
    for path in tmp_path.rglob("*.mp4"):
        with moviepy.VideoFileClip(str(path)) as clip:
            assert clip.fps == pytest.approx(fps, rel=0.01)


@pytest.mark.parametrize("mode", MODES)
def test_lists_of_pictures(mode, monkeypatch):
    """`render_mode="rgb_array_list"` gives what Gymnasium's batch of single fish gives: as many pictures, the same."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    options = {"render_mode": "rgb_array_list", "max_episode_steps": 3}
    native = gym.make_vec(STUB, 2, autoreset_mode=mode, **options)
    own = SyncVectorEnv([lambda: gym.make(STUB, **options)] * 2, autoreset_mode=mode)
    for env in (native, own):
        env.reset(seed=0)
    for steps in (1, 2, 2):
        for _ in range(steps):
            over, _ = (env.step(np.zeros((2, 12), dtype=np.float32))[3] for env in (native, own))
        one, other = native.render(), own.render()
        assert [len(each) for each in one] == [len(each) for each in other]
        np.testing.assert_array_equal(one, other)
        reset_ended((native, own), over)
    with pytest.raises(ValueError, match="unknown render_mode 'rgb_array_list'; choose None, 'human', 'rgb_array'"):
        sb3(render_mode="rgb_array_list")
