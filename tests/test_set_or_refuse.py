"""Every keyword on every path: set, it acts as if the environment had been made with it, bit for bit, or it is refused.

The table is made of all keywords of an environment and of its task, a good, a bad and a misspelt value of each, and all
the ways to set one.
"""

import copy
import pickle
import warnings
from itertools import product
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

from fish_env import make_fish, make_sb3_vec_env
from fish_env.envs import FishVectorEnv
from fish_env.envs.episode import Episodes
from fish_env.tasks.left_after_right import LeftAfterRightTask
from fish_env.tasks.options import keywords_of

ID = "FishEnv/LeftAfterRight-v0"
KEYWORDS = sorted({*keywords_of(Episodes), *keywords_of(FishVectorEnv), *keywords_of(LeftAfterRightTask)})
ANOTHER = {
    "angle": 1.5, "severity": 0.2, "part": 0.9, "dwell": 0.5, "wait": 3.0, "reversals": 2, "alignment_weight": 1.0,
    "effort_weight": 0.7, "overshoot_weight": 3.0, "max_episode_steps": 2, "variation": {"mass": 1.3},
    "failure_penalty": 3.0, "info_every_step": True,
}  # fmt: skip
"""Values of those that can be set while it runs: other than the defaults, and allowed."""
WRONG = object()
"""A value that no keyword may have."""
FIXED = {"dt": 0.001, "water": "drag", "action_noise": 0.5, "history": 2, "body": "planar", "render_mode": "rgb_array"}
"""Good values of some of the others."""


class Empty(gym.Wrapper):
    """A wrapper that does nothing."""


def wrapped(wrap=lambda env: env, **options):
    """One fish, and the way to set an option of it."""
    env = wrap(gym.make(ID, **options))
    return env, env.set_wrapper_attr


def of_stable_baselines3(maker):
    """A `VecEnv`, imported when it is asked for."""

    def make(**options):
        module = pytest.importorskip("stable_baselines3.common.vec_env")
        monitor = pytest.importorskip("stable_baselines3.common.monitor").Monitor
        return maker(SimpleNamespace(batch=module, Monitor=monitor), **options)

    return make


def dummy(sb3, **options):
    """Stable-Baselines3's own batch."""
    env = sb3.batch.DummyVecEnv([lambda: sb3.Monitor(gym.make(ID, **options))] * 2)
    return env, lambda name, value: env.env_method("set_wrapper_attr", name, value)


def native(sb3, **options):
    """The batch for Stable-Baselines3 that this package has."""
    env = make_sb3_vec_env(ID, 2, **options)
    return env, env.set_attr


def monitored(sb3, **options):
    """One fish in a wrapper of Stable-Baselines3."""
    return wrapped(sb3.Monitor, **options)


def assigned(make):
    """Plain assignment to what is inside of an environment, its task included."""

    def changed(**options):
        env, _ = make(**options)
        bare = env.unwrapped
        batch = getattr(bare, "fish", bare)

        def assign(name, value):
            refused = []
            for owner in dict.fromkeys((bare, batch, *[batch.task] * (name in keywords_of(LeftAfterRightTask)))):
                with pytest.raises(AttributeError, match=f"'{name}' cannot be assigned; (call|make)") as found:
                    setattr(owner, name, value)
                refused.append(found.value)
            raise refused[0]

        return env, assign

    return changed


def batch(env):
    """A batch, and the way to set an option of it."""
    return env, lambda name, value: env.unwrapped.set_attr(name, [value] * 2)


def sync(**options):
    """Gymnasium's own batch."""
    return batch(SyncVectorEnv([lambda: gym.make(ID, **options)] * 2))


def vector(wrap=lambda env: env, **options):
    """The batch of this package."""
    return batch(wrap(gym.make_vec(ID, 2, **options)))


