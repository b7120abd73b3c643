"""What the tests share: lists of methods, forces in kernels of any kind, tanks of any body in any state."""

from dataclasses import replace
from functools import cache

import naive
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fish_env import BODIES, INTEGRATORS, Tank, make_fish
from fish_env.bodies.masses import Moments
from fish_env.kernels.compile import njit
from fish_env.kernels.simd import Kind, Pack, Vectors, packed, zero
from fish_env.physics import forces
from fish_env.physics.fish import ElasticObject, Fish
from fish_env.physics.forces.control import NOMINAL, make_control
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.forces.plan import FACTOR, INNER, LEAST, LOWEST, POLYNOMIAL, STAGES, H
from fish_env.physics.lazy import Lazy
from fish_env.physics.records import Body, World
from fish_env.physics.world import VACUUM

FISH = {name: make_fish(name) for name in naive.TU}
KINDS = ("explicit", "semi-implicit", "linearly implicit", "stabilised", "adaptive")
EXPLICIT, SEMI_IMPLICIT, LINEARLY_IMPLICIT, STABILISED, ADAPTIVE = (
    [name for name, record in INTEGRATORS.items() if record.kind == kind] for kind in KINDS
)
SOLVING = SEMI_IMPLICIT + LINEARLY_IMPLICIT
FIXED_STEP = EXPLICIT + SOLVING + STABILISED
MATRIX = {
    "linearly_implicit": {},
    "linearly_implicit_projected": {"projected": True},
    "linearly_implicit_water": {"wet": True},
    "rosenbrock": {},
}
"""What `naive.implicit_matrices` is told for each linearly implicit method."""
FINER = {
    "explicit_euler": 16,
    "linearly_implicit": 16,
    "linearly_implicit_projected": 16,
    "linearly_implicit_water": 16,
    "leapfrog_chebyshev": 4,
}
"""By how much steps are shortened for a method, so that its error is in the straight part of its slope."""
REPRESENTATIVE = ("leapfrog_chebyshev", "semi_implicit", "rk4", "rosenbrock", "dop853")
"""One method of each family of kernels. The others differ from one of them by numbers of a table, take as long to
compile again, and are tried by `pytest -m slow`; every run tries each of them without the compiler (`kernels` in
conftest.py)."""
SOFT = {
    *LINEARLY_IMPLICIT, *ADAPTIVE, *(name for name, record in BODIES.items() if isinstance(record.make, Lazy)),
    *("two layers", "rings", "compartment", "block", "linear block", "green block"),
}  # fmt: skip
"""Methods and bodies of `fish_env.soft`."""


def marks_of(values, quick=True):
    """Marks of a parameter: slow, unless it is quick; soft, if one of its values names what is soft."""
    soft = any(isinstance(value, str) and value in SOFT for value in values)
    return [pytest.mark.soft] * soft + [pytest.mark.slow] * (not quick)


def tiered(names, quick=REPRESENTATIVE):
    """Parameters of a test, methods for example: those not among the quick ones marked as slow, and soft ones as that.

    `quick` may be "all".
    """
    return [pytest.param(name, marks=marks_of((name,), quick == "all" or name in quick)) for name in names]


def rows(table, quick="all"):
    """The same for parameters of several arguments each, rows of a table."""
    return [pytest.param(*row, marks=marks_of(row, quick == "all" or row in quick)) for row in table]


each_body = pytest.mark.parametrize("body", naive.TU)
each_method = pytest.mark.parametrize("name", tiered(INTEGRATORS))
each_fixed = pytest.mark.parametrize("name", tiered(FIXED_STEP))
every_method = pytest.mark.parametrize("name", tiered(INTEGRATORS, "all"))
every_fixed = pytest.mark.parametrize("name", tiered(FIXED_STEP, "all"))


THIN = VACUUM._replace(quadratic=1e-300)
"""Water that moves no bit: tests in it share the kernels of tests in water. Methods differ in a real vacuum only where
`vacuum_for` gives it."""


