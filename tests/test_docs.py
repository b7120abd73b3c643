"""What the pages in docs/ say is what the code does: their examples run, their tables and numbers agree."""

import inspect
import os
import re
import subprocess
import sys
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from pages import ROOT, blocks

import fish_env
from fish_env.envs import VARIATIONS, FishVectorEnv, episode
from fish_env.physics.failures import FAILURES
from fish_env.tasks import TASKS, avoid, fast_start, start, target, turns
from fish_env.tasks.options import keywords_of

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
FORMS = [*((task, {}) for task in TASKS), ("swim", {"speed": 1.0}), ("target", {"dimensions": 3})]
FIRST = 153  # elements of the observation before the task's own, for which all pages refer to swim.md
SHARED_WEIGHTS = {"effort_weight", "failure_penalty"}  # of the reward of every task, on swim.md too

every_task = pytest.mark.parametrize("task", TASKS)
every_form = pytest.mark.parametrize(("task", "keywords"), FORMS)


@cache
def page(name):
    """Text of a page under docs/: of a task, if it is given by its key."""
    return (ROOT / "docs" / (f"envs/{name}.md" if name in TASKS else name)).read_text()


def section(name, heading):
    """What stands under a second-level heading of a page."""
    parts = page(name).split(f"\n## {heading}\n")
    assert len(parts) == 2, f"{name} has no section {heading!r}, or more than one"
    return parts[1].split("\n## ")[0]


def rows(name, heading, table=0):
    """Cells of a table of a page, the table-th under this second-level heading."""
    tables = re.findall(r"(?:^\|.*\n)+", section(name, heading), re.MULTILINE)
    lines = tables[table].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def number(name, pattern):
    """The number that this pattern finds on a page; it may stand there more than once, but only with one value."""
    found = set(re.findall(pattern, page(name)))
    assert len(found) == 1, f"{name}: {pattern} finds {found or 'nothing'}"
    return float(found.pop())


def spelled(value):
    """A bound as the pages write it: "π/18", "-π", "0.1"."""
    part = Fraction(value / np.pi).limit_denominator(36)
    if value == 0 or abs(part * np.pi - value) > 1e-12:
        return f"{value:g}"
    over = "" if part.denominator == 1 else f"/{part.denominator}"
    return f"{part.numerator}π{over}".replace("1π", "π")


def span(option):
    """The range of an `Option` as the pages write it: "-π to π"."""
    return f"{spelled(option.low)} to {spelled(option.high)}"


def applies(meaning, keywords):
    """Whether a row holds for an environment with these keywords: it may say "only with `speed`"."""
    only = re.search(r"only with `(\w+)", meaning)
    return only is None or only[1] in keywords


def modules(task):
    """The modules that the class of a task and its bases are in."""
    return [sys.modules[cls.__module__] for cls in TASKS[task].__mro__ if cls is not object]


# Links, names and equation numbers


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path):
    """Every relative link and picture of a page exists, and the heading it leads to."""
    for link, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", path.read_text()):
        if "://" not in link:
            assert (path.parent / link).exists(), link
            assert not anchor or anchor in anchors((path.parent / link if link else path).read_text()), anchor


def anchors(text):
    """The names that the headings of a page have as the end of a link."""
    return {
        re.sub(r"[^\w\s-]", "", line).strip().lower().replace(" ", "-") for line in re.findall(r"^#+ (.*)$", text, re.M)
    }


def test_design_names_what_exists():
    """The ladder of design.md is that of the import contract, and every file that the page names exists."""
    page = (ROOT / "docs/design.md").read_text()
    rooms = re.findall(r"^  (\w+) ", page.split("```")[1], re.MULTILINE)
    contract = re.search(r"layers = \[(\"__main__\".*)\]", (ROOT / "pyproject.toml").read_text())
    assert contract and rooms == re.findall(r"\w+", contract[1])
    names = set(re.findall(r"`([\w/]+\.py)`", page))
    assert len(names) > 30
    for name in names:
        assert any(path.as_posix().endswith(f"/{name}") for path in ROOT.rglob(Path(name).name)), name


STEP = """
import sys
from fish_env.envs import FishVectorEnv

env, seen = FishVectorEnv(1, task="swim", body="mass_spring", threads=1), []
env.reset(seed=0)


def enter(frame, event, argument):
    file = frame.f_code.co_filename.partition("fish_env/")[2]
    if event == "call" and frame.f_code.co_name != "sort" and file and file not in seen:  # that puts fish in order only
        seen.append(file)


sys.setprofile(enter)
env.step(env.action_space.sample())
sys.setprofile(None)
print(*seen)
"""


