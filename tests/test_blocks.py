"""Every code block of README.md and of the pages in docs/ and examples/ does what it says, found by itself.

Python blocks are executed, each alone, or all of a page in order where the page says so; functions `test_...` in them
are called. Commands are checked by the help of the program they call, without being executed.
"""

import importlib.util
import io
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import pytest
from pages import FENCE, PAGES, ROOT, blocks

IN_ORDER = re.compile(r"blocks\s+(?:of|on)\s+this\s+page\s+run\s+in\s+order", re.IGNORECASE)
"""What a page says whose Python blocks build on one another."""
ELSEWHERE = {"docs/extending.md": "tests/test_extending.py runs its blocks, some of which are files"}
NOT_CODE = {"", "math", "text", "mermaid", "bibtex"}
SHELL = ("sh", "bash", "shell", "console")
OTHER_PROGRAMS = {
    "pytest": "the tests themselves",
    "tensorboard": "a server",
    "pre-commit": "changes the checkout",
    "mkdocs": "builds the site",
    "git": "needs a network",
    "cd": "a shell's own",
    "ray": "starts a cluster",
    ".ci/coverage": "runs the tests",
}
OTHER_LIBRARIES = {"rllib": "ray", "cleanrl": "torch", "torchrl": "torchrl", "sbx": "sbx", "gpu": "torch"}
"""Libraries that the help of an example needs, by a word of its name."""
OTHER_MODULES = {"rl_zoo3.train": "not installed here", "rl_zoo3.enjoy": "not installed here", "pip": "see `pip`"}

BLOCKS = [block for page in PAGES for block in blocks(page)]
RUN = [block for block in BLOCKS if block.language in ("python", "json") and block.page not in ELSEWHERE]


def programs():
    """Blocks that run together: each alone, or all of a page that says so."""
    found: dict[str, list] = {}
    for block in RUN:
        in_order = IN_ORDER.search((ROOT / block.page).read_text())
        found.setdefault(block.page if in_order else str(block), []).append(block)
    return found


PROGRAMS = programs()


def commands():
    """(block, words) of every command of the shell blocks."""
    for block in BLOCKS:
        if block.language in SHELL:
            text = block.text.replace("\\\n", " ")
            if block.language == "console":
                text = "\n".join(line[2:] for line in text.splitlines() if line.startswith("$ "))
            for line in text.splitlines():
                for command in re.split(r"\s(?:&&|;)\s", line):
                    words = shlex.split(command, comments=True)
                    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):  # a variable of the command
                        words.pop(0)
                    if words:
                        yield block, words


COMMANDS = list(commands())


def test_every_block_is_checked():
    """There are blocks, and none in a language of which this file does not know what to do with it."""
    assert len(BLOCKS) > 20 and len(RUN) > 10 and len(COMMANDS) > 5
    known = NOT_CODE | {"python", "json", *SHELL}
    unknown = [str(block) for block in BLOCKS if block.language not in known and block.page not in ELSEWHERE]
    assert not unknown, f"say in tests/test_blocks.py how these are checked: {unknown}"
    fences = sum(len(re.findall(r"^ *```", page.read_text(), re.MULTILINE)) for page in PAGES)
    assert fences == 2 * len(BLOCKS)  # none is left open or overlooked
    assert set(ELSEWHERE) <= {block.page for block in BLOCKS}


def execute(block, scope):
    """Run a block in a namespace, and the tests that it defines; JSON is read."""
    if block.language == "json":
        json.loads(block.text)
        return
    if re.search(r"stable_baselines3|sb3|\btorch\b", block.text):
        pytest.importorskip("stable_baselines3")
    for library in ("onnx", "optuna", "wandb"):
        if re.search(rf"\b(to_)?{library}\b", block.text):
            pytest.importorskip(library)
    if re.search(r"\brllib\b", block.text):
        pytest.importorskip("ray")
    if "torch_env" in block.text and not pytest.importorskip("torch").cuda.is_available():
        pytest.skip("needs an NVIDIA GPU")
    if "render_mode" in block.text:
        pytest.importorskip("pygame")
    before = set(scope)
    filler = "\n" * (block.line - 1)  # so that a traceback names the line of the page
    exec(compile(filler + block.text, str(ROOT / block.page), "exec"), scope)
    for name in sorted(set(scope) - before):
        if name.startswith("test_"):
            scope[name]()


@pytest.mark.parametrize("program", PROGRAMS)
def test_blocks_run(program, monkeypatch, tmp_path):
    """A block can be copied out of its page, anywhere: it imports what it needs, or its page says what is before."""
    monkeypatch.chdir(tmp_path)
    scope = {"__name__": "block"}
    for block in PROGRAMS[program]:
        execute(block, scope)


# Commands


