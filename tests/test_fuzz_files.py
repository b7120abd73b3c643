"""Files and command lines, damaged and odd: read, or refused in one sentence, and never an error without one."""

import copy
import dataclasses
import io
import json
import os
import struct
import sys
import time
import tracemalloc
import warnings
import zipfile
from collections import Counter

import gymnasium as gym
import numpy as np
import pytest
from fuzzing import CALLS, JSON, call, examples, odd
from hypothesis import HealthCheck, given, settings
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
    shipped_policy,
    write_film,
)
from fish_env.control.motor import MOTOR_FILE, load_tables, swim_mc, turn_mc
from fish_env.control.recording import Recording, arrays_of

FILES = (ValueError, FileNotFoundError, gym.error.Error)
"""What may be raised for a file, whatever is in it."""
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


def call_file(entry, function, *args):
    """As `call`, for what reads files."""
    try:
        result = function(*args)
    except FILES as error:
        assert str(error), f"{entry} raised {type(error).__name__} without a word"
        CALLS[entry, type(error).__name__] += 1
        return None
    CALLS[entry, "accepted"] += 1
    return result


def test_a_head_that_is_no_python(place, recorded, tmp_path):
    """Numpy reads the head of an array as Python; here it must be as numpy writes it, with every bracket closed."""
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
    call_file("load_policy", load_policy, place)
    place.write_bytes(flagged(recorded.save(tmp_path / "episode.npz").read_bytes(), bit))
    call_file("load_recording", load_recording, place)


def test_an_encrypted_policy_is_refused(place):
    """A policy file that asks for a password is a policy file that cannot be read."""
    place.write_bytes(flagged(shipped_policy("swim").read_bytes(), 0))
    with pytest.raises(ValueError, match="is not a policy file, or is damaged"):
        load_policy(place)


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


@pytest.mark.parametrize("text", ["[" * 10**5, '{"turns": ' + "9" * 5000 + "}", " " * 2**21, "\0", '{"turns": 1e999}'])
def test_tables_that_are_not_read(place, text):
    """Deep lists, huge numbers and long files are no tables; nor is a folder, or a name that no file can have."""
    path = place.with_suffix(".json")
    path.write_text(text)
    for wrong in (path, place.parent, place.with_name("x" * 300)):
        with pytest.raises(ValueError, match="holds no tables of motor controllers"):
            load_tables(wrong)


# Files of strangers

SAYS = st.one_of(JSON, st.sampled_from([
    -1, 10**30, 10**99, 1e308, 5e-324, True, "planted:" + SHORT, "a\nb\x1b[2J", "\ud800", "x" * 3000, [[[[[]]]]],
    {"num_envs": 10**9}, {"threads": 10**9}, {"dt": 1e-12}, {"max_episode_steps": 2**53}, {"control_interval": 1e9},
    {"control_interval": 1e-9}, {"body": "tetrahedral"}, {"render_mode": "human"}, {"vector_kwargs": {}}, {"lanes": []},
    {"water": {"current": [[1e308] * 3]}}, {"variation": {"mass": [2, 1]}}, {"muscle_groups": {}}, {"task": "fly"},
]))  # fmt: skip
"""What a part of a description may be instead."""
TEXTS = ["", "null", "[]", "NaN", "[" * 10**5, '{"a":' * 5000, '{"seed": ' + "9" * 5000 + "}", '{"a": 1e999}', "{" * 9]
NAMES = ["../../planted", "/tmp/planted", "weight0", "bias9", "weight00", "weight", "about", "kind", "note", "a\\b", ""]
DTYPES = ["f4", ">f8", "f2", "i8", "i4", "u8", "?", "c16", "g", "U3", "S3", "M8[s]", "O", [("a", float)]]


@st.composite
def said(draw, about):
    """A description in which something is said otherwise, lacks, or has another name; as text."""
    about = copy.deepcopy(about)
    for _ in range(draw(st.integers(1, 2))):
        inner = draw(st.sampled_from([about, *(part for part in about.values() if isinstance(part, dict) and part)]))
        name, value = draw(st.sampled_from(list(inner))), copy.deepcopy(draw(SAYS))
        kind = draw(st.sampled_from(["value", "value", "id", "options", "name", "lacks", "more"]))
        if kind == "id":
            about["env_id"] = draw(st.sampled_from(IDS))
        elif kind == "options":
            about["env_options"] = copy.deepcopy(draw(st.one_of(KEYWORDS, SAYS)))
        elif kind == "value":
            inner[name] = value
        elif kind == "more":
            inner[draw(st.text(max_size=5))] = value
        else:
            held = inner.pop(name)
            inner |= {draw(st.sampled_from(["self", "id", "num_envs", ""])): held} if kind == "name" else {}
        if not about:
            break
    return json.dumps(about)


