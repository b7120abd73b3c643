"""Stable-Baselines3's PPO with networks and loss by compiled kernels: the same numbers to rounding, in less time.

Rollouts are Stable-Baselines3's, so are the buffer, its returns and advantages, the order of minibatches, the cut of
the gradient, the optimizer, files and logs; the parameters are torch's. Networks and loss, forward and
backward, are those of `agents/kernels.py`.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule
from stable_baselines3.common.utils import explained_variance

from agents import kernels
from agents.kernels import HALF_LOG_TWO_PI, Samples, Settings
from agents.networks import Networks, arrays_of, unsupported
from fish_env.physics.tank_options import available_processors

PARTS = 4  # of a minibatch, and so the most threads that can share it
FIELDS = ("actions", "log_probs", "values", "advantages", "returns")


class FastPPO(PPO):
    """PPO by kernels where `Networks` supports the policy (`why_slow` is None), else by Stable-Baselines3's own code.

    `threads` says how many threads share a minibatch, None for all processors; it changes no bit of the parameters.
    """

    threads: int | None = None
    clip_range: Schedule  # Stable-Baselines3 makes schedules of the numbers it is given
    clip_range_vf: Schedule | None

    @property
    def why_slow(self) -> str | None:
        """Reason for using Stable-Baselines3's own code; None if it is not used."""
        if type(self.rollout_buffer) is not RolloutBuffer:
            return f"its buffer is {type(self.rollout_buffer).__name__}"
        return unsupported(self.policy)

    def collect_rollouts(self, *arguments, **options) -> bool:
        """Collect rollouts as Stable-Baselines3 does, with the policy evaluated by kernels."""
        if self.why_slow:
            return super().collect_rollouts(*arguments, **options)
        actor = Acting(Networks(self.policy))
        self.policy.forward, self.policy.predict_values = actor.forward, actor.predict_values  # in place of its methods
        try:
            return super().collect_rollouts(*arguments, **options)
        finally:
            del self.policy.forward, self.policy.predict_values

    def train(self) -> None:
        """Update the policy as Stable-Baselines3 does: epochs of minibatches over the rollout."""
        if self.why_slow:
            super().train()
            return
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        progress, threads = self._current_progress_remaining, min(PARTS, self.threads or available_processors())
        limit = np.inf if self.clip_range_vf is None else self.clip_range_vf(progress)
        settings = Settings(0.0, 1.0, self.clip_range(progress), limit, self.vf_coef)
        with ThreadPoolExecutor(threads) as pool:
            update = Update(Networks(self.policy), self.rollout_buffer, pool.map if threads > 1 else map)
            found, begin = self._epochs(update, settings)
        self._log(found, begin, settings)

    def _epochs(self, update: "Update", settings: Settings) -> tuple[np.ndarray, int]:
        """Train on the rollout; return what is logged of every minibatch, and where the last epoch begins."""
        found, going = [], True
        for epoch in range(self.n_epochs):
            rows = update.order[np.random.permutation(update.order.size)]  # noqa: NPY002 - the generator SB3 uses
            begin = len(found)
            for batch in np.split(rows, range(self.batch_size, rows.size, self.batch_size)):
                found.append(update.differentiate(batch, settings, self.ent_coef, self.normalize_advantage))
                going = self.target_kl is None or found[-1][3] <= 1.5 * self.target_kl
                if not going:
                    break
                torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
                self.policy.optimizer.step()
            self._n_updates += 1
            if not going:
                if self.verbose >= 1:
                    print(f"Early stopping at step {epoch} due to reaching max kl: {found[-1][3]:.2f}")
                break
        return np.array(found), begin

    def _log(self, found: np.ndarray, last_epoch: int, settings: Settings) -> None:
        """Log what Stable-Baselines3 logs of an update.

        Args:
            found: (minibatches,5) statistics of the minibatches.
            last_epoch: row at which the last epoch begins.
            settings: of the minibatches.
        """
        (policy, value, clipped, _, disorder), last, buffer = found.mean(0), found[-1], self.rollout_buffer
        self.logger.record("train/entropy_loss", -disorder)
        self.logger.record("train/policy_gradient_loss", policy)
        self.logger.record("train/value_loss", value)
        self.logger.record("train/approx_kl", found[last_epoch:, 3].mean())
        self.logger.record("train/clip_fraction", clipped)
        self.logger.record("train/loss", last[0] - self.ent_coef * last[4] + self.vf_coef * last[1])
        explained = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", explained)
        self.logger.record("train/std", self.policy.log_std.exp().mean().item())
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/clip_range", settings.clip)
        if self.clip_range_vf is not None:
            self.logger.record("train/clip_range_vf", settings.value_clip)


