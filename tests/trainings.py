"""Short trainings."""

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from fish_env.training import train as training

SHORT = {"timesteps": 1024, "num_envs": 8}


def train_short(task="swim", seed=None, changes=SHORT, report=False, pictures=False, env_options=None, **options):
    """Train for a moment, and evaluate only if a report is wanted; return the folder of the run.

    Options are those of a request; `body`, `integrator` and `dt` are keywords of the environment.
    """
    torch.set_num_threads(1)
    simulation = {name: options.pop(name) for name in ("body", "integrator", "dt") if name in options}
    request = training.Request(
        task, seed, changes=changes, pictures=pictures, env_options={**(env_options or {}), **simulation}, **options
    )
    with pytest.MonkeyPatch.context() as patch:
        if not report:
            patch.setattr(training, "report", lambda *arguments: None)
        return training.train(request)
