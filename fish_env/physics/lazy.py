"""Entries of tables that are loaded when they are used, as those of Gymnasium's registry are."""

import inspect
from collections.abc import Callable, Mapping
from pkgutil import resolve_name
from typing import Any


class Lazy:
    """The function or object of a text "module:name", which is loaded when it is called or asked for an attribute."""

    def __init__(self, text: str):
        self._text = text

    def __call__(self, *arguments, **keywords) -> Any:
        return resolve_name(self._text)(*arguments, **keywords)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__signature__":  # pickle and copy ask for such
            raise AttributeError(name)
        found = resolve_name(self._text)
        return inspect.signature(found) if name == "__signature__" else getattr(found, name)


def lazy_names(module: str, texts: Mapping[str, str]) -> Callable[[str], Any]:
    """`__getattr__` of a module that loads names when they are first used, each from its text "module:name"."""

    def load(name: str) -> Any:
        if name in texts:
            return resolve_name(texts[name])
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return load


def load_texts(record: Any, *names: str) -> None:
    """Replace attributes of a frozen record that are texts "module:name" by what they name, loaded when used."""
    for name in names:
        if isinstance(getattr(record, name), str):
            object.__setattr__(record, name, Lazy(getattr(record, name)))
