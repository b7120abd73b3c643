"""Forces, exact derivatives and energies of one fish, for Python: references, statics and tests call them."""

from functools import cache

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.forces.control import make_control
from fish_env.simd import Kind, Pack, packed, zero

ONE = Kind(1)


@cache
def compiled(names: tuple[str, ...], function: str):
    """A function of all these forces, compiled: it fills `block.f`, or `block.matrices`, or returns a number."""
    call = forces.total(names, function)
    if function in ("energy", "failed"):

        @njit
        def number(block):
            b = block
            return call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

        return number
    if function == "add_jacobian":

        @njit
        def jacobian(block):
            b = block
            call(b.body, b.world, b.control, b.x, b.v, b.matrices, b.cache)

        return jacobian

    @njit
    def force(block):
        b = block
        for i in range(b.f.size):
            b.f[i] = zero(b.f)
        call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

    return force


class Evaluator:
    """The forces on one body in one world, worked out for positions x and velocities v (N,3) and rest lengths (E,).

    Args:
        body: any.
        world: what surrounds it.
        names: the forces to take into account; None for all that act.
    """

    def __init__(self, body, world, names: tuple[str, ...] | None = None):
        self.names = forces.present(body, world) if names is None else names
        n = len(body.mass)
        self._control = make_control(body, ONE)
        self._matrices = Pack("matrices", stiffness=np.zeros((0, 0)), damping=np.zeros((0, 0)))
        self._block = Pack(
            "block", body=packed(body, ONE), world=packed(world, ONE), control=self._control,
            x=ONE.vectors(n), v=ONE.vectors(n), f=ONE.vectors(n),
            cache=forces.make_cache(body, world, ONE, self.names), matrices=self._matrices,
        )  # fmt: skip

    def _set(self, rest_length, x, v) -> None:
        self._control.rest_length.memory[:, 0] = rest_length
        self._block.x.memory[:], self._block.v.memory[:] = x, v

    def force(self, rest_length, x, v) -> np.ndarray:
        """Force on every node, (N,3) N."""
        self._set(rest_length, x, v)
        compiled(self.names, "add_force")(self._block)
        return self._block.f.memory.copy()

    def jacobian(self, rest_length, x, v) -> tuple[np.ndarray, np.ndarray]:
        """Exact -df/dx (3N,3N) N/m and -df/dv (3N,3N) N s/m. The walls, whose force jumps, are left out.

        Raises:
            ValueError: for a force without derivatives.
        """
        for name in forces.without(self.names, "add_jacobian"):
            raise ValueError(f"the force {name!r} has no add_jacobian; this method needs exact derivatives")
        self._set(rest_length, x, v)
        size = 3 * len(x)
        stiffness, damping = np.zeros((2, size, size))
        self._matrices.set(stiffness=stiffness, damping=damping)
        compiled(self.names, "add_jacobian")(self._block)
        return stiffness, damping

    def energies(self, rest_length, x, v) -> dict[str, float]:
        """Energy, J: "kinetic", and what each force stores, by its name."""
        self._set(rest_length, x, v)
        stored = {name: float(compiled((name,), "energy")(self._block)) for name in self._having("energy")}
        kinetic = 0.5 * self._block.body.mass @ (np.asarray(v) ** 2).sum(axis=1)
        return {"kinetic": float(kinetic), **stored}

    def failures(self, rest_length, x) -> set[int]:
        """Why a body at these positions is not valid any more: indices into FAILURES."""
        self._set(rest_length, x, np.zeros_like(x))
        broken = [name for name in self._having("failed") if compiled((name,), "failed")(self._block)]
        return {forces.FORCES[name].FAILURE for name in broken}

    def _having(self, function: str) -> list[str]:
        return [name for name in self.names if hasattr(forces.FORCES[name], function)]
