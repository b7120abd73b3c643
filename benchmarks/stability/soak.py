"""A long trial: every task on every body under every kind of actions, with the variation at its extremes.

    python -m benchmarks.stability.soak --steps 20000000      goes on from where the last one stopped; writes the tables
    python -m benchmarks.stability.soak --minutes 5 --folder runs/trial --trial         a trial: no table is written

A round drives a batch of one body in one task for STEPS environment steps: at random, bang-bang at its own natural
frequencies, oscillating, or adversarially, by the worst commands known (tests/worst/) and by a search that goes on
from round to round for those that stretch it most. The factors on stiffness, mass and drag, the current, pitch and
roll of a round are each the smallest or the largest that is allowed. Everything that leaves the environment is checked.

A fish-step is one environment step of one fish. State is stored after every round, so the trial may be stopped, also
by a kill, and goes on with the next round. It is bound to the code that it was begun with.
"""

import argparse
import ctypes
import gc
import json
import resource
import statistics
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.common.energy import stretch_and_energy
from benchmarks.common.tables import ROOT, write_csv
from benchmarks.stability.attack_search import decoded
from benchmarks.stability.cases import stored
from benchmarks.stability.mistreatment import GOALS, LEVELS
from fish_env import BODIES, TASKS, make_fish
from fish_env._cache import source_hash
from fish_env.bodies import Fish
from fish_env.control.files import write_text
from fish_env.envs import VARIATIONS, FishVectorEnv

COMMAND = "python -m benchmarks.stability.soak"
FISH = {"tetrahedral": 16, "two_layer": 128, "published": 128}
USUAL = 512  # fish of the other bodies: a round of any takes some seconds
STEPS = 250  # environment steps of a round: an episode of the default fish
LOOK = 10  # environment steps between two looks at the stretch
KINDS = (*GOALS, "adversarial")
PASS = [(body, task, kind) for kind in KINDS for task in TASKS for body in BODIES]
"""The rounds of one pass, after which every combination was had once."""
FIXED = {"task": "swim", "body": "mass_spring"}  # whose speed is measured
COMPARED = 5  # measurements of the speed at the end, each beside one of a fresh process
AIM = 100_000_000


def extremes(generator: np.random.Generator, flat: bool = False) -> dict[str, tuple[float, float]]:
    """A corner of all that may vary; where a current flows to is left to chance, and a flat body stays in its plane."""
    ends = {name: (option.low, option.high)[generator.integers(2)] for name, option in VARIATIONS.items()}
    left = {"current_heading", "pitch", "roll"} if flat else {"current_heading"}
    return {name: (end, end) for name, end in ends.items() if name not in left}


