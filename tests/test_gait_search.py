"""Searches of the calibration run, are kept, and write what the package reads."""

import json

import numpy as np
import pytest

from benchmarks.calibration import finest, gait_search, keep
from fish_env.bodies.fitted import WATERS
from fish_env.control import Gait, best_gait


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A folder for what searches find."""
    monkeypatch.setattr(keep, "KEPT", tmp_path / "kept")
    return tmp_path / "kept"


def test_a_search_of_one_generation(tmp_path, monkeypatch, kept):
    """It writes what it found, near where it began, with its provenance; the package stays; found again, it is kept."""
    pytest.importorskip("cma")
    shipped, path = best_gait(), tmp_path / "gait.json"
    monkeypatch.setattr(gait_search, "GAIT_FILE", path)
    gait_search.calibrate("drag", generations=1)
    written = json.loads(path.read_text())["drag"]
    found = Gait(written["gait"]["frequency"], tuple(written["gait"]["amplitude"]), tuple(written["gait"]["lag"]))
    assert "--water drag" in written["provenance"]["command"] and best_gait() == shipped
    assert 3.0 < found.frequency <= 4.0 and found.lag[0] == 0.0
    monkeypatch.setattr(gait_search, "search", None)
    gait_search.calibrate("drag", generations=1)
    assert json.loads(path.read_text())["drag"]["gait"] == written["gait"] and len(list(kept.iterdir())) == 1


def test_another_job_is_another_result(kept):
    """What is kept under one job is not given for another."""
    assert [keep.kept("double", lambda value: 2 * value, value) for value in (1, 2, 1)] == [2, 4, 2]
    assert len(list(kept.iterdir())) == 2


@pytest.mark.parametrize("water", finest.START)
def test_the_finest_body_at_the_start_of_its_search(water):
    """The point zero is the record itself; a factor changes the one value that it is of."""
    start = finest.START[water]
    assert finest.decoded(np.zeros(finest.SIZE), start) == start
    moved = finest.decoded(0.1 * np.eye(finest.SIZE)[0], start)
    assert moved["parameters"]["stiffness"][1] == pytest.approx(np.exp(0.1) * start["parameters"]["stiffness"][1], 1e-3)
    moved["parameters"]["stiffness"] = start["parameters"]["stiffness"]
    assert moved == start and water in WATERS
