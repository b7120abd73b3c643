"""From a state that was taken, the future is the same to the bit: of a batch, of one fish and of the `VecEnv`."""

import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gliding import ID, GlidingEnv, GlidingVectorEnv, each_way

import fish_env
from fish_env.envs import FishEnv, StubEnv, StubVectorEnv, state
from fish_env.tasks import Direction, place

FISH, ROUNDS, LIMIT, AHEAD = 4, 2, 8, 12  # every future has the end of an episode and a beginning


class Rhythm:
    """A task in Python that replaces its arrays, names one twice, and has a constant as long as the batch."""

    term_names, episode_steps = ("change",), LIMIT
    directions = (Direction("drawn", "in the body frame", 1.0, 1.0),)
    reset_options = {}

    def prepare(self, tank, interval):
        """Make the arrays for the fish of a tank."""
        self.drawn, self.weights = np.zeros((tank.num_fish, 3)), np.arange(float(FISH))
        self.before = self.now = np.zeros(tank.num_fish)
        self.counted = {"steps": [np.zeros(tank.num_fish, dtype=int)]}

    def start(self, tank, i, generator, options):
        """Begin an episode for fish i."""
        place(tank, i, generator, 0.0, options)
        self.drawn[i] = generator.uniform(-0.5, 0.5, 3)
        self.before[i] = self.now[i] = self.counted["steps"][0][i] = 0

    def vectors(self, tank, pose):
        """World vectors (B,1,3)."""
        return self.drawn[:, None]

    def reward(self, tank, pose):
        """The change of the centre since the step before the last one."""
        change = pose.centre[:, 0] - self.before
        self.before, self.now = self.now, pose.centre[:, 0].copy()
        self.counted["steps"][0] += 1
        return {"change": change * self.counted["steps"][0] + self.weights.sum()}

    def done(self, tank, pose):
        """(B,) some end early."""
        return self.counted["steps"][0] > 5 + 5 * self.drawn[:, 0]

    def metrics(self, tank, i, seconds):
        """What fish i has remembered."""
        return {"before": float(self.before[i])}


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Put the task into the table."""
    monkeypatch.setitem(fish_env.TASKS, "rhythm", Rhythm)


def told(infos, i):
    """What the infos of a batch say of fish i, as text: numbers of numpy and of Python read the same."""
    if isinstance(infos, dict):
        return {name: told(value, i) for name, value in infos.items() if not name.startswith("_")}
    return str(np.asarray(infos[i] if isinstance(infos, np.ndarray) else infos).tolist())


def future(batch, actions):
    """Each fish's observations, rewards, ends and infos for these actions, restarting in the step that ends one."""
    seen = []
    for action in actions:
        obs, reward, terminated, truncated, infos = batch.step(action)
        over = terminated | truncated
        last = [told(infos["final_info"], i) if over[i] else {} for i in range(batch.num_envs)]
        final = [infos["final_obs"][i].tobytes() if over[i] else b"" for i in range(batch.num_envs)]
        each = zip(obs, reward, terminated, truncated, final, last, strict=True)
        seen.append([(o.tobytes(), float(r), bool(a), bool(b), f, info) for o, r, a, b, f, info in each])
    return list(zip(*seen, strict=True))


def future_of_one(env, actions):
    """The same of a single environment."""
    seen = []
    for action in actions:
        obs, reward, terminated, truncated, info = env.step(action)
        final, last = b"", {}
        if terminated or truncated:
            final, last = obs.tobytes(), told(info, 0)
            obs, _ = env.reset()
        truncated = truncated and not terminated  # `TimeLimit` also sets it in a step that terminates
        seen.append((obs.tobytes(), reward, terminated, truncated, final, last))
    return tuple(seen)


@each_way
def test_the_future_is_the_same(task, make):
    """In the same batch, in another order in another batch, and in one fish."""
    check_future(task, make)


def test_the_future_of_a_task_in_python():
    """The same where no kernel knows what the task remembers."""
    check_future("rhythm", GlidingVectorEnv)


