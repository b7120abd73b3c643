"""Is the finite-element body right? A beam against the theory of beams, large bending, recovery, damping.

    python -m benchmarks.finite_elements            everything (about 5 min): CSVs, charts, and the bars
    python -m benchmarks.finite_elements --draw     the charts again, from the CSVs
    python -m benchmarks.finite_elements --bars     the CSVs against their bars, exit 1 if one is missed

The beam is clamped at x = 0 and ten times as long as thick, of a material with Poisson's ratio 0, so that nothing but
its elements keeps it from being the beam of the theory. Cells are cubes, split so that the mesh mirrors itself.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))  # so that it runs as a script as well as with -m

import argparse
import csv

import numpy as np
from scipy.integrate import solve_bvp

from benchmarks.provenance import RESULTS, write_csv
from fish_env import Tank, make_world, statics
from fish_env.bodies.fish import ElasticObject
from fish_env.bodies.mesh import box, lumped_mass
from fish_env.body import Body, hold, make_body
from fish_env.elements import make_tets
from fish_env.forces.evaluate import Evaluator
from fish_env.world import VACUUM

THICK, RATIO, YOUNG, DENSITY = 0.02, 10, 2e5, 1000.0
LENGTH = RATIO * THICK
REFINED = (2, 4, 8, 16, 32)
SHEAR = 0.6 / RATIO**2  # by which Timoshenko's beam is softer than Euler's: 3 EI / (5/6 G A L^2), G = E/2
CLAMPED = 1.8751040687119611  # cos b cosh b = -1
BENDING = 8  # cells through the thickness of the beam that is bent far
LOADS = tuple(np.arange(1, 21) / 2)  # P L^2 / E I
SHOWN = 10.0  # the load at which shapes are drawn
COMMAND = "python -m benchmarks.finite_elements"
IMAGES = Path(__file__).parent.parent / "docs" / "images"
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#999999"


def solid(position, nodes, poisson=0.0, rule="quarter", young=YOUNG, **options) -> Body:
    """A body of tetrahedra alone."""
    mass = lumped_mass(position, nodes, DENSITY, rule)
    material = make_tets(position, nodes, young, poisson, **options)
    return make_body(position, mass, [], [], [], [], [], tets=material)


def cantilever(n: int, rule="quarter", **options) -> Body:
    """The beam with n cells through its thickness and two across its width, which is two cells wide."""
    position, nodes = box((LENGTH, 2 * THICK / n, THICK), (RATIO * n, 2, n), mirrored=True)
    return hold(solid(position, nodes, rule=rule, **options), position[:, 0] == 0.0)


def rigidity(body: Body) -> float:
    """E I of the beam, N m2, for bending along z."""
    return YOUNG * np.ptp(body.position[:, 1]) * THICK**3 / 12


def tip_load(body: Body, force: float) -> np.ndarray:
    """A force along z, N, shared by the nodes of the free end as evenly spread pressure would be, (N,3)."""
    x, load = body.position, np.zeros_like(body.position)
    end = np.isclose(x[:, 0], LENGTH, rtol=0, atol=1e-9 * LENGTH)
    weight = np.where(np.abs(np.abs(x[:, 2]) - THICK / 2) < 1e-9 * THICK, 0.5, 1.0) * end
    weight *= np.where(np.abs(np.abs(x[:, 1]) - np.abs(x[:, 1]).max()) < 1e-9 * THICK, 0.5, 1.0)
    load[:, 2] = force * weight / weight.sum()
    return load


def tip(body: Body, x) -> np.ndarray:
    """Middle of the free end, (3,) m, of a beam at x (N,3)."""
    return x[np.argmin(np.linalg.norm(body.position - [LENGTH, 0.0, 0.0], axis=1))]


def first_frequency(body: Body) -> float:
    """Of Euler's beam, Hz."""
    line_density = DENSITY * np.ptp(body.position[:, 1]) * THICK
    return CLAMPED**2 / LENGTH**2 * np.sqrt(rigidity(body) / line_density) / (2.0 * np.pi)


