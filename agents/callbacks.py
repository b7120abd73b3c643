"""What happens beside the learning: a progress bar, the learning curve, and a checkpoint to go on from."""

import os
import time
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm


class Progress(BaseCallback):
    """One line that moves: decisions, their rate, and the speed the fish swim at now."""

    def _on_training_start(self) -> None:
        self._bar = tqdm(
            total=self.locals["total_timesteps"], initial=self.num_timesteps, unit=" decisions", unit_scale=True,
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


class LearningCurve(BaseCallback):
    """Appends (timesteps, seconds, speed, return) of the episodes that ended since the last row to a CSV file."""

    def __init__(self, path: Path):
        super().__init__()
        self.path = path

    def _on_training_start(self) -> None:
        self._begin, self._speeds, self._returns = time.perf_counter(), [], []
        if not self.path.exists():
            self.path.write_text("timesteps,seconds,episodes,speed,return\n")

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "speed" in info:
                self._speeds.append(info["speed"])
                self._returns.append(sum(info["terms"].values()))
        return True

    def _on_rollout_end(self) -> None:
        if not self._speeds:
            return
        count, seconds = len(self._speeds), time.perf_counter() - self._begin
        speed, total = sum(self._speeds) / count, sum(self._returns) / count
        with self.path.open("a") as file:
            file.write(f"{self.num_timesteps},{seconds:.1f},{count},{speed:.4f},{total:.4f}\n")
        self.logger.record("swim/speed", speed)
        self._speeds, self._returns = [], []


class Checkpoint(BaseCallback):
    """Saves the model every so many seconds, replacing the last one only when the new one is whole."""

    def __init__(self, path: Path, seconds: float = 30.0):
        super().__init__()
        self.path, self.seconds = path, seconds

    def _on_training_start(self) -> None:
        self._last = time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if time.perf_counter() - self._last > self.seconds:
            save_whole(self.model, self.path)
            self._last = time.perf_counter()


def save_whole(model, path: Path) -> None:
    """Save a model so that an interruption leaves either the old file or the new one, never half of it."""
    partial = path.with_suffix(".partial.zip")
    model.save(partial)
    os.replace(partial, path)
