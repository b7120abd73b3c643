"""What each task is trained with: one typed record a task, kept beside every run."""

import math
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class TrainConfig:
    """Environment and PPO settings of one task. Times are in seconds, so that they survive a change of step."""

    env_id: str
    env_options: dict[str, Any] = field(default_factory=dict)
    """Keywords of the environment."""
    timesteps: int = 2_000_000
    """Decisions to train for, all fish together."""
    num_envs: int = 256
    """Fish trained side by side."""
    rollout: int = 32
    """Decisions of each fish between two updates."""
    batch_size: int = 2048
    epochs: int = 5
    learning_rate: float = 1e-3
    """At the start; it falls linearly to a tenth."""
    horizon: float = 1.0
    """How far ahead a decision looks, s: the discount a decision is exp(-control interval / horizon)."""
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    entropy_weight: float = 0.0
    initial_log_std: float = -0.5
    hidden: tuple[int, ...] = (64, 64)

    def discount(self, control_interval: float) -> float:
        """The discount factor for decisions `control_interval` seconds apart."""
        return math.exp(-control_interval / self.horizon)


CONFIGS: dict[str, TrainConfig] = {
    "swim": TrainConfig("FishEnv/Swim-v0", {"muscle_groups": "pairs"}),
}
