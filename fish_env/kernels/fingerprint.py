"""Fingerprint of a function: a hash of all that it is compiled from, which differs for different functions.

It covers the bytecode with nested code, the defaults, the closure, every global that it loads, and the implementations
of overloaded functions, all by value. An object that is not known by value has no fingerprint.
"""

import builtins
import dis
import enum
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, ModuleType, NoneType
from typing import Any

import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.core.typing.templates import builtin_registry

LIBRARIES = ("builtins", "cmath", "math", "numba", "numpy", "operator", "scipy")
"""Libraries whose functions and classes are known by name: the name of every stored kernel contains numba's version."""
PLAIN = (bool, int, float, complex, str, bytes, range, NoneType, EllipsisType)
CODE = ("co_code", "co_names", "co_varnames", "co_freevars", "co_cellvars", "co_argcount", "co_posonlyargcount",
        "co_kwonlyargcount", "co_flags", "co_exceptiontable")  # fmt: skip
"""Attributes of a code object in its fingerprint, beside its constants; its location is not one of them."""


class UnknownValueError(TypeError):
    """A function depends on an object that is not known by value."""


def fingerprint(function: FunctionType) -> str:
    """Fingerprint of a function, 64 hexadecimal digits; UnknownValueError names an object not known by value."""
    digest = hashlib.sha256()
    for part in _function(function, {}):
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def _function(function: FunctionType, seen: dict[Any, int]) -> Iterator[bytes]:
    if function in seen:
        yield b"seen %d" % seen[function]
        return
    seen[function] = len(seen)
    yield from _code(function.__code__, function.__globals__, seen)
    yield from _value((function.__defaults__, function.__kwdefaults__), seen)
    for cell in function.__closure__ or ():
        try:
            held = cell.cell_contents
        except ValueError:  # an empty cell
            held = NoneType
        yield from _value(held, seen)


def _code(code: CodeType, space: dict[str, Any], seen) -> Iterator[bytes]:
    yield repr([getattr(code, name, None) for name in CODE]).encode()
    for constant in code.co_consts:
        yield from _code(constant, space, seen) if isinstance(constant, CodeType) else _value(constant, seen)
    for name in _globals(code):
        yield name.encode()
        value = space.get(name, getattr(builtins, name, NoneType))
        yield from _module(value, code, seen) if isinstance(value, ModuleType) else _value(value, seen)


@cache
def _globals(code: CodeType) -> tuple[str, ...]:
    """Names of the globals that it loads."""
    loads = (each.argval for each in dis.get_instructions(code) if each.opname in ("LOAD_GLOBAL", "LOAD_NAME"))
    return tuple(dict.fromkeys(loads))


def _module(module: ModuleType, code: CodeType, seen) -> Iterator[bytes]:
    """Yield the parts of a module that the code may use: its attributes with a name that occurs in the code."""
    yield module.__name__.encode()
    if module.__name__.split(".")[0] in LIBRARIES:
        return
    for name in code.co_names:
        if hasattr(module, name):
            value = getattr(module, name)
            yield name.encode()
            yield from _module(value, code, seen) if isinstance(value, ModuleType) else _value(value, seen)


def _value(value: Any, seen) -> Iterator[bytes]:
    kind = type(value)
    yield f"{kind.__module__}.{kind.__qualname__}".encode()
    if isinstance(value, Dispatcher):
        seen[value] = len(seen)
        yield repr(sorted(value.targetoptions.items())).encode()
        yield from _function(value.py_func, seen)
    elif kind in PLAIN:
        yield repr(value).encode()
    elif kind is np.ndarray and not value.dtype.hasobject:
        yield f"{value.dtype!r} {value.shape} {value.strides} {value.flags.aligned}".encode()
        yield value.tobytes()
    elif isinstance(value, np.generic) and not value.dtype.hasobject:
        yield repr(value.dtype).encode()
        yield value.tobytes()
    elif isinstance(value, enum.Enum):
        yield value.name.encode()
        yield from _value(kind, seen)
    elif isinstance(value, tuple | list):
        yield repr((len(value), getattr(value, "_fields", None))).encode()
        yield from _all(value, seen)
    elif isinstance(value, dict):
        yield from _all((tuple(value), tuple(value.values())), seen)
    elif isinstance(value, FunctionType) and not _is_known(value):
        for function in (value, *_overloads(value)):
            yield from _function(function, seen)
    elif isinstance(value, frozenset):
        yield b"".join(sorted(b"\n".join(_value(each, {})) for each in value))
    else:
        yield _name(value)
        if isinstance(value, type):
            yield from _class(value, seen)


def _is_known(function: FunctionType) -> bool:
    """Return True for a function that its name identifies: one of `fish_env.kernels` or of a library."""
    home = function.__module__ or ""
    ours = home.startswith("fish_env.kernels.")
    return (ours or home.split(".")[0] in LIBRARIES) and not function.__closure__


def _overloads(function: FunctionType) -> list[FunctionType]:
    """Overloads that numba compiles in place of a plain Python function."""
    kinds = (kind for known, kind in builtin_registry.globals if known is function)
    return [each._overload_func for kind in kinds for each in kind.templates if hasattr(each, "_overload_func")]


def _all(values: Iterable, seen) -> Iterator[bytes]:
    for each in values:
        yield from _value(each, seen)


def _class(value: type, seen) -> Iterator[bytes]:
    """Yield the parts of a class's fingerprint beside its name: its members or fields."""
    if issubclass(value, enum.Enum):
        members: dict[str, Any] = dict(value.__members__)
        yield from _all([(name, member.value) for name, member in members.items()], seen)
    elif issubclass(value, tuple):
        yield from _all([getattr(value, "_fields", None), getattr(value, "_field_defaults", None)], seen)


def _name(value: Any) -> bytes:
    """Name of an object that it identifies: of a library or this package, a type, or a class of plain values."""
    if isinstance(value, np.dtype | types.Type):
        return repr(value).encode()
    if isinstance(value, _Intrinsic):
        home, name = value._defn.__module__, getattr(value, "cache_key", value._name)
    else:
        home, name = getattr(value, "__module__", None) or "builtins", getattr(value, "__qualname__", None)
        name = getattr(value, "__name__", None) if name is None else name
    room = str(home).split(".")[0]
    ours = room == "fish_env" and isinstance(value, FunctionType | type | _Intrinsic)
    library = room in LIBRARIES and isinstance(value, FunctionType | BuiltinFunctionType | type | np.ufunc | _Intrinsic)
    numpys = type(value) is type(np.sum)  # not a plain function
    held = isinstance(value, type) and issubclass(value, enum.Enum | tuple)
    if name is None or not (ours or library or numpys or held):
        raise UnknownValueError(f"{value!r} is a {type(value).__name__}, which is not known by value")
    return f"{home}.{name}".encode()
