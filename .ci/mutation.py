"""Would the tests notice a mistake? Mistakes are made one at a time, in memory, and the tests without the compiler run.

    python .ci/mutation.py --count 40 --seed 1                    so many mistakes, drawn at random
    python .ci/mutation.py fish_env/physics/forces/water.py       all mistakes in a file

A mistake exchanges an operator or a comparison, changes a number, drops a minus or a `not`, or exchanges `and` and
`or`. Texts, annotations and what is raised stay. Each runs in a forked process with NUMBA_DISABLE_JIT=1, so that no
kernel is compiled, and meets the tests that are fast enough there. One that these do not notice is made in a copy of
the package, which is compiled, and meets whole files of tests (a minute or two). One that no test notices is printed.
"""

import argparse
import ast
import importlib.abc
import importlib.util
import io
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

os.environ |= {"NUMBA_DISABLE_JIT": "1", "OPENBLAS_NUM_THREADS": "1", "FISH_ENV_TEST_SECONDS": "20"}

ROOT = Path(__file__).parent.parent
SECONDS = 60  # of processor time for all tests of a mistake; one that takes longer is noticed: some loop has no end


class Room(NamedTuple):
    """Files in which mistakes are made, and the tests that are asked: patterns of tests/**/test_*.py."""

    files: tuple[str, ...]
    """Patterns below the root."""
    selected: str
    """Selects tests, since some take too long without the compiler."""
    fast: tuple[str, ...]
    """Tests that meet a mistake without the compiler."""
    compiled: tuple[str, ...]
    """Tests that a compiled copy of the package with a mistake meets."""


ROOMS = (
    Room(
        ("fish_env/physics/integrators/*.py", "fish_env/soft/adaptive.py"),
        "equal_their_reference or equals_its_reference or every_method_has or most_stages or filter or polynomials",
        ("methods", "soft_methods"),
        ("methods", "soft_methods", "stability", "bodies", "tank"),
    ),
    Room(
        ("fish_env/physics/forces/*.py", "fish_env/soft/forces/*.py"),
        "not derivatives",
        ("elements", "forces"),
        ("forces", "elements", "extending", "conditions", "tank", "bodies", "soft_methods", "methods"),
    ),
    Room(
        ("fish_env/tasks/*.py",),
        "start_pose or starts_differ or commanded_when or reversal or severity_widens or alignment or impossible",
        ("tasks",),
        ("tasks", "observations", "environments", "controllers", "evaluation"),
    ),
)  # fmt: skip
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
             ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult}  # fmt: skip
COMPARISONS = {ast.Lt: ast.GtE, ast.LtE: ast.Lt, ast.Gt: ast.LtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
               ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}  # fmt: skip


class Mistakes(ast.NodeTransformer):
    """Finds the places where a mistake can be made, and makes the one of a number."""

    def __init__(self, wanted: int | None = None):
        self.wanted, self.count, self.what = wanted, 0, ""

    def made(self, node: ast.AST, text: str) -> bool:
        """Whether this place is the wanted one."""
        self.count += 1
        if self.count - 1 != self.wanted:
            return False
        self.what = f"line {node.lineno}: {text}"  # type: ignore[attr-defined]
        return True

    def visit_FunctionDef(self, node):
        """Functions without their annotations and decorators."""
        node.body = [self.visit(each) for each in node.body]
        return node

    def visit_AnnAssign(self, node):
        """Without the annotation."""
        node.value = node.value and self.visit(node.value)
        return node

    def visit_Raise(self, node):
        """Texts of errors are nobody's mistake."""
        return node

    def visit_JoinedStr(self, node):
        """Nor are other texts."""
        return node

    def visit_BinOp(self, node):
        """Another operator."""
        self.generic_visit(node)
        other = OPERATORS.get(type(node.op))
        before = ast.unparse(node)
        if other and not isinstance(node.left, ast.JoinedStr) and self.made(node, before):
            node.op = other()
            self.what += f" -> {ast.unparse(node)}"
        return node

    def visit_AugAssign(self, node):
        """Subtracted instead of added, and the like."""
        self.generic_visit(node)
        other, before = OPERATORS.get(type(node.op)), ast.unparse(node)
        if other and self.made(node, before):
            node.op = other()
            self.what += f" -> {ast.unparse(node)}"
        return node

    def visit_Compare(self, node):
        """The opposite comparison, or one that differs where both sides are equal."""
        self.generic_visit(node)
        other, before = COMPARISONS.get(type(node.ops[0])), ast.unparse(node)
        if other and self.made(node, before):
            node.ops[0] = other()
            self.what += f" -> {ast.unparse(node)}"
        return node

    def visit_BoolOp(self, node):
        """`or` for `and`."""
        self.generic_visit(node)
        before = ast.unparse(node)
        if self.made(node, before):
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            self.what += f" -> {ast.unparse(node)}"
        return node

    def visit_UnaryOp(self, node):
        """No minus, no `not`."""
        self.generic_visit(node)
        if isinstance(node.op, ast.USub | ast.Not) and self.made(node, ast.unparse(node)):
            self.what += f" -> {ast.unparse(node.operand)}"
            return node.operand
        return node

    def visit_Constant(self, node):
        """Another number or truth value."""
        value = node.value
        if isinstance(value, bool):
            other = not value
        elif isinstance(value, int):
            other = value + 1
        elif isinstance(value, float):
            other = 2.0 * value if value else 1.0
        else:
            return node
        if self.made(node, repr(value)):
            self.what += f" -> {other!r}"
            return ast.Constant(other)
        return node


