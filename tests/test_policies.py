"""Policies: models, their exported policies and the files of these act alike; what would act otherwise is refused."""

import importlib
import io
import json
import os
import sys
import tracemalloc
import warnings
import zipfile
from dataclasses import replace

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
from fish_env import __main__ as command_line
from fish_env.control import (
    Normalisation,
    Policy,
    compare,
    evaluate,
    load_policy,
    load_recording,
    make_eval_env,
    make_policy_env,
    play,
    record,
    replay,
    write_film,
)
from fish_env.control.equivariant import (
    EquivariantPolicy,
    equivariant_options,
    export_policy,
    reflection_of,
)
from fish_env.control.files import LARGEST, replacing, writable_file, write_text
from fish_env.control.policy import HIDDEN, OUTPUT
from fish_env.envs import FishVectorEnv

TANH = {"activation_fn": torch.nn.Tanh}
SMALL = {"net_arch": [32, 32]}
STUB = "FishEnv/Stub-v0"


@pytest.fixture(autouse=True)
def one_thread():
    """Torch on one thread, as the scripts have it."""
    torch.set_num_threads(1)


def fish(**options):
    """A batch of fish."""
    return fish_env.make_sb3_vec_env("FishEnv/Swim-v0", num_envs=4, seed=0, **options)


def single(*wrappers):
    """One fish in wrappers of Gymnasium."""

    def make():
        env = gym.make("FishEnv/Swim-v0")
        for wrap in wrappers:
            env = wrap(env)
        return env

    return DummyVecEnv([make])


def learner(env, algorithm=sb3.PPO, policy="MlpPolicy", options=TANH, trained=256, **settings):
    """A learner trained for a moment, its actions large enough to be clipped now and then."""
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


def scaled(symmetric):
    """A learner whose observations are normalised, and then scaled by fixed numbers."""
    env = VecNormalize(fish(), clip_obs=3.0)
    options = equivariant_options(env.unwrapped.fish) | TANH
    if not symmetric:
        del options["reflection"]
    return learner(env, policy=EquivariantPolicy if symmetric else "MlpPolicy", options=options)


MODELS = {
    "A2C": lambda: learner(fish(), sb3.A2C, n_steps=16),
    "ReLU": lambda: learner(fish(), options={"activation_fn": torch.nn.ReLU}),
    "linear": lambda: learner(fish(), options=TANH | {"net_arch": []}),
    "other layers": lambda: learner(fish(), options=TANH | {"net_arch": {"pi": [8, 24], "vf": [5]}}),
    "extractors of their own": lambda: learner(fish(), options=TANH | {"share_features_extractor": False}),
    "squashed": lambda: learner(fish(), use_sde=True, options=TANH | {"squash_output": True}),
    "SAC, normalised": lambda: learner(VecNormalize(fish()), sb3.SAC, options=SMALL),
    "SAC, noise by state": lambda: learner(fish(), sb3.SAC, options=SMALL | {"clip_mean": 0.0}, use_sde=True),
    "TD3": lambda: learner(fish(), sb3.TD3, options=SMALL),
    "DDPG": lambda: learner(fish(), sb3.DDPG, options=SMALL | TANH),
    "TQC": lambda: learner(VecNormalize(fish()), contrib("TQC"), options=SMALL),
    "returns normalised": lambda: learner(VecNormalize(fish(), norm_obs=False)),
    "observations normalised": lambda: learner(VecNormalize(fish(), clip_obs=np.inf)),
    "normalised within others": lambda: learner(VecMonitor(VecCheckNan(VecNormalize(fish(), clip_obs=0.5)))),
    "of single fish": lambda: learner(VecNormalize(single())),
    "scaled": lambda: scaled(False),
    "equivariant": lambda: scaled(True),
}


@pytest.mark.parametrize("name", MODELS)
def test_exported_models_act_alike(name, tmp_path):
    """Whatever the algorithm, the layers and the normalisation, the file acts as the model does in its wrappers."""
    model = MODELS[name]()
    export_policy(model, {"env_id": "FishEnv/Swim-v0"}).save(tmp_path / "policy.npz")
    assert_same_actions(model, load_policy(tmp_path / "policy.npz"))


