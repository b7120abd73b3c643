"""The compiled loop over blocks of fish: gather, integrate, check, scatter; and the intervals that are repeated.

A block is the number of fish that the kernels process at once. Its fish are copied from the rows of the tank into
lanes, moved, checked and copied back, so that a fish that fails leaves its row unchanged. Lanes are independent: a fish
has the same bits as a single fish and in any batch.

Legend: b fish; i node; k axis; m lane; e spring; d driven spring; p, q start and end of a block in the list `todo`.
"""

from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from fish_env.kernels.compile import INDEX, kernel, njit, part
from fish_env.kernels.simd import Kind, Pack, block_size, dot, floats, lane, nowhere, packed, select, zero
from fish_env.physics import forces
from fish_env.physics.failures import NON_FINITE, OUT_OF_RANGE, UNTRUSTED_SOLVE
from fish_env.physics.forces.control import CURRENT, DRAG, MASS, STIFFNESS, make_control
from fish_env.physics.forces.plan import STAGES, H
from fish_env.physics.integrators.leapfrog_chebyshev import MOST_STAGES

if TYPE_CHECKING:
    from fish_env.physics.tank import Tank

MOST_KEYS = 10_000  # stiffnesses whose step coefficients are cached
DEEPEST = 6  # how often steps are halved at most
COUNTED = 3  # force evaluations, factorisations and solves of a step
FARTHEST = 1000.0  # body lengths from the origin, in float32, if a force depends on the position: resolution 6e-5 BL
FACTORISATIONS = 1  # index of the count that reused factors reduce


@kernel
def gather(tank, block, todo, p, q):
    """Copy fish todo[p:q] into the lanes of a block; the last fish also fills the unused lanes."""
    # Positions are relative to each fish's first node if `block.relative`: single precision is insufficient far from
    # the origin.
    control = block.control
    x, v, start, rate = floats(block.x), floats(block.v), floats(control.start), floats(control.rate)
    rest, stiffness, drag = floats(control.rest_length), floats(control.stiffness), floats(control.drag)
    lightness, shortness, current = floats(control.lightness), floats(control.shortness), floats(control.current)
    for m in range(block_size(block.x)):
        b = INDEX(todo[min(p + m, q - 1)])
        for k in range(3):
            origin = tank.x[b, 0, k] if block.relative else 0.0
            for i in range(x.shape[0]):
                x[i, k, m] = tank.x[b, i, k] - origin
                v[i, k, m] = tank.v[b, i, k]
        for e in range(rest.shape[0]):
            rest[e, m] = tank.rest_length[b, e]
        for d in range(start.shape[0]):
            e = INDEX(control.driven[d])
            start[d, m] = tank.rest_length[b, e]
            rate[d, m] = tank.rate[b, e]
        light = 1.0 / tank.variation[b, MASS]
        stiffness[0, m] = tank.variation[b, STIFFNESS] * light
        drag[0, m] = tank.variation[b, DRAG] * light
        lightness[0, m] = light
        shortness[0, m] = 1.0 / tank.length_variation[b]
        for k in range(3):
            current[0, k, m] = tank.variation[b, CURRENT + k]
    for k in range(control.flows.total.size):
        control.flows.total[k] = zero(control.flows.total)
    control.fastest[0] = zero(control.fastest)
    control.work[0] = zero(control.work)
    control.pivots[0] = zero(control.pivots)
    control.untrusted[0] = zero(control.untrusted)
    control.reused[0] = 0


@kernel
def scatter(tank, queue, block, b, m):
    """Copy lane m of a block back to fish b, and add the work of its muscles and the flows that are measured."""
    x, v = floats(block.x), floats(block.v)
    for k in range(3):
        origin = tank.x[b, 0, k]
        for i in range(x.shape[0]):
            tank.x[b, i, k] = origin + x[i, k, m] if block.relative else x[i, k, m]
            tank.v[b, i, k] = v[i, k, m]
    tank.work[b] += tank.variation[b, STIFFNESS] * floats(block.control.work)[0, m]
    for k in range(queue.flows.shape[1]):
        queue.flows[b, k] += tank.variation[b, MASS] * floats(block.control.flows.total)[k, m]


@kernel
def stop(tank, block, b, duration):
    """Move the rest lengths of fish b to the end of the interval, and set their rates to zero."""
    driven = block.control.driven
    for d in range(driven.size):
        e = INDEX(driven[d])
        tank.rest_length[b, e] += duration * tank.rate[b, e]
        tank.rate[b, e] = 0.0


@kernel
def end_of_block(queue, todo, p, count, lanes):
    """End of the fish todo[p:] that fit into one block: at most one a lane, all with the same step coefficients."""
    row, q = queue.row[todo[p]], p + 1
    while q < count and q - p < lanes and queue.row[todo[q]] == row:
        q += 1
    return q


