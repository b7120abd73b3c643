"""System matrices of one body, M + h D + h^2 K in its skyline, assembled, factorised and solved by the kernels."""

from functools import cache

import numpy as np

from fish_env import forces
from fish_env._jit import njit
from fish_env.body import Body
from fish_env.forces.control import make_control
from fish_env.integrators import _common as common
from fish_env.linalg import ldlt
from fish_env.simd import Kind, Pack, packed
from fish_env.world import World


@cache
def compiled(names: tuple[str, ...]) -> dict:
    """What a system does, compiled for Python to call, for forces of these names that are taken implicitly."""
    add_system, add_tangent = forces.total(names, "add_system"), forces.total(names, "add_tangent")

    @njit
    def assemble(block):
        b = block
        common.set_masses(b.body, b.matrix)
        add_system(b.body, b.world, b.control, b.x, b.v, b.matrix, b.cache)

    @njit
    def add_pull(block):
        b = block
        add_tangent(b.body, b.world, b.control, b.x, b.moved, b.load, b.cache)

    @njit
    def eliminate(block):
        common.zero_fixed(block.body, block.load)
        common.eliminate(block.body, block.matrix)

    @njit
    def factor_solve(block):
        ldlt.factor(block.body.profile, block.matrix, block.row)
        ldlt.solve(block.body.profile, block.matrix, block.load)

    return {kernel.__name__: kernel for kernel in (assemble, add_pull, eliminate, factor_solve)}


class System:
    """The system of a body where it is at rest, at rest, not moving.

    Args:
        body: any; its springs have their rest lengths there.
        world: what surrounds it.
        h: step, s.
    """

    def __init__(self, body: Body, world: World, h: float):
        kind, n = Kind("xyz"), len(body.mass)
        names = tuple(name for name in forces.present(body, world) if forces.any_has((name,), "add_system"))
        self._kernels = compiled(names)
        self._block = Pack(
            "block", body=packed(body, kind), world=packed(world, kind),
            control=make_control(body, kind, plans=common.plan_of_step(0.0, 0.0, h)[None]),
            x=kind.rows(body.position), v=kind.vectors(n), moved=kind.vectors(n), load=kind.vectors(n),
            matrix=kind.vectors(3 * int(body.profile.start[-1])), row=kind.vectors(3 * n),
            cache=forces.make_cache(body, world, kind, names),
        )  # fmt: skip
        self.load = self._block.load.memory[:, :3]
        """The right-hand side, then the solution, (N,3): live."""
        self.columns = self._block.matrix.memory
        """The matrix, then its factors, (3S,4): the columns of a block for each entry of the skyline, and nothing."""

    def assemble(self) -> np.ndarray:
        """Set the matrix to M + h D + h^2 K; returns its blocks (S,3,3), a copy."""
        self._kernels["assemble"](self._block)
        return self.columns[:, :3].reshape(-1, 3, 3).transpose(0, 2, 1).copy()

    def add_pull(self, moved) -> None:
        """Add to the load the pull of the stiffness last assembled, if the nodes moved by `moved` (N,3) m."""
        self._block.moved.memory[:, :3] = moved
        self._kernels["add_pull"](self._block)

    def eliminate(self) -> None:
        """Take the fixed degrees of freedom out of the matrix and the load."""
        self._kernels["eliminate"](self._block)

    def factor_solve(self) -> None:
        """Factorise the matrix and solve for the load, in place."""
        self._kernels["factor_solve"](self._block)
