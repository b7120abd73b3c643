"""`python train.py report`: one HTML page of a training run, or of several side by side; it opens from disk."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from agents import run_charts as charts
from agents.config import RESULTS
from agents.run_measures import (
    FILES,
    Episodes,
    Motion,
    Run,
    measured_episodes,
    motion,
    read_run,
    recorded_episodes,
    tail_beat,
)
from agents.saved_run import check_name
from agents.statistics import interval
from fish_env.bodies import Fish
from fish_env.control import EPISODES, FIRST_SEED, Recording
from fish_env.control.files import replacing, writable_file
from fish_env.control.film import film_text

TEMPLATE = Path(__file__).with_name("run_report.html")
WORST = 5  # episodes that are listed
CURVES = (
    "Of the training, with exploration noise. Thin lines are seeds; bold lines are interquartile means over seeds, "
    "with their 95 % bootstrap intervals as bands. A single seed has no interval."
)
GAIT = (
    "How far each muscle is contracted in the first episode: those of the left side (L), then those of the right (R), "
    "upper (u) and lower (l), each from the head (1) to the tail."
)


@dataclass(frozen=True, eq=False)
class Group:
    """Runs that differ in their seeds only, with their measurements."""

    label: str
    runs: list[Run]
    episodes: list[Episodes]
    recordings: list[Recording]
    """Recordings of the first run."""
    motions: list[Motion]
    fish: Fish


def write_report(folders: Sequence[str | Path], path: Path | None = None, episodes: int = EPISODES) -> Path:
    """Write the page of one run, or of several: those that differ in their seeds only are put together.

    Args:
        folders: of runs that `train.py` has written.
        path: the page; None is report.html in the folder of a single run, or in the folder that contains all of them.
        episodes: how many each policy is evaluated in, on the fixed seeds.

    Raises:
        ValueError: for no folder or one that contains no run, for more groups than there are colours, fewer than one
            episode, or a page that cannot be written.
    """
    if episodes < 1:
        raise ValueError(f"--episodes is {episodes}; give a whole number, at least 1")
    runs = [read_run(folder) for folder in dict.fromkeys(Path(folder).resolve() for folder in folders)]
    if not runs:
        raise ValueError(f"there is no folder; give folders of runs, with {', '.join(FILES)}")
    if path is None:
        path = Path(os.path.commonpath([run.folder for run in runs])) / "report.html"
    check_name(path)
    path = writable_file(path, (".html",))
    sections = []
    for task in dict.fromkeys(run.task for run in runs):
        groups = [measured(label, same, episodes) for label, same in grouped([r for r in runs if r.task == task])]
        sections.append(section(task, groups, alone=len(runs) == 1))
    title = f"{runs[0].task}, seed {runs[0].seed}" if len(runs) == 1 else f"{len(runs)} training runs"
    about = (f"Every policy is measured in {episodes} episodes without exploration noise, with the seeds from "
             f"{FIRST_SEED:,} on, which no training uses. BL is a body length.")  # fmt: skip
    with replacing(path) as partial:
        page = TEMPLATE.read_text(encoding="utf-8").format(title=escape(title), about=about, sections="".join(sections))
        partial.write_text(page, encoding="utf-8")
    return path


def grouped(runs: Sequence[Run]) -> list[tuple[str, list[Run]]]:
    """Runs of one task by the settings that differ, named after them.

    Raises:
        ValueError: if there are more groups than colours.
    """
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(json.dumps([run.record["config"], run.record.get("start")], sort_keys=True), []).append(run)
    if len(found) > len(charts.COLOURS):
        raise ValueError(f"the runs have {len(found)} different settings; compare at most {len(charts.COLOURS)}")
    settings = [flat(same[0].record["config"] | {"start": same[0].record.get("start")}) for same in found.values()]
    if len(found) == 1:
        return [(f"seed {runs[0].seed}" if len(runs) == 1 else "all seeds", list(runs))]
    names = dict.fromkeys(name for each in settings for name in each)
    other = [name for name in names if len({str(each.get(name)) for each in settings}) > 1]
    labels = [", ".join(f"{n.rpartition('.')[2]} {each[n]}" for n in other if n in each) for each in settings]
    return [(label or "default", same) for label, same in zip(labels, found.values(), strict=True)]


def flat(settings: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings in one dict, by names with dots."""
    out: dict[str, Any] = {}
    for name, value in settings.items():
        out |= flat(value, f"{before}{name}.") if isinstance(value, dict) else {before + name: value}
    return out