def test_a_policy_alone():
    """It does not know what it observes: who gives it says so."""
    model = learner(fish())
    with pytest.raises(ValueError, match="whether its observations are normalised"):
        export_policy(model.policy, {})
    assert_same_actions(model, export_policy(model.policy, {}, raw=True))


class Shifted(VecEnvWrapper):
    """Shows other observations."""

    def reset(self):
        return self.venv.reset() + 1.0

    def step_wait(self):
        obs, *rest = self.venv.step_wait()
        return obs + 1.0, *rest


class Discrete(gym.ActionWrapper):
    """Three actions."""

    action_space = gym.spaces.Discrete(3)

    def action(self, action):
        return np.full(12, action - 1.0)


def made(algorithm, policy, env, **settings):
    """An untrained learner."""
    return algorithm(policy, env, device="cpu", **settings)


def without_env(model):
    """The model as it is loaded without an environment."""
    model.env = None
    return model


def diverged(model):
    """The model with a parameter that is no number."""
    with torch.no_grad():
        model.policy.action_net.bias[0] = np.nan
    return model


WRAPPERS = gym.wrappers
REFUSED = {
    "discrete": (lambda: made(sb3.DQN, "MlpPolicy", single(Discrete)), "actions are a Discrete; train on a Box"),
    "recurrent": (lambda: made(contrib("RecurrentPPO"), "MlpLstmPolicy", fish()),
                  "a RecurrentActorCriticPolicy is not exported"),
    "bounded mean": (lambda: made(sb3.SAC, "MlpPolicy", fish(), use_sde=True), "a layer has Hardtanh.* clip_mean=0.0"),
    "ELU": (lambda: learner(fish(), options={"activation_fn": torch.nn.ELU}), "a layer has ELU; train with"),
    "stacked": (lambda: learner(VecFrameStack(fish(), 2)), "has a VecFrameStack"),
    "stacked before": (lambda: learner(single(lambda env: WRAPPERS.FrameStackObservation(env, 2))), "one vector"),
    "shifted inside": (lambda: learner(VecMonitor(Shifted(fish()))), "has a Shifted"),
    "shifted one by one": (lambda: learner(single(WRAPPERS.NormalizeObservation)), "has a NormalizeObservation"),
    "other actions": (lambda: learner(single(lambda env: WRAPPERS.RescaleAction(env, np.float32(0), np.float32(1)))),
                      "are not from -1 to 1"),
    "held actions": (lambda: learner(single(lambda env: WRAPPERS.StickyAction(env, 0.25))), "has a StickyAction"),
    "no environment": (lambda: without_env(learner(fish())), "has no environment"),
    "diverged": (lambda: diverged(learner(fish())), "not finite"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_act_otherwise_is_refused(name):
    """Each with its reason."""
    make, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        export_policy(make(), {})


def test_a_wrapper_that_combines_actions_may_not_stack_frames():
    """With the matrix of a wrapper, what is seen must still be what the environment shows."""
    model = learner(VecFrameStack(fish(), 2))
    with pytest.raises(ValueError, match=r"expects observations of shape \(312,\), the environment returns \(156,\)"):
        export_policy(model, {}, np.eye(12))


# Models in evaluations


ACTING = {
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


# The reflection


def test_mirror_is_the_fish_seen_in_a_mirror():
    """Observations of a mirrored fish are the mirrored observations, and mirroring twice changes nothing."""
    env = FishVectorEnv(2, task="avoid")
    body = env.tank.fish
    place, sign, swap = reflection_of(env)
    np.testing.assert_array_equal(place[place], np.arange(len(place)))
    np.testing.assert_array_equal(swap[swap], np.arange(len(swap)))
    for i, side in enumerate((1, -1)):
        options = {"yaw": 0.0, "turn": side * 0.9, "wait": 0.1, "gap": 0.5, "aside": side * 0.3, "drift": side * 0.5}
        env.reset(seed=0, options={**options, "reset_mask": np.arange(2) == i})
    env.tank.position[1] = (env.tank.position[0] * [1, -1, 1])[body.mirror]
    env.tank.velocity[1] = (env.tank.velocity[0] * [1, -1, 1])[body.mirror]
    env._measure()
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 12)):
        obs, *_ = env.step(np.stack([action, action[swap]]))
        np.testing.assert_allclose(obs[1], obs[0][place] * sign, atol=1e-5)
    assert np.abs(obs[0] - obs[1]).max() > 0.1


@pytest.mark.parametrize(("id", "body", "groups"), [("Target", "mass_spring", "muscles"), ("Stub", "planar", "pairs")])
def test_policy_is_equivariant(id, body, groups):
    """Its action for a reflected observation is the reflected action, and the value is the same."""
    env = fish_env.make_sb3_vec_env(f"FishEnv/{id}-v0", num_envs=4, seed=0, body=body, muscle_groups=groups)
    model = learner(env, policy=EquivariantPolicy, options=equivariant_options(env.unwrapped.fish) | TANH)
    place, sign, swap = reflection_of(env.unwrapped.fish)
    obs = env.reset()
    other = (obs[:, place] * sign).astype(np.float32)
    (one, _), (reflected, _) = (model.predict(seen, deterministic=True) for seen in (obs, other))
    np.testing.assert_allclose(reflected, one[:, swap], atol=1e-5)
    assert np.abs(one - one[:, swap]).max() > 0.01
    values = [model.policy.predict_values(torch.as_tensor(seen)).detach().numpy() for seen in (obs, other)]
    np.testing.assert_allclose(*values, atol=1e-5)


@pytest.mark.parametrize("module", ["fish_env.control.equivariant", "fish_env.envs.sb3"])
def test_it_says_what_to_install(module, monkeypatch):
    """Without torch and Stable-Baselines3 a module that needs them says what is to be installed."""
    for name in ("torch", "stable_baselines3", "stable_baselines3.common.vec_env"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, module, raising=False)
    with pytest.raises(ImportError, match=r'pip install "fish_env\[train\]"'):
        importlib.import_module(module)


# Formats


LAYERS = [(156, 24), (24, 12), (12, 12)]


def drawn_policy(hidden="tanh", output="clip", limit=None, env_id="FishEnv/Swim-v0"):
    """A policy of random numbers, which normalises unless `limit` is None."""
    rng = np.random.default_rng(0)
    weights = tuple((rng.normal(size=size) / size[0] ** 0.5).astype(np.float32) for size in LAYERS)
    biases = tuple(rng.normal(scale=0.3, size=size[1]).astype(np.float32) for size in LAYERS)
    scaling = None if limit is None else Normalisation(rng.normal(size=156), rng.uniform(0.3, 2.0, 156), limit)
    about = {"env_id": env_id, "note": "é"}
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


def test_a_policy_is_in_the_file_that_is_named(tmp_path):
    """Also where numpy would add another ending; what could not be read again is refused, and an old file stays."""
    policy = drawn_policy("tanh", "clip", 3)
    policy.save(tmp_path / "new" / "P.NPZ")
    again = load_policy(tmp_path / "new" / "P.NPZ")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["P.NPZ"] and again.normalisation.limit == 3.0
    assert replace(policy, weights=[each.astype(float) for each in policy.weights])(np.zeros(156)).dtype == np.float32
    for change, message in (
        ({"about": {}}, "does not say which environment"),
        ({"biases": policy.biases[:-1]}, "missing or extra parts"),
        ({"weights": (np.full_like(policy.weights[0], np.nan), *policy.weights[1:])}, "not finite"),
        ({"normalisation": policy.normalisation._replace(limit=0)}, "no limit above zero"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(policy, **change).save(tmp_path / "new" / "P.NPZ")
    for few in (3.0, [], np.zeros(3), np.zeros((156, 1))):
        with pytest.raises(ValueError, match=r"the observation has shape .*; give \(\.\.\., 156\)"):
            policy(few)
    with pytest.raises(ValueError, match=r"ends in '\.v1'; give a name that ends in \.npz"):
        policy.save(tmp_path / "policy.v1")
    np.testing.assert_array_equal(load_policy(tmp_path / "new" / "P.NPZ").weights[0], policy.weights[0])
    assert load_recording(stub_recording().save(tmp_path / "R.NPZ")).steps == stub_recording().steps


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
        (damage(lambda model: model.graph.node.pop()), "its graph is another one"),
        (damage(lambda model: model.graph.initializer.pop(0)), "missing or extra parts .*weight0"),
        (damage(lambda model: model.metadata_props.pop()), "output is 'None'; choose from"),
        (damage(move_outside), "its numbers are in other files"),
    ],
)
def test_other_onnx_files_are_refused(change, message, tmp_path):
    """Truncated or changed models are refused with the reason, and no other file is read."""
    pytest.importorskip("onnx")
    path = tmp_path / "policy.onnx"
    drawn_policy(limit=2.0).to_onnx(path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(ValueError, match=message):
        load_policy(path)


def test_what_formats_need(tmp_path, monkeypatch):
    """Another ending is refused, and a library that is missing is named; nothing is left of the file."""
    policy = drawn_policy()
    for write, module, ending in ((policy.to_onnx, "onnx", "onnx"), (policy.to_torchscript, "torch", "pt")):
        with pytest.raises(ValueError, match=rf"ends in '.npz'; give a name that ends in .{ending}"):
            write(tmp_path / "policy.npz")
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ImportError, match=r"pip install .fish_env\[(onnx|train)\]"):
            write(tmp_path / f"policy.{ending}")
    assert not list(tmp_path.iterdir())


# Files: written whole


@pytest.mark.parametrize("name", ["policy.npz", "e\u0301.html", "n" * 245 + ".csv", "bare"])
def test_two_writers_of_one_file(name, tmp_path):
    """Each writes a file of its own with the same ending; the last to end is what is there, whole."""
    path = tmp_path / name
    with replacing(path) as one, replacing(path) as other:  # `other` ends first
        assert one != other and {one.suffix, other.suffix} == {path.suffix} and one.parent == tmp_path
        one.write_text("one " * 1000)
        other.write_text("other")
        assert not path.exists()
    assert path.read_text() == "one " * 1000 and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_of_what_was_not_finished(error, tmp_path):
    """Whatever is raised, the old file is there, and nothing beside it; the rights are those of any new file."""
    path, before = tmp_path / "x.txt", os.umask(0o027)
    write_text(path, "old")
    os.umask(before)
    with pytest.raises(error), replacing(path) as partial:
        partial.write_text("ne")
        raise error
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path] and path.stat().st_mode & 0o777 == 0o640


