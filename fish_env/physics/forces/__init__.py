"""The forces on a body: one list of modules, from which all sums, matrices and step-size bounds follow.

A force is a module in FORCES: one file and one entry of that list. Its kernels all have the arguments
`body, world, control, x, v, f, cache`, and work on one fish or a block of fish:

    add_force          adds the force on every node to f, N; the only one that every force must have
    add_force_cached   the same, and keeps in cache what the next two need (default: `add_force`)
    add_tangent        adds to f the pull if every node moved by what stands in v, by the stiffness last stored
    add_change         adds to f what the force changes by when the velocities become v, positions being those stored
    add_system         adds h D + h^2 K to the matrix in f, and keeps K for `add_tangent`
    add_damping        adds h D to it, for the method that takes the water implicitly
    add_lagged         adds the force to `f.load` and h^2 times its effective stiffness to `f.matrix`, a number for each
                       entry of the nodes' skyline, for Tu's method (default: explicit, by `add_force`)
    energy             what the force stores, J
    failed             where an element is not what it should be any more; FAILURE says why
    constrain          changes the accelerations in f to what the force allows
    decay              changes the velocities by what the force alone makes of them in half a step; where a method calls
                       it, `add_force_cached` leaves that part out
    finish             changes the velocities at the end of a step

`present(body, world)` says whether there is anything to do: kernels are compiled without the forces that are not there.
`make_cache(body, world, kind)` makes what the force keeps, a `Pack` that it is then handed as `cache`.
`constant(body, world)` says whether what `add_system` adds and keeps is the same wherever the nodes are and however
fast they move; a force that does not say so is taken not to be.
`rest_matrices(body, elastic)` yields element matrices, (nodes (M,k), matrices (M,3k,3k)), of small motion about rest,
and `bounds(body, world)` says how stiff and how damped the surroundings make a body, for the choice of a step.

ANYWHERE says that the force is the same wherever the body is as a whole. If all that act say so, positions in float32
are relative to each fish, and as precise far away.

All but `present` and `add_force` may be missing. A force without `add_system` is explicit in the methods that solve
systems, and one without `add_tangent` is not filtered. Exact derivatives follow from `add_force` by dual numbers
(`evaluate`), but for a force that jumps and says so by JUMPS: it is left out of them. Such a force, a wall, may take
something from the sum of the others, so it acts after them wherever it stands in the list.

`control` holds what belongs to each fish of the block: rest lengths, and factors on stiffness, drag and on all else
(`lightness`), each already over the factor on the fish's mass, so that masses are the same for all. A force of which
`Body` and `World` know nothing has its parameters, a named tuple, in `World.extra` under a name of its own, and reads
them as `world.<name>`.
"""

from collections.abc import Callable
from functools import cache, wraps
from types import ModuleType
from typing import Any

from fish_env.kernels.simd import Kind, Pack, select, zero
from fish_env.physics.forces import anchors, barriers, contact, gravity, green_lagrange, pressure, springs, tets, water
from fish_env.physics.forces.compose import in_turn
from fish_env.physics.records import Body, World

FORCES: dict[str, ModuleType] = {
    module.__name__.rsplit(".", 1)[1]: module
    for module in (
        water,
        springs,
        tets,
        green_lagrange,
        pressure,
        barriers,
        gravity,
        anchors,
        contact,
    )
}
"""Every force, in the order in which they are summed."""


def present(body: Body, world: World) -> tuple[str, ...]:
    """The names of the forces that act on a body in a world, in the order in which they act: those that jump last."""
    names = [name for name, module in FORCES.items() if module.present(body, world)]
    return tuple(sorted(names, key=lambda name: hasattr(FORCES[name], "JUMPS")))


def make_cache(body: Body, world: World, kind: Kind, names: tuple[str, ...] | None = None) -> Pack:
    """What forces, those that act or those of these names, keep between calls, by name."""
    names = present(body, world) if names is None else names
    return Pack("cache", **{name: FORCES[name].make_cache(body, world, kind) for name in names if has_cache(name)})


def has_cache(name: str) -> bool:
    """Whether a force keeps anything."""
    return hasattr(FORCES[name], "make_cache")


KERNELS = ("add_force", "add_force_cached", "add_tangent", "add_change", "add_system", "add_damping", "add_lagged",
           "energy", "failed", "constrain", "decay", "finish")  # fmt: skip
COMPILED = (*KERNELS, "make_cache", "FAILURE", "JUMPS", "ANYWHERE")
"""What compiled sums depend on of a force."""


def cached(make: Callable) -> Any:
    """As `functools.cache`, for what is compiled for the forces of some names, the first argument.

    It is made again when FORCES has another force under one of these names, or other functions of it.
    """
    made = cache(lambda definitions, names, *others: make(names, *others))

    @wraps(make)
    def find(names: tuple[str, ...], *others):
        definitions = tuple(getattr(FORCES[name], what, None) for name in names for what in COMPILED)
        return made(definitions, names, *others)

    return find


@cached
def total(names: tuple[str, ...], function: str, *others: str):
    """The kernel that calls the function of that name, or the first of the others it has, of each force in turn.

    Raises:
        ValueError: for a function that is none of KERNELS.
    """
    if not {function, *others} <= set(KERNELS):
        raise ValueError(f"{(function, *others)} are no functions of forces; choose from {', '.join(KERNELS)}")
    found = {}
    for name in names:
        chosen = next((option for option in (function, *others) if hasattr(FORCES[name], option)), None)
        if chosen is not None:
            found[name] = (getattr(FORCES[name], chosen), has_cache(name))
    if function == "energy":
        return in_turn(found, "found += {call}", "found = zero(control.stiffness)", "return found", zero=zero)
    if function == "failed":  # the first in the list has the last word
        codes = {f"CODE_{name}": float(FORCES[name].FAILURE) for name in found}
        return in_turn(dict(reversed(found.items())), "code = select({call}, CODE_{name}, code)",
                       "code = zero(control.stiffness)", "return code", zero=zero, select=select, **codes)  # fmt: skip
    return in_turn(found)


def placed(names: tuple[str, ...]) -> bool:
    """Whether any of the forces depends on where the body is, or does not say that it does not."""
    return not all(hasattr(FORCES[name], "ANYWHERE") for name in names)


def any_has(names: tuple[str, ...], *functions: str) -> bool:
    """Whether any of the forces has any of these functions."""
    return any(hasattr(FORCES[name], function) for name in names for function in functions)


def constant_system(body: Body, world: World) -> bool:
    """Whether h D + h^2 K of all forces that act is the same wherever the nodes are and however fast they move."""
    implicit = [FORCES[name] for name in present(body, world) if hasattr(FORCES[name], "add_system")]
    return all(hasattr(force, "constant") and force.constant(body, world) for force in implicit)


def bounds(body: Body, world: World) -> list[tuple[float, float]]:
    """What the surroundings add to the body's highest elastic and viscous rates, 1/s2 and 1/s."""
    return [FORCES[name].bounds(body, world) for name in present(body, world) if hasattr(FORCES[name], "bounds")]


def rest_matrices(body: Body, elastic: bool = True) -> list[tuple]:
    """Element matrices of all forces within a body for small motion about rest: stiffness, N/m, or damping, N s/m.

    A list of (nodes (M,k), matrices (M,3k,3k)): what M elements of k nodes add between them.
    """
    modules = [module for module in FORCES.values() if hasattr(module, "rest_matrices")]
    return [part for module in modules for part in module.rest_matrices(body, elastic)]