def measured(label: str, runs: list[Run], count: int) -> Group:
    """A group with its episodes on the fixed seeds."""
    episodes = [measured_episodes(run, count) for run in runs]
    recordings, fish = recorded_episodes(runs[0])
    return Group(label, runs, episodes, recordings, [motion(one, fish) for one in recordings], fish)


def section(task: str, groups: list[Group], alone: bool) -> str:
    """All that is said of the runs of a task."""
    interval_s = groups[0].recordings[0].about["control_interval"]
    first = [(group.label, group.motions[0]) for group in groups]
    fish = groups[0].fish
    order, names = muscle_rows(fish)
    curves = charts.learning_curves([(g.label, [run.curve for run in g.runs]) for g in groups], RESULTS[task].score)
    terms = charts.reward_terms([(group.label, charts.pooled(group.episodes)) for group in groups])
    course = charts.term_course(first[0][1], groups[0].recordings[0].about["term_names"]) if alone else ""
    paths = charts.paths([(group.label, group.motions) for group in groups], task.startswith("target"))
    gaits = charts.gaits([(label, found.contraction[:, order], found.time) for label, found in first], names)
    parts = [
        settings_of_run(groups[0].runs[0]) if alone else f"<h2>{escape(task)}: the runs</h2>{table_of_runs(groups)}",
        f"<h2>{escape(task)}: results</h2>{table_of_metrics(task, groups)}",
        f"<h2>Learning curves</h2>{note(CURVES)}{curves}",
        f"<h2>Failures</h2>{failures(groups)}",
        f"<h2>Reward terms</h2>{note('Black lines are 95 % bootstrap intervals over the episodes.')}{terms}{course}",
        f"<h2>Path</h2>{note(f'From above, the first {len(groups[0].motions)} episodes; a dot is the end.')}{paths}",
        f"<h2>Heading</h2>{note('Of the first episode.')}{charts.headings(first)}",
        f"<h2>Gait</h2>{note(GAIT)}{gaits}",
        f"<h2>Tail sweep</h2>{table_of_beats(groups, interval_s)}{charts.tails(first, interval_s)}",
        film(groups[0]) if alone else "",
    ]
    return "".join(parts)


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


def table_of_runs(groups: Sequence[Group]) -> str:
    """Every run with its folder, seed and length."""
    rows = [(group.label, str(run.folder), run.seed, f"{steps_of(run):,}", str(run.record.get("commit", "-")))
            for group in groups for run in group.runs]  # fmt: skip
    return table(("group", "folder", "seed", "environment steps", "commit"), rows, 2)


def steps_of(run: Run) -> int:
    """Number of environment steps at the end of the learning curve."""
    return int(run.curve["timesteps"][-1]) if len(run.curve["timesteps"]) else 0


def settings_of_run(run: Run) -> str:
    """Command, commit and settings of a run."""
    record = run.record
    steps, wanted = steps_of(run), record["config"].get("timesteps", 0)
    short = f' <span class="bad">Interrupted: {wanted:,} were asked for.</span>' if steps < 0.9 * wanted else ""
    seconds = run.curve["seconds"][-1] if steps else 0.0
    commit = escape(str(record.get("commit", "unknown")))
    rows = list(flat(record["config"]).items()) + list(flat(record.get("versions", {}), "version of ").items())
    return (
        f"<p><code>{escape(str(record.get('command', '')))}</code></p>"
        f"<p>{steps:,} environment steps in {seconds:.0f} s, commit {commit}.{short}</p>"
        f"<details><summary>Settings and versions</summary>{table(('setting', 'value'), rows, 9)}</details>"
    )