def test_files_are_tried_before_anything_is_computed(tmp_path):
    """Names that are too long, other endings, and files and folders in place of each other change nothing."""
    taken, long = tmp_path / "taken", "x" * 300
    taken.write_text("content")
    (tmp_path / "folder.gif").mkdir()
    for path, message in (
        (taken / "x.gif", "no file can be written in the folder"),
        (tmp_path / "x.avi", r"give a name that ends in .mp4 or .gif"),
        (tmp_path / "folder.gif", "is a folder"),
        (tmp_path / f"{long}.gif", r"no file can be written as .*give another name"),
    ):
        with pytest.raises(ValueError, match=message):
            writable_file(path, (".mp4", ".gif"))
    assert writable_file(tmp_path / "new" / "x.gif", (".gif",)).parent.is_dir()
    assert taken.read_text() == "content" and not list((tmp_path / "new").iterdir())
    for read in (load_policy, load_recording):
        with pytest.raises(FileNotFoundError, match="there is no"):
            read(tmp_path / f"{long}.npz")


# Files: read


def stub_policy(**about):
    """A policy for the stub."""
    policy = drawn_policy(env_id=STUB, limit=10.0)
    return replace(policy, about=policy.about | about)


def stub_recording(**about):
    """Two steps of the stub, of which something else may be said."""
    one = record(gym.make(STUB, max_episode_steps=3), np.zeros((2, 12)), seed=1)
    return replace(one, about=one.about | about)


