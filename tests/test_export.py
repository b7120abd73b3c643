"""Models, their exported policies and the files of these act alike; what would act otherwise is refused."""

import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")
sb3 = pytest.importorskip("stable_baselines3")

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecEnvWrapper,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

import fish_env
from fish_env.control import Normalisation, Policy, compare, equivariant, evaluate, load_policy, make_eval_env, record
from fish_env.control.equivariant import EquivariantPolicy, ScaledObservation, equivariant_options, export_policy
from fish_env.control.policy import HIDDEN, OUTPUT
from fish_env.training.build import make_env, make_model
from fish_env.training.config import CONFIGS

TANH = {"activation_fn": torch.nn.Tanh}
SMALL = {"net_arch": [32, 32]}


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


def fish(**options):
    """A batch of fish."""
    return fish_env.make_sb3_vec_env("FishEnv/Swim-v0", num_envs=4, seed=0, **options)


def learner(env, algorithm=sb3.PPO, policy="MlpPolicy", options=TANH, trained=256, **settings):
    """A learner that has learnt a little, its actions large enough to be clipped now and then."""
    if issubclass(algorithm, sb3.PPO):
        settings = {"n_steps": 16, "batch_size": 32} | settings
    elif issubclass(algorithm, OffPolicyAlgorithm):
        settings = {"learning_starts": 100, "batch_size": 32, "buffer_size": 1000, "train_freq": 10} | settings
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = algorithm(policy, env, policy_kwargs=dict(options), device="cpu", seed=0, **settings)
        model.learn(trained)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return model


def contrib(name):
    """An algorithm of sb3-contrib."""
    return getattr(pytest.importorskip("sb3_contrib"), name)


def assert_same_actions(model, policy):
    """The policy gives, for 1,000 raw observations, the actions of the model for what it is shown, to 1e-5."""
    env, normaliser = model.get_env(), model.get_vec_normalize_env()
    if normaliser is not None:
        normaliser.training = False
    shown, free, seen = env.reset(), [], 0
    while seen < 1000:
        raw = shown if normaliser is None else normaliser.get_original_obs()
        expected = model.predict(shown, deterministic=True)[0]
        np.testing.assert_allclose(policy(raw), np.clip(expected, -1, 1), rtol=0, atol=1e-5)
        free.append(np.abs(np.abs(expected) - 0.5) < 0.48)  # neither near zero nor at a bound
        seen += len(raw)
        shown, *_ = env.step(expected)
    assert np.mean(free) > 0.3


MODELS = {
    "as it is": lambda: learner(fish()),
    "A2C": lambda: learner(fish(), sb3.A2C, n_steps=16),
    "ReLU": lambda: learner(fish(), options={"activation_fn": torch.nn.ReLU}),
    "linear": lambda: learner(fish(), options=TANH | {"net_arch": []}),
    "other layers": lambda: learner(fish(), options=TANH | {"net_arch": {"pi": [8, 24], "vf": [5]}}),
    "extractors of their own": lambda: learner(fish(), options=TANH | {"share_features_extractor": False}),
    "noise that depends on the state": lambda: learner(fish(), use_sde=True),
    "squashed": lambda: learner(fish(), use_sde=True, options=TANH | {"squash_output": True}),
    "SAC": lambda: learner(fish(), sb3.SAC, options=SMALL),
    "SAC, normalised": lambda: learner(VecNormalize(fish()), sb3.SAC, options=SMALL),
    "SAC with noise that depends on the state": lambda: learner(
        fish(), sb3.SAC, options=SMALL | {"clip_mean": 0.0}, use_sde=True
    ),
    "TD3": lambda: learner(fish(), sb3.TD3, options=SMALL),
    "DDPG": lambda: learner(fish(), sb3.DDPG, options=SMALL | TANH),
    "TQC": lambda: learner(VecNormalize(fish()), contrib("TQC"), options=SMALL),
    "returns normalised": lambda: learner(VecNormalize(fish(), norm_obs=False)),
    "observations normalised": lambda: learner(VecNormalize(fish(), clip_obs=np.inf)),
    "normalised and clipped": lambda: learner(VecNormalize(fish(), clip_obs=0.5)),
    "normalised within others": lambda: learner(VecMonitor(VecCheckNan(VecNormalize(fish())))),
    "of single fish": lambda: learner(VecNormalize(single())),
}


