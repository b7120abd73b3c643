"""Fit an inexpensive body in motion to the finest one (CMA-ES): the same commands, the least distance.

python -m benchmarks.calibration.fit --body mass_spring     fits, writes fish_env/bodies/<body>.json (minutes)
python -m benchmarks.calibration.fit                        all bodies, in the order in which they depend on each other
python -m benchmarks.calibration.fit --spread               five fit seeds of each body, tested: fits.csv (resumes)
python -m benchmarks.calibration.fit --test                 what is shipped, tested: results/fit_tests.csv

The finest body is that of tetrahedra at level 3. Its motions are kept in `runs/calibration`, under the digest of the
body and the commands, so that only the first fit waits for them. Fitted are the logarithms of factors on stiffness,
muscles and drag, and where on a section the water is felt; the masses keep the outline's mass, centre and yaw inertia.
A body is trained on the commands of all tasks and of four families, and swims the gaits with which the finest one swims
like a trout; it is tested on other seeds of the tasks and on four families it has not seen.
"""

import argparse
import hashlib
import json
import multiprocessing
from pathlib import Path

import numpy as np
from tqdm import tqdm

import fish_env.bodies
from benchmarks.calibration.commands import TRAINING, UNSEEN, drawn, training_scenes
from benchmarks.calibration.living_fish import BEATS, SECONDS, TROUT, beyond, cost, living_gaits
from benchmarks.calibration.midline import swim_midlines
from benchmarks.common.motion import Motion, errors, play, record
from benchmarks.common.problems import DISTURBANCE, left_after_right
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import provenance, write_csv
from fish_env import TASKS, Tank, make_fish
from fish_env._cache import source_hash
from fish_env.bodies import Fish
from fish_env.control.files import write_text
from fish_env.integrators import limits

COMMAND = "python -m benchmarks.calibration.fit"
FOLDER = Path(fish_env.bodies.__file__).parent
KEPT = Path("runs/calibration")
FINEST = {"body": "tetrahedral", "level": 3}
BODIES = ("mass_spring", "planar", "two_layer")
SEED, EACH = 100, 4  # of the families' training scenes, and how many of each
TESTED, TEST_SEED = 12, 5_000  # scenes of each task, and the first's seed: neither trained nor fitted on
UNSEEN_SEED, UNSEEN_EACH = 900, 12
GENERATIONS = {"mass_spring": 260, "planar": 120, "two_layer": 70}
POPULATION = 16
EVERY = {"two_layer": 3}  # it takes ten times as long as the others, and is fitted to every third scene
WIDEST = 3.0  # a factor is not above this, nor below its inverse
START = {
    "stiffness": [130.0, 1600.0], "taper": [0.15, 0.4, 0.09, 0.12, 0.16, 0.106],
    "contracted": [0.875, 0.89, 0.8], "relaxation_time": 0.0004, "mass_factor": [0.7, 0.6, 1.0, 1.3, 0.7, 0.9, 1.5],
    "water_place": [0.5, 0.3, 0.8, 0.4, 0.55, 0.85], "water_drag": [0.9, 3.0, 0.7, 3.0, 1.4, 0.7],
}  # fmt: skip
"""Where the search of the 23 nodes begins; `planar` begins with factors of 1."""
OTHER = 977.0  # N/m, of the other springs: not fitted, since the taper scales them
PREDICTABLE = 100.0
"""Times that the abrupt manoeuvre may magnify a disturbance: a fish that buckles does so a millionfold, and nobody can
say where it ends (the finest body: 5 times)."""
LIMIT = 0.002
"""Stable step of symplectic Euler, s, that a body must have: stiffness that hardly moves it is expensive."""
MOST_DRAG = 4.0
"""Of a section's drag over that of a face whose every point is taken: neighbours could make up for each other."""
PLACES = 0.1, 0.9
"""Of the point of a section at which the water is felt, from its front to its rear."""
LIVING, NOSE, WORST = 0.006, 0.185, 50.0
"""Weight of what `living_fish` minimises; the sway of the nose over the tail's above which more is added; its limit."""
FACTORS = {"bending": 5, "shear": 1, "pull": 3, "drag": 6}
TWO_LAYERS = {
    "bending": [1.6, 1.05, 0.66, 0.66, 1.5], "shear": 1.6, "pull": [1.2, 1.3, 1.25],
    "drag": [0.57, 0.6, 0.94, 0.95, 1.67, 0.88],
}  # fmt: skip
"""Where the search of two layers begins: what a shorter one ended with."""


def digest(fish: Fish, contractions: np.ndarray) -> str:
    """Names what a body is and is told."""
    body, text = fish.body, hashlib.sha256()
    parts = [body.position, body.mass, *body.springs, fish.contracted, np.array(fish.activation_time)]
    parts += [np.array([fish.water.quadratic, fish.time_step, fish.contraction_time]), contractions]
    parts += [] if body.tets is None else [part for part in body.tets if isinstance(part, np.ndarray)]
    for part in parts:
        text.update(np.ascontiguousarray(part).tobytes())
    return text.hexdigest()[:16]