@st.composite
def parts_of(draw, whole):
    """The parts of a file, some of them renamed, retyped, reshaped, missing, or something else; by name."""
    parts = dict(whole)
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(parts)))
        array = np.asarray(parts[name])
        kind = draw(
            st.sampled_from(["said", "said", "said", "text", "name", "type", "shape", "number", "odd", "lacks"])
        )
        if kind == "said":
            parts["about"] = draw(said(json.loads(str(whole["about"]))))
        elif kind == "text":
            parts["about"] = draw(st.sampled_from(TEXTS))
        elif kind in ("name", "lacks"):
            del parts[name]
            parts |= {draw(st.sampled_from(NAMES)): array} if kind == "name" else {}
        elif kind == "type":
            with np.errstate(all="ignore"):
                parts[name] = array.astype(draw(st.sampled_from(DTYPES)))
        elif kind == "shape":
            parts[name] = draw(st.sampled_from([array.ravel(), array.T, array[None], array.ravel()[:0], array[:0]
                                                if array.ndim else array, np.zeros((array.size, 0))]))  # fmt: skip
        elif kind == "number" and array.size and array.dtype.kind in "fi":
            parts[name] = array.copy()
            parts[name].flat[draw(st.integers(0, array.size - 1))] = draw(st.sampled_from([1e30, -1, 0, 3]))
        elif kind == "odd":
            parts[name] = draw(st.one_of(odd, st.sampled_from([2, 1, -1, 10**30, "2", "{}"])))
    return parts


def zipped(parts, method=zipfile.ZIP_DEFLATED, **sizes) -> bytes:
    """A zip file of parts (name, bytes), with the sizes and places of the first one in its list changed if asked."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there already
        for name, data in parts:
            file.writestr(name + ".npy", data)
        for name, value in sizes.items():
            setattr(file.filelist[0], name, value)
        file._didModify = True
    return out.getvalue()


def npy(array, **head) -> bytes:
    """An array as numpy writes it, with another shape or type in its head if asked."""
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, np.lib.format.header_data_from_array_1_0(np.asarray(array)) | head)
    return out.getvalue() + np.asarray(array).tobytes()


@st.composite
def strange(draw, whole):
    """The bytes of a file near one that is read, of parts `whole`."""
    kind = draw(st.sampled_from(["parts", "parts", "parts", "bytes", "head", "zip"]))
    if kind == "parts":
        try:
            return data_of(draw(parts_of(whole)))
        except (TypeError, ValueError, OSError, RecursionError, AttributeError, OverflowError):
            kind = "bytes"  # numpy cannot write it
    if kind == "bytes":
        return draw(damaged(data_of(whole)))
    parts = [(name, npy(np.asarray(array))) for name, array in whole.items()]
    name = draw(st.sampled_from(sorted(whole)))
    array = np.asarray(whole[name])
    if kind == "head":
        shape = draw(st.sampled_from([(), (0,), (2**62,), (2**31, 2**31), (10**30, 0), (3, 3), (1,) * 70]))
        head = draw(st.sampled_from([{"shape": shape}, {"descr": "|O"}, {"descr": "<U99999"}, {"fortran_order": True}]))
        return zipped([(each, npy(array, **head) if each == name else data) for each, data in parts])
    bomb = ("weight0", npy(np.zeros(0), shape=(2**26,)) + bytes(2**22))
    return draw(st.sampled_from([
        zipped([*parts, parts[0]]), zipped([*parts, bomb]), zipped([bomb, *parts]), zipped(parts, zipfile.ZIP_LZMA),
        zipped(parts, zipfile.ZIP_STORED, header_offset=60), zipped(parts, file_size=9), zipped(parts, file_size=2**40),
        zipped(parts, compress_size=9), zipped(parts, flag_bits=1), zipped([(name, b"") for name, _ in parts]),
    ]))  # fmt: skip


class Watched:
    """What a process does while it is asked: which modules are imported, and which files are opened to be written."""

    asked, imported, written = False, set(), set()

    @classmethod
    def hook(cls, event, arguments):
        if cls.asked and event == "import":
            cls.imported.add(arguments[0].split(".")[0])
        elif cls.asked and event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            cls.written.add(str(arguments[0]))


sys.addaudithook(Watched.hook)


def use_policy(path, folder):
    """Read a policy, and all that is done with one."""
    policy = call_file("load_policy", load_policy, path)
    if policy is not None:
        env = call_file("make_policy_env", make_policy_env, policy, 2)
        if env is not None:
            control = call_file("policy_controller", policy_controller, policy, env)
            if control is not None:
                assert control(env.reset(seed=0)[0], 0.0).shape == (2, *env.single_action_space.shape)
            env.close()
    return [["evaluate", "--episodes", "2", "--policy", str(path)],
            ["play", "--policy", str(path), "--to", str(folder / "film.html")],
            ["evaluate", "swim", "--policy", str(path), "--episodes", "2"]]  # fmt: skip


def use_recording(path, folder):
    """Read a recording, and all that is done with one."""
    one = call_file("load_recording", load_recording, path)
    if one is not None:
        call_file("replay", replay, one)
        call_file("write_film", write_film, one, folder / "film.html")
    return [["replay", str(path)], ["replay", str(path), "--save", str(folder / "film.html")]]


def try_file(use, path):
    """Do all with a file: no other exception, no other module, nothing written elsewhere, and little memory."""
    Watched.imported, Watched.written, Watched.asked = set(), set(), True
    tracemalloc.start()
    begun = time.process_time()
    try:
        for arguments in use(path, path.parent):
            err = io.StringIO()
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(sys, "stderr", err)
                patch.setattr(sys, "stdout", io.StringIO())
                status = command_line.main(arguments)
            lines = err.getvalue().count("\n")
            assert status in (0, 1, 2) and (lines == 1 if status == 2 else not lines), (status, err.getvalue())
            CALLS[f"python -m fish_env {arguments[0]}", f"status {status}"] += 1
        seconds, peak = time.process_time() - begun, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        Watched.asked = False
    assert not Watched.imported & {"planted", "nowhere", "this"}
    assert not {name for name in Watched.written if not name.startswith((str(path.parent), os.devnull))}
    assert peak < MEMORY
    return peak, seconds


KINDS = {"policy": use_policy, "recording": use_recording}


@pytest.fixture(scope="module")
def wholes(recorded):
    """The parts of a good file of each kind; the policy has two small layers."""
    rng = np.random.default_rng(0)
    about = {"env_id": SHORT, "env_options": {"control_interval": 0.02, "heading_error": 0.4}, "task": "swim"}
    policy = {"format": 2, "layout": 1, "about": json.dumps(about), "weight0": rng.normal(size=(156, 4)),
              "bias0": np.zeros(4), "weight1": rng.normal(size=(4, 12)), "bias1": np.zeros(12)}  # fmt: skip
    policy = {name: array.astype(np.float32) if hasattr(array, "ndim") else array for name, array in policy.items()}
    parts = {"kind": "fish_env recording", "format": 1, "about": json.dumps(dict(recorded.about))}
    return {"policy": policy, "recording": parts | arrays_of(recorded)}


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A folder from which modules are imported, and a module in it that no file may have imported."""
    folder = tmp_path_factory.mktemp("modules")
    (folder / "planted.py").write_text("raise SystemExit('imported')")
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


