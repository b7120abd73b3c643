"""`fish_env report`: one HTML page of a training run, or of several side by side; it opens from disk."""

import json
import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from fish_env.bodies import Fish
from fish_env.control import Policy, Recording, Scores, load_policy, make_policy_env, record
from fish_env.control.env_spec import make_checked_env
from fish_env.control.evaluation import EPISODES, FIRST_SEED, checked_episodes, environment_for, evaluate
from fish_env.control.files import writable_file, write_text
from fish_env.control.film import FilmEpisode, film_data, film_text
from fish_env.control.statistics import SHARES, SIGNED, Interval, interval
from fish_env.kernels.data import data
from fish_env.training import report_charts as charts
from fish_env.training.config import SCORES
from fish_env.training.report import baselines
from fish_env.training.run_folder import CURVE, read_curve, read_record

FILES = ("config.json", "curve.csv", "policy.npz")
TEMPLATE = data("fish_env.training", "report_page.html")
RECORDED = 3  # episodes whose motion is drawn
WORST = 5  # episodes that are listed
MEANS = (
    "Means over episodes with 95 % intervals: Wilson score intervals of shares, bootstrap intervals of all else. "
    "The controllers without learning run the same episodes."
)
CURVES = "Means per episode in training, with exploration noise. The terms of the reward add up to the return."
SEEDS = " Thin lines are seeds, and bold ones their interquartile means, as in the table."
PATHS = (
    f"From above, the first {RECORDED} episodes: a dot is the end. Circles are targets, grey areas those of obstacles."
)
GAIT = (
    "How far each muscle is contracted in the first episode: those of the left side (L), then those of the right (R), "
    "upper (u) and lower (l), each from the head (1) to the tail."
)


@dataclass(frozen=True, eq=False)
class Run:
    """A finished or interrupted training run."""

    folder: Path
    record: dict[str, Any]
    """config.json."""
    curve: dict[str, np.ndarray]
    """The columns of curve.csv."""
    policy: Policy


@dataclass(frozen=True, eq=False)
class Group:
    """Runs that differ in their seeds only, with their measurements."""

    label: str
    runs: list[Run]
    episodes: list[Scores]
    """On the fixed seeds, of every run."""
    recordings: list[Recording]
    """Recordings of the first run."""
    motions: list[charts.Motion]
    fish: Fish
    untrained: dict[str, Scores]
    """Metrics of the controllers without learning, in the environment of the first run."""


def write_report(folders: Sequence[str | Path], path: Path | None = None, episodes: int = EPISODES) -> Path:
    """Write the page of one run, or of several: those that differ in their seeds only are put together.

    Args:
        folders: of runs that `train` has written.
        path: the page; None is report.html in the folder of a single run, or in the folder that contains all of them.
        episodes: how many each policy is evaluated in, on the fixed seeds.

    Raises:
        ValueError: for no folder or one that contains no run, for more groups than there are colours, fewer than one
            episode, or a page that cannot be written.
    """
    checked_episodes(episodes, FIRST_SEED)
    runs = [read_run(folder) for folder in dict.fromkeys(Path(folder).resolve() for folder in folders)]
    if not runs:
        raise ValueError(f"there is no folder; give folders of runs, with {', '.join(FILES)}")
    if path is None:
        path = Path(os.path.commonpath([run.folder for run in runs])) / "report.html"
    path = writable_file(path, (".html",))
    sections = []
    with mpl.rc_context(charts.STYLE):
        for task in dict.fromkeys(run.record["task"] for run in runs):
            same_task = [run for run in runs if run.record["task"] == task]
            groups = [measure_group(label, same, episodes) for label, same in group_runs(same_task)]
            sections.append(write_section(task, groups, alone=len(runs) == 1))
    first = runs[0].record
    title = f"{first['task']}, seed {first['seed']}" if len(runs) == 1 else f"{len(runs)} training runs"
    about = (f"Every policy is measured in {episodes} episodes without exploration noise, with the seeds from "
             f"{FIRST_SEED:,} on, which no training uses. BL is a body length.")  # fmt: skip
    page = TEMPLATE.read_text(encoding="utf-8").format(title=escape(title), about=about, sections="".join(sections))
    write_text(path, page)
    return path


def read_run(folder: str | Path) -> Run:
    """A run by its folder; ValueError if it contains no run, or one whose files are damaged or of another version."""
    folder = Path(folder)
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        what = f"holds no {', '.join(missing)}" if folder.is_dir() else "is not a folder"
        raise ValueError(f"{folder} is not a training run: it {what}; give a folder that `fish_env train` has written")
    saved, rows = read_record(folder), read_curve(folder)
    policy = load_policy(folder / "policy.npz", saved["config"]["env_id"])
    curve = {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else CURVE)}
    return Run(folder, saved, curve, policy)


