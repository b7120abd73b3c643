"""Messages of the laboratory's page, and what it is answered, without a browser."""

import json
import struct

import numpy as np
import pytest

from fish_env.lab.own import Own, body_of, own_things
from fish_env.lab.scenes import SCENES
from fish_env.lab.session import Session
from fish_env.lab.stage import Control
from fish_env.lab.swimmers import Swimmers

ASK = {"do": "frame"}


@pytest.fixture(scope="module")
def session():
    """A session that tests leave as it is, but for its scene."""
    session = Session()
    yield session
    session.close()


def told(replies) -> dict:
    """The messages of an answer that are text, together."""
    found = {}
    for reply in replies:
        found |= json.loads(reply) if isinstance(reply, str) else {}
    return found


def picture(replies) -> tuple[dict, np.ndarray]:
    """Header and numbers of the picture in an answer."""
    (data,) = [reply for reply in replies if isinstance(reply, bytes)]
    (size,) = struct.unpack("<I", data[:4])
    return json.loads(data[4 : 4 + size]), np.frombuffer(data[4 + size :], "<f4")


def test_the_first_picture_comes_with_what_it_needs():
    """The first answer describes the stage and its controls; the next one only the picture."""
    session = Session()
    first, second = session.answer(ASK), session.answer(ASK)
    stage = told(first)["stage"]
    assert stage["scene"] == "follow me" and stage["scenes"] == list(SCENES) and len(stage["looks"]) == 1
    assert told(first)["controls"] and not told(second)
    header, numbers = picture(second)
    ((look, nodes, muscles, tones),) = header["bodies"]
    assert (look, tones) == (0, 0) and len(numbers) == 3 * nodes + muscles
    fish = session.stage.fish
    shown = numbers[: 3 * nodes].reshape(-1, 3) * fish.length
    assert shown == pytest.approx(session.stage.shown_positions()[0], abs=1e-5)
    session.close()


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_shown_and_every_control_acts(name, session):
    """Every scene moves, its plots have numbers, and every control takes another value that it offers."""
    assert "tell" not in told(session.answer({"do": "scene", "name": name}))
    stage = session.stage
    stage.advance(0.1)
    header, numbers = picture(session.answer(ASK))
    assert np.isfinite(numbers).all() and len(header["bodies"]) >= 1 and not header["failure"]
    assert [len(row) for row in header["values"]] == [len(plot.lines) for plot in stage.plots]
    assert all(value is not None for row in header["values"] for value in row)
    for control in session.controls():
        if control.group == "Objects" or control.name in ("fish", "driver"):
            continue  # these take another stage
        value = {"button": None, "switch": not control.value, "choice": control.options[-1:] and control.options[-1],
                 "slider": 0.5 * (control.low + control.high)}[control.kind]  # fmt: skip
        assert "tell" not in told(session.answer({"do": "set", "name": control.name, "value": value})), control.name
        now = {each.name: each for each in session.controls()}.get(control.name)
        if control.kind != "button" and now is not None:
            assert now.value == pytest.approx(value)
    session.answer(ASK)


def test_another_object_is_another_look(session):
    """A choice under Objects sends the new looks and plots, and leaves the camera."""
    session.answer({"do": "scene", "name": "soft objects"})
    stage = told(session.answer({"do": "set", "name": "thing 0", "value": "ring"}))["stage"]
    assert stage["again"] and stage["upright"] and len(stage["looks"][0]["surfaces"]) == 2
    for count in (2, 3):
        more = told(session.answer({"do": "set", "name": f"thing {count - 1}", "value": "ring"}))["stage"]
        assert len(more["looks"]) == count and all(len(plot["lines"]) == count for plot in more["plots"][:2])
        session.stage.advance(0.1)
        values = picture(session.answer(ASK))[0]["values"]
        assert len(values[0]) == count and len(values[-1]) == count - 1
        assert all(value is not None for row in values for value in row)
    fewer = told(session.answer({"do": "set", "name": "thing 1", "value": "none"}))["stage"]
    assert len(fewer["looks"]) == 1