def vertical(body: Body, count=4) -> tuple[float, np.ndarray]:
    """Lowest frequency of the beam's bending along z, Hz, and its shape (N,3)."""
    found, shapes = statics.modes(body, count)
    across = np.einsum("n,cn->c", body.mass, shapes[:, :, 2] ** 2) > 0.5
    first = int(np.argmax(across))
    return float(found[first]), shapes[first]


def converging() -> list[dict]:
    """Deflection under a small end load and first frequency over those of Euler's beam, as the mesh is refined."""
    rows = []
    for n in REFINED:
        body = cantilever(n)
        force = 1e-4 * rigidity(body) / LENGTH**2
        deflection = tip(body, statics.linear_deflection(body, tip_load(body, force)))[2]
        even = cantilever(n, rule="uniform")
        rows.append({
            "cells": n, "nodes": len(body.mass), "tetrahedra": len(body.tets.nodes),
            "deflection": deflection / (force * LENGTH**3 / (3.0 * rigidity(body))),
            "frequency_quarter": vertical(body)[0] / first_frequency(body),
            "frequency_uniform": vertical(even)[0] / first_frequency(body),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def order(cells, error) -> float:
    """Slope of the errors' line of best fit against the size of the elements, both logarithmic."""
    return float(-np.polyfit(np.log(cells), np.log(np.abs(error)), 1)[0])


def elastica(load: float, points=201) -> np.ndarray:
    """Shape (points,2), in lengths, of a thin beam clamped at one end under a force P L^2 / E I of fixed direction.

    The angle t along the beam obeys t'' = -load cos t, t(0) = 0, t'(1) = 0 (Euler 1744).
    """
    s = np.linspace(0.0, 1.0, points)
    found = solve_bvp(
        lambda s, y: np.stack([y[1], -load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]),
        lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
        s, np.zeros((4, points)), tol=1e-10, max_nodes=100_000,
    )  # fmt: skip
    return found.sol(s)[2:].T


def volume(body: Body, x) -> float:
    """Volume of all tetrahedra at x, over that at rest."""
    edges = x[body.tets.nodes[:, 1:]] - x[body.tets.nodes[:, :1]]
    return float(np.linalg.det(edges).sum() / 6 / body.tets.volume.sum())


def bend(body: Body, loads):
    """Positions (N,3) of the beam at rest under each end load P L^2 / E I, one after the other."""
    x = None
    for load in loads:
        x = statics.equilibrium(body, start=x, load=tip_load(body, load * rigidity(body) / LENGTH**2))
        yield load, x


def bending() -> list[dict]:
    """Tip and volume of the beam, corotational and linear, under every load, and the tip of the elastica."""
    rows, shapes = [], {}
    turned, fixed = (cantilever(BENDING, corotational=choice) for choice in (True, False))
    for (load, x), (_, y) in zip(bend(turned, LOADS), bend(fixed, LOADS), strict=True):
        wanted = elastica(load)[-1]
        here, there = tip(turned, x) / LENGTH, tip(fixed, y) / LENGTH
        rows.append({
            "load": load, "elastica_x": wanted[0], "elastica_z": wanted[1],
            "corotational_x": here[0], "corotational_z": here[2], "corotational_volume": volume(turned, x),
            "linear_x": there[0], "linear_z": there[2], "linear_volume": volume(fixed, y),
        })  # fmt: skip
        shapes[load] = x, y
    middle = np.flatnonzero(np.abs(turned.position[:, 1]) < 1e-9)
    outline = [
        {"x": p[0], "z": p[2], "corotational_x": x[0], "corotational_z": x[2], "linear_x": y[0], "linear_z": y[2]}
        for p, x, y in zip(*(a[middle] / LENGTH for a in (turned.position, *shapes[SHOWN])), strict=True)
    ]
    write_csv("finite_elements_shapes.csv", outline, COMMAND)
    return rows


def loose(body: Body, step: float, name="body") -> ElasticObject:
    """What a tank moves."""
    size = float(np.ptp(body.position, axis=0).max())
    return ElasticObject(name=name, body=body, length=size, time_step=step, control_interval=step)


def damped_block(cells, edge=0.05, poisson=0.3) -> tuple[Body, float]:
    """A free block of cubes, its lowest vibration critically damped, and that vibration's angular frequency, 1/s."""
    position, nodes = box(edge * np.array(cells), cells, mirrored=True)
    lowest = 2.0 * np.pi * statics.modes(solid(position, nodes, poisson), 7)[0][6]
    return solid(position, nodes, poisson, relaxation_time=2.0 / lowest), float(lowest)


def deformation(body: Body, x) -> np.ndarray:
    """Deformation gradients (T,3,3) of the elements at x (N,3)."""
    return np.einsum("tac,tad->tcd", x[body.tets.nodes], body.tets.gradient)


def stretch(body: Body, x) -> np.ndarray:
    """Over its natural length, (T,): how long every element is, along its longest direction, the others being 1."""
    return np.sqrt(np.maximum((deformation(body, x) ** 2).sum(axis=(1, 2)) - 2.0, 0.0))


def elastic_energy(body: Body, x) -> float:
    """Of all elements, J."""
    return Evaluator(body, VACUUM).energies(body.springs.rest_length, x, np.zeros_like(x))["tets"]


def ruined(body: Body, how: str, seed: int) -> np.ndarray:
    """A start (N,3) m: the body "reflected" or "flattened" in the plane z = 0 with noise, or "scrambled" at random."""
    rng = np.random.default_rng(seed)
    x, size = body.position, np.ptp(body.position[:, 2])
    noise = 0.01 * size * rng.standard_normal(x.shape)
    if how == "scrambled":  # as far as no element is stretched to more than twice its length
        x = rng.uniform(-0.5, 0.5, x.shape) * np.ptp(x, axis=0)
        while not (stretch(body, x) <= 2.0).all():
            x *= 0.98
        return x
    return x * [1.0, 1.0, {"reflected": -1.0, "flattened": 0.0}[how]] + noise


def out_of_shape(body: Body, x) -> float:
    """Largest distance of a node from where it is at rest, over the body's size, once x is turned to fit best."""
    here, there = (a - np.average(a, axis=0, weights=body.mass) for a in (x, body.position))
    u, _, vt = np.linalg.svd((here * body.mass[:, None]).T @ there)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.linalg.norm(here @ turn - there, axis=1).max() / np.ptp(body.position, axis=0).max())


STEPS = {"linearly_implicit": 0.05, "leapfrog_chebyshev": 0.02}


def recover(body: Body, lowest: float, start, method: str, most=400.0) -> dict:
    """Let the damped body go from a start, in thin air, until it has its shape again: how long, and how well.

    Times and steps (STEPS) are in units of 1 / lowest, the lowest vibration's angular frequency.
    """
    step = STEPS[method]
    air = make_world(viscosity=0.2 * lowest * float(body.mass.mean()))
    tank = Tank(loose(body, step / lowest), 1, method, step / lowest, air)
    tank.position[0] = start
    inverted = float((np.linalg.det(deformation(body, start)) < 0).mean())
    while tank.alive[0] and tank.time[0] * lowest < most and not out_of_shape(body, tank.position[0]) < 1e-6:
        tank.advance(round(1.0 / step))
    return {
        "inverted_at_start": inverted, "time": float(tank.time[0] * lowest),
        "out_of_shape": out_of_shape(body, tank.position[0]),
        "energy_kept": elastic_energy(body, tank.position[0]) / elastic_energy(body, start),
        "failure": tank.failure[0],
    }  # fmt: skip


def recovering() -> list[dict]:
    """Ruined blocks under two methods, five seeds each."""
    rows = []
    for cells in ((2, 2, 2), (4, 4, 4), (12, 2, 2)):
        body, lowest = damped_block(cells)
        for how in ("reflected", "flattened", "scrambled"):
            for method in ("linearly_implicit", "leapfrog_chebyshev"):
                for seed in range(5):
                    result = recover(body, lowest, ruined(body, how, seed), method)
                    rows.append({"cells": "x".join(map(str, cells)), "start": how, "method": method, "seed": seed}
                                | result)  # fmt: skip
                    print(rows[-1], flush=True)
    return rows


def ringing(body: Body, method: str, periods: float, steps_a_period: int, amplitude=1e-4):
    """Displacements along the first mode, over the first one, and energies, J, of the beam let go, at every step.

    `periods` and steps are those of the mode. Both arrays have an entry a step, and one for the start.
    """
    frequency, shape = vertical(body)
    scale = amplitude * LENGTH / np.abs(shape).max()
    step = 1.0 / (frequency * steps_a_period)
    tank = Tank(loose(body, step), 1, method, step)
    tank.position[0] += scale * shape
    places, energies = [], []
    for _ in range(round(periods * steps_a_period) + 1):
        x, v = tank.position[0], tank.velocity[0]
        places.append(np.einsum("n,nk,nk->", body.mass, shape, x - body.position) / scale)
        energies.append(0.5 * np.einsum("n,nk,nk->", body.mass, v, v) + elastic_energy(body, x))
        tank.advance(1)
    return np.array(places), np.array(energies)


def rates_of(places, steps_a_period: int) -> tuple[float, float]:
    """Angular frequency and decay rate, times a period, of a damped vibration (Prony's method).

    Samples at equal intervals obey q'' = a q' - b q, which is exact for any method that is linear: no fit of a curve.
    """
    stride = max(1, steps_a_period // 8)
    q = places[::stride]
    a, b = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    exponent = np.log(np.roots([1.0, -a, b]).astype(complex)[0]) * steps_a_period / stride
    return float(abs(exponent.imag)), float(-exponent.real)


def implicit_euler(relaxation: float, steps_a_period: int) -> tuple[float, float]:
    """As `rates_of`, of implicit Euler on a vibration whose relaxation time is given in periods."""
    turn = 2.0 * np.pi / steps_a_period
    damping = turn * 2.0 * np.pi * relaxation
    exponent = np.log(np.roots([1.0 + damping + turn**2, -2.0 - damping, 1.0]).astype(complex)[0]) * steps_a_period
    return float(abs(exponent.imag)), float(-exponent.real)


def vibrating(n=2) -> list[dict]:
    """The first mode in time: its frequency and decay over what they should be, and the energy left after a period."""
    rows = []
    plain = cantilever(n)
    period = 1.0 / vertical(plain)[0]
    for relaxation in (0.0, 0.01):
        body = cantilever(n, relaxation_time=relaxation * period)
        wanted = 0.5 * relaxation * (2.0 * np.pi) ** 2  # s omega^2 / 2, a period
        for method, steps in (
            *(("linearly_implicit", steps) for steps in (10, 20, 50, 100, 200, 500, 1000, 2000)),
            *(("leapfrog_chebyshev", steps) for steps in (50, 100, 200, 500)),
        ):
            places, energies = ringing(body, method, 3.0, steps)
            frequency, rate = rates_of(places, steps)
            rows.append({
                "relaxation_time": relaxation, "method": method, "steps_a_period": steps,
                "frequency": frequency / np.sqrt((2.0 * np.pi) ** 2 - wanted**2),
                "decay": rate, "decay_wanted": wanted,
                "decay_of_implicit_euler": implicit_euler(relaxation, steps)[1],
                "energy_after_a_period": energies[steps] / energies[0],
            })  # fmt: skip
            print(rows[-1], flush=True)
    return rows


def figure(columns: int, width=11.0):
    """A row of panels, and what saves it without a date."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    drawn, panels = plt.subplots(1, columns, figsize=(width, 4.2), layout="constrained")
    for panel in panels:
        panel.grid(alpha=0.2)

    def save(name):
        drawn.savefig(IMAGES / name, metadata={"Date": None})
        plt.close(drawn)

    return panels, save


def draw_beam() -> None:
    """Errors against the size of the elements."""
    rows = read("finite_elements_beam.csv")
    (left, right), save = figure(2)
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
    save("finite_elements_beam.svg")


def draw_bending() -> None:
    """Shapes of both beams under the largest load drawn, and volumes against the load."""
    rows, outline = read("finite_elements_bending.csv"), read("finite_elements_shapes.csv")
    (left, right), save = figure(2)
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
    save("finite_elements_bending.svg")


def draw_vibration() -> None:
    """Decay and frequency of the first mode against the step."""
    rows = read("finite_elements_vibration.csv")
    (left, right), save = figure(2)
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
    save("finite_elements_vibration.svg")


def read(name: str) -> list[dict]:
    """The rows of a CSV, numbers as numbers."""

    def number(text):
        try:
            return float(text)
        except ValueError:
            return text

    lines = (RESULTS / name).read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [{key: number(value) for key, value in row.items()} for row in rows]


def bars() -> bool:
    """Print what was measured beside its bar; True if all are met."""
    beam, bent = read("finite_elements_beam.csv"), read("finite_elements_bending.csv")
    back, rung = read("finite_elements_recovery.csv"), read("finite_elements_vibration.csv")
    cells, finest, last = [row["cells"] for row in beam], beam[-1], bent[-1]
    deflections = order(cells[1:], [1.0 + SHEAR - row["deflection"] for row in beam[1:]])
    apart = max(
        np.hypot(row["corotational_x"] - row["elastica_x"], row["corotational_z"] - row["elastica_z"]) for row in bent
    )
    slow = [row for row in rung if row["method"] == "linearly_implicit" and row["steps_a_period"] == 2000]
    fine = [row for row in rung if row["method"] == "leapfrog_chebyshev" and row["steps_a_period"] == 500]
    large = next(row for row in rung if row["method"] == "linearly_implicit")
    found = (
        ("order of the deflection from 4 cells on", deflections, deflections > 1.8, "above 1.8"),
        *(
            (f"{name} over Euler's, {int(cells[-1])} cells", finest[name], abs(finest[name] - 1.0) < 0.02, "1 +- 0.02")
            for name in ("deflection", "frequency_quarter", "frequency_uniform")
        ),
        ("tip of the bent beam from the elastica's, lengths", apart, apart < 0.03, "below 0.03"),
        *(
            (f"volume under the largest load, {kind}", last[f"{kind}_volume"], met, bar)
            for kind, met, bar in (
                ("corotational", abs(last["corotational_volume"] - 1.0) < 0.03, "1 +- 0.03"),
                ("linear", abs(last["linear_volume"] - 1.0) > 0.2, "off by more than 0.2"),
            )
        ),
        *(
            (f"{start} blocks back in shape to 1e-6, of {len(mine)}", sum(mine), all(mine), "all")
            for start in ("reflected", "flattened", "scrambled")
            for mine in [[row["out_of_shape"] < 1e-6 and not row["failure"] for row in back if row["start"] == start]]
        ),
        ("frequency of implicit Euler at 2000 steps", slow[0]["frequency"], abs(slow[0]["frequency"] - 1) < 1e-3,
         "1 +- 0.001"),
        ("energy after a period at 10 steps", large["energy_after_a_period"], large["energy_after_a_period"] < 0.1,
         "below 0.1"),
        ("decay over s w^2 / 2", fine[1]["decay"] / fine[1]["decay_wanted"],
         abs(fine[1]["decay"] / fine[1]["decay_wanted"] - 1.0) < 0.01, "1 +- 0.01"),
    )  # fmt: skip
    for name, value, met, bar in found:
        print(f"{name}: {value:.6g}, bar {bar}: {'met' if met else 'MISSED'}")
    return all(met for _, _, met, _ in found)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--draw", action="store_true", help="draw the charts again from the CSVs")
    action.add_argument("--bars", action="store_true", help="compare the CSVs with the bars, exit 1 if one is missed")
    arguments = parser.parse_args()
    if not (arguments.draw or arguments.bars):
        for name, measure in (("vibration", vibrating), ("recovery", recovering), ("bending", bending),
                              ("beam", converging)):  # fmt: skip
            write_csv(f"finite_elements_{name}.csv", measure(), COMMAND)
    if not arguments.bars:
        for chart in (draw_beam, draw_bending, draw_vibration):
            chart()
        print(f"written to {RESULTS} and {IMAGES}")
    return 0 if arguments.draw or bars() else 1


if __name__ == "__main__":
    sys.exit(main())
