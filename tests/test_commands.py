"""Every command of the pages runs: those of their shell blocks, and those within their text.

A page is read from its top: its commands run in order, in one folder, as a reader types them. They are only made
short, by options of `SHORT` after those of the page. What cannot run here stands in `NOT_RUN` with the reason. Slow
commands, and the whole page that they are on, are run by `pytest -m slow`.
"""

import importlib
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import pytest
from pages import FENCE, PAGES, ROOT, blocks

import fish_env
from fish_env import __main__ as command_line
from fish_env.control.policy import shipped_policy

HERE = [*PAGES, ROOT / "CONTRIBUTING.md"]
PROGRAMS = "python|fish_env|pip|pytest|pre-commit|mkdocs|twine|tensorboard|ray|docker|git|cd"
"""First words of commands: of every line of a shell block, and of spans within the text that say more than a name."""

NOT_RUN = {
    "git clone": "needs the network",
    "cd fish_env": "is for a clone",
    "git grep": "is for a clone",
    "pip install": "needs the network",
    "python -m build$": "needs the network",
    "twine check": "needs the archives",
    "pre-commit install": "changes the checkout",
    "mkdocs build": "takes a minute, in .ci/run too",
    "pytest": "is the tests themselves",
    r"python tests/mutation\.py": "runs the tests once for each mistake",
    "tensorboard": "is a server of somebody else's",
    "docker build": "builds images",
    "docker run": "needs an image",
    "ray start": "begins a cluster",
    r"python examples/train_rllib\.py": "needs a cluster",
    r"python -m rl_zoo3\.": "needs RL Baselines3 Zoo, which is no dependency",
    r"python examples/train_torchrl\.py": "needs TorchRL; test_learners.py runs it where that is installed",
    r"python examples/train_sbx\.py": "needs SBX; test_learners.py runs it where that is installed",
    r"python examples/train_gpu\.py": "needs an NVIDIA GPU",
    r"python -m benchmarks\.speed\.gpu": "needs an NVIDIA GPU",
    r"python -m benchmarks\.speed\.peers": "needs MuJoCo",
    r"python docs/site/gallery\.py": "needs a browser",
    r"python train\.py all": "takes an hour; test_publishing.py does it in small",
    r"python train\.py compare --integrators": "takes half an hour",
    "python -m benchmarks --all": "takes hours",
    r"python -m benchmarks\.calibrate ": "takes an hour, and changes the package",
    r"python -m benchmarks\.calibration\.fit": "takes a quarter of an hour",
    r"python -m benchmarks\.calibration\.living_fish": "takes six minutes",
    r"python -m benchmarks\.stability\.water": "takes 18 minutes",
    r"python -m benchmarks\.water\.prices": "takes three minutes",
    r"python -m benchmarks\.learning\.sensing": "takes half an hour",
}
"""How commands begin that no test runs, as regular expressions, and why."""

SHORT = {
    "fish_env train ": "--timesteps 2048 --num-envs 16 --no-pictures",
    "fish_env train .*--resume ": "--timesteps 4096",  # the run of the line before has ended
    r"python train\.py [a-z_]+$": "--timesteps 2048 --num-envs 16 --no-pictures",
    "fish_env play ": "--episodes 1 --env-kwargs max_episode_steps=9",
    "fish_env evaluate ": "--episodes 2",
    r"python train\.py evaluate ": "--episodes 2",
    "fish_env report ": "--episodes 2",
    r"python examples/train_cleanrl\.py": "--timesteps 512 --num-envs 16 --evaluations 3",
    r"python -m benchmarks\.accuracy": "--draw",
    r"python -m benchmarks\.bodies": "--draw",
    r"python -m benchmarks\.validation": "--draw",
    r"python -m benchmarks\.stability\.survey": "--draw",
    r"python -m benchmarks\.water\.levels": "--draw",
    r"python -m benchmarks\.speed\.scaling": "--draw",
    r"python -m benchmarks\.stability\.attack": "--body planar --fish 64 --evaluations 8",
    r"python -m benchmarks\.learning\.bound": "swim --starts 1 --seeds 1 --budget 2",
}
"""Options that make commands short, after those of the page."""