class Acting:
    """Methods of the policy that a rollout calls."""

    def __init__(self, networks: Networks):
        self.networks, self.log_std = networks, networks.policy.log_std

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Actions (B,A), drawn or their mean, values (B,1), log-probabilities of the actions (B,)."""
        mean, values = self.networks.act(obs.numpy())
        noise = np.zeros(mean.shape, mean.dtype)
        if not deterministic:
            torch.from_numpy(noise).normal_()  # the numbers that SB3 draws
        actions = mean + noise * np.exp(self.log_std)
        if not np.isfinite(actions).all():
            raise ValueError(
                "the policy's actions are not finite: the training has diverged; resume from an earlier checkpoint"
            )
        log_probs = -0.5 * (noise * noise).sum(1) - (self.log_std + HALF_LOG_TWO_PI).sum()
        return torch.from_numpy(actions), torch.from_numpy(values[:, None]), torch.from_numpy(log_probs)

    def predict_values(self, obs: PyTorchObs) -> torch.Tensor:
        """Values (B,1)."""
        assert isinstance(obs, torch.Tensor)  # a fish sees one array, not several by name
        return torch.from_numpy(self.networks.act(obs.numpy())[1][:, None])


class Update:
    """Gradients of minibatches of a full buffer, into the `grad` of torch's parameters.

    A minibatch is cut into the same parts whatever the number of threads, and their sums are added in the same order.
    `share_out` is `map`, Python's or that of a pool of threads.

    Attributes:
        order: which sample of the buffer's arrays is Stable-Baselines3's k-th: fish by fish, not step by step.
    """

    def __init__(self, networks: Networks, buffer: RolloutBuffer, share_out):
        size, dtype = buffer.buffer_size * buffer.n_envs, networks.dtype
        self.networks, self._share_out = networks, share_out
        self.order = np.arange(size)
        if not buffer.generator_ready:
            self.order = self.order.reshape(buffer.buffer_size, buffer.n_envs).T.ravel()
        actions, *rest = (getattr(buffer, name).reshape(size, -1).astype(dtype, copy=False) for name in FIELDS)
        self.samples = Samples(
            networks.see(buffer.observations.reshape(size, -1)), actions, *(one[:, 0] for one in rest)
        )
        self.parts = [(networks.work(), *networks.zeros(), np.zeros(4)) for _ in range(PARTS)]
        for parameter, array in zip(networks.parameters, arrays_of(self.parts[0][2]), strict=True):
            parameter.grad = torch.from_numpy(array)

    def differentiate(
        self, batch: np.ndarray, settings: Settings, entropy_weight: float, normalize: bool
    ) -> np.ndarray:
        """Means over the samples `batch` of what `kernels.loss` sums, and the entropy, (5,)."""
        if normalize and batch.size > 1:
            advantages = self.samples.advantages[batch]
            settings = settings._replace(mean=float(advantages.mean()), spread=float(advantages.std(ddof=1)) + 1e-8)
        now = settings, self.networks.transposed()
        jobs = zip(np.array_split(batch, PARTS), self.parts, [now] * PARTS, strict=True)
        list(self._share_out(self._part, jobs))
        _, flat, total, statistics = self.parts[0]
        for _, other, _, others in self.parts[1:]:
            flat += other
            statistics += others
        flat /= batch.size
        total.log_std[:] -= entropy_weight
        log_std = self.networks.policy.log_std
        return np.append(statistics / batch.size, (log_std + (0.5 + HALF_LOG_TWO_PI)).sum())

    def _part(self, job) -> None:
        """The sums of a part of a minibatch."""
        which, (work, flat, total, statistics), (settings, transposed) = job
        flat.fill(0.0)
        statistics.fill(0.0)
        swap, policy = self.networks.images.swap, self.networks.policy
        kernels.differentiate(self.samples, which, settings, policy, transposed, swap, work, (total, statistics))
