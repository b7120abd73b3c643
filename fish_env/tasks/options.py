"""Options of a task: numbers with their range; a number outside raises an error at once."""

import copy
from collections.abc import Mapping
from inspect import signature
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import finite_array, is_whole


class Option(NamedTuple):
    """A number that a keyword or `reset(options=...)` may set."""

    low: float
    high: float
    text: str
    """Its meaning, with the unit."""
    default: float | None = None
    """Its value without the keyword; of weights of the reward only."""

    def checked(self, name: str, value: Any) -> float:
        """`value` as a float; ValueError, naming the range, unless it is one finite number inside it."""
        if isinstance(value, bool | np.bool_ | str):
            raise ValueError(f"{name} is {value!r}; give a number from {self.low:g} to {self.high:g} ({self.text})")
        number = float(finite_array(value, (), name))
        if not self.low <= number <= self.high:
            raise ValueError(f"{name} is {number:g}; give a number from {self.low:g} to {self.high:g} ({self.text})")
        return number

    def checked_range(self, name: str, value: Any) -> tuple[float, float]:
        """`value`, a number or a pair (lowest, highest), as a pair; ValueError unless it lies in the range."""
        pair = tuple(value) if isinstance(value, tuple | list | np.ndarray) and np.shape(value) else (value, value)
        if len(pair) != 2:
            raise ValueError(f"{name} is {value!r}; give a number, or a pair (lowest, highest)")
        low, high = (self.checked(name, number) for number in pair)
        if low > high:
            raise ValueError(f"{name} is {value!r}; give the lowest first")
        return low, high


def weight(default: float, text: str) -> Option:
    """A weight of a term of the reward, 0 to 1000."""
    return Option(0.0, 1000.0, text, default)


class Direction(NamedTuple):
    """A vector that the observation ends with."""

    name: str
    unit: str
    limit: float
    """Bound of its components in the observation space."""
    typical: float
    """A typical change of a component: what a learner should scale it by."""


def check_choice(name: str, value: Any, choices: tuple[int, ...]) -> int:
    """Return `value` as an int; ValueError unless it is one of the choices."""
    if not is_whole(value) or value not in choices:
        raise ValueError(f"{name} is {value!r}; give {' or '.join(map(str, choices))}")
    return int(value)


def check_options(given: Mapping[str, Any], allowed: Mapping[str, Option]) -> dict[str, float]:
    """Return the options of a reset as numbers, or raise ValueError naming what is allowed."""
    if not isinstance(given, Mapping):
        raise ValueError(f"options is {given!r}; give a dict with keys among {', '.join(allowed)}")
    for name in given:
        if name not in allowed:
            meant = "; ".join(f"{key!r}, {option.text}" for key, option in allowed.items())
            raise ValueError(f"unknown reset option {name!r}; choose from {meant}")
    return {name: allowed[name].checked(f"options[{name!r}]", value) for name, value in given.items()}


class Keywords:
    """An object that refuses the assignment of a keyword it was made with, which would not be checked or recorded.

    The `spec` of an environment is a copy: later changes of the keywords by the caller do not affect it.
    """

    _keywords: frozenset[str] = frozenset()
    settable: tuple[str, ...] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._keywords:
            call = f"call set_wrapper_attr({name!r}, value) of one fish, set_attr({name!r}, value) of a batch"
            do = call if name in self.settable else f"make a new environment with {name}=..."
            raise AttributeError(f"{name!r} cannot be assigned; {do}")
        super().__setattr__(name, copy.deepcopy(value) if name == "spec" else value)


def keywords_of(task: type) -> dict[str, Any]:
    """The keywords that a class of tasks or environments takes, weights of a reward included, with their defaults."""
    given = [*signature(task.__init__).parameters.values()][1:]
    named = {each.name: each.default for each in given if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)}
    return named | {name: option.default for name, option in getattr(task, "weights", {}).items()}
