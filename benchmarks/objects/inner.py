"""The inner layer against the outer: natural frequencies beside simulated ones, and what an impact does to both layers.

python -m benchmarks.objects.inner           the tables and the chart (about 1 min)
python -m benchmarks.objects.inner --draw    the chart again, from the tables
"""

import argparse

import numpy as np

from benchmarks.common.charts import BLUE, GREY, ORANGE, panels, save
from benchmarks.common.tables import RESULTS, read_table, write_csv
from fish_env import Tank
from fish_env.bodies.layers import TwoLayers
from fish_env.bodies.objects import OBJECTS, RING, Layered, make_ring
from fish_env.forces.evaluate import Evaluator
from fish_env.statics import modes
from fish_env.world import VACUUM, make_world

COMMAND = "python -m benchmarks.objects.inner"
OPPOSED = -0.9  # correlation of the layers' displacements, below which they move against each other
SMALL = 1e-6  # m: the amplitude of the outer layer, at which the forces are linear
PERIODS = 8
MASSES = (0.12, 0.72)  # kg: the standard inner layer, and one three times as heavy as the outer


def opposed_mode(thing: Layered) -> tuple[float, np.ndarray]:
    """The lowest natural frequency, Hz, at which the layers move against each other, and its shape (N,3), 1/sqrt(kg).

    Raises:
        ArithmeticError: if there is none.
    """
    free = int(np.count_nonzero(thing.body.inverse_mass))
    for frequency, shape in zip(*modes(thing.body, min(free, 200)), strict=True):
        one, other = shape[thing.outer], shape[thing.inner]
        if np.sum(one * other) <= OPPOSED * np.sqrt(np.sum(one * one) * np.sum(other * other)):
            return float(frequency), shape
    raise ArithmeticError(f"no mode of the {thing.name} moves its layers against each other")


def twist_rate(nodes: int, chosen: TwoLayers) -> float:
    """Angular frequency, 1/s, at which the layers of a ring turn against each other, in closed form.

    A turn by a small angle stretches the 2 n shear springs only, each by R r sin(2 pi / n) / length times the angle.
    """
    outer, inner, angle = chosen.radius, chosen.inner_radius, 2 * np.pi / nodes
    arm = outer * inner * np.sin(angle) / np.sqrt(outer**2 + inner**2 - 2 * outer * inner * np.cos(angle))
    inertia = 1 / (chosen.mass * outer**2) + 1 / (chosen.inner_mass * inner**2)
    return float(np.sqrt(2 * nodes * chosen.shear_stiffness * arm**2 * inertia))


def damping(thing: Layered, shape) -> float:
    """Rate of decay of a mode, 1/s, to first order in the damping: half of u^T C u, C the damping matrix."""
    body = thing.body
    evaluator = Evaluator(body, VACUUM)
    slope = evaluator.jacobian(body.springs.rest_length, body.position, np.zeros_like(body.position))[1]
    return float(0.5 * shape.ravel() @ slope @ shape.ravel())


def swung(thing: Layered, frequency: float, shape, integrator="rk4", steps=400) -> tuple[np.ndarray, np.ndarray]:
    """Times (K,) s and amplitudes (K,) of a mode, over SMALL, in a simulation that starts with its displacement."""
    body = thing.body
    size = SMALL / np.linalg.norm(shape[thing.outer], axis=1).max()
    tank = Tank(thing, integrator=integrator, dt=1 / (frequency * steps), water=VACUUM, threads=1)
    tank.position[0] += size * shape
    time, amount = [0.0], [1.0]
    for _ in range(PERIODS * steps):
        tank.advance(1)
        time.append(float(tank.time[0]))
        amount.append(np.sum(body.mass[:, None] * shape * (tank.position[0] - body.position)) / size)
    return np.array(time), np.array(amount)


def measured(time, amount) -> tuple[float, float]:
    """Frequency, Hz, and rate of decay, 1/s, of a decaying oscillation: its zeros, and its values between them."""
    at = np.flatnonzero(np.signbit(amount[1:]) != np.signbit(amount[:-1]))
    zeros = time[at] - amount[at] * (time[at + 1] - time[at]) / (amount[at + 1] - amount[at])
    half = np.polyfit(np.arange(len(zeros)), zeros, 1)[0]
    peaks = [np.abs(amount[a:b]).max() for a, b in zip(at[:-1] + 1, at[1:] + 1, strict=True)]
    return 0.5 / half, -np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0] / half


