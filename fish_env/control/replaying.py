"""Record an episode, and replay it: simulate it again from its seed and its actions and compare bit for bit."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from fish_env.checks import finite_array, is_whole
from fish_env.control.environments import one_fish
from fish_env.control.evaluation import PolicyLike, as_controller
from fish_env.control.recording import Recording, as_json, env_of, load_recording, versions
from fish_env.envs import FishEnv

STATES = ("position", "velocity", "rest_length", "time", "failure", "counters", "directions", "spheres")
RESULTS = ("reward", "terms", "terminated")


class Replay(NamedTuple):
    """Result of a replay. Its truth value is ambiguous: use `same`."""

    same: bool
    """True if every state, reward and term has the same bits."""
    steps: int
    """Number of environment steps that were simulated and compared."""
    message: str
    """One sentence: that all is the same, or where it first differs, and which versions differ."""

    def __str__(self) -> str:
        return self.message


def record(
    env: gym.Env,
    policy: PolicyLike | np.ndarray,
    seed: int = 0,
    options: Mapping[str, float] | None = None,
    steps: int | None = None,
) -> Recording:
    """Run one episode and keep all of it.

    Args:
        env: of `gym.make`; it is reset first. Its keywords must be plain: numbers, text, lists and dicts. Its wrappers
            must be those that only watch, such as `RecordEpisodeStatistics`.
        policy: the name of a shipped policy, a policy file, a `Policy`, a model of Stable-Baselines3, or a function of
            observations (1,D) and the time, s, that gives actions (1,A) or (A,): what `as_controller` takes; or an
            array of actions (T,A), of which as many are taken as the episode has steps.
        seed: of the reset.
        options: of the reset.
        steps: environment steps after which to stop; None for the time limit of the environment.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: for an environment that is not one fish, or was not made by `gym.make` with plain keywords; for a
            seed, options or actions that are not allowed; and for a policy that does not fit the environment.
    """
    bare, id, keywords = one_fish(env)
    keywords = as_json(keywords, "the environment's keywords")
    if not is_whole(seed) or seed < 0:
        raise ValueError(f"seed is {seed!r}; give a whole number, zero or more: a recording must be repeatable")
    wanted: dict[str, Any] = {} if options is None else as_json(options, "options")
    limited = env.has_wrapper_attr("_max_episode_steps")  # may have been set since `gym.make`
    steps = env.get_wrapper_attr("_max_episode_steps") if steps is None and limited else steps
    act, limit = _controller(policy, bare, steps)
    episode = Episode(env, int(seed), wanted)
    while limit is None or len(episode.actions) < limit:
        obs = episode.observation
        batch: Any = {name: part[None] for name, part in obs.items()} if isinstance(obs, dict) else obs[None]
        if episode.step(np.asarray(act(batch, episode.seconds), dtype=np.float64)):
            break
    about = {
        "env_id": id,
        "env_options": keywords,
        "seed": int(seed),
        "options": wanted,
        "control_interval": bare.fish.control_interval,
        "length": float(bare.tank.fish.length),
        "term_names": list(bare.fish._names),
        "versions": versions(),
    }
    return episode.recording(about)


def replay(recording: Recording | str | Path) -> Replay:
    """Simulate a recorded episode again, and compare every state and reward with the recorded ones, bit for bit.

    It stops at the first difference. Other versions of the packages, or another machine, may give other bits; the
    message then names them.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that is no recording, or an episode that this version cannot begin.
    """
    found = recording if isinstance(recording, Recording) else load_recording(recording)
    env = env_of(found.about)
    try:
        episode = Episode(env, found.about["seed"], found.about["options"])
        difference = _first_difference(found, episode)
    finally:
        env.close()
    steps, seconds = len(episode.actions), len(episode.actions) * found.about["control_interval"]
    if difference is None:
        return Replay(True, steps, f"the same bits in all of {steps} environment steps ({seconds:.2f} s)")
    return Replay(False, steps, f"it differs first after environment step {steps} ({seconds:.2f} s), in {difference}"
                  + _other_versions(found))  # fmt: skip


class Episode:
    """An episode of one fish, with all of its states so far."""

    def __init__(self, env: gym.Env, seed: int, options: Mapping[str, float]):
        bare = env.unwrapped
        assert isinstance(bare, FishEnv)  # as `one_fish` and `env_of` return
        self._env, self._bare = env, bare
        self.observation, _ = env.reset(seed=seed, options=dict(options))
        self.actions: list[np.ndarray] = []
        self.states = [self._state()]
        self.results: list[dict[str, Any]] = []

    @property
    def seconds(self) -> float:
        return len(self.actions) * self._bare.fish.control_interval

    def step(self, action: np.ndarray) -> bool:
        """Take one environment step; return True if the episode is over."""
        action = action[0] if action.ndim == 2 and len(action) == 1 else action
        self.observation, reward, terminated, _, _ = self._env.step(action)
        self.actions.append(action.copy())
        self.states.append(self._state())
        terms = self._bare.fish._arrays["terms"][:, 0].copy()
        self.results.append({"reward": reward, "terms": terms, "terminated": terminated})
        return terminated or self._bare.fish._truncated.item()  # not by a `TimeLimit`, beyond which `steps` may go

    def _state(self) -> dict[str, Any]:
        fish, state = self._bare.fish, self._bare.tank.get_state()
        spheres = getattr(fish.task, "spheres", None)
        return {
            "position": state["x"][0],
            "velocity": state["v"][0],
            "rest_length": state["rest_length"][0],
            "time": state["t"][0],
            "failure": state["failure"][0],
            "counters": state["counters"][0],
            "directions": fish._vectors[0].copy(),
            "spheres": np.zeros((0, 4)) if spheres is None else np.array(spheres(0), dtype=float),
        }

    def recording(self, about: dict[str, Any]) -> Recording:
        """All of it, as a recording."""
        count = max(len(state["spheres"]) for state in self.states)
        for state in self.states:
            state["spheres"] = pad_spheres(state["spheres"], count)
        states = {name: np.array([state[name] for state in self.states]) for name in STATES}
        fish = self._bare.fish
        action = np.array(self.actions).reshape(-1, *fish.single_action_space.shape)
        terms = np.array([result["terms"] for result in self.results]).reshape(-1, len(fish._names))
        reward = np.array([result["reward"] for result in self.results], dtype=np.float64)
        terminated = np.array([result["terminated"] for result in self.results], dtype=bool)
        variation = self._bare.tank.variation[0].copy()
        return Recording(about=about, action=action, variation=variation, terms=terms, reward=reward,
                         terminated=terminated, **states)  # fmt: skip


def pad_spheres(spheres: np.ndarray, count: int) -> np.ndarray:
    """Spheres (S,4) as (count,4), with radii of zero where there is none."""
    return np.concatenate([spheres, np.zeros((max(0, count - len(spheres)), 4))])


def _controller(
    given: PolicyLike | np.ndarray, bare: FishEnv, limit: int | None
) -> tuple[Callable[[np.ndarray, float], np.ndarray], int | None]:
    """Controller of the actions, and number of environment steps after which to stop."""
    if limit is not None and (not is_whole(limit) or limit < 1):
        raise ValueError(f"steps is {limit!r}; give a whole number, at least 1, or None")
    limit = None if limit is None else int(limit)
    if isinstance(given, np.ndarray | list):
        rows = finite_array(
            given, (len(given) if np.ndim(given) else 0, *bare.fish.single_action_space.shape), "actions"
        )
        queue = iter(rows)
        return lambda obs, time: next(queue), len(rows) if limit is None else min(limit, len(rows))
    if limit is None:
        raise ValueError("the environment has no time limit; give steps")
    return as_controller(given, bare.fish), limit


def _first_difference(found: Recording, episode: Episode) -> str | None:
    """First difference of the episode, simulated along the recorded actions; None if there is none."""
    for step in range(found.steps + 1):
        if step:
            episode.step(found.action[step - 1])
            for name in RESULTS:
                said = _compare_bits(name, getattr(found, name)[step - 1], episode.results[-1][name])
                if said:
                    return said
        for name in STATES:
            now = episode.states[-1][name]
            recorded = getattr(found, name)[step]
            now = pad_spheres(now, len(recorded)) if name == "spheres" else now
            said = _compare_bits(name, recorded, now)
            if said:
                return said
        if not step and (said := _compare_bits("variation", found.variation, episode._bare.tank.variation[0])):
            return said
    return None


def _compare_bits(name: str, recorded: Any, now: Any) -> str | None:
    """First place at which two arrays differ in their bits, in words; None if they do not differ."""
    recorded, now = np.atleast_1d(recorded), np.atleast_1d(now)
    if recorded.shape != now.shape:
        return f"{name}: its shape was {recorded.shape} and is {now.shape}"
    other = recorded != now
    if recorded.dtype == np.float64:  # zeros of both signs are equal, but not in their bits
        other = np.ascontiguousarray(recorded).view(np.int64) != np.ascontiguousarray(now).view(np.int64)
    if not other.any():
        return None
    place = tuple(np.argwhere(other)[0].tolist())
    return f"{name}{list(place)}: {recorded[place]!r} was recorded, and it is {now[place]!r}"


def _other_versions(found: Recording) -> str:
    """Versions that differ from those that recorded, in words."""
    now, then = versions(), found.about["versions"]
    other = [f"{name} {then.get(name)} then, {now.get(name)} now" for name in now if then.get(name) != now[name]]
    return f"; other versions: {'; '.join(other)}" if other else "; the versions are the same"
