"""The gait and the motor controllers without learning: tables, symmetry, the batch, what each task asks, searches."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration import finest, gait_search, keep, motor_controllers
from fish_env.bodies import make_fish
from fish_env.control import (
    Gait,
    SequencerConfig,
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


def test_gait_is_what_it_says():
    """Left and right contract exactly out of phase, within [0, amplitude], at the stated frequency."""
    fish, gait, time = make_fish(), Gait(2.0, (0.3, 0.6, 1.0), (0.0, 1.0, 2.0)), np.linspace(0, 1, 101)
    contraction = gait.contraction(fish, time)
    amplitude = np.array(gait.amplitude)[fish.segments]
    assert contraction.shape == (101, 12) and (contraction >= 0).all() and (contraction <= amplitude).all()
    left, right = (contraction[:, fish.sides == side] for side in (1, -1))
    np.testing.assert_allclose(left + right, np.broadcast_to(amplitude[fish.sides == 1], left.shape), atol=1e-12)
    np.testing.assert_allclose(contraction, gait.contraction(fish, time + 0.5), atol=1e-12)
    for bad in ({"frequency": 0.0}, {"amplitude": (1.0, 1.0, 1.5)}, {"lag": (0.0, np.nan, 0.0)}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            replace(gait, **bad)


def test_gait_swims():
    """The best open-loop gait swims along its heading, better than random twitching, and the same way twice."""
    env = make("Swim", 4, muscle_groups="pairs")
    gait, again = (evaluate(env, gait_controller(best_gait(), env)) for _ in range(2))
    twitching = evaluate(env, random_actions(env))
    assert not gait["failed"].any() and not twitching["failed"].any()
    assert gait["speed"].min() > 1.0 and gait["speed"].min() > 1.1 * np.abs(twitching["speed"]).max()
    np.testing.assert_array_equal(gait["speed"], again["speed"])


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
        for controller, rows, end in ((turn_mc, turns, 0.7), (start_mc, starts, 0.3)):
            left, right = (controller(rows, side * np.ones(3), np.full(3, since))[0] for side in (1, -1))
            np.testing.assert_array_equal(left, right[:, :, ::-1])
            assert left.any() == (since < end) and left.shape == (3, 3, 2)
    for since, wanted in ((0.1, [[0.9, 0], [0.8, 0], [0.7, 0]]), (0.2, [[0, 0.3], [0, 0.2], [0, 0.1]])):
        np.testing.assert_allclose(start_mc(starts, np.ones(3), np.full(3, since))[0][0], wanted)


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
    muscles, pairs = (scripted(env, config=SequencerConfig(pitch=0.0))(obs, 0.0) for env in both)
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
    metric, least = {"Swim": ("speed", 1.5), "Target": ("targets", 3), "FastStart": ("escape_distance", 0.4)}.get(
        task, ("success", 0.49)
    )
    assert scores[metric].mean() > least


def test_commanded_speed_and_depth():
    """A commanded speed is kept, and targets above and below are reached."""
    env = make("Swim", 10, speed=(0.5, 2.0))
    assert evaluate(env, scripted(env), 11)["speed_error"].mean() < 0.3
    env = make("Target", 10, dimensions=3)
    assert evaluate(env, scripted(env), 11)["targets"].sum() > 0


def test_commanded_speed_seen_by_sensors():
    """The motor controllers act on what sensors show as on the velocities of the nodes."""
    first = []
    for observation in ("nodes", "sensors"):
        env = make("Swim", 2, speed=1.0, observation=observation)
        obs, _ = env.reset(seed=0)
        first.append(scripted(env)(obs, 0.0))
    np.testing.assert_allclose(*first, atol=1e-6)


def test_thirds_of_a_fish_of_six_segments_act_as_one():
    """Under the gait and the motor controllers."""
    fish = make_fish()
    many = replace(fish, segments=2 * fish.segments + (fish.heights > 0))
    np.testing.assert_array_equal(*(best_gait().contraction(each, np.linspace(0, 1, 9)) for each in (fish, many)))
    env = make("Turn", 2, body=many)
    obs, _ = env.reset(seed=0)
    np.testing.assert_array_equal(scripted(env)(obs, 0.0), scripted(make("Turn", 2))(obs, 0.0))


def test_random_actions_are_seeded():
    """Random actions fill the range, differ from one environment step to the next, and come back with their seed."""
    one, same, other = (random_actions(make("Swim", 4), seed) for seed in (0, 0, 1))
    seen = np.zeros((4, 3))
    first = one(seen, 0.0)
    assert first.shape == (4, 12) and np.abs(first).max() <= 1 and (one(seen, 0.02) != first).all()
    np.testing.assert_array_equal(same(seen, 0.0), first)
    assert (other(seen, 0.0) != first).all()


# Searches


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A folder for what searches find."""
    monkeypatch.setattr(keep, "KEPT", tmp_path / "kept")
    return tmp_path / "kept"


@pytest.mark.slow
def test_a_search_of_one_generation(tmp_path, monkeypatch, kept):
    """It writes what it found, near where it began, with its provenance; the package stays; found again, it is kept."""
    pytest.importorskip("cma")
    shipped, path = best_gait(), tmp_path / "gait.json"
    monkeypatch.setattr(gait_search, "GAIT_FILE", path)
    gait_search.calibrate("drag", generations=1)
    written = json.loads(path.read_text())["drag"]
    found = Gait(written["gait"]["frequency"], tuple(written["gait"]["amplitude"]), tuple(written["gait"]["lag"]))
    assert "--water drag" in written["provenance"]["command"] and best_gait() == shipped
    assert 3.0 < found.frequency <= 4.0 and found.lag[0] == 0.0
    monkeypatch.setattr(gait_search, "search", None)
    gait_search.calibrate("drag", generations=1)
    assert json.loads(path.read_text())["drag"]["gait"] == written["gait"] and len(list(kept.iterdir())) == 1


def test_another_job_is_another_result(kept):
    """What is kept under one job is not given for another."""
    assert [keep.kept("double", lambda value: 2 * value, value) for value in (1, 2, 1)] == [2, 4, 2]
    assert len(list(kept.iterdir())) == 2


@pytest.mark.parametrize("water", finest.START)
def test_the_finest_body_at_the_start_of_its_search(water):
    """The point zero is the record itself; a factor changes the one value that it is of."""
    start = finest.START[water]
    assert finest.decoded(np.zeros(finest.SIZE), start) == start
    moved = finest.decoded(0.1 * np.eye(finest.SIZE)[0], start)
    assert moved["parameters"]["stiffness"][1] == pytest.approx(np.exp(0.1) * start["parameters"]["stiffness"][1], 1e-3)
    moved["parameters"]["stiffness"] = start["parameters"]["stiffness"]
    assert moved == start


def test_strokes_of_full_amplitude_swim():
    """The search of the swimming table tries strokes whose contraction is 1 and a rounding error."""
    r1, f, r2 = 0.9981 * (1.0 + 2**-52), 2.5, 0.7131
    stroke = np.array([[0.0, r1, f, r2, f]])
    speed, effort = motor_controllers.steady(motor_controllers.gait_tables("drag"), stroke, "drag", 1.0, 0.5)
    assert 0.5 < speed[0] < 3.0 and 0.0 < effort[0] <= 1.0