def array(shape, data=b"", descr="<f4"):
    """A part that says that it is an array of this shape and type, and holds these bytes."""
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": descr, "fortran_order": False, "shape": shape})
    return out.getvalue() + data


BAD = {
    "unpacks to 100 MB": ([bytes(100 * 2**20)], "unpacks to 104,857,600"),
    "many parts of 1 MB": ([bytes(2**20)] * 40, "unpacks to"),
    "objects": ([array((), b"cos\nsystem\n.", "|O")], "allow_pickle=False"),
    "no archive": (None, ""),
}


@pytest.mark.parametrize("kind", BAD)
def test_archives_that_are_not_what_they_say(kind, tmp_path):
    """Refused in a sentence that names the file, before more memory is taken than the largest honest file needs."""
    path, (parts, message) = tmp_path / "file.npz", BAD[kind]
    if parts is None:
        path.write_bytes(b"hello" * 100)
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            for k, data in enumerate(parts):
                file.writestr(f"{k}.npy", data)
    tracemalloc.start()
    try:
        for read, name in ((load_policy, "policy file"), (load_recording, "recording")):
            with pytest.raises(ValueError, match=rf"file\.npz is not a {name}, or is damaged or pickled .*{message}"):
                read(path)
        assert tracemalloc.get_traced_memory()[1] < 2 * LARGEST
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("kind", "name", "change", "message"),
    [
        ("policy", "bias0", None, r"missing or extra parts \['bias0'\]"),
        ("policy", "format", lambda array: 99, "format 99 and not 2 or 3"),
        ("policy", "layout", lambda array: 7, "version 7 of the observation layout; this package has version 1"),
        ("policy", "weight0", lambda array: array[:, :-1], "should be floating of shape"),
        ("policy", "weight0", lambda array: array.astype(int), "should be floating of shape"),
        ("policy", "bias0", lambda array: array * np.nan, "not finite"),
        ("policy", "about", lambda array: "[" * 100_000, "about"),
        ("policy", "about", lambda array: "{}", "does not say which environment it is for"),
        ("policy", "about", lambda array: json.dumps({"env_id": "FishEnv/Other-v0"}), "trained for FishEnv/Other"),
        ("policy", "hidden", lambda array: "elu", "hidden is 'elu'.*; choose from 'tanh', 'relu'"),
        ("policy", "deviation", lambda array: 0.0 * array, "or deviations of zero or less"),
        ("policy", "limit", lambda array: np.nan, "no limit above zero, or"),
        ("recording", "format", lambda array: 2, "has format 2; this package reads format 1: record the episode again"),
        ("recording", "velocity", None, r"missing or extra parts \['velocity'\]"),
        ("recording", "velocity", lambda array: array[:-1], "velocity is .* it should be"),
        ("recording", "action", lambda array: array[:-1], "it should be|states for"),
        ("recording", "reward", lambda array: array.astype(np.float32), "reward is .*float32; it should be float64"),
        ("recording", "failure", lambda array: array - 1, "failure holds numbers that name no failure"),
        ("recording", "about", lambda array: "{}", "describes no episode"),
        ("recording", "kind", lambda array: "x", "it is no recording"),
    ],
)  # fmt: skip
def test_wrong_parts(kind, name, change, message, tmp_path):
    """Parts of another format, missing, ill-fitting or not finite: each says why."""
    path, read = tmp_path / "file.npz", {"policy": lambda path: load_policy(path, STUB), "recording": load_recording}
    (stub_policy() if kind == "policy" else stub_recording()).save(path)
    parts = dict(np.load(path))
    before = parts.pop(name)
    np.savez(path, **parts, **({} if change is None else {name: change(before)}))
    with pytest.raises(ValueError, match=rf"file\.npz cannot be used: .*({message})"):
        read[kind](path)


