"""Files: written whole by one writer at a time, and read within bounds whoever wrote them."""

import io
import json
import os
import shutil
import sys
import tracemalloc
import zipfile
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from fish_env import __main__ as command_line
from fish_env.control import (
    Normalisation,
    Policy,
    load_policy,
    load_recording,
    make_eval_env,
    make_policy_env,
    play,
    record,
    replay,
    write_film,
)
from fish_env.control import npz as reader
from fish_env.control import recording as recordings
from fish_env.control.files import replacing, writable_file, write_text
from fish_env.control.npz import LARGEST

STUB = "FishEnv/Stub-v0"


def stub_policy(**about) -> Policy:
    """A policy for the stub, of one layer."""
    return Policy((np.zeros((156, 12), np.float32),), (np.zeros(12, np.float32),), {"env_id": STUB} | about)


def stub_recording(**about):
    """Two steps of the stub, of which something else may be said."""
    one = record(gym.make(STUB, max_episode_steps=3), np.zeros((2, 12)), seed=1)
    return replace(one, about=one.about | about)


# Written


@pytest.mark.parametrize("name", ["policy.npz", "x.json", "e\u0301.html", "n" * 245 + ".csv", "bare"])
def test_two_writers_of_one_file(name, tmp_path):
    """Each writes a file of its own with the same ending; the last to end is what is there, whole."""
    path = tmp_path / name
    with replacing(path) as one, replacing(path) as other:  # `other` ends first
        assert one != other and {one.suffix, other.suffix} == {path.suffix} and one.parent == tmp_path
        one.write_text("one " * 1000)
        other.write_text("other")
        assert not path.exists()
    assert path.read_text() == "one " * 1000 and list(tmp_path.iterdir()) == [path]


def test_nothing_is_written_through_a_link(tmp_path, monkeypatch):
    """A link that waits in the folder, even under the very name that is drawn, leads to no other file."""
    victim, path = tmp_path / "victim", tmp_path / "folder" / "model.zip"
    path.parent.mkdir()
    victim.write_text("mine")
    monkeypatch.setattr("secrets.token_hex", lambda count: "drawn")
    write_text(path, "new")
    path.with_name(".model-partial-drawn.zip").symlink_to(victim)
    with pytest.raises(FileExistsError):
        write_text(path, "newer")
    assert victim.read_text() == "mine" and path.read_text() == "new" and len(list(path.parent.iterdir())) == 2


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit, MemoryError])
def test_nothing_is_left_of_what_was_not_finished(error, tmp_path):
    """Whatever is raised, the old file is there, and nothing beside it."""
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(error), replacing(path) as partial:
        partial.write_text("ne")
        raise error
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_a_policy_is_read_as_it_was_written(tmp_path, monkeypatch):
    """A policy read back from its file acts the same, bit for bit, also after another was not written to the end."""
    path, rng = tmp_path / "policy.npz", np.random.default_rng(0)
    layers = tuple(rng.normal(size=size).astype(np.float32) for size in ((156, 8), (8, 6)))
    policy = Policy(layers, (np.ones(8, np.float32), np.zeros(6, np.float32)), {"env_id": STUB})
    policy.save(path)

    def fail(file, **arrays):
        file.write_bytes(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="no space left"):
        stub_policy().save(path)
    obs = rng.normal(size=(5, 156))
    np.testing.assert_array_equal(load_policy(path, STUB)(obs), policy(obs))
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_others_may_read_what_the_user_lets_them(umask, tmp_path):
    """The rights of a file are those of any new file."""
    before = os.umask(umask)
    stub_policy().save(tmp_path / "policy.npz")
    os.umask(before)
    assert (tmp_path / "policy.npz").stat().st_mode & 0o777 == 0o666 & ~umask


