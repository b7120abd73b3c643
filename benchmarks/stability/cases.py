"""Cases: fish driven through given commands, the worst of them stored in `tests/worst.npz`, and done again."""

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.common.measures import stretch_and_energy
from benchmarks.common.problems import scaled
from benchmarks.common.tables import ROOT
from benchmarks.stability.mistreatment import LEVELS, Family
from fish_env import Fish, Tank, make_fish

WORST = ROOT / "tests" / "worst.npz"
STORED = 2  # worst sequences of a batch considered, and of each kind of failure of a body stored
EXPLAINED = 50  # failures of a family that are run again with RK4


def drive(tank: Tank, goals: np.ndarray, watch: Callable[[Tank], None] | None = None) -> dict[str, np.ndarray]:
    """Drive a tank through goals (K,B,M): worst stretch, when that was, highest energy and when a fish failed, (B,).

    `watch` is told of every control interval.
    """
    substeps = round(tank.fish.control_interval / tank.dt)
    stretch, when, highest, failed = np.zeros((4, tank.num_fish))
    failed[:] = np.inf
    for k, goal in enumerate(goals):
        tank.drive(goal / LEVELS, substeps)
        failed[~tank.alive & np.isinf(failed)] = k
        if watch is not None:
            watch(tank)
        longest, energy = stretch_and_energy(tank)
        when[longest > stretch] = k
        stretch = np.maximum(stretch, longest)
        highest = np.maximum(highest, energy)
        if k % 25 == 0 and not tank.alive.any():
            break
    return {"stretch": stretch, "when": when, "energy": highest, "failed": failed}


class Settings(NamedTuple):
    """How fish are moved: method, steps a control interval, and what refines them."""

    integrator: str
    substeps: int
    refine: float = np.inf


def own_settings(fish: Fish) -> Settings:
    """Method, steps a control interval and refinement that a fish has of its own.

    Raises:
        ValueError: if the fish's control interval is not a whole number of its steps.
    """
    steps = fish.control_interval / fish.time_step
    if abs(steps - round(steps)) > 1e-9:
        raise ValueError(f"{fish.name}: a control interval is {steps:g} steps; give a whole number")
    return Settings(fish.integrator, round(steps), fish.refine)


def tank_at(fish: Fish, how: Settings, position, velocity, threads=None) -> Tank:
    """A tank with fish at these positions and velocities (B,N,3)."""
    dt = fish.control_interval / how.substeps
    tank = Tank(fish, len(position), how.integrator, dt, fish.water, threads, refine=how.refine)
    tank.position[:], tank.velocity[:] = position, velocity
    return tank


def case_of(fish, family, how: Settings, position, velocity, goals, found, i) -> dict:
    """All it takes to repeat fish i of a batch up to its worst moment, or a little beyond where it failed."""
    end = int(found["failed"][i] if np.isfinite(found["failed"][i]) else found["when"][i]) + 2
    return {
        "body": fish.name, "family": family.name, "stiffness": family.stiffness, "mass": family.mass,
        **how._asdict(), "stretch": float(found["stretch"][i]),
        "failure": "", "position": position[i], "velocity": velocity[i], "goals": goals[:end, i],
    }  # fmt: skip


def replay(case: dict, how: Settings | None = None, copies=1, threads=1) -> tuple[Tank, np.ndarray]:
    """Repeat a stored case, or move it otherwise, `copies` equal fish: the tank at the end, and their worst stretch."""
    how = how or Settings(case["integrator"], case["substeps"], case.get("refine", np.inf))
    fish = scaled(make_fish(case["body"]), stiffness=case["stiffness"], mass=case["mass"])
    start = [np.repeat(case[name][None], copies, 0) for name in ("position", "velocity")]
    tank = tank_at(fish, how, *start, threads)
    return tank, drive(tank, np.repeat(case["goals"][:, None], copies, 1))["stretch"]


def explained(fish, substeps, position, velocity, goals, failed) -> int:
    """How many of these fish RK4 at an eighth of the step loses too, each by half again the time it failed at."""
    tank = tank_at(fish, Settings("rk4", 8 * substeps), position, velocity)
    found = drive(tank, goals[: int(1.5 * failed.max()) + 10])["failed"]
    tank.close()
    return int((found <= 1.5 * failed + 10).sum())