SLOW = (
    "python -m benchmarks",
    "python -m fish_env compile",
    "fish_env compile",
    "fish_env compare",
    "fish_env train .*--integrator",
    "fish_env train .*--body tetrahedral",
    "fish_env evaluate .*--body two_layer",
    r"fish_env report runs/(swim|all)/",
)
"""How commands begin that take long even so."""

MINE = """
import gymnasium as gym
import fish_env

gym.register("Mine-v0", entry_point="fish_env.envs:FishEnv", vector_entry_point="fish_env.envs:FishVectorEnv",
             max_episode_steps=250, kwargs={"task": "turn", "body": fish_env.make_fish(length=0.3)})
"""


class Command(NamedTuple):
    """A command of a page."""

    page: str
    line: int
    text: str

    def __str__(self):
        return f"{self.page}:{self.line}: {self.text}"

    def matches(self, patterns) -> list[str]:
        """Those of the patterns that the command begins with."""
        return [pattern for pattern in patterns if re.match(pattern, self.text)]


def commands_of(path: Path) -> list[Command]:
    """The commands of a page, from its top, without comments and the variables before them."""
    page, text = path.relative_to(ROOT).as_posix(), path.read_text()
    found = [
        (block.line + number, command)
        for block in blocks(path, "sh")
        for number, line in enumerate(block.text.splitlines())
        for command in re.split(r"\s&&\s", re.sub(r"\s#\s.*", "", line))
    ]
    prose = FENCE.sub(lambda match: "\n" * match[0].count("\n"), text)
    for span in re.finditer(rf"(?<!`)`((?:[A-Z_]+=\S+ )*(?:{PROGRAMS}) [^`\n]+)`(?!`)", prose):
        found.append((prose.count("\n", 0, span.start()) + 1, span[1]))
    return [
        Command(page, line, re.sub(r"^([A-Z_]+=\S+ )*", "", text.strip()))
        for line, text in sorted(found, key=itemgetter(0))
    ]


COMMANDS = {path.relative_to(ROOT).as_posix(): commands_of(path) for path in HERE}
ALL = [command for of_page in COMMANDS.values() for command in of_page]


def test_every_command_is_known():
    """Blocks name their language, shell blocks hold commands, and no entry of the tables has lost its command."""
    for block in (block for path in HERE for block in blocks(path)):
        assert block.language, f"{block} names no language; commands are sh"
        if block.language != "sh":
            assert not re.search(r"^\$? ?(fish_env|pip|python|pytest|docker) \S", block.text, re.MULTILINE), block
    assert len(ALL) > 80
    for command in ALL:
        assert re.match(rf"(?:{PROGRAMS})\b", command.text), f"{command}: how is it checked?"
        assert len(command.matches(NOT_RUN)) < 2, command
    for pattern in (*NOT_RUN, *SHORT, *SLOW):
        assert any(command.matches([pattern]) for command in ALL), f"no page has a command {pattern}"


@pytest.mark.parametrize("command", [command for command in ALL if command.text.startswith("pip ")], ids=str)
def test_what_pip_installs(command):
    """The extras exist, and so do the constraints and the folder."""
    declared = (ROOT / "pyproject.toml").read_text().split("[project.optional-dependencies]")[1].split("\n[")[0]
    for extra in re.findall(r"(?:\.|fish_env)\[(\w+)\]", command.text):
        assert re.search(rf"^{extra} = ", declared, re.MULTILINE), f"there is no extra {extra!r}"
    for name in re.findall(r'-[ce] "?([\w./]+)', command.text):
        assert (ROOT / name).exists(), name


# Running them


