"""Every code block of README.md and of the pages in docs/ and examples/ does what it says, found by itself.

Python blocks are executed, each alone, or all of a page in order where the page says so; functions `test_...` in them
are called. `test_documentation.py` runs the commands.
"""

import importlib.util
import json
import os
import re
import subprocess
import sys

import pytest
from moving import tiered
from pages import FENCE, PAGES, ROOT, blocks

import fish_env

pytestmark = pytest.mark.soft

IN_ORDER = re.compile(r"blocks\s+(?:of|on)\s+this\s+page\s+run\s+in\s+order", re.IGNORECASE)
"""What a page says whose Python blocks build on one another."""
ELSEWHERE = {"docs/extending.md": "tests/test_extending.py runs its blocks, some of which are files"}
OWN_KERNELS = "docs/soft-objects.md"
"""A page whose blocks take long to compile, and which are slow."""
NOT_CODE = {"math", "text", "mermaid", "bibtex"}
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


def test_every_block_is_checked():
    """There are blocks, and none in a language of which this file does not know what to do with it."""
    assert len(BLOCKS) > 20 and len(RUN) > 10
    known = NOT_CODE | {"python", "json", "sh"}
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
    for library in ("onnx", "wandb"):
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


@pytest.mark.parametrize("program", tiered(PROGRAMS, [each for each in PROGRAMS if not each.startswith(OWN_KERNELS)]))
def test_blocks_run(program, monkeypatch, tmp_path):
    """A block can be copied out of its page, anywhere: it imports what it needs, or its page says what is before."""
    monkeypatch.chdir(tmp_path)
    scope, tasks = {"__name__": "block"}, set(fish_env.TASKS)
    try:
        for block in PROGRAMS[program]:
            execute(block, scope)
    finally:
        for task in set(fish_env.TASKS) - tasks:
            del fish_env.TASKS[task]


# Code within the text


def spans():
    """(page, text) of every piece of code within the text."""
    for page in PAGES:
        text = FENCE.sub("", page.read_text())
        for span in re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text):
            yield page.relative_to(ROOT).as_posix(), span


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
