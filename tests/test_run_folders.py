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
from trainings import SHORT, torch, train_short, training

from agents import train_all
from fish_env import __main__ as command_line
from fish_env.control import statistics
from fish_env.training import run_measures, run_report
from fish_env.training.config import CONFIGS
from fish_env.training.saved_run import not_through_link, read_curve

DOCUMENTED = (ValueError, FileNotFoundError, RuntimeError, Error)
COUNTED = ("num_timesteps", "_n_updates", "seed", "_current_progress_remaining")
LONGER = {"timesteps": 2048}
FILES = ("config.json", "curve.csv", "model.zip", "policy.npz")


@pytest.fixture
def place(trained, tmp_path, monkeypatch):
    """A folder with a copy of the run in `run`, a file that is not its own, and a module that must not be imported."""
    prepare(trained, tmp_path, monkeypatch)
    return tmp_path


def prepare(trained, tmp_path, monkeypatch):
    """Fill the folder of a test, and make reports quick."""
    monkeypatch.setattr(statistics, "RESAMPLES", 5)
    monkeypatch.setattr(run_measures, "SHOWN", 1)
    (tmp_path / "outside.txt").write_text("not of the run\n")
    (tmp_path / "tripwire.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\n")
    monkeypatch.syspath_prepend(tmp_path)
    shutil.copytree(trained, tmp_path / "run")


def contents(folder):
    """What lies in a folder, by path, its links as they are; locks are left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.name != "lock" and "__pycache__" not in path.parts:
            held = os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else path.is_dir()
            found[path] = held
    return found


def evaluate(place):
    """The exit status of the command that evaluates the policy of the run."""
    return command_line.main(["evaluate", str(place / "run/policy.npz"), "--episodes", "1"])


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


def pack(path, parts, kind=zipfile.ZIP_DEFLATED):
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
        pack(path, {name: part(place) if callable(part) else part for name, part in kept.items()})

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


def policy(change):
    """A function that changes the tensors of the policy; what `change` returns is saved, if it is something."""
    return with_parts(policy=tensors("policy.pth", change))


def optimizer(change):
    """The same for what the optimizer keeps."""
    return with_parts(optimizer=tensors("policy.optimizer.pth", change))


def as_policy(make):
    """A function that puts other bytes in place of the policy; `make` is given the path of what a payload writes."""
    return with_parts(policy=lambda place: make(place / "executed"))


def serialize(place):
    """Counts with a pickle that writes a file, as `PPO.save` stores what is no JSON."""
    text = base64.b64encode(pickle.dumps(Payload(place / "executed"))).decode()
    return counts(policy_class={":type:": "type", ":serialized:": text})(place)


def repack(place):
    """The weights, compressed in their own archive, which torch does not do."""
    out = BytesIO()
    pack(out, parts_of(BytesIO(parts_of(place / "run/model.zip")["policy.pth"])))
    return out.getvalue()


def first(held):
    """The name of the first matrix of weights."""
    return next(name for name, value in held.items() if value.ndim == 2)


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
    "compressed inside": with_parts(policy=repack),
    "bzip2": lambda place: pack(place / "run/model.zip", parts_of(place / "run/model.zip"), zipfile.ZIP_BZIP2),
    "empty": lambda place: pack(place / "run/model.zip", {}),
}
"""Changes of model.zip with which it is refused."""
KEPT = {
    "payload beside the counts": with_parts(data=serialize),
    "payload in a part that is not read": with_parts(variables=lambda place: saved(Payload(place / "executed"))),
}
"""Changes of model.zip with which it is read all the same."""


def assert_refused(place, message="."):
    """The run is neither resumed nor started from; nothing has changed, been executed or imported."""
    before = contents(place)
    for request in ({"resume": place / "run"}, {"start": place / "run", "folder": place / "new"}):
        with pytest.raises(DOCUMENTED, match=message):
            train_short(changes=LONGER, **request)
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
    train_short(changes=LONGER, resume=place / "run")
    train_short(start=place / "run", folder=place / "new")
    assert not (place / "executed").exists()
    assert json.loads(parts_of(place / "run/model.zip")["data"])["num_timesteps"] == 2048


def test_the_payloads_would_be_executed(place):
    """Stable-Baselines3's own reading executes them: the tests above can fail."""
    KEPT["payload beside the counts"](place)
    with pytest.raises(Exception):  # noqa: B017 - whatever follows from it
        training.PPO.load(place / "run/model.zip", device="cpu")
    assert (place / "executed").exists()