def check_future(task, make):
    """Take states at some moments, and compare what follows from them."""
    options = {"task": task, "variation": {"stiffness": (0.8, 1.25), "current": (0.0, 0.3)}}
    if task in ("turn", "rhythm"):
        options |= {"observation_noise": {"vertical": 0.1}, "action_noise": 0.1, "history": 1}
        options |= {"observation_delay": (0, 2), "action_delay": (0, 2)}
    batch, other = (make(FISH, autoreset_mode="SameStep", max_episode_steps=LIMIT, **options) for _ in "12")
    single = gym.wrappers.TimeLimit((GlidingEnv if make is GlidingVectorEnv else FishEnv)(**options), LIMIT)
    rng = np.random.default_rng(3)
    batch.reset(seed=0)
    batch.stagger()
    other.reset(seed=100)
    single.reset(seed=1)
    for _ in range(ROUNDS):
        for action in rng.uniform(-1, 1, (rng.integers(1, LIMIT), FISH, 12)):
            batch.step(action)
        taken, order, actions = batch.get_state(), rng.permutation(FISH), rng.uniform(-1, 1, (AHEAD, FISH, 12))
        stored = pickle.dumps(taken)
        wanted = future(batch, actions)
        assert pickle.dumps(taken) == stored, "a state is a copy"
        taken = pickle.loads(stored)
        batch.set_state(taken)
        singles = [batch.get_state([i]) for i in order]
        assert future(batch, actions) == wanted
        other.set_state(singles if rng.random() < 0.5 else batch_of(batch, taken, order))
        assert future(other, actions[:, order]) == [wanted[i] for i in order]
        single.unwrapped.set_state(singles[0])
        assert future_of_one(single, actions[:, order[0]]) == wanted[order[0]]
        single.unwrapped.set_state(singles[0])
        one = single.unwrapped.get_state()
        assert pickle.dumps(one.arrays) == pickle.dumps(singles[0].arrays) and one.generators == singles[0].generators
        other.set_state(one, indices=[1, 3])
        assert future(other, np.repeat(actions[:, order[:1]], FISH, axis=1))[3] == wanted[order[0]]
    assert any(last for _, _, _, _, _, last in wanted[0])


def batch_of(batch, taken, order):
    """The state of a batch in another order, taken from the batch itself."""
    batch.set_state(taken)
    return batch.get_state(order)


def test_some_fish_of_a_vec_env():
    """The `VecEnv` goes on from the states of the others, and gives those of some fish to whoever asks."""
    pytest.importorskip("stable_baselines3")
    vec, single = fish_env.make_sb3_vec_env(ID["turn"], 3, seed=0, max_episode_steps=LIMIT), GlidingEnv(task="turn")
    single.reset(seed=7)
    single.step(np.zeros(12))
    vec.reset()
    (before,), mine = vec.env_method("get_state", indices=[0]), single.get_state()
    (obs,) = vec.env_method("set_state", mine, indices=[1])
    assert pickle.dumps(vec.get_state([0]).arrays) == pickle.dumps(before.arrays), "the others stay"
    np.testing.assert_array_equal(vec.set_state(mine)[[0, 2]], [obs, obs])
    np.testing.assert_array_equal(vec.step([np.ones(12)] * 3)[0][1], single.step(np.ones(12))[0])
    assert {len(each) for each in vec.env_method("get_state")} == {1}


def test_time_limits():
    """One fish is truncated at the limit of the state, or of its `TimeLimit` if that is shorter."""
    for limit, of_wrapper, wanted in ((8, 20, 3), (None, 7, 2), (8, 8, 3)):
        batch, single = StubVectorEnv(1, max_episode_steps=limit), gym.wrappers.TimeLimit(StubEnv(), of_wrapper)
        batch.reset(seed=0)
        for _ in range(5):
            batch.step(np.zeros((1, 12)))
        single.reset(seed=1)
        single.unwrapped.set_state(batch.get_state())
        assert [single.step(np.zeros(12))[3] for _ in range(wanted)] == [False] * (wanted - 1) + [True]
        ended = single.unwrapped.get_state()
        batch.set_state(ended)  # at the end of its episode: it begins another
        assert batch.step(np.zeros((1, 12)))[1] == 0.0 and batch._elapsed[0] == 0


