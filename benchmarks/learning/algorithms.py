"""Which method learns fastest: PPO with a symmetric policy and without, SAC and TD3, for the same wall time.

    python -m benchmarks.learning.algorithms --task left_after_right --seconds 300    results/algorithms_<task>.csv

The learning rate is constant, since it is not known beforehand how far a method comes in the time. Off-policy methods
have fewer fish and make one update of 256 transitions for every few environment steps; the scaling of
observations, the synergies and the discount are those of the task.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import time
from dataclasses import replace

import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from agents.build import make_env, make_model
from agents.config import CONFIGS, RESULTS, TrainConfig
from benchmarks.common.tables import write_csv
from fish_env.control import EPISODES, evaluate, make_eval_env, means
from fish_env.control.equivariant import ScaledObservation

FISH = 32  # side by side, for the off-policy methods
UPDATES = 16  # for every environment step of all these fish
LOOKS = 5  # measurements over the time


def off_policy(method, config: TrainConfig, seed: int, **options):
    """SAC or TD3 on the task's fish."""
    env = make_env(config, FISH, seed)
    fish = env.unwrapped.fish
    offset, scale = fish.layout.scaling()
    return method(
        "MlpPolicy", env, learning_rate=1e-3, batch_size=256, gamma=config.discount(fish.control_interval),
        train_freq=1, gradient_steps=UPDATES, learning_starts=5_000, buffer_size=500_000, seed=seed, device="cpu",
        policy_kwargs={
            "net_arch": [128, 128],
            "features_extractor_class": ScaledObservation,
            "features_extractor_kwargs": {"offset": offset, "scale": scale},
        },
        **options,
    )  # fmt: skip


def td3(config: TrainConfig, seed: int):
    """TD3 with the usual noise."""
    return off_policy(TD3, config, seed, action_noise=NormalActionNoise(np.zeros(12), np.full(12, 0.1)))


def ppo(config: TrainConfig, seed: int):
    """PPO with the settings of the task."""
    return make_model(config, make_env(config, config.num_envs, seed), seed)


METHODS = {
    "PPO, symmetric": ppo,
    "PPO": lambda config, seed: ppo(replace(config, symmetric=False), seed),
    "SAC": lambda config, seed: off_policy(SAC, config, seed),
    "TD3": td3,
}


class Looks(BaseCallback):
    """Measures the policy without noise a few times and ends the training when its time is over."""

    def __init__(self, config: TrainConfig, seconds: float):
        super().__init__()
        self.env = make_eval_env(config.env_id, EPISODES, config.env_options)
        self.seconds, self.rows, self.measuring = seconds, [], 0.0
        self.env.reset(seed=0)
        self.env.step(self.env.action_space.sample())  # what has to be compiled is compiled now

    def _on_training_start(self) -> None:
        self.begin = time.perf_counter()

    def _on_step(self) -> bool:
        spent = time.perf_counter() - self.begin - self.measuring
        if spent >= self.seconds * (len(self.rows) + 1) / LOOKS:
            begin = time.perf_counter()
            self.rows.append(self.measured() | {"seconds": round(spent), "decisions": self.model.num_timesteps})
            self.measuring += time.perf_counter() - begin
        return len(self.rows) < LOOKS

    def measured(self) -> dict:
        """Scores of the mean action on the evaluation episodes."""
        matrix = self.model.get_env().matrix

        def act(obs, _):
            return np.clip(self.model.predict(obs, deterministic=True)[0] @ matrix, -1.0, 1.0)

        return means(evaluate(act, self.env))


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", choices=CONFIGS, default="swim")
    parser.add_argument("--seconds", type=float, default=300.0, help="of training a method, measuring left out")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    config, rows = CONFIGS[arguments.task], []
    for name, make in METHODS.items():
        model, looks = make(config, arguments.seed), Looks(config, arguments.seconds)
        model.learn(10**9, looks)
        for row in looks.rows:
            score = {metric: row[metric] for metric in ("return",)} | {"score": row[RESULTS[arguments.task].score]}
            rows.append({"method": name, "seed": arguments.seed, "seconds": row["seconds"],
                         "decisions": row["decisions"]} | score)  # fmt: skip
            print(rows[-1])
        given = f"--task {arguments.task} --seconds {arguments.seconds:g} --seed {arguments.seed}"
        write_csv(f"algorithms_{arguments.task}.csv", rows, f"python -m benchmarks.learning.algorithms {given}")


if __name__ == "__main__":
    main()
