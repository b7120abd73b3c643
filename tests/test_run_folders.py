"""Folders of runs that others have made: what is in them executes nothing, and changes nothing elsewhere.

A run that is shared is resumed, started from, reported and evaluated. Whatever its files hold, that works or is one of
the exceptions that are documented.
"""

import base64
import json
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from fuzzing import JSON, examples
from gymnasium.error import Error
from hypothesis import given
from hypothesis import strategies as st
from pages import ROOT

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from agents import report, run_measures, run_report, statistics, train_all
from agents import train as training
from agents.config import CONFIGS
from agents.saved_run import not_through_link, read_curve
from fish_env import __main__ as command_line

DOCUMENTED = (ValueError, FileNotFoundError, RuntimeError, Error)
COUNTED = ("num_timesteps", "_n_updates", "seed", "_current_progress_remaining")
SHORT = {"timesteps": 512, "num_envs": 8}
FILES = ("config.json", "curve.csv", "model.zip", "policy.npz")


def train(changes=SHORT, **options):
    """A run of Swim with these changed settings."""
    return training.train(training.Request("swim", changes=changes, pictures=False, **options))


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The folder of a short run that must not be changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "report", lambda *args: None)
        return train(folder=tmp_path_factory.mktemp("begun") / "run")


@pytest.fixture
def place(begun, tmp_path, monkeypatch):
    """A folder with a copy of the run in `run`, a file that is not its own, and a module that must not be imported."""
    prepare(begun, tmp_path, monkeypatch)
    return tmp_path


