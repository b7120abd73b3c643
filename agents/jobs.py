"""One run of `train.py all`: a process of its own, on this machine or on another."""

import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fish_env.training.checkout import ROOT
from fish_env.training.config import PARENT, TrainConfig, settings_of
from fish_env.training.saved_run import read_curve, read_record

SCRIPT = ROOT / "train.py"


@dataclass
class Job:
    """One run: a task with a seed, in a folder of its own."""

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
        with suppress(ValueError, IndexError):  # there is no row yet
            return int(read_curve(self.folder / "curve.csv")[-1].split(",")[0])
        return 0

    def check(self) -> None:
        """Raise ValueError if the files of the folder cannot be used, or if its settings are not those of the task."""
        path = self.folder / "config.json"
        if path.exists() and settings_of(read_record(path)["config"]) != self.config:
            raise ValueError(f"{self.folder} was trained with other settings; move it away, or give other --runs")

    def command(self) -> list[str]:
        """The command that begins the run, or resumes it from its last checkpoint; its last word is the folder."""
        words = [sys.executable, str(SCRIPT), self.task, "--seed", str(self.seed), "--no-pictures"]
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
