"""Tables of metrics on a terminal."""

from pathlib import Path


def print_means(env_id: str, records: list[dict]) -> None:
    """Print the metrics of one environment, a row each, and a column for each policy.

    Args:
        env_id: of the environment.
        records: of the policies, each with `policy` (its name), `means`, `episodes` and `first_seed`.
    """
    print(f"{env_id}: mean over {records[0]['episodes']} episodes, seeds from {records[0]['first_seed']}")
    names = [record["policy"] for record in records]
    names = [Path(name).parent.name if Path(name).name == "policy.npz" else name for name in names]
    widths = [max(12, len(name) + 2) for name in names]
    if len(records) > 1:
        print(" " * 22 + "".join(name.rjust(width) for name, width in zip(names, widths, strict=True)))
    for metric in dict.fromkeys(metric for record in records for metric in record["means"]):
        values = [record["means"].get(metric) for record in records]
        cells = ["-" if value is None else f"{value:.4g}" for value in values]
        print(f"  {metric:20}" + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