class Search:
    """The distribution of commands that stretch a body most: the best quarter of a round is the mean of the next."""

    def __init__(self, held: dict[str, list]):
        self.held = held

    def sample(self, fish: Fish, count: int, generator: np.random.Generator) -> np.ndarray:
        """Points (B,3M) of `attack_search.decoded`."""
        size = 3 * fish.num_muscles
        mean, spread = self.held.get(fish.name, [[0.0] * size, [1.5] * size])
        return np.array(mean) + np.array(spread) * generator.normal(size=(count, size))

    def learn(self, fish: Fish, points: np.ndarray, stretch: np.ndarray) -> None:
        """Keep the best quarter; never less than a tenth of the first spread, so that the search goes on."""
        best = points[np.argsort(stretch)[-max(2, len(points) // 4) :]]
        self.held[fish.name] = [best.mean(axis=0).tolist(), np.maximum(best.std(axis=0), 0.15).tolist()]


def worst_goals(fish: Fish, count: int, generator: np.random.Generator) -> np.ndarray:
    """The stored worst commands of a body (K,B,M), each begun anywhere and repeated."""
    known = [case["goals"] for case in stored().values() if case["body"] == fish.name and len(case["goals"]) > 1]
    found = np.zeros((STEPS, count, fish.num_muscles), dtype=np.uint8)
    for b in range(count):
        goals = known[generator.integers(len(known))]
        found[:, b] = goals[(np.arange(STEPS) + generator.integers(len(goals))) % len(goals)]
    return found


def not_finite(env: FishVectorEnv, obs, reward, infos) -> int:
    """How many numbers that leave the environment are not finite, or beyond the bounds of an observation."""
    highest = env.single_observation_space.high
    bad = (~(np.abs(obs) <= highest)).sum() + (~np.isfinite(reward)).sum()
    if "final_obs" in infos:
        last = np.stack(list(infos["final_obs"][infos["_final_obs"]]))
        terms = [part for name, part in infos["final_info"]["terms"].items() if not name.startswith("_")]
        bad += (~(np.abs(last) <= highest)).sum() + (~np.isfinite(terms)).sum()
    return int(bad)


def goals_of(kind: str, fish: Fish, count: int, generator, search: Search) -> tuple[np.ndarray, np.ndarray | None]:
    """Commands (K,B,M), whole numbers of 1/255, and the points of those of them that are searched, the last ones."""
    if kind != "adversarial":
        return GOALS[kind](fish, count, generator)[:STEPS], None
    points = search.sample(fish, count - count // 2, generator)
    searched = np.resize(decoded(fish, points, "muscles"), (STEPS, len(points), fish.num_muscles))
    return np.concatenate([worst_goals(fish, count // 2, generator), searched], axis=1), points


def drive(env: FishVectorEnv, goals: np.ndarray, seed: int) -> dict:
    """Drive a batch through goals (K,B,M): what was counted, and the worst stretch of every fish (B,)."""
    found, reasons, stretch = Counter(), Counter(), np.zeros(env.num_envs)
    obs, infos = env.reset(seed=seed)
    found["not_finite"] += not_finite(env, obs, np.zeros(1), infos)
    begun = time.process_time()
    for k, goal in enumerate(goals):
        obs, reward, terminated, truncated, infos = env.step(2.0 / LEVELS * goal.astype(np.float32) - 1.0)
        found["not_finite"] += not_finite(env, obs, reward, infos)
        why = infos.get("final_info", {}).get("failure", ())  # a collision ends an episode too, and is no failure
        reasons.update(text.split(":")[0] for text in why if text)
        found["episodes"] += int((terminated | truncated).sum())
        if k % LOOK == 0:
            stretch = np.fmax(stretch, stretch_and_energy(env.tank)[0])
    seconds = time.process_time() - begun
    steps = len(goals) * env.num_envs
    counts = {"fish_steps": steps, "integrator_steps": steps * round(env.control_interval / env.tank.dt)}
    return {**counts, **found, "reasons": dict(reasons), "seconds": seconds, "stretch": stretch}


def round_of(number: int, held: dict[str, list], fish: int | None = None) -> tuple[str, dict]:
    """Round `number` of the trial: which combination it was, and what it counted."""
    body, task, kind = PASS[number % len(PASS)]
    generator = np.random.default_rng([7, number])
    count = fish or FISH.get(body, USUAL)
    flat = not make_fish(body).body.inverse_mass[:, 2].any()
    env = FishVectorEnv(count, task=task, body=body, variation=extremes(generator, flat), autoreset_mode="SameStep",
                        max_episode_steps=TASKS[task].episode_steps, threads=1)  # fmt: skip
    search = Search(held)
    goals, points = goals_of(kind, env.tank.fish, count, generator, search)
    found = drive(env, goals, 1000 * number)
    if points is not None:
        search.learn(env.tank.fish, points, found["stretch"][-len(points) :])
    env.close()
    return f"{body} {task} {kind}", found | {"stretch": float(found["stretch"].max())}


def speed(repeats: int = 3) -> float:
    """Fish-steps per second of processor time of a fixed batch, the fastest of some repeats."""
    env = FishVectorEnv(USUAL, autoreset_mode="SameStep", threads=1, **FIXED)
    goals = GOALS["random"](env.tank.fish, USUAL, np.random.default_rng(0))[:100]
    found = [drive(env, goals, 0) for _ in range(repeats)]
    env.close()
    return max(each["fish_steps"] / each["seconds"] for each in found)


def fresh_speed() -> float:
    """`speed` in a process that has just begun."""
    call = [sys.executable, "-m", "benchmarks.stability.soak", "--speed"]
    return float(subprocess.run(call, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT).stdout)


def speeds() -> tuple[float, float]:
    """Medians of `speed` and `fresh_speed`, in alternation: the machine's own changes touch both."""
    pairs = [(speed(), fresh_speed()) for _ in range(COMPARED)]
    return statistics.median(own for own, _ in pairs), statistics.median(fresh for _, fresh in pairs)


def memory() -> float:
    """Resident memory of this process, MB; the highest so far where the system does not tell the present one.

    What the C library keeps for later is given back before, where it can be asked to (glibc).
    """
    gc.collect()
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(library, "malloc_trim"):
        library.malloc_trim(0)
    status = Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmRSS")) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def add(totals: dict[str, dict], name: str, found: dict) -> None:
    """Add a round to the totals of its combination."""
    row = totals.setdefault(name, {"stretch": 0.0, "reasons": {}})
    for key in ("fish_steps", "integrator_steps", "episodes", "not_finite", "seconds"):
        row[key] = row.get(key, 0) + found.get(key, 0)
    row["stretch"] = max(row["stretch"], found["stretch"])
    row["reasons"] = dict(Counter(row["reasons"]) + Counter(found["reasons"]))


def load(path: Path) -> dict:
    """What was done so far.

    Raises:
        ValueError: if it was done with other code.
    """
    if not path.is_file():
        return {"code": source_hash(), "round": 0, "totals": {}, "search": {}, "sessions": []}
    state = json.loads(path.read_text())
    if state["code"] != source_hash():
        raise ValueError(f"{path} belongs to other code of fish_env; give another --folder, or delete it")
    return state


def done(state: dict) -> int:
    """Fish-steps so far."""
    return sum(row["fish_steps"] for row in state["totals"].values())


def soak(path: Path, steps: int, minutes: float = np.inf, fish: int | None = None) -> dict:
    """Go on until `steps` fish-steps are done in all, `minutes` have passed, or Ctrl-C; the state, which is stored."""
    state, begun = load(path), time.monotonic()
    first, session = state["round"], {"fish_steps": 0}
    with tqdm(total=steps, initial=min(steps, done(state)), unit="fish-step", unit_scale=True) as bar:
        try:
            while done(state) < steps and time.monotonic() - begun < 60 * minutes:
                if state["round"] - first == len(PASS):  # all is compiled
                    session["memory_first_mb"] = memory()
                name, found = round_of(state["round"], state["search"], fish)
                add(state["totals"], name, found)
                state["round"] += 1
                session["fish_steps"] += found["fish_steps"]
                write_text(path, json.dumps(state))
                bar.update(found["fish_steps"])
                bar.set_postfix_str(name)
        except KeyboardInterrupt:
            state = load(path)  # without the round that was interrupted
            print(f"stopped after {done(state):,} fish-steps; the same command goes on")
    if "memory_first_mb" in session:
        session["memory_last_mb"] = memory()
        session["rate_last"], session["rate_fresh"] = speeds()
        state["sessions"].append(session)
        write_text(path, json.dumps(state))
    return state


def rows_of(state: dict) -> list[dict]:
    """A row for each body and kind of actions in each task."""
    rows = []
    for name, row in sorted(state["totals"].items()):
        body, task, kind = name.split(" ")
        reasons = row["reasons"]
        rows.append({
            "body": body, "task": task, "actions": kind,
            **{key: row[key] for key in ("fish_steps", "integrator_steps", "episodes", "not_finite")},
            "failures": sum(reasons.values()), "reasons": "; ".join(f"{n} {why}" for why, n in sorted(reasons.items())),
            "worst_stretch": round(row["stretch"], 4),
        })  # fmt: skip
    return rows


def sessions_of(state: dict) -> list[dict]:
    """A row for each session of more than one pass: its steps, its memory, and its speed beside a fresh process."""
    return [
        {"session": k, "fish_steps": each["fish_steps"],
         "memory_first_mb": round(each["memory_first_mb"], 1), "memory_last_mb": round(each["memory_last_mb"], 1),
         "rate_last": round(each["rate_last"]), "rate_fresh": round(each["rate_fresh"])}
        for k, each in enumerate(state["sessions"])
    ]  # fmt: skip


def report(state: dict) -> bool:
    """Print the sums by body; True if nothing that was not finite has left an environment."""
    rows = rows_of(state)
    print(f"{'body':14}{'fish-steps':>14}{'episodes':>10}{'not finite':>12}{'failures':>10}{'stretch':>9}")
    for body in BODIES:
        own = [row for row in rows if row["body"] == body]
        sums = [sum(row[key] for row in own) for key in ("fish_steps", "episodes", "not_finite", "failures")]
        worst = max((row["worst_stretch"] for row in own), default=0.0)
        print(f"{body:14}{sums[0]:14,}{sums[1]:10,}{sums[2]:12,}{sums[3]:10,}{worst:9.3f}")
    print(f"{done(state):,} fish-steps, {done(state) / AIM:.1%} of {AIM:,}")
    for row in sessions_of(state):
        print(f"session {row['session']}: {row['fish_steps']:,} fish-steps, "
              f"memory {row['memory_first_mb']} MB, then {row['memory_last_mb']} MB; "
              f"{row['rate_last']:,} fish-steps/s, a fresh process {row['rate_fresh']:,}")  # fmt: skip
    return not any(row["not_finite"] for row in rows)


def main() -> int:
    """The command line; exit 1 if a number that is not finite has left an environment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=float, default=AIM, help=f"fish-steps in all (default {AIM:,})")
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after so many, at the end of a round")
    parser.add_argument("--folder", type=Path, default=ROOT / "runs" / "soak", help="of the state (runs/soak)")
    parser.add_argument("--trial", action="store_true", help="write no table")
    parser.add_argument("--speed", action="store_true", help="only print the speed of a fixed batch, fish-steps/s")
    chosen = parser.parse_args()
    if chosen.speed:
        print(speed())
        return 0
    chosen.folder.mkdir(parents=True, exist_ok=True)
    state = soak(chosen.folder / "state.json", int(chosen.steps), chosen.minutes)
    good = report(state)
    if not chosen.trial and state["sessions"]:
        print(write_csv("soak.csv", rows_of(state), f"{COMMAND} --steps {done(state)}"))
        print(write_csv("soak_sessions.csv", sessions_of(state), f"{COMMAND} --steps {done(state)}"))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
