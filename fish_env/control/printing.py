"""Tables of metrics on a terminal."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from fish_env.control.evaluation import EPISODES, FIRST_SEED
from fish_env.control.statistics import Comparison


def print_means(env_id: str, records: list[dict]) -> None:
    """Print the metrics of one environment, a row each, and a column for each policy.

    Args:
        env_id: of the environment.
        records: of the policies, each with `policy` (its name), `means`, `episodes` and `first_seed`.
    """
    print(f"{env_id}: mean over {records[0]['episodes']} episodes, seeds from {records[0]['first_seed']}")
    rows = {}
    for metric in dict.fromkeys(metric for record in records for metric in record["means"]):
        values = [record["means"].get(metric) for record in records]
        rows[metric] = ["-" if value is None else f"{value:.4g}" for value in values]
    _print_table([record["policy"] for record in records], rows)


def print_comparison(env_id: str, names: Sequence[str], found: Mapping[str, Comparison]) -> None:
    """Print what `compare` found about two policies of these names: means and their difference, with intervals."""
    print(f"{env_id}: mean over {EPISODES} episodes, seeds from {FIRST_SEED}, with 95 % intervals")
    rows = {
        metric: [f"{v:.4g} ({low:.4g} to {high:.4g})" if math.isfinite(v) else "-" for v, low, high in every]
        for metric, every in found.items()
    }
    _print_table([*names, "difference"], rows)


def _print_table(names: Sequence[str], rows: Mapping[str, Sequence[str]]) -> None:
    """Print rows of cells under the names of policies, those of files shortened; one name alone is left out."""
    heads = [Path(name).parent.name if Path(name).name == "policy.npz" else name for name in names]
    columns = zip(heads, *rows.values(), strict=True)
    widths = [max(12, 2 + max(len(cell) for cell in column)) for column in columns]
    for label, cells in {**({"": heads} if len(heads) > 1 else {}), **rows}.items():
        print(f"  {label:20}" + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