def test_refused(monkeypatch):
    """States of other fish, and fish that do not exist, are refused in one line, and nothing changes."""
    env, single = StubVectorEnv(3), StubEnv()
    with pytest.raises(gym.error.ResetNeeded, match="before reset"):
        single.set_state(None)
    with pytest.raises(gym.error.ResetNeeded, match=r"before reset of the fish \[0, 1, 2\]; call env.reset"):
        env.get_state()
    env.reset(seed=0)
    good, before = env.get_state(), pickle.dumps(env.get_state())
    cases = [
        (env, {"x": 1}, None, "state is a dict; give what get_state returned"),
        (env, [good, 3], None, "state is a list; give what get_state returned"),
        (env, [], None, "the state is of 0 fish; give that of one fish, or of 3"),
        (env, good, [0, 1], "the state is of 3 fish; give that of one fish, or of 2"),
        (env, good, [0, 1, 3], r"indices is \[0, 1, 3\]; give numbers from 0 to 2, or a boolean array \(3,\)"),
        (env, good, [True, False], "indices is"),
        (env, good, 1.5, "indices is 1.5"),
        (StubVectorEnv(3, speed=1.0), good, None, "layout of the state is .*'commanded heading'.*'commanded velocity'"),
    ]
    for fish, given, indices, message in cases:
        with pytest.raises(ValueError, match=message) as caught:
            fish.set_state(given, indices)
        assert "\n" not in str(caught.value)
    assert pickle.dumps(env.get_state()) == before
    monkeypatch.setattr(state, "STATE_FORMAT", 0)
    with pytest.raises(ValueError, match=r"format of the state is 2, and of these fish 0; .* by this version"):
        StubVectorEnv(3).set_state(good)


PATHS = {
    "single": lambda **options: StubEnv(**options),
    "batch": lambda **options: StubVectorEnv(2, **options),
    "VecEnv": lambda **options: fish_env.make_sb3_vec_env("FishEnv/Stub-v0", 2, monitor=False, **options),
}
OTHERS = {
    "body": ({"body": "planar"}, "mass_spring, 0.2 m, 0.086.*, and of these fish 'planar, 0.2 m"),
    "fish of another water": ({"water": "drag"}, "0.0864 kg.*0.0443 kg"),
    "outline": ({"body": fish_env.make_fish(outline=None)}, "0.0864 kg.*0.0443 kg"),
    "muscles": ({"body": fish_env.make_fish(contraction_time=0.3)}, "body of the state is .*content .*content"),
    "length": ({"body": fish_env.make_fish(length=0.3)}, "0.2 m, .*, and of these fish 'mass_spring, 0.3 m"),
    "interval": ({"control_interval": 0.04}, "control interval, s, of the state is 0.02, and of these fish 0.04"),
    "delay": ({"action_delay": 1}, r"delays of the state is .*'action_delay': \(0, 0\).*: \(1, 1\)"),
    "history": ({"history": 1}, "history, noise and delays of the state is .*'history': 0.*'history': 1"),
    "noise": ({"action_noise": 0.1}, "noise and delays of the state is .*'action_noise': 0.0.*'action_noise': 0.1"),
    "muscle groups": ({"muscle_groups": "pairs"}, "arrays of the state is"),
}


def reset(env):
    """Begin episodes, with another seed than those of the state."""
    return env.reset(**({} if hasattr(env, "seed") else {"seed": 5}))


@pytest.mark.parametrize("path", PATHS)
def test_other_fish_are_refused(path):
    """By what they are and not by their names; water, method, threads and options that may be set may differ."""
    if path == "VecEnv":
        pytest.importorskip("stable_baselines3")
    taken = StubEnv()
    taken.reset(seed=0)
    taken.step(np.ones(12))
    given = taken.get_state()
    for options, message in OTHERS.values():
        env = PATHS[path](**options)
        reset(env)
        with pytest.raises(ValueError, match=message) as caught:
            env.set_state(given)
        assert "\n" not in str(caught.value)
    wanted = taken.step(np.zeros(12))[0]
    for options in (
        {"water": {"drag_coefficient": 1.0}}, {"integrator": "semi_implicit"}, {"dt": 0.0005}, {"threads": 2},
        {"lanes": 1}, {"dtype": "float32"}, {"refine": np.inf}, {"effort_weight": 0.9}, {"variation": {"mass": 1.1}},
        {"body": fish_env.make_fish(time_step=0.0005)},
    ):  # fmt: skip
        env = PATHS[path](**options)
        reset(env)
        env.set_state(given)
        obs = env.step(np.zeros((2, 12)) if path != "single" else np.zeros(12))[0]
        np.testing.assert_array_equal(obs if path == "single" else obs[1], wanted, err_msg=str(options))