def compared(kind: str) -> dict:
    """A row: the opposed mode's natural frequency, and frequency and decay measured without damping and with it."""
    row = {"object": kind}
    for name, time in (("undamped", 0.0), ("damped", 0.002)):
        thing = OBJECTS[kind].make(relaxation_time=time)
        frequency, shape = opposed_mode(thing)
        found, decay = measured(*swung(thing, frequency, shape))
        rate = 2 * np.pi * frequency
        lost = damping(thing, shape)
        row |= {f"{name}_hz": np.sqrt(rate**2 - lost**2) / (2 * np.pi), f"{name}_measured_hz": found,
                f"{name}_decay": lost, f"{name}_measured_decay": decay}  # fmt: skip
    return row


def thrown(inner_mass: float, speed=2.5) -> list[dict]:
    """Rows over time: a ring flies into a wall; the mean velocity of each layer along the wall's normal, m/s."""
    thing = make_ring(inner_mass=inner_mass)
    tank = Tank(thing, water=make_world(planes=[((-1.0, 0.0, 0.0), -0.11, 0.5)]), threads=1)
    tank.velocity[0, :, 0] = speed
    rows = []
    for _ in range(round(0.2 / tank.dt)):
        tank.advance(1)
        v = tank.velocity[0, :, 0]
        rows.append({"inner_mass": inner_mass, "time": float(tank.time[0]), "outer": v[thing.outer].mean(),
                     "inner": v[thing.inner].mean()})  # fmt: skip
    return rows


def measure() -> None:
    """Write the tables."""
    write_csv("song_inner.csv", [compared(kind) for kind in ("ring", "sphere", "uniform sphere")], COMMAND)
    write_csv("song_inner_impact.csv", [row for mass in MASSES for row in thrown(mass)], COMMAND)


def draw() -> None:
    """The mode's shape, its oscillation, and the layers' velocities through an impact."""
    figure, (shape_panel, swing_panel, impact) = panels(3, (13, 4.2))
    thing = make_ring(relaxation_time=0.0)
    frequency, shape = opposed_mode(thing)
    x, along = thing.body.position, 0.02 * shape / np.linalg.norm(shape[thing.outer], axis=1).max()
    for layer, colour in ((thing.outer, BLUE), (thing.inner, ORANGE)):
        loop = np.append(layer, layer[:1])
        shape_panel.plot(x[loop, 0], x[loop, 1], color=GREY, linewidth=0.8)
        shape_panel.quiver(*x[layer, :2].T, *along[layer, :2].T, color=colour, angles="xy", scale_units="xy", scale=1)
    shape_panel.set(aspect="equal", title=f"shape of the mode of {frequency:.2f} Hz", xlim=(-0.13, 0.13))
    for time, colour, label in ((0.0, GREY, "no damping"), (0.002, BLUE, "damped by 2 ms")):
        t, amount = swung(make_ring(relaxation_time=time), frequency, shape)
        swing_panel.plot(t, amount, color=colour, label=label, linewidth=1.1)
        rate = twist_rate(12, RING)
        lost = 0.5 * time * rate**2
        turn = np.sqrt(rate**2 - lost**2)
        theory = np.exp(-lost * t) * (np.cos(turn * t) + lost / turn * np.sin(turn * t))
        swing_panel.plot(t[::40], theory[::40], color=colour, linestyle="", marker="o", markersize=3)
    swing_panel.set(
        title="turning against each other (dots: closed form)", xlabel="s", ylabel="angle over that at start"
    )
    swing_panel.legend(frameon=False, fontsize=8)
    rows = read_table("song_inner_impact.csv")
    for mass, line in zip(MASSES, (":", "-"), strict=True):
        part = [row for row in rows if row["inner_mass"] == mass]
        for layer, colour in (("outer", BLUE), ("inner", ORANGE)):
            impact.plot([row["time"] for row in part], [row[layer] for row in part], color=colour, linestyle=line,
                        linewidth=1.1, label=f"{layer} layer, inner one {mass} kg")  # fmt: skip
    impact.axhline(0.0, color="black", linewidth=0.6)
    impact.set(title="a ring flies into a wall", xlabel="s", ylabel="mean velocity towards the wall, m/s")
    impact.legend(frameon=False, fontsize=8)
    save(figure, RESULTS / "song_inner.svg")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="the chart again, from the tables")
    if not parser.parse_args().draw:
        measure()
    draw()
    print(f"written to {RESULTS}/song_inner*.csv and the chart beside them")


if __name__ == "__main__":
    main()
