"""Any function of the forces, of any kind of block, for the tests: numpy arrays in, numpy arrays out."""

from functools import cache

import numpy as np

from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack, Vectors, packed, zero
from fish_env.physics import forces
from fish_env.physics.forces.control import NOMINAL, make_control
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, LOWEST, POLYNOMIAL, STAGES, H

ONE = Kind(1)
STEP = 0.37


def plan(h=STEP, inner=None, lowest=-np.inf, factor=1.0, least=0.0, stages=0):
    """The row of a plan as forces read it."""
    row = np.zeros(POLYNOMIAL)
    inner = h if inner is None else inner
    row[[H, INNER, LOWEST, FACTOR, LEAST, STAGES]] = h, inner, lowest, factor, least, stages
    return row


@cache
def entry(names, function, default):
    """A function of forces of these names, compiled: it changes what stands in `block.f`, or fills `block.number`."""
    call = forces.total(names, function, *default)
    if function in ("energy", "loss", "failed"):

        @njit
        def number(block):
            b = block
            b.number[0] = zero(b.number) + call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

        return number

    @njit
    def run(block):
        b = block
        call(b.body, b.world, b.control, b.x, b.v, b.f, b.cache)

    return run


def write(array, values):
    """Set an array of a kind to values (W,n,3), or of numbers (W,n)."""
    if not isinstance(array, Vectors):
        array.memory[:] = np.transpose(values)
    elif array.kind.lanes == "xyz":
        array.memory[:, :3] = values[0]
    else:
        array.memory.reshape(len(array.memory), 3, -1)[:] = np.transpose(values, (1, 2, 0))


def read(array):
    """Values (W,n,3) of an array of vectors of a kind, or (W,n) of one of numbers."""
    if not isinstance(array, Vectors):
        return array.memory.T.copy()
    if array.kind.lanes == "xyz":
        return array.memory[None, :, :3].copy()
    return array.memory.reshape(len(array.memory), 3, -1).transpose(2, 0, 1).copy()


class Block:
    """A block of W fish of one body, at states of their own.

    Args:
        names: of the forces; None for all that act.
        body: any.
        world: what surrounds it.
        kind: of W lanes.
        rest_length: (E,) m or (W,E) m; None takes the body's.
        variation: (6,) or (W,6), what sets the fish apart.
        **numbers: of the plan.
    """

    def __init__(self, names, body, world, kind=ONE, rest_length=None, variation=NOMINAL, **numbers):
        self.names = forces.present(body, world) if names is None else names
        self.body, self.kind, n, w = body, kind, len(body.mass), kind.width
        control = make_control(body, kind, plans=plan(**numbers)[None])
        if rest_length is not None:
            write(control.rest_length, np.broadcast_to(rest_length, (w, len(body.springs.nodes))))
        stiffness, mass, drag, *current = np.broadcast_to(variation, (w, 6)).T
        for field, value in (("stiffness", stiffness / mass), ("drag", drag / mass), ("lightness", 1.0 / mass)):
            write(getattr(control, field), value[:, None])
        write(control.current, np.transpose(current)[:, None])
        self.control = control
        self.pack = Pack(
            "block", body=packed(body, kind), world=packed(world, kind), control=control, x=kind.vectors(n),
            v=kind.vectors(n), f=kind.vectors(n), cache=forces.make_cache(body, world, kind, self.names),
            number=kind.numbers(1),
        )  # fmt: skip
        entries, others = int(body.profile.start[-1]), self.pack._kept
        self.system = Pack("block", **(others | {"f": kind.vectors(3 * entries)}))
        tu = Pack("system", matrix=kind.numbers(entries), load=kind.vectors(n))
        self.tu = Pack("block", **(others | {"f": tu}))

    def set(self, x, v):
        """Put the fish at x and v, (W,N,3), or (N,3) for all alike."""
        for array, value in ((self.pack.x, x), (self.pack.v, v)):
            write(array, np.broadcast_to(value, (self.kind.width, *np.shape(value)[-2:])))
        return self

    def add(self, function, *default, f=0.0, v=None):
        """What a function makes of f, (W,N,3), or (N,3) of one fish; v takes the place of the velocities."""
        if v is not None:
            self.set(self._one(read(self.pack.x)), v)
        write(self.pack.f, np.broadcast_to(f, (self.kind.width, len(self.body.mass), 3)))
        entry(self.names, function, default)(self.pack)
        return self._one(read(self.pack.f))

    def velocities(self, function):
        """What a function makes of the velocities, as `add`."""
        entry(self.names, function, ())(self.pack)
        return self._one(read(self.pack.v))

    def number(self, function):
        """The energy, or the code of a failure, (W,), or one number of one fish."""
        entry(self.names, function, ())(self.pack)
        return self._one(read(self.pack.number)[:, 0])

    def blocks(self, function):
        """The blocks (W,S,3,3), or (S,3,3) of one fish, that a function adds to a system matrix."""
        self.system.f.memory[:] = 0.0
        entry(self.names, function, ())(self.system)
        columns = read(self.system.f)
        return self._one(columns.reshape(len(columns), -1, 3, 3).swapaxes(2, 3))

    def matrix(self, function):
        """The symmetric matrix (3N,3N) of those blocks, of one fish; above the diagonal nothing is read."""
        shape, a, n = self.body.profile, self.blocks(function), len(self.body.mass)
        matrix = np.zeros((3 * n, 3 * n))
        for i in range(n):
            for j in range(shape.first[i], i + 1):
                matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = a[shape.start[i] + j - shape.first[i]]
        return np.tril(matrix) + np.tril(matrix, -1).T

    def lagged(self):
        """What `add_lagged` adds to the matrix and to the load of Tu's method, (W,S) and (W,N,3), or of one fish."""
        matrix, load = self.tu.f.matrix, self.tu.f.load
        matrix.memory[:], load.memory[:] = 0.0, 0.0
        entry(self.names, "add_lagged", ())(self.tu)
        return {"matrix": self._one(read(matrix)), "load": self._one(read(load))}

    def _one(self, values):
        return values[0] if self.kind.width == 1 else values


def force(name, body, world, x, v, rest_length=None):
    """The force (N,3) of one kind on one fish."""
    return Block((name,), body, world, rest_length=rest_length).set(x, v).add("add_force")


def energy(name, body, world, x, rest_length=None):
    """The energy of one kind of one fish, J."""
    return float(Block((name,), body, world, rest_length=rest_length).set(x, 0 * x).number("energy"))