@pytest.mark.parametrize("kind", KINDS)
@examples(75)
@given(data=st.data())
def test_files_of_strangers(place, wholes, planted, kind, data):
    """Files near good ones are read and used, or refused; see `try_file`."""
    place.write_bytes(data.draw(strange(wholes[kind])))
    try_file(KINDS[kind], place)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_files_of_strangers(place, wholes, planted, kind, capsys):
    """2,500 of each kind; prints what became of them, the largest memory and the longest time of a processor."""
    place.write_bytes(data_of(wholes[kind]))
    try_file(KINDS[kind], place)  # what is loaded and compiled once is not the files'
    found, before = [(0, 0.0)], Counter(CALLS)

    @settings(max_examples=2500, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(data=st.data())
    def run(data):
        place.write_bytes(data.draw(strange(wholes[kind])))
        found.append(try_file(KINDS[kind], place))

    run()
    peak, seconds = (max(numbers) for numbers in zip(*found, strict=True))
    with capsys.disabled():
        print(f"\n{len(found) - 1} {kind} files: at most {peak / 1e6:.0f} MB and {seconds:.1f} s; {CALLS - before}")


@pytest.mark.parametrize("kind", KINDS)
def test_the_good_file_of_the_trial_is_used(place, wholes, kind):
    """What the trial changes is read, replayed, played and evaluated as it is: refusals are due to the changes."""
    place.write_bytes(data_of(wholes[kind]))
    before = Counter(CALLS)
    peak, _ = try_file(KINDS[kind], place)
    made = CALLS - before
    refused = sum(count for (_, end), count in made.items() if end not in ("accepted", "status 0"))
    assert refused == 0 and len(made) >= 4 and peak > 0


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
            "nan", "inf", "1e400", "-1", "x", "--tasks", "--integrators", "--help", "", "--",
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
