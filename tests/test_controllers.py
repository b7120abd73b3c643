"""The motor controllers without learning: tables, symmetry, the batch, and that they do what each task asks."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration import motor_controllers
from fish_env.control import (
    Habits,
    best_gait,
    evaluate,
    gait_controller,
    load_tables,
    make_eval_env,
    random_actions,
    scripted,
)
from fish_env.control.motor import MOTOR_FILE, Start, Swim, Table, Turn, scaled_turns, start_mc, turn_mc

TASKS = ("Swim", "Turn", "LeftAfterRight", "Target", "Avoid", "FastStart")


def make(task, num_envs, **options):
    """A small batch on one thread."""
    return make_eval_env(f"FishEnv/{task}-v0", num_envs, {"threads": 1} | options)


def test_tables_are_read_as_written():
    """Rows come back as the file has them, angles in radians; between two rows the mean, beyond the end the end.

    Half the smallest angle of the table is half its bend, for as long.
    """
    tables, written = load_tables(water="drag"), json.loads(MOTOR_FILE.read_text())["drag"]
    assert [row["angle"] for row in written["turns"]] == [30, 45, 60, 90] and written["provenance"]["command"]
    first, second = tables.turns.values[:2]
    assert first[0] == pytest.approx(np.radians(30)) and first[5] == written["turns"][0]["hold"]
    np.testing.assert_allclose(tables.turns.at(np.radians([30, 37.5, 45])), [first, (first + second) / 2, second])
    np.testing.assert_allclose(tables.swims.at(np.array([np.inf])), tables.swims.values[-1:])
    half = scaled_turns(tables.turns, first[:1] / 2)[0]
    np.testing.assert_allclose([*half[1:4], *half[5:]], [*first[1:4] / 2, *first[5:]])


def test_bad_rows_are_refused():
    """Contractions beyond 1, times that are not positive, rows out of order and single rows say what is allowed."""
    good = {"front": 0.5, "middle": 0.5, "tail": 0.1, "strokes": 0.5, "hold": 0.1, "straighten": 0.1, "phase": 0.0}
    row = Turn(1.0, **good)
    for bad in ([-0.1], [1.0, 1.2], [1.0, 0.5, 0.5, 0.5, np.inf]):
        with pytest.raises(ValueError, match="give"):
            Start(*bad, *[0.1] * (10 - len(bad)))
    for bad in ({"front": 1.2}, {"tail": -1.1}, {"hold": 0.0}, {"phase": np.nan}):
        with pytest.raises(ValueError, match="give"):
            Turn(1.0, **(good | bad))
    with pytest.raises(ValueError, match="amplitudes"):
        Swim(1.0, 1.5, 3.0, 0.5, 3.0)
    for message, rows in (("increasing order", [row, row]), ("at least two", [row])):
        with pytest.raises(ValueError, match=message):
            Table(rows)


def test_turns_are_mirror_images():
    """Turns and fast starts to the right contract on the right what those to the left contract on the left."""
    turns = scaled_turns(load_tables().turns, np.radians([30.0, 50.0, 90.0]))
    starts = Table([Start(a, 0.9, 0.8, 0.7, 0.1, 0.3, 0.2, 0.1, 0.2, 0.0) for a in (1.0, 2.0)]).at(np.ones(3))
    for since in (0.0, 0.1, 0.28, 0.4, 0.8):
        for make, rows, end in ((turn_mc, turns, 0.7), (start_mc, starts, 0.3)):
            left, right = (make(rows, side * np.ones(3), np.full(3, since))[0] for side in (1, -1))
            np.testing.assert_array_equal(left, right[:, :, ::-1])
            assert left.any() == (since < end)
    assert left.shape == (3, 3, 2)
    np.testing.assert_allclose(start_mc(starts, np.ones(3), np.full(3, 0.1))[0][0], [[0.9, 0], [0.8, 0], [0.7, 0]])
    np.testing.assert_allclose(start_mc(starts, np.ones(3), np.full(3, 0.2))[0][0], [[0, 0.3], [0, 0.2], [0, 0.1]])


def test_fast_starts_get_away():
    """A C-start gets farther along the command than the best gait; tables without them are refused."""
    env = make("FastStart", 40)
    controllers = scripted(env), gait_controller(best_gait(), env)
    started, swum = (evaluate(env, each, 11)["escape_distance"].mean() for each in controllers)
    assert started > swum + 0.2
    with pytest.raises(ValueError, match="have no fast starts; search them"):
        scripted(env, replace(load_tables(), starts=None))


@pytest.mark.parametrize("task", TASKS)
def test_batch_is_one_by_one(task):
    """The controller of a batch does for each fish what that of the fish alone does, whatever the others see."""
    env = make(task, 3)
    controller, single = scripted(env), [scripted(make(task, 1)) for _ in range(3)]
    obs, _ = env.reset(seed=7)
    for k in range(100):
        action = controller(obs, k * env.control_interval)
        for i in range(3):
            np.testing.assert_array_equal(single[i](obs[i : i + 1], k * 0.02)[0], action[i])
        obs, *_ = env.step(action)


def test_pairs_are_the_muscles_two_by_two():
    """With one action for each pair the fish does what it does with one for each muscle, but for pitching."""
    both = make("Turn", 2), make("Turn", 2, muscle_groups="pairs")
    obs = both[0].reset(seed=7)[0]
    muscles, pairs = (scripted(env, habits=Habits(pitch=0.0))(obs, 0.0) for env in both)
    assert muscles.shape == (2, 12) and pairs.shape == (2, 6)
    np.testing.assert_array_equal(muscles, pairs[:, both[1].groups])


@pytest.mark.parametrize("groups", ["muscles", "pairs"])
@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_played(task, groups):
    """Ten episodes of each task end without a failure of the physics, and most reach what they should."""
    env = make(task, 10, muscle_groups=groups)
    controller = scripted(env)
    scores, again = (evaluate(env, controller, 11) for _ in range(2))
    np.testing.assert_array_equal(scores["return"], again["return"])  # time zero is a new beginning
    assert not scores["failed"].any()
    if task == "Swim":
        assert scores["speed"].min() > 1.5
    elif task == "Target":
        assert scores["targets"].mean() > 3
    elif task == "FastStart":
        assert scores["escape_distance"].mean() > 0.4
    else:
        assert scores["success"].mean() >= 0.5


def test_commanded_speed_and_depth():
    """A commanded speed is kept, and targets above and below are reached."""
    env = make("Swim", 10, speed=(0.5, 2.0))
    assert evaluate(env, scripted(env), 11)["speed_error"].mean() < 0.3
    env = make("Target", 10, dimensions=3)
    assert evaluate(env, scripted(env), 11)["targets"].sum() > 0


def test_random_actions_are_seeded():
    """Random actions fill the range, differ from one environment step to the next, and come back with their seed."""
    one, same, other = (random_actions(make("Swim", 4), seed) for seed in (0, 0, 1))
    first = one(None, 0.0)
    assert first.shape == (4, 12) and np.abs(first).max() <= 1 and (one(None, 0.02) != first).all()
    np.testing.assert_array_equal(same(None, 0.0), first)
    assert (other(None, 0.0) != first).all()


def test_strokes_of_full_amplitude_swim():
    """The search of the swimming table tries strokes whose contraction is 1 and a rounding error."""
    r1, f, r2 = 0.9981 * (1.0 + 2**-52), 2.5, 0.7131
    stroke = np.array([[0.0, r1, f, r2, f]])
    speed, effort = motor_controllers.steady(motor_controllers.gait_tables("drag"), stroke, "drag", 1.0, 0.5)
    assert 0.5 < speed[0] < 3.0 and 0.0 < effort[0] <= 1.0
