"""Results of searches are kept in `runs/calibration`: one that was interrupted goes on after the last that ended."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fish_env
from benchmarks.common.tables import provenance
from fish_env.control.files import write_text
from fish_env.kernels.cache import source_hash

KEPT = Path("runs/calibration")
HERE = Path(__file__).parent
PACKAGE = Path(fish_env.__file__).parent
COMMAND = "python -m benchmarks.calibrate"
DIGITS = 4
"""Significant digits of what is calibrated."""


def digest(*parts: Any) -> str:
    """Names what a result depends on: what is given, the code of the calibration, of scenes and of the package."""
    code = sorted([*HERE.glob("*.py"), *HERE.parent.glob("common/*.py"), *HERE.glob("*.npz")])
    text = hashlib.sha256(f"{parts} {source_hash()}".encode() + b"".join(path.read_bytes() for path in code))
    return text.hexdigest()[:16]


def kept(name: str, function: Callable, *job: Any) -> Any:
    """What `function` of a job returns, as JSON gives it back; read from KEPT if it has been found before.

    A job says all that its result depends on beside code: numbers of the package may be others the next time.
    """
    path = KEPT / f"{name}-{digest(name, *job)}.json"
    if not path.exists():
        found = function(*job)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(found))
    return json.loads(path.read_text("utf-8"))


def publish(path: Path, water: str, record: dict) -> None:
    """Replace what a file of the package has for a level of water, with its provenance."""
    known = json.loads(path.read_text("utf-8")) if path.exists() else {}
    known[water] = {"provenance": provenance(f"{COMMAND} --water {water}"), **record}
    write_text(path, json.dumps(known, indent=2) + "\n")


def rounded(value: Any) -> Any:
    """Numbers, and lists of them, with DIGITS significant digits; anything else as it is."""
    if isinstance(value, dict):
        return {name: rounded(each) for name, each in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