def test_files_are_tried_before_anything_is_computed(tmp_path):
    """Names that are too long, other endings, and files and folders in place of each other change nothing."""
    taken, long = tmp_path / "taken", "x" * 300
    taken.write_text("content")
    (tmp_path / "folder.gif").mkdir()
    for path, message in (
        (taken / "x.gif", "no file can be written in the folder"),
        (tmp_path, "ends in ''"),
        (tmp_path / "x.avi", r"give a name that ends in .mp4 or .gif"),
        (tmp_path / "folder.gif", "is a folder"),
        (tmp_path / f"{long}.gif", r"no file can be written as .*give another name"),
    ):
        with pytest.raises(ValueError, match=message):
            writable_file(path, (".mp4", ".gif"))
    assert writable_file(tmp_path / "new" / "x.gif", (".gif",)).parent.is_dir()
    assert taken.read_text() == "content" and not list((tmp_path / "new").iterdir())
    for read in (load_policy, load_recording):
        with pytest.raises(FileNotFoundError, match="there is no"):
            read(tmp_path / f"{long}.npz")


# Read: archives


def archive(path, parts, kind=zipfile.ZIP_DEFLATED, **changes):
    """An archive of parts (name, bytes, how often the bytes stand there), its list changed for the last part."""
    with zipfile.ZipFile(path, "w", kind) as file:
        for name, data, often in parts:
            with file.open(name, "w") as part:
                for _ in range(often):
                    part.write(data)
        for name, value in changes.items():
            setattr(file.filelist[-1], name, value)


def array(shape, data=b"", descr="<f4"):
    """A part that says that it is an array of this shape and type, and holds these bytes."""
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": descr, "fortran_order": False, "shape": shape})
    return "a.npy", out.getvalue() + data, 1


MB = bytes(2**20)
BAD = {
    "unpacks to 100 MB": ([("a.npy", MB, 100)], {}, "says that it unpacks to 104,857,600; at most"),
    "many parts of 1 MB": ([(f"{k}.npy", MB, 1) for k in range(40)], {}, "says that it unpacks to"),
    "unpacks to more than it says": ([("a.npy", MB, 100)], {"file_size": 1000}, "not an array|CRC|npz is"),
    "is shorter than it says": ([array((2**20,), bytes(16))], {"file_size": 2**22}, "EOF|array data"),
    "another compression": ([("a.npy", MB, 1)], {"kind": zipfile.ZIP_BZIP2}, "compressed otherwise"),
    "nothing, of huge axes": ([array((0, 10**30))], {}, "too large|too big|exceeded|convert"),
    "very many axes": ([array((1,) * 100, bytes(4))], {}, "dimension"),
    "an encrypted part": ([array((4,), bytes(16))], {"flag_bits": 1}, "encrypted"),
    "objects": ([array((), b"cos\nsystem\n.", "|O")], {}, "allow_pickle=False"),
}


@pytest.mark.parametrize("kind", BAD)
def test_archives_that_are_not_what_they_say(kind, tmp_path):
    """Refused in a sentence that names the file, before more memory is taken than the largest honest file needs."""
    path = tmp_path / "file.npz"
    parts, changes, message = BAD[kind]
    archive(path, parts, **changes)
    tracemalloc.start()
    try:
        for read, name in ((load_policy, "policy file"), (load_recording, "recording")):
            with pytest.raises(ValueError, match=rf"file\.npz is not a {name}, or is damaged or pickled .*({message})"):
                read(path)
        assert tracemalloc.get_traced_memory()[1] < 2 * LARGEST
    finally:
        tracemalloc.stop()


def test_an_array_that_is_not_there(tmp_path):
    """A head of four terabytes over sixteen bytes is refused; nothing is written to such an array."""
    archive(tmp_path / "file.npz", [array((2**40,), bytes(16))])
    with pytest.raises(ValueError, match="is not a policy file, or is damaged"):
        load_policy(tmp_path / "file.npz")


@pytest.mark.parametrize("text", ["[" * 100_000, '{"seed": ' + "9" * 5000 + "}", "[]", "3", ""])
def test_descriptions_that_are_not_read(text, tmp_path):
    """A description that is deep, of huge numbers or no dictionary is refused."""
    np.savez(tmp_path / "policy.npz", format=2, layout=1, about=text, weight0=np.zeros((1, 1)), bias0=np.zeros(1))
    with pytest.raises(ValueError, match=r"policy\.npz cannot be used: .*(about|Expecting|digits)"):
        load_policy(tmp_path / "policy.npz")


