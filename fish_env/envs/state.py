"""States of fish: all that decides what happens next, copied out of a batch and back in, to plan and to branch.

A batch need not say what its state is. Every array with a row a fish is part of it: of the tank, of the episode, and
of the task. They are found by comparison with those of a batch of another size.
"""

import copy
import hashlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode

from fish_env.envs.layout import LAYOUT_VERSION
from fish_env.kernels.simd import Pack
from fish_env.kernels.simd.kinds import Lanes
from fish_env.physics.tank import Tank
from fish_env.tasks.options import keywords_of

STATE_FORMAT = 2
"""Format of the states. It is raised whenever a state of before would mean something else."""


@dataclass(frozen=True, eq=False, repr=False)
class FishState:
    """State of K fish in their episodes, as `get_state` returns it: a copy, which can be pickled and set many times."""

    about: tuple[tuple[str, Any], ...]
    """Names and values of what must be the same where it is set, in words and by a hash of what they mean."""
    arrays: dict[str, np.ndarray]
    """Arrays (K,...) by name, such as "tank.x"."""
    generators: tuple[dict[str, Any], ...]
    """State of the random generator of each fish, from which its next episodes are drawn."""

    def __len__(self) -> int:
        return len(self.generators)

    def __repr__(self) -> str:
        return f"FishState of {len(self)} fish, {', '.join(f'{name} {value!r}' for name, value in self.about[1:3])}"


class Stateful:
    """A batch of episodes whose state can be taken and set."""

    _rows: "Rows | None" = None  # found when it is first needed

    def get_state(self, indices=None) -> FishState:
        """All that decides what happens next to the fish: physics, task, generators, elapsed steps and time limits.

        Boundary conditions of the tank (`Tank.grab`, `fix` and `move`) and options that are set are no part of it.

        Args:
            indices: numbers of K fish, which may repeat, or a boolean mask (B,); None for all.

        Raises:
            ValueError: for fish that do not exist.
            gymnasium.error.ResetNeeded: for fish whose first episode has not begun.
        """
        return self._found_rows().take(indices)

    def set_state(self, state: FishState | Sequence[FishState], indices=None) -> np.ndarray:
        """Let the fish go on from a state: from now on, the same actions give the same bits.

        Args:
            state: of one fish, for all fish that are meant; or of as many, one each; or a list of states.
            indices: numbers of the fish, or a boolean mask (B,); None for all.

        Returns:
            The observations of all fish, as `observe` returns them.

        Water, method (`integrator`, `dt`, `refine`), `dtype`, `lanes`, `threads` and what is `settable` while it runs
        may differ from those where it was taken.

        Raises:
            ValueError: for a state of another task, body, layout, control interval, history, noise, delay or format, or
                of another number of fish; for one at the end of an episode, where the next begins in the same step
                ("SameStep", `VecEnv`). Nothing has changed then.
        """
        return self._found_rows().put(state, indices)

    def _found_rows(self) -> "Rows":
        if self._rows is None:
            self._rows = Rows(self)
        return self._rows