def places(path: Path) -> int:
    """How many mistakes can be made in a file."""
    finder = Mistakes()
    finder.visit(ast.parse(path.read_text()))
    return finder.count


class Loader(importlib.abc.MetaPathFinder):
    """Loads one module of the package with a mistake in it."""

    def __init__(self, path: Path, number: int):
        self.name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        self.maker, self.path = Mistakes(number), path

    def find_spec(self, name, path, target=None):
        """The specification of that module, and of no other."""
        return importlib.util.spec_from_loader(name, self, origin=str(self.path)) if name == self.name else None

    def create_module(self, spec):
        """Nothing special."""

    def exec_module(self, module):
        """Run the source with the mistake."""
        module.__file__ = str(self.path)
        tree = ast.fix_missing_locations(self.maker.visit(ast.parse(self.path.read_text())))
        exec(compile(tree, str(self.path), "exec"), module.__dict__)


def files_of(room: Room) -> list[Path]:
    """The files of a room."""
    return sorted(path for pattern in room.files for path in ROOT.glob(pattern))


def room_of(path: Path) -> Room:
    """The room that a file is in."""
    for room in ROOMS:
        if path in files_of(room):
            return room
    raise SystemExit(f"{path} is in no room; give a file of {', '.join(each for room in ROOMS for each in room.files)}")


def tests_of(names: tuple[str, ...]) -> list[str]:
    """The files of tests by their patterns."""
    found = {name: sorted((ROOT / "tests").rglob(f"test_{name}.py")) for name in names}
    if missing := [name for name, paths in found.items() if not paths]:
        raise SystemExit(f"there is no test_{missing[0]}.py in tests; correct ROOMS in {Path(__file__).name}")
    return [path.relative_to(ROOT).as_posix() for paths in found.values() for path in paths]


def status_of(path: Path, number: int | None) -> int:
    """The exit status of pytest with a mistake in a file, 0 if no test notices; in this process, which it spoils."""
    import numpy as np
    import pytest

    np.seterr(all="ignore")
    if number is not None:
        sys.meta_path.insert(0, Loader(path, number))
    room = room_of(path)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        return int(pytest.main(["-x", "-q", "-n", "0", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore",
                                "-k", room.selected, *tests_of(room.fast)]))  # fmt: skip


def noticed(path: Path, number: int | None) -> bool:
    """Whether a test notices a mistake; with None for the number, whether the tests fail without one."""
    process = os.fork()
    if not process:
        try:
            import resource

            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            os._exit(status_of(path, number))
        except BaseException:
            os._exit(3)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) != 0


def noticed_compiled(path: Path, number: int) -> bool:
    """Whether a test notices a mistake in a copy of the package, with the compiler."""
    maker = Mistakes(number)
    tree = ast.fix_missing_locations(maker.visit(ast.parse(path.read_text())))
    room = room_of(path)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place)
        for name in ("fish_env", "agents", "benchmarks", "tests", "docs", "examples"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "train.py", "README.md"):
            shutil.copy(ROOT / name, copy / name)
        (copy / path.relative_to(ROOT)).write_text(ast.unparse(tree))
        own = {"PYTHONPATH": f"{copy}{os.pathsep}{copy / 'tests'}", "FISH_ENV_CACHE": str(copy / "kernels")}
        kept = {
            key: value for key, value in os.environ.items() if key not in ("NUMBA_DISABLE_JIT", "FISH_ENV_TEST_SECONDS")
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "--tb=no", "-p", "no:cacheprovider",
                   *tests_of(room.compiled)]  # fmt: skip
        done = subprocess.run(command, cwd=copy, env=kept | own, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1, 2):  # passed, failed, or not even loaded
            raise SystemExit(f"pytest could not run the tests of {path}: {done.stdout}{done.stderr}")
        return done.returncode != 0


def main() -> int:
    """The command line; the number of mistakes that no test has noticed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="all mistakes in these; default: some at random from ROOMS")
    parser.add_argument("--count", type=int, default=40, help="how many at random (default 40)")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (default 0)")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no other after so many")
    chosen = parser.parse_args()
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    import numba, numpy, pytest, scipy.optimize, gymnasium, hypothesis  # noqa: E401, F401, I001 - forks share them

    files = [path.resolve() for path in chosen.files] or [path for room in ROOMS for path in files_of(room)]
    os.chdir(ROOT)
    for path in {room_of(path): path for path in files}.values():
        if noticed(path, None):
            raise SystemExit(f"the tests of {path.relative_to(ROOT)} fail without any mistake")
    found = [(path, number) for path in files for number in range(places(path))]
    if not chosen.files:
        found = random.Random(chosen.seed).sample(found, min(chosen.count, len(found)))
    begun, tried, late, missed = time.monotonic(), 0, 0, 0
    for path, number in found:
        if time.monotonic() - begun > 60 * chosen.minutes:
            break
        tried += 1
        if noticed(path, number):
            continue
        if noticed_compiled(path, number):
            late += 1
        else:
            missed += 1
            maker = Mistakes(number)
            maker.visit(ast.parse(path.read_text()))
            print(f"{path.relative_to(ROOT)}, {maker.what}", flush=True)
    print(
        f"{tried} mistakes of {len(found)} drawn, {tried - missed} noticed, {late} of them compiled only, {missed} not"
    )
    return missed


if __name__ == "__main__":
    sys.exit(main())