# Read: which environment


def uses(policy, one, folder):
    """All that makes the environment of a policy or of a recording."""
    film = folder / "x.html"
    return [lambda: make_policy_env(policy, 1), lambda: play(policy, 0, 1, film), lambda: replay(one),
            lambda: write_film(one, film)]  # fmt: skip


@pytest.mark.parametrize("env_id", ["planted:" + STUB, "FishEnv/planted:Swim-v0", "planted:", STUB + "\n", "../planted",
                                    "", "x" * 1000, 3, None, {"id": "planted"}, "F\u0131shEnv/Stub-v0"],
                         ids=lambda id: repr(id)[:30])  # fmt: skip
def test_a_file_has_no_module_imported(env_id, tmp_path, capsys, monkeypatch):
    """Ids that are not plain are refused by all that reads policies and recordings; no module is imported."""
    (tmp_path / "planted.py").write_text("raise SystemExit('it was imported')")
    monkeypatch.syspath_prepend(tmp_path)
    paths = [tmp_path / "policy.npz", tmp_path / "recording.npz"]
    stub_policy().save(paths[0])
    stub_recording().save(paths[1])
    for path in paths:
        parts = dict(np.load(path))
        np.savez(path, **parts | {"about": json.dumps(json.loads(str(parts["about"])) | {"env_id": env_id})})
    policy, one = stub_policy(env_id=env_id), stub_recording(env_id=env_id)
    for use in (lambda: load_policy(paths[0]), lambda: load_recording(paths[1]), *uses(policy, one, tmp_path)):
        with pytest.raises(ValueError, match="env_id is"):
            use()
    for command in (["evaluate", "--policy", str(paths[0])], ["replay", str(paths[1])]):
        assert command_line.main(command) == 2 and capsys.readouterr().err.count("\n") == 1
    assert "planted" not in sys.modules