class Rows:
    """Where a batch of episodes has what decides the future of a fish: views of its arrays, with the fish first."""

    def __init__(self, episodes):
        self.episodes, task = episodes, episodes.task
        self.everyone = np.arange(episodes.num_envs)
        parts = {"tank": episodes.tank.pack, **episodes._made, "task": vars(task)}
        arrays, axes = arrays_of(parts), fish_axes(parts_of_another(episodes), parts)
        self.loose: dict[str, int] = {}
        """Arrays that a task in Python may replace by others, and their axes."""
        self.views: dict[str, np.ndarray] = {}
        places, loose = set(), {f"task.{name}" for name in vars(task)}
        for name, axis in axes.items():
            array = memory_of(arrays[name])
            place = address(array)
            if episodes._kernels is None and name in loose:
                self.loose[name.removeprefix("task.")] = axis
            elif place not in places:  # kernels and tasks often have two names for one array
                self.views[name] = np.moveaxis(array, axis, 0)
                places.add(place)
        self.places = frozenset(places)
        self.shapes = {name: view.shape[1:] for name, view in (*self.views.items(), *self.replaceable())}
        self.about = (
            ("format", STATE_FORMAT),  # first: the others may differ too if it does
            ("task", text_of_task(task, episodes._task_options)),
            ("body", text_of_fish(episodes.tank)),
            ("control interval, s,", episodes.control_interval),
            ("history, noise and delays", episodes._senses._asdict()),
            ("layout", (LAYOUT_VERSION, *((part.name, part.size) for part in episodes.layout))),
            ("arrays", tuple(self.shapes.items())),
        )

    def replaceable(self) -> Iterator[tuple[str, np.ndarray]]:
        """The arrays that a task in Python may have replaced since, by their paths, with the fish first."""
        for name, axis in self.loose.items():
            yield f"task.{name}", np.moveaxis(getattr(self.episodes.task, name), axis, 0)

    def take(self, indices) -> FishState:
        """The state of some fish, or of all for None."""
        episodes, rows = self.episodes, self.numbers(indices)
        if not episodes._started and not episodes._begun[rows].all():
            late = rows[~episodes._begun[rows]].tolist()
            raise ResetNeeded(f"get_state was called before reset of the fish {late}; call env.reset() first")
        pairs = (*self.views.items(), *self.replaceable()) if self.loose else self.views.items()
        arrays = {name: view.copy() if indices is None else view[rows] for name, view in pairs}
        generators = episodes._generators
        return FishState(self.about, arrays, tuple(generators[i].bit_generator.state for i in rows.tolist()))

    def put(self, state, indices) -> np.ndarray:
        """Set the state of some fish, or of all for None: the observations (B,D)."""
        episodes, rows = self.episodes, self.numbers(indices)
        state = self.checked(state, len(rows))
        drawn = state.generators if len(state) > 1 else state.generators * len(rows)
        for i, each in zip(rows.tolist(), drawn, strict=True):
            if episodes._generators[i] is None:
                episodes._generators[i], _ = np_random(0)
            episodes._generators[i].bit_generator.state = each
        tank, which = episodes.tank, slice(None) if indices is None else rows
        before = tank.variation.copy()
        for name, view in self.views.items():
            view[which] = state.arrays[name]
        for name, axis in self.loose.items():
            self.replace(name, axis, which, state.arrays[f"task.{name}"])
        for i in np.flatnonzero((tank.variation != before).any(axis=1)).tolist():
            tank._set_variation(i, tank.variation[i])
        tank._impose()
        episodes._begun[which] = True
        episodes._started = bool(episodes._begun.all())
        return episodes.observe()

    def replace(self, name: str, axis: int, which, values: np.ndarray) -> None:
        """Set rows of an array of a task in Python, in another array unless kernels read it."""
        array = getattr(self.episodes.task, name)
        if address(array) not in self.places:  # another attribute may be the same array
            array = array.astype(np.result_type(array, values))
            setattr(self.episodes.task, name, array)
        np.moveaxis(array, axis, 0)[which] = values

    def numbers(self, indices) -> np.ndarray:
        """Numbers of the fish that are meant; ValueError for others."""
        count = self.episodes.num_envs
        if indices is None:
            return self.everyone
        found = np.asarray(indices)
        if found.dtype == bool and found.shape == (count,):
            return np.flatnonzero(found)
        if found.ndim != 1 or found.dtype.kind not in "iu" or not ((found >= 0) & (found < count)).all():
            raise ValueError(
                f"indices is {indices!r}; give numbers from 0 to {count - 1}, or a boolean array ({count},)"
            )
        return found

    def checked(self, state, count: int) -> FishState:
        """A state of one fish or of so many; ValueError for others, or for a state of other fish."""
        states = [state] if isinstance(state, FishState) else state
        if not isinstance(states, list | tuple) or not all(isinstance(each, FishState) for each in states):
            raise ValueError(f"state is a {type(state).__name__}; give what get_state returned, or a list of such")
        for each in states:
            if each.about is not self.about and each.about != self.about:
                raise other_fish(each.about, self.about)
            over = np.flatnonzero(each.arrays["episode.terminated"] | each.arrays["episode.truncated"]).tolist()
            if over and getattr(self.episodes, "autoreset_mode", None) is AutoresetMode.SAME_STEP:
                why = "but in this batch the step that ends one begins the next; reset these fish instead"
                raise ValueError(f"the episodes of fish {over} of the state have ended, {why}")
        number = sum(map(len, states))
        if number != count and not (number == 1 and count):
            raise ValueError(f"the state is of {number} fish; give that of one fish, or of {count}")
        if len(states) == 1:
            return states[0]
        arrays = {name: np.concatenate([each.arrays[name] for each in states]) for name in self.shapes}
        return FishState(self.about, arrays, tuple(drawn for each in states for drawn in each.generators))


