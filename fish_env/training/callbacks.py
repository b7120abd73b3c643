"""Callbacks of a training: a progress bar, the learning curve, and a checkpoint to resume from."""

import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from fish_env.control.evaluation import mostly_failed
from fish_env.control.files import replacing, write_csv
from fish_env.training.run_folder import CURVE, TERM, read_curve

DIGITS = {"timesteps": ".0f", "seconds": ".1f", "episodes": ".0f"}
MIN_EPISODES = 20  # episodes after which it is said that most have failed


def ended(infos: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The infos of the fish whose episodes ended in a step."""
    return [info for info in infos if "terminal_observation" in info]


def finite_mean(values: Iterable[float]) -> float:
    """Mean of the values that are finite; NaN without any."""
    finite = [float(value) for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")


class Progress(BaseCallback):
    """A progress bar: environment steps, their rate, and the mean return and `score`, a metric, of recent episodes."""

    def __init__(self, score: str = "return"):
        super().__init__()
        self.score, self._scores, self._failures, self._warned = score, deque(maxlen=100), deque(maxlen=100), False

    def _on_training_start(self) -> None:
        self._bar = tqdm(
            total=self.locals["total_timesteps"], initial=self.num_timesteps, unit=" steps", unit_scale=True,
            desc="training", dynamic_ncols=True,
        )  # fmt: skip

    def _on_step(self) -> bool:
        found = ended(self.locals["infos"])
        self._failures.extend(info["failure"] for info in found)
        self._scores.extend(info[self.score] for info in found if self.score in info)
        if not self._warned and len(self._failures) >= MIN_EPISODES:
            warning = mostly_failed(self._failures, self.training_env.get_attr("tank", [0])[0].dt)
            if warning is not None:
                tqdm.write(f"Warning: {warning}.")
            self._warned = warning is not None
        return True

    def _on_rollout_end(self) -> None:
        if episodes := self.model.ep_info_buffer:
            shown = f"{self.score} {finite_mean(self._scores):.2f}, " if self._scores else ""
            total = sum(e["r"] for e in episodes) / len(episodes)
            self._bar.set_postfix_str(f"{shown}return {total:.2f}", refresh=False)
        self._bar.update(self.num_timesteps - self._bar.n)

    def _on_training_end(self) -> None:
        self._bar.update(self.num_timesteps - self._bar.n)
        self._bar.close()


class LearningCurve(BaseCallback):
    """Appends a row to curve.csv, of the episodes ended since the last one: `CURVE` and the terms of the reward.

    All their metrics go to TensorBoard. `score` is the metric that is the score, or "return"; a row is written as soon
    as `min_episodes` have ended.
    """

    def __init__(self, folder: Path, score: str, min_episodes: int = 100):
        super().__init__()
        self.folder, self.score, self.min_episodes = folder, score, min_episodes

    def _on_training_start(self) -> None:
        trained = self.num_timesteps  # rows beyond are of steps that the model was not trained on
        self._rows = [row for row in read_curve(self.folder) if row["timesteps"] <= trained]
        self._infos, self._start = [], time.perf_counter() - (self._rows[-1]["seconds"] if self._rows else 0.0)
        self._write()

    def _on_step(self) -> bool:
        self._infos += ended(self.locals["infos"])
        return True

    def _on_rollout_end(self) -> None:
        if len(self._infos) >= self.min_episodes:
            self._append()

    def _on_training_end(self) -> None:
        if self._infos:
            self._append()

    def _append(self) -> None:
        count = len(self._infos)
        for name in self._infos[0]:
            mean = finite_mean(info[name] for info in self._infos if isinstance(info.get(name), int | float))
            if np.isfinite(mean):
                self.logger.record(f"episode/{name}", mean)
        terms = {
            TERM + name: sum(info["terms"][name] for info in self._infos) / count for name in self._infos[0]["terms"]
        }
        total = sum(terms.values())
        score = total if self.score == "return" else finite_mean(info[self.score] for info in self._infos)
        row = zip(CURVE, (self.num_timesteps, time.perf_counter() - self._start, count, score, total), strict=True)
        self._rows.append({**dict(row), **terms})
        self._infos = []
        self._write()

    def _write(self) -> None:
        names = self._rows[0] if self._rows else CURVE  # a resumed run keeps its columns
        rows = [[f"{row[name]:{DIGITS.get(name, '.4f')}}" for name in names] for row in self._rows]
        write_csv(self.folder / "curve.csv", [names, *rows])


class Checkpoint(BaseCallback):
    """Saves the model every so many seconds, replacing the last one only when the new one is complete.

    `trained_steps` are the environment steps that the model has been trained on.
    """

    def __init__(self, path: Path, trained_steps: int, seconds: float = 30.0):
        super().__init__()
        self.path, self.trained_steps, self.seconds = path, trained_steps, seconds

    def _on_training_start(self) -> None:
        self._last = time.perf_counter()

    def _on_rollout_start(self) -> None:
        check_finite(self.model)
        self.trained_steps = self.num_timesteps
        if time.perf_counter() - self._last > self.seconds:
            save_model(self.model, self.path)
            self._last = time.perf_counter()

    def _on_step(self) -> bool:
        return True


class StopIf(BaseCallback):
    """Stops the training, as Ctrl-C does, as soon as a condition holds."""

    def __init__(self, condition: Callable[[], bool]):
        super().__init__()
        self.condition = condition

    def _on_step(self) -> bool:
        if self.condition():
            raise KeyboardInterrupt
        return True


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