@forces.cached
def make_failure_codes(names: tuple[str, ...]):
    """Make the kernel that returns the failure codes of a block, for the forces of these names."""
    # It returns one number per lane: 0, or an index into FAILURES.
    failed, placed = forces.total(names, "failed"), forces.depend_on_position(names)

    @part
    def failure_codes(block):
        body, world, control, x, v, c = block.body, block.world, block.control, block.x, block.v, block.cache
        infinite = nowhere(x)
        for i in range(x.size):
            infinite = infinite | (select(dot(x[i], x[i]) + dot(v[i], v[i]) < np.inf, 0.0, 1.0) > 0.0)
        code = failed(body, world, control, x, v, x, c)
        if placed:
            far = nowhere(x)
            for i in range(x.size):
                far = far | (select(dot(x[i], x[i]) < block.reach, 0.0, 1.0) > 0.0)
            code = select(far, 1.0 * OUT_OF_RANGE, code)
        code = select(infinite, 1.0 * NON_FINITE, code)
        return select(control.untrusted[0] > 0.0, 1.0 * UNTRUSTED_SOLVE, code)  # any infinite value results from it

    return failure_codes


@forces.cached
def make_finish(names: tuple[str, ...]):
    """Make the kernel that ends an attempt to move a block: each fish is stored, has failed, or is repeated."""
    failure_codes = make_failure_codes(names)

    @part
    def restore_rest_state(tank, block, p, q):
        """Move fish whose state was invalid at the start, as set by a user, to the body's rest position."""
        # Rest lengths that are not finite become natural lengths, and a clock that is not finite becomes zero.
        gather(tank, block, block.todo, p, q)
        code = failure_codes(block)
        for m in range(q - p):
            b = INDEX(block.todo[p + m])
            if tank.failure[b] != 0 and lane(code, m) > 0.0:
                tank.failure[b] = int(lane(code, m))
                for i in range(block.x.size):
                    for k in range(3):
                        tank.x[b, i, k] = tank.rest_position[i, k]
                        tank.v[b, i, k] = 0.0
            for e in range(tank.rest_length.shape[1]):
                if tank.failure[b] != 0 and not abs(tank.rest_length[b, e]) < np.inf:
                    tank.rest_length[b, e] = tank.spring_length[e]
            if not abs(tank.clock[b]) < np.inf:
                tank.clock[b] = 0.0

    @part
    def finish(tank, queue, block, p, q, level, steps, again):
        """End an attempt at `steps` steps of fish todo[p:q]; return the number to repeat, which are first in todo."""
        control, todo = block.control, block.todo
        whole = control.plans[queue.row[todo[p]], H] * (steps >> level)
        strain = control.plans[control.row[0], H] * control.fastest[0]
        code, pivots, bad = failure_codes(block), control.pivots[0], 0
        for m in range(q - p):
            b = INDEX(todo[p + m])
            for k in range(COUNTED):
                tank.counters[b, k] += steps * control.costs[control.row[0], k]
            tank.counters[b, FACTORISATIONS] -= control.reused[0]
            tank.counters[b, COUNTED] += int(lane(pivots, m))
            reason = int(lane(code, m))
            if not abs(tank.clock[b]) < np.inf:
                reason = NON_FINITE
            failing = reason != 0
            if level < queue.deepest and (failing or lane(strain, m) > queue.tolerance):
                todo[again] = todo[p + m]
                again += 1
                tank.counters[b, COUNTED + 1] += 1
                continue
            if failing:
                tank.failure[b] = reason
                bad += 1
            else:
                scatter(tank, queue, block, b, m)
                tank.clock[b] += whole
            stop(tank, block, b, whole)
        if bad > 0:
            restore_rest_state(tank, block, p, q)
        return again

    return finish


@forces.cached
def make_advance(names: tuple[str, ...], make_run):
    """Make the kernel `advance` of a method from its `make_run`, for the forces of these names."""
    run, finish = make_run(names), make_finish(names)

    @part
    def advance(tank, queue, block, first, last, n):
        """Move fish queue.order[first:last] by n steps, in place. Fish that fail keep their last state."""
        control, todo = block.control, block.todo
        none = np.int64(0)  # with a literal 0 numba would compile `gather` and `finish` twice
        lanes, count, level, steps = block_size(block.x), none, none, n
        for p in range(first, last):
            b = queue.order[p]
            if tank.failure[b] == 0:
                todo[count] = b
                count += 1
        while count > 0:
            again, p = none, none
            while p < count:
                q = end_of_block(queue, todo, p, count, lanes)
                gather(tank, block, todo, p, q)
                control.row[0] = queue.row[todo[p]] + level
                run(block.body, block.world, control, block.x, block.v, block.work, block.cache, steps)
                again = finish(tank, queue, block, p, q, level, steps, again)
                p = q
            count, level, steps = again, level + 1, 2 * steps

    return advance


