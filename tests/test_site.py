"""README.md, CITATION.cff and the hooks of the documentation site."""

import importlib.util
import logging
import re
from pathlib import Path

import pytest

import fish_env

ROOT = Path(__file__).parent.parent


def hook(name):
    """A hook of the site as a module, as MkDocs loads it."""
    pytest.importorskip("mkdocs", reason="the extra [docs] is not installed")
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "site" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_readme_is_short_and_begins_with_a_moving_picture():
    """README has at most 80 lines; its first picture moves and is quick to load."""
    from PIL import Image

    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 80
    path = ROOT / re.search(r"!\[[^\]]+\]\(([^)]+)\)", text)[1]
    assert path.stat().st_size < 700_000
    with Image.open(path) as picture:
        assert picture.n_frames > 20


def test_readme_has_the_two_commands():
    """The command that trains and the one that tests stand on a line each."""
    lines = (ROOT / "README.md").read_text().splitlines()
    assert 'pip install -c constraints.txt -e ".[train]" && python train.py swim' in lines
    assert 'pip install -c constraints.txt -e ".[dev]" && pytest' in lines


def test_citation_names_this_version():
    """The version in CITATION.cff is that of the package."""
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M)[1] == fish_env.__version__


def test_links_out_of_docs_lead_to_copies():
    """A source file becomes a page, data stay as they are, and links within docs/ and to the web are not touched."""
    links = hook("links")
    assert links.uri(ROOT / "fish_env" / "physics" / "tank.py") == "repository/fish_env/physics/tank.py.md"
    assert links.uri(ROOT / "benchmarks" / "results" / "gait.csv") == "repository/benchmarks/results/gait.csv"
    assert links.uri(ROOT / "benchmarks") == "repository/benchmarks/index.md"
    folder = ROOT / "docs" / "envs"
    assert links.outside(folder, "../../fish_env/physics/tank.py") == ROOT / "fish_env" / "physics" / "tank.py"
    for link in ("swim.md", "../physics.md", "https://gymnasium.farama.org", "../../nothing.py", "../../../tmp"):
        assert links.outside(folder, link) is None, link


def test_links_are_found_outside_code_only():
    """A link in fenced code is not a link."""
    assert hook("links").links("[a](../a.py)\n\n```\n[b](../b.py)\n```\n\n[c](c.md#d)\n") == ["../a.py", "c.md"]


def test_equations_become_mathml_and_unknown_commands_are_reported(caplog):
    """A number moves beside its equation; a command that cannot be converted is a warning, which CI refuses."""
    equations = hook("equations")
    found = equations.block(r"e_{ij} = \lvert r_{ij} \rvert \tag{4}", "math", "", {}, None)
    assert "<math" in found and "(4)" in found and 'id="eq-4"' in found and "tag" not in found
    assert not caplog.records
    with caplog.at_level(logging.WARNING):
        equations.mathml(r"\nosuchcommand x", "inline")
    assert r"\nosuchcommand" in caplog.text