def test_a_node_is_dragged(session):
    """A press on a node drags it to where the pointer goes, until it is let go."""
    session.answer({"do": "scene", "name": "finite elements"})
    stage, shown = session.stage, picture(session.answer(ASK))[1][:3].astype(float)
    session.answer({"do": "point", "phase": "start", "point": shown.tolist(), "body": 0})
    assert stage.hand is not None and stage.hand.node == 0
    goal = shown + np.array([0.0, 0.0, 0.3])
    session.answer({"do": "point", "phase": "move", "point": goal.tolist(), "body": 0})
    stage.advance(0.5)
    assert stage.hand.point / stage.length == pytest.approx(goal, abs=1e-3)
    session.answer({"do": "point", "phase": "end", "point": goal.tolist(), "body": 0})
    assert stage.hand is None


@pytest.mark.parametrize(
    "message",
    [None, 3, [], "frame", {}, {"do": "leave"}, {"do": 1}, {"do": "scene"}, {"do": "scene", "name": ["ring"]},
     {"do": "set"}, {"do": "set", "name": "__class__", "value": 1}, {"do": "set", "name": "speed", "value": "fast"},
     {"do": "set", "name": "speed", "value": True}, {"do": "set", "name": "speed", "value": 1e9},
     {"do": "set", "name": "pause", "value": 1}, {"do": "set", "name": {}, "value": 1}, {"do": "point"},
     {"do": "point", "phase": "start", "point": [0, 0, None], "body": 0},
     {"do": "point", "phase": "start", "point": [1e99, 0, 0], "body": 0},
     {"do": "point", "phase": "jump", "point": [0, 0, 0], "body": 0},
     {"do": "point", "phase": "start", "point": [0, 0, 0], "body": True},
     {"do": "point", "phase": "start", "point": [0, 0, 0], "body": 9},
     {"do": "save"}],
)  # fmt: skip
def test_what_a_page_never_sends_is_refused(message, session, capsys):
    """It is told what is wrong, nothing is printed, and the next picture comes as if nothing had been sent."""
    if session.scene != "soft objects":
        session.answer({"do": "scene", "name": "soft objects"})
    before = [(control.name, control.value) for control in session.controls()]
    text = told(session.answer(message))["tell"]
    assert text and "mistake" not in text
    assert [(control.name, control.value) for control in session.controls()] == before
    picture(session.answer(ASK | {"away": "far", "focal": None}))
    assert capsys.readouterr().err == ""


def test_a_failure_is_one_message_and_pauses(session):
    """What fails waits with its reason and its node; half the step is offered then, and starts again."""
    session.answer({"do": "scene", "name": "what the method does"})
    for name, value in (("integrator 0", "explicit_euler"), ("thing 1", "none"), ("step", 50.0)):
        session.answer({"do": "set", "name": name, "value": value})
    session.stage.throw()
    for _ in range(200):
        session.stage.advance(0.02)
    header, _ = picture(session.answer(ASK))
    assert "explicit_euler failed on the ring" in header["failure"] and header["failed"][0] == 0
    assert "halve" in [control.name for control in session.controls()]
    session.answer({"do": "set", "name": "halve", "value": None})
    header, _ = picture(session.answer(ASK))
    assert not header["failure"] and not header["paused"] and session.stage.numbers["step"] == 25.0


