"""What the pages say is what the code does: their tables and numbers agree, their commands run, their site is built.

Commands are those of shell blocks, and those within the text. A page is read from its top: its commands run in order,
in one folder, as a reader types them. They are only made short, by options of `SHORT` after those of the page. What
cannot run here stands in `NOT_RUN` by its reason. Slow commands, and the whole page that they are on, are run by
`pytest -m slow`. `test_blocks.py` runs the other blocks.
"""

import importlib
import inspect
import logging
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from fractions import Fraction
from functools import cache, partial
from operator import itemgetter
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from pages import FENCE, PAGES, ROOT, blocks

import fish_env
from fish_env import __main__ as command_line
from fish_env.control.policy import shipped_policy
from fish_env.envs import VARIATIONS, FishVectorEnv, episode
from fish_env.envs.step import FAILURE_PENALTY
from fish_env.physics.failures import FAILURES
from fish_env.tasks import TASKS, avoid, fast_start, start, target, turns
from fish_env.tasks.options import keywords_of

FORMS = [*((task, {}) for task in TASKS), ("swim", {"speed": 1.0}), ("target", {"dimensions": 3})]
OVERVIEW = "envs/index.md"  # what is common to all tasks
NUMBERED = ("physics.md", "physics-more.md")  # pages whose equations have numbers, in the order of these
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


def entries(name, heading):
    """What precedes and what follows the colon in each item of the lists under a second-level heading."""
    return re.findall(r"^- (.+?): (.+)$", section(name, heading), re.MULTILINE)


def names_in(text):
    """The names in code, of keywords or of keys, that stand in a text, without those of links."""
    return re.findall(r'`"?([\w<>]+)"?`', text)


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


@pytest.mark.parametrize("path", sorted({*PAGES, *ROOT.glob("*.md")}), ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path):
    """Every relative link and picture of a page exists, and the heading it leads to."""
    for link, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", path.read_text()):
        if "://" not in link:
            assert (path.parent / link).exists(), link
            assert not anchor or anchor in anchors((path.parent / link if link else path).read_text()), anchor


def anchors(text):
    """The names that the headings and the equations of a page have as the end of a link."""
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    names = {re.sub(r"[^\w\s-]", "", line).strip().lower().replace(" ", "-") for line in headings}
    return names | {f"eq-{number}" for number in equations(text)}


def equations(text):
    """The numbers of the equations of a page, in their order."""
    return [int(tag) for tag in re.findall(r"\\tag\{(\d+)\}", text)]


def test_design_names_what_exists():
    """The layers of design.md are those of the import contract, and every file that the page names exists."""
    page = (ROOT / "docs/design.md").read_text()
    layers = re.findall(r"^  (\w+) ", page.split("```")[1], re.MULTILINE)
    contract = re.search(r"layers = \[(\"__main__\".*)\]", (ROOT / "pyproject.toml").read_text())
    assert contract and layers == re.findall(r"\w+", contract[1])
    names = set(re.findall(r"`([\w/]+\.py)`", page))
    assert len(names) > 30
    for name in names:
        assert any(path.as_posix().endswith(f"/{name}") for path in ROOT.rglob(Path(name).name)), name


