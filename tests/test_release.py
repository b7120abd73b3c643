"""A release: one placeholder, which the check refuses; pinned actions; model cards; and a film from the core alone."""

import importlib.util
import re
import shutil
import subprocess
import sys

import pytest
from pages import ROOT

from fish_env.control import play

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FILES = ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "fish_env/__init__.py")


def load(path):
    """A program of the checkout as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


check = load(ROOT / ".ci" / "release_check.py")


def replace(path, before, after):
    """Replace what stands once in a file."""
    text = path.read_text()
    assert text.count(before) == 1, before
    path.write_text(text.replace(before, after))


@pytest.fixture
def ready(tmp_path):
    """The files that the check reads, ready for the release of 0.1.0."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    pyproject = tmp_path / "pyproject.toml"
    pyproject.write_text(pyproject.read_text().replace(f"/{check.PLACEHOLDER}/", "/someone/"))
    day = re.search("^date-released: (.*)$", (tmp_path / "CITATION.cff").read_text(), re.MULTILINE)[1]
    head, _ = check.section(tmp_path)
    replace(tmp_path / "CHANGELOG.md", f"## {head}\n", f"## 0.1.0, {day}\n")
    return tmp_path


def test_placeholder_stands_once():
    """The account that does not exist yet stands in pyproject.toml, once; no page, notebook or program repeats it."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this is no clone")
    found = {}
    for name in filter(None, listed.stdout.split("\0")):
        text = (ROOT / name).read_bytes() if (ROOT / name).is_file() else b""
        if count := text.count(check.PLACEHOLDER.encode()):
            found[name] = count
    assert set(found) <= {"pyproject.toml"} and found.get("pyproject.toml", 0) <= 1


@pytest.mark.parametrize(
    ("name", "before", "after", "said"),
    [
        ("pyproject.toml", "/someone/", f"/{check.PLACEHOLDER}/", "put the account there"),
        ("pyproject.toml", 'version = "0.1.0"', 'version = "0.2.0"', "tag v0.2.0"),
        ("fish_env/__init__.py", '__version__ = "0.1.0"', '__version__ = "0.2.0"', "__init__.py is 0.2.0"),
        ("CITATION.cff", "\nversion: 0.1.0", "\nversion: 0.2.0", "CITATION.cff is 0.2.0"),
        ("CITATION.cff", "date-released: 20", "date-released: 21", "CHANGELOG.md is '0.1.0, 20"),
        ("pyproject.toml", "\nrepository = ", "\nhome = ", "missing in pyproject.toml is no address"),
        ("pyproject.toml", "\nversion = ", "\nnumber = ", "the version in pyproject.toml missing"),
        ("CITATION.cff", "\nversion: ", "\nnumber: ", "CITATION.cff is missing"),
        ("CITATION.cff", "\ndate-released: ", "\nday: ", "would be '0.1.0, missing'"),
        ("CHANGELOG.md", "\n## 0.1.0", "\n# 0.1.0", "CHANGELOG.md is 'missing'"),
    ],
)
def test_check_refuses(ready, capsys, name, before, after, said):
    """One mistake in one file is named, and no notes are written; without it they are those of this version."""
    notes = ready / "notes.md"
    assert check.main(["v0.1.0", "--notes", str(notes)], ready) == 0
    assert notes.read_text().startswith("### ") and "\n## " not in notes.read_text()
    notes.unlink()
    replace(ready / name, before, after)
    capsys.readouterr()
    assert check.main(["v0.1.0", "--notes", str(notes)], ready) == 1
    assert said in capsys.readouterr().out and not notes.exists()


def test_workflows():
    """Actions are pinned by whole digests with a version; one digest each; jobs end, and have no permission unsaid."""
    yaml = pytest.importorskip("yaml")
    digests = {}
    for path in WORKFLOWS:
        text = path.read_text()
        used = re.findall(r"uses: *(.*)$", text, re.MULTILINE)
        for line in used:
            name, digest = re.fullmatch(r"([\w./-]+)@([0-9a-f]{40}) # v\d+\.\d+\.\d+", line).groups()
            assert digests.setdefault(name, digest) == digest
        read = yaml.safe_load(text)
        assert read["permissions"] == {} and "concurrency" in read
        for job in read["jobs"].values():
            assert job["timeout-minutes"] <= 240 and "permissions" in job
            for step in job["steps"]:
                if step.get("uses", "").startswith("actions/checkout@"):
                    assert step["with"]["persist-credentials"] is False
    assert len(digests) == 6


def test_lowest_versions():
    """The constraints of the job with the lowest versions are those of pyproject.toml."""
    done = subprocess.run([sys.executable, ROOT / ".ci/lowest"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["numpy==2.0.*", "scipy==1.13.*", "gymnasium==1.2.*", "numba==0.60.*"]


@pytest.mark.parametrize("task", ["swim", "target_3d"])
def test_model_card(task):
    """A card begins with YAML that the hub reads; its scores are numbers, and the page has its command and limits."""
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("matplotlib")
    from benchmarks.learning.cards import card

    _, head, text = card(task).split("---\n", 2)
    read = yaml.safe_load(head)
    (result,) = read["model-index"][0]["results"]
    assert read["library_name"] == "stable-baselines3" and result["dataset"]["name"] in read["tags"]
    assert result["metrics"][0]["type"] == "mean_reward" and len(result["metrics"]) > 3
    assert all(isinstance(metric["value"], int | float) for metric in result["metrics"])
    assert f"fish_env train {task} " in text and "## Intended use and limits" in text and "the same" not in text


def test_film_needs_no_extra(tmp_path, monkeypatch):
    """The 3-D film of a shipped policy is written where pygame is not installed."""
    for name in ("pygame", "fish_env.render"):
        monkeypatch.setitem(sys.modules, name, None)
    play("swim", episodes=1, video=tmp_path / "film.html")
    assert (tmp_path / "film.html").stat().st_size > 100_000