def test_other_tasks_are_refused(monkeypatch):
    """By class and by what cannot be set while they run; a class of the same name in another module is another."""
    turn, target = (GlidingVectorEnv(1, task=task) for task in ("turn", "target"))
    turn.reset(seed=0)
    target.reset(seed=0)
    given = target.get_state()
    with pytest.raises(ValueError, match=r"task of the state is 'fish_env.*TargetTask\(.*'fish_env.*TurnTask\("):
        turn.set_state(given)
    with pytest.raises(ValueError, match=r"goal_env=False.*goal_env=True"):
        GlidingVectorEnv(1, task="target", goal_env=True).set_state(given)
    namesake = type("TargetTask", (fish_env.TASKS["target"],), {"__module__": "elsewhere"})
    monkeypatch.setitem(fish_env.TASKS, "target", namesake)
    with pytest.raises(ValueError, match=r"and of these fish 'elsewhere.TargetTask\("):
        GlidingVectorEnv(1, task="target").set_state(given)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled", "VecEnv"])
def test_the_end_of_an_episode(mode):
    """A state of it begins another episode, waits for a reset, or is refused where no step ends between the two."""
    single = gym.make("FishEnv/Stub-v0", max_episode_steps=2)
    single.reset(seed=0)
    before = single.unwrapped.get_state()
    single.step(np.zeros(12))
    assert single.step(np.zeros(12))[3]
    ended = single.unwrapped.get_state()
    if mode == "VecEnv":
        pytest.importorskip("stable_baselines3")
    env = PATHS["VecEnv"]() if mode == "VecEnv" else StubVectorEnv(2, autoreset_mode=mode)
    reset(env)
    if mode in ("SameStep", "VecEnv"):
        with pytest.raises(ValueError, match=r"the episodes of fish \[0\] of the state have ended, but in this batch"):
            env.set_state([before, ended])
    else:
        env.set_state([before, ended])
        if mode == "Disabled":
            with pytest.raises(gym.error.ResetNeeded, match=r"fish \[1\] are at the end"):
                env.step(np.zeros((2, 12)))
            env.reset(options={"reset_mask": np.array([False, True])})
        env.step(np.zeros((2, 12)))
        assert env._elapsed.tolist() == [1, 1 if mode == "Disabled" else 0]


@pytest.mark.parametrize(("method", "wrong", "text"), [
    ("vectors", lambda good: good * np.nan, "vectors of the task is nan"),
    ("vectors", lambda good: good[0, 0], "vectors of the task has shape"),
    ("done", lambda good: None, "done of the task is None; give a boolean array"),
    ("done", lambda good: True, "done of the task is True; give a boolean array"),
    ("done", lambda good: good[:, None], "done of the task is array"),
])  # fmt: skip
def test_vectors_and_ends_that_are_refused(method, wrong, text, monkeypatch):
    """A task in Python whose vectors are not finite, or whose ends are not those of each fish, raises an error."""
    env, good = GlidingVectorEnv(2, task="rhythm"), getattr(Rhythm, method)
    monkeypatch.setattr(Rhythm, method, lambda self, tank, pose: wrong(good(self, tank, pose)))
    with pytest.raises(ValueError, match=text):
        env.reset(seed=0)
        env.step(np.zeros((2, 12)))


@pytest.mark.parametrize("terms", [
    (lambda good: good | {"bonus": good["change"]}, "has the terms .*'change', 'bonus'.*; give .*'change'"),
    (lambda good: {}, r"has the terms \[\]; give .*'change'"), (lambda good: good["change"], "has the terms array"),
    (lambda good: {"change": good["change"] * np.nan}, "term 'change' of the reward is nan"),
    (lambda good: {"change": good["change"] + 1j}, "term 'change' of the reward is .*; give finite"),
    (lambda good: {"change": good["change"][:, None]}, "term 'change' of the reward has shape"),
    (lambda good: 1 / 0, "division"),
], ids=["unknown", "missing", "no dict", "nan", "complex", "shape", "error"])  # fmt: skip
@pytest.mark.parametrize("make", [GlidingEnv, partial(GlidingVectorEnv, 2)], ids=["single", "batch"])
def test_rewards_that_are_refused(make, terms, monkeypatch):
    """A reward of a task in Python that is not its terms raises an error, after which a reset must come first."""
    env, (wrong, text) = make(task="rhythm"), terms
    idle = np.zeros(env.action_space.shape, np.float32)
    env.reset(seed=0)
    env.step(idle)
    with monkeypatch.context() as patch:
        reward = Rhythm.reward
        patch.setattr(Rhythm, "reward", lambda self, tank, pose: wrong(reward(self, tank, pose)))
        with pytest.raises((ValueError, ZeroDivisionError), match=text):
            env.step(idle)
    with pytest.raises(gym.error.ResetNeeded, match="after an error in a step"):
        env.step(idle)
    env.reset(seed=0)
    env.step(idle)
    env.close()
