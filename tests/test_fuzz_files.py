"""Files and command lines, damaged and odd: read, or refused in one sentence, and never an error without one."""

import copy
import dataclasses
import io
import json
import struct
import sys
import zipfile

import numpy as np
import pytest
from fuzzing import CALLS, JSON, call, examples, odd
from hypothesis import given
from hypothesis import strategies as st

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import load_policy, load_recording, record, replay, shipped_policy, write_film
from fish_env.control.motor import MOTOR_FILE, load_tables, swim_mc, turn_mc
from fish_env.control.recording import SHAPES, Recording

OBSERVED = np.zeros((2, 156), np.float32)
FILES = (ValueError, FileNotFoundError)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of three environment steps."""
    import gymnasium as gym

    env = gym.make("FishEnv/Stub-v0", max_episode_steps=3)
    made = record(env, np.zeros((3, 12)), seed=1)
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
        at = draw(
            st.one_of(st.integers(0, len(data) - 1), st.integers(0, 200), st.integers(-200, -1).map(len(data).__add__))
        )
        at = min(max(at, 0), len(data) - 1)
        size = draw(st.sampled_from([1, 2, 4, 100]))
        new = draw(st.sampled_from([b"\0" * size, b"\xff" * size, draw(st.binary(min_size=size, max_size=size))]))
        data = draw(st.sampled_from([
            data[:at] + new + data[at + size :], data[:at] + new + data[at:], data[:at] + data[at + size :],
            data[:at], data[at:], data[:at] + data[at : at + size] * 2 + data[at + size :],
        ])) or b"PK"  # fmt: skip
    return data


def flagged(data: bytes, bit: int) -> bytes:
    """A zip file all of whose parts have a flag set: bit 0 says that they are encrypted."""
    out = bytearray(data)
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = out.find(signature)
        while at >= 0:
            struct.pack_into("<H", out, at + offset, struct.unpack_from("<H", out, at + offset)[0] | 1 << bit)
            at = out.find(signature, at + 4)
    return bytes(out)


def read_policy(path):
    """Read a policy file; one that can be read gives finite actions."""
    policy = call_file("load_policy", load_policy, path)
    if policy is not None and policy.weights[0].shape[0] == OBSERVED.shape[1]:
        with np.errstate(all="ignore"):
            assert np.isfinite(policy(OBSERVED)).all()


def call_file(entry, function, *args):
    """As `call`, for functions that also say that there is no file."""
    try:
        return call(entry, function, *args)
    except FileNotFoundError:
        CALLS[entry, "FileNotFoundError"] += 1
        return None


@examples(150)
@given(data=st.data())
def test_damaged_policies(place, data):
    """A policy file with bytes changed, lost or added is read as it was, or refused."""
    place.write_bytes(data.draw(damaged(shipped_policy("swim").read_bytes())))
    read_policy(place)


@examples(60)
@given(data=st.data())
def test_damaged_recordings(place, recorded, data):
    """A recording with bytes changed, lost or added is read as it was, or refused."""
    parts = {"kind": "fish_env recording", "format": 1, "about": json.dumps(dict(recorded.about))}
    whole = data_of(parts | {name: getattr(recorded, name) for name in SHAPES})
    place.write_bytes(data.draw(damaged(whole)))
    call_file("load_recording", load_recording, place)


def test_a_head_that_is_no_python(place, recorded, tmp_path):
    """Numpy reads the head of an array as Python, and ends in a TokenError where a bracket is not closed."""
    for read, whole in ((load_policy, shipped_policy("swim")), (load_recording, recorded.save(tmp_path / "whole.npz"))):
        with zipfile.ZipFile(whole) as old, zipfile.ZipFile(place, "w") as new:
            for name in old.namelist():
                new.writestr(name, old.read(name).replace(b"}", b"(", 1))
        with pytest.raises(ValueError, match=r"file\.npz"):
            read(place)


@pytest.mark.parametrize("bit", [0, 3, 5, 6, 11, 13])
def test_flagged_files(place, recorded, tmp_path, bit):
    """Files whose parts are said to be encrypted, patched or of another kind are read or refused."""
    place.write_bytes(flagged(shipped_policy("swim").read_bytes(), bit))
    read_policy(place)
    place.write_bytes(flagged(recorded.save(tmp_path / "episode.npz").read_bytes(), bit))
    call_file("load_recording", load_recording, place)


def test_an_encrypted_policy_is_refused(place):
    """A policy file that asks for a password is a policy file that cannot be read."""
    place.write_bytes(flagged(shipped_policy("swim").read_bytes(), 0))
    with pytest.raises(ValueError, match="is not a policy file, or is damaged"):
        load_policy(place)


@examples(80)
@given(data=st.data())
def test_odd_parts_of_policies(place, data):
    """A whole file with parts of other types, shapes and numbers."""
    with np.load(shipped_policy("swim")) as file:
        parts = dict(file)
    name = data.draw(st.sampled_from([*parts, "weight9", "note"]))
    changed = data.draw(st.one_of(odd, st.sampled_from([2, 1, -1, 10**30, "2", "{}", '{"env_id": 3}', "[" * 5000])))
    try:
        place.write_bytes(data_of(parts | {name: changed}))
    except (TypeError, ValueError, OSError, RecursionError, AttributeError):
        return  # numpy cannot write it
    read_policy(place)


IDS = ["FishEnv/Stub-v0", "FishEnv/Stub", "Stub", "", "CartPole-v1", "nowhere:FishEnv/Stub-v0", ":", "fish_env:Stub-v0",
       "json:FishEnv/Stub-v0", "FishEnv/Stub-v99", "a b", "FishEnv/", "../x", "fish_env:"]  # fmt: skip
KEYWORDS = st.dictionaries(
    st.sampled_from(["body", "speed", "num_envs", "dt", "water", "variation", "x", "max_episode_steps", "self"]), JSON,
    max_size=2,
)  # fmt: skip


@examples(60)
@given(data=st.data())
def test_odd_recordings(place, recorded, tmp_path_factory, data):
    """Recordings that say anything of themselves, or hold other arrays: replayed, filmed, or refused."""
    about, arrays = dict(recorded.about), {name: getattr(recorded, name) for name in SHAPES}
    name = data.draw(st.sampled_from([*about, *arrays, "note"]))
    if name == "env_id":
        about[name] = data.draw(st.sampled_from(IDS))
    elif name == "env_options":
        about[name] = data.draw(KEYWORDS)
    elif name in arrays:
        arrays[name] = data.draw(odd)
    else:
        about[name] = data.draw(JSON)
    parts = {"kind": "fish_env recording", "format": 1, "about": json.dumps(about)}
    try:
        place.write_bytes(data_of(parts | arrays))
    except (TypeError, ValueError, RecursionError, AttributeError):
        return  # numpy cannot write it
    found = call_file("load_recording", load_recording, place)
    if isinstance(found, Recording):
        call("replay", replay, found)
        call("write_film", write_film, found, place.with_suffix(".html"))


def test_a_film_of_another_fish_is_refused(recorded, place):
    """A recording that holds fewer rest lengths than the fish of its environment has is refused before it is drawn."""
    other = dataclasses.replace(recorded, rest_length=recorded.rest_length[:, :0])
    with pytest.raises(ValueError, match=r"rest lengths of shapes .* record the episode again"):
        write_film(other, place.with_suffix(".html"))


@pytest.mark.parametrize("part", ["format", "layout"])
def test_a_policy_of_an_infinite_version_is_refused(place, part):
    """A version that no whole number can hold is refused as damage."""
    with np.load(shipped_policy("swim")) as file:
        parts = {name: file[name] for name in file.files}
    np.savez(place, **(parts | {part: np.inf}))
    with pytest.raises(ValueError, match="damaged"):
        load_policy(place)


@pytest.mark.parametrize("id", ["nowhere:FishEnv/Stub-v0", "CartPole-v1"])
def test_recordings_of_other_environments_are_refused(recorded, place, id):
    """A file that names a module that there is not, or an environment without a fish, is refused in a sentence."""
    other = Recording(**vars(recorded) | {"about": {**recorded.about, "env_id": id}})
    for use in (lambda: replay(other), lambda: write_film(other, place.with_suffix(".html"))):
        with pytest.raises(ValueError, match=r"cannot be made here|one fish|not an environment of fish"):
            use()


@examples(30)
@given(data=st.data())
def test_layouts_and_tables(place, data):
    """The layout of any id and the tables of any file, or an error that says why not."""
    id = data.draw(st.one_of(st.sampled_from(IDS), odd))
    call("observation_layout", fish_env.observation_layout, id, **data.draw(KEYWORDS))
    place.with_suffix(".json").write_text(data.draw(st.one_of(st.text(max_size=20), JSON.map(json.dumps))))
    call_file("load_tables", load_tables, place.with_suffix(".json"))


TABLES = json.loads(MOTOR_FILE.read_text())


@examples(80)
@given(data=st.data())
def test_tables_with_other_numbers(place, data):
    """Tables of which a number, a row or a part is another one: refused, or contractions that are numbers."""
    found = copy.deepcopy({name: TABLES[name] for name in ("turns", "swims", "front", "lag")})
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
    tables = call_file("load_tables", load_tables, place.with_suffix(".json"))
    if tables is not None:
        turns, swims = tables.turns.at(np.array([0.5, 2.0])), tables.swims.at(np.array([0.1, 0.8]))
        added = [
            turn_mc(turns, np.array([1.0, -1.0]), np.array([0.0, 0.2]))[0],
            swim_mc(tables, swims, np.zeros((2, 2))),
        ]
        assert np.isfinite(added).all() and added[0].min() >= 0.0 and added[0].max() <= 1.0


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("front", "1.0", "front is '1.0'; give"),
        ("front", -1.0, "front is -1.0"),
        ("lag", [0.0, 0.1], r"lag \(rad\) has shape \(2,\)"),
        ("lag", ["a", "b", "c"], r"lag \(rad\) is"),
        ("lag", [0.0, float("nan"), 0.0], r"lag \(rad\) is nan"),
    ],
)
def test_tables_of_other_parts_are_refused(place, part, value, message):
    """The numbers beside the tables are looked at as well."""
    place.with_suffix(".json").write_text(json.dumps(TABLES | {part: value}))
    with pytest.raises(ValueError, match=rf"holds no tables of motor controllers: .*{message}"):
        load_tables(place.with_suffix(".json"))


# Command lines

WORDS = ["play", "evaluate", "replay", "versions", "swim", "turn", "fly", "", "-", "--", "--help", "-h", "--to",
         "--save", "--seed", "--episodes", "--body", "--policy", "--integrator", "planar", "rk4", "radau2", "0", "1",
         "-1", "1e3", "9" * 30, "x.json", "x.npz", "x.html", "/", "/proc/version", "pyproject.toml", "é\udcff", "a b",
         "--seed=1",
         "--body=", "--x", "@x", "\0"]  # fmt: skip


@examples(60)
@given(arguments=st.lists(st.sampled_from(WORDS), max_size=6))
def test_command_lines(tmp_path_factory, arguments):
    """`python -m fish_env` with any words: done, or one line and status 2; it writes nothing outside its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.getbasetemp())
        patch.setattr(command_line, "evaluate", lambda controller, env, seed: {"speed": np.zeros(env.num_envs)})
        patch.setattr(command_line, "play", lambda *arguments, **options: None)
        patch.setattr(sys, "stderr", io.StringIO())
        patch.setattr(sys, "stdout", io.StringIO())
        try:
            status = command_line.main(arguments)
        except SystemExit as end:
            status = end.code
        said = sys.stderr.getvalue()
    assert status in (0, 2) and (status == 0) == (not said), (arguments, status, said)
    CALLS["python -m fish_env", f"status {status}"] += 1


TRAINING = ["swim", "all", "evaluate", "compare", "report", "play", "--seed", "--timesteps", "--num-envs", "--dt", "1",
            "nan", "inf", "1e400", "-1", "x", "--tasks", "--learner", "sb3", "--integrators", "--help", "", "--",
            "é"]  # fmt: skip


@examples(60)
@given(arguments=st.lists(st.sampled_from(TRAINING), max_size=5))
def test_training_command_lines(arguments):
    """The command line of `train.py`, of any words, is understood or refused by argparse with status 2."""
    train = pytest.importorskip("train")
    pytest.importorskip("torch")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["train.py", *arguments])
        patch.setattr(sys, "stderr", io.StringIO())
        patch.setattr(sys, "stdout", io.StringIO())
        try:
            train.parse()
        except SystemExit as end:
            assert end.code in (0, 2), arguments
            CALLS["train.py", f"status {end.code}"] += 1
            return
    CALLS["train.py", "accepted"] += 1


def test_a_damaged_file_is_one_that_zip_refuses(place):
    """The damage that the tests do is real: a file that is cut short is no zip file any more."""
    place.write_bytes(shipped_policy("swim").read_bytes()[:-30])
    assert not zipfile.is_zipfile(place)
