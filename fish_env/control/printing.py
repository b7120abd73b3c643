"""Tables of metrics on a terminal."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fish_env.control.statistics import SIGNED, Comparison, Interval

Environments = Sequence[tuple[str, dict[str, Any]]]  # ids and keywords


def print_means(records: list[dict]) -> None:
    """Print the metrics of policies in environments of one id, a row each, and a column for each policy."""
    # A record has `policy` (its name), `env_id`, `env_options`, `means`, `intervals` (of shares), `episodes`,
    # `first_seed`.
    rows = {}
    for metric in dict.fromkeys(metric for record in records for metric in record["means"]):
        values = [math.nan if record["means"].get(metric) is None else record["means"][metric] for record in records]
        ends = [record["intervals"].get(metric, (value, value)) for record, value in zip(records, values, strict=True)]
        rows[metric] = [f"{Interval(value, *at):.4g}" for value, at in zip(values, ends, strict=True)]
    environments = [(record["env_id"], record["env_options"]) for record in records]
    about = f"{records[0]['episodes']} episodes, seeds from {records[0]['first_seed']}; shares with 95 % intervals"
    _print_table(environments, [record["policy"] for record in records], about, rows)


def print_comparison(envs: Environments, names: Sequence[str], found: Mapping[str, Comparison], about: str) -> None:
    """Print what `compare` found about two policies of these names: means and their difference, with intervals."""
    rows = {metric: [f"{one:.4g}" for one in every] for metric, every in found.items()}
    _print_table(envs, names, f"{about}, with 95 % intervals", rows, "difference")


def _print_table(
    environments: Environments, names: Sequence[str], mean_over: str, rows: Mapping[str, Sequence[str]], *others: str
) -> None:
    """Print environment and options, and rows of cells under the names of policies; one name alone is left out."""
    short = [Path(name).parent.name if Path(name).name == "policy.npz" else name for name in names]
    texts = [", ".join(f"{name}={value!r}" for name, value in sorted(options.items())) for _, options in environments]
    same = texts.count(texts[0]) == len(texts)
    print(f"{environments[0][0]}{f' with {texts[0]}' if same and texts[0] else ''}: mean over {mean_over}")
    for name, text in () if same else zip(short, texts, strict=True):
        print(f"  {name}: {text or 'no options'}")
    heads = [*short, *others]
    rows = {metric: cells for metric, cells in rows.items() if metric not in SIGNED}
    widths = [max(12, 2 + max(len(cell) for cell in column)) for column in zip(heads, *rows.values(), strict=True)]
    for label, cells in {**({"": heads} if len(heads) > 1 else {}), **rows}.items():
        print(f"  {label:20}" + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
