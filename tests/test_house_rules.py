"""Sizes that keep the code easy to read: of functions and of argument lists."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FILES = sorted(path for room in ("fish_env", "agents", "examples") for path in (ROOT / room).rglob("*.py"))
FUNCTION_LINES, ARGUMENTS = 60, 8
EXCEPTIONS = {
    "make_body": "the constructor of a record, called by keywords",
    "make_water": "keywords of an environment's `water`",
    "make_two_layer": "keywords of `make_fish`: each a number of the material that a user may set",
    "Tank.__init__": "the public constructor: each option is a keyword, also of the environments",
    "Episodes.__init__": "the keywords of `gym.make`, in one place",
}
"""Functions that take more arguments, or more lines to document them, and why."""


def functions(path):
    """Name, lines and number of arguments of every function in a file, methods by their class."""

    def walk(node, owner):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                yield from walk(child, child.name)
            elif isinstance(child, ast.FunctionDef):
                given = child.args
                count = len(given.posonlyargs) + len(given.args) + len(given.kwonlyargs)
                bound = owner is not None and not any(
                    getattr(d, "id", "") == "staticmethod" for d in child.decorator_list
                )
                name = f"{owner}.{child.name}" if owner else child.name
                yield name, child.end_lineno - child.lineno + 1, count - bound
                yield from walk(child, None)

    return list(walk(ast.parse(path.read_text()), None))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_short(path):
    """Functions of at most 60 lines and 8 arguments, but for those named above."""
    long = {
        name: (lines, count) for name, lines, count in functions(path) if lines > FUNCTION_LINES or count > ARGUMENTS
    }
    assert set(long) <= set(EXCEPTIONS), long


def test_exceptions_are_needed():
    """Every exception names a function that exists and is longer than the rest."""
    found = {
        name for path in FILES for name, lines, count in functions(path) if lines > FUNCTION_LINES or count > ARGUMENTS
    }
    assert set(EXCEPTIONS) <= found
