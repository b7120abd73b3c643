"""What a measurement was made with: written beside every CSV and into every calibrated file."""

import csv
import os
import platform
import subprocess
from datetime import date
from importlib.metadata import version
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


def provenance(command: str) -> dict[str, str]:
    """Command, commit, processor and versions. A commit is dirty if code that results depend on is not committed."""
    root = Path(__file__).parent.parent

    def git(*arguments):
        return subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False).stdout.strip()

    commit = git("describe", "--always")
    code = ("fish_env", "agents", "benchmarks", "train.py", "constraints.txt", "pyproject.toml")
    written = (":!benchmarks/results", ":!fish_env/control/pretrained", ":!fish_env/control/*.json")
    if commit and git("status", "--porcelain", "--", *code, *written):
        commit += "-dirty"
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), processor)
    return {
        "command": command,
        "commit": commit or "unknown",
        "date": date.today().isoformat(),
        "processor": f"{processor}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba", "gymnasium")},
    }


def write_csv(name: str, rows: list[dict], command: str) -> Path:
    """Write rows to results/name, preceded by the provenance as comment lines."""
    path = RESULTS / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        for key, value in provenance(command).items():
            file.write(f"# {key}: {value}\n")
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path
