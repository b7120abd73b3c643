"""The figure of the default fish: numbered nodes, springs, and muscles with their action index.

python docs/site/fish_figure.py     writes docs/images/fish.svg
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import fish_env

ROOT = Path(__file__).parents[2]
SPRING, MUSCLES, NODE = "#b9c4c9", ("#c0562f", "#a8328a", "#2f6fc0"), "#16323c"
VIEWS = {
    "Left flank, seen from the left": ((-1, 0, 0), (0, 0, 1), "left"),
    "Right flank, seen from the right": ((1, 0, 0), (0, 0, 1), "right"),
    "All nodes and springs, seen from the upper left": ((-1.0, 0.42, 0.0), (-0.10, -0.34, 1.0), "all"),
    "Upper side, seen from above": ((-1, 0, 0), (0, -1, 0), "upper"),
}
"""Title: the directions to the right and upwards in the panel, and the nodes whose springs it shows."""


def members(position: np.ndarray, which: str) -> np.ndarray:
    """(N,) whether a node belongs to a view."""
    x = position
    return {"left": x[:, 1] > -1e-9, "right": x[:, 1] < 1e-9, "upper": x[:, 2] > -1e-9, "all": x[:, 0] > -np.inf}[which]


def panel(axes, fish, title: str) -> None:
    """One view of the fish at rest, in body lengths."""
    right, up, which = VIEWS[title]
    x = fish.body.position / fish.length
    x = x - x.mean(axis=0)
    seen = x @ np.array([right, up], dtype=float).T
    shown = members(x, which)
    nodes = fish.body.springs.nodes
    inside = shown[nodes].all(axis=1)
    for i, j in nodes[inside]:
        axes.plot(*seen[[i, j]].T, color=SPRING, lw=0.7, zorder=1)
    for action, spring in enumerate(fish.muscles):
        if inside[spring]:
            ends, colour = seen[nodes[spring]], MUSCLES[fish.segments[action]]
            axes.plot(*ends.T, color=colour, lw=2.6, zorder=2, solid_capstyle="round")
            label = f"{action}" if which == "all" else f"{action} ({spring})"
            place = ends.mean(axis=0)
            place[1] += 0.0 if which == "all" else 0.034 * np.sign(ends[:, 1].sum())
            axes.text(*place, label, color="white", fontsize=9.5, ha="center", va="center", zorder=4,
                      bbox={"boxstyle": "round,pad=0.15", "fc": colour, "ec": "none"})  # fmt: skip
    for node in np.flatnonzero(shown):
        axes.plot(*seen[node], "o", color=NODE, ms=13, zorder=3)
        axes.text(*seen[node], str(node), color="white", fontsize=9.5, ha="center", va="center_baseline", zorder=5)
    axes.set_title(title, pad=12)
    axes.set_aspect("equal")
    axes.margins(0.05, 1.1 if which == "upper" else 0.12)
    axes.axis("off")


def main() -> None:
    """Draw the four views and the legend."""
    plt.rcParams.update({"svg.hashsalt": "fish_env", "svg.fonttype": "none", "font.size": 10, "axes.titlesize": 10})
    fish = fish_env.make_fish("mass_spring")
    figure, grid = plt.subplots(2, 2, figsize=(10, 5.6), layout="constrained")
    for axes, title in zip(grid.flat, VIEWS, strict=True):
        panel(axes, fish, title)
    handles = [plt.Line2D([], [], color=NODE, marker="o", ls="", label="node"),
               plt.Line2D([], [], color=SPRING, label="spring")]  # fmt: skip
    handles += [
        plt.Line2D(
            [], [], color=colour, lw=2.6, label=f"muscle of segment {segment}: action index (index of the spring)"
        )
        for segment, colour in enumerate(MUSCLES)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    path = ROOT / "docs" / "images" / "fish.svg"
    figure.savefig(path, metadata={"Date": None})
    print(f"{path}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
