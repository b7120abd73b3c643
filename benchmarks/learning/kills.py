"""Training that is killed again and again and resumed: no file is ever broken, and little of the training is lost.

    python -m benchmarks.learning.kills                     results/kills.csv; exit 1 if anything was broken
    python -m benchmarks.learning.kills --kills 5 --seeds 1 --timesteps 100000      a trial: nothing is written

A run of Swim is begun, killed by SIGKILL and resumed, until it has had so many kills; then it is left to finish. The
first kill comes before the first checkpoint; of the others, one in EARLY comes at a random time of the start, a third
of the rest while a file is being written, and the others at a random time of the training. Checkpoints are not 30 s
apart but one of INTERVALS, 0 for one an update. After each kill every file of the run is read, and the environment
steps of the model are compared with those at the kill. The policy that results is evaluated beside that of a run with
the same seed that nothing disturbed.
"""

import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy and torch are loaded

import argparse
import contextlib
import json
import mmap
import signal
import struct
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from threading import RLock

import numpy as np
import torch
from stable_baselines3 import PPO
from tqdm import tqdm

from agents import callbacks
from agents import train as training
from agents.records import read_rows
from benchmarks.common.tables import write_csv
from fish_env.control import load_policy

COMMAND = "python -m benchmarks.learning.kills"
KILLS, SEEDS, TIMESTEPS = 50, 1, 2_000_000  # the training of Swim as it is
INTERVALS = (0.0, 0.5)  # s between checkpoints
UPDATES = 4  # after fewer than so many a run is killed
EARLY = 8  # one in so many is killed while it starts
WRITING = 3  # of the others, one in so many is killed while it writes a file
LATEST = 1.0  # s after that, at most
AT_ONCE = 0.05  # s after its beginning, at most, the first kill comes
RECORD = struct.Struct("qd")  # environment steps, and when they were reached
ROOM = 100_000  # records of one process


class Diary(callbacks.BaseCallback):
    """Writes into shared memory when how many environment steps had been trained on."""

    def __init__(self, memory: mmap.mmap):
        super().__init__()
        self.memory, self.count = memory, 0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        RECORD.pack_into(self.memory, 8 + RECORD.size * self.count, self.num_timesteps, time.monotonic())
        self.count += 1
        struct.pack_into("q", self.memory, 0, self.count)

    @staticmethod
    def read(memory: mmap.mmap) -> list[tuple[int, float]]:
        """The records, oldest first."""
        count = struct.unpack_from("q", memory, 0)[0]
        return [RECORD.unpack_from(memory, 8 + RECORD.size * k) for k in range(count)]


def trained(folder: Path) -> int:
    """Environment steps of the model in a folder; 0 without one."""
    path = folder / "model.zip"
    return int(PPO.load(path, device="cpu").num_timesteps) if path.exists() else 0


def broken_files(folder: Path) -> list[str]:
    """The files of a run that cannot be read, or say what cannot be."""
    readers = {
        "model.zip": lambda path: PPO.load(path, device="cpu"),
        "policy.npz": load_policy,
        "config.json": lambda path: json.loads(path.read_text())["config"],
        "results.json": lambda path: json.loads(path.read_text())["rows"],
        "curve.csv": lambda path: [[float(value) for value in row.values()] for row in read_rows(path)],
    }
    bad = []
    for name, read in readers.items():
        try:
            if (folder / name).exists():
                read(folder / name)
        except Exception as error:  # whatever a reader raises, the file is broken
            bad.append(f"{name}: {type(error).__name__} {error}")
    return bad


