"""Callbacks of a training: a progress bar, the learning curve, and a checkpoint to resume from.

If the disk is full, training continues: a file that cannot be written is reported and left out.
"""

import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter
from tqdm import tqdm

from agents.saved_run import CURVE, read_curve
from fish_env.control.files import replacing, write_text


class Progress(BaseCallback):
    """A progress bar: environment steps, their rate, and the mean return of recent episodes."""

    def _on_training_start(self) -> None:
        self._bar = tqdm(
            total=self.locals["total_timesteps"], initial=self.num_timesteps, unit=" steps", unit_scale=True,
            desc="training", dynamic_ncols=True,
        )  # fmt: skip

    def _on_rollout_end(self) -> None:
        episodes = self.model.ep_info_buffer
        if episodes:
            self._bar.set_postfix_str(f"return {sum(e['r'] for e in episodes) / len(episodes):.2f}", refresh=False)
        self._bar.update(self.num_timesteps - self._bar.n)

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._bar.update(self.num_timesteps - self._bar.n)
        self._bar.close()


class Writing(BaseCallback):
    """A callback that writes a file. A failure is reported once, until the file can be written again."""

    failed = False

    @contextmanager
    def going_on(self, path: Path):
        """A context in which a file that cannot be written is reported, and does not end the training."""
        try:
            yield
            self.failed = False
        except OSError as error:
            if not self.failed:
                say_unwritten(path, error, "it is tried again")
            self.failed = True


def say_unwritten(path: Path, error: OSError, rest: str) -> None:
    """Print one line next to the progress bar: the file that could not be written, the reason and the consequence."""
    tqdm.write(f"Warning: {path} could not be written ({error.strerror or error}); the training goes on, and {rest}.")


class LearningCurve(Writing):
    """Appends (timesteps, seconds, episodes, score, return) of the episodes ended since the last row to a CSV file.

    All their metrics go to TensorBoard. Rows that cannot be written, on a full disk for example, are written later.

    Args:
        path: the file.
        score: the metric that is the score.
        min_episodes: a row is written as soon as so many have ended.
    """

    def __init__(self, path: Path, score: str, min_episodes: int = 100):
        super().__init__()
        self.path, self.score, self.min_episodes = path, score, min_episodes

    def _on_training_start(self) -> None:
        self._begin, self._infos, self._rows = time.perf_counter(), [], ""
        trained = self.num_timesteps  # rows beyond are of steps that the model was not trained on
        rows = [row for row in read_curve(self.path) if int(row.split(",")[0]) <= trained]
        write_text(self.path, "\n".join([CURVE, *rows, ""]))
        if rows:  # a run that is resumed
            self._begin -= float(rows[-1].split(",")[1])

    def _on_step(self) -> bool:
        self._infos += [info for info in self.locals["infos"] if info]
        return True

    def _on_rollout_end(self) -> None:
        if len(self._infos) >= self.min_episodes:
            self._write()

    def _on_training_end(self) -> None:
        if self._infos:
            self._write()

    def _write(self) -> None:
        seconds = time.perf_counter() - self._begin
        total = sum(sum(info["terms"].values()) for info in self._infos) / len(self._infos)
        for name in self._infos[0]:
            values = [float(info[name]) for info in self._infos if isinstance(info.get(name), int | float)]
            finite = [value for value in values if np.isfinite(value)]
            if finite:
                self.logger.record(f"episode/{name}", float(np.mean(finite)))
        score = np.mean([info[self.score] for info in self._infos])
        self._rows += f"{self.num_timesteps},{seconds:.1f},{len(self._infos)},{score:.4f},{total:.4f}\n"
        self._infos = []
        with self.going_on(self.path):
            write_text(self.path, self.path.read_text() + self._rows)
            self._rows = ""


class Checkpoint(Writing):
    """Saves the model every so many seconds, replacing the last one only when the new one is complete.

    If that fails, on a full disk for example, training continues and tries again after the same interval.

    Attributes:
        trained_steps: environment steps that the model has been trained on.
    """

    def __init__(self, path: Path, seconds: float = 30.0):
        super().__init__()
        self.path, self.seconds, self.trained_steps = path, seconds, 0

    def _on_training_start(self) -> None:
        self._last = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        check_finite(self.model)
        self.trained_steps = self.num_timesteps
        if time.perf_counter() - self._last > self.seconds:
            with self.going_on(self.path):
                save_model(self.model, self.path)
            self._last = time.perf_counter()


class EndsIf(BaseCallback):
    """Stops the training, as Ctrl-C does, as soon as a condition holds."""

    def __init__(self, condition: Callable[[], bool]):
        super().__init__()
        self.condition = condition

    def _on_step(self) -> bool:
        if self.condition():
            raise KeyboardInterrupt
        return True


class Events(KVWriter):
    """Write the log as TensorBoard events, up to the first event that cannot be written.

    Args:
        inner: Stable-Baselines3's writer of events.
        folder: where it writes them.
    """

    def __init__(self, inner: KVWriter, folder: Path):
        self.inner, self.folder, self.failed = inner, folder, False

    def write(self, key_values, key_excluded, step=0) -> None:
        """Write one event as Stable-Baselines3 does; the first OSError is reported and not raised."""
        if self.failed:
            return
        try:
            self.inner.write(key_values, key_excluded, step)
        except OSError as error:
            self.failed = True
            say_unwritten(self.folder, error, "TensorBoard will show nothing of the rest of it")

    def close(self) -> None:
        """End the writer, unless it has ended by an error."""
        if not self.failed:
            self.inner.close()


class SurvivingEvents(BaseCallback):
    """Puts `Events` around the logger's writers while the training lasts."""

    def _on_training_start(self) -> None:
        formats = self.logger.output_formats
        formats[:] = [Events(each, Path(self.logger.dir or "")) for each in formats]

    def _on_step(self) -> bool:
        return True


@contextmanager
def without_tracebacks_of_writers():
    """A context in which a thread that ends by an OSError prints nothing: `Events` reports the error."""
    before = threading.excepthook

    def hook(arguments):
        if not issubclass(arguments.exc_type, OSError):
            before(arguments)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


def check_finite(model) -> None:
    """Raise ValueError if a parameter of the policy is not finite."""
    if not all(parameter.isfinite().all() for parameter in model.policy.parameters()):
        raise ValueError(
            f"the training diverged before environment step {model.num_timesteps:,}: parameters of the policy are not "
            "finite; resume the run from its last checkpoint, or train with another seed or a smaller learning rate"
        )


def save_model(model, path: Path) -> None:
    """Save a model so that an interruption leaves either the old file or the new one, never a part of it."""
    with replacing(path) as partial:
        model.save(partial, exclude=["_last_obs", "_last_episode_starts"])  # large, and a run resumes with new episodes
