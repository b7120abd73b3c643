"""Forces on a body: one list of modules, from which all sums, matrices and step-size bounds follow.

A force is a module in FORCES: one file and one entry of that table. Its kernels all have the arguments
`body, world, control, x, v, f, cache`, and work on one fish or a block of fish:

    add_force          adds the force on every node to f, N; the only one that every force must have
    add_force_cached   the same, and stores in cache the data of the next two (default: `add_force`)
    add_tangent        adds to f the restoring force of displacements v, by the stiffness last stored
    add_change         adds to f the change of the force when the velocities become v, at the stored positions
    add_system         adds h D + h^2 K to the matrix in f, and stores K for `add_tangent`
    add_damping        adds h D to it, for the method with implicit water
    add_lagged         adds the force to `f.load` and h^2 times its effective stiffness to `f.matrix`, a number for each
                       entry of the nodes' skyline, for Tu's method (default: explicit, by `add_force`)
    add_reaction       adds to f, the sum of all forces, a force that depends on the resulting accelerations
    add_inertia        adds to f the mass that the force adds to the nodes' own, at positions x, times the vectors v
    solve_lagged       adds the forces of that mass to `f.load`, the right-hand side of Tu's method, between elimination
                       and backward substitution
    energy             stored energy, J
    loss               power that the force takes from the body, or from the water that moves with it, for good, W; f is
                       scratch memory
    failed             mask of the fish in which an element is invalid; FAILURE is the reason
    constrain          constrains the accelerations in f
    decay              changes the velocities by the effect of this force in half a step; `add_force_cached` leaves
                       that part out for a method that calls it
    finish             changes the velocities at the end of a step

`present(body, world)` returns True if the force acts: kernels are compiled without absent forces.
`make_cache(body, world, kind)` makes the data that the force stores, a `Pack`, the argument `cache` of its kernels.
`constant(body, world)` returns True if the contribution of `add_system` does not depend on positions and velocities; it
is False for a force without this function.
`rest_matrices(body, elastic)` yields element matrices, (nodes (M,k), matrices (M,3k,3k)), of small motion about rest,
and `bounds(body, world)` returns the stiffness and damping of the surroundings, for the choice of a step.

IN_WATER marks a force of the water: its `loss` is work on the water, and its forward part is thrust.
ANYWHERE marks a force that is invariant under translations of the whole body. If all acting forces have it, positions
in float32 are relative to each fish, and equally precise far from the origin.

A force that grows with the acceleration, such as the inertia of the water, has `add_reaction`, `add_inertia`,
`solve_lagged` and `add_system`; after `add_reaction`, f is the nodes' own mass times their acceleration.

All but `present` and `add_force` may be missing. A force without `add_system` is explicit in the methods that solve
systems, and one without `add_tangent` is not filtered. Exact derivatives follow from `add_force` by dual numbers
(`evaluate`). They exclude a discontinuous force, marked by JUMPS. Such a force, a wall, may reduce the sum of the
others, so it acts after them, whatever its place in the list.

`control` contains the data of each fish of the block: rest lengths, and factors on stiffness, drag and all other forces
(`lightness`). Each is divided by the factor on the fish's mass, so that all fish have the same masses. `shortness` is
the factor on forces that grow as the cube of the length, and not as its fourth power. A force without parameters in
`Body` or `World` has them, a named tuple, in `World.extra` under its own name. It reads them as `world.<name>`.
"""

import importlib
from collections.abc import Callable
from functools import cache, wraps
from types import ModuleType
from typing import Any

from fish_env.kernels.compile import kernel
from fish_env.kernels.simd import Kind, Pack, field, select, zero
from fish_env.physics.forces import gravity, reactive, righting, springs, water
from fish_env.physics.records import Body, World

FORCES: dict[str, Any] = {
    "water": water,
    "reactive": reactive,
    "righting": righting,
    "springs": springs,
    "tets": "fish_env.soft.forces.tets:tets",
    "green_lagrange": "fish_env.soft.forces.green_lagrange:tets",
    "pressure": "fish_env.soft.forces.pressure:compartments",
    "barriers": "fish_env.soft.forces.barriers:barriers",
    "gravity": gravity,
    "anchors": "fish_env.soft.forces.anchors:anchors",
    "contact": "fish_env.soft.forces.contact:planes",
}
"""Every force, in the order in which they are summed: a module, or "module:part", which is loaded, and takes the place
of the text, when a body or a world first has that part."""


def loaded(body: Body, world: World | None = None) -> dict[str, ModuleType]:
    """Forces of the table, by name, but those whose part neither the body nor the world has."""
    for name, force in FORCES.items():
        if isinstance(force, str):
            module, part = force.split(":")
            if getattr(body, part, None) is not None or getattr(world, part, None) is not None:
                FORCES[name] = importlib.import_module(module)
    return {name: force for name, force in FORCES.items() if not isinstance(force, str)}


def present(body: Body, world: World) -> tuple[str, ...]:
    """Names of the forces that act on a body in a world, in the order in which they act: discontinuous ones last."""
    names = [name for name, module in loaded(body, world).items() if module.present(body, world)]
    return tuple(sorted(names, key=lambda name: hasattr(FORCES[name], "JUMPS")))