def test_a_run_goes_on_as_with_stable_baselines(place, monkeypatch):
    """Bit for bit: parameters, optimizer, learning rate and counts are those of a learner that `PPO.load` gave."""
    before = shutil.copytree(place / "run", place / "before")
    train_short(changes=LONGER, resume=place / "run")
    load = lambda config, env, *rest: training.PPO.load(before / "model.zip", env, device="cpu")  # noqa: E731
    monkeypatch.setattr(training, "make_model", load)
    monkeypatch.setattr(training, "restore", lambda model, path: model)
    train_short(changes=LONGER, resume=before)
    one, other = (parts_of(folder / "model.zip") for folder in (place / "run", before))
    for name in ("policy.pth", "policy.optimizer.pth"):
        mine, theirs = (flatten(torch.load(BytesIO(held[name]), weights_only=True)) for held in (one, other))
        assert mine.keys() == theirs.keys() and mine.get("param_groups.0.lr", 0.0) < 1e-3
        for key, value in mine.items():
            assert np.array_equal(value, theirs[key]), key
    counted, same = ([json.loads(held["data"])[name] for name in COUNTED] for held in (one, other))
    assert counted == same and counted[0] == 2048
    assert [path.name for path in (place / "run" / "tensorboard").iterdir()] == ["ppo_1"]


def flatten(value, name=""):
    """The numbers in lists and dictionaries, by their paths."""
    if not isinstance(value, dict | list | tuple):
        return {name: value}
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    return {key: each for part, held in inner for key, each in flatten(held, f"{name}.{part}".strip(".")).items()}


MEMORY = """import resource, sys
from fish_env.training import train
def most(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
for folder in sys.argv[1:]:
    before = most()
    try:
        train.train(train.Request("swim", resume=folder, changes={"timesteps": 2048}, pictures=False))
    except ValueError as error:
        print(most() - before, str(error).splitlines()[0])"""