def start(folder: Path, seed: int, timesteps: int, memory: mmap.mmap, interval: float) -> int:
    """Begin or resume the run in a forked process; its number."""
    memory[:8] = bytes(8)
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        os.dup2(os.open(folder.parent / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 1)
        os.dup2(1, 2)
        learn_as_usual = training.CallbackList
        training.CallbackList = lambda found: learn_as_usual([*found, Diary(memory)])
        training.Checkpoint = lambda path: callbacks.Checkpoint(path, seconds=interval)
        begun = {"folder": folder, "seed": seed, "changes": {"timesteps": timesteps}}
        resumed = (folder / "model.zip").exists()  # with the settings that it was begun with
        training.train(training.Request("swim", pictures=False, **({"resume": folder} if resumed else begun)))
        status = 0
    finally:
        os._exit(status)


def ends_first(process: int, updates: int, memory: mmap.mmap) -> bool:
    """Wait until the process has begun to train and made so many updates; whether it has ended before."""
    while len(Diary.read(memory)) <= updates:
        if os.waitpid(process, os.WNOHANG)[0]:
            return True
        time.sleep(0.01)
    return False


def half_written(folder: Path, since: int = 0) -> bool:
    """Whether a file is being written in a folder, or was left half written, since a time, ns."""
    with contextlib.suppress(FileNotFoundError):  # it was finished while we looked
        return any(path.stat().st_mtime_ns > since for path in folder.glob(".*partial*"))
    return False


def ends_before_writing(process: int, folder: Path) -> bool:
    """Wait until the process writes a file; whether it has ended before."""
    since = time.time_ns()
    while not half_written(folder, since):
        if os.waitpid(process, os.WNOHANG)[0]:
            return True
    return False


class Killed:
    """A run that is killed `kills` times, and then ends by itself; what was found is in the attributes."""

    def __init__(self, folder: Path, seed: int, timesteps: int, kills: int, interval: float):
        self.folder, self.timesteps, self.interval = folder, timesteps, interval
        self.done = self.half_written = self.before_first = self.too_much = 0
        self.lost, self.bad = 0.0, []
        folder.mkdir(parents=True)
        generator = np.random.default_rng(seed)
        memory = mmap.mmap(-1, 8 + RECORD.size * ROOM)
        tqdm.set_lock(RLock())  # its own is shared with forked processes, and one that is killed may hold it
        with tqdm(total=kills, desc=f"seed {seed}", unit="kill") as bar:
            while self.done < kills and trained(folder) < timesteps:
                begun = time.time_ns()
                process = start(folder, seed, timesteps, memory, interval)
                if not self.done:
                    after = generator.uniform(0.0, AT_ONCE)
                elif not generator.integers(EARLY):
                    after = generator.uniform(0.0, LATEST)
                elif not generator.integers(WRITING):
                    after = 0.0
                    if ends_before_writing(process, folder):
                        break
                else:
                    after = generator.uniform(0.0, LATEST)
                    if ends_first(process, generator.integers(UPDATES), memory):
                        break
                self.kill(process, after, memory, begun)
                bar.update(1)
        _, status = os.waitpid(start(folder, seed, timesteps, memory, interval), 0)
        self.finished = os.waitstatus_to_exitcode(status) == 0 and not broken_files(folder)

    def kill(self, process: int, after: float, memory: mmap.mmap, begun: int) -> None:
        """End the process, begun at a time in ns, after so many seconds, and look at what it leaves."""
        time.sleep(after)
        os.kill(process, signal.SIGKILL)
        ended = time.monotonic()
        os.waitpid(process, 0)
        self.done += 1
        self.half_written += half_written(self.folder, begun)
        self.bad += broken_files(self.folder)
        saved, reached = trained(self.folder), Diary.read(memory)
        self.before_first += not saved
        later = [(steps, when) for steps, when in reached if steps > saved]
        if later:  # trained on more than was saved
            lost = ended - next((when for steps, when in reached if steps == saved), reached[0][1])
            times = [*(when for _, when in reached), ended]
            slowest = max(after - before for before, after in pairwise(times))
            self.lost = max(self.lost, lost)
            self.too_much += lost > self.interval + 2 * slowest  # checkpoints begin and end between two updates


def score(folder: Path) -> float:
    """Speed of the trained policy, body lengths per second, over the fixed episodes of its report."""
    return json.loads((folder / "results.json").read_text())["rows"]["trained policy"]["speed"]


def undisturbed(folder: Path, seed: int, timesteps: int) -> float:
    """The score of a run that nothing disturbs."""
    folder.mkdir(parents=True)
    os.waitpid(start(folder, seed, timesteps, mmap.mmap(-1, 8 + RECORD.size * ROOM), 30.0), 0)
    return score(folder)


def measure(folder: Path, seed: int, timesteps: int, kills: int, interval: float) -> dict:
    """A row of the table."""
    run = Killed(folder, seed, timesteps, kills, interval)
    return {
        "seed": seed, "timesteps": timesteps, "kills": run.done, "half_written": run.half_written,
        "before_first_checkpoint": run.before_first, "broken_files": len(run.bad), "finished": run.finished,
        "checkpoint_interval_s": interval, "most_lost_s": round(run.lost, 2), "lost_too_much": run.too_much,
        "speed": score(run.folder), "what": "; ".join(run.bad),
    }  # fmt: skip


def main() -> int:
    """The command line; 1 if a file was broken, a run did not finish, or more than an interval was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=KILLS, help=f"of each run (default {KILLS})")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"runs (default {SEEDS})")
    parser.add_argument("--timesteps", type=int, default=TIMESTEPS, help=f"of each (default {TIMESTEPS:,})")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as root:
        rows = []
        for seed in range(chosen.seeds):
            whole = {"speed_undisturbed": undisturbed(Path(root) / f"whole_{seed}", seed, chosen.timesteps)}
            for k, interval in enumerate(INTERVALS):
                folder = Path(root) / f"killed_{seed}_{k}"
                rows.append(measure(folder, seed, chosen.timesteps, chosen.kills, interval) | whole)
    for row in rows:
        print(", ".join(f"{name} {value}" for name, value in row.items()))
    if (chosen.kills, chosen.seeds, chosen.timesteps) == (KILLS, SEEDS, TIMESTEPS):
        print(write_csv("kills.csv", rows, COMMAND))
    return int(any(row["broken_files"] or not row["finished"] or row["lost_too_much"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
