"""What the pages in docs/ say is what the code does: their examples run, their tables and numbers agree."""

import ast
import inspect
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import fish_env
from fish_env.body import FAILURES
from fish_env.envs import FishVectorEnv, episode, observation
from fish_env.tasks import swim

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
SWIM = (ROOT / "docs/envs/swim.md").read_text()


def blocks(page):
    """The Python blocks of a page under docs/."""
    return re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.DOTALL | re.MULTILINE)


def rows(heading, table=0):
    """Cells of a table of swim.md, the table-th under this second-level heading."""
    section = SWIM.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    tables = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    lines = tables[table].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def number(pattern):
    """The number that this pattern finds in swim.md, where it must stand exactly once."""
    found = re.findall(pattern, SWIM)
    assert len(found) == 1, pattern
    return float(found[0])


# Examples


def test_extending_runs(tmp_path):
    """The blocks of extending.md, one after the other in a process of their own, with the assertions they hold."""
    script = tmp_path / "extending.py"
    script.write_text("\n\n".join(blocks("extending.md")))
    found = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, script], env=found, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_swim_examples_run():
    """The blocks of swim.md."""
    scope = {}
    for block in blocks("envs/swim.md"):
        exec(block, scope)
    assert scope["envs"].num_envs == 256
    assert scope["env"].action_space.shape == (6,)


def test_stub_example_passes():
    """The test that stub.md shows."""
    scope = {}
    exec(blocks("envs/stub.md")[0], scope)
    scope["test_my_wrapper"]()


# Links, names and equation numbers


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    """Every relative link and picture of a page exists."""
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_design_names_what_exists():
    """Every file and folder in the layout of design.md exists."""
    layout = (ROOT / "docs/design.md").read_text().split("```")[1]
    names = re.findall(r"[\w/.-]+\.(?:py|json|md|toml|txt)\b|\w+/", layout)
    assert len(names) > 30
    for name in names:
        assert any(ROOT.rglob(name.rstrip("/"))), name


def test_equations():
    """physics.md numbers its equations from 1 on, without gaps, each once, and the code refers to no other."""
    tags = [int(tag) for tag in re.findall(r"\\tag\{(\d+)\}", (ROOT / "docs/physics.md").read_text())]
    assert sorted(tags) == list(range(1, len(tags) + 1))
    for folder in ("fish_env", "agents", "benchmarks"):
        for path in (ROOT / folder).rglob("*.py"):
            for comment in re.findall(r"  # ((?:\(\d+\)(?:, )?)+)", path.read_text()):
                assert set(map(int, re.findall(r"\d+", comment))) <= set(tags), f"{path}: {comment}"


