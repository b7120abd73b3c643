"""The search of the open-loop gait runs, and writes a gait that the package reads."""

import json

import pytest

from benchmarks.calibration import gait_search
from fish_env.control import Gait, best_gait


def test_a_search_of_one_generation(tmp_path, monkeypatch):
    """It writes what it found with its provenance, near where it began, and nothing of the package."""
    pytest.importorskip("cma")
    shipped, path = best_gait(), tmp_path / "gait.json"
    monkeypatch.setattr(gait_search, "GAIT_FILE", path)
    gait_search.write_gait([Gait(4.0, (0.5, 0.8, 0.7), (0.0, 0.7, 5.8))], "a test", generations=1)
    written = json.loads(path.read_text())
    found = Gait(written["gait"]["frequency"], tuple(written["gait"]["amplitude"]), tuple(written["gait"]["lag"]))
    assert written["provenance"]["command"] == "a test" and best_gait() == shipped
    assert 3.0 < found.frequency <= 4.0 and found.lag[0] == 0.0
    assert all(abs(a - b) < 0.5 for a, b in zip(found.amplitude, (0.5, 0.8, 0.7), strict=True))