@pytest.mark.parametrize(("env_id", "message"), [
    ("Nobody/Fish-v7", "is not registered; import the package that registers it first"),
    ("FishEnv/Stub", "is not registered"), ("CartPole-v1", "not an environment of fish"),
])  # fmt: skip
def test_environments_that_are_not_made(env_id, message, tmp_path, monkeypatch):
    """Files of environments that are not registered, or not of fish, can be read, for plots; nothing is made."""
    policy, one = stub_policy(env_id=env_id, env_options={"map_name": "x"}), stub_recording(env_id=env_id)
    policy.save(tmp_path / "policy.npz")
    assert load_policy(tmp_path / "policy.npz").about["env_id"] == env_id
    assert load_recording(one.save(tmp_path / "one.npz")).about["env_id"] == env_id
    for name in ("make", "make_vec"):
        monkeypatch.setattr(gym, name, lambda *a, **k: pytest.fail("it was made"))
    for use in uses(policy, one, tmp_path):
        with pytest.raises(ValueError, match=message):
            use()


OPTIONS = [
    ({"num_envs": 10**9}, "env_options has 'num_envs'"), ({"render_mode": "human"}, "has 'render_mode'"),
    (None, "env_options is"), ({"a b": 1}, "env_options is"), ({"control_interval": -0.02}, "control_interval is"),
    ({"control_interval": float("nan")}, "control_interval is nan"), ({"control_interval": [0.02]}, "_interval is"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), OPTIONS, ids=str)
def test_keywords_that_are_not_the_environments(options, message, tmp_path):
    """Keywords of those who make an environment, and what is no keyword, are refused when a file is written or read."""
    policy = stub_policy(env_options=options)
    with pytest.raises(ValueError, match=message):
        policy.save(tmp_path / "policy.npz")
    np.savez(tmp_path / "policy.npz", **policy.parts())
    with pytest.raises(ValueError, match=rf"policy\.npz.*{message}"):
        load_policy(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match=rf"one\.npz cannot be used: .*{message}"):
        load_recording(stub_recording(env_options=options).save(tmp_path / "one.npz"))