def test_the_files_that_a_step_enters():
    """The table of design.md names files that a step enters, in the order in which it does."""
    table = (ROOT / "docs/design.md").read_text().split("| File | What happens there |")[1].split("\n\n")[0]
    named = re.findall(r"^\| `(.*?)` \|", table, re.MULTILINE)
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", STEP], env=environment, capture_output=True, text=True, check=True)
    entered = [file for file in done.stdout.split() if file in named]
    assert entered == named and len(named) > 8


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
    stated = rows("physics.md", "Methods")
    for record in fish_env.INTEGRATORS.values():
        cost = f"{record.forces}, {record.factorisations}, {record.solves}" if record.forces else "counted as they come"
        assert [f"`{record.name}`", str(record.order), record.kind, cost] in stated
    assert len(stated) == len(fish_env.INTEGRATORS)


# Pages of the tasks


@every_task
def test_page_begins_with_its_picture(task):
    """The first thing on a page is a picture of the task, not too large to load at once."""
    lines = page(task).splitlines()
    assert lines[0].startswith("# ")
    assert re.fullmatch(rf"!\[.+\]\(\.\./images/gallery/env_{task}\.webp\)", lines[2])
    assert (ROOT / f"docs/images/gallery/env_{task}.webp").stat().st_size < 600_000


@every_task
def test_page_examples_run(task):
    """The first block of a page makes the task's environments, one and many."""
    scope = {}
    exec(blocks(ROOT / f"docs/envs/{task}.md", "python")[0].text, scope)
    assert scope["envs"].num_envs == 256
    assert scope["envs"].spec.id == scope["env"].spec.id == env_id(task)


def env_id(task):
    """The id that a task is registered under, which its page must name."""
    found = {spec.kwargs["task"]: name for name, spec in gym.registry.items() if re.match(r"FishEnv/(?!Stub)", name)}
    assert f'"{found[task]}"' in page(task)
    return found[task]


def described(layout):
    """The rows of a table of an observation."""
    return [
        [f"`{part.name}`", f"{part.start} to {part.slice.stop - 1}", f"`{part.shape}`", part.unit, f"±{part.limit:g}"]
        for part in layout
    ]


@every_form
def test_observation_table(task, keywords):
    """The table of the observation is the layout: part, place, shape and range; from FIRST on beside swim.md."""
    env = FishVectorEnv(1, task=task, **keywords)
    wanted, of_swim = described(env.layout), described(FishVectorEnv(1).layout)
    if task != "swim" and wanted == of_swim:
        assert ", as for [Swim](swim.md#observation-space)." in page(task)
    else:
        first = 0 if wanted == of_swim else env.layout.parts.index(env.layout["vertical"]) + 1
        assert rows(task, "Observation Space", 1 if "speed" in keywords else 0) == wanted[first:]
        assert task == "swim" or f"Elements 0 to {FIRST - 1} are those of [Swim]" in page(task)
    assert env.single_observation_space.shape == (number(task, r"`Box\(\((\d+),\), float32\)`"),)
    assert env.layout["vertical"].slice.stop == FIRST


def test_table_of_sensors():
    """The table of sensors is the layout's."""
    wanted = described(FishVectorEnv(1, observation="sensors").layout)
    assert [row[:5] for row in rows("envs/sensing.md", "Sensors")] == wanted


def test_action_tables():
    """The tables of actions name each muscle's segment, side, height and nodes, and each pair's muscles."""
    fish = fish_env.make_fish()
    nodes, x = fish.body.springs.nodes[fish.muscles], fish.body.position
    sides = ["left" if side > 0 else "right" for side in fish.sides]
    heights = ["Upper" if x[i, 2] > 0 else "Lower" for i, _ in nodes]
    columns = ["Upper left", "Upper right", "Lower right", "Lower left"]
    wanted = [[str(segment), *[""] * 4] for segment in range(3)]
    for muscle, (i, j) in enumerate(nodes):
        column = columns.index(f"{heights[muscle]} {sides[muscle]}")
        wanted[fish.segments[muscle]][1 + column] = f"{muscle} ({i}-{j})"
    assert rows("swim", "Action Space") == wanted and f"| Segment | {' | '.join(columns)} |" in page("swim")
    groups = fish.grouping("pairs")
    pairs = [[str(segment), "", ""] for segment in range(3)]
    for group in range(FishVectorEnv(1, muscle_groups="pairs").single_action_space.shape[0]):
        members = np.flatnonzero(groups == group)
        place = 1 + ["left", "right"].index(sides[members[0]])
        pairs[fish.segments[members[0]]][place] = f"{group} ({', '.join(map(str, members))})"
    assert rows("swim", "Action Space", 1) == pairs