def test_methods_table():
    """The table of methods in physics.md is that of INTEGRATORS."""
    section = (ROOT / "docs/physics.md").read_text().split("\n## Methods\n")[1].split("\n## ")[0]
    stated = [[cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\| `.*$", section, re.M)]
    for record in fish_env.INTEGRATORS.values():
        cost = f"{record.forces}, {record.factorisations}, {record.solves}" if record.forces else "counted as they come"
        assert [f"`{record.name}`", str(record.order), record.kind, cost] in stated
    assert len(stated) == len(fish_env.INTEGRATORS)


# swim.md


def test_observation_table():
    """The table of observations is that of `observation.table`, element by element."""
    env = FishVectorEnv(1)
    wanted = observation.table(env.tank.fish, env.task)
    stated = {}
    for index, name, unit, low, high in rows("Observation Space"):
        assert float(low) == -float(high)
        for i in range(23) if "i" in index else [None]:
            place = eval(index.replace("3i", f"3 * {i}"))
            assert place not in stated
            stated[place] = (name.replace("node i", f"node {i}"), unit, float(high))
    assert [stated[place] for place in range(len(stated))] == wanted
    assert env.single_observation_space.shape == (number(r"`Box\(\((\d+),\), float32\)`"),)


def test_action_tables():
    """The tables of actions name each muscle's segment, side, nodes and group."""
    fish = fish_env.make_fish()
    groups = fish.grouping("pairs")
    stated = rows("Action Space")
    assert [int(row[0]) for row in stated] == list(range(fish.num_muscles))
    for muscle, (_, name, nodes, *_) in enumerate(stated):
        i, j = fish.body.springs.nodes[fish.muscles[muscle]]
        height = "upper" if fish.body.position[i, 2] > 0 else "lower"
        side = "left" if fish.sides[muscle] > 0 else "right"
        assert (name, nodes) == (f"segment {fish.segments[muscle]}, {height} {side}", f"{i}-{j}")
    paired = rows("Action Space", 1)
    assert len(paired) == FishVectorEnv(1, muscle_groups="pairs").single_action_space.shape[0]
    for group, (index, name, muscles, *_) in enumerate(paired):
        members = np.flatnonzero(groups == group)
        side = "left" if fish.sides[members[0]] > 0 else "right"
        assert (int(index), name) == (group, f"segment {fish.segments[members[0]]}, {side}")
        assert muscles == ", ".join(map(str, members))


def test_times():
    """Step, control interval and length of an episode."""
    env = FishVectorEnv(1)
    steps = gym.spec("FishEnv/Swim-v0").max_episode_steps
    assert number(r"one control interval of ([\d.]+) s") == env.control_interval
    assert number(r"s, (\d+) integrator steps") == env._substeps
    assert number(r"integrator steps of ([\d.]+) s\.") == pytest.approx(env.tank.dt, rel=1e-5)
    assert number(r"after (\d+) steps") == steps
    assert number(r"after \d+ steps, ([\d.]+) s\.") == pytest.approx(steps * env.control_interval)


def test_rewards_and_start():
    """Weights of the reward and widths of the starting state."""
    env = FishVectorEnv(1)
    assert number(r"\*effort\*: \$`-([\d.]+)") == swim.EFFORT_WEIGHT
    assert number(r"\*failure\*: -(\d+) ") == episode.FAILURE_PENALTY
    assert number(r"standard deviation of ([\d.]+) body lengths/s") == swim.START_NOISE
    assert number(r"by at most\s+([\d.]+) rad") == env.task.heading_error


def test_arguments():
    """Every keyword of the environment and of the task, with its default; times and water as the fish has them."""
    stated = {name.strip("`"): (default.strip("`"), meaning) for name, default, meaning in rows("Arguments")}
    keywords = dict(list(inspect.signature(FishVectorEnv).parameters.items())[:-1])
    keywords |= dict(list(inspect.signature(episode.Episodes).parameters.items())[:-1])
    keywords |= inspect.signature(swim.SwimTask).parameters
    assert set(stated) == set(keywords)
    for name, parameter in keywords.items():
        wanted = parameter.default
        if name == "max_episode_steps":
            wanted = gym.spec("FishEnv/Swim-v0").max_episode_steps
        assert ast.literal_eval(stated[name][0]) == getattr(wanted, "value", wanted), name
    env = FishVectorEnv(1)
    assert stated["dt"][1].endswith(f"own, {env.tank.dt:g}")
    assert f'own, `"{env.tank.integrator.name}"`' in stated["integrator"][1]
    assert stated["control_interval"][1].endswith(f"own, {env.control_interval:g}")
    coefficient = fish_env.make_fish().water.quadratic / 500.0
    assert f"still water, 1000 kg/m³, drag coefficient {coefficient:.4g}, quadratic law" in SWIM


def test_reset_options_and_failures():
    """Keys of `reset(options=...)` with their meaning, and every reason for a failure."""
    stated = {name.strip('`"'): meaning for name, meaning in rows("Starting State")}
    assert stated == swim.SwimTask.reset_options
    for reason in FAILURES[1:]:
        assert f"- `{reason}`" in SWIM


@pytest.mark.parametrize("single", [False, True])
def test_info_keys(single):
    """`info` has the keys the page lists: those of the step, and at the end of an episode those of the episode."""
    listed = [{row[0].strip("`") for row in rows("Info", table)} for table in (0, 1)]
    make = gym.make if single else partial(gym.make_vec, num_envs=2)
    env = make("FishEnv/Swim-v0", info_every_step=True)
    env.reset(seed=0)
    steps = gym.spec("FishEnv/Swim-v0").max_episode_steps
    infos = [env.step(env.action_space.sample())[4] for _ in range(steps)]
    keys = [{key for key in info if not key.startswith("_")} for info in infos]
    assert all(key == listed[1] for key in keys[:-1])
    assert keys[-1] == listed[1] | listed[0] - {"failure"}
    terms = {key for key in infos[-1]["terms"] if not key.startswith("_")}
    assert terms == set(re.findall(r"`(\w+)`", rows("Info")[0][1]))
