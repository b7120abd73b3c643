"""What `export_policy` exports acts as the model does in its environment; what would act otherwise is refused."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")
sb3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecEnvWrapper,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

import fish_env
from fish_env.control import equivariant
from fish_env.control.equivariant import EquivariantPolicy, ScaledObservation, equivariant_options, export_policy
from fish_env.training.build import make_env, make_model
from fish_env.training.config import CONFIGS

TANH = {"activation_fn": torch.nn.Tanh}


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


def fish(**options):
    """A batch of fish."""
    return fish_env.make_sb3_vec_env("FishEnv/Swim-v0", num_envs=4, seed=0, **options)


def learner(env, algorithm=sb3.PPO, policy="MlpPolicy", options=TANH, trained=64, **settings):
    """A learner that has learnt a little, its actions large enough to be clipped now and then."""
    if issubclass(algorithm, sb3.PPO):
        settings = {"n_steps": 16, "batch_size": 32} | settings
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = algorithm(policy, env, policy_kwargs=options, device="cpu", seed=0, **settings)
        model.learn(trained)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return model


def assert_same_actions(model, policy, atol=2e-4):
    """The policy gives, for raw observations of a few steps, the actions of the model for those it is shown."""
    env, normaliser = model.get_env(), model.get_vec_normalize_env()
    if normaliser is not None:
        normaliser.training = False
    shown, large = env.reset(), 0.0
    for _ in range(20):
        raw = shown if normaliser is None else normaliser.get_original_obs()
        expected = model.predict(shown, deterministic=True)[0]
        np.testing.assert_allclose(policy(raw), np.clip(expected, -1, 1), atol=atol)
        large = max(large, np.abs(expected).max())
        shown, *_ = env.step(expected)
    assert large > 0.1


MODELS = {
    "as it is": lambda: learner(fish()),
    "A2C": lambda: learner(fish(), sb3.A2C, n_steps=16),
    "linear": lambda: learner(fish(), options=TANH | {"net_arch": []}),
    "other layers": lambda: learner(fish(), options=TANH | {"net_arch": {"pi": [8, 24], "vf": [5]}}),
    "extractors of their own": lambda: learner(fish(), options=TANH | {"share_features_extractor": False}),
    "noise that depends on the state": lambda: learner(fish(), use_sde=True),
    "returns normalised": lambda: learner(VecNormalize(fish(), norm_obs=False)),
    "observations normalised": lambda: learner(VecNormalize(fish(), clip_obs=np.inf)),
    "normalised, and clipped beyond what was seen": lambda: learner(VecNormalize(fish(), clip_obs=1e4)),
    "normalised twice": lambda: learner(VecNormalize(VecNormalize(fish(), clip_obs=np.inf), clip_obs=np.inf)),
    "normalised within others": lambda: learner(VecMonitor(VecCheckNan(VecNormalize(fish(), clip_obs=np.inf)))),
    "of single fish": lambda: learner(VecNormalize(single(), clip_obs=1e4)),
}


@pytest.mark.parametrize("name", MODELS)
def test_exported_models_act_alike(name):
    """Normalised, with other layers or extractors: the file acts as the model does in its wrappers."""
    model = MODELS[name]()
    policy = export_policy(model, {})
    if name != "normalised twice":  # the observations before both are not kept
        assert_same_actions(model, policy)
    else:
        outer = model.get_env()
        raw = outer.venv.venv.reset()
        shown = outer.normalize_obs(outer.venv.normalize_obs(raw))
        expected = model.predict(shown, deterministic=True)[0]
        np.testing.assert_allclose(policy(raw), np.clip(expected, -1, 1), atol=2e-3)


@pytest.mark.parametrize("symmetric", [True, False])
def test_fixed_scales_within_a_normaliser(symmetric):
    """Both scalings are folded into the first layer, in their order."""
    env = VecNormalize(fish(), clip_obs=np.inf)
    options = equivariant_options(env.unwrapped.fish) | TANH
    if not symmetric:
        del options["reflection"]
    model = learner(env, policy=EquivariantPolicy if symmetric else "MlpPolicy", options=options)
    assert_same_actions(model, export_policy(model, {}))


class Shifted(VecEnvWrapper):
    """Shows other observations."""

    def reset(self):
        return self.venv.reset() + 1.0

    def step_wait(self):
        obs, *rest = self.venv.step_wait()
        return obs + 1.0, *rest


class Subclass(sb3.ppo.MlpPolicy):
    """May do anything."""


class Extractor(ScaledObservation):
    """Scales twice."""

    def forward(self, obs):
        return super().forward(super().forward(obs))


def single(*wrappers):
    """Single fish in wrappers of Gymnasium."""

    def make():
        env = gym.make("FishEnv/Swim-v0")
        for wrap in wrappers:
            env = wrap(env)
        return env

    return DummyVecEnv([make])


def scaled_actions(env):
    """Actions from 0 to 1."""
    return gym.wrappers.RescaleAction(env, np.float32(0.0), np.float32(1.0))


SQUASHED = TANH | {"squash_output": True}
REFUSED = {
    "SAC": (lambda: learner(fish(), sb3.SAC, options=None, trained=8), "a SACPolicy is not exported"),
    "TD3": (lambda: learner(fish(), sb3.TD3, options=None, trained=8), "a TD3Policy is not exported"),
    "DDPG": (lambda: learner(fish(), sb3.DDPG, options=None, trained=8), "a TD3Policy is not exported"),
    "subclass": (lambda: learner(fish(), policy=Subclass), "a Subclass is not exported"),
    "squashed": (lambda: learner(fish(), use_sde=True, options=SQUASHED), "actions are squashed by tanh"),
    "ReLU": (lambda: learner(fish(), options={"activation_fn": torch.nn.ReLU}), "a hidden layer has ReLU"),
    "Hardtanh": (lambda: learner(fish(), options={"activation_fn": torch.nn.Hardtanh}), "a hidden layer has Hardtanh"),
    "extractor": (
        lambda: learner(fish(), options=TANH | {
            "features_extractor_class": Extractor,
            "features_extractor_kwargs": {"offset": np.zeros(156), "scale": np.ones(156)},
        }),
        "observations pass Extractor",
    ),
    "clipped": (lambda: learner(VecNormalize(fish(), clip_obs=0.5)), "VecNormalize clips observations at 0.5"),
    "not seen": (lambda: with_env(learner(fish()), VecNormalize(fish())), "VecNormalize clips observations at 10"),
    "stacked": (lambda: learner(VecFrameStack(fish(), 2)), "has a VecFrameStack"),
    "stacked before": (lambda: learner(single(lambda env: gym.wrappers.FrameStackObservation(env, 2))), "one vector"),
    "shifted": (lambda: learner(Shifted(fish())), "has a Shifted"),
    "shifted inside": (lambda: learner(VecMonitor(Shifted(fish()))), "has a Shifted"),
    "shifted one by one": (lambda: learner(single(gym.wrappers.NormalizeObservation)), "has a ObservationWrapper"),
    "other actions": (lambda: learner(single(scaled_actions)), "has a ActionWrapper"),
    "no environment": (lambda: without_env(learner(fish())), "has no environment"),
    "diverged": (lambda: diverged(learner(fish())), "not finite"),
}  # fmt: skip


def with_env(model, env):
    """The model in another environment, as one that is loaded: it has seen nothing in it."""
    model.rollout_buffer.reset()
    model.set_env(env)
    return model


def without_env(model):
    """The model as it is loaded without an environment."""
    model.env = None
    return model


def diverged(model):
    """The model with a parameter that is no number."""
    with torch.no_grad():
        model.policy.action_net.bias[0] = np.nan
    return model


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_act_otherwise_is_refused(name):
    """Each with its reason."""
    make, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        export_policy(make(), {})


def test_a_policy_alone():
    """It does not know what it observes: who gives it says so."""
    model = learner(fish())
    with pytest.raises(ValueError, match="whether its observations are normalised"):
        export_policy(model.policy, {})
    assert_same_actions(model, export_policy(model.policy, {}, raw=True))


def test_a_wrapper_that_combines_actions_may_not_stack_frames():
    """With the matrix of a wrapper, what is seen must still be what the environment shows."""
    model = learner(VecFrameStack(fish(), 2))
    with pytest.raises(ValueError, match=r"expects observations of shape \(312,\), the environment returns \(156,\)"):
        export_policy(model, {}, np.eye(12))


def test_the_training_of_the_package_is_exported():
    """The wrapper of `train.py` needs its matrix."""
    model = make_model(CONFIGS["swim"], make_env(CONFIGS["swim"], 2, 0), 0)
    with pytest.raises(ValueError, match="has a Synergies"):
        equivariant.export_policy(model, {})
