"""Recordings: replayed bit for bit, every changed bit found, and every wrong file refused with the reason."""

import gymnasium as gym
import numpy as np
import pytest

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import load_policy, load_recording, record, replay, shipped_policy
from fish_env.control.evaluation import evaluation_options, policy_controller
from fish_env.control.recording import SHAPES, Recording, arrays_of

VARIED = {"stiffness": (0.5, 2.0), "mass": (0.8, 1.2), "drag": 1.3, "current": (0.2, 0.5), "roll": 0.4}
TASKS = ("Swim", "Turn", "LeftAfterRight", "Target", "Avoid", "FastStart")
CASES = [
    *((f"FishEnv/{task}-v0", {"variation": VARIED}, {}) for task in TASKS),
    ("FishEnv/Stub-v0", {}, {}),
    ("FishEnv/Swim-v0", {"muscle_groups": "pairs", "dt": 0.001}, {}),
    pytest.param("FishEnv/Swim-v0", {"integrator": "semi_implicit", "dt": 0.0002}, {}, marks=pytest.mark.slow),
    ("FishEnv/Swim-v0", {"water": {"drag_coefficient": np.float64(1.2)}}, {"mass": 1.3, "current": 0.3}),
]


def actions(env, steps, seed=0):
    """Random ones, the same for the same seed."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, *env.action_space.shape))


def recorded(id="FishEnv/Swim-v0", steps=4, seed=7, options=None, **keywords) -> Recording:
    """An episode under random actions."""
    env = gym.make(id, **keywords)
    return record(env, actions(env, steps), seed, options)


@pytest.mark.parametrize(("id", "keywords", "options"), CASES, ids=lambda case: str(case)[:40])
def test_replayed_bit_for_bit(id, keywords, options, tmp_path):
    """Every task, varied fish, a current and another method: the file is replayed with the same bits."""
    one = recorded(id, options=options, **keywords)
    found = replay(one.save(tmp_path / "new" / "one.npz"))
    assert found.same and found.steps == 4 and "the same bits in all of 4 environment steps" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("body", fish_env.BODIES)
def test_every_task_on_every_body(body, task, tmp_path):
    """Every task on every body, varied fish in a current: the file is replayed with the same bits."""
    varied = {name: value for name, value in VARIED.items() if name != "roll" or body != "planar"}
    one = recorded(f"FishEnv/{task}-v0", 20, body=body, variation=varied)
    assert replay(one.save(tmp_path / "one.npz")).same


def test_what_it_holds(tmp_path):
    """The arrays are those that the environment shows, state by state, and come back from the file unchanged."""
    env = gym.make("FishEnv/Avoid-v0", variation=VARIED)
    given = actions(env, 6)
    one = load_recording(record(env, given, 3).save(tmp_path / "one.npz"))
    other = gym.make("FishEnv/Avoid-v0", variation=VARIED)
    other.reset(seed=3)
    tank = other.unwrapped.tank
    for step in range(7):
        np.testing.assert_array_equal(one.position[step], tank.position[0])
        np.testing.assert_array_equal(one.velocity[step], tank.velocity[0])
        np.testing.assert_array_equal(one.rest_length[step], tank.rest_length[0])
        assert one.time[step] == tank.time[0] and one.failure[step] == 0
        if step < 6:
            assert other.step(given[step])[1] == one.reward[step]
    np.testing.assert_allclose(one.terms.sum(axis=1), one.reward, rtol=1e-12)
    np.testing.assert_array_equal(one.action, given)
    np.testing.assert_array_equal(one.variation, tank.variation[0])
    assert one.spheres.shape[2] == 4 and one.directions.shape[0] == 7 and one.steps == 6
    assert one.about["versions"]["numpy"] == np.__version__ and one.about["seed"] == 3
    assert one.about["term_names"][-1] == "failure" and one.about["env_id"] == "FishEnv/Avoid-v0"


def test_policy_and_function():
    """A policy acts as `policy_controller` does; a function sees observations and time; the time limit ends both."""
    policy = load_policy(shipped_policy("swim"))
    env = gym.make("FishEnv/Swim-v0", max_episode_steps=5, **evaluation_options(policy.about["env_options"]))
    one, seen = record(env, policy, 1), []
    assert one.steps == 5 and replay(one).same
    act = policy_controller(policy, env.unwrapped.fish)
    by_hand = record(env, lambda obs, time: (seen.append(time), act(obs, time))[1], 1, steps=3)
    np.testing.assert_array_equal(by_hand.position, one.position[:4])
    np.testing.assert_allclose(seen, [0.0, 0.02, 0.04])


def test_another_task_of_its_own_episode():
    """A target that is reached and replaced is drawn again by the replay, from the same generator."""
    env = gym.make("FishEnv/Target-v0", distance=0.8, radius=0.25)
    one = record(env, load_policy(shipped_policy("target")), 0, steps=100)
    assert len(np.unique(one.spheres[:, 0], axis=0)) > 1
    assert replay(one).same


@pytest.mark.parametrize("name", [name for name in SHAPES if name != "action"])
def test_changed_bit_is_found(name, tmp_path):
    """One changed bit of a state, a reward or a term is found, with its step and place; what comes before agrees."""
    one = recorded("FishEnv/Target-v0")
    arrays = {key: array.copy() for key, array in arrays_of(one).items()}
    place = (0,) * arrays[name].ndim if name == "variation" else (2, *(0,) * (arrays[name].ndim - 1))
    if arrays[name].dtype == np.float64:
        bits = arrays[name].view(np.int64)
        bits[place] ^= 1
    else:
        arrays[name][place] ^= 1
    found = replay(Recording(about=one.about, **arrays).save(tmp_path / "changed.npz"))
    step = 0 if name == "variation" else 3 if name in ("reward", "terms", "terminated") else 2
    assert not found.same and found.steps == step
    assert f"after environment step {step} " in found.message and f"in {name}[" in found.message
    assert "the versions are the same" in found.message


def test_changed_action_and_other_versions():
    """A changed action is found by the motion that follows; versions that differ are named."""
    one = recorded()
    action = one.action.copy()
    action[1] *= 0.5
    about = one.about | {"versions": one.about["versions"] | {"numpy": "1.0.0"}}
    found = replay(Recording(about=about, **arrays_of(one) | {"action": action}))
    assert found.steps == 2 and f"numpy 1.0.0 then, {np.__version__} now" in found.message


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (lambda: gym.make("FishEnv/Stub-v0", body=fish_env.make_fish()), {},
         "body.* is a Fish, which a recording cannot hold; .* a body by its name"),
        (lambda: gym.make("FishEnv/Stub-v0", water=fish_env.make_water()), {},
         r"water.* is a World, which a recording cannot hold; .* keywords of fish_env.make_water"),
        (lambda: gym.wrappers.ClipAction(gym.make("FishEnv/Stub-v0")), {}, "a wrapper ClipAction, which may change"),
        (lambda: fish_env.FishEnv(task="swim"), {}, "not made by gym.make alone"),
        (lambda: gym.make("CartPole-v1"), {}, "give one fish"),
        (None, {"seed": -1}, "seed is -1"),
        (None, {"seed": None}, "seed is None"),
        (None, {"options": {"depth": 1.0}}, "unknown reset option"),
        (None, {"policy": np.zeros((2, 11))}, "actions has shape"),
        (None, {"policy": np.full((2, 12), np.nan)}, "actions is nan"),
        (None, {"policy": lambda obs, time: np.zeros(3)}, "action"),
        (None, {"steps": 0}, "steps is 0"),
    ],
)  # fmt: skip
def test_wrong_use(make, arguments, message):
    """An environment, keyword, controller or seed that cannot be recorded is refused with the reason."""
    with pytest.raises(ValueError, match=message):
        record(gym.make("FishEnv/Stub-v0") if make is None else make(), **{"policy": np.zeros((2, 12))} | arguments)


def test_command(tmp_path, capsys):
    """`python -m fish_env replay` prints the finding; its exit status is 1 for a difference and 2 for a wrong file."""
    one = recorded("FishEnv/Stub-v0")
    with pytest.raises(ValueError, match=r"ends in '.txt'; give a name that ends in .npz"):
        one.save(tmp_path / "one.txt")
    assert command_line.main(["replay", str(one.save(tmp_path / "one.npz"))]) == 0
    assert "the same bits" in capsys.readouterr().out
    changed = Recording(about=one.about, **arrays_of(one) | {"reward": one.reward + 1.0})
    assert command_line.main(["replay", str(changed.save(tmp_path / "other.npz"))]) == 1
    assert "differs first after environment step 1 (0.02 s), in reward[0]" in capsys.readouterr().out
    assert command_line.main(["replay", str(tmp_path / "missing.npz")]) == 2
    assert "there is no recording" in capsys.readouterr().err
