"""What the rejected methods share: a record that makes them a `Method`, and their dense systems.

They move one fish, as it was made, in one lane: what they store from step to step belongs to that fish.

Legend: a matrix; b its right-hand sides, then the solution: (N,3) for a matrix that serves all axes, else (3N,1); e
spring.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fish_env import forces
from fish_env._jit import INDEX, kernel, part
from fish_env.body import Body
from fish_env.forces.evaluate import Evaluator
from fish_env.forces.plan import H
from fish_env.integrators._common import move_rest_lengths, plan_of_step, scratch
from fish_env.simd import Kind, Pack, dot, floats, fma, sqrt, zero
from fish_env.world import VACUUM


@dataclass(frozen=True)
class RejectedMethod:
    """A method that was rejected."""

    name: str
    make_run: Callable[[tuple[str, ...]], Callable]
    """As of `fish_env.integrators.Method`."""
    extra: Callable[[Body, Kind, float], dict]
    """What its scratch memory holds beside a force, by name, for a body, a kind and `number`."""
    cost: tuple[int, int, int]
    """Force evaluations, factorisations and solves of a step."""
    once: tuple[int, int] = (0, 0)
    """Force evaluations and factorisations that are made only once, however far the fish swims."""
    number: float = field(default=0.0, compare=False)
    """The step, s, for those that prepare a matrix for it; what step doubling may err in a step, m."""

    def plan(self, elastic: float, viscous: float, h: float) -> np.ndarray:
        """The row of `control.plans`."""
        return plan_of_step(elastic, viscous, h)

    def costs(self, row: np.ndarray) -> tuple[int, int, int]:
        """Force evaluations, factorisations and solves of a step."""
        return self.cost

    def make_work(self, body: Body, kind: Kind) -> Pack:
        """Scratch of a fish."""
        if kind.lanes != 1:
            raise ValueError(f"lanes is {kind.lanes!r}; a rejected method takes 1")
        return scratch(body, kind, "f", **self.extra(body, kind, self.number))


def nothing(body, kind, number) -> dict:
    """No scratch memory beside the force."""
    return {}


def system(size: int, columns: int) -> dict:
    """A dense matrix and its right-hand sides."""
    return {"a": np.zeros((size, size)), "b": np.zeros((size, columns))}


def at_rest(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, stiffness and damping of the springs of a body at rest, (3N,3N) each."""
    still = np.zeros_like(body.position)
    stiffness, damping = Evaluator(body, VACUUM).jacobian(body.springs.rest_length, body.position, still)
    return np.diag(np.repeat(body.mass, 3)), stiffness, damping


def isotropic(body: Body, weight) -> np.ndarray:
    """Matrix (N,N) of masses, and of springs that pull back with a weight (E,) wherever their nodes go."""
    ends = np.zeros((len(weight), len(body.mass)))
    ends[np.arange(len(weight)), body.springs.nodes[:, 0]] = -1.0
    ends[np.arange(len(weight)), body.springs.nodes[:, 1]] = 1.0
    return np.diag(body.mass) + ends.T @ (weight[:, None] * ends)


def make_force(names: tuple[str, ...], function: str = "add_force"):
    """The kernel `force(body, world, control, x, v, f, cache)` that sets f to the sum of these forces."""
    add_force = forces.total(names, function)

    @kernel
    def force(body, world, control, x, v, f, cache):
        for i in range(f.size):
            f[i] = zero(f)
        add_force(body, world, control, x, v, f, cache)

    return force


def leapfrog(make_kick):
    """Drift half a step, kick, drift half a step; `kick` leaves the change of the velocities in `work.f`.

    It has the middle's positions and rest lengths, and the velocities of the step's start.
    """

    def make_run(names):
        kick = make_kick(names)

        @kernel
        def run(body, world, control, x, v, work, cache, n):
            h, f = control.plans[control.row[0], H], work.f
            for s in range(n):
                for i in range(x.size):
                    x[i] = fma(0.5 * h, v[i], x[i])
                move_rest_lengths(control, (s + 0.5) * h)
                kick(body, world, control, x, v, work, cache)
                for i in range(x.size):
                    v[i] += f[i]
                    x[i] = fma(0.5 * h, v[i], x[i])

        return run

    return make_run


@kernel
def spring(body, control, x, e):
    """Of spring e: its nodes, its separation r, 1 / |r|, and its strain over its present length."""
    i, j = INDEX(body.springs.nodes[e, 0]), INDEX(body.springs.nodes[e, 1])
    r = x[j] - x[i]
    inverse = 1.0 / sqrt(dot(r, r))
    return i, j, r, inverse, 1.0 - control.rest_length[e] * inverse


@kernel
def set_masses(body, a):
    """Set a matrix, (N,N) or (3N,3N), to the masses."""
    axes = a.shape[0] // body.mass.size
    for p in range(a.shape[0]):
        for q in range(a.shape[1]):
            a[p, q] = 0.0
        a[p, p] = body.mass[p // axes]


@kernel
def pour(vectors, b):
    """Copy vectors (N,) into right-hand sides."""
    values, width = floats(vectors), b.shape[1]
    for i in range(vectors.size):
        for k in range(3):
            place = 3 * i + k
            b[place // width, place % width] = values[i, k, 0]


@kernel
def pour_back(b, vectors):
    """Copy a solution into vectors (N,)."""
    values, width = floats(vectors), b.shape[1]
    for i in range(vectors.size):
        for k in range(3):
            place = 3 * i + k
            values[i, k, 0] = b[place // width, place % width]


@part
def solve(a, b):
    """Solve a system in place, by elimination with the largest pivot of each column; the matrix is destroyed."""
    size, columns = b.shape
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        for j in range(k, size):
            a[k, j], a[best, j] = a[best, j], a[k, j]
        for j in range(columns):
            b[k, j], b[best, j] = b[best, j], b[k, j]
        for i in range(k + 1, size):
            part_of = a[i, k] / a[k, k]
            for j in range(k + 1, size):
                a[i, j] -= part_of * a[k, j]
            for j in range(columns):
                b[i, j] -= part_of * b[k, j]
    for above in range(size):
        k = size - 1 - above
        for j in range(columns):
            total = b[k, j]
            for i in range(k + 1, size):
                total -= a[k, i] * b[i, j]
            b[k, j] = total / a[k, k]


@part
def multiply(inverse, b, c):
    """Set c to the inverse of a matrix times right-hand sides b."""
    size, columns = b.shape
    for i in range(size):
        for j in range(columns):
            total = 0.0
            for k in range(size):
                total += inverse[i, k] * b[k, j]
            c[i, j] = total
