"""Charts of the stability survey, and its tables on the screen."""

from pathlib import Path

import numpy as np

from benchmarks.common.charts import METHOD_STYLE, pyplot, save
from benchmarks.stability.runs import ACCURATE, FINEST, FIXED, INTERVALS_PER_STEP, STIFFNESS, VERDICTS, grid
from fish_env import INTEGRATORS, make_fish

THESIS = "100 to 150 (Tu 1996)"
COLOURS = ("#0072B2", "#F5C26B", "#4A4A4A")  # of VERDICTS


def report(rows: list[dict], table: list[dict]) -> None:
    """Print largest steps over explicit Euler's, and which methods stay bounded at a step of the control interval."""
    for body in dict.fromkeys(row["body"] for row in table):
        print(f"\n{body}, as it is: largest stable step of the manoeuvre; thesis, over explicit Euler: {THESIS}")
        print(f"{'':30}{'measured, ms':>14}{'linear, ms':>12}{'over explicit':>15}{'linear':>9}")
        for row in table:
            if row["body"] == body and row["stiffness"] == 1.0:
                print(f"{row['integrator']:30}{1e3 * row['largest_stable_s']:14.3f}{1e3 * row['linear_theory_s']:12.3f}"
                      f"{row['over_explicit_euler']:15.1f}{row['linear_over_explicit_euler']:9.1f}")  # fmt: skip
    default = make_fish()
    print(f"\n{default.name} at a step of one control interval: error in body lengths by stiffness, X: blown up")
    print(f"{'':30}" + "".join(f"{factor:8g}" for factor in STIFFNESS))
    for name in FIXED:
        line = [row for row in rows if row["body"] == default.name and row["integrator"] == name
                and row["substeps"] == row["intervals"] == 1]  # fmt: skip
        marks = {row["stiffness"]: "X" if row["verdict"] == VERDICTS[2] else f"{row['error']:.2f}" for row in line}
        print(f"{name:30}" + "".join(f"{marks.get(factor, ''):>8}" for factor in STIFFNESS))


def draw_limits(table: list[dict], path: Path) -> None:
    """Largest stable step against stiffness: measured, a marker; linear theory, a dashed line."""
    plt, fish = pyplot(), make_fish()
    implicit = [name for name in FIXED if INTEGRATORS[name].factorisations and name != "semi_implicit"]
    shared = [name for name in FIXED if name not in implicit]
    figure, panels = plt.subplots(1, 2, figsize=(12.5, 6), sharey=True, layout="constrained")
    top = 1e3 * INTERVALS_PER_STEP[0] * fish.control_interval
    for panel, names, title in zip(panels, (shared, implicit), ("explicit, stabilised and Tu's", "linearly implicit"),
                                   strict=True):  # fmt: skip
        for name in names:
            line = [row for row in table if row["body"] == fish.name and row["integrator"] == name]
            colour, marker = METHOD_STYLE.get(name, ("#444444", "P"))
            factor = [row["stiffness"] for row in line]
            hollow = name in ("semi_implicit", "linearly_implicit_water")  # so that what lies beneath is seen
            panel.loglog(factor, [1e3 * row["largest_stable_s"] for row in line], color=colour, marker=marker,
                         markersize=9 if hollow or marker == "*" else 5, fillstyle="none" if hollow else "full",
                         linewidth=1.4, label=name)  # fmt: skip
            theory = [min(1e3 * row["linear_theory_s"], 1.25 * top) for row in line]
            panel.plot(factor, theory, color=colour, linestyle=(0, (4, 3)), linewidth=1.0)
        for value in (fish.control_interval, fish.time_step):
            panel.axhline(1e3 * value, color="#888888", linewidth=0.8, linestyle=":", zorder=0)
        panel.plot([], [], color="#444444", linestyle=(0, (4, 3)), linewidth=1.0, label="linear theory (top: none)")
        panel.set(title=title, xlabel="stiffness over the default fish's (same damping)", xlim=(0.85, 1.2e4))
        panel.grid(alpha=0.2)
        panel.legend(frameon=False, loc="lower left", fontsize=8.5)
    panels[0].text(1.1e4, 1e3 * fish.control_interval * 0.93, "control interval", fontsize=8, ha="right", va="top")
    panels[0].text(1.1e4, 1e3 * fish.time_step * 1.07, "default step", fontsize=8, ha="right", va="bottom")
    panels[0].set_ylabel("largest stable step, ms")
    save(figure, path)