PATHS = {
    "gym.make": wrapped,
    "an empty wrapper": lambda **options: wrapped(Empty, **options),
    "Monitor": of_stable_baselines3(monitored),
    "SyncVectorEnv": sync,
    "make_vec": vector,
    "a wrapped make_vec": lambda **options: vector(gym.wrappers.vector.RecordEpisodeStatistics, **options),
    "make_sb3_vec_env": of_stable_baselines3(native),
    "DummyVecEnv": of_stable_baselines3(dummy),
    "assignment, one fish": assigned(wrapped),
    "assignment, make_vec": assigned(vector),
    "assignment, make_sb3_vec_env": assigned(of_stable_baselines3(native)),
}
each_path = pytest.mark.parametrize("path", PATHS)


def fish_of(env):
    """The batches of fish within an environment."""
    inner = getattr(env.unwrapped, "envs", [env])
    return [getattr(each.unwrapped, "fish", each.unwrapped) for each in inner]


def plain(value):
    """Arrays of infos as lists, for `repr`; without the time that monitors measure."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items() if key not in ("episode", "_episode")}
    return [plain(each) for each in value] if isinstance(value, list | tuple) else np.asarray(value).tolist()


def episode(env):
    """An episode of four steps as text, in the third of which the fish fail; and what the task has drawn."""
    theirs = hasattr(env, "reset_infos")  # of Stable-Baselines3
    shape, seen = ((env.num_envs,) if theirs else ()) + env.action_space.shape, []
    for seed in (2, 3):  # which between them use all that the task draws
        if theirs:
            env.seed(seed)
        seen.append((env.reset(), *env.reset_infos) if theirs else env.reset(seed=seed))
        for fish in fish_of(env):
            drawn = (
                *fish.task.course,
                fish.tank.variation,
                *(getattr(fish.task.pack, name) for name in fish.task.weights),
            )
            seen.append(copy.deepcopy(drawn))
    for step in range(4):
        if step == 2:
            for fish in fish_of(env):
                fish.tank.velocity[:] = np.nan
        seen.extend(env.step(np.full(shape, 0.5 - step % 2, np.float32)))
        if not hasattr(env, "num_envs") and (seen[-3] or seen[-2]):
            break
    return repr([plain(each) for each in seen])


@pytest.fixture(scope="module", params=PATHS)
def default(request):
    """A path, an environment of it with its defaults, and an episode of that environment."""
    env, change = PATHS[request.param]()
    yield SimpleNamespace(path=request.param, env=env, change=change, episode=episode(env))
    env.close()


def test_all_keywords_are_in_the_table():
    """What can be set is what has a value in this table: a new keyword must be entered, or is refused everywhere."""
    assert set(ANOTHER) == set(gym.make_vec(ID, 2).unwrapped.settable) and set(ANOTHER) <= set(KEYWORDS)
    assert set(gym.make(ID).unwrapped.settable) == set(ANOTHER) - {"max_episode_steps"}


@pytest.mark.parametrize("name", KEYWORDS)
def test_set_or_refused(name, default):
    """A good value acts, or is refused; a bad value and a misspelt name are refused, and change nothing."""
    for wrong, value in ((name, WRONG), (name[1:] + "_", ANOTHER.get(name))):
        if wrong == name or "assignment" not in default.path:  # other attributes may be assigned
            with pytest.raises((AttributeError, ValueError)):
                default.change(wrong, value)
    if name in ANOTHER and "assignment" not in default.path:
        env, change = PATHS[default.path]()
        wanted, _ = PATHS[default.path](**{name: ANOTHER[name]})
        own = name == "max_episode_steps" and type(fish_of(env)[0].spec) is type(None)
        change("_max_episode_steps" if own else name, ANOTHER[name])
        assert episode(env) == episode(wanted) != default.episode
        assert own or all(fish.changed == {name: ANOTHER[name]} for fish in fish_of(env))
        for each in (env, wanted):
            each.close()
    else:
        with pytest.raises(AttributeError):
            default.change(name, ANOTHER.get(name, FIXED.get(name)))
        assert episode(default.env) == default.episode


def test_misspelt_names():
    """The nearest name that can be set is told; of a keyword that an environment is made with, that."""
    env, vec = gym.make(ID), gym.make_vec(ID, 2)
    for set_attr in (env.set_wrapper_attr, vec.set_attr):
        with pytest.raises(AttributeError, match=r"\(did you mean 'severity'\?\); make a new environment, or"):
            set_attr("severty", 0.5)
    typos = {"control_intervall": "control_interval", "n_envs": "num_envs", "sverity": "severity"}
    for make, (given, wanted) in product((gym.make, gym.make_vec), typos.items()):
        with pytest.raises(ValueError, match=rf"'{given}' \(did you mean '{wanted}'\?\)"):
            make(ID, **{given: 0.02})
    with pytest.raises(AttributeError, match="give '_max_episode_steps'"):
        env.set_wrapper_attr("max_episode_steps", 2)


def test_other_processes():
    """Workers of Gymnasium set and refuse as well; those of Stable-Baselines3 set by `env_method`."""
    env = AsyncVectorEnv([lambda: gym.make(ID)])
    env.set_attr("severity", 0.2)
    assert env.get_attr("severity") == (0.2,)
    with warnings.catch_warnings(), pytest.raises(AttributeError, match="did you mean 'severity'"):
        warnings.simplefilter("ignore")
        env.set_attr("severty", 0.2)
    batches = pytest.importorskip("stable_baselines3.common.vec_env")
    own = batches.SubprocVecEnv([lambda: gym.make(f"fish_env:{ID}")])
    own.env_method("set_wrapper_attr", "severity", 0.2)
    assert own.get_attr("severity") == [0.2]
    own.close()


def test_copies_keep_what_was_set():
    """Pickles and copies of an environment have what was set, and refuse as it does."""
    env = gym.make_vec(ID, 2).unwrapped
    env.set_attr("effort_weight", 0.7)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert other.changed == {"effort_weight": 0.7} and episode(other) == episode(env)
        for owner in (other, other.task):
            with pytest.raises(AttributeError, match="cannot be assigned; call set_wrapper_attr"):
                owner.effort_weight = 1.0


@pytest.mark.parametrize("delayed", ["observation_delay", "action_delay"])
def test_limits_below_a_delay(delayed):
    """An episode is longer than its delays, however its limit is set."""
    single, vec = gym.make(ID, **{delayed: 5}), gym.make_vec(ID, 2, **{delayed: 5})
    with pytest.raises(ValueError, match=f"{delayed} is .* an episode has 3 steps"):
        vec.set_attr("max_episode_steps", 3)
    single.set_wrapper_attr("_max_episode_steps", 3)
    with pytest.raises(ValueError, match=f"{delayed} is .* an episode has 3 steps"):
        single.reset(seed=0)
    vec.set_attr("max_episode_steps", 6)


def test_noise_follows_the_unit():
    """The noise of a part may be as large as the part; a part that is not there is named, whatever its noise."""
    for part in gym.make(ID, observation="sensors").unwrapped.layout:
        gym.make(ID, observation="sensors", observation_noise={part.name: part.limit})
        with pytest.raises(ValueError, match=rf"from 0 to {part.limit:g} \(standard deviation, "):
            gym.make(ID, observation="sensors", observation_noise={part.name: 1.01 * part.limit})
    with pytest.raises(ValueError, match="observation_noise has 'presure'; choose from"):
        gym.make(ID, observation="sensors", observation_noise={"presure": 0.0})


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
    "law": ({"law": "linear"}, {"quadratic", "linear"}),
    "current": ({"current": (0.1, 0.0, 0.0)}, {"current"}),
}


@pytest.mark.parametrize("case", WATERS)
def test_water_changes_what_it_names(case):
    """A dictionary of water keeps, bit for bit, what it does not name of the fish's own water."""
    given, changed = WATERS[case]
    own, found = make_fish().water, gym.make(ID, water=given).unwrapped.tank.world
    assert {name for name in own._fields if not np.array_equal(getattr(own, name), getattr(found, name))} == changed
    if case == "density":
        for name in changed:
            np.testing.assert_allclose(getattr(found, name), 0.5 * np.asarray(getattr(own, name)), rtol=1e-15)


def test_water_that_changes_nothing():
    """A keyword that would have no effect is refused."""
    for given in ({"added_mass": (2.0, 1.0), "inertia": False}, {"viscosity": 4e-6, "friction": 0.0}):
        with pytest.raises(ValueError, match="changes nothing in water without"):
            gym.make(ID, water=given)