def test_a_refused_choice_is_shown_as_it_was(session):
    """What the page chose in vain is sent again; after a failure another choice moves at once."""
    session.answer({"do": "scene", "name": "soft objects"})
    session.answer({"do": "set", "name": "thing 0", "value": "ring"})
    refused = told(session.answer({"do": "set", "name": "integrator 0", "value": "dop853"}))
    shown = {control["name"]: control["value"] for control in refused["controls"]}
    assert refused["tell"] and shown["integrator 0"] == "its own"
    session.answer({"do": "set", "name": "integrator 0", "value": "explicit_euler"})
    session.answer({"do": "set", "name": "step", "value": 50.0})
    session.stage.throw()
    while not session.stage.failure:
        session.answer({"do": "frame", "passed": 0.05})
    session.answer({"do": "set", "name": "integrator 0", "value": "rk4"})
    assert picture(session.answer({"do": "frame", "passed": 0.05}))[0]["time"] == pytest.approx(0.05)


def test_a_pause_and_one_step():
    """While paused nothing moves but by single steps; a slider makes time slower."""
    session = Session()
    session.answer(ASK)
    session.answer({"do": "set", "name": "pause", "value": True})
    before = session.stage.time
    assert picture(session.answer(ASK))[0]["time"] == before
    session.answer({"do": "set", "name": "one_step"})
    assert session.stage.time == pytest.approx(before + session.stage.interval) and session.paused
    session.answer({"do": "set", "name": "reset"})
    assert session.stage.time == 0.0 and not session.paused
    session.close()


def test_a_mistake_of_the_laboratory_does_not_end_the_session(session, capsys, monkeypatch):
    """It is told of, and printed in full for who runs it."""
    monkeypatch.setattr(session, "frame", lambda passed: 1 / 0)
    assert "mistake" in told(session.answer(ASK))["tell"]
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_controls_check_their_values():
    """Every kind refuses what it does not offer, and hands on what it does."""
    taken = []
    slider = Control("slider", "a", "A", taken.append, low=0.0, high=2.0)
    switch = Control("switch", "b", "B", taken.append)
    choice = Control("choice", "c", "C", taken.append, options=["x", "y"])
    for control, good, wrong in (
        (slider, 1.5, (-1.0, 2.1, "1", None, True, float("nan"), [1.0])), (switch, True, (1, None, "true")),
        (choice, "y", ("z", None, 1, ["x"])),
    ):  # fmt: skip
        control.set(good)
        for value in wrong:
            with pytest.raises(ValueError, match=r"give|choose"):
                control.set(value)
    assert taken == [1.5, True, "y"] and "act" not in slider.shown()


def test_own_things(tmp_path):
    """A policy, a body of a file and a task of the user make a scene, which comes first."""
    path = tmp_path / "mine.py"
    path.write_text("import fish_env\n\ndef make():\n    return fish_env.make_fish(length=0.3)\n")
    own = own_things("FishEnv/Turn-v0", None, f"{path}:make")
    session = Session(own)
    assert session.scenes()[0] == session.scene == "your own" and session.stage.length == 0.3
    sliders = [control for control in session.controls() if control.group == "Muscles"]
    sliders[0].set(1.0)
    session.stage.advance(0.3)
    assert np.abs(session.stage.frame().bodies[0].contraction).max() > 0.1
    session.close()
    stage = Session(own_things(None, "target", "planar")).stage
    stage.advance(11.0)
    assert stage.fish.name == "planar" and "episode ended after 10.0 s" in stage.note and stage.frame().touchable
    stage.close()
    for words in ("flying", "nowhere.py:make", f"{path}:other", f"{path}:fish_env"):
        with pytest.raises(ValueError, match=r"choose from|give FILE"):
            body_of(words)
    with pytest.raises(ValueError, match="not registered"):
        own_things("Mine-v0", None, None)
    assert not Own().given


def test_a_school_is_drawn_with_fewer_faces():
    """Skins of many fish are coarser: 64 are drawn as fast as a few."""
    one, many = Swimmers("", ""), Swimmers("", "", num_fish=16)
    assert len(many.looks[0].surfaces[0].faces) < 0.2 * len(one.looks[0].surfaces[0].faces)
    assert len(many.frame().bodies) == 16
    for stage in (one, many):
        stage.close()
