"""Sums over forces: one kernel that calls a function of each force module in turn."""

from fish_env.kernels.compile import kernel

ARGUMENTS = "body, world, control, x, v, f, cache"


def part_of(cache, module) -> str:
    """Expression for a module's part of the cache, in the source of a sum's kernel."""
    return f"cache.{module}" if cache else "cache"


def in_turn(functions: dict[str, tuple], lines="{call}", before="pass", after="pass", **space):
    """Make a kernel `(body, world, control, x, v, f, cache)` that calls functions with these arguments in turn.

    Args:
        functions: (function, True if its force has a cache) by the name of its module.
        lines: source lines for each `{call}`; `{name}` is the module's name.
        before: first source line.
        after: last source line.
        space: names that these lines may use.
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