@every_task
def test_times(task):
    """Length of an episode, and on swim.md the step and the control interval, which all tasks share."""
    env = FishVectorEnv(1, task=task)
    steps = gym.spec(env_id(task)).max_episode_steps
    assert number(task, r"after (\d+) steps") == steps
    assert number(task, r"after \d+ steps, ([\d.]+) s\.") == pytest.approx(steps * env.control_interval)
    assert number("swim", r"one control interval of ([\d.]+) s") == env.control_interval
    assert number("swim", r"s, (\d+) integrator steps") == env._substeps
    assert number("swim", r"integrator steps of ([\d.]+) s\.") == pytest.approx(env.tank.dt, rel=1e-5)


@every_task
def test_rewards(task):
    """The terms of the reward in their order, and the weight of each; what all tasks have, on swim.md."""
    stated = [(term.strip("`"), weight.strip("`")) for term, weight, _ in rows(task, "Rewards")]
    names, weights = [*TASKS[task].term_names, "failure"], {"1", *TASKS[task].weights, "failure_penalty"}
    if task != "swim":
        assert "`effort` and `failure` are as for [Swim](swim.md#rewards)" in page(task)
        names, weights = [name for name in names if name not in ("effort", "failure")], weights - SHARED_WEIGHTS
    assert [term for term, _ in stated] == names
    assert {weight for _, weight in stated} == weights
    for term, weight in stated:
        assert weight == "1" if term == "progress" else term.startswith(weight.split("_")[0])


FACTS = [
    ("swim", r"standard deviation of ([\d.]+) body lengths/s", start.NOISE),
    ("swim", r"by at most\s+([\d.]+) rad", TASKS["swim"]().heading_error),
    *((name, r"(\d+) % (?:of|was)", 100 * turns.COMPLETE) for name in ("turn", "left_after_right")),
    ("turn", r"averaged twice over ([\d.]+) s", turns.MEAN_TIME),
    ("turn", r"(\d+) degrees \|", np.degrees(turns.SETTLED)),
    ("physics.md", r"mean heading over the last ([\d.]+) s", turns.MEAN_TIME),
    ("left_after_right", r"at the latest after (\d+) s", turns.PATIENCE),
    ("target", r"(\d+) targets are drawn", target.DRAWN),
    ("avoid", r"a fish at (\d+) body lengths per second", avoid.CRUISE),
    ("fast_start", r"whether ([\d.]+) body lengths were made good", fast_start.AWAY),
    ("fast_start", r"heading within ([\d.]+) s of the command", fast_start.IN_TIME),
    ("fast_start", r"within ([\d.]+) s of the command, m", fast_start.START),
    ("fast_start", r"averaged over (\d+) ms", 1000 * fast_start.OVER),
]


@pytest.mark.parametrize(("name", "pattern", "value"), FACTS, ids=lambda part: str(part)[:40])
def test_facts(name, pattern, value):
    """Numbers in the text that are constants of the code."""
    assert number(name, pattern) == pytest.approx(value)


def test_turn_before_the_obstacle():
    """Avoid: how long before the obstacle a turn is commanded."""
    env = FishVectorEnv(500, task="avoid", turning=1.0)
    env.reset(seed=0)
    lead = env.task._appears - env.task.course.wait[:, 0]
    low, high = map(float, re.search(r"commanded ([\d.]+) to ([\d.]+) s before", page("avoid")).groups())
    assert low <= lead.min() < low + 0.01 and high - 0.01 < lead.max() <= high


@every_task
def test_arguments(task):
    """Every keyword of the task, with its default and range; on swim.md those of the environment and of all tasks."""
    stated = {name.strip("`"): (default.strip("`"), meaning) for name, default, meaning in rows(task, "Arguments")}
    shared = dict(list(inspect.signature(FishVectorEnv).parameters.items())[:-1])
    shared |= dict(list(inspect.signature(episode.Episodes).parameters.items())[:-1])
    own = keywords_of(TASKS[task])
    wanted = {name: parameter.default for name, parameter in shared.items()} | own
    wanted |= {"task": task, "max_episode_steps": gym.spec(env_id(task)).max_episode_steps}
    if task != "swim":
        assert "Those of [Swim](swim.md#arguments) without `heading_error` and `speed`, and:" in page(task)
        assert TASKS[task].weights["effort_weight"] == TASKS["swim"].weights["effort_weight"]
        wanted = {name: wanted[name] for name in own if name not in SHARED_WEIGHTS}
    assert set(stated) == set(wanted)
    for name, default in wanted.items():
        assert eval(stated[name][0], {"np": np}) == getattr(default, "value", default), name
    for name in set(own) & set(stated) - {"dimensions", "reversals", "goal_env"}:  # whose meaning lists what is allowed
        option = TASKS[task].weights.get(name) or vars(modules(task)[0]).get(name.upper(), avoid.CHANCE)
        assert re.search(rf"(?<![\d.]){re.escape(span(option))}(?!\.?\d)", stated[name][1]), f"{name}: {span(option)}"