def vacuum_for(name):
    """Vacuum for a method that leaves something out where no force decays velocities, `THIN` for the others."""
    return VACUUM if name in STABILISED else THIN


def without_walls(name, world):
    """The same world, without walls for a method that cannot serve them."""
    return world._replace(planes=None) if name in ADAPTIVE else world


def driven(thing, h):
    """The thing, or an object of the body, with a muscle for every spring and steps of h s; a fish stays a fish."""
    if isinstance(thing, Body):
        thing = ElasticObject(name="driven", body=thing, length=1.0, time_step=h, control_interval=h)
    count = thing.body.springs.stiffness.size
    changes = {"muscles": np.arange(count), "contracted": np.full(count, 0.5), "fibres": None, "drives": None}
    if isinstance(thing, Fish):  # the kernels of all fish have the same types
        landmarks = thing.landmarks._replace(muscles=np.zeros((count, 2), dtype=np.int64))
        changes |= {"sides": np.ones(count, int), "segments": np.zeros(count, int), "landmarks": landmarks}
    return replace(thing, time_step=h, control_interval=h, **changes)


def tank_of(name, thing, world, x, v, h, rest=None, rate=None, **options):
    """A tank of bodies at x with velocities v, (N,3) or (B,N,3), that the method of this name moves by steps of h s.

    Args:
        name: a key of INTEGRATORS.
        thing: a `Body`, or an elastic object that has one.
        world: what surrounds it.
        x: positions, m.
        v: velocities, m/s.
        h: step, s.
        rest: rest lengths (E,) or (B,E), m; None leaves the natural ones.
        rate: how fast they move in the first call, m/s; None holds them.
        options: of `Tank`.
    """
    x, v = np.array(x, ndmin=3), np.array(v, ndmin=3)
    tank = Tank(driven(thing, h), len(x), name, h, water=world, **{"threads": 1, "refine": np.inf, **options})
    tank.position[:], tank.velocity[:] = x, v
    if rest is not None:
        tank.rest_length[:] = rest
    if rate is not None:
        tank.control.rate[:] = rate
    return tank


def advance(name, thing, world, x, v, rest, rate, h, n):
    """Where one body is after n steps in a call, which it must survive: (x, v)."""
    tank = tank_of(name, thing, world, x, v, h, rest, rate)
    tank.advance(n)
    assert tank.alive[0], tank.failure[0]
    return tank.position[0], tank.velocity[0]


def assert_moved(start, moved, wanted, of_way, of_velocity):
    """Check the ends (x, v) of a motion from `start`: displacements and velocities, each to an absolute error."""
    np.testing.assert_allclose(moved[0] - start, wanted[0] - start, rtol=0, atol=of_way)
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=of_velocity)


def run_into_failure(tank, n, calls=200):
    """Advance one body until it fails: it must be left, with its clock, as it was before the last call."""
    for _ in range(calls):
        before = [array.copy() for array in tank.state[:3]]
        tank.advance(n)
        if not tank.alive[0]:
            for now, then in zip(tank.state[:3], before, strict=True):
                np.testing.assert_array_equal(now, then)
            assert np.isfinite(tank.position).all() and np.isfinite(tank.velocity).all()
            tank.advance(n)  # a failed body stays where it is
            np.testing.assert_array_equal(tank.position, before[0])
            assert tank.time[0] == before[2][0]
            return tank.state.failure[0]
    raise AssertionError(f"still valid after {calls} calls")


def world_of(fish, current=(0.3, -0.2, 0.1)):
    """The water of `naive.dense_water` as the kernels take it."""
    return World(*naive.dense_water(fish, current=current))


def random_motion(fish, rng):
    """A random state, with muscles and, a little, all other rest lengths on the move: x, v, rest lengths, rates."""
    x, v = naive.random_state(fish, rng, speed=0.2)
    natural = fish.body.springs.rest_length
    rest = natural * rng.uniform(0.9, 1.1, natural.size)
    rate = natural * rng.uniform(-0.3, 0.3, natural.size) / fish.contraction_time
    return x, v, rest, rate