def finest_motion(contractions: np.ndarray) -> Motion:
    """What the finest body makes of contractions (S,K,M).

    Raises:
        RuntimeError: if it fails in one of the scenes.
    """
    fish = make_fish(**FINEST)
    path = KEPT / f"{digest(fish, contractions)}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        parts = np.array_split(np.arange(len(contractions)), -(-len(contractions) // 8))
        with multiprocessing.get_context("spawn").Pool() as pool:
            work = pool.imap(_finest, [contractions[part] for part in parts])
            found = list(tqdm(work, total=len(parts), desc="finest body"))
        motion = [np.concatenate([np.asarray(one[k]) for one in found]) for k in range(5)]
        failed = [f"scene {k}: {reason}" for k, reason in enumerate(motion[4]) if reason]
        if failed:
            raise RuntimeError(f"the reference failed in {'; '.join(failed)}; leave them out or correct the body")
        np.savez(path, **dict(zip(Motion._fields[:4], motion[:4], strict=True)))
    kept = np.load(path)
    return Motion(*(kept[name] for name in Motion._fields[:4]), [""] * len(contractions))


def _finest(contractions):
    return tuple(play(make_fish(**FINEST), contractions))


def start_of(body: str) -> dict[str, np.ndarray]:
    """What is fitted of a body, and where the search begins."""
    known = {"mass_spring": START, "two_layer": TWO_LAYERS}
    if body in known:
        return {name: np.array(value) for name, value in known[body].items()}
    return {name: np.ones(size) for name, size in FACTORS.items()}


def built(body: str, start: dict, logs) -> tuple[dict, Fish]:
    """The parameters at a point of the search, and the body made of them."""
    given, used = {}, 0
    for name, value in start.items():
        factor = np.exp(np.clip(logs[used : used + value.size], -np.log(WIDEST), np.log(WIDEST)))
        used += value.size
        if name == "contracted":  # what a muscle takes off its length is fitted, not what it leaves
            given[name] = _rounded(np.clip(1.0 - factor * (1.0 - value), 0.4, 0.97))
        else:
            given[name] = _rounded(factor * value)
    if body == "mass_spring":
        given["water_drag"] = np.minimum(given["water_drag"], MOST_DRAG).tolist()
        given["water_place"] = np.clip(given["water_place"], *PLACES).tolist()
        given["stiffness"] = [*given["stiffness"], OTHER]
    return given, make_fish(body, **given)


def _rounded(value, digits=4):
    """A number or a list of numbers of so many significant digits."""
    rounded = [float(f"{v:.{digits}g}") for v in np.ravel(value)]
    return rounded[0] if np.size(value) == 1 else rounded


def distance(fish: Fish, contractions, finest: Motion) -> float:
    """Mean distance to the finest body over the scenes; what fails counts 2."""
    motion = play(fish, contractions)
    off = errors(motion, finest, fish.control_interval)["all"]
    failed = np.array([bool(text) for text in motion.failure])
    return float(np.where(failed, 2.0, np.minimum(np.nan_to_num(off, nan=2.0), 2.0)).mean())


def living(fish: Fish) -> float:
    """How far the finest body's three gaits, swum by this body, are from a living trout; at most WORST."""
    found = swim_midlines(fish, living_gaits(), [row.speed for row in TROUT], SECONDS, BEATS)
    if any(one.failure for one in found):
        return WORST
    return min(cost(found) + 1000.0 * sum(float(beyond(one.nose, NOSE)) ** 2 for one in found), WORST)


def magnification(fish: Fish) -> float:
    """By how much the abrupt manoeuvre magnifies a small displacement of the nodes; the larger of two."""
    goals, count = left_after_right(fish), 2
    tank, moved = Tank(fish, 1 + count, water=fish.water, threads=1), 0.0
    shape = tank.position[0].shape
    for b in range(count):
        displaced = DISTURBANCE * fish.length * np.random.default_rng(b).normal(size=shape)
        tank.position[1 + b] += displaced * (fish.body.inverse_mass > 0.0)
    for goal in goals:
        tank.drive(np.repeat(goal[None], 1 + count, axis=0), round(fish.control_interval / tank.dt))
        moved = max(moved, float(np.linalg.norm(tank.position[1:] - tank.position[0], axis=2).max()))
    return moved / (DISTURBANCE * fish.length) if tank.alive.all() else 1e7


