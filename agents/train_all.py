"""Train every task with all its seeds, a run on each processor; stop and go on at any time."""

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from agents.config import CONFIGS, RESULTS

LOOK = 2.0  # s between two looks at the runs


@dataclass
class Job:
    """One run: a task with a seed, in a folder of its own."""

    task: str
    seed: int
    folder: Path
    process: subprocess.Popen | None = None

    @property
    def finished(self) -> bool:
        return (self.folder / "results.json").exists()

    @property
    def decisions(self) -> int:
        """How far it has come."""
        if self.finished:
            return CONFIGS[self.task].timesteps
        try:
            with (self.folder / "curve.csv").open() as file:
                return int(list(csv.DictReader(file))[-1]["timesteps"])
        except (OSError, IndexError, ValueError):
            return 0

    def start(self, processor: int | None) -> None:
        """Begin the run, or go on with it from its last checkpoint, on one processor."""
        self.folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "train.py", self.task, "--seed", str(self.seed), "--no-pictures"]
        started = (self.folder / "model.zip").exists()
        command += ["--resume" if started else "--folder", str(self.folder)]

        def prepare() -> None:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # a program in the background may have been told to ignore it
            if processor is not None:
                os.sched_setaffinity(0, {processor})

        with (self.folder / "log.txt").open("a") as log:  # in a session of its own: Ctrl-C reaches it once, from here
            self.process = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, preexec_fn=prepare, start_new_session=True
            )
        (self.folder / "process.txt").write_text(str(self.process.pid))

    def check_free(self) -> None:
        """RuntimeError if another program is training this run."""
        try:
            number = int((self.folder / "process.txt").read_text())
            os.kill(number, 0)
        except (OSError, ValueError):
            return
        raise RuntimeError(f"{self.folder} is being trained by process {number}; wait for it, or end it first")


def train_all(root: Path = Path("runs/all"), tasks=None, jobs: int | None = None) -> list[Path]:
    """Train what is not trained yet; returns the folders of all runs.

    Args:
        root: a run is kept in root/<task>/seed_<k>; one that is finished there is left alone, one that was stopped
            goes on from its last checkpoint.
        tasks: keys of `CONFIGS`; None for all.
        jobs: runs side by side; None for one a processor.

    Raises:
        ValueError: for an unknown task.
        RuntimeError: if a run fails; its log is named.
    """
    tasks = list(CONFIGS if tasks is None else tasks)
    for task in tasks:
        if task not in CONFIGS:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(CONFIGS)}")
    most = max(RESULTS[task].seeds for task in tasks)
    work = [  # the first seed of every task before the second of any: a run that is stopped has something of each
        Job(task, seed, root / task / f"seed_{seed}")
        for seed in range(most)
        for task in tasks
        if seed < RESULTS[task].seeds
    ]
    can_pin = hasattr(os, "sched_getaffinity")
    processors = sorted(os.sched_getaffinity(0)) if can_pin else list(range(os.cpu_count() or 1))
    slots: list[Job | None] = [None] * (jobs or len(processors))
    waiting = [job for job in work if not job.finished]
    for job in waiting:
        job.check_free()
    total, done = sum(CONFIGS[job.task].timesteps for job in work), sum(job.decisions for job in work)
    for number in (signal.SIGINT, signal.SIGTERM):  # being terminated is like Ctrl-C, also in the background
        signal.signal(number, signal.default_int_handler)
    try:
        with tqdm(total=total, initial=done, unit=" decisions", unit_scale=True, desc="all tasks") as bar:
            while waiting or any(slots):
                for k, job in enumerate(slots):
                    if job is not None and job.process.poll() is not None:
                        if not job.finished:
                            raise RuntimeError(f"{job.task}, seed {job.seed} failed; see {job.folder / 'log.txt'}")
                        (job.folder / "process.txt").unlink(missing_ok=True)
                        slots[k] = None
                    if slots[k] is None and waiting:
                        slots[k] = waiting.pop(0)
                        slots[k].start(processors[k % len(processors)] if can_pin else None)
                running = ", ".join(f"{job.task} {job.seed}" for job in slots if job)
                bar.set_postfix_str(
                    f"{sum(job.finished for job in work)} of {len(work)} runs; now {running}", refresh=False
                )
                bar.n = sum(job.decisions for job in work)
                bar.refresh()
                time.sleep(LOOK)
    finally:
        stop([job for job in slots if job])
    return [job.folder for job in work]


def stop(jobs: list[Job]) -> None:
    """Let the runs that are going keep what they learnt and end."""
    for job in jobs:
        if job.process.poll() is None:
            job.process.send_signal(signal.SIGINT)
    for job in jobs:
        job.process.wait()
        (job.folder / "process.txt").unlink(missing_ok=True)
