"""Files and command lines, damaged and odd: read, or refused in one sentence, and never an error without one."""

import copy
import dataclasses
import errno
import io
import json
import os
import tracemalloc
from contextlib import redirect_stderr, redirect_stdout
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from fuzzing import JSON, call, examples, odd
from hypothesis import given
from hypothesis import strategies as st

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import (
    load_policy,
    load_recording,
    make_policy_env,
    policy_controller,
    record,
    replay,
    write_film,
)
from fish_env.control.files import write_csv, write_text
from fish_env.control.motor import MOTOR_FILE, load_tables, start_mc, swim_mc, turn_mc
from fish_env.control.recording import arrays_of

FILES = (ValueError, FileNotFoundError, gym.error.Error)
"""What may be raised for a file, whatever is in it."""
call_file = partial(call, refused=FILES)
MEMORY = 200e6  # bytes that reading and using a file may take at most
SHORT = "Stranger/Short-v0"
"""The stub with episodes of three steps: real command lines end at once."""
gym.register(SHORT, "fish_env.envs:StubEnv", vector_entry_point="fish_env.envs:StubVectorEnv", max_episode_steps=3,
             kwargs={"task": "swim"})  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of three environment steps."""
    made = record(gym.make(SHORT), np.zeros((3, 12)), seed=1)
    made.save(tmp_path_factory.mktemp("recorded") / "episode.npz")
    return made


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A file that the examples of this module write, one after the other."""
    return tmp_path_factory.mktemp("fuzz") / "file.npz"


