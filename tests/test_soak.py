"""The long trial: it counts what it claims, stops and goes on, and would notice a number that is not finite."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.stability import soak
from fish_env.envs import VARIATIONS, FishVectorEnv

ROUNDS = [("mass_spring", "swim", kind) for kind in ("random", "adversarial")]


@pytest.fixture
def short(monkeypatch):
    """Two rounds a pass, of few steps."""
    monkeypatch.setattr(soak, "PASS", ROUNDS)
    monkeypatch.setattr(soak, "STEPS", 12)
    monkeypatch.setattr(soak, "USUAL", 4)
    monkeypatch.setattr(soak, "COMPARED", 1)


def test_every_combination_is_in_a_pass():
    """Every body in every task under every kind of actions, once."""
    assert len(set(soak.PASS)) == len(soak.PASS) == len(soak.BODIES) * len(soak.TASKS) * 4


def test_variation_is_at_its_extremes():
    """Each number is the smallest or the largest that is allowed, and each of the two occurs."""
    drawn = [soak.extremes(np.random.default_rng(k)) for k in range(40)]
    assert set(drawn[0]) == set(VARIATIONS) - {"current_heading"}
    for name in drawn[0]:
        option = VARIATIONS[name]
        assert {corner[name] for corner in drawn} == {(option.low, option.low), (option.high, option.high)}
    assert set(soak.extremes(np.random.default_rng(0), flat=True)) == set(drawn[0]) - {"pitch", "roll"}


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(soak.PASS)))
def test_every_round(number, monkeypatch):
    """Each combination can be driven; nothing that leaves it is not finite."""
    monkeypatch.setattr(soak, "STEPS", 12)
    name, found = soak.round_of(number, {}, fish=8)
    assert name == " ".join(soak.PASS[number]) and found["fish_steps"] == 96 and found["not_finite"] == 0


def test_a_flat_body_can_be_driven(short, monkeypatch):
    """It stays in its plane, whatever the corner."""
    monkeypatch.setattr(soak, "PASS", [("planar", "swim", "random")])
    assert all(soak.round_of(number, {})[1]["not_finite"] == 0 for number in range(3))


def stored(path):
    """What was stored, without the seconds, which differ from run to run."""
    state = json.loads(path.read_text())
    for row in state["totals"].values():
        assert row.pop("seconds") > 0.0
    return {key: state[key] for key in ("round", "totals", "search")}


def test_it_goes_on_after_an_interruption(short, tmp_path, monkeypatch):
    """A trial that is interrupted within a round and resumed counts what an uninterrupted one does; sessions too."""
    whole, parts = tmp_path / "whole.json", tmp_path / "parts.json"
    soak.soak(whole, 4 * 48)
    drive, calls = soak.drive, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return drive(*arguments)

    monkeypatch.setattr(soak, "drive", interrupted)
    state = soak.soak(parts, 4 * 48)
    assert soak.done(state) == 48 and state["sessions"] == []
    monkeypatch.setattr(soak, "drive", drive)
    state = soak.soak(parts, 4 * 48)
    assert stored(parts) == stored(whole) and soak.done(state) == 4 * 48
    (session,) = state["sessions"]
    assert session["fish_steps"] == 3 * 48 and session["memory_first_mb"] > 10.0
    assert session["rate_last"] > 0.0 and session["rate_fresh"] > 0.0
    rows = soak.rows_of(state)
    assert [row["actions"] for row in rows] == ["adversarial", "random"] and soak.report(state)
    assert sum(row["fish_steps"] for row in rows) == 192 and rows[0]["integrator_steps"] == 6 * 96


def test_the_search_stretches_more(short):
    """What a round of the search finds is remembered, and the spread shrinks towards it."""
    held = {}
    for number in range(1, 9, 2):
        soak.round_of(number, held)
    mean, spread = map(np.array, held["mass_spring"])
    assert mean.any() and spread.mean() < 1.5 and (spread >= 0.15).all()


def test_what_is_not_finite_is_counted():
    """In observations, rewards, last observations and reward terms, each number once."""
    env = SimpleNamespace(single_observation_space=SimpleNamespace(high=np.array([1.0, 10.0])))
    obs, reward = np.array([[0.5, 9.0], [-1.0, -10.0]]), np.zeros(2)
    infos = {
        "final_obs": np.array([None, np.array([1.0, 2.0])], dtype=object),
        "_final_obs": np.array([False, True]),
        "final_info": {"terms": {"speed": np.zeros(2), "_speed": np.ones(2, bool)}},
    }
    assert soak.not_finite(env, obs, reward, infos) == 0
    obs[0, 0], obs[1] = np.nan, (2.0, np.inf)
    reward[1] = np.nan
    infos["final_obs"][1][1] = -np.inf
    infos["final_info"]["terms"]["speed"][0] = np.nan
    assert soak.not_finite(env, obs, reward, infos) == 6


def test_failures_are_counted_by_reason(monkeypatch):
    """A fish that is torn counts as a failure, with its reason, once."""
    env = FishVectorEnv(3, autoreset_mode="SameStep", threads=1)
    step = env.step

    def torn(action):
        env.tank.position[1, 0] += 1.0
        monkeypatch.setattr(env, "step", step)
        return step(action)

    monkeypatch.setattr(env, "step", torn)
    found = soak.drive(env, np.zeros((4, 3, 12), dtype=np.uint8), 0)
    assert found["reasons"] == {"torn": 1} and found["episodes"] == 1 and found["not_finite"] == 0
    env.close()


def test_a_collision_is_no_failure(monkeypatch):
    """An episode may end without a failure of the physics."""
    env = FishVectorEnv(3, autoreset_mode="SameStep", threads=1)
    done = env.tank.num_fish * [True]
    infos = {"final_info": {"terms": {}}, "final_obs": np.zeros((3, 156)), "_final_obs": np.array(done)}
    last = np.zeros((3, 156), np.float32), np.zeros(3), np.array(done), ~np.array(done), infos
    monkeypatch.setattr(env, "step", lambda action: last)
    found = soak.drive(env, np.zeros((1, 3, 12), dtype=np.uint8), 0)
    assert found["reasons"] == {} and found["episodes"] == 3
    env.close()


def test_other_code_is_refused(tmp_path):
    """A trial that was begun with other code does not go on."""
    path = tmp_path / "state.json"
    path.write_text(json.dumps({"code": "other"}))
    with pytest.raises(ValueError, match="other code of fish_env"):
        soak.soak(path, 100)
