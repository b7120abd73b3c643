"""Record an episode, and replay it: simulate it again from its seed and its actions and compare bit for bit."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from fish_env.checks import finite_array, is_whole
from fish_env.control.env_spec import one_fish, time_limit
from fish_env.control.evaluation import Controller, PolicyLike, as_controller
from fish_env.control.recording import SHAPES, Recording, as_json, env_of, load_recording, versions
from fish_env.envs import FishEnv

RESULTS = ("reward", "terms", "terminated")
"""Arrays with a row for each environment step; the others, but for `variation`, have one for each state."""


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
    steps = time_limit(env) if steps is None else steps
    act, limit = _controller(policy, bare, steps)
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
    return _run(env, bare, about, act, limit)


def replay(recording: Recording | str | Path) -> Replay:
    """Simulate a recorded episode again, and compare every state and reward with the recorded ones, bit for bit.

    Other versions of the packages, or another machine, may give other bits; the message then names them.
    FileNotFoundError without a file; ValueError for one that is no recording, or that this version cannot begin.
    """
    found = recording if isinstance(recording, Recording) else load_recording(recording)
    with closing(env_of(found.about)) as env:
        bare = env.unwrapped
        assert isinstance(bare, FishEnv)  # as `env_of` returns
        queue = iter(found.action)
        again = _run(env, bare, found.about, lambda obs, time: next(queue), found.steps)
    difference = _first_difference(found, again)
    interval = found.about["control_interval"]
    if difference is None:
        steps = found.steps
        return Replay(True, steps, f"the same bits in all of {steps} environment steps ({steps * interval:.2f} s)")
    steps, where = difference
    now, then = versions(), found.about["versions"]
    other = [f"{name} {then.get(name)} then, {now.get(name)} now" for name in now if then.get(name) != now[name]]
    said = f"other versions: {'; '.join(other)}" if other else "the versions are the same"
    message = f"it differs first after environment step {steps} ({steps * interval:.2f} s), in {where}; {said}"
    return Replay(False, steps, message)


def _run(env: gym.Env, bare: FishEnv, about: Mapping[str, Any], act: Controller, limit: int | None) -> Recording:
    """The episode that `about` describes, until it is over or has `limit` environment steps."""
    fish, size = bare.fish, bare.fish.single_action_space.shape
    obs, _ = env.reset(seed=about["seed"], options=dict(about["options"]))
    states, actions, reward, terms, ends, over = [_state(bare)], [], [], [], [], False
    while not over and (limit is None or len(actions) < limit):
        batch: Any = {name: part[None] for name, part in obs.items()} if isinstance(obs, dict) else obs[None]
        action = np.asarray(act(batch, len(actions) * fish.control_interval), dtype=np.float64)
        action = action[0] if action.ndim == 2 and len(action) == 1 else action
        obs, gained, terminated, _, _ = env.step(action)
        over = terminated or fish._truncated.item()  # not by a `TimeLimit`, beyond which `steps` may go
        actions.append(action.copy())
        states.append(_state(bare))
        reward.append(gained)
        terms.append(fish._arrays["terms"][:, 0].copy())
        ends.append(terminated)
    count = max(len(state["spheres"]) for state in states)
    for state in states:
        state["spheres"] = np.pad(state["spheres"], ((0, count - len(state["spheres"])), (0, 0)))
    return Recording(
        about=about,
        action=np.array(actions).reshape(-1, *size),
        variation=bare.tank.variation[0].copy(),
        terms=np.array(terms).reshape(-1, len(fish._names)),
        reward=np.array(reward, dtype=np.float64),
        terminated=np.array(ends, dtype=bool),
        **{name: np.array([state[name] for state in states]) for name in states[0]},
    )


def _state(bare: FishEnv) -> dict[str, Any]:
    """Those of the arrays of a recording that have a row for each state."""
    state, spheres = bare.tank.get_state(), getattr(bare.fish.task, "spheres", None)
    names = {"position": "x", "velocity": "v", "rest_length": "rest_length", "time": "t"}
    names |= {"failure": "failure", "counters": "counters"}
    return {name: state[key][0] for name, key in names.items()} | {
        "directions": bare.fish._vectors[0].copy(),
        "spheres": np.zeros((0, 4)) if spheres is None else np.array(spheres(0), dtype=float),
    }


def _controller(given: PolicyLike | np.ndarray, bare: FishEnv, limit: int | None) -> tuple[Controller, int | None]:
    """Controller of the actions, and number of environment steps after which to stop."""
    if limit is not None and (not is_whole(limit) or limit < 1):
        raise ValueError(f"steps is {limit!r}; give a whole number, at least 1, or None")
    limit = None if limit is None else int(limit)
    if isinstance(given, np.ndarray | list):
        shape = (len(given) if np.ndim(given) else 0, *bare.fish.single_action_space.shape)
        rows = finite_array(given, shape, "actions")
        queue = iter(rows)
        return lambda obs, time: next(queue), len(rows) if limit is None else min(limit, len(rows))
    if limit is None:
        raise ValueError("the environment has no time limit; give steps")
    return as_controller(given, bare.fish), limit


def _first_difference(found: Recording, again: Recording) -> tuple[int, str] | None:
    """Environment steps before the first difference in bits, and what differs, in words; None if nothing does."""
    differences = []
    for name in (*RESULTS, *(name for name in SHAPES if name not in RESULTS)):
        recorded, now = getattr(found, name), getattr(again, name)
        rows = min(len(recorded), len(now))
        if recorded.shape[1:] != now.shape[1:]:
            return 0, f"{name}: its shape was {recorded.shape} and is {now.shape}"
        one, other = (np.ascontiguousarray(array[:rows]) for array in (recorded, now))
        if one.dtype == np.float64:  # zeros of both signs are equal, but not in their bits
            one, other = one.view(np.int64), other.view(np.int64)
        if (one != other).any():
            place = tuple(np.argwhere(one != other)[0].tolist())
            step = 0 if name == "variation" else place[0] + (name in RESULTS)
            text = f"{name}{list(place)}: {recorded[place]!r} was recorded, and it is {now[place]!r}"
            differences.append((step, text))
        elif len(recorded) != len(now):
            differences.append((rows, f"{name}: {len(recorded)} rows were recorded, and there are {len(now)}"))
    return min(differences, key=lambda each: each[0], default=None)
