"""Train every task with all its seeds, a run on each processor. It can be interrupted and resumed at any time.

For Linux and macOS.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

from agents.published import CONFIGS, SEEDS
from fish_env.control.files import writable_folder
from fish_env.envs.vector import make_batch
from fish_env.training.checkout import ROOT
from fish_env.training.config import PARENT, TrainConfig, settings_of
from fish_env.training.run_folder import read_curve, read_record

POLL = 2.0  # s between two looks at the runs


@dataclass
class Job:
    """One run: a task with a seed, in a folder and a process of its own."""

    task: str
    seed: int
    folder: Path
    config: TrainConfig
    process: subprocess.Popen | None = None

    @property
    def running(self) -> bool:
        """True if the job was started here and has not ended."""
        return self.process is not None and self.process.poll() is None

    @property
    def finished(self) -> bool:
        return (self.folder / "results.json").exists()

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        if self.finished:
            return self.config.timesteps
        with suppress(ValueError, IndexError):  # there is no row yet, or none that can be read
            return int(read_curve(self.folder)[-1]["timesteps"])
        return 0

    def check(self) -> None:
        """Raise ValueError if the files of the folder cannot be used, or if its settings are not those of the task."""
        if (self.folder / "config.json").exists() and settings_of(read_record(self.folder)["config"]) != self.config:
            raise ValueError(f"{self.folder} was trained with other settings; move it away, or give other --runs")

    def command(self) -> list[str]:
        """The command that begins the run, or resumes it from its last checkpoint."""
        words = [sys.executable, str(ROOT / "train.py"), self.task, "--seed", str(self.seed), "--no-pictures"]
        if (self.folder / "model.zip").exists():
            return [*words, "--resume", str(self.folder)]
        for name in ("integrator", "dt"):
            if name in self.config.env_options:
                words += [f"--{name}", str(self.config.env_options[name])]
        return [*words, "--folder", str(self.folder)]

    def start(self, processor: int | None) -> None:
        """Run the command, on one processor."""

        def prepare() -> None:
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # a program in the background may have been told to ignore it
            if processor is not None:
                os.sched_setaffinity(0, {processor})

        self.folder.mkdir(parents=True, exist_ok=True)
        # in a session of its own: Ctrl-C reaches it once, from here
        with (self.folder / "log.txt").open("a") as log:
            self.process = subprocess.Popen(
                self.command(), stdout=log, stderr=subprocess.STDOUT, preexec_fn=prepare, start_new_session=True,
                env=os.environ | {PARENT: str(os.getpid())},
            )  # fmt: skip


def train_all(
    root: Path = Path("runs/all"),
    tasks=None,
    jobs: int | None = None,
    integrator: str | None = None,
    dt: float | None = None,
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
        stopped: returns True to save and end the runs, as by Ctrl-C.

    Raises:
        ValueError: for an unknown task, integrator or step, fewer than one job, a run with other settings than its
            task has now, or a folder that cannot be written to.
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
    method = {name: value for name, value in (("integrator", integrator), ("dt", dt)) if value is not None}
    configs = {task: replace(CONFIGS[task], env_options=CONFIGS[task].env_options | method) for task in tasks}
    for config in configs.values() if method else ():
        with closing(make_batch(config.env_id, 1, **config.env_options)):  # an error here, and not in every run
            pass
    work = [  # the first seed of every task before the second of any: a run that is stopped has something of each
        Job(task, seed, root / task / f"seed_{seed}", config)
        for seed in range(max(SEEDS.values()))
        for task, config in configs.items()
        if seed < SEEDS[task]
    ]
    writable_folder(root)
    for job in work:
        job.check()
    failed = run_jobs([job for job in work if not job.finished], work, jobs, stopped)
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