def test_times_and_water_of_the_fish():
    """What swim.md says that the fish has of its own, in the meaning of the arguments."""
    stated = {name.strip("`"): meaning for name, _, meaning in rows("swim", "Arguments")}
    env = FishVectorEnv(1)
    assert stated["dt"].endswith(f"own, {env.tank.dt:g}")
    assert f'own, `"{env.tank.integrator.name}"`' in stated["integrator"]
    assert stated["control_interval"].endswith(f"own, {env.control_interval:g}")
    coefficient = fish_env.make_fish().water.quadratic / 500.0
    assert f"still water, 1000 kg/m³, drag coefficient {coefficient:.4g}, quadratic law" in page("swim")


@every_form
def test_reset_options(task, keywords):
    """Keys of `reset(options=...)` beside those that stand on swim.md, in order, with their range and meaning."""
    shared = {*VARIATIONS} if task == "swim" else {*VARIATIONS, *FishVectorEnv(1, task="swim").task.reset_options}
    options = FishVectorEnv(1, task=task, **keywords).task.reset_options
    check_options(
        {key: option for key, option in options.items() if key not in shared},
        [row for row in rows(task, "Starting State") if applies(row[2], keywords)],
    )
    assert task == "swim" or "beside those of [Swim](swim.md#starting-state)" in page(task)


def test_variations():
    """What may vary in every task, in order, with its range and meaning."""
    check_options(VARIATIONS, rows("swim", "Starting State", 1))


def check_options(options, stated):
    """Rows of a page are options, in their order, with their range; a row may say more than the option's text."""
    assert [key.strip('`"') for key, *_ in stated] == list(options)
    for (key, between, meaning), option in zip(stated, options.values(), strict=True):
        assert between == span(option), f"{key} is from {span(option)}"
        assert option.text in meaning, f"{key}: {option.text!r}"


@every_task
def test_failures(task):
    """Every reason for a failure is listed on swim.md, and the other pages lead there."""
    if task == "swim":
        assert re.findall(r"^  - `(.*)`$", section(task, "Episode End"), re.MULTILINE) == list(FAILURES[1:])
    else:
        assert "the reasons [listed for Swim](swim.md#episode-end)" in section(task, "Episode End")


@every_form
@pytest.mark.parametrize("single", [False, True])
def test_info_keys(task, keywords, single):
    """With `info_every_step`, the last `info` has the keys the page lists, of the step and of the episode.

    Those before it lack numbers that do not exist yet, and no others.
    """
    stated = [row for row in rows(task, "Info") if applies(row[1], keywords)]
    more = rows("turn", "Info") if "The other keys are those of [Turn](turn.md#info)" in page(task) else []
    shared = re.search(r"^(.*) are in the `info` of every task", section("swim", "Info"), re.MULTILINE)
    assert shared and (task == "swim" or more or "beside the keys [of every task](swim.md#info)" in page(task))
    of_every_task = set(re.findall(r"`(\w+)`", shared[1]))
    assert of_every_task <= {key.strip("`") for key, _ in rows("swim", "Info")}
    of_episode = {key.strip("`") for key, _ in [*stated, *more]} | of_every_task
    keys_of_step = {key.strip("`") for key, _ in rows("swim", "Info", 1)} - {"term_<name>"}
    make = gym.make if single else partial(gym.make_vec, num_envs=2)
    env = make(env_id(task), info_every_step=True, **keywords)
    over, infos = False, [env.reset(seed=0)[1]]
    while not over:
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        infos.append(info)
        over = np.any(terminated) or np.any(truncated)
    terms = set(re.findall(r"`(\w+)`", stated[0][1]))
    wanted = keys_of_step | of_episode | {f"term_{name}" for name in terms}
    assert {key for key in infos[-1] if not key.startswith("_")} == wanted
    for info in infos:
        missing = wanted - info.keys()
        assert {key for key in info if not key.startswith("_")} == wanted - missing
        assert all(np.asarray(infos[-1][key]).dtype == np.float64 for key in missing)
    assert {key for key in infos[-1]["terms"] if not key.startswith("_")} == terms