def edges(values) -> np.ndarray:
    """Borders of the cells around increasing values on a logarithmic axis."""
    logarithm = np.log(values)
    middle = 0.5 * (logarithm[1:] + logarithm[:-1])
    ends = 2 * logarithm[0] - middle[0], 2 * logarithm[-1] - middle[-1]
    return np.exp(np.concatenate([ends[:1], middle, ends[1:]]))


def draw_verdicts(plt, figure) -> None:
    """The legend below a map."""
    handles = [plt.Rectangle((0, 0), 1, 1, color=colour) for colour in COLOURS]
    texts = [f"accurate: within {ACCURATE:.0%} of a body length", "bounded but wrong", "blown up"]
    for marker, size, colour, width, text in (
        ("o", 3.5, "white", 0.6, "non-positive pivots met"),
        ("D", 7, "white", 1.6, "the fish's own step"),
    ):
        handles.append(plt.Line2D([], [], ls="", marker=marker, ms=size, color=colour, mec="black", mew=width))
        texts.append(text)
    figure.legend(handles, texts, loc="outside lower center", ncols=5, frameon=False, handlelength=1.2)


def draw_map(rows: list[dict], path: Path) -> None:
    """Accurate, bounded or blown up: a panel a method, step against stiffness; dots where pivots were not positive."""
    plt, fish = pyplot(), make_fish()
    columns = -(-len(FIXED) // 2)
    figure, panels = plt.subplots(2, columns, figsize=(3.1 * columns, 8.6), sharex=True, sharey=True, squeeze=False,
                                  layout="constrained")  # fmt: skip
    coarse = set(grid(FINEST))
    per_interval = {*coarse, *(1 / intervals for intervals in INTERVALS_PER_STEP)}
    steps = sorted(1e3 * fish.control_interval / k for k in per_interval)
    for panel in panels.flat[len(FIXED) :]:
        panel.set_axis_off()
    for panel, name in zip(panels.flat, FIXED, strict=False):
        shade, dotted = np.full((len(steps), len(STIFFNESS)), np.nan), []
        for row in rows:
            if row["body"] == fish.name and row["integrator"] == name:
                close = np.abs(np.log(np.array(steps) / (1e3 * row["step_s"])))
                if close.min() < 1e-4:  # not one of the refinement
                    shade[close.argmin(), STIFFNESS.index(row["stiffness"])] = VERDICTS.index(row["verdict"])
                    if row["non_positive_pivots"]:
                        dotted.append((row["stiffness"], 1e3 * row["step_s"]))
        colours = plt.matplotlib.colors.ListedColormap(COLOURS)
        panel.pcolormesh(edges(STIFFNESS), edges(steps), shade, cmap=colours, vmin=-0.5, vmax=2.5, edgecolors="white",
                         linewidth=0.3, rasterized=True)  # fmt: skip
        if dotted:
            panel.plot(*zip(*dotted, strict=True), "o", color="white", mec="black", mew=0.4, markersize=2.8)
        own = fish.time_step if name == fish.integrator else None
        if own:
            panel.plot(1.0, 1e3 * own, "D", color="white", mec="black", mew=1.6, markersize=7, clip_on=False)
        panel.axhline(1e3 * fish.control_interval, color="black", linewidth=0.7, linestyle=":")
        panel.set(xscale="log", yscale="log")
        panel.set_title(name, fontsize=10)
    for panel in panels[-1]:
        panel.set_xlabel("stiffness over the default's")
    for panel in panels[:, 0]:
        panel.set_ylabel("step, ms (dotted line: control interval)")
    draw_verdicts(plt, figure)
    save(figure, path, dpi=200)