def test_a_bomb_is_not_unpacked(trained, tmp_path):
    """Archives that unpack to a quarter of a gigabyte, and settings of that size, are refused without their memory."""
    pytest.importorskip("resource")
    folders = [tmp_path / name for name in ("data", "policy.pth", "lying policy.pth", "fish", "layer")]
    for folder in folders:
        shutil.copytree(trained, folder)
    for folder in folders[:3]:
        path, size, name = folder / "model.zip", 2**28 + 1_234_567, folder.name.split()[-1]
        pack(path, {other: part for other, part in parts_of(path).items() if other != name})
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as file, file.open(name, "w") as part:
            for _ in range(-(-size // 2**24)):
                part.write(bytes(2**24))
            size = part._file_size
        if "lying" in folder.name:
            path.write_bytes(path.read_bytes().replace(size.to_bytes(4, "little"), (1000).to_bytes(4, "little")))
        assert path.stat().st_size < 4 * 2**20
    change_record(folders[3], num_envs=10**9)
    change_record(folders[4], hidden=[10**9])
    command = [sys.executable, "-c", MEMORY, *map(str, folders)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    said = done.stdout.splitlines()
    assert len(said) == len(folders) and all("model.zip cannot be read" in line for line in said[:3])
    assert max(int(line.split()[0]) for line in said) < 200 * 2**20


HUGE = {
    "fish": {"num_envs": 10**9},
    "steps of a rollout": {"rollout": 10**12},
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
    change_record(place / "run", **HUGE[name])
    assert_refused(place)


def change_record(folder, task="swim", **config):
    """Change settings in config.json."""
    record = json.loads((folder / "config.json").read_text())
    record["config"] |= config
    (folder / "config.json").write_text(json.dumps(record | {"task": task}))


@pytest.mark.parametrize("env_id", ["tripwire:Swim-v0", "tripwire:FishEnv/Swim-v0", "CartPole-v1", ""])
def test_no_module_is_imported_for_a_run(env_id, place):
    """The environment of a run is that of its task: another name imports nothing, in whichever file it stands."""
    change_record(place / "run", env_id=env_id)
    assert_refused(place, r"config\.json cannot be used")
    with pytest.raises(ValueError, match=r"config\.json cannot be used"):
        run_report.write_report([place / "run"], episodes=1)
    about, file = {"env_id": env_id, "task": "swim", "env_options": {}}, place / "run" / "policy.npz"
    np.savez(file, **(dict(np.load(file)) | {"about": json.dumps(about)}))
    assert evaluate(place) == 2
    assert not (place / "imported").exists() and "tripwire" not in sys.modules


def put(kind, path, place, target, held=b""):
    """Put a link, a folder, a pipe or other bytes in place of a file."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    if kind == "bytes":
        path.write_bytes(held)
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("this system has no named pipes")
        os.mkfifo(path)
    else:
        path.symlink_to(target if kind == "link" else Path("/dev/zero") if kind == "device" else place / "nothing")


@pytest.mark.parametrize("name", ["lock", "tensorboard", "tensorboard/ppo_1", "config.json", "curve.csv", "model.zip"])
@pytest.mark.parametrize("kind", ["link", "folder", "pipe", "dangling link"])
def test_no_other_file_is_written_through_a_run(kind, name, place, trained):
    """Links, folders and pipes in place of files: what lies elsewhere stays, and nothing waits for them."""
    path = place / "run" / name
    put(kind, path, place, trained / name if name != "lock" else place / "outside.txt")
    outside = contents(trained), (place / "outside.txt").read_text()
    with suppress(*DOCUMENTED):
        train_short(changes=LONGER, resume=place / "run")
    assert (contents(trained), (place / "outside.txt").read_text()) == outside and not (place / "nothing").exists()
    assert not path.is_symlink() or path.name in ("lock", "ppo_1", "tensorboard") or kind == "dangling link"


@pytest.mark.parametrize("name", ["policy.npz", "results.json", "report.html"])
def test_what_would_stand_in_the_way_at_the_end_is_refused_at_the_beginning(name, place):
    """A folder in place of a file that is written when the training is over."""
    put("folder", place / "run" / name, place, None)
    with pytest.raises(ValueError, match=f"{name} is not a file"):
        train_short(changes=LONGER, resume=place / "run")


def test_a_lock_is_not_truncated(place):
    """A file of another name for the same bytes is not emptied, and the log of `train.py all` follows no link."""
    (place / "run" / "lock").unlink()
    os.link(place / "outside.txt", place / "run" / "lock")
    train_short(changes=LONGER, resume=place / "run")
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
    for use in (lambda: read_curve(place / "run" / "curve.csv"), lambda: run_report.write_report([place / "run"]),
                lambda: train_short(changes=LONGER, resume=place / "run")):  # fmt: skip
        with pytest.raises(ValueError, match=r"curve\.csv"):
            use()
    assert train_all.Job("swim", 0, place / "run", CONFIGS["swim"]).steps == 0


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are any bytes on Linux only")
def test_a_name_that_is_not_utf_8(place, trained):
    """A folder whose name cannot be printed is refused before anything is measured or trained."""
    folder = Path(os.fsdecode(os.fsencode(place) + b"/\xff"))
    shutil.copytree(trained, folder)
    for call in (
        lambda: run_report.write_report([folder]),
        lambda: run_report.write_report([place / "run"], folder / "page.html"),
        lambda: train_short(changes=LONGER, resume=folder),
        lambda: train_short(folder=folder / "new"),
        lambda: train_short(root=folder / "runs"),
    ):
        with pytest.raises(ValueError, match="is not UTF-8"):
            call()
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in trained.iterdir())


# Anything

ODD = [10**400, -1, 0, 1e308, -1e308, "1", "tripwire:Swim-v0", "mass_spring", {"a": {"b": {}}}, ["x"] * 300,
       [[[[[[[[[[[[]]]]]]]]]]]], "\udcff", float("nan"), float("inf")]  # fmt: skip
VALUES = st.one_of(JSON, st.sampled_from(ODD))
OPTIONS = ["body", "integrator", "control_interval", "water", "variation", "muscle_groups", "threads", "lanes", "x",
           "refine", "max_episode_steps", "task", "num_envs", "autoreset_mode", "render_mode", "id", "self",
           "dtype"]  # fmt: skip
WHOLE = [b"", b"{}", b"[]", b"null", b"NaN", b"[" * 100_000, b"\xff\xfe\0", b'{"a":' * 5000]
BYTES = st.one_of(st.binary(max_size=50), st.sampled_from(WHOLE))


def change_setting(place, at, option, value):
    """Put another value anywhere in config.json."""
    path = place / "run" / "config.json"
    record = json.loads(path.read_text() if path.is_file() else "{}")
    config = record["config"]
    places = [(record, name) for name in (*record, "start")] + 2 * [(config, name) for name in (*config, "more")]
    places += [(config["env_options"], option)] * 30
    inner, name = places[at % len(places)]
    inner[name] = value
    path.write_text(json.dumps(record))


def change_part(place, at, known, held):
    """Change a part of model.zip in one of the ways above, or put other bytes or a pickle in its place."""
    path = place / "run" / "model.zip"
    if path.is_file() and known is not None:
        known(place)
    elif path.is_file():
        parts = parts_of(path)
        which = [*parts, "more.pth"][at % (len(parts) + 1)]
        pack(path, parts | {which: pickle.dumps(Payload(place / "executed")) if held is None else held})


@st.composite
def changes(draw):
    """A function that changes a folder of a run."""
    at, kind = draw(st.integers(0, 99)), draw(st.sampled_from(["setting", "file", "part"]))
    if kind == "setting":
        option, value = draw(st.sampled_from(OPTIONS)), draw(VALUES)
        return lambda place: change_setting(place, at, option, value)
    if kind == "part":
        known = draw(st.sampled_from([*MODELS.values(), *KEPT.values(), None, None]))
        held = draw(st.one_of(BYTES, st.none()))
        return lambda place: change_part(place, at, known, held)
    name, other = draw(st.sampled_from([*FILES, "lock", "tensorboard"])), draw(BYTES)
    put_kind = draw(st.sampled_from(["bytes", "link", "dangling", "folder", "pipe", "device"]))
    return lambda place: put(put_kind, place / "run" / name, place, place / "outside.txt", other)


CALLS = {
    "resume": lambda place: train_short(changes=LONGER, resume=place / "run"),
    "resume as it says": lambda place: train_short(changes={}, resume=place / "run"),
    "start": lambda place: train_short(changes=SHORT, start=place / "run", folder=place / "new"),
    "report": lambda place: run_report.write_report([place / "run"], place / "page.html", episodes=1),
    "evaluate": evaluate,
}


@examples(100)
@given(changed=st.lists(changes(), min_size=1, max_size=2), name=st.sampled_from(list(CALLS)))
def test_changed_folders(trained, tmp_path_factory, changed, name):
    """Any change of a run: what is documented comes of it, and nothing is executed, imported or written elsewhere."""
    place = tmp_path_factory.mktemp("any")
    with pytest.MonkeyPatch.context() as patch:
        prepare(trained, place, patch)
        for change in changed:
            with suppress(Exception):  # what it changes may have been changed already
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