def table_of_metrics(task: str, groups: Sequence[Group]) -> str:
    """The task's metrics, a row each, with intervals over seeds and episodes."""
    names = [*RESULTS[task].metrics, "return", "failed"]
    rows = []
    for name in names:
        cells = []
        for group in groups:
            scores = [one.scores for one in group.episodes]
            if name not in scores[0] and name != "time_per_target":
                cells.append("-")
                continue
            middle, low, high = interval(scores, name, np.random.default_rng(0))
            cells.append(f"{middle:.3f} ({low:.3f} to {high:.3f})" if np.isfinite(middle) else "-")
        rows.append((name, *cells))
    text = (
        "Interquartile means over seeds of the means over episodes; 95 % bootstrap intervals over seeds and episodes."
    )
    return note(text) + table(("metric", *(f"{group.label}{seeds_of(group)}" for group in groups)), rows)


def seeds_of(group: Group) -> str:
    """Number of seeds of a group, in brackets, if there are several."""
    return f" ({len(group.runs)} seeds)" if len(group.runs) > 1 else ""


def failures(groups: Sequence[Group]) -> str:
    """Frequency and reasons of failures, and the worst episodes with the commands that show them."""
    lines = []
    for group in groups:
        count = sum(len(one.scores["return"]) for one in group.episodes)
        why = charts.pooled(group.episodes).failures
        said = ", ".join(f"{number} {reason}" for reason, number in why.most_common()) or "none"
        kind = ' class="bad"' if why else ""
        lines.append(
            f"<p{kind}>{escape(group.label)}: {said} of {count} episodes were ended by a failure of the physics.</p>"
        )
        scores, policy = group.episodes[0].scores, group.runs[0].folder / "policy.npz"
        worst = np.argsort(scores["return"], kind="stable")[:WORST].tolist()
        rows = [(FIRST_SEED + i, f"{scores['return'][i]:.2f}", f"{scores['seconds'][i]:.2f}",
                 "failed" if scores["failed"][i] else "") for i in worst]  # fmt: skip
        command = f"python train.py play {policy} --seed SEED --episodes 1 --save film.html"
        lines.append(note(f"Lowest returns of the first run; to see one: <code>{escape(command)}</code>"))
        lines.append(table(("seed", "return", "seconds", ""), rows, 0))
    return "".join(lines)


def table_of_beats(groups: Sequence[Group], interval_s: float) -> str:
    """Frequency and amplitude of the tail beat in the episodes that were recorded."""
    rows = []
    for group in groups:
        beats = np.array([tail_beat(found, interval_s) for found in group.motions]).mean(axis=0)
        rows.append((group.label, f"{beats[0]:.2f}", f"{beats[1]:.3f}"))
    text = (
        "Mean of the tail's two tips, across the body's axis. The frequency is that of the highest peak of the "
        "spectrum, the amplitude that of a sine wave of the same mean square; means of the recorded episodes."
    )
    return note(text) + table(("", "frequency, Hz", "amplitude, BL"), rows)


def muscle_rows(fish: Fish) -> tuple[list[int], list[str]]:
    """The muscles in the order of the chart, and their names: side, height and segment from the head."""
    upper = fish.heights > fish.heights.mean()
    order = np.lexsort((fish.segments, ~upper, -np.asarray(fish.sides))).tolist()
    names = [f"{'L' if fish.sides[m] > 0 else 'R'}{'u' if upper[m] else 'l'} {fish.segments[m] + 1}" for m in order]
    return order, names


def film(group: Group) -> str:
    """The recorded episodes, to be turned in 3-D, as a page within the page."""
    return f'<h2>Film</h2><iframe title="film of the episodes" srcdoc="{escape(film_text(group.recordings))}"></iframe>'