@pytest.mark.parametrize("name", MODELS)
def test_exported_models_act_alike(name, tmp_path):
    """Whatever the algorithm, the layers and the normalisation, the file acts as the model does in its wrappers."""
    model = MODELS[name]()
    export_policy(model, {"env_id": "FishEnv/Swim-v0"}).save(tmp_path / "policy.npz")
    assert_same_actions(model, load_policy(tmp_path / "policy.npz"))


@pytest.mark.parametrize("symmetric", [True, False])
def test_fixed_scales_within_a_normaliser(symmetric):
    """Both scalings are done, in their order."""
    env = VecNormalize(fish(), clip_obs=3.0)
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


def held_actions(env):
    """Actions that are repeated now and then."""
    return gym.wrappers.StickyAction(env, 0.25)


class Pictures(gym.ObservationWrapper):
    """Pictures in place of numbers."""

    observation_space = gym.spaces.Box(0, 255, (3, 36, 36), np.uint8)

    def observation(self, observation):
        return self.observation_space.sample()


def made(algorithm, policy, env, **settings):
    """An untrained learner."""
    return algorithm(policy, env, device="cpu", **settings)


class Discrete(gym.ActionWrapper):
    """Three actions."""

    action_space = gym.spaces.Discrete(3)

    def action(self, action):
        return np.full(12, action - 1.0)


class Named(gym.ObservationWrapper):
    """Observations by name."""

    def __init__(self, env):
        super().__init__(env)
        self.observation_space = gym.spaces.Dict(seen=env.observation_space)

    def observation(self, observation):
        return {"seen": observation}


REFUSED = {
    "DQN": (lambda: made(sb3.DQN, "MlpPolicy", single(Discrete)), "actions are a Discrete; train on a Box"),
    "discrete": (lambda: made(sb3.PPO, "MlpPolicy", single(Discrete)), "actions are a Discrete; train on a Box"),
    "by name": (lambda: made(sb3.PPO, "MultiInputPolicy", single(Named)), "observations are a Dict"),
    "pictures": (lambda: made(sb3.PPO, "CnnPolicy", single(Pictures)), "observations are a Box of shape"),
    "recurrent": (lambda: made(contrib("RecurrentPPO"), "MlpLstmPolicy", fish()),
                  "a RecurrentActorCriticPolicy is not exported"),
    "other layers": (lambda: made(contrib("CrossQ"), "MlpPolicy", fish()), "a CrossQPolicy is not exported"),
    "bounded mean": (lambda: made(sb3.SAC, "MlpPolicy", fish(), use_sde=True), "a layer has Hardtanh.* clip_mean=0.0"),
    "normalised twice": (lambda: made(sb3.PPO, "MlpPolicy", VecNormalize(VecNormalize(fish()))), "VecNormalize twice"),
    "subclass": (lambda: learner(fish(), policy=Subclass), "a Subclass is not exported"),
    "ELU": (lambda: learner(fish(), options={"activation_fn": torch.nn.ELU}), "a layer has ELU; train with"),
    "extractor": (
        lambda: learner(fish(), options=TANH | {
            "features_extractor_class": Extractor,
            "features_extractor_kwargs": {"offset": np.zeros(156), "scale": np.ones(156)},
        }),
        "observations pass Extractor",
    ),
    "stacked": (lambda: learner(VecFrameStack(fish(), 2)), "has a VecFrameStack"),
    "stacked before": (lambda: learner(single(lambda env: gym.wrappers.FrameStackObservation(env, 2))), "one vector"),
    "shifted": (lambda: learner(Shifted(fish())), "has a Shifted"),
    "shifted inside": (lambda: learner(VecMonitor(Shifted(fish()))), "has a Shifted"),
    "shifted one by one": (lambda: learner(single(gym.wrappers.NormalizeObservation)), "has a NormalizeObservation"),
    "other actions": (lambda: learner(single(scaled_actions)), "are not from -1 to 1"),
    "held actions": (lambda: learner(single(held_actions)), "has a StickyAction"),
    "delayed": (lambda: learner(single(lambda env: gym.wrappers.DelayObservation(env, 2))), "has a "),
    "no environment": (lambda: without_env(learner(fish())), "has no environment"),
    "diverged": (lambda: diverged(learner(fish())), "not finite"),
}  # fmt: skip


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
    with pytest.raises(ValueError, match="actions are not from -1 to 1"):
        equivariant.export_policy(model, {})