@cache
def help_of(*words):
    """What a program of this repository prints when it is called with these words and --help, in this process."""
    if words[0] == "-m":
        spec = importlib.util.find_spec(words[1])
        spec = importlib.util.find_spec(f"{words[1]}.__main__") if spec.submodule_search_locations else spec
        words = (spec.origin, *words[2:])
    printed, before = io.StringIO(), (sys.argv, sys.path[:])
    sys.argv = [str(ROOT / words[0]), *words[1:], "--help"]
    sys.path.insert(0, str(Path(sys.argv[0]).parent))
    try:
        with redirect_stdout(printed), pytest.raises(SystemExit) as end:
            runpy.run_path(sys.argv[0], run_name="__main__")
    finally:
        sys.argv, sys.path[:] = before
    assert not end.value.code, f"{' '.join(words)} --help: {end.value}"
    return printed.getvalue()


def check_pip(words):
    """The extras that are installed exist, and so does a file of constraints."""
    text = " ".join(words)
    declared = (ROOT / "pyproject.toml").read_text().split("[project.optional-dependencies]")[1].split("\n[")[0]
    for extras in re.findall(r"(?:^|\s)(?:\.|fish_env)\[([\w,]+)\]", text):
        for extra in extras.split(","):
            assert re.search(rf"^{extra} = ", declared, re.MULTILINE), f"there is no extra {extra!r}"
    for name in re.findall(r"-[cr] (\S+)", text):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize(("block", "words"), COMMANDS, ids=lambda part: " ".join(part) if type(part) is list else "")
def test_command(block, words):
    """The program exists and has every option that is given: its help says so."""
    program, *rest = words if words[0] != "fish_env" else ["python", "-m", *words]
    if program == "pip":
        return check_pip(rest)
    if program in OTHER_PROGRAMS:
        return None
    assert program == "python", f"{block}: say in tests/test_blocks.py how {program} is checked"
    entry = rest[:2] if rest[0] == "-m" else rest[:1]
    for word, module in OTHER_LIBRARIES.items():
        if word in entry[-1]:
            pytest.importorskip(module)
    if entry[-1] in OTHER_MODULES:
        return None
    arguments = rest[len(entry) :]
    first = next((k for k, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    named = [word for word in arguments[:first] if re.fullmatch(r"\w+", word)]
    text = help_of(*entry, *named)
    for option in (word.split("=")[0] for word in arguments if word.startswith("-")):
        assert re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", text), f"{block}: {option} is not in its help"
    return None


# Code within the text


def spans():
    """(page, text) of every piece of code within the text."""
    for page in PAGES:
        text = FENCE.sub("", page.read_text())
        for span in re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text):
            yield page.relative_to(ROOT).as_posix(), span


def test_commands_within_the_text():
    """A program named in the text exists, and every option it is given stands in its source, or else in its help."""
    found = 0
    for page, span in spans():
        match = re.match(r"python (?:-m )?([\w./]+)(.*)", span)
        if match is None or match[1] in OTHER_MODULES:
            continue
        found += 1
        if "-m" in span.split():
            spec = importlib.util.find_spec(match[1])
            assert spec is not None, f"{page}: {span}"
            paths = [Path(spec.origin)]
            if paths[0].name == "__init__.py":
                paths = [*paths[0].parent.rglob("*.py")]
                assert any(path.name == "__main__.py" for path in paths), f"{page}: {span} cannot be run"
        else:
            paths = [ROOT / match[1]]
        source = "".join(path.read_text() for path in paths)
        for option in re.findall(r"(?<!\S)--[\w-]+", match[2]):
            if f'"{option}"' not in source:
                entry = span.split()[1:3] if "-m" in span.split() else [match[1]]
                assert re.search(rf"(?<![\w-]){option}(?![\w-])", help_of(*entry)), f"{page}: {span}"
    assert found > 3


def test_names_within_the_text():
    """A name that begins with `fish_env.` exists; what the text calls is found after `import fish_env` alone.

    That loads neither Stable-Baselines3 nor torch, also where `fish_env.make_sb3_vec_env` can be called.
    """
    called, named = {"fish_env.make_sb3_vec_env": "the test"}, {}
    for page, span in spans():
        match = re.match(r"(fish_env(?:\.\w+)+)(\(?)", span)
        if match is not None and not match[1].endswith((".py", ".md")):
            (called if match[2] else named).setdefault(match[1], page)
    assert called and named
    made = "assert fish_env.make_sb3_vec_env('FishEnv/Stub-v0', num_envs=3, seed=0).reset().shape == (3, 156)\n"
    if importlib.util.find_spec("stable_baselines3") is None:
        called.pop("fish_env.make_sb3_vec_env")
        made = ""
    script = (
        "import pkgutil, sys, fish_env\n"
        "loaded = {'stable_baselines3', 'torch', 'pygame', 'matplotlib'} & set(sys.modules)\n"
        "assert not loaded, loaded\n"
        "assert 'make_sb3_vec_env' in fish_env.__all__\n"
        f"for name in {sorted(called)}:\n"
        "    found = fish_env\n"
        "    for part in name.split('.')[1:]: found = getattr(found, part)\n"
        f"for name in {sorted(named)}:\n"
        "    pkgutil.resolve_name(name)\n" + made
    )
    found = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", script], env=found, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stderr}\n{called} {named}"