@pytest.fixture
def reader(trained, tmp_path, monkeypatch):
    """The folder of a reader with earlier runs, a policy and a module of theirs; what is registered is forgotten."""
    for run in ("runs/swim/2026-11-26", "runs/all/turn/0", "runs/all/turn/1"):
        shutil.copytree(trained, tmp_path / run)
    (tmp_path / "my").mkdir()
    shutil.copy(shipped_policy("turn"), tmp_path / "my" / "policy.npz")
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(ROOT / "examples/register_elsewhere/src"), *sys.path])
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    before = [(table, set(table)) for table in (gym.registry, fish_env.TASKS)]
    yield tmp_path
    for table, names in before:
        for name in set(table) - names:
            del table[name]
    for name in [name for name in sys.modules if re.match(r"mine$|swim_elsewhere", name)]:
        del sys.modules[name]


def typed(command: Command) -> list[str]:
    """The words of a command, with what a reader puts in for <...> and the shell for *, and made short."""
    words = []
    for word in shlex.split(command.text):
        word = re.sub("<policy>", "swim", word)
        if "<time>" in word:  # the latest run of this task
            found = sorted(Path().glob(word.replace("<time>", "*")), key=lambda path: path.stat().st_mtime)
            assert found, f"{command}: there is no such run"
            words.append(str(found[-1]))
        else:
            words += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return [*words, *(more for pattern in command.matches(SHORT) for more in SHORT[pattern].split())]


def look_and_leave(laboratory):
    """What a reader does who opens the laboratory: the page, and its first picture."""
    from test_lab_server import ask, enter, get

    try:
        assert get(laboratory)[0] == 200
        with enter(laboratory) as page:
            assert isinstance(ask(page, {"do": "frame"})[-1], bytes)
    finally:
        laboratory.close()


def run(command: Command, monkeypatch):
    """Run a command, here if it can be: it must end well."""
    program, *words = typed(command)
    if words[0] == "-m" and words[1].startswith("benchmarks"):  # they write into their checkout
        checkout = Path("checkout")
        if not checkout.exists():
            shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(".git", "runs", "site", "__pycache__"))
        variables = os.environ | {"PYTHONPATH": str(checkout.resolve())}
        subprocess.run([sys.executable, *words], cwd=checkout, env=variables, check=True)
        return
    if words[:2] == ["-m", "fish_env"]:
        program, words = "fish_env", words[2:]
    with monkeypatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path])
        if program == "fish_env":
            if words[0] == "lab":
                pytest.importorskip("websockets")
                patch.setattr("fish_env.lab.server.Laboratory.wait", look_and_leave)
            status = command_line.main(words)
        elif words[0] == "train.py":
            patch.setattr(sys, "argv", words)
            status = importlib.import_module("train").main()
        else:
            patch.setattr(sys, "argv", [str(ROOT / words[0]), *words[1:]])
            sys.path.insert(0, str((ROOT / words[0]).parent))
            status = runpy.run_path(sys.argv[0], run_name="__main__") and 0
    assert status == 0, command


def runs_of(page: str, slow: bool) -> list[Command]:
    """The commands of a page that are run, each once."""
    found = {command.text: command for command in reversed(COMMANDS[page]) if not command.matches(NOT_RUN)}
    return [command for command in reversed(found.values()) if slow or not command.matches(SLOW)]


@pytest.mark.parametrize(
    ("page", "slow"),
    [
        pytest.param(page, slow, marks=[pytest.mark.slow] * slow, id=page + ", slow ones too" * slow)
        for page in COMMANDS
        for slow in (False, True)
        if len(runs_of(page, slow)) > (len(runs_of(page, False)) if slow else 0)
    ],
)
def test_commands_of_a_page(page, slow, reader, monkeypatch):
    """They run in their order, and each ends with exit status 0."""
    for module in ("stable_baselines3", "tensorboard", "moviepy"):
        pytest.importorskip(module)
    for command in runs_of(page, slow):
        run(command, monkeypatch)