def test_a_large_recording_is_read_again(tmp_path, monkeypatch):
    """One whose numbers hardly differ, and which would shrink more than a file may unpack to, is written as it is."""
    one = stub_recording()
    small = one.save(tmp_path / "small.npz").stat().st_size
    for place, name, number in ((reader, "LARGEST", 1000), (reader, "RATIO", 1), (recordings, "LARGEST", 1000)):
        monkeypatch.setattr(place, name, number)
    with pytest.raises(ValueError, match="unpacks to"):
        load_recording(tmp_path / "small.npz")
    assert load_recording(one.save(tmp_path / "large.npz")).steps == 2
    assert (tmp_path / "large.npz").stat().st_size > 1.5 * small


# Read: policies and recordings


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    scaling = Normalisation(np.zeros(156), np.ones(156), 10.0)
    replace(stub_policy(), normalisation=scaling).save(folder / "policy file.npz")
    stub_recording().save(folder / "recording.npz")
    return folder


def check_wrong(kind, content, message, path, error=ValueError):
    """A file of these bytes or parts is refused with a message."""
    path.unlink(missing_ok=True)
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.savez(path, **content)
    with pytest.raises(error, match=message):
        replay(path) if kind == "recording" else load_policy(path, STUB)


@pytest.mark.parametrize("kind", ["policy file", "recording"])
def test_wrong_files(kind, good, tmp_path):
    """Missing, truncated, damaged and foreign files are refused."""
    data, path = (good / f"{kind}.npz").read_bytes(), tmp_path / "bad.npz"
    check_wrong(kind, None, f"there is no {kind}", path, FileNotFoundError)
    half = len(data) // 2
    for bad in (*(data[:size] for size in (0, 10, 1000, len(data) - 30)), b"hello" * 100,
                data[:half] + bytes([data[half] ^ 4]) + data[half + 1 :]):  # fmt: skip
        check_wrong(kind, bad, f"is not a {kind}, or is damaged or pickled", path)
    others = {"policy file": ("recording", "has format 1 and not 2 or 3"), "recording": ("policy file", "no recording")}
    check_wrong(kind, (good / f"{others[kind][0]}.npz").read_bytes(), others[kind][1], path)


