"""Sums over forces: one kernel that calls a function of each force module in turn."""

from fish_env.kernels.compile import kernel

ARGUMENTS = "body, world, control, x, v, f, cache"


def part_of(cache, module) -> str:
    """How the kernel of a sum names a module's own part of the cache."""
    return f"cache.{module}" if cache else "cache"


def in_turn(functions: dict[str, tuple], lines="{call}", before="pass", after="pass", **space):
    """A kernel `(body, world, control, x, v, f, cache)` that calls functions with these arguments one after another.

    Args:
        functions: (function, whether its force has a cache of its own) by the name of its module.
        lines: what to do with each `{call}`; `{name}` is the module's.
        before: what comes first.
        after: what comes last.
        space: what these lines may name.
    """
    text = [f"def sum_of_forces({ARGUMENTS}):", f"    {before}"]
    for name, (function, cached) in functions.items():
        space[f"call_{name}"] = function
        call = f"call_{name}(body, world, control, x, v, f, {part_of(cached, name)})"
        text.append("    " + lines.format(call=call, name=name))
    text.append(f"    {after}")
    exec(compile("\n".join(text), __file__, "exec"), space)
    function = space["sum_of_forces"]
    function.__module__ = __name__
    return kernel(function)
