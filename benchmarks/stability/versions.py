"""The package on other versions of Python and of what it depends on: built, installed, imported and tested.

    python -m benchmarks.stability.versions                      all of TRIALS, an hour; results/versions.csv
    python -m benchmarks.stability.versions 3.10-lowest          one of them; the other rows of the table stay
    python -m benchmarks.stability.versions 3.12-pinned --no-tests         without running the tests, some minutes
    python -m benchmarks.stability.versions 3.12-newest --folder /tmp/trial      in a folder that is left behind

A trial takes `python3.10` (or another) from the PATH and the last commit, never what is not committed. In a new folder
it builds the source archive, and the wheel out of that; installs the wheel without extras into an empty environment,
where importing it must not warn and a shipped policy must swim; installs the source archive with the extra [dev] into
another one, and runs the tests there, with a cache of kernels of its own. Resolutions: "lowest", everything that
pyproject.toml requires at its lower bound; "newest", what pip chooses, but for torch; "pinned", constraints.txt.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.common.tables import RESULTS, ROOT, read_rows, write_csv
from benchmarks.stability.reliability import count_tests

COMMAND = "python -m benchmarks.stability.versions"
TABLE = "versions.csv"
TRIALS = ("3.10-lowest", "3.11-pinned", "3.12-pinned", "3.13-newest")
RESOLUTIONS = ("lowest", "newest", "pinned")
BUILD = "import setuptools.build_meta as backend, sys; print(backend.build_sdist(sys.argv[1]))"
IMPORT = "import fish_env, fish_env.control, fish_env.envs"


def required(text: str, extra: str = "dev") -> list[str]:
    """What the text of a pyproject.toml requires with an extra, and with the extras of its own that this one names."""
    lists = dict(re.findall(r"^([\w-]+) = \[(.*)\]$", text, re.MULTILINE))
    found = []
    for each in re.findall(r'"([^"]+)"', lists["dependencies"] + lists[extra]):
        own = re.fullmatch(r"fish_env\[(\w+)\]", each)
        found += required(text, own[1]) if own else [each]
    return list(dict.fromkeys(found))


def bounds(text: str) -> dict[str, str]:
    """The lower bound of everything that the text of a pyproject.toml requires with the extra [dev], by name.

    Raises:
        ValueError: a package has no lower bound, or two.
    """
    found: dict[str, str] = {}
    for each in required(text):
        name, bound = re.match(r"([\w-]+)(?:\[\w+\])?(?:>=([\d.]+))?", each).groups()
        if bound is None or found.setdefault(name, bound) != bound:
            raise ValueError(f"{name} has the lower bounds {found.get(name)} and {bound}; give it one")
    return found


def constraints(resolution: str, source: Path) -> str:
    """The lines that pip is constrained by, from the files of a source tree."""
    pinned = (source / "constraints.txt").read_text()
    if resolution == "lowest":
        required = bounds((source / "pyproject.toml").read_text())
        return "".join(f"{name}=={bound}\n" for name, bound in required.items())
    if resolution == "newest":  # other builds of torch than the pinned one are of some gigabytes, for GPUs
        return "".join(line for line in pinned.splitlines(keepends=True) if line.startswith("torch=="))
    return pinned


class Place:
    """A folder with a clone of the last commit, environments, and what commands run there are told."""

    def __init__(self, folder: Path, python: str, resolution: str):
        self.folder, self.python, self.source = folder, python, folder / "source"
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL", "FISH"))}
        cache = {"NUMBA_CACHE_DIR": str(folder / "kernels"), "XDG_CACHE_HOME": str(folder / "cache")}
        self.variables = kept | cache | {"SDL_VIDEODRIVER": "dummy", "OMP_NUM_THREADS": "1"}
        self.run("git", "clone", "--quiet", str(ROOT), str(self.source))
        self.given = folder / "constraints.txt"
        self.given.write_text(constraints(resolution, self.source))

    def run(self, *command: str, **keywords) -> str:
        """What a command prints; one that fails ends the trial, its own output before it."""
        done = subprocess.run(command, cwd=keywords.pop("cwd", self.folder), env=self.variables, text=True,
                              stdout=subprocess.PIPE, check=False, **keywords)  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}\n{done.stdout[-5000:]}")
        return done.stdout

    def environment(self, name: str, *packages: str) -> str:
        """The interpreter of a new environment that holds packages and what they require."""
        self.run(self.python, "-m", "venv", str(self.folder / name))
        python = str(self.folder / name / "bin" / "python")
        self.run(python, "-m", "pip", "install", "--quiet", "--no-compile", "-c", str(self.given), *packages)
        return python


def build(place: Place) -> tuple[Path, Path]:
    """The source archive of a place, and the wheel that is built out of it."""
    python = place.environment("build", "setuptools")
    (place.folder / "dist").mkdir()
    name = place.run(python, "-c", BUILD, str(place.folder / "dist"), cwd=place.source).splitlines()[-1]
    archive = place.folder / "dist" / name
    place.run(python, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(archive.parent), str(archive))
    (wheel,) = archive.parent.glob("*.whl")
    return archive, wheel


def use(place: Place, python: str) -> None:
    """What an installed package must do outside the checkout: be imported without a warning, and swim."""
    place.run(python, "-m", "pip", "check")
    place.run(python, "-W", "error", "-c", IMPORT)
    if "speed" not in place.run(python, "-m", "fish_env", "evaluate", "swim", "--episodes", "1"):
        raise RuntimeError("python -m fish_env evaluate swim printed no speed")


def versions(place: Place, python: str) -> str:
    """The versions of what pyproject.toml names, of those that are installed, in its order."""
    listed = json.loads(place.run(python, "-m", "pip", "list", "--format", "json"))
    found = {re.sub("[-_.]+", "-", each["name"]).lower(): each["version"] for each in listed}
    names = bounds((place.source / "pyproject.toml").read_text())
    return ", ".join(f"{name} {found[name.lower()]}" for name in names if name.lower() in found)


def trial(place: Place, workers: int, tested: bool = True) -> dict[str, int | str]:
    """Build, install, import and test in a place: how many tests there were, and of which versions.

    If it is not to be tested, the source archive is installed without extras, as the wheel is, and numbers are missing.
    """
    archive, wheel = build(place)
    use(place, place.environment("core", str(wheel)))
    if not tested:
        python = place.environment("archive", str(archive))
        use(place, python)
        return dict.fromkeys(("tests", "passed", "skipped", "failed"), "-") | {"versions": versions(place, python)}
    python = place.environment("dev", f"{archive}[dev]")
    use(place, python)
    report = place.folder / "report.xml"
    command = [python, "-m", "pytest", "-n", str(workers), "-p", "no:cacheprovider", "--junitxml", str(report)]
    subprocess.run(command, cwd=place.source, env=place.variables, check=False)
    return count_tests(report) | {"versions": versions(place, python)}


@contextmanager
def room(folder: Path | None) -> Iterator[Path]:
    """An empty folder: a given one, or one that is removed in the end."""
    if folder is None:
        with tempfile.TemporaryDirectory() as name:
            yield Path(name)
    else:
        folder.mkdir(parents=True)
        yield folder.absolute()


def keep(row: dict[str, int | str]) -> None:
    """Put a row into the table, in place of the one of the same Python and resolution."""
    path = RESULTS / TABLE
    rows: list[dict] = read_rows(path) if path.exists() else []

    def key(each):
        return [int(part) for part in each["python"].split(".")[:2]], each["resolution"]

    rows = sorted([each for each in rows if key(each) != key(row)] + [row], key=key)
    write_csv(TABLE, rows, COMMAND)


def main() -> int:
    """The command line; exit 1 if a test failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trials", nargs="*", default=TRIALS, help="such as 3.10-lowest (default: all of the table)")
    parser.add_argument("--workers", type=int, default=2, help="processes of pytest (default 2)")
    parser.add_argument("--no-tests", action="store_true", help="only build, install, import and evaluate a policy")
    parser.add_argument(
        "--folder", type=Path, help="a new folder, left behind to be looked at (default a temporary one)"
    )
    chosen = parser.parse_args()
    failed = 0
    for name in chosen.trials:
        version, _, resolution = name.partition("-")
        python = shutil.which(f"python{version}")
        if resolution not in RESOLUTIONS or python is None:
            parser.error(f"{name}: is python{version} on the PATH, and the resolution one of {', '.join(RESOLUTIONS)}?")
        with room(chosen.folder and chosen.folder / name) as folder:
            place = Place(folder, python, resolution)
            exact = place.run(python, "-c", "import platform; print(platform.python_version())").strip()
            commit = place.run("git", "describe", "--always", cwd=place.source).strip()
            row = {"python": exact, "resolution": resolution, "commit": commit}
            row |= trial(place, chosen.workers, not chosen.no_tests)
        print(", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
        failed += 0 if chosen.no_tests else int(row["failed"])
        keep(row)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