def data_of(arrays) -> bytes:
    """The bytes of an .npz file of these arrays."""
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@st.composite
def damaged(draw, data: bytes):
    """The bytes of a file, some of them changed, lost, doubled or put elsewhere."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.one_of(st.integers(0, len(data) - 1), st.integers(0, 200), st.integers(-200, -1))) % len(data)
        size = draw(st.sampled_from([1, 2, 4, 100]))
        new = draw(st.sampled_from([b"\0" * size, b"\xff" * size, draw(st.binary(min_size=size, max_size=size))]))
        data = draw(st.sampled_from([
            data[:at] + new + data[at + size :], data[:at] + new + data[at:], data[:at] + data[at + size :],
            data[:at], data[at:], data[:at] + data[at : at + size] * 2 + data[at + size :],
        ])) or b"PK"  # fmt: skip
    return data


IDS = ["FishEnv/Stub-v0", "FishEnv/Stub", "Stub", "", "CartPole-v1", "nowhere:FishEnv/Stub-v0", ":", "fish_env:Stub-v0",
       "json:FishEnv/Stub-v0", "FishEnv/Stub-v99", "a b", "FishEnv/", "../x", "fish_env:"]  # fmt: skip
KEYWORDS = st.dictionaries(
    st.sampled_from(["body", "speed", "num_envs", "dt", "water", "variation", "x", "max_episode_steps", "self"]), JSON,
    max_size=2,
)  # fmt: skip


def test_a_film_of_another_fish_is_refused(recorded, place):
    """A recording that holds fewer rest lengths than the fish of its environment has is refused before it is drawn."""
    other = dataclasses.replace(recorded, rest_length=recorded.rest_length[:, :0])
    with pytest.raises(ValueError, match=r"rest lengths of shapes .* record the episode again"):
        write_film(other, place.with_suffix(".html"))


@examples(30)
@given(data=st.data())
def test_layouts_and_tables(place, data):
    """The layout of any id and the tables of any file, or an error that says why not."""
    id = data.draw(st.one_of(st.sampled_from(IDS), odd))
    call(fish_env.observation_layout, id, **data.draw(KEYWORDS))
    place.with_suffix(".json").write_text(data.draw(st.one_of(st.text(max_size=20), JSON.map(json.dumps))))
    call_file(load_tables, place.with_suffix(".json"))


TABLES = json.loads(MOTOR_FILE.read_text())["drag"]


@examples(80)
@given(data=st.data())
def test_tables_with_other_numbers(place, data):
    """Tables of which a number, a row or a part is another one: refused, or contractions that are numbers."""
    found = copy.deepcopy({name: TABLES[name] for name in ("turns", "swims", "front", "lag", "starts")})
    part = data.draw(st.sampled_from(list(found)))
    value = data.draw(st.one_of(JSON, st.floats(0.0, 1.0), st.sampled_from([1, True, "0.5", [1], np.nan, -1.0])))
    if part == "front":
        found[part] = value
    else:
        at = data.draw(st.integers(0, len(found[part]) - 1))
        if part == "lag" or data.draw(st.integers(0, 5)) == 0:
            found[part][at] = value
        else:
            found[part][at][data.draw(st.sampled_from(list(found[part][at])))] = value
    place.with_suffix(".json").write_text(json.dumps(found))
    tables = call_file(load_tables, place.with_suffix(".json"))
    if tables is not None:
        turns, swims = tables.turns.at(np.array([0.5, 2.0])), tables.swims.at(np.array([0.1, 0.8]))
        added = [
            turn_mc(turns, np.array([1.0, -1.0]), np.array([0.0, 0.2]))[0],
            swim_mc(tables, swims, np.zeros((2, 2))),
        ]
        starts = tables.starts.at(np.array([0.5, 2.0]))
        added.append(start_mc(starts, np.array([1.0, -1.0]), np.array([0.0, 0.2]))[0])
        assert np.isfinite(added).all() and added[0].min() >= 0.0 and added[0].max() <= 1.0


@pytest.mark.parametrize("text", ["[" * 10**5, '{"turns": ' + "9" * 5000 + "}", "\0", '{"turns": 1e999}'])
def test_tables_that_are_not_read(place, text):
    """Deep lists and huge numbers are no tables; nor is a folder, or a name that no file can have."""
    path = place.with_suffix(".json")
    path.write_text(text)
    for wrong in (path, place.parent, place.with_name("x" * 300)):
        with pytest.raises(ValueError, match="holds no tables of motor controllers"):
            load_tables(wrong)


# Files of strangers

SAYS = st.one_of(JSON, st.sampled_from([
    -1, 10**30, 1e308, 5e-324, True, "a\nb\x1b[2J", "\ud800", "x" * 3000, {"num_envs": 10**9}, {"threads": 10**9},
    {"dt": 1e-12}, {"max_episode_steps": 2**53}, {"control_interval": 1e9}, {"body": "tetrahedral"}, {"lanes": []},
    {"render_mode": "human"}, {"water": {"current": [[1e308] * 3]}}, {"variation": {"mass": [2, 1]}}, {"task": "fly"},
]))  # fmt: skip
"""What a part of a description may be instead."""
TEXTS = ["", "null", "[]", "NaN", "[" * 10**5, '{"a":' * 5000, '{"seed": ' + "9" * 5000 + "}", "{" * 9]
NAMES = ["../../planted", "weight0", "bias9", "weight00", "weight", "about", "kind", "a\\b", ""]
DTYPES = ["f4", ">f8", "f2", "i8", "u8", "?", "c16", "g", "U3", "M8[s]", "O"]


@st.composite
def said(draw, about):
    """A description in which something is said otherwise, or lacks; as text."""
    about = copy.deepcopy(about)
    inner = draw(st.sampled_from([about, *(part for part in about.values() if isinstance(part, dict) and part)]))
    name, kind = draw(st.sampled_from(list(inner))), draw(st.sampled_from(["value", "id", "options", "lacks", "more"]))
    if kind == "id":
        about["env_id"] = draw(st.sampled_from(IDS))
    elif kind == "options":
        about["env_options"] = draw(st.one_of(KEYWORDS, SAYS))
    elif kind == "lacks":
        del inner[name]
    else:
        inner[name if kind == "value" else draw(st.text(max_size=5))] = draw(SAYS)
    return json.dumps(about)


@st.composite
def parts_of(draw, whole):
    """The parts of a file, one of them renamed, retyped, reshaped, missing, or something else; by name."""
    parts, name = dict(whole), draw(st.sampled_from(sorted(whole)))
    array = np.asarray(parts.pop(name))
    changed = {
        "said": ("about", draw(said(json.loads(str(whole["about"]))))),
        "text": ("about", draw(st.sampled_from(TEXTS))),
        "name": (draw(st.sampled_from(NAMES)), array),
        "shape": (name, draw(st.sampled_from([array.ravel(), array.T, array[None], np.zeros((array.size, 0))]))),
        "odd": (name, draw(st.one_of(odd, st.sampled_from([2, 1, -1, 10**30, np.inf, "2", "{}"])))),
    }
    kind = draw(st.sampled_from(["said", *changed, "type", "number", "lacks"]))
    if kind in changed:
        return (whole if kind in ("said", "text") else parts) | dict([changed[kind]])
    if kind == "type":
        with np.errstate(all="ignore"):
            parts[name] = array.astype(draw(st.sampled_from(DTYPES)))
    elif kind == "number" and array.size and array.dtype.kind in "fi":
        parts[name] = array.copy()
        parts[name].flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from([1e30, -1, 0, 3]))
    return parts


@st.composite
def strange(draw, whole):
    """The bytes of a file near one that is read, of parts `whole`; test_files.py has archives that lie."""
    try:
        return data_of(draw(parts_of(whole)))
    except (TypeError, ValueError, OSError, RecursionError, AttributeError, OverflowError):
        return draw(damaged(data_of(whole)))  # numpy cannot write what was drawn


def use_policy(path, folder):
    """Read a policy, and all that is done with one."""
    policy = call_file(load_policy, path)
    env = policy and call_file(make_policy_env, policy, 2)
    control = env and call_file(policy_controller, policy, env)
    if control is not None:
        assert control(env.reset(seed=0)[0], 0.0).shape == (2, *env.single_action_space.shape)
    return [["evaluate", "--episodes", "2", "--policy", str(path)],
            ["play", "--policy", str(path), "--to", str(folder / "film.html")],
            ["evaluate", "swim", "--policy", str(path), "--episodes", "2"]]  # fmt: skip


def use_recording(path, folder):
    """Read a recording, and all that is done with one."""
    one = call_file(load_recording, path)
    if one is not None:
        call_file(replay, one)
        call_file(write_film, one, folder / "film.html")
    return [["replay", str(path)], ["replay", str(path), "--save", str(folder / "film.html")]]


def try_file(use, path):
    """Do all with a file: no other exception, a line for each error, and little memory."""
    statuses = []
    tracemalloc.start()
    try:
        for arguments in use(path, path.parent):
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
                statuses.append(status := command_line.main(arguments))
            lines = err.getvalue().count("\n")
            assert status in (0, 1, 2) and (lines == 1 if status == 2 else not lines), (status, err.getvalue())
        assert tracemalloc.get_traced_memory()[1] < MEMORY
    finally:
        tracemalloc.stop()
    return statuses


KINDS = {"policy": use_policy, "recording": use_recording}


@pytest.fixture(scope="module")
def wholes(recorded):
    """The parts of a good file of each kind; the policy has two small layers."""
    rng = np.random.default_rng(0)
    about = {"env_id": SHORT, "env_options": {"control_interval": 0.02, "heading_error": 0.4}, "task": "swim"}
    policy = {"format": 3, "layout": 1, "about": json.dumps(about), "hidden": "relu", "output": "tanh",
              "mean": np.zeros(156), "deviation": np.ones(156), "limit": 10.0, "weight0": rng.normal(size=(156, 4)),
              "bias0": np.zeros(4), "weight1": rng.normal(size=(4, 12)), "bias1": np.zeros(12)}  # fmt: skip
    policy = {name: array.astype(np.float32) if hasattr(array, "ndim") else array for name, array in policy.items()}
    parts = {"kind": "fish_env recording", "format": 1, "about": json.dumps(dict(recorded.about))}
    return {"policy": policy, "recording": parts | arrays_of(recorded)}


@pytest.fixture(autouse=True)
def quiet(monkeypatch):
    """No word of the compiler among the errors of files."""
    monkeypatch.setenv("FISH_ENV_QUIET", "1")


@pytest.mark.parametrize("kind", KINDS)
@examples(10)
@given(data=st.data())
def test_files_of_strangers(place, wholes, kind, data):
    """Files near good ones are read and used, or refused; see `try_file`."""
    place.write_bytes(data.draw(strange(wholes[kind])))
    try_file(KINDS[kind], place)


@pytest.mark.parametrize("kind", KINDS)
def test_the_good_file_of_the_trial_is_used(place, wholes, kind):
    """What the trial changes is read, replayed, played and evaluated as it is: refusals are due to the changes."""
    place.write_bytes(data_of(wholes[kind]))
    assert set(try_file(KINDS[kind], place)) == {0}


# Disks that fail


def write_policy(path, marks):
    """A file of a policy whose mark is told by `about`."""
    policy = load_policy("swim")
    dataclasses.replace(policy, about={**policy.about, "mark": marks}).save(path)


WRITERS = {
    "policy.npz": write_policy,
    "model.pt": lambda path, marks: load_policy(("swim", "turn")[marks]).to_torchscript(path),
    "policy.onnx": lambda path, marks: load_policy(("swim", "turn")[marks]).to_onnx(path),
    "episode.npz": lambda path, marks: record(gym.make(SHORT), np.full((3, 12), marks), seed=1).save(path),
    "film.html": lambda path, marks: write_film(record(gym.make(SHORT), np.full((3, 12), marks), seed=1), path),
    "film.webp": lambda path, marks: write_film(record(gym.make(SHORT), np.full((3, 12), marks), seed=1), path),
    "table.csv": lambda path, marks: write_csv(path, [["a", "b"], *[[marks, "é"]] * 3000]),
    "results.json": lambda path, marks: write_text(path, json.dumps({"marks": [marks] * 3000})),
}
"""Every kind of file, written with the mark 0 or 1."""


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_fails(name, tmp_path, monkeypatch):
    """Whichever of the writes, of the flushes and of the renames fails: an error says so, and the old file is whole."""
    resource = pytest.importorskip("resource", reason="this system has no limit on the size of a file")
    pytest.importorskip(
        {"pt": "torch", "onnx": "onnx", "html": "pygame", "webp": "PIL"}.get(name.split(".")[1], "numpy")
    )
    path, write = tmp_path / name, WRITERS[name]
    write(path, 1)
    size = path.stat().st_size
    write(path, 0)
    before = path.read_bytes()

    def fails():
        with pytest.raises((OSError, ValueError)):
            write(path, 1)
        assert path.read_bytes() == before and [each.name for each in tmp_path.iterdir()] == [name]

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for written in (0, 1, size // 3, size - 1):
        resource.setrlimit(resource.RLIMIT_FSIZE, (written, limits[1]))  # the write that would pass it fails
        try:
            fails()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    for each in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, each, partial(refuse, each))
            fails()
    write(path, 1)
    assert path.read_bytes() != before


def refuse(call, *arguments):
    """A system call that fails."""
    raise OSError(errno.EIO, f"{call} failed")


# Command lines

WORDS = ["play", "evaluate", "replay", "versions", "swim", "turn", "fly", "", "-", "--", "--help", "-h", "--to",
         "--save", "--seed", "--episodes", "--body", "--policy", "--integrator", "planar", "rk4", "radau2", "0", "1",
         "-1", "1e3", "9" * 30, "x.json", "x.npz", "x.html", "/", "/proc/version", "pyproject.toml", "é\udcff", "a b",
         "--seed=1", "--body=", "--x", "@x", "\0"]  # fmt: skip


@examples(60)
@given(arguments=st.lists(st.sampled_from(WORDS), max_size=6))
def test_command_lines(tmp_path_factory, arguments):
    """`python -m fish_env` with any words: done, or one line and status 2; it writes nothing outside its folder."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
        patch.chdir(tmp_path_factory.getbasetemp())
        patch.setattr("fish_env.training.report.evaluate", lambda env, policy, seed: {"speed": np.zeros(env.num_envs)})
        patch.setattr(command_line, "play", lambda *arguments, **options: None)
        try:
            status = command_line.main(arguments)
        except SystemExit as end:
            status = end.code
    assert status in (0, 2) and (status == 0) == (not err.getvalue()), (arguments, status, err.getvalue())