def slope_of(errors, steps):
    """Measured order: slope of log error over log step."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def exact(body, world, x, v, rest, rate, duration):
    """The reference solution (x, v) by an eighth-order method with its own error control, on the kernels' forces.

    Also returns which faces moved outward: one row for every pattern met on the way.
    """
    evaluator, size, outward = Evaluator(body, world), x.size, set()

    def slope(t, y):
        positions, velocities = y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)
        p, q, r, s = np.moveaxis(positions[body.faces.nodes], 1, 0)
        through = np.einsum("fc,fck->fk", body.faces.share, velocities[body.faces.nodes]) - world.current
        outward.add(tuple(np.einsum("fk,fk->f", np.cross(r - p, s - q), through) > 0))
        f = evaluator.force(rest + t * rate, positions, velocities, t)
        return np.concatenate([y[size:], (f / body.mass[:, None]).ravel()])

    y0 = np.concatenate([x.ravel(), v.ravel()])
    y = solve_ivp(slope, (0.0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-15 * np.abs(y0).max()).y[:, -1]
    return (y[:size].reshape(-1, 3), y[size:].reshape(-1, 3)), outward


@cache
def scene(body, medium):
    """A smooth motion to measure orders on (body, world, x, v, rest lengths, rates, duration), and where it ends.

    In vacuum: a shaken, turned fish, all of whose vibrations matter. In water: a nearly straight one in a slanting
    current that no face overtakes, for the one-sided law is smooth only where no face turns. Stiff: driven from rest.
    """
    fish = FISH[body]
    rng = np.random.default_rng(1)
    x, v, rest, world = fish.body.position, np.zeros((23, 3)), fish.body.springs.rest_length, VACUUM
    rate, duration = np.zeros_like(rest), 8.0 / naive.highest_frequency(fish.body)
    rate[fish.muscles] = rest[fish.muscles] * (1 - fish.contracted) * rng.uniform(-1, 0, 12) / fish.contraction_time
    if medium == "vacuum":
        x, v = naive.random_state(fish, rng, displacement=0.005, speed=0.3)
    elif medium == "water":
        linear, quadratic, current = naive.dense_water(fish, current=(0.7, 1.0, 1.0))
        world = VACUUM._replace(linear=linear, quadratic=0.01 * quadratic, current=current)
        rate *= 0.2
        v = 0.02 * fish.length / fish.contraction_time * rng.uniform(-1, 1, (23, 3))
    elif medium == "stiff":
        duration *= 2
    start_of_it = (fish.body, world, x, v, rest, rate, duration)
    end, outward = exact(*start_of_it)
    if medium == "water":
        assert len(outward) == 1, "a face turned between outward and inward: the scene is not smooth"
    return start_of_it[1:], end


# Forces in kernels of any kind

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
        acting = forces.present(body, world)  # which also loads them
        self.names = acting if names is None else names
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
        matrix, order = np.zeros((3 * n, 3 * n)), (3 * shape.row[:, None] + np.arange(3)).ravel()
        for i in range(n):
            for j in range(shape.first[i], i + 1):
                matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = a[shape.start[i] + j - shape.first[i]]
        return (np.tril(matrix) + np.tril(matrix, -1).T)[np.ix_(order, order)]

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


def close(actual, wanted, tolerance=1e-12):
    """Equal up to `tolerance` times the largest element."""
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())


def moments(mass, position):
    """The moments of node masses (N,) kg at positions (N,3) m."""
    centre = mass @ position / mass.sum()
    return Moments(float(mass.sum()), float(centre[0]), mass @ (position - centre) ** 2)


def inertia(found):
    """Roll, pitch and yaw inertia about the centre, (3,) kg m2, of `Moments`."""
    return found.squares.sum() - found.squares