@forces.cached
def make_call(names: tuple[str, ...], make_run):
    """Compile `advance` as a function that Python calls."""
    advance = make_advance(names, make_run)

    @njit
    def call(tank, queue, block, first, last, n):
        advance(tank, queue, block, first, last, n)

    return call


@cache
def with_flows(make_run):
    """The `make_run` of a method that measures energy flows; the same object each time, by which kernels are kept."""
    return partial(make_run, flows=True)


class Engine:
    """The compiled method of a tank, with its working memory."""

    def __init__(self, tank: "Tank"):
        fish, world, b = tank.fish, tank.world, tank.num_fish
        assert tank.integrator.method is not None  # tanks without one use `Integrator.advance`
        self.tank, self.method = tank, tank.integrator.method
        self.names = forces.present(fish.body, world)
        self.compiled = make_call(self.names, with_flows(self.method.make_run) if tank.energy else self.method.make_run)
        own = (fish.body.max_stiffness_eigenvalue, fish.body.max_damping_eigenvalue)
        self.bounds = [sum(rates) for rates in zip(own, *forces.bounds(fish.body, world), strict=True)]
        self.levels, self._rows, self._plans = (1 + DEEPEST if np.isfinite(tank.refine) else 1), {}, []
        self.order, self.row, self._sorted = np.arange(b), np.zeros(b, dtype=np.int64), True
        self.queue = Pack("queue", order=self.order, row=self.row, deepest=self.levels - 1, tolerance=tank.refine,
                          flows=tank.flow)  # fmt: skip
        self.blocks = []
        for i in range(b):
            self.choose_step(i)
        self.blocks = [self.new_block(b, tank.kind) for _ in range(tank._chunks)]

    def new_block(self, fish_count: int, kind: Kind) -> Pack:
        """Memory with which one thread moves blocks of this number of fish: lanes, caches and scratch memory."""
        fish, world, single = self.tank.fish, self.tank.world, kind.dtype == "float32"
        body, n, placed = fish.body, len(fish.body.mass), forces.depend_on_position(self.names)
        constant = forces.constant_system(body, world)
        line = np.array(getattr(fish, "line", np.zeros(n)), dtype=float) if self.tank.energy else None
        return Pack(
            "block", body=packed(body, kind), world=packed(world, kind),
            control=make_control(body, kind, np.unique(fish.fibres), *self._tables(), constant, line),
            x=kind.vectors(n),
            v=kind.vectors(n), work=self.method.make_work(body, kind), cache=forces.make_cache(body, world, kind),
            todo=kind.scratch(fish_count, "int64"), relative=single and not placed,
            reach=(FARTHEST * fish.length) ** 2 if single and placed else np.inf,
        )  # fmt: skip

    def choose_step(self, i: int) -> None:
        """Choose the step coefficients of fish i from its stiffness; fish with the same coefficients share blocks."""
        stiffness, mass = self.tank.variation[i, :2]
        key = stiffness / mass
        if key not in self._rows:
            elastic, viscous = (rate * key for rate in self.bounds)
            rows = [self.method.plan(elastic, viscous, self.tank.dt / 2**level) for level in range(self.levels)]
            same = tuple(row.tobytes() for row in rows)
            if same not in self._rows:
                row = len(self._plans)
                self._plans.extend(rows)
                if self.blocks:
                    plans, costs = self._tables()
                    for block in self.blocks:
                        block.control.set(plans=plans, costs=costs)
                self._rows[same] = row  # last: an interruption leaves only unused rows
            if len(self._rows) > MOST_KEYS:
                self._rows = {name: row for name, row in self._rows.items() if isinstance(name, tuple)}
            self._rows[key] = self._rows[same]
        if self.row[i] != self._rows[key]:
            self._sorted = False
            self.row[i] = self._rows[key]

    def too_stiff(self, row: np.ndarray) -> bool:
        """Return True if even the shortest steps of a fish with these factors (6,) need too many stages."""
        elastic, viscous = (rate * row[STIFFNESS] / row[MASS] for rate in self.bounds)
        return self.method.plan(elastic, viscous, self.tank.dt / 2 ** (self.levels - 1))[STAGES] >= MOST_STAGES

    def _tables(self):
        width = max(len(row) for row in self._plans)
        plans = np.array([np.pad(row, (0, width - len(row))) for row in self._plans])
        return plans, np.array([self.method.costs(row) for row in self._plans], dtype=np.int64)

    def sort(self) -> None:
        """Sort the fish so that those with the same step coefficients are adjacent."""
        if not self._sorted:
            self.order[:] = np.argsort(self.row, kind="stable")
            self._sorted = True

    def advance(self, chunk: int, first: int, last: int, steps: int) -> None:
        """Move a range of the sorted fish by a number of steps, in the memory of one chunk."""
        self.compiled(self.tank.pack, self.queue, self.blocks[chunk], first, last, steps)