def test_equations():
    """Equations count from 1 on through both pages; the code cites only these, and names the page that has them."""
    tags = {name: equations(page(name)) for name in NUMBERED}
    everywhere, cited = [tag for name in NUMBERED for tag in tags[name]], set()
    assert everywhere == list(range(1, len(everywhere) + 1))
    for folder in ("fish_env", "agents", "benchmarks", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text()
            found = [(comment, everywhere) for comment in re.findall(r"  # ((?:\(\d+\)(?:, )?)+)$", text, re.MULTILINE)]
            named = re.findall(r"docs/(physics[\w-]*\.md), eq\. ([\d-]+)", text)
            for citation, allowed in [*found, *((several, tags[name]) for name, several in named)]:
                numbers = set(map(int, re.findall(r"\d+", citation)))
                assert numbers <= set(allowed), f"{path}: {citation}"
                cited |= numbers
    assert len(cited) > 0.8 * len(everywhere)


def test_pages_cite_equations():
    """Pages cite equations of other pages by links to their anchors, and only those of their own without a link."""
    linked = 0
    for path in PAGES:
        text = path.read_text()
        prose = re.sub(r"\$`.*?`\$", "", FENCE.sub("", text))
        for number, link in re.findall(r"\[(?:eq\. |\()(\d+)\)?\]\(([^)]*)\)", prose):
            assert link.endswith(f"#eq-{number}"), f"{path}: {number} leads to {link}"
        linked += len(re.findall(r"\]\([^)]*#eq-\d+\)", prose))  # with the number, or a word, as their text
        plain = re.sub(r"\[[^\]]*\]\([^)]*\)", "", prose)
        assert not re.search(r"\b[Ee]qs?\. \(?\d", plain), path
        if path.name in NUMBERED:
            assert set(map(int, re.findall(r"(?<!\w)\((\d{1,3})\)", plain))) <= set(equations(text)), path
    assert linked > 20


def test_methods_table():
    """The table of methods is that of INTEGRATORS."""
    stated = rows("api/integrators.md", "Methods")
    for record in fish_env.INTEGRATORS.values():
        cost = f"{record.forces}, {record.factorisations}, {record.solves}" if record.forces else "counted as they come"
        assert [f"`{record.name}`", str(record.order), record.kind, cost] in stated
    assert len(stated) == len(fish_env.INTEGRATORS)


# Pages of the tasks


@every_task
def test_page_of_a_task(task):
    """Its picture, the length of an episode, the terms of the reward with their weights, the threshold, and links.

    The step, the control interval and the reasons for failures are on the overview, which every page links to.
    """
    lines, env = page(task).splitlines(), FishVectorEnv(1, task=task)
    assert lines[0].startswith("# ")
    assert re.fullmatch(rf"!\[.+\]\(\.\./images/gallery/env_{task}\.webp\)", lines[2])
    assert (ROOT / f"docs/images/gallery/env_{task}.webp").stat().st_size < 600_000
    steps = gym.spec(env_id(task)).max_episode_steps
    assert number(task, r"after (\d+) steps") == steps
    assert number(task, r"after \d+ steps, ([\d.]+) s\n") == pytest.approx(steps * env.control_interval)
    assert number(OVERVIEW, r"one control interval of ([\d.]+) s") == env.control_interval
    assert number(OVERVIEW, r"s, (\d+) integrator steps") == env._substeps
    assert number(OVERVIEW, r"integrator steps of ([\d.]+) s\.") == pytest.approx(env.tank.dt, rel=1e-5)
    assert re.findall(r"^- `(.*)`$", section(OVERVIEW, "Reasons of failure"), re.MULTILINE) == list(FAILURES[1:])
    for anchor in ("common-arguments", "variation", "common-info-keys", "reasons-of-failure"):
        assert f"](index.md#{anchor})" in page(task)
    assert not re.search(r"\]\((?:swim|turn|target|avoid)\.md", page(task))  # a page is complete in itself
    stated = [names_in(term) for term, _ in entries(task, "Rewards")]
    assert [term for term, *_ in stated] == [*TASKS[task].term_names, "failure"]
    for term, *weight in stated:
        assert not weight if term == "progress" else term.startswith(weight[0].split("_")[0])
    weights = {name: option.default for name, option in TASKS[task].weights.items()}
    defaults = re.findall(r"`(\w+)` = ([\d.]+)", section(task, "Rewards"))
    assert {name: float(value) for name, value in defaults} == weights | {"failure_penalty": FAILURE_PENALTY}
    assert {span(option) for option in TASKS[task].weights.values()} == {"0 to 1000"}
    assert "keywords, 0 to 1000" in section(task, "Rewards") and "- v0: " in section(task, "Version History")
    threshold = re.search(r"`reward_threshold` is (.*?)\. ", section(task, "Rewards"))
    ids = [spec for spec in gym.registry.values() if spec.kwargs.get("task") == task and spec.reward_threshold]
    assert threshold and list(map(float, re.findall(r"\b\d+\b", threshold[1]))) == [s.reward_threshold for s in ids]


def env_id(task):
    """The id that a task is registered under, which its page must name."""
    found = {spec.kwargs["task"]: name for name, spec in gym.registry.items() if re.match(r"FishEnv/(?!Stub)", name)}
    assert f'"{found[task]}"' in page(task)
    return found[task]


def described(layout):
    """The rows of a table of an observation; that vectors are in the body frame stands above it."""
    units = [re.sub("^$", "unit vector", re.sub("(, )?in the body frame$", "", part.unit)) for part in layout]
    return [
        [f"`{part.name}`", f"{part.start}-{part.slice.stop - 1}, `{part.shape}`", f"{unit}, ±{part.limit:g}"]
        for part, unit in zip(layout, units, strict=True)
    ]


@every_form
def test_observation_table(task, keywords):
    """The table of the observation is the layout: part, place, shape, unit and range; and the rule for node i."""
    env = FishVectorEnv(1, task=task, **keywords)
    wanted = described(env.layout)
    if "speed" in keywords:
        name, _, unit = wanted.pop()
        assert f"{name}, {unit}, takes the place of `commanded heading`" in section(task, "Observation Space")
    assert rows(task, "Observation Space")[: len(wanted)] == wanted
    assert len(rows(task, "Observation Space")) == len(list(env.layout))
    assert env.single_observation_space.shape == (number(task, r"`Box\(\((\d+),\), float32\)`"),)
    meaning = [label for label, *_ in env.layout.table()]
    further = number(task, r"relative to space, is (\d+) further")
    assert "position of node *i*, from the centre of mass, is at $`3i`$ to $`3i+2`$" in page(task)
    for i in range(23):
        assert meaning[3 * i].startswith(f"position of node {i},")
        assert meaning[3 * i + int(further)].startswith(f"velocity of node {i},")
    assert env.tank.fish.nose == number(OVERVIEW, r"form a nose \((\d+)\)")
    assert "a tail fin (tips 21, 22)" in page(OVERVIEW) and list(env.tank.fish.tail) == [21, 22]


def test_sensors_list():
    """The list of sensors is their layout."""
    found = re.findall(r"^- (`[a-z ]+`), (.*?): (.*?); ", section("envs/sensing.md", "Sensors"), re.MULTILINE)
    assert list(map(list, found)) == described(FishVectorEnv(1, observation="sensors").layout)


@every_task
def test_action_list(task):
    """The list of actions names the muscles of every segment in order; the overview has their nodes, and pairs."""
    fish = fish_env.make_fish()
    nodes, x = fish.body.springs.nodes[fish.muscles], fish.body.position
    assert nodes.tolist() == [[k + 1, k + 5] for k in range(len(nodes))]
    assert "Muscle *k* is the spring between nodes $`k+1`$ and $`k+5`$" in section(OVERVIEW, "The fish")
    assert fish.segments.tolist() == [k // 4 for k in range(len(nodes))]
    for first in (0, 4, 8):
        heights = ["upper" if x[i, 2] > 0 else "lower" for i, _ in nodes[first : first + 4]]
        sides = ["left" if side > 0 else "right" for side in fish.sides[first : first + 4]]
        order = ", ".join(f"{height} {side}" for height, side in zip(heights, sides, strict=True))
        said = f"- {first} to {first + 3}: {('front', 'middle', 'rear')[first // 4]} segment"
        said += ", likewise\n" if first else f": {order}\n"
        assert said in section(task, "Action Space")
    left = [2 * segment + (side < 0) for segment, side in zip(fish.segments, fish.sides, strict=True)]
    assert fish.grouping("pairs").tolist() == left
    assert "six actions for left and right of each segment in turn" in page(OVERVIEW)
    assert FishVectorEnv(1, muscle_groups="pairs").single_action_space.shape == (6,)


TURNS = ("turn", "left_after_right", "avoid", "fast_start")
FACTS = [
    (OVERVIEW, r"standard deviation of ([\d.]+) body lengths/s", start.NOISE),
    ("swim", r"by at most\s+([\d.]+) rad", TASKS["swim"]().heading_error),
    *((name, r"(\d+) % of the turn is covered", 100 * turns.COMPLETE) for name in TURNS),
    *((name, r"within (\d+) % of the commanded angle", 100 - 100 * turns.COMPLETE) for name in TURNS),
    *((name, r"(\d+) % of the (?:turn|last) was", 100 * turns.COMPLETE) for name in TURNS[:2]),
    *((name, r"averaged twice over ([\d.]+) s", turns.MEAN_TIME) for name in TURNS[:3]),
    *((name, r"at most (\d+) degrees", np.degrees(turns.SETTLED)) for name in TURNS[:3]),
    *((name, r"mean heading of the last ([\d.]+) s", turns.MEAN_TIME) for name in TURNS[:2]),
    ("physics-more.md", r"mean heading over the last ([\d.]+) s", turns.MEAN_TIME),
    ("left_after_right", r"at the latest after (\d+) s", turns.PATIENCE),
    ("target", r"(\d+) targets are drawn", target.DRAWN),
    ("avoid", r"a fish at (\d+) body lengths per second", avoid.CRUISE),
    ("fast_start", r"([\d.]+) body lengths were covered", fast_start.AWAY),
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


def defaults_in(name, heading):
    """Keywords with their defaults, and what is said of them, in a list under a heading."""
    found = [(names_in(head), re.findall(r"`(\w+)` = `([^`]*)`", head), said) for head, said in entries(name, heading)]
    return {key: (value, said) for _, pairs, said in found for key, value in pairs}


@every_task
def test_arguments(task):
    """Every keyword of the task, with its default and range; and a link to those of all tasks."""
    stated = defaults_in(task, "Arguments")
    own = {name: value for name, value in keywords_of(TASKS[task]).items() if name not in TASKS[task].weights}
    assert set(stated) == set(own)
    for name, default in own.items():
        assert eval(stated[name][0], {"np": np}) == default, name
    for name in set(own) - {"dimensions", "reversals", "goal_env"}:  # whose meaning lists what is allowed
        option = vars(modules(task)[0]).get(name.upper(), avoid.CHANCE)
        assert re.search(rf"(?<![\d.]){re.escape(span(option))}(?!\.?\d)", stated[name][1]), f"{name}: {span(option)}"
    shared = re.search(
        r"^Also the .* \[common arguments\]\(index\.md#common-arguments\), such as `(\w+)`", page(task), re.M
    )
    assert shared and shared[1] in shared_arguments()


def shared_arguments():
    """The keywords of all tasks, with their defaults."""
    shared = dict(list(inspect.signature(FishVectorEnv).parameters.items())[:-1])
    shared |= dict(list(inspect.signature(episode.Episodes).parameters.items())[:-1])
    return {name: each.default for name, each in shared.items() if name != "failure_penalty"}  # a weight


def test_common_arguments():
    """The overview has every keyword of all tasks with its default; two are set by the id."""
    stated, wanted = defaults_in(OVERVIEW, "Common arguments"), shared_arguments()
    of_id = {
        name for head, said in entries(OVERVIEW, "Common arguments") if "by the id" in said for name in names_in(head)
    }
    assert of_id == {"task", "max_episode_steps"}
    assert set(stated) == set(wanted) - of_id
    for name, (default, _) in stated.items():
        assert eval(default) == getattr(wanted[name], "value", wanted[name]), name


def test_times_and_water_of_the_fish():
    """What the overview says that the fish has of its own, in the meaning of the arguments."""
    stated = {name: said for name, (_, said) in defaults_in(OVERVIEW, "Common arguments").items()}
    env = FishVectorEnv(1)
    assert stated["dt"].endswith(f"own, {env.tank.dt:g}")
    assert f'own, `"{env.tank.integrator.name}"`' in stated["integrator"]
    assert stated["control_interval"].endswith(f"own, {env.control_interval:g}")
    coefficient = fish_env.make_fish().water.quadratic / 500.0
    assert f"still water, 1000 kg/m³, drag coefficient {coefficient:.4g}, cross-flow law" in stated["water"]


@every_form
def test_reset_options(task, keywords):
    """Keys of `reset(options=...)`, in order, with their range and meaning, or as the argument of the same name.

    An item may say more than the option's text. What may vary in every task is on the overview.
    """
    options = FishVectorEnv(1, task=task, **keywords).task.reset_options
    own = {key: option for key, option in options.items() if key not in VARIATIONS}
    stated = [item for item in entries(task, "Starting State") if applies(item[1], keywords)]
    arguments = defaults_in(task, "Arguments")
    for items, wanted in ((stated, own), (entries(OVERVIEW, "Variation"), VARIATIONS)):
        assert [key for head, _ in items for key in names_in(head)] == list(wanted)
        for head, meaning in items:
            for key in names_in(head):
                if "as the [argument" in meaning:
                    assert span(wanted[key]) in arguments[key][1]
                else:
                    assert head == f'`"{key}"`, {span(wanted[key])}', f"{key} is from {span(wanted[key])}"
                    assert wanted[key].text in meaning, f"{key}: {wanted[key].text!r}"


@every_form
@pytest.mark.parametrize("single", [False, True])
def test_info_keys(task, keywords, single):
    """With `info_every_step`, the last `info` has the keys the page lists, of the step and of the episode.

    Those before it lack numbers that do not exist yet, and no others.
    """
    own = {key for head, said in entries(task, "Info") if applies(said, keywords) for key in names_in(head)}
    link = re.search(r"has the \[common keys\]\(index\.md#common-info-keys\)(.*), and:$", section(task, "Info"), re.M)
    common = [names_in(head)[0] for head, _ in entries(OVERVIEW, "Common info keys")]
    shared, keys_of_step = set(common[: common.index("step_terms")]), set(common[common.index("step_terms") :])
    assert link and names_in(link[1]) == ([] if "success" in own else ["is_success"])
    make = gym.make if single else partial(gym.make_vec, num_envs=2)
    env = make(env_id(task), info_every_step=True, **keywords)
    over, infos = False, [env.reset(seed=0)[1]]
    while not over:
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        infos.append(info)
        over = np.any(terminated) or np.any(truncated)
    terms = {names_in(head)[0] for head, _ in entries(task, "Rewards")}
    wanted = keys_of_step - {"term_<name>"} | own | shared - {*names_in(link[1])} | {f"term_{name}" for name in terms}
    assert {key for key in infos[-1] if not key.startswith("_")} == wanted
    for info in infos:
        missing = wanted - info.keys()
        assert {key for key in info if not key.startswith("_")} == wanted - missing
        assert all(np.asarray(infos[-1][key]).dtype == np.float64 for key in missing)
    assert {key for key in infos[-1]["terms"] if not key.startswith("_")} == terms


# The site, README.md and the gallery


def hook(name):
    """A hook of the site as a module, as MkDocs loads it."""
    pytest.importorskip("mkdocs", reason="the extra [docs] is not installed")
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/site/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_readme_and_citation():
    """README is short, has its two commands, and begins with a picture that moves; CITATION.cff names this version."""
    from PIL import Image

    text = (ROOT / "README.md").read_text()
    lines = text.splitlines()
    assert len(lines) <= 80
    assert 'pip install -c constraints.txt -e ".[train]" && python train.py swim' in lines
    assert 'pip install -c constraints.txt -e ".[dev]" && pytest' in lines
    path = ROOT / re.search(r"!\[[^\]]+\]\(([^)]+)\)", text)[1]
    assert path.stat().st_size < 700_000
    with Image.open(path) as picture:
        assert picture.n_frames > 20
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M)[1] == fish_env.__version__


def test_links_out_of_docs_lead_to_copies():
    """A source file becomes a page, data stay as they are; links within docs/, to the web and in code are left."""
    links = hook("links")
    assert links.uri(ROOT / "fish_env" / "physics" / "tank.py") == "repository/fish_env/physics/tank.py.md"
    assert links.uri(ROOT / "benchmarks" / "results" / "gait.csv") == "repository/benchmarks/results/gait.csv"
    assert links.uri(ROOT / "benchmarks") == "repository/benchmarks/index.md"
    folder = ROOT / "docs" / "envs"
    assert links.outside(folder, "../../fish_env/physics/tank.py") == ROOT / "fish_env" / "physics" / "tank.py"
    for link in ("swim.md", "../physics.md", "https://gymnasium.farama.org", "../../nothing.py", "../../../tmp"):
        assert links.outside(folder, link) is None, link
    assert links.links("[a](../a.py)\n\n```\n[b](../b.py)\n```\n\n[c](c.md#d)\n") == ["../a.py", "c.md"]


def test_film_of_the_site():
    """The film is made of a policy, and links of the repository lead to it."""
    film = hook("film")
    assert "WebGL" in film.film(episodes=1)
    assert film.on_page_markdown("[film](site/film.py)", None, None, None) == "[film](videos/left_after_right.html)"


def test_equations_become_mathml(caplog):
    """A number moves beside its equation; a command that cannot be converted is a warning, which CI refuses."""
    equations = hook("equations")
    found = equations.block(r"e_{ij} = \lvert r_{ij} \rvert \tag{4}", "math", "", {}, None)
    assert "<math" in found and "(4)" in found and 'id="eq-4"' in found and "tag" not in found
    assert not caplog.records
    with caplog.at_level(logging.WARNING):
        equations.mathml(r"\nosuchcommand x", "inline")
    assert r"\nosuchcommand" in caplog.text


@pytest.mark.slow
def test_window_film_and_laboratory_draw_the_same(monkeypatch):
    """Of one moment the three show the same pose and the same colours, to 1/30 of a length; of another moment not."""
    for module, extra in (("playwright.sync_api", "browser"), ("websockets", "lab")):
        pytest.importorskip(module, reason=f'needs pip install -e ".[{extra}]"')
    monkeypatch.syspath_prepend(str(ROOT / "docs/site"))
    gallery = importlib.import_module("gallery")

    def warm(image):  # muscles that contract and fins: where, about the middle, and the shares of red, green and blue
        pixels = np.asarray(image).astype(int)
        rows, columns = np.nonzero(pixels[..., 0] - pixels[..., 2] > 30)
        red = pixels[pixels[..., 0] - pixels[..., 1:].mean(axis=2) > 90]
        mask = np.zeros((400, 400), bool)
        mask[rows - round(rows.mean()) + 200, columns - round(columns.mean()) + 200] = True
        return mask, (red / red.sum(axis=1, keepdims=True)).mean(axis=0)

    def overlap(one, other):
        near = np.pad(other, 8)
        near = np.any([np.roll(near, (i, j), (0, 1)) for i in range(-8, 9, 2) for j in range(-8, 9, 2)], axis=0)
        return (one & near[8:-8, 8:-8]).sum() / one.sum()

    (window, red), *others = map(warm, gallery.three_renderers(30))
    earlier, _ = warm(gallery.window_at(28))
    for mask, colour in others:
        assert min(overlap(window, mask), overlap(mask, window)) > 0.95
        np.testing.assert_allclose(colour, red, atol=0.05)
        assert min(overlap(earlier, mask), overlap(mask, earlier)) < 0.9


# Commands

HERE = [*PAGES, ROOT / "CONTRIBUTING.md"]
PROGRAMS = "python|fish_env|pip|uvx|pytest|pre-commit|mkdocs|twine|tensorboard|ray|docker|git|cd"
"""First words of commands: of every line of a shell block, and of spans within the text that say more than a name."""

NOT_RUN = {
    "needs the network": ("pip install", "uvx", r"python -m build$"),
    "is for a release; test_release.py runs it": (r"python \.ci/release_check\.py", "twine check"),
    "changes the checkout, or the package": (
        "pre-commit install", r"python -m benchmarks\.calibrate ", r"python -m benchmarks\.learning\.learners ",
    ),
    "is the tests themselves, once or for each mistake": ("pytest", r"python \.ci/mutation\.py"),
    "is a server, an image or a cluster": ("tensorboard", "docker build", "docker run", "ray start"),
    "is in .ci/run too": ("mkdocs build",),
    "needs RL Baselines3 Zoo, which is no dependency": (r"python -m rl_zoo3\.",),
    "is run by test_learners.py, test_rllib.py and test_gpu.py where that is installed": (
        r"python examples/train_torchrl\.py", r"python examples/train_sbx\.py", r"python examples/train_rllib\.py",
        r"python examples/train_gpu\.py",
    ),
    "needs an NVIDIA GPU, MuJoCo or a browser": (
        r"python -m benchmarks\.speed\.gpu", r"python -m benchmarks\.speed\.peers", r"python docs/site/gallery\.py",
    ),
    "takes an hour; test_benchmarks.py does it in small": (r"python train\.py all",),
    "takes minutes, up to hours": (
        r"python train\.py compare --integrators", r"python -m benchmarks (--all|validation)",
        r"python -m benchmarks\.stability\.water",
    ),
}  # fmt: skip
"""How commands begin that no test runs, as regular expressions, by the reason."""

SHORT = {
    "fish_env train ": "--timesteps 2048 --num-envs 16 --no-pictures",
    "fish_env train .*--resume ": "--timesteps 4096",  # the run of the line before has ended
    r"python train\.py [a-z_]+$": "--timesteps 2048 --num-envs 16 --no-pictures",
    "fish_env play ": "--episodes 1 --env-kwargs max_episode_steps=9",
    "fish_env evaluate ": "--episodes 2",
    r"python train\.py evaluate ": "--episodes 2",
    "fish_env report ": "--episodes 2",
    "fish_env benchmark learner": "--steps 320",
    "fish_env benchmark ppo": "--tasks swim --levels easy --steps 2048 --seeds 0 --save ppo.json",
    r"python examples/train_cleanrl\.py": "--timesteps 512 --num-envs 16 --evaluations 3",
    r"python -m benchmarks\.(accuracy|bodies|validation|stability\.survey|water\.levels|speed\.scaling)": "--draw",
    r"python -m benchmarks\.calibration\.living_fish": "--draw",
    r"python -m benchmarks\.stability\.stress": "--body planar --fish 64 --evaluations 8",
    r"python -m benchmarks\.learning\.bound": "swim --starts 1 --seeds 1 --budget 2",
}
"""Options that make commands short, after those of the page."""

SLOW = (
    "python -m benchmarks",
    "python -m fish_env compile",
    "fish_env compile",
    "fish_env compare",
    "fish_env chart",
    "fish_env train .*--integrator",
    "fish_env train .*--body tetrahedral",
    r"fish_env report runs/(swim|all)/",
)
"""How commands begin that take long even so."""

MINE = """
import gymnasium as gym
import fish_env

gym.register("Mine-v0", entry_point="fish_env.envs:FishEnv", vector_entry_point="fish_env.envs:FishVectorEnv",
             max_episode_steps=250, kwargs={"task": "turn", "body": fish_env.make_fish(length=0.3)})
"""


def commands_of(path: Path) -> list[str]:
    """The commands of a page, from its top, without comments and the variables before them."""
    text = path.read_text()
    found = [
        (block.line + number, command)
        for block in blocks(path, "sh")
        for number, line in enumerate(block.text.splitlines())
        for command in re.split(r"\s&&\s", re.sub(r"\s#\s.*", "", line))
    ]
    prose = FENCE.sub(lambda match: "\n" * match[0].count("\n"), text)
    for span in re.finditer(rf"(?<!`)`((?:[A-Z_]+=\S+ )*(?:{PROGRAMS}) [^`\n]+)`(?!`)", prose):
        found.append((prose.count("\n", 0, span.start()) + 1, span[1]))
    return [re.sub(r"^([A-Z_]+=\S+ )*", "", text.strip()) for _, text in sorted(found, key=itemgetter(0))]


def matching(command, patterns):
    """Those of the patterns that a command begins with."""
    return [pattern for pattern in patterns if re.match(pattern, command)]


ENDLESS = [pattern for patterns in NOT_RUN.values() for pattern in patterns]
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
        assert re.match(rf"(?:{PROGRAMS})\b", command), f"{command}: how is it checked?"
        assert len(matching(command, ENDLESS)) < 2, command
    for pattern in (*ENDLESS, *SHORT, *SLOW):
        assert any(re.match(pattern, command) for command in ALL), f"no page has a command {pattern}"


def test_what_pip_installs():
    """The extras exist, and so do the constraints and the folder."""
    declared = (ROOT / "pyproject.toml").read_text().split("[project.optional-dependencies]")[1].split("\n[")[0]
    for command in [command for command in ALL if command.startswith("pip ")]:
        for extra in re.findall(r"(?:\.|fish_env)\[(\w+)\]", command):
            assert re.search(rf"^{extra} = ", declared, re.MULTILINE), f"{command}: there is no extra {extra!r}"
        for name in re.findall(r'-[ce] "?([\w./]+)', command):
            assert (ROOT / name).exists(), f"{command}: there is no {name}"


@pytest.fixture
def reader(trained, tmp_path, monkeypatch):
    """The folder of a reader with earlier runs, a policy and a module of theirs; what is registered is forgotten."""
    for run in ("runs/swim/2026-11-26", "runs/all/turn/0", "runs/all/turn/1"):
        shutil.copytree(trained, tmp_path / run)
    (tmp_path / "my").mkdir()
    shutil.copy(shipped_policy("turn"), tmp_path / "my" / "policy.npz")
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "learner.py").write_text(blocks(ROOT / "docs/benchmark.md", "python")[0].text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(ROOT / "examples/register_elsewhere/src"), *sys.path])
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    before = [(table, set(table)) for table in (gym.registry, fish_env.TASKS)]
    yield tmp_path
    for table, names in before:
        for name in set(table) - names:
            del table[name]
    for name in [name for name in sys.modules if re.match(r"mine$|learner$|swim_elsewhere", name)]:
        del sys.modules[name]


def typed(command: str) -> list[str]:
    """The words of a command, with what a reader puts in for <...> and the shell for *, and made short."""
    words = []
    for word in shlex.split(command):
        word = re.sub("<policy>", "swim", word)
        if "<time>" in word:  # the latest run of this task
            found = sorted(Path().glob(word.replace("<time>", "*")), key=lambda path: path.stat().st_mtime)
            assert found, f"{command}: there is no such run"
            words.append(str(found[-1]))
        else:
            words += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return [*words, *(more for pattern in matching(command, SHORT) for more in SHORT[pattern].split())]


def look_and_leave(laboratory):
    """What a reader does who opens the laboratory: the page, and its first picture."""
    from test_lab_server import ask, enter, get

    try:
        assert get(laboratory)[0] == 200
        with enter(laboratory) as page:
            assert isinstance(ask(page, {"do": "frame"})[-1], bytes)
    finally:
        laboratory.close()


def run(command: str, monkeypatch):
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


def runs_of(page: str, slow: bool) -> list[str]:
    """The commands of a page that are run, each once."""
    found = dict.fromkeys(command for command in COMMANDS[page] if not matching(command, ENDLESS))
    return [command for command in found if slow or not matching(command, SLOW)]


@pytest.mark.soft
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
