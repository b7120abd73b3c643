"""Forces, exact derivatives and energies of one fish, callable from Python: for references, statics and tests.

Derivatives come from the forces' own kernels, called with dual numbers: no force implements them.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.simd import Kind, Pack, directions, floats, packed, zero
from fish_env.physics import forces
from fish_env.physics.forces.control import make_control
from fish_env.physics.integrity import check_elements, check_world
from fish_env.physics.records import Body, World

ONE, DUAL = Kind(1), Kind("dual")


@forces.cached
def compiled(names: tuple[str, ...], function: str) -> Callable[..., Any]:
    """Compile a function of all these forces, which fills `block.f` or returns a number."""
    call, add_reaction = forces.total(names, function), forces.total(names, "add_reaction")
    if function in ("energy", "failed"):

        @njit
        def number(block):
            b = block
            return call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

        return number

    @njit
    def force(block):
        b = block
        for i in range(b.f.size):
            b.f[i] = zero(b.f)
        call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)
        if function == "add_force":
            add_reaction(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

    return force


def make_dual(body: Body, world: World, names) -> Pack:
    """Memory in which these forces compute their derivatives: one fish of dual numbers."""
    n = len(body.mass)
    return Pack("dual", control=make_control(body, DUAL), cache=forces.make_cache(body, world, DUAL, names),
                x=DUAL.vectors(n), v=DUAL.vectors(n), f=DUAL.vectors(n))  # fmt: skip


@forces.cached
def make_jacobian(names: tuple[str, ...]):
    """Make the kernel `(body, world, dual, stiffness, damping, begin)` for columns of -df/dx and -df/dv, (3N,...)."""
    # It sums the smooth ones of these forces on one fish (one lane, float64), in the state of the values in
    # `make_dual`'s pack. `stiffness` (3N,C) receives the columns from number `begin` on, `damping` all of its own, or
    # none if (3N,0).
    smooth = tuple(name for name in names if not hasattr(forces.FORCES[name], "JUMPS"))
    add_force, add_reaction = forces.total(smooth, "add_force"), forces.total(smooth, "add_reaction")

    @kernel
    def jacobian(body, world, dual, stiffness, damping, begin):
        x, v, f, count = floats(dual.x), floats(dual.v), floats(dual.f), stiffness.shape[1]
        columns, width = count + damping.shape[1], directions(dual.f)
        for first in range(0, columns, width):
            last = min(first + width, columns)
            for m in range(first, last):
                moving, place, which = (x, begin + m, m - first + 1) if m < count else (v, m - count, m - first + 1)
                moving[place // 3, place % 3, which] = 1.0
            for i in range(dual.f.size):
                dual.f[i] = zero(dual.f)
            add_force(body, world, dual.control, dual.x, dual.v, dual.f, dual.cache)
            add_reaction(body, world, dual.control, dual.x, dual.v, dual.f, dual.cache)
            for m in range(first, last):
                moving, place, which = (x, begin + m, m - first + 1) if m < count else (v, m - count, m - first + 1)
                matrix, column = (stiffness, m) if m < count else (damping, m - count)
                moving[place // 3, place % 3, which] = 0.0
                for row in range(matrix.shape[0]):
                    matrix[row, column] = -f[row // 3, row % 3, which]

    return jacobian


@forces.cached
def compiled_jacobian(names: tuple[str, ...]):
    """Compile `make_jacobian`'s kernel as a function that Python calls."""
    jacobian = make_jacobian(names)

    @njit
    def call(block, dual, stiffness, damping, begin):
        jacobian(block.body, block.world, dual, stiffness, damping, begin)

    return call


class Evaluator:
    """Forces on one body in one world, for positions x and velocities v (N,3) and rest lengths (E,).

    `names` are the forces to include, None for all acting ones. ValueError if body or world are inconsistent.
    """

    def __init__(self, body: Body, world: World, names: tuple[str, ...] | None = None):
        check_elements(body)
        check_world(world, len(body.mass))
        acting = forces.present(body, world)  # which also loads them
        self.names = acting if names is None else names
        n = len(body.mass)
        self._control, self._dual, self._around = make_control(body, ONE), None, (body, world)
        self._compiled, self._jacobian = cache(compiled), cache(compiled_jacobian)  # for the present FORCES
        self._block = Pack(
            "block", body=packed(body, ONE), world=packed(world, ONE), control=self._control,
            x=ONE.vectors(n), v=ONE.vectors(n), f=ONE.vectors(n),
            cache=forces.make_cache(body, world, ONE, self.names),
        )  # fmt: skip

    def _set(self, rest_length, x, v) -> None:
        self._control.rest_length.memory[:, 0] = rest_length
        self._block.x.memory[:], self._block.v.memory[:] = x, v

    def force(self, rest_length, x, v, elapsed=0.0) -> np.ndarray:
        """Force on every node, (N,3) N, with moving anchors `elapsed` seconds after their stored positions."""
        self._set(rest_length, x, v)
        self._control.elapsed[0] = elapsed
        self._compiled(self.names, "add_force")(self._block)
        return self._block.f.memory.copy()

    def inertia(self, x, a) -> np.ndarray:
        """Mass that the forces add to the nodes' own at positions x, times accelerations a (N,3) m/s2: (N,3) N."""
        names = tuple(self._having("add_inertia"))
        if not names:
            return np.zeros_like(a)
        self._set(self._control.rest_length.memory[:, 0], x, a)
        self._compiled(names, "add_inertia")(self._block)
        return self._block.f.memory.copy()

    def jacobian(self, rest_length, x, v, elapsed=0.0) -> tuple[np.ndarray, np.ndarray]:
        """Exact -df/dx (3N,3N) N/m and -df/dv (3N,3N) N s/m, without walls, whose force is discontinuous."""
        return self._derivatives(rest_length, x, v, range(x.size), x.size, elapsed)

    def stiffness(self, rest_length, x, v, columns: range | None = None) -> np.ndarray:
        """Exact -df/dx (3N,3N) N/m, as `jacobian`, or a range of its columns, (3N,C)."""
        return self._derivatives(rest_length, x, v, range(x.size) if columns is None else columns, 0)[0]

    def _derivatives(self, rest_length, x, v, columns: range, damped: int, elapsed=0.0):
        if self._dual is None:
            self._dual = make_dual(*self._around, self.names)
        dual, stiffness, damping = self._dual, np.zeros((x.size, len(columns))), np.zeros((x.size, damped))
        dual.control.rest_length.memory[:, 0], dual.control.elapsed[0] = rest_length, elapsed
        dual.x.memory[:, :, 0], dual.v.memory[:, :, 0] = x, v
        self._jacobian(self.names)(self._block, dual, stiffness, damping, columns.start)
        return stiffness, damping

    def energies(self, rest_length, x, v) -> dict[str, float]:
        """Energies, J: "kinetic", and the stored energy of each force, by its name."""
        self._set(rest_length, x, v)
        stored = {name: float(self._compiled((name,), "energy")(self._block)) for name in self._having("energy")}
        kinetic = 0.5 * self._block.body.mass @ (np.asarray(v) ** 2).sum(axis=1)
        return {"kinetic": float(kinetic), **stored}

    def failures(self, rest_length, x) -> set[int]:
        """Reasons that a body at these positions is invalid: indices into FAILURES."""
        self._set(rest_length, x, np.zeros_like(x))
        broken = [name for name in self._having("failed") if self._compiled((name,), "failed")(self._block)]
        return {forces.FORCES[name].FAILURE for name in broken}

    def _having(self, function: str) -> list[str]:
        return [name for name in self.names if hasattr(forces.FORCES[name], function)]