@pytest.mark.parametrize(
    ("kind", "name", "change", "message"),
    [
        ("policy file", "weight0", lambda array: np.array([{}], dtype=object), "damaged or pickled"),
        ("policy file", "bias0", None, r"missing or extra parts \['bias0'\]"),
        ("policy file", "format", lambda array: 99, "format 99"),
        ("policy file", "format", lambda array: np.zeros(2), "format"),
        ("policy file", "format", lambda array: 1, "format 1 and not 2 or 3"),
        ("policy file", "layout", lambda array: 7,
         "version 7 of the observation layout; this package has version 1 .*: train the"),
        ("policy file", "weight0", lambda array: array[:, :-1], "does not fit the other"),
        ("policy file", "weight0", lambda array: array.astype(int), "floating of shape"),
        ("policy file", "bias0", lambda array: array * np.nan, "not finite"),
        ("policy file", "about", lambda array: json.dumps({"env_id": "FishEnv/Other-v0"}), "trained for FishEnv/Other"),
        ("policy file", "about", lambda array: "{}", "does not say which environment it is for"),
        ("policy file", "about", None, "about|Expecting"),
        ("policy file", "hidden", lambda array: "elu", "hidden is 'elu'; choose from tanh, relu"),
        ("policy file", "output", lambda array: 3, "output is '3'"),
        ("policy file", "mean", None, "missing or extra parts .*deviation"),
        ("policy file", "mean", lambda array: array[:-1], "does not fit the other"),
        ("policy file", "deviation", lambda array: 0.0 * array, "or deviations of zero or less"),
        ("policy file", "limit", lambda array: np.nan, "no limit above zero, or"),
        ("policy file", "limit", lambda array: 3, "no limit above zero, or"),
        ("recording", "reward", lambda array: np.array([{}], dtype=object), "damaged or pickled"),
        ("recording", "format", lambda array: 2, "has format 2; this package reads format 1: record the episode again"),
        ("recording", "format", lambda array: np.zeros(2), "has format"),
        ("recording", "velocity", None, r"missing or extra parts \['velocity'\]"),
        ("recording", "extra", lambda array: np.zeros(2), r"missing or extra parts \['extra'\]"),
        ("recording", "velocity", lambda array: array[:-1], "velocity has shape .* does not fit"),
        ("recording", "position", lambda array: array[:, :-1], "has shape .* does not fit"),
        ("recording", "terms", lambda array: array[:, :-1], "terms has shape .* does not fit"),
        ("recording", "reward", lambda array: array.astype(np.float32), "reward is .*float32; it should be float64"),
        ("recording", "position", lambda array: array * np.nan, "position holds numbers that are not finite"),
        ("recording", "failure", lambda array: array - 1, "failure holds numbers that name no failure"),
        ("recording", "failure", lambda array: array + 2**62, "failure holds numbers that name no failure"),
        ("recording", "about", lambda array: "{", "Expecting"),
        ("recording", "about", lambda array: "{}", "describes no episode"),
    ],
)  # fmt: skip
def test_wrong_parts(kind, name, change, message, good, tmp_path):
    """Parts that are pickled, of another format, missing, extra, ill-fitting or not finite: each says why."""
    parts = dict(np.load(good / f"{kind}.npz"))
    before = parts.pop(name, None)
    check_wrong(kind, parts | ({} if change is None else {name: change(before)}), message, tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        *((key, value, f"{key} is|does not fit") for key, value in (
            ("seed", -1), ("seed", True), ("env_id", 3), ("length", float("nan")), ("term_names", [3] * 4),
            ("control_interval", 0), ("options", []))),
        ("env_options", {"body": "whale"}, "whale.* cannot be made here"),
        ("options", {"depth": 1.0}, "unknown reset option 'depth'"),
    ],
)  # fmt: skip
def test_wrong_descriptions(key, value, message, good, tmp_path):
    """A recording of an episode that cannot be, or not here, is refused with the reason."""
    parts = dict(np.load(good / "recording.npz"))
    about = json.loads(str(parts["about"])) | {key: value}
    check_wrong("recording", parts | {"about": json.dumps(about)}, message, tmp_path / "bad.npz")


# Read: which environment


IDS = [f"{{}}:{STUB}", "FishEnv/{}:Swim-v0", "{}:", ":" + STUB, STUB + "\n", " " + STUB, "", "../{}", "a/b/c-v0",
       "x" * 1000, 3, None, ["{}"], {"id": "{}"}, "F\u0131shEnv/Stub-v0"]  # fmt: skip


def uses(policy, one, folder):
    """All that makes the environment of a policy or of a recording."""
    film = folder / "x.html"
    return [lambda: make_policy_env(policy, 1), lambda: play(policy, 0, 1, film), lambda: replay(one),
            lambda: write_film(one, film)]  # fmt: skip