LAYERS = [(156, 24), (24, 12), (12, 12)]


def drawn_policy(hidden, output, limit, seed=0):
    """A policy of random numbers, which normalises unless `limit` is None."""
    rng = np.random.default_rng(seed)
    weights = tuple((rng.normal(size=size) / size[0] ** 0.5).astype(np.float32) for size in LAYERS)
    biases = tuple(rng.normal(scale=0.3, size=size[1]).astype(np.float32) for size in LAYERS)
    scaling = None if limit is None else Normalisation(rng.normal(size=156), rng.uniform(0.3, 2.0, 156), limit)
    about = {"env_id": "FishEnv/Swim-v0", "note": "é"}
    return Policy(weights, biases, about, hidden=hidden, output=output, normalisation=scaling)


@pytest.mark.parametrize("limit", [None, 1.5, np.inf])
@pytest.mark.parametrize("output", OUTPUT)
@pytest.mark.parametrize("hidden", HIDDEN)
def test_every_format_acts_alike(hidden, output, limit, tmp_path):
    """numpy, ONNX and TorchScript agree to 1e-5; what is read again of .npz and .onnx has the same bits."""
    policy, seen = drawn_policy(hidden, output, limit), np.random.default_rng(1).normal(size=(1000, 156))
    expected, seen = policy(seen.astype(np.float32)), seen.astype(np.float32)
    assert np.mean(np.abs(expected) < 0.9) > 0.2 and expected.std() > 0.1
    policy.save(tmp_path / "policy.npz")
    np.testing.assert_array_equal(load_policy(tmp_path / "policy.npz")(seen), expected)
    policy.to_torchscript(tmp_path / "policy.pt")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        found = torch.jit.load(tmp_path / "policy.pt")(torch.from_numpy(seen))
    np.testing.assert_allclose(found.numpy(), expected, rtol=0, atol=1e-5)
    pytest.importorskip("onnx")
    policy.to_onnx(tmp_path / "policy.onnx")
    session = pytest.importorskip("onnxruntime").InferenceSession(tmp_path / "policy.onnx")
    np.testing.assert_allclose(session.run(None, {"observation": seen})[0], expected, rtol=0, atol=1e-5)
    again = load_policy(tmp_path / "policy.onnx", "FishEnv/Swim-v0")
    np.testing.assert_array_equal(again(seen), expected)
    assert again.about == policy.about and again.hidden == hidden and again.output == output


def damage(change):
    """A change of a model, as a change of its file."""

    def changed(data):
        onnx = pytest.importorskip("onnx")
        model = onnx.load_model_from_string(data)
        change(model)
        return model.SerializeToString()

    return changed


