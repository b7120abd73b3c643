"""Fit an inexpensive body in motion to the finest one (CMA-ES): the same commands, the least distance.

`python -m benchmarks.calibrate` fits the bodies, in the order in which they depend on each other.

The finest body is that of tetrahedra at level 2, which moves as level 3 does. Its motions are kept in
`runs/calibration` as the searches are. Fitted are stiffness, damping, muscles and drag, and where on a section the
water is felt (`benchmarks/calibration/fit_search.py`); the masses keep the outline's mass, centre and yaw inertia.
A body is trained on the commands of all tasks and of four families, and is to do what living fish do; it is tested on
other seeds of the tasks and on four families it has not seen.
"""

import hashlib
import multiprocessing
from functools import partial

import numpy as np
from tqdm import tqdm

from benchmarks.calibration.commands import TRAINING, UNSEEN, drawn, training_scenes, weights
from benchmarks.calibration.fit_search import FIXED, Search, parameters
from benchmarks.calibration.keep import KEPT, PACKAGE, digest, kept, publish, rounded
from benchmarks.common import tables
from benchmarks.common.motion import Motion, errors, play, record
from benchmarks.common.search import minimise
from benchmarks.common.statistics import interval_of
from fish_env import TASKS, Fish, make_fish
from fish_env.bodies import BODIES as KINDS
from fish_env.bodies.fitted import WATERS, read_calibration

FINEST = {"body": "tetrahedral", "level": 2}
BODIES = ("mass_spring", "planar", "two_layer")
SEED = 100  # of the families' training scenes
TESTED, TEST_SEED = 12, 61_000  # scenes of each task, and the first's seed: neither trained nor fitted on
UNSEEN_SEED, UNSEEN_EACH = 9_300, 24  # some square waves are ten times as far off as most: the mean needs many
OLD_STRENGTH = 0.5
"""Factor on recorded commands: they were recorded on a fish that contracts half as far."""
EVERY = {"two_layer": 10}  # it takes twenty times as long as the others, and is fitted to every tenth scene
GENERATIONS = {"mass_spring": 40, "planar": 50, "two_layer": 6}
SPREAD = {"mass_spring": 0.02, "planar": 0.05, "two_layer": 0.05}
"""Of the search for a body, and the spread of its first points."""


def finest_motion(contractions: np.ndarray, water: str) -> Motion:
    """What the finest body makes of contractions (S,K,M) in a level of water.

    Raises:
        RuntimeError: if it fails in one of the scenes.
    """
    told = hashlib.sha256(contractions.tobytes()).hexdigest()
    path = KEPT / f"{digest(FINEST, water, read_calibration('tetrahedral', water), told)}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        parts = np.array_split(np.arange(len(contractions)), -(-len(contractions) // 8))
        with multiprocessing.get_context("spawn").Pool() as pool:
            work = pool.imap(partial(_finest, water), [contractions[part] for part in parts])
            found = list(tqdm(work, total=len(parts), desc="finest body"))
        motion = [np.concatenate([np.asarray(one[k]) for one in found]) for k in range(5)]
        failed = [f"scene {k}: {reason}" for k, reason in enumerate(motion[4]) if reason]
        if failed:
            raise RuntimeError(f"the reference failed in {'; '.join(failed)}; leave them out or correct the body")
        np.savez(path, **dict(zip(Motion._fields[:4], motion[:4], strict=True)))
    kept = np.load(path)
    return Motion(*(kept[name] for name in Motion._fields[:4]), [""] * len(contractions))


def _finest(water, contractions):
    return tuple(play(make_fish(**FINEST, water=water), contractions))


def training(body: str, water: str) -> tuple[np.ndarray, Motion, np.ndarray]:
    """What a body is fitted to: the scenes, what the finest one makes of them, and how much they count."""
    contractions, part = training_scenes(SEED, OLD_STRENGTH), slice(None, None, EVERY.get(body, 1))
    finest = finest_motion(contractions, water)
    return contractions[part], Motion(*(values[part] for values in finest[:5])), weights()[part]


def search(body: str, water: str, _mass_spring: dict, generations: int, _finest: dict) -> dict:
    """The best parameters that are found, and their squares."""
    contractions, finest, counts = training(body, water)
    problem = Search(body, water, contractions, finest, counts)
    with multiprocessing.get_context("spawn").Pool() as pool:
        each = partial(pool.map, chunksize=1)
        found, least = minimise(problem.squares, problem.start, SPREAD[body], generations, 1, 16, each)
    given = {name: FIXED.get(name, rounded(value)) for name, value in parameters(body, water, found).items()}
    return {"squares": least, "parameters": given}


def test_scenes(water: str) -> dict[str, np.ndarray]:
    """What a fit is tested on: unseen seeds of every task and of the families trained on, and unseen families."""
    scenes = {task: record(task, TESTED, TEST_SEED, water) for task in TASKS}
    for k, (name, family) in enumerate({**UNSEEN, **TRAINING}.items()):
        scenes[name] = drawn(family, UNSEEN_SEED + k, UNSEEN_EACH)
    return scenes


def tested(fish: Fish, scenes: dict, water: str) -> list[dict]:
    """A row for each kind of scene: the distance to the finest body."""
    rows = []
    for name, contractions in scenes.items():
        motion, finest = play(fish, contractions), finest_motion(contractions, water)
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


def fit(body: str, water: str) -> None:
    """Ship what the search for a body finds; `planar` and `two_layer` are made of `mass_spring`."""
    base = {} if body == "mass_spring" else read_calibration("mass_spring", water)["parameters"]
    finest = read_calibration("tetrahedral", water)["parameters"]
    found = kept("fit", search, body, water, base, GENERATIONS[body], finest)
    given = found["parameters"]
    fish, (contractions, wanted, _) = make_fish(body, water=water, **given), training(body, water)
    distance = float(errors(play(fish, contractions), wanted, fish.control_interval)["all"].mean())
    print(f"{body}: squares {found['squares']:.4f}; {100 * distance:.2f} %")
    publish(
        PACKAGE / "bodies" / f"{body}.json", water, {"distance_percent": rounded(100 * distance), "parameters": given}
    )


def measure() -> list[dict]:
    """The rows of all fitted bodies."""
    rows = []
    for water in WATERS:
        scenes = test_scenes(water)
        for body in (name for name in BODIES if water in KINDS[name].waters):
            rows += [
                {"water": water, "body": body} | row for row in tested(make_fish(body, water=water), scenes, water)
            ]
    return rows


if __name__ == "__main__":
    tables.publish(__doc__, {"fit_tests.csv": measure})
