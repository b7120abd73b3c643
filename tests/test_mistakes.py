"""Twenty mistakes of newcomers, each answered at once by a sentence that says what to do."""

import gymnasium as gym
import pytest

from fish_env import Tank, make_fish, make_sb3_vec_env, make_water
from fish_env.__main__ import main
from fish_env.control import evaluate

STUB = "FishEnv/Stub-v0"
LIBRARY = "stable_baselines3.common.vec_env"
MISTAKES = [
    ("tran swim", "(did you mean 'train'?)"),
    ("train swimm", "(did you mean 'swim'?)"),
    ("train swim --hyperparameters learning_rat=1", "(did you mean 'learning_rate'?)"),
    ("train swim --seeds 0 1 --folder run", "give --runs, or --seed"),
    ("evaluate swm", "(did you mean 'swim'?)"),
    ("evaluate swim --episods 2", "(did you mean '--episodes'?)"),
    ("compare swim --sed 2", "(did you mean '--seed'?)"),
    ("evaluate swim --env-kwargs sped=1", "(did you mean 'speed'?)"),
    ("chart --water drg", "(did you mean 'drag'?)"),
    (lambda: gym.make(STUB, control_intervall=0.02), "(did you mean 'control_interval'?)"),
    (lambda: gym.make(STUB, n_envs=4), "gym.make_vec"),
    (lambda: gym.make_vec(STUB, n_envs=4), "(did you mean 'num_envs'?)"),
    (lambda: make_sb3_vec_env(STUB, n_envs=4), "(did you mean 'num_envs'?)"),
    (lambda: make_fish(lenght=0.3), "(did you mean 'length'?)"),
    (lambda: make_water(densty=900.0), "(did you mean 'density'?)"),
    (lambda: Tank(make_fish(), num_envs=2, water="drag"), "(did you mean 'num_fish'?)"),
    (lambda: pytest.importorskip(LIBRARY).VecNormalize(gym.make_vec(STUB)), "by fish_env.make_sb3_vec_env"),
    (lambda: gym.make_vec(STUB).env_method("reset"), "by fish_env.make_sb3_vec_env"),
    (lambda: evaluate(gym.make(STUB), "m.zip"), "m.zip is a Stable-Baselines3 model: load it and pass it"),
    (lambda: gym.make(STUB, render_mode="human").reset(), "='rgb_array', or write a file: fish_env play --save"),
]


@pytest.mark.parametrize(("mistake", "answer"), MISTAKES)
def test_mistakes(mistake, answer, capsys, monkeypatch):
    """A command ends with status 2 and the answer, after its own usage for an option; a call raises it."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if not isinstance(mistake, str):
        with pytest.raises((ValueError, TypeError, AttributeError, RuntimeError)) as error:
            mistake()
        said = str(error.value)
    else:
        try:
            assert main(mistake.split()) == 2
            said = capsys.readouterr().err
            assert said.count("\n") == 1
        except SystemExit as end:
            assert end.code == 2
            *usage, said = capsys.readouterr().err.splitlines()
            assert usage[0].startswith("usage: fish_env " + (mistake.split()[0] if "--" in mistake else "[-h]"))
    assert answer in said