def prepare(begun, tmp_path, monkeypatch):
    """Fill the folder of a test, and make reports quick."""
    torch.set_num_threads(1)
    monkeypatch.setattr(training, "report", lambda *args: None)
    monkeypatch.setattr(statistics, "RESAMPLES", 5)
    monkeypatch.setattr(run_measures, "SHOWN", 1)
    (tmp_path / "outside.txt").write_text("not of the run\n")
    (tmp_path / "tripwire.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(report, "EPISODES", 1)
    shutil.copytree(begun, tmp_path / "run")


def contents(folder):
    """What lies in a folder, by path, its links as they are; locks are left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.name != "lock" and "__pycache__" not in path.parts:
            held = os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else path.is_dir()
            found[path] = held
    return found


class Payload:
    """What writes a file when it is read out of a pickle."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


class Large:
    """What takes 8 GB when it is read out of a pickle, by a function that torch allows."""

    def __reduce__(self):
        return bytearray, (2**33,)


def saved(value):
    """The bytes of what torch saves."""
    file = BytesIO()
    torch.save(value, file)
    return file.getvalue()


def parts_of(path):
    """The parts of a zip archive."""
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def packed(path, parts, kind=zipfile.ZIP_DEFLATED):
    """Write a zip archive of such parts."""
    with zipfile.ZipFile(path, "w", kind) as file:
        for name, data in parts.items():
            file.writestr(name, data)


NAMES = {"policy": "policy.pth", "optimizer": "policy.optimizer.pth", "variables": "pytorch_variables.pth"}


def with_parts(**changed):
    """A function that changes parts of model.zip; None takes one away."""

    def change(place):
        path = place / "run" / "model.zip"
        parts = parts_of(path) | {NAMES.get(name, name): part for name, part in changed.items()}
        kept = {name: part for name, part in parts.items() if part is not None}
        packed(path, {name: part(place) if callable(part) else part for name, part in kept.items()})

    return change


def counts(**changed):
    """A function of the place that gives the counts in model.zip, changed."""
    return lambda place: json.dumps(json.loads(parts_of(place / "run" / "model.zip")["data"]) | changed)


def tensors(name, change):
    """A function of the place that gives the tensors of a part of model.zip, changed."""

    def changed(place):
        held = torch.load(BytesIO(parts_of(place / "run" / "model.zip")[name]), weights_only=True)
        return saved(change(held) or held)

    return changed


def serialized(place):
    """Counts with a pickle that writes a file, as `PPO.save` stores what is no JSON."""
    text = base64.b64encode(pickle.dumps(Payload(place / "executed"))).decode()
    return counts(policy_class={":type:": "type", ":serialized:": text})(place)


def first(held):
    """The name of the first matrix of weights."""
    return next(name for name, value in held.items() if value.ndim == 2)


def policy(change):
    """A function that changes the tensors of the policy; what `change` returns is saved, if it is something."""
    return with_parts(policy=tensors("policy.pth", change))


def optimizer(change):
    """The same for what the optimizer keeps."""
    return with_parts(optimizer=tensors("policy.optimizer.pth", change))


def as_policy(make):
    """A function that puts other bytes in place of the policy; `make` is given the path of what a payload writes."""
    return with_parts(policy=lambda place: make(place / "executed"))


MODELS = {
    "no counts": with_parts(data=None),
    "counts of text": with_parts(data=counts(num_timesteps="512")),
    "counts below zero": with_parts(data=counts(num_timesteps=-1)),
    "counts without end": with_parts(data=counts(num_timesteps=10**400)),
    "counts that are true": with_parts(data=counts(_n_updates=True)),
    "no JSON": with_parts(data=b"\xff\xfe{"),
    "deep JSON": with_parts(data=b"[" * 100_000),
    "list": with_parts(data=b"[1]"),
    "no weights": with_parts(policy=None),
    "no optimizer": with_parts(optimizer=None),
    "swapped": with_parts(policy=tensors("policy.optimizer.pth", lambda held: held)),
    "reshaped": policy(lambda held: held | {first(held): held[first(held)].T.clone()}),
    "retyped": policy(lambda held: held | {"log_std": held["log_std"].long()}),
    "not finite": policy(lambda held: held | {"log_std": held["log_std"] * np.nan}),
    "expanded": policy(lambda held: held | {"log_std": torch.ones(1).expand(10**12)}),
    "other places": policy(lambda held: held | {"mlp_extractor.place": held["mlp_extractor.place"] + 10**9}),
    "other scales": policy(lambda held: held | {"features_extractor.scale": 2.0 * held["features_extractor.scale"]}),
    "one more": policy(lambda held: held | {"more": torch.ones(1)}),
    "renamed": policy(lambda held: held | {"other": held.pop("log_std")}),
    "numbers": policy(lambda held: dict.fromkeys(held, 1.0)),
    "a tensor": policy(lambda held: held["value_net.bias"] + 1.0),
    "optimizer reshaped": optimizer(lambda held: held["state"][0].update(exp_avg=torch.ones(3))),
    "optimizer of text": optimizer(lambda held: held | {"state": "x"}),
    "optimizer of one": optimizer(lambda held: held | {"state": {0: held["state"][0]}}),
    "optimizer without end": optimizer(lambda held: held["state"][0].update(step=torch.tensor(np.inf))),
    "payload in the optimizer": with_parts(optimizer=lambda place: saved({"state": Payload(place / "executed")})),
    "payload in the weights": as_policy(lambda path: saved({"log_std": Payload(path)})),
    "pickle for weights": as_policy(lambda path: pickle.dumps(Payload(path))),
    "old format of torch": as_policy(lambda path: pickle.dumps(0x1950A86A20F9469CFC6C) + pickle.dumps(Payload(path))),
    "large": as_policy(lambda path: saved({"log_std": Large()})),
    "compressed inside": with_parts(policy=lambda place: repacked(place)),
    "bzip2": lambda place: packed(place / "run/model.zip", parts_of(place / "run/model.zip"), zipfile.ZIP_BZIP2),
    "empty": lambda place: packed(place / "run/model.zip", {}),
}
"""Changes of model.zip with which it is refused."""

KEPT = {
    "as it is": lambda place: None,
    "payload beside the counts": with_parts(data=serialized),
    "payload in a part that is not read": with_parts(variables=lambda place: saved(Payload(place / "executed"))),
    "another part": with_parts(note=b"text"),
}
"""Changes of model.zip with which it is read all the same."""


def repacked(place):
    """The weights, compressed in their own archive, which torch does not do."""
    parts = parts_of(BytesIO(parts_of(place / "run/model.zip")["policy.pth"]))
    out = BytesIO()
    packed(out, parts)
    return out.getvalue()


def assert_refused(place, message="."):
    """The run is neither resumed nor started from; nothing has changed, been executed or imported."""
    before = contents(place)
    for request in ({"resume": place / "run"}, {"start": place / "run", "folder": place / "new"}):
        with pytest.raises(DOCUMENTED, match=message):
            train({"timesteps": 1024}, **request)
    assert contents(place) == before


@pytest.mark.parametrize("name", MODELS)
def test_a_model_that_cannot_be_used_is_refused(name, place):
    """Parts that are missing, of other shapes, types or sizes, or that would execute something."""
    MODELS[name](place)
    assert_refused(place, r"model\.zip cannot be read \(")


@pytest.mark.parametrize("name", KEPT)
def test_nothing_of_a_model_is_executed(name, place):
    """What else is in the file is not read: the run goes on as before."""
    KEPT[name](place)
    train({"timesteps": 1024}, resume=place / "run")
    train(SHORT, start=place / "run", folder=place / "new")
    assert not (place / "executed").exists()
    assert json.loads(parts_of(place / "run/model.zip")["data"])["num_timesteps"] == 1024


def test_the_payloads_would_be_executed(place):
    """Stable-Baselines3's own reading executes them: the tests above can fail."""
    KEPT["payload beside the counts"](place)
    with pytest.raises(Exception):  # noqa: B017 - whatever follows from it
        training.PPO.load(place / "run/model.zip", device="cpu")
    assert (place / "executed").exists()


def test_a_run_goes_on_as_with_stable_baselines(place, monkeypatch):
    """Bit for bit: parameters, optimizer, learning rate and counts are those of a learner that `PPO.load` gave."""
    before = shutil.copytree(place / "run", place / "before")
    train({"timesteps": 2048}, resume=place / "run")
    load = lambda config, env, *rest: training.PPO.load(before / "model.zip", env, device="cpu")  # noqa: E731
    monkeypatch.setattr(training, "make_model", load)
    monkeypatch.setattr(training, "restore", lambda model, path: model)
    train({"timesteps": 2048}, resume=before)
    one, other = (parts_of(folder / "model.zip") for folder in (place / "run", before))
    for name in ("policy.pth", "policy.optimizer.pth"):
        mine, theirs = (flat(torch.load(BytesIO(held[name]), weights_only=True)) for held in (one, other))
        assert mine.keys() == theirs.keys() and mine.get("param_groups.0.lr", 0.0) < 1e-3
        for key, value in mine.items():
            assert np.array_equal(value, theirs[key]), key
    counted, same = ([json.loads(held["data"])[name] for name in COUNTED] for held in (one, other))
    assert counted == same and counted[0] == 2048
    assert [path.name for path in (place / "run" / "tensorboard").iterdir()] == ["ppo_1"]


def flat(value, name=""):
    """The numbers in lists and dictionaries, by their paths."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    found = {f"{name}.{key}".strip("."): each for key, each in inner}
    return {n: v for key, each in found.items() for n, v in flat(each, key).items()} if inner != () else {name: value}


def taken(folder):
    """What is said of a run that is resumed, and how much memory that took beyond what the imports take, bytes."""
    code = """import resource, sys
from agents import train
def most(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
before = most()
try:
    train.train(train.Request("swim", resume=sys.argv[1], changes={"timesteps": 1024}, pictures=False))
except ValueError as error:
    print(str(error).splitlines()[0])
print(most() - before)"""
    command = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    *_, said, number = done.stdout.splitlines()
    return said, int(number)


@pytest.mark.parametrize(("name", "lying"), [("data", False), ("policy.pth", False), ("policy.pth", True)])
def test_a_bomb_is_not_unpacked(name, lying, place):
    """An archive that unpacks to a quarter of a gigabyte is refused before it has, also if its head lies."""
    pytest.importorskip("resource")
    path, size = place / "run" / "model.zip", 2**28 + 1_234_567
    parts = parts_of(path)
    packed(path, {other: part for other, part in parts.items() if other != name})
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as file, file.open(name, "w") as part:
        for _ in range(-(-size // 2**24)):
            part.write(bytes(2**24))
        size = part._file_size
    if lying:
        path.write_bytes(path.read_bytes().replace(size.to_bytes(4, "little"), (1000).to_bytes(4, "little")))
    assert path.stat().st_size < 4 * 2**20
    said, number = taken(place / "run")
    assert "model.zip cannot be read" in said and number < 200 * 2**20


HUGE = {
    "fish": {"num_envs": 10**9},
    "steps of a rollout": {"rollout": 10**12},
    "a layer": {"hidden": [10**9]},
    "two layers": {"hidden": [10**6, 10**6]},
    "many layers": {"hidden": [1] * 10**5},
    "timesteps": {"timesteps": 10**30},
    "digits": {"timesteps": 10**4000},
    "steps of an episode": {"env_options": {"max_episode_steps": 10**400}},
    "obstacles": {"env_options": {"reversals": 10**9}},
}


@pytest.mark.parametrize("name", HUGE)
def test_huge_settings_are_refused(name, place):
    """Sizes that no machine has are refused before anything is made of them."""
    pytest.importorskip("resource")
    change_record(place / "run", **HUGE[name])
    if name in ("fish", "a layer"):
        said, number = taken(place / "run")
        assert said and number < 200 * 2**20
    assert_refused(place)


def change_record(folder, task="swim", **config):
    """Change settings in config.json."""
    record = json.loads((folder / "config.json").read_text())
    record["config"] |= config
    (folder / "config.json").write_text(json.dumps(record | {"task": task}))


@pytest.mark.parametrize("env_id", ["tripwire:Swim-v0", "tripwire:FishEnv/Swim-v0", "CartPole-v1", "", ":"])
def test_no_module_is_imported_for_a_run(env_id, place):
    """The environment of a run is that of its task: another name imports nothing, in whichever file it stands."""
    change_record(place / "run", env_id=env_id)
    assert_refused(place, r"config\.json cannot be used")
    with pytest.raises(ValueError, match=r"config\.json cannot be used"):
        run_report.write_report([place / "run"], episodes=1)
    about = {"env_id": env_id, "task": "swim", "env_options": {}}
    policy = place / "run" / "policy.npz"
    with np.load(policy) as file:
        np.savez(policy, **(dict(file) | {"about": json.dumps(about)}))
    assert command_line.main(["evaluate", str(policy), "--episodes", "1"]) == 2
    assert not (place / "imported").exists() and "tripwire" not in sys.modules


@pytest.mark.parametrize("name", ["lock", "tensorboard", "tensorboard/ppo_1", "config.json", "curve.csv", "model.zip"])
@pytest.mark.parametrize("kind", ["link", "folder", "pipe", "dangling link"])
def test_no_other_file_is_written_through_a_run(kind, name, place, begun):
    """Links, folders and pipes in place of files: what lies elsewhere stays, and nothing waits for them."""
    if kind == "pipe" and not hasattr(os, "mkfifo"):
        pytest.skip("this system has no named pipes")
    path = place / "run" / name
    if path.is_dir():
        shutil.rmtree(path)
    elif path.exists():
        path.unlink()
    if kind == "link":
        path.symlink_to(begun / name if name != "lock" else place / "outside.txt")
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(place / "nothing")
    outside = contents(begun), (place / "outside.txt").read_text()
    with suppress(*DOCUMENTED):
        train({"timesteps": 1024}, resume=place / "run")
    assert (contents(begun), (place / "outside.txt").read_text()) == outside and not (place / "nothing").exists()
    assert not path.is_symlink() or path.name in ("lock", "ppo_1", "tensorboard") or kind == "dangling link"


@pytest.mark.parametrize("name", ["policy.npz", "results.json", "report.html"])
def test_what_would_stand_in_the_way_at_the_end_is_refused_at_the_beginning(name, place):
    """A folder in place of a file that is written when the training is over."""
    (place / "run" / name).unlink(missing_ok=True)
    (place / "run" / name).mkdir()
    with pytest.raises(ValueError, match=f"{name} is not a file"):
        train({"timesteps": 1024}, resume=place / "run")


def test_a_lock_is_not_truncated(place):
    """A file of another name for the same bytes is not emptied, and the log of `train.py all` follows no link."""
    (place / "run" / "lock").unlink()
    os.link(place / "outside.txt", place / "run" / "lock")
    train({"timesteps": 1024}, resume=place / "run")
    (place / "run" / "log.txt").symlink_to(place / "outside.txt")
    with pytest.raises(OSError):
        train_all.Job("swim", 0, place / "run", CONFIGS["swim"]).start(None)
    with pytest.raises(OSError):
        open(place / "run" / "log.txt", "w", opener=not_through_link).close()
    assert (place / "outside.txt").read_text() == "not of the run\n"


HEAD = b"timesteps,seconds,episodes,score,return\n"
CURVES = [b"\xff\xfe", *(HEAD + row for row in (b"1,2,3,4", b"-1,2,3,4,5", b"9" * 5000 + b",2,3,4,5", b"1,2,3,4,x"))]


@pytest.mark.parametrize("held", CURVES)
def test_a_curve_that_cannot_be_read(held, place):
    """Bytes that are no text and rows that are no numbers are refused by the file's name, everywhere it is read."""
    (place / "run" / "curve.csv").write_bytes(held)
    with pytest.raises(ValueError, match=r"curve\.csv"):
        read_curve(place / "run" / "curve.csv")
    with pytest.raises(ValueError, match=r"curve\.csv"):
        run_report.write_report([place / "run"], episodes=1)
    with pytest.raises(ValueError, match=r"curve\.csv"):
        train({"timesteps": 1024}, resume=place / "run")
    assert train_all.Job("swim", 0, place / "run", CONFIGS["swim"]).steps == 0


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are any bytes on Linux only")
def test_a_name_that_is_not_utf_8(place, begun):
    """A folder whose name cannot be printed is refused before anything is measured or trained."""
    folder = Path(os.fsdecode(os.fsencode(place) + b"/\xff"))
    shutil.copytree(begun, folder)
    for call in (
        lambda: run_report.write_report([folder]),
        lambda: run_report.write_report([place / "run"], folder / "page.html"),
        lambda: train({"timesteps": 1024}, resume=folder),
        lambda: train(folder=folder / "new"),
        lambda: train(root=folder / "runs"),
    ):
        with pytest.raises(ValueError, match="is not UTF-8"):
            call()
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in begun.iterdir())


# Anything

ODD = [10**400, -1, 0, 1e308, -1e308, "1", "tripwire:Swim-v0", "mass_spring", {"a": {"b": {}}}, ["x"] * 300,
       [[[[[[[[[[[[]]]]]]]]]]]], "\udcff", float("nan"), float("inf")]  # fmt: skip
VALUES = st.one_of(JSON, st.sampled_from(ODD))
OPTIONS = [
    "body",
    "integrator",
    "control_interval",
    "water",
    "variation",
    "muscle_groups",
    "threads",
    "lanes",
    "x",
    "refine",
    "max_episode_steps",
    "task",
    "num_envs",
    "autoreset_mode",
    "render_mode",
    "id",
    "self",
    "dtype",
]
LINKS = ["link", "dangling", "folder", "pipe", "device"]
WHOLE = [b"", b"{}", b"[]", b"null", b"NaN", b"[" * 100_000, b"\xff\xfe\0", b'{"a":' * 5000]
BYTES = st.one_of(st.binary(max_size=50), st.sampled_from(WHOLE))


@st.composite
def changed_folder(draw):
    """A function that changes a folder of a run in one or two ways."""
    changes = draw(st.lists(st.one_of(settings_changed(), files_replaced(), parts_changed()), min_size=1, max_size=2))

    def change(place):
        for each in changes:
            with suppress(Exception):  # what it changes may have been changed already
                each(place)

    return change


@st.composite
def settings_changed(draw):
    """A value anywhere in config.json is another one."""
    at, value = draw(st.integers(0, 99)), draw(VALUES)
    option = draw(st.sampled_from(OPTIONS))

    def change(place):
        path = place / "run" / "config.json"
        record = json.loads(path.read_text()) if path.is_file() and not path.is_symlink() else {}
        if not isinstance(record, dict) or not isinstance(record.get("config"), dict):
            return
        config = record["config"]
        places = [(record, n) for n in (*record, "start")] + 2 * [(config, n) for n in (*config, "more")]
        options = config.get("env_options")
        places += [(options, option)] * 30 if isinstance(options, dict) else []
        inner, name = places[at % len(places)]
        inner[name] = value
        path.write_text(json.dumps(record))

    return change


@st.composite
def files_replaced(draw):
    """A file is other bytes, or something else."""
    name, kind = draw(st.sampled_from([*FILES, "lock", "tensorboard"])), draw(st.sampled_from(["bytes", *LINKS]))
    held = draw(BYTES)

    def change(place):
        path = place / "run" / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        if kind == "bytes":
            path.write_bytes(held)
        elif kind == "folder":
            path.mkdir()
        elif kind == "pipe" and hasattr(os, "mkfifo"):
            os.mkfifo(path)
        else:
            path.symlink_to({"link": place / "outside.txt", "device": Path("/dev/zero")}.get(kind, place / "nothing"))

    return change


@st.composite
def parts_changed(draw):
    """A part of model.zip is changed in one of the ways above, is other bytes, or a pickle."""
    known = draw(st.sampled_from([*MODELS.values(), *KEPT.values(), None, None]))
    at, held, pickled = draw(st.integers(0, 20)), draw(BYTES), draw(st.booleans())

    def change(place):
        path = place / "run" / "model.zip"
        if not path.is_file() or not zipfile.is_zipfile(path):
            return
        if known is not None:
            known(place)
        else:
            parts = parts_of(path)
            which = [*parts, "more.pth"][at % (len(parts) + 1)]
            packed(path, parts | {which: pickle.dumps(Payload(place / "executed")) if pickled else held})

    return change


CALLS = {
    "resume": lambda place: train({"timesteps": 1024}, resume=place / "run"),
    "resume as it says": lambda place: train({}, resume=place / "run"),
    "start": lambda place: train(SHORT, start=place / "run", folder=place / "new"),
    "report": lambda place: run_report.write_report([place / "run"], place / "page.html", episodes=1),
    "evaluate": lambda place: command_line.main(["evaluate", str(place / "run" / "policy.npz"), "--episodes", "1"]),
}


@examples(120)
@given(change=changed_folder(), name=st.sampled_from(list(CALLS)))
def test_changed_folders(begun, tmp_path_factory, change, name):
    """Any change of a run: what is documented comes of it, and nothing is executed, imported or written elsewhere."""
    place = tmp_path_factory.mktemp("any")
    with pytest.MonkeyPatch.context() as patch:
        prepare(begun, place, patch)
        change(place)
        before = {path: held for path, held in contents(place).items() if place / "run" not in path.parents}
        modules = set(sys.modules)
        try:
            CALLS[name](place)
        except DOCUMENTED as error:
            assert str(error)
        after = contents(place)
        own = (place / "run", place / "new", place / "page.html")
        assert before.items() <= after.items()
        assert all(path in before or any(each in (path, *path.parents) for each in own) for path in after)
        assert not {module for module in set(sys.modules) - modules if module.startswith(("tripwire", "gone"))}
    shutil.rmtree(place)