def search(job) -> tuple[float, dict]:
    """One run of CMA-ES: the least distance, and the parameters there."""
    import cma

    body, seed, generations = job
    contractions = training_scenes(SEED, EACH)
    finest, start, part = finest_motion(contractions), start_of(body), slice(None, None, EVERY.get(body, 1))
    contractions, finest = contractions[part], Motion(*(values[part] for values in finest))
    size = sum(value.size for value in start.values())
    settings = {"seed": seed, "popsize": POPULATION, "verbose": -9, "maxiter": generations}
    strategy, best = cma.CMAEvolutionStrategy(np.zeros(size), 0.1, settings), (np.inf, {})
    with tqdm(total=generations, desc=f"{body}, seed {seed}", mininterval=10) as bar:
        while not strategy.stop():
            points, costs = strategy.ask(), []
            for point in points:
                outside = float((np.maximum(np.abs(point) - np.log(WIDEST), 0.0) ** 2).sum())
                try:
                    given, fish = built(body, start, point)
                except ValueError:
                    costs.append(10.0 + outside)
                    continue
                stiff = max(0.0, np.log(LIMIT / limits.leapfrog(fish.body))) if body != "two_layer" else 0.0
                wild = max(0.0, np.log10(magnification(fish) / PREDICTABLE))
                apart = distance(fish, contractions, finest) + LIVING * living(fish)
                costs.append(apart + outside + stiff + 0.05 * wild)
                if costs[-1] < best[0]:
                    best = costs[-1], given
            strategy.tell(points, costs)
            bar.update()
            bar.set_postfix(distance=f"{100 * best[0]:.2f} %")
    return best


def kept_search(job) -> tuple[float, dict]:
    """What `search` finds; read from KEPT if the same code has run this search to its end before."""
    name = hashlib.sha256(f"{job} {source_hash()}".encode() + Path(__file__).read_bytes()).hexdigest()[:16]
    path = KEPT / f"fit-{name}.json"
    if not path.exists():
        found = search(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(found))
    return tuple(json.loads(path.read_text()))


def write(body: str, given: dict, found: float, seed: int) -> None:
    """Put fitted parameters where the package reads them."""
    path = FOLDER / f"{body}.json"
    about = provenance(f"{COMMAND} --body {body}") | {"seed": seed, "distance_percent": round(100 * found, 3)}
    kept = json.loads(path.read_text())["parameters"] if body == "mass_spring" else {}
    path.write_text(json.dumps({"provenance": about, "parameters": kept | given}, indent=2) + "\n")


def test_scenes() -> dict[str, np.ndarray]:
    """What a fit is tested on: unseen seeds of every task and of the families trained on, and unseen families."""
    scenes = {task: record(task, TESTED, TEST_SEED) for task in TASKS}
    for k, (name, family) in enumerate({**UNSEEN, **TRAINING}.items()):
        scenes[name] = drawn(family, UNSEEN_SEED + k, UNSEEN_EACH)
    return scenes


def tested(fish: Fish, scenes: dict) -> list[dict]:
    """A row for each kind of scene: the distance to the finest body."""
    rows = []
    for name, contractions in scenes.items():
        motion, finest = play(fish, contractions), finest_motion(contractions)
        for quantity, off in errors(motion, finest, fish.control_interval).items():
            if quantity == "volume":
                continue
            mean, low, high = interval_of(off)
            rows.append({
                "scene": name, "kind": "task" if name in TASKS else "unseen" if name in UNSEEN else "trained",
                "quantity": quantity, "distance": f"{mean:.4g}", "low": f"{low:.4g}", "high": f"{high:.4g}",
                "scenes": len(contractions), "failed": sum(map(bool, motion.failure)),
            })  # fmt: skip
    return rows


def report(label: str, rows: list[dict]) -> None:
    """A line: the distances over all quantities."""
    text = " ".join(f"{r['scene']} {100 * float(r['distance']):.1f}" for r in rows if r["quantity"] == "all")
    print(f"{label}: {text} %", flush=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", choices=BODIES, help="only this one")
    parser.add_argument("--seed", type=int, default=1, help="of the search")
    parser.add_argument("--generations", type=int, help=f"of {POPULATION} bodies; {GENERATIONS}")
    parser.add_argument("--spread", action="store_true", help="five seeds of each; nothing is shipped")
    parser.add_argument("--test", action="store_true", help="only test what is shipped")
    chosen = parser.parse_args()
    bodies = BODIES if chosen.body is None else (chosen.body,)
    if chosen.test:
        rows, scenes = [], test_scenes()
        for body in bodies:
            found = tested(make_fish(body), scenes)
            report(body, found)
            rows += [{"body": body} | row for row in found]
        write_csv("fit_tests.csv", rows, f"{COMMAND} --test")
    elif chosen.spread:
        rows, scenes = [], test_scenes()
        finest_motion(training_scenes(SEED, EACH))
        jobs = [(body, seed, chosen.generations or GENERATIONS[body]) for body in bodies for seed in range(1, 6)]
        with multiprocessing.get_context("spawn").Pool() as pool:
            for (body, seed, _), (found, given) in zip(jobs, pool.imap(kept_search, jobs), strict=True):
                outcome = tested(make_fish(body, **given), scenes)
                report(f"{body}, seed {seed}, {100 * found:.2f} % trained", outcome)
                rows += [{"body": body, "fit_seed": seed, "training": f"{found:.4g}"} | row for row in outcome]
        write_csv("fits.csv", rows, f"{COMMAND} --spread")
    else:
        for body in bodies:
            found, given = search((body, chosen.seed, chosen.generations or GENERATIONS[body]))
            write(body, given, found, chosen.seed)
            print(f"{body}: {100 * found:.2f} %, {given}")


if __name__ == "__main__":
    main()