class Tally:
    """Count of what becomes of the fish of a family, batch by batch.

    Args:
        fish: of the family.
        family: how they are mistreated.
        how: how they are moved.
        explained: how many failures are run again with RK4.
    """

    def __init__(self, fish: Fish, family: Family, how: Settings, explained=EXPLAINED):
        self.fish, self.family, self.how, self.explained = fish, family, how, explained
        self.count, self.rerun, self.both, self.stretch, self.energy = 0, 0, 0, 0.0, 0.0
        self.reasons: Counter[str] = Counter()

    def drive(self, start, goals: np.ndarray, watch=None) -> tuple[Tank, dict[str, np.ndarray], np.ndarray]:
        """Drive a batch from positions and velocities (B,N,3); the tank, what `drive` found, and whom RK4 was tried on.

        Failed fish are run again with RK4.
        """
        tank = tank_at(self.fish, self.how, *start)
        found = drive(tank, goals, watch)
        self.count += tank.num_fish
        self.reasons.update(tank.failure[~tank.alive])
        self.stretch = max(self.stretch, found["stretch"].max())
        self.energy = max(self.energy, found["energy"][tank.alive].max(initial=0.0))
        lost = np.flatnonzero(~tank.alive)[: self.explained - self.rerun]
        if lost.size:
            again = (*(part[lost] for part in start), goals[:, lost], found["failed"][lost])
            self.rerun += lost.size
            self.both += explained(self.fish, self.how.substeps, *again)
        return tank, found, lost

    def row(self, usual: float) -> dict:
        """Row of the table; `usual` is the highest energy, J, of a fish that swims the gait."""
        lost = self.lost()
        again = {name: lost.pop(name) for name in ("rerun_with_rk4", "rk4_fails_too")}
        return {
            "body": self.fish.name, "family": self.family.name, "integrator": self.how.integrator,
            "step_s": self.fish.control_interval / self.how.substeps, "refine": self.how.refine,
            **lost, "worst_stretch": round(float(self.stretch), 4),
            "peak_energy_over_gait": round(float(self.energy / usual), 2) if self.count > lost["failures"] else np.nan,
            **again,
        }  # fmt: skip

    def lost(self) -> dict:
        """How many fish there were, and how many failed why."""
        return {
            "fish": self.count, "failures": self.reasons.total(),
            "reasons": "; ".join(f"{count} {reason}" for reason, count in self.reasons.items()),
            "rerun_with_rk4": self.rerun, "rk4_fails_too": self.both,
        }  # fmt: skip


def store(cases: list[dict], path: Path = WORST) -> None:
    """Write the worst survivor of each kind of mistreatment and the first of each kind of failure, for each body.

    Replaces what is there.
    """
    chosen = {}
    for case in sorted(cases, key=lambda case: (len(case["goals"]) if case["failure"] else 0, -case["stretch"])):
        kind = case["family"].split(",")[0].split(" ")[0]  # all stiffnesses and masses are one kind, all searches too
        chosen.setdefault((case["body"], case["failure"], kind), case)
    failures, arrays = Counter(), {}
    for number, ((body, failure, kind), case) in enumerate(sorted(chosen.items(), key=lambda item: item[0])):
        failures[body, failure] += 1
        if failure and failures[body, failure] > STORED:
            continue
        parts = {key: value for key, value in case.items() if isinstance(value, np.ndarray)}
        arrays[f"{body}-{number:02d}-{kind}/about"] = json.dumps({k: v for k, v in case.items() if k not in parts})
        for key, value in parts.items():
            arrays[f"{body}-{number:02d}-{kind}/{key}"] = value if key == "goals" else value.astype(np.float32)
    np.savez_compressed(path, **arrays)


def stored(path: Path = WORST) -> dict[str, dict]:
    """The stored cases by name."""
    cases = {}
    with np.load(path) as file:
        for name in sorted({key.split("/")[0] for key in file.files}):
            exact = {part: file[f"{name}/{part}"].astype(float) for part in ("position", "velocity")}
            cases[name] = json.loads(str(file[f"{name}/about"])) | exact | {"goals": file[f"{name}/goals"]}
    return cases
