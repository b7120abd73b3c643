"""Charts of the checks of the finite-element body."""

import numpy as np

from benchmarks.accuracy.beam_bending import SHOWN, elastica
from benchmarks.common.beam import SHEAR
from benchmarks.common.charts import BLUE, GREY, ORANGE, panels, save
from benchmarks.common.tables import IMAGES, read_table


def draw_beam() -> None:
    """Errors against the size of the elements."""
    rows = read_table("finite_elements_beam.csv")
    figure, (left, right) = panels(2)
    cells = [row["cells"] for row in rows]
    left.loglog(cells, [abs(1.0 + SHEAR - row["deflection"]) for row in rows], "o-", color=BLUE, label="deflection")
    left.set_ylabel("error of the tip's deflection, of Timoshenko's")
    for rule, colour in (("quarter", BLUE), ("uniform", ORANGE)):
        error = [abs(row[f"frequency_{rule}"] - 1.0) for row in rows]
        right.loglog(cells, error, "o-", color=colour, label=f"masses: {rule}")
    right.axhline(0.02, color=GREY, linestyle=":", label="2 %")
    right.set_ylabel("difference of the first frequency from Euler's")
    for panel in (left, right):
        panel.loglog(cells, [1.7 / n**2 for n in cells], "--", color=GREY, label="second order")
        panel.set_xticks(cells, [f"{n:g}" for n in cells])
        panel.set_xticks([], minor=True)
        panel.set(xlabel="cells through the thickness")
        panel.legend(frameon=False)
    save(figure, IMAGES / "finite_elements_beam.svg")


def draw_bending() -> None:
    """Shapes of both beams under the largest load drawn, and volumes against the load."""
    rows, outline = read_table("finite_elements_bending.csv"), read_table("finite_elements_shapes.csv")
    figure, (left, right) = panels(2)
    curve = elastica(SHOWN)
    for kind, colour in (("linear", ORANGE), ("corotational", BLUE)):
        x, z = (np.array([point[f"{kind}_{axis}"] for point in outline]) for axis in "xz")
        left.plot(x, z, ".", markersize=2.5, color=colour, label=kind)
    left.plot(*curve.T, color="black", linewidth=1.0, label="elastica")
    left.set(xlabel="x over the length", ylabel="z over the length", aspect="equal", xlim=(-0.2, 3.6))
    left.set_title(f"end load {SHOWN:g} EI/L$^2$: nodes of the middle plane", fontsize=10)
    left.legend(frameon=False, loc="center right", markerscale=4)
    load = [row["load"] for row in rows]
    for kind, colour in (("linear", ORANGE), ("corotational", BLUE)):
        right.semilogy(load, [abs(row[f"{kind}_volume"] - 1.0) for row in rows], ".-", color=colour, label=kind)
    right.axhline(0.2, color=GREY, linestyle=":")
    right.axhline(0.03, color=GREY, linestyle="--")
    right.set(xlabel="end load, EI/L$^2$", ylabel="change of volume, of that at rest")
    right.legend(frameon=False)
    save(figure, IMAGES / "finite_elements_bending.svg")


def draw_vibration() -> None:
    """Decay and frequency of the first mode against the step."""
    rows = read_table("finite_elements_vibration.csv")
    figure, (left, right) = panels(2)
    for method, colour in (("linearly_implicit", ORANGE), ("leapfrog_chebyshev", BLUE)):
        for relaxation, style, text in ((0.0, "o-", "undamped"), (0.01, "s--", "damped")):
            mine = [row for row in rows if row["method"] == method and row["relaxation_time"] == relaxation]
            steps = [row["steps_a_period"] for row in mine]
            label = f"{method}, {text}"
            left.semilogx(steps, [row["energy_after_a_period"] for row in mine], style, color=colour, label=label)
            error = [abs(row["frequency"] - 1.0) for row in mine]
            right.loglog(steps, error, style, color=colour, label=label)
    left.set(xlabel="steps a period", ylabel="energy left after a period")
    right.set(xlabel="steps a period", ylabel="error of the frequency")
    left.legend(frameon=False, fontsize=8)
    save(figure, IMAGES / "finite_elements_vibration.svg")