def other_fish(its: tuple, own: tuple) -> ValueError:
    """The error for a state of other fish, by what it says about itself and what these fish are."""
    name, one, other = next(
        (name, one, other) for (name, one), (_, other) in zip(its, own, strict=True) if one != other
    )
    if name == "arrays":
        one, other = (sorted(set(mine) - set(others)) for mine, others in ((one, other), (other, one)))
    return ValueError(
        f"{name} of the state is {one!r}, and of these fish {other!r}; give a state of the same task, body, layout and "
        "interval, taken by this version of fish_env"
    )


def parts_of_another(episodes) -> dict[str, Any]:
    """All that has the arrays of a batch with another number of fish, which is otherwise the same."""
    tank, task, count = episodes.tank, copy.deepcopy(episodes.task), 1 if episodes.num_envs > 1 else 2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a step that is too long, as the tank itself warned
        other = Tank(tank.fish, count, tank.integrator.name, tank.dt, tank.world, threads=1, refine=tank.refine)
    task.prepare(other, episodes.control_interval)
    return {"tank": other.pack, **episodes._make_arrays(count), "task": vars(task)}


NOT_THE_BODY = ("name", "water", "integrator", "time_step", "refine", "control_interval")


def text_of_fish(tank: Tank) -> str:
    """Name, length, mass and content of the fish of a tank, but its water, its method and conditions of its nodes."""
    fish, body = tank.fish, tank._own._replace(max_stiffness_eigenvalue=0.0, max_damping_eigenvalue=0.0)
    content = digest({name: part for name, part in vars(fish).items() if name not in NOT_THE_BODY} | {"body": body})
    return f"{fish.name}, {fish.length:g} m, {body.mass.sum():.3g} kg, content {content}"


def text_of_task(task, given: dict[str, Any]) -> str:
    """Class, options and content of the options of a task that cannot be set while it runs."""
    named, settable = keywords_of(type(task)) | given, getattr(task, "settable", ())
    options = {name: getattr(task, name, value) for name, value in named.items() if name not in settable}
    shown = " ".join(", ".join(f"{name}={value!r}" for name, value in options.items()).split())
    return f"{type(task).__module__}.{type(task).__qualname__}({shown}), content {digest(options)}"


def digest(value) -> str:
    """Hash of arrays, numbers and others in tuples, lists and dictionaries; of floats, the first seven digits count."""
    if isinstance(value, dict):
        value = sorted((str(name), digest(part)) for name, part in value.items())
    elif isinstance(value, tuple | list):
        value = [digest(part) for part in value]
    elif isinstance(value, np.ndarray | Real):
        array = np.asarray(value)
        value = array.shape, (array.astype(np.float32) if array.dtype.kind == "f" else array).tobytes()
    return hashlib.sha256(repr(value).encode()).hexdigest()[:12]


def address(array: np.ndarray) -> tuple[int, int]:
    """Where the memory of an array begins, and how much of it there is."""
    return array.__array_interface__["data"][0], array.nbytes


def arrays_of(value, path: str = "") -> dict[str, Any]:
    """Arrays in packs, tuples, lists and dictionaries, by their paths: "tank.x" for example."""
    if isinstance(value, np.ndarray | Lanes):
        return {path: value}
    if isinstance(value, Pack):
        value = value._kept
    elif isinstance(value, tuple | list):
        value = dict(zip(getattr(value, "_fields", range(len(value))), value, strict=True))
    if not isinstance(value, dict):
        return {}
    within = f"{path}." if path else ""
    return {name: array for key, part in value.items() for name, array in arrays_of(part, f"{within}{key}").items()}


def memory_of(value) -> np.ndarray:
    """Numpy array that contains a value's numbers."""
    return value if isinstance(value, np.ndarray) else value.memory


def fish_axes(one, many) -> dict[str, int]:
    """Axis of the fish in each array that has one, by its path: the axis in which it differs for one and many fish."""
    single, found = arrays_of(one), {}
    for name, value in arrays_of(many).items():
        shape, other = memory_of(value).shape, memory_of(single[name]).shape if name in single else ()
        if len(shape) == len(other) and shape != other:
            found[name] = int(np.flatnonzero(np.not_equal(shape, other))[0])
    return found