def group_runs(runs: Sequence[Run]) -> list[tuple[str, list[Run]]]:
    """The runs of one task by their settings, named after what differs; ValueError for more groups than colours."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(json.dumps([run.record["config"], run.record["start"]], sort_keys=True), []).append(run)
    if len(found) > len(charts.COLOURS):
        raise ValueError(f"the runs have {len(found)} different settings; compare at most {len(charts.COLOURS)}")
    if len(found) == 1:
        return [("trained policy" if len(runs) == 1 else "all seeds", list(runs))]
    settings = [flatten(same[0].record["config"] | {"start": same[0].record["start"]}) for same in found.values()]
    labels = [
        ", ".join(f"{name.rpartition('.')[2]} {value}" for name, value in each.items()
                  if any(str(other.get(name)) != str(value) for other in settings))
        for each in settings
    ]  # fmt: skip
    return [(label or "default", same) for label, same in zip(labels, found.values(), strict=True)]


def flatten(settings: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Put nested settings into one dict, by names with dots."""
    out: dict[str, Any] = {}
    for name, value in settings.items():
        out |= flatten(value, f"{before}{name}.") if isinstance(value, dict) else {before + name: value}
    return out


def measure_group(label: str, runs: list[Run], count: int) -> Group:
    """Evaluate the runs of a group in `count` episodes on the fixed seeds, and record a few of the first run."""
    episodes, untrained = [], {}
    for run in runs:
        with closing(make_policy_env(run.policy, count)) as batch:
            episodes.append(evaluate(batch, run.policy))
            untrained = untrained or {name: evaluate(batch, act) for name, act in baselines(batch).items()}
    with closing(make_checked_env(*environment_for(runs[0].policy, {}))) as env:
        recordings = [record(env, runs[0].policy, FIRST_SEED + k) for k in range(RECORDED)]
    film = film_data(recordings)
    motions = [measure_motion(*pair, film.fish) for pair in zip(recordings, film.episodes, strict=True)]
    return Group(label, runs, episodes, recordings, motions, film.fish, untrained)


def measure_motion(recording: Recording, one: FilmEpisode, fish: Fish) -> charts.Motion:
    """The motion in an episode of this fish, in body lengths, from its start, the first command along +x."""
    x, y = one.command[0, :2] if one.command[0, :2].any() else fish.line @ recording.position[0, :, :2]
    along, start = np.arctan2(y, x), one.centre[0, :2]
    turn = np.array([[np.cos(along), -np.sin(along)], [np.sin(along), np.cos(along)]])
    places = np.unique(np.round(one.spheres[one.spheres[..., 3] > 0.0], 9), axis=0).reshape(-1, 4)
    around, path = ((points[:, :2] - start) @ turn / fish.length for points in (places, one.centre))
    return charts.Motion(one.time, path, one.contraction, np.column_stack([around, places[:, 3]]))


def write_section(task: str, groups: list[Group], alone: bool) -> str:
    """Everything about the runs of a task; `alone` for a single run, whose settings and film are shown too."""
    score, several = SCORES.get(task, "return"), any(len(group.runs) > 1 for group in groups)
    keys = [note(f'<span style="color: {colour}">&#9632; {escape(group.label)}</span>')
            for colour, group in zip(charts.COLOURS, groups, strict=False)] if len(groups) > 1 else [""]  # fmt: skip
    key = "".join(keys)
    curves = charts.draw_learning_curves([[run.curve for run in group.runs] for group in groups], score)
    paths = charts.draw_paths([group.motions for group in groups], task.startswith("target"))
    gaits = [charts.draw_gait(group.motions[0], *order_muscles(group.fish)) for group in groups]
    runs = f"<h2>{escape(task)}: the run{'s' * (not alone)}</h2>{tabulate_runs(groups)}"
    parts = [
        f"<h2>{escape(task)}: results</h2>{tabulate_metrics(groups, score)}{note(MEANS)}",
        f"<h2>Learning curves</h2>{note(CURVES + SEEDS * several)}{key}",
        f'<div class="charts">{"".join(f"<div>{curve}</div>" for curve in curves)}</div>',
        f'<div class="charts"><section><h2>Path</h2>{note(PATHS)}{key}{paths}</section>',
        f"<section><h2>Gait</h2>{note(GAIT)}{''.join(map(''.join, zip(keys, gaits, strict=True)))}</section>",
        f"<section><h2>Failures</h2>{''.join(list_failures(group) for group in groups)}</section></div>",
    ]
    if not alone:
        return "".join([runs, *parts])
    film = f'<iframe title="film of the episodes" srcdoc="{escape(film_text(groups[0].recordings))}"></iframe>'
    return "".join(["<h2>Film</h2>", film, *parts, runs, list_settings(groups[0].runs[0].record)])