def make_cache(body: Body, world: World, kind: Kind, names: tuple[str, ...] | None = None) -> Pack:
    """Caches of the acting forces, or of those of these names, by name."""
    names = present(body, world) if names is None else names
    return Pack("cache", **{name: FORCES[name].make_cache(body, world, kind) for name in names if has_cache(name)})


def has_cache(name: str) -> bool:
    """Return True if a force has a cache."""
    return hasattr(FORCES[name], "make_cache")


KERNELS = ("add_force", "add_force_cached", "add_tangent", "add_change", "add_system", "add_damping", "add_lagged",
           "add_reaction", "add_inertia", "solve_lagged", "energy", "loss", "failed", "constrain", "decay",
           "finish")  # fmt: skip
COMPILED = (*KERNELS, "make_cache", "FAILURE", "JUMPS", "ANYWHERE", "IN_WATER")
"""Attributes of a force on which compiled sums depend."""


def cached(make: Callable) -> Any:
    """Cache results like `functools.cache`, for functions whose first argument is a tuple of names of forces."""
    # A result is computed again if FORCES contains another force under one of these names, or other functions of it.
    made = cache(lambda definitions, names, *others: make(names, *others))

    @wraps(make)
    def find(names: tuple[str, ...], *others):
        definitions = tuple(getattr(FORCES[name], what, None) for name in names for what in COMPILED)
        return made(definitions, names, *others)

    return find


@cached
def total(names: tuple[str, ...], function: str, *others: str):
    """Make the kernel that calls a function of each force in turn, or the first of the others that the force has.

    Raises:
        ValueError: for a function that is not in KERNELS, or a force whose part no body or world has had.
    """
    if not {function, *others} <= set(KERNELS):
        raise ValueError(f"{(function, *others)} are no functions of forces; choose from {', '.join(KERNELS)}")
    absent = [name for name in names if isinstance(FORCES[name], str)]
    if absent:
        raise ValueError(f"{absent[0]!r} acts on nothing here: give a body or a world with its part, or leave it out")
    found = {}
    for name in names:
        chosen = next((option for option in (function, *others) if hasattr(FORCES[name], option)), None)
        if chosen is not None:
            found[name] = getattr(FORCES[name], chosen)
    if function == "failed":  # the first in the list takes precedence
        found = dict(reversed(found.items()))
    join = {"energy": add_numbers, "loss": add_numbers, "failed": first_code}.get(function, in_turn)
    kernels = nothing if join is in_turn else no_number
    for name, one in found.items():
        kernels = join(kernels, one, name if has_cache(name) else "", float(getattr(FORCES[name], "FAILURE", 0)))
    return kernels


@kernel
def nothing(body, world, control, x, v, f, cache):
    """Call no kernel."""


@kernel
def no_number(body, world, control, x, v, f, cache):
    """Return zero."""
    return zero(control.stiffness)


def in_turn(before, one, name: str, code: float):
    """Make the kernel that calls the kernels before, and one with its part of the cache."""

    @kernel
    def call(body, world, control, x, v, f, cache):
        before(body, world, control, x, v, f, cache)
        one(body, world, control, x, v, f, field(cache, name))

    return call


def add_numbers(before, one, name: str, code: float):
    """Make the kernel that adds the number of one kernel to those before."""

    @kernel
    def add(body, world, control, x, v, f, cache):
        return before(body, world, control, x, v, f, cache) + one(body, world, control, x, v, f, field(cache, name))

    return add


def first_code(before, one, name: str, code: float):
    """Make the kernel that returns the code of one kernel where it is true, and the code of those before elsewhere."""

    @kernel
    def choose(body, world, control, x, v, f, cache):
        found = before(body, world, control, x, v, f, cache)
        return select(one(body, world, control, x, v, f, field(cache, name)), code, found)

    return choose


def depend_on_position(names: tuple[str, ...]) -> bool:
    """Return True if any of the forces may depend on the absolute position of the body."""
    return not all(hasattr(FORCES[name], "ANYWHERE") for name in names)


def any_has(names: tuple[str, ...], *functions: str) -> bool:
    """Return True if any of the forces has any of these functions."""
    return any(hasattr(FORCES[name], function) for name in names for function in functions)


def constant_system(body: Body, world: World) -> bool:
    """Return True if h D + h^2 K of all acting forces does not depend on positions and velocities."""
    implicit = [FORCES[name] for name in present(body, world) if hasattr(FORCES[name], "add_system")]
    return all(hasattr(force, "constant") and force.constant(body, world) for force in implicit)


def bounds(body: Body, world: World) -> list[tuple[float, float]]:
    """Contributions of the surroundings to the highest stiffness and damping eigenvalues, 1/s2 and 1/s."""
    return [FORCES[name].bounds(body, world) for name in present(body, world) if hasattr(FORCES[name], "bounds")]


def rest_matrices(body: Body, elastic: bool = True) -> list[tuple]:
    """Element matrices of all forces within a body for small motion about rest: stiffness, N/m, or damping, N s/m.

    A list of (nodes (M,k), matrices (M,3k,3k)), each for M elements of k nodes.
    """
    modules = [module for module in loaded(body).values() if hasattr(module, "rest_matrices")]
    return [part for module in modules for part in module.rest_matrices(body, elastic)]