@pytest.mark.parametrize("env_id", IDS, ids=repr)
def test_a_file_has_no_module_imported(env_id, good, tmp_path, capsys, monkeypatch):
    """Ids that are not plain are refused by all that reads policies and recordings; no module is imported."""
    (tmp_path / "planted.py").write_text("raise SystemExit('it was imported')")
    monkeypatch.syspath_prepend(tmp_path)
    wanted = env_id.format("planted") if isinstance(env_id, str) else env_id
    policy_file, recording_file = (shutil.copy(good / f"{kind}.npz", tmp_path) for kind in ("policy file", "recording"))
    for path in (policy_file, recording_file):
        parts = dict(np.load(path))
        np.savez(path, **parts | {"about": json.dumps(json.loads(str(parts["about"])) | {"env_id": wanted})})
    policy, one = stub_policy(env_id=wanted), stub_recording(env_id=wanted)
    for use in (lambda: load_policy(policy_file), lambda: load_recording(recording_file), *uses(policy, one, tmp_path)):
        with pytest.raises(ValueError, match="env_id is"):
            use()
    commands = (["evaluate", "--policy", policy_file], ["play", "--policy", policy_file], ["replay", recording_file])
    for command in commands:
        assert command_line.main([*map(str, command)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert "planted" not in sys.modules


@pytest.mark.parametrize(
    ("env_id", "message"),
    [
        *((env_id, "is not registered; import the package that registers it first") for env_id in (
            "Nobody/Fish-v7", "FishEnv/Stub", "FishEnv/Stub-v1", "stub")),
        *((env_id, "not an environment of fish") for env_id in ("CartPole-v1", "FrozenLake-v1", "Blackjack-v1")),
    ],
)  # fmt: skip
def test_environments_that_are_not_made(env_id, message, tmp_path, monkeypatch):
    """Files of environments that are not registered, or not of fish, can be read, for plots; nothing is made."""
    policy, one = stub_policy(env_id=env_id, env_options={"map_name": "x"}), stub_recording(env_id=env_id)
    policy.save(tmp_path / "policy.npz")
    assert load_policy(tmp_path / "policy.npz").about["env_id"] == env_id
    assert load_recording(one.save(tmp_path / "one.npz")).about["env_id"] == env_id
    for name in ("make", "make_vec"):
        monkeypatch.setattr(gym, name, lambda *a, **k: pytest.fail("it was made"))
    for use in uses(policy, one, tmp_path):
        with pytest.raises(ValueError, match=message):
            use()


def test_ids_that_a_user_types_may_name_modules(tmp_path):
    """They are Gymnasium's; a policy that is saved with one names the environment alone."""
    assert make_eval_env(f"fish_env:{STUB}", 1, {}).num_envs == 1
    stub_policy(env_id=f"fish_env:{STUB}").save(tmp_path / "policy.npz")
    policy = load_policy(tmp_path / "policy.npz", STUB)
    assert policy.about["env_id"] == STUB and make_policy_env(policy, 1).num_envs == 1


OPTIONS = [
    ({"num_envs": 10**9}, "env_options has 'num_envs'"), ({"autoreset_mode": "Disabled"}, "has 'autoreset_mode'"),
    ({"render_mode": "human"}, "has 'render_mode'"), ({"self": 1}, "has 'self'"), ({"id": STUB}, "has 'id'"),
    ({"wrappers": []}, "has 'wrappers'"), ({"vector_kwargs": {}}, "has 'vector_kwargs'"), ([], "env_options is"),
    (None, "env_options is"), ("body", "env_options is"), ({"a b": 1}, "env_options is"), ({"": 1}, "env_options is"),
    ({"control_interval": "1"}, "control_interval is '1'"), ({"control_interval": -0.02}, "control_interval is -0.02"),
    ({"control_interval": float("nan")}, "control_interval is nan"), ({"control_interval": [0.02]}, "_interval is"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), OPTIONS, ids=[str(one) for one, _ in OPTIONS])
def test_keywords_that_are_not_the_environments(options, message, tmp_path):
    """Keywords of those who make an environment, and what is no keyword, are refused when the file is read."""
    stub_policy(env_options=options).save(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match=rf"policy\.npz.*{message}"):
        load_policy(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match=rf"one\.npz cannot be used: .*{message}"):
        load_recording(stub_recording(env_options=options).save(tmp_path / "one.npz"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 1e-12}, r"an environment step has [\d,]+ steps of dt = 1e-12 s"), ({"dt": 1e-7}, "step has"),
        ({"threads": 0}, "threads is 0"), ({"body": "x" * 10**5}, "unknown body"), ({"lanes": 3.5}, "lanes"),
        ({"body": {"level": 10**9}}, "unknown body"), ({"fish": 1}, "unknown option"),
        ({"water": {"walls": []}}, "water is"), ({"variation": {"mass": [[2]]}}, "mass"),
    ],
)  # fmt: skip
def test_keywords_that_no_fish_has(options, message, tmp_path, capsys):
    """They are refused when the environment is made, in one line, before much is computed."""
    policy, one = stub_policy(env_options=options), stub_recording(env_options=options)
    policy.save(tmp_path / "policy.npz")
    for use in uses(policy, one, tmp_path):
        with pytest.raises(ValueError, match=message):
            use()
    assert command_line.main(["evaluate", "--policy", str(tmp_path / "policy.npz")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and len(said) < 3000