def note(text: str) -> str:
    """A remark under a heading."""
    return f'<p class="note">{text}</p>'


def table(header: Sequence[str], rows: Sequence[Sequence[Any]], first_numbers: int = 1) -> str:
    """A table whose cells are text; columns from `first_numbers` on are numbers."""

    def cells(tag, row):
        kinds = [" class=number" if k >= first_numbers else "" for k in range(len(row))]
        return "".join(f"<{tag}{kind}>{escape(str(cell))}</{tag}>" for kind, cell in zip(kinds, row, strict=True))

    lines = [f"<tr>{cells('th', header)}</tr>", *(f"<tr>{cells('td', row)}</tr>" for row in rows)]
    return f'<div class="scroll"><table>{"".join(lines)}</table></div>'


def tabulate_runs(groups: Sequence[Group]) -> str:
    """Every run with its folder, seed, environment steps made and requested, seconds and commit."""
    rows = []
    for label, run in [(group.label, run) for group in groups for run in group.runs]:
        steps, seconds = (run.curve[name].max(initial=0.0) for name in ("timesteps", "seconds"))
        made = f"{steps:,.0f} of {run.record['config'].get('timesteps', 0):,}"
        rows.append((label, run.folder, run.record["seed"], made, f"{seconds:.0f}", run.record["commit"]))
    return table(("group", "folder", "seed", "environment steps", "seconds", "commit"), rows, 2)


def list_settings(record: dict[str, Any]) -> str:
    """Command, settings and versions of a run."""
    rows = [*flatten(record["config"]).items(), *flatten(record["versions"], "version of ").items()]
    return (
        f"<p><code>{escape(record['command'])}</code></p>"
        f"<details><summary>Settings and versions</summary>{table(('setting', 'value'), rows, 9)}</details>"
    )


def tabulate_metrics(groups: Sequence[Group], score: str) -> str:
    """The metrics, a row each, the score first, of the groups and of the controllers without learning, with intervals.

    Metrics whose mean says nothing are left out: signed ones, and those that are undefined or the same in all episodes.
    """
    columns = [(f"{g.label} ({len(g.runs)} seeds)" if len(g.runs) > 1 else g.label, g.episodes) for g in groups]
    untrained = {(name, scores["return"].tobytes()): (name, f"{name}, {group.label}", [scores])
                 for group in reversed(groups) for name, scores in group.untrained.items()}  # fmt: skip
    several, rows = len(untrained) > len(groups[0].untrained), []  # environments
    columns += [(long if several else short, scores) for short, long, scores in untrained.values()]
    for metric in dict.fromkeys([score, *(name for _, (scores, *_) in columns for name in scores)]):
        having = [[{metric: np.full_like(scores["return"], np.nan)} | scores for scores in episodes]
                  for _, episodes in columns]  # fmt: skip
        values = np.concatenate([scores[metric] for episodes in having for scores in episodes])
        values = values[np.isfinite(values)]
        if metric not in SIGNED and values.size and (metric in SHARES or np.ptp(values)):
            name, times = charts.shown(metric)
            found = [interval(episodes, metric, np.random.default_rng(0)) for episodes in having]
            rows.append((name, *(Interval(*(times * number for number in one)) for one in found)))
    return table(("metric", *(label for label, _ in columns)), rows)


def list_failures(group: Group) -> str:
    """Number of failures, and the worst episodes with the command that shows them."""
    failed = np.concatenate([scores["failed"] for scores in group.episodes])
    scores, policy = group.episodes[0], group.runs[0].folder / "policy.npz"
    worst = np.argsort(scores["return"], kind="stable")[:WORST].tolist()
    rows = [(FIRST_SEED + i, f"{scores['return'][i]:.2f}", f"{scores['seconds'][i]:.2f}",
             "failed" if scores["failed"][i] else "") for i in worst]  # fmt: skip
    command = f"fish_env play {policy} --seed SEED --save film.html"
    return (
        f"<p{' class=bad' if failed.any() else ''}>{escape(group.label)}: {int(failed.sum()) or 'none'} of "
        f"{failed.size} episodes were ended by a failure of the physics.</p>"
        + note(f"Lowest returns of the first run; to see one: <code>{escape(command)}</code>")
        + table(("seed", "return", "seconds", ""), rows, 0)
    )


def order_muscles(fish: Fish) -> tuple[list[int], list[str]]:
    """The muscles in the order of the chart, and their names: side, height and segment from the head."""
    upper = fish.heights > fish.heights.mean()
    order = np.lexsort((fish.segments, ~upper, -np.asarray(fish.sides))).tolist()
    names = [f"{'L' if fish.sides[m] > 0 else 'R'}{'u' if upper[m] else 'l'} {fish.segments[m] + 1}" for m in order]
    return order, names
