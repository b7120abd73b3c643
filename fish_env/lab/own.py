"""The user's own things in the laboratory: a policy file, a body of a Python file, a registered environment."""

import importlib.util
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fish_env.bodies import BODIES, Fish
from fish_env.control.env_spec import environment_of, make_checked_batch
from fish_env.control.evaluation import as_controller, environment_for
from fish_env.control.policy import Policy, load_policy
from fish_env.lab.stage import Control, Plot, Stage, muscle_names, sliders
from fish_env.scene.frame import Frame, make_frame
from fish_env.scene.look import look_of

DEFAULT_TASK = "FishEnv/Swim-v0"


class Own(NamedTuple):
    """Things of the user from the command line; None for what was not given."""

    task: str | None = None  # the id of a registered environment
    policy: Policy | None = None
    body: Any = None  # a name of BODIES, or a `Fish`

    @property
    def given(self) -> bool:
        """Return True if there is anything."""
        return any(part is not None for part in self)


def own_things(task: str | None, policy: str | Path | None, body: str | None) -> Own:
    """Things that the command line names: an id, a policy (a file, or a shipped one), a body or FILE.py:function.

    Raises:
        FileNotFoundError: if there is no such policy file.
        ValueError: for what cannot be used, saying why.
    """
    loaded = None if policy is None else load_policy(policy)
    own = Own(task, loaded, None if body is None else body_of(body))
    if own.given:
        Watch(own).close()
    return own


def body_of(words: str) -> Any:
    """A body's name, or the fish that FILE.py:function makes; ValueError for anything else."""
    path, colon, name = words.rpartition(":")
    if not colon:
        if words not in BODIES:
            raise ValueError(f"unknown body {words!r}; choose from {', '.join(BODIES)}, or give FILE.py:function")
        return words
    spec = importlib.util.spec_from_file_location("own_body", path)
    if spec is None or spec.loader is None or not Path(path).is_file():
        raise ValueError(f"there is no Python file {path!r}; give FILE.py:function")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    fish = getattr(module, name)() if callable(getattr(module, name, None)) else None
    if not isinstance(fish, Fish):
        raise ValueError(f"{words!r} makes {fish!r:.100}; give FILE.py:function of a function that returns a fish")
    return fish


class Watch(Stage):
    """One fish in an environment of the user, episode after episode; raises what making the environment raises."""

    hint = "Episodes follow one another. Without a policy, every muscle has a slider."

    def __init__(self, own: Own):
        about = {} if own.policy is None else own.policy.about
        trained = own.task in (None, about.get("env_id"))
        options = {} if own.body is None else {"body": own.body}
        if own.policy is not None and trained:
            name, options = environment_for(own.policy, options)
        else:
            name, _ = environment_of({"env_id": own.task or about.get("env_id") or DEFAULT_TASK})
        self.env = make_checked_batch(name, options, 1)
        self.title, self.fish, self.interval = f"Your own: {name}", self.env.tank.fish, self.env.control_interval
        self.action = np.full(self.env.single_action_space.shape or (), -1.0, np.float32)
        self.controller = None if own.policy is None else as_controller(own.policy, self.env)
        self.looks, self.show = [look_of(self.fish)], {"skin": True, "springs": False}
        self.plots = [Plot("reward of a step", ["reward"]), Plot("speed (lengths/s)", ["speed"])]
        self.reset()

    def reset(self) -> None:
        """Begin the first episode again."""
        self.observation, _ = self.env.reset(seed=0)
        self.due = self.time = self.since = self.reward = 0.0
        self.path: deque[np.ndarray] = deque(maxlen=100)
        self.note = ""

    def step(self) -> None:
        """Move on by an environment step."""
        action = self.controller(self.observation, self.since) if self.controller else self.action
        self.observation, reward, terminated, truncated, info = self.env.step(np.reshape(action, (1, -1)))
        self.time += self.interval
        self.since, self.reward, self.due = self.since + self.interval, float(reward[0]), max(self.due, self.time)
        self.path.append(self.env._pose.centre[0].copy())
        if terminated[0] or truncated[0]:
            reason = str(np.ravel(info.get("final_info", {}).get("failure", [""]))[0])
            self.since, self.note = 0.0, f"An episode ended after {self.time:.1f} s. {reason}".strip()
            self.path.clear()

    def frame(self) -> Frame:
        """The fish in its environment."""
        path = np.reshape(self.path, (-1, 3))
        return make_frame(self.env, 0, path, self.looks[0])._replace(show=self.shown())

    def readings(self) -> list[list[float]]:
        """Reward and speed."""
        return [[self.reward], [float(np.linalg.norm(self.env._pose.velocity[0])) / self.length]]

    def controls(self) -> list[Control]:
        """A slider for every action, if no policy acts."""
        names = muscle_names(self.fish)
        names = names if len(names) == self.action.size else [f"action {m}" for m in range(self.action.size)]
        return ([] if self.controller else sliders(names, self.action, -1.0)) + self.view_controls()

    def close(self) -> None:
        """End its threads."""
        self.env.close()
