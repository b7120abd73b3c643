"""Train every task with all its seeds, a run on each processor. It can be interrupted and resumed at any time.

For Linux and macOS.
"""

import itertools
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from agents.jobs import Job
from agents.published import CONFIGS, SEEDS
from agents.ray_jobs import run_on_ray
from fish_env.control.files import writable_folder
from fish_env.training.config import change_simulation

POLL = 2.0  # s between two looks at the runs


def train_all(
    root: Path = Path("runs/all"),
    tasks=None,
    jobs: int | None = None,
    integrator: str | None = None,
    dt: float | None = None,
    ray: str | None = None,
    stopped: Callable[[], bool] = bool,
) -> list[Path]:
    """Train the runs that are not finished; returns the folders of all runs.

    Args:
        root: a run is saved in root/<task>/seed_<k>; one that is finished there is left unchanged, one that was stopped
            is resumed from its last checkpoint.
        tasks: keys of `CONFIGS`; None for all.
        jobs: runs side by side; None for one on each processor.
        integrator: a key of `fish_env.INTEGRATORS` to train with; None for the fish's own.
        dt: its step, s; None for its default step.
        ray: address of a Ray cluster to run them on, "local" for one that is begun here; None for this machine without.
        stopped: returns True to save and end the runs, as by Ctrl-C.

    Raises:
        ValueError: for an unknown task, integrator or step, fewer than one job, a run with other settings than its
            task has now, a folder that cannot be written to, or no cluster at the address.
        RuntimeError: on Windows; and when all others are done, if runs have failed: their logs are named.
    """
    tasks = list(dict.fromkeys(CONFIGS if tasks is None else tasks))
    for task in tasks:
        if task not in CONFIGS:
            raise ValueError(f"unknown task {task!r}; choose from {', '.join(CONFIGS)}")
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs is {jobs}; give a whole number, at least 1")
    if os.name == "nt":
        raise RuntimeError("train.py all is for Linux and macOS; train the tasks one by one here")
    work = [  # the first seed of every task before the second of any: a run that is stopped has something of each
        Job(task, seed, root / task / f"seed_{seed}", change_simulation(CONFIGS[task], None, integrator, dt))
        for seed, task in itertools.product(range(SEEDS), tasks)
    ]
    writable_folder(root)
    for job in work:
        job.check()
    waiting = [job for job in work if not job.finished]
    failed = run_jobs(waiting, work, jobs, stopped) if ray is None else run_on_ray(waiting, work, ray)
    if failed:
        logs = ", ".join(str(job.folder / "log.txt") for job in failed)
        raise RuntimeError(f"{len(failed)} of {len(work)} runs failed; see {logs}")
    return [job.folder for job in work]


def run_jobs(waiting: list[Job], work: list[Job], jobs: int | None, stopped: Callable[[], bool] = bool) -> list[Job]:
    """Run the waiting jobs, `jobs` at a time, until `stopped`; return those that failed."""
    processors = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [None] * (os.cpu_count() or 1)
    slots: list[Job | None] = [None] * (jobs or len(processors))
    failed = []
    with tqdm(total=sum(j.config.timesteps for j in work), unit=" steps", unit_scale=True, desc="all tasks") as bar:
        try:
            while waiting or any(slots):
                if stopped():
                    raise KeyboardInterrupt
                for k, job in enumerate(slots):
                    if job is not None and not job.running:
                        failed += [] if job.finished else [job]
                        slots[k] = None
                    if slots[k] is None and waiting:
                        waiting[0].start(processors[k % len(processors)])
                        slots[k] = waiting.pop(0)
                running = ", ".join(f"{job.task} {job.seed}" for job in slots if job)
                ready = f"{sum(job.finished for job in work)} of {len(work)} runs"
                bar.n = sum(job.steps for job in work)
                bar.set_postfix_str(f"{ready}; now {running}")
                if any(slots):
                    time.sleep(POLL)
        finally:
            under_way = [job.process for job in slots if job and job.process]
            for process in under_way:
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)  # it saves its model and ends
            for process in under_way:
                process.wait()
    return failed
