"""Fit an inexpensive body in motion to the finest one (least squares): the same commands, the least distance.

python -m benchmarks.calibration.fit --body mass_spring     fits, writes fish_env/bodies/<body>.json (minutes)
python -m benchmarks.calibration.fit                        all bodies, in the order in which they depend on each other
python -m benchmarks.calibration.fit --test                 what is shipped, tested: results/fit_tests.csv

The finest body is that of tetrahedra at level 3. Its motions and the searches that have ended are kept in
`runs/calibration`, under the digest of what they depend on, so that only the first fit waits for them. Fitted are
stiffness, damping, muscles and drag, and where on a section the water is felt (`benchmarks/calibration/fit_search.py`);
the masses keep the outline's mass, centre and yaw inertia. Several searches begin near one start, and the best is
shipped. A body is trained on the commands of all tasks and of four families, and swims the gaits with which the finest
one swims like a trout; it is tested on other seeds of the tasks and on four families it has not seen.
"""

import argparse
import hashlib
import json
import multiprocessing
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.calibration import commands, fit_search
from benchmarks.calibration.commands import FILE, TRAINING, UNSEEN, drawn, training_scenes, weights
from benchmarks.calibration.fit_search import FOLDER, Problem, parameters, rounded, shipped
from benchmarks.common import families
from benchmarks.common.motion import Motion, errors, play, record
from benchmarks.common.statistics import interval_of
from benchmarks.common.tables import provenance, write_csv
from fish_env import TASKS, make_fish
from fish_env.bodies import Fish
from fish_env.control.files import write_text
from fish_env.kernels.cache import source_hash

COMMAND = "python -m benchmarks.calibration.fit"
KEPT = Path("runs/calibration")
FINEST = {"body": "tetrahedral", "level": 3}
BODIES = ("mass_spring", "planar", "two_layer")
SEED = 100  # of the families' training scenes
TESTED, TEST_SEED = 12, 61_000  # scenes of each task, and the first's seed: neither trained nor fitted on
UNSEEN_SEED, UNSEEN_EACH = 9_300, 24  # some square waves are ten times as far off as most: the mean needs many
EVERY = {"two_layer": 10}  # it takes twenty times as long as the others, and is fitted to every tenth scene
SEEDS = {"mass_spring": (4, 5), "planar": (1, 2), "two_layer": (1,)}  # with the best of five that were tried


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


def training(body: str) -> tuple[np.ndarray, Motion, np.ndarray]:
    """What a body is fitted to: the scenes, what the finest one makes of them, and how much they count."""
    contractions, part = training_scenes(SEED), slice(None, None, EVERY.get(body, 1))
    finest = finest_motion(contractions)
    return contractions[part], Motion(*(values[part] for values in finest[:5])), weights()[part]


def search(job) -> tuple[float, dict]:
    """One search: half its squares, and the parameters there.

    Args:
        job: the body, the seed, and the parameters of `mass_spring` that the body is made of where they are not those
            of the package.
    """
    body, seed, base = job
    contractions, finest, counts = training(body)
    found = Problem(body, contractions, finest, base, counts).solve(seed)
    return float(found.cost), rounded(parameters(body, found.x))


def kept_search(job) -> tuple[float, dict]:
    """What `search` finds; read from KEPT if the same code has run this search to its end before.

    A job says of which `mass_spring` a body is made: the package may hold another one the next time.
    """
    code = b"".join(
        Path(path).read_bytes() for path in (__file__, fit_search.__file__, commands.__file__, families.__file__, FILE)
    )
    name = hashlib.sha256(f"{job} {source_hash()}".encode() + code).hexdigest()[:16]
    path = KEPT / f"fit-{name}.json"
    if not path.exists():
        found = search(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(found))
    return tuple(json.loads(path.read_text()))


def searches(jobs: list) -> list[tuple[float, dict]]:
    """What the searches find, some at the same time; the finest body moves first, for all of them."""
    finest_motion(training_scenes(SEED))
    with multiprocessing.get_context("spawn").Pool() as pool:
        return pool.map(kept_search, jobs, chunksize=1)


def trained(body: str, fish: Fish) -> float:
    """Mean distance of a body to the finest one over what it was fitted to."""
    contractions, finest, _ = training(body)
    return float(errors(play(fish, contractions), finest, fish.control_interval)["all"].mean())


def write(body: str, given: dict, seed: int) -> None:
    """Put fitted parameters where the package reads them."""
    path = FOLDER / f"{body}.json"
    about = provenance(f"{COMMAND} --body {body}")
    about |= {"seed": seed, "distance_percent": round(100 * trained(body, make_fish(body, **given)), 3)}
    kept = shipped(body) if body == "mass_spring" else {}
    path.write_text(json.dumps({"provenance": about, "parameters": kept | given}, indent=2) + "\n")
    print(f"{body}: seed {seed}, {about['distance_percent']} %, {given}", flush=True)


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


def fit(bodies) -> None:
    """Ship the best of the searches of each body; `planar` and `two_layer` are made of `mass_spring`."""
    for body in bodies:
        base = {} if body == "mass_spring" else fitted()
        found = searches([(body, seed, base) for seed in SEEDS[body]])
        best = int(np.argmin([cost for cost, _ in found]))
        print(f"{body}: half the squares {', '.join(f'{cost:.4f}' for cost, _ in found)}")
        write(body, found[best][1], SEEDS[body][best])


def fitted() -> dict:
    """The parameters of the package's `mass_spring` that a search finds."""
    kept = shipped("mass_spring")
    return {name: kept[name] for name in parameters("mass_spring", fit_search.beginning("mass_spring")[0])}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--body", choices=BODIES, nargs="+", default=BODIES, help="fit only these")
    parser.add_argument("--test", action="store_true", help="only test what is shipped")
    chosen = parser.parse_args()
    if not chosen.test:
        fit([body for body in BODIES if body in chosen.body])
        return
    rows, scenes = [], test_scenes()
    for body in BODIES:
        found = tested(make_fish(body), scenes)
        text = " ".join(f"{r['scene']} {100 * float(r['distance']):.1f}" for r in found if r["quantity"] == "all")
        print(f"{body}: {text} %", flush=True)
        rows += [{"body": body} | row for row in found]
    write_csv("fit_tests.csv", rows, f"{COMMAND} --test")


if __name__ == "__main__":
    main()