def move_outside(model):
    """Let numbers be read from another file."""
    part = model.graph.initializer[0]
    part.data_location = 1
    part.external_data.add(key="location", value="secret.bin")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-100], "policy.onnx cannot be used|not a policy file that Policy.to_onnx wrote"),
        (lambda data: b"", "not a policy file that Policy.to_onnx wrote"),
        (damage(lambda model: model.graph.node.pop()), "its graph is another one"),
        (damage(lambda model: model.graph.initializer.pop(0)), "missing or extra parts .*weight0"),
        (damage(lambda model: model.graph.initializer.pop()), "no limit above zero"),
        (damage(lambda model: model.metadata_props.pop()), "output is 'None'; choose from"),
        (damage(lambda model: model.metadata_props.add(key="weight3", value="x")), "missing or extra parts .*bias3"),
        (damage(move_outside), "its numbers are in other files"),
        (damage(lambda model: setattr(model.metadata_props[0], "value", "9")), "has format 9"),
        (damage(lambda model: setattr(model.metadata_props[2], "value", "[]")), "about"),
    ],
)
def test_other_onnx_files_are_refused(change, message, tmp_path):
    """Truncated or changed models are refused with the reason, and no other file is read."""
    pytest.importorskip("onnx")
    path = tmp_path / "policy.onnx"
    drawn_policy("tanh", "clip", 2.0).to_onnx(path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(ValueError, match=message):
        load_policy(path)


def test_what_formats_need(tmp_path, monkeypatch):
    """Another ending is refused, and a library that is missing is named; nothing is left of the file."""
    policy = drawn_policy("relu", "tanh", None)
    for write, ending in ((policy.to_onnx, "onnx"), (policy.to_torchscript, "pt")):
        with pytest.raises(ValueError, match=rf"ends in '.npz'; give a name that ends in .{ending}"):
            write(tmp_path / "policy.npz")
    for write, module, extra in ((policy.to_onnx, "onnx", "onnx"), (policy.to_torchscript, "torch", "train")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ImportError, match=rf"fish_env\[{extra}\]"):
            write(tmp_path / f"policy.{'pt' if module == 'torch' else module}")
    assert not list(tmp_path.iterdir())


ACTING = {
    "PPO": lambda: learner(fish()),
    "SAC, normalised": MODELS["SAC, normalised"],
    "recurrent": lambda: learner(
        fish(), contrib("RecurrentPPO"), "MlpLstmPolicy", {"lstm_hidden_size": 8}, 64, n_steps=8
    ),
}


@pytest.mark.parametrize("kind", ACTING)
def test_a_model_acts_as_its_exported_policy(kind):
    """`evaluate`, `record` and `compare` take the model itself, with what normalises its observations."""
    model, env = ACTING[kind](), make_eval_env("FishEnv/Swim-v0", 3, {"max_episode_steps": 20})
    one = gym.make("FishEnv/Swim-v0", max_episode_steps=20)
    scores, again = (evaluate(env, model) for _ in range(2))
    np.testing.assert_array_equal(scores["return"], again["return"])  # no memory is left of the episode before
    if kind == "recurrent":
        with pytest.raises(ValueError, match="RecurrentActorCriticPolicy is not exported"):
            export_policy(model, {})
        return
    policy = export_policy(model, {"env_id": "FishEnv/Swim-v0"})
    np.testing.assert_allclose(scores["return"], evaluate(env, policy)["return"], rtol=0, atol=1e-3)
    kept = [record(one, given, 5).action for given in (model, policy)]
    np.testing.assert_allclose(*kept, rtol=0, atol=1e-4)
    difference = compare(model, policy, env)["return"].difference
    assert abs(difference.low) < 1e-3 > abs(difference.high)


def test_a_model_with_goals():
    """Its observations are dicts: it is evaluated and recorded, but not exported, and not with `VecNormalize`."""
    options = {"goal_env": True, "max_episode_steps": 10}
    goals = fish_env.make_sb3_vec_env("FishEnv/Target-v0", 2, **options)
    model, env = learner(goals, sb3.SAC, "MultiInputPolicy"), gym.make("FishEnv/Target-v0", **options)
    assert evaluate(env, model, episodes=2)["return"].tolist() == [-10.0, -10.0] and record(env, model).steps == 10
    with pytest.raises(ValueError, match="observations are a Dict"):
        export_policy(model, {})
    with pytest.raises(ValueError, match="VecNormalize over a dict"):
        evaluate(env, learner(VecNormalize(goals), sb3.SAC, "MultiInputPolicy"))


UNFIT = {
    "policy of a model": (lambda: learner(fish()).policy, "whether its observations are normalised; give the model"),
    "other parts": (lambda: learner(fish(speed=1.0)), r"only the policy has commanded velocity \(3\)"),
    "no environment": (lambda: without_env(learner(fish())), "the model has no environment"),
    "other actions": (
        lambda: learner(fish(muscle_groups="pairs")),
        "trained with muscle_groups='pairs', and the environment has 'muscles'",
    ),
    "stacked": (lambda: learner(VecFrameStack(fish(), 2)), "has a VecFrameStack"),
}


@pytest.mark.parametrize("name", UNFIT)
def test_models_that_do_not_fit(name):
    """Each is refused with one line, before an environment step."""
    make, message = UNFIT[name]
    model, env = make(), make_eval_env("FishEnv/Swim-v0", 1, {})
    with pytest.raises(ValueError, match=message):
        evaluate(env, model)
