"""Where the time of a step goes: what it computes, against what the processor can do.

    taskset -c 1 python -m benchmarks.speed.limits     results/speed/limits.csv (about 2 min on a quiet machine)

The operations of one step of the default method are counted by running its kernels as Python on numbers that count.
How long a SIMD operation takes at best is measured by loops of nothing else, of eight or more that do not wait for each
other. Arithmetic, division with square roots, and loads and stores go through different units of a processor and may
overlap: the longest of the three is a lower bound, unless operations have to wait for one another.
"""

import argparse
from collections import Counter
from contextlib import contextmanager
from unittest import mock

import numpy as np

from benchmarks.common.tables import write_csv
from benchmarks.common.timing import interleaved
from benchmarks.speed.costs import Glide, swimming, timed
from fish_env import Tank, forces, make_fish
from fish_env._jit import njit
from fish_env.engine import make_block
from fish_env.simd import Kind, Pack, fma, plain, sqrt, zero

COMMAND = "python -m benchmarks.speed.limits"
KINDS = {"one fish, float64": Kind("xyz"), "8 fish, float64": Kind(8), "16 fish, float32": Kind(16, "float32")}
ARITHMETIC = ("add", "multiply", "fma", "compare", "select")
DIVIDER = ("divide", "square root")
LENGTH, OFTEN, ROUNDS, SETS = 96, 2000, 9, 3
counts: Counter = Counter()


class Counted:
    """A number that counts what is done with it."""

    __array_ufunc__ = None

    def __init__(self, value):
        self.value = float(getattr(value, "value", value))

    def __add__(self, other):
        return count("add", self.value + value_of(other))

    def __sub__(self, other):
        return count("add", self.value - value_of(other))

    def __mul__(self, other):
        return other * self if isinstance(other, plain.Vec3) else count("multiply", self.value * value_of(other))

    def __truediv__(self, other):
        return count("divide", self.value / value_of(other))

    def __rtruediv__(self, other):
        return count("divide", value_of(other) / self.value)

    def __rsub__(self, other):
        return count("add", value_of(other) - self.value)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self):
        return Counted(-self.value)

    def __abs__(self):
        return Counted(abs(self.value))

    def __gt__(self, other):
        counts["compare"] += 1
        return self.value > value_of(other)

    def __lt__(self, other):
        counts["compare"] += 1
        return self.value < value_of(other)

    def __ge__(self, other):
        counts["compare"] += 1
        return self.value >= value_of(other)


def count(operation: str, value: float) -> Counted:
    """The result of an operation."""
    counts[operation] += 1
    return Counted(value)


def value_of(number) -> float:
    """The value of a number, counted or not."""
    return getattr(number, "value", number)


def fused(a, b, c):
    """`plain.fma`, counted."""
    if isinstance(b, plain.Vec3) or isinstance(a, plain.Vec3):
        a, b, c = ((*each,) if isinstance(each, plain.Vec3) else (each,) * 3 for each in (a, b, c))
        return plain.Vec3(*(fused(*each) for each in zip(a, b, c, strict=True)))
    return count("fma", value_of(a) * value_of(b) + value_of(c))


def dot(a, b):
    """`plain.dot`, counted."""
    return fused(a.z, b.z, fused(a.y, b.y, a.x * b.x))


def cross(a, b):
    """`plain.cross`, counted."""
    return plain.Vec3(*(fused(p, q, -(r * s)) for p, q, r, s in (
        (a.y, b.z, a.z, b.y), (a.z, b.x, a.x, b.z), (a.x, b.y, a.y, b.x))))  # fmt: skip


def chosen(condition, a, b):
    """`plain.select`, counted."""
    if isinstance(a, plain.Vec3):
        return plain.Vec3(*(chosen(condition, *each) for each in zip(a, b, strict=True)))
    return count("select", value_of(a if condition else b))


def load(row, lanes):
    """`plain.read`, counted."""
    counts["load"] += 1
    return Counted(row[0])


def store(memory, place, number, lanes):
    """`plain.write`, counted."""
    counts["store"] += 1
    memory[place] = value_of(number)


@contextmanager
def counting():
    """Kernels that run as Python count what they do."""
    counts.clear()
    root = dict(sqrt=lambda a: count("square root", value_of(a) ** 0.5))
    with mock.patch.multiple(plain, fma=fused, dot=dot, cross=cross, select=chosen, read=load, write=store, **root):
        yield counts


def operations(steps: int) -> Counter:
    """What one of so many steps of the default method does with numbers, coordinate by coordinate."""
    tank = Tank(make_fish(), 1, lanes=1)
    fish, world, method = tank.fish, tank.fish.water, tank.integrator.method
    plans = np.array([method.plan(fish.body.max_stiffness_eigenvalue, fish.body.max_damping_eigenvalue, tank.dt)])
    costs = np.array([method.costs(plans[0])])
    block = make_block(1, fish.body, world, Kind(1), np.unique(fish.fibres), plans, costs, method)
    swum = swimming(fish, 1)
    block.x.memory[:], block.v.memory[:] = swum.position[0], swum.velocity[0]
    block.control.rest_length.memory[:, 0] = swum.control.rest_length[0]
    block.control.start.memory[:, 0] = swum.control.rest_length[0, block.control.driven]
    run = method.make_run(forces.present(fish.body, world))
    with counting() as found:
        run(block.body, block.world, block.control, block.x, block.v, block.work, block.cache, steps)
    return Counter({name: number / steps for name, number in found.items()})


@njit
def arithmetic(p, n):
    """Twelve fused multiply-adds that do not wait for one another, n times."""
    x, b, c = p.x, p.b[0], p.c[0]
    q, r, s, t, u, v = x[0], x[1], x[2], x[3], x[4], x[5]
    d, e, f, g, h, i = x[6], x[7], x[8], x[9], x[10], x[11]
    for _ in range(n):
        q, r, s, t = fma(q, b, c), fma(r, b, c), fma(s, b, c), fma(t, b, c)
        u, v, d, e = fma(u, b, c), fma(v, b, c), fma(d, b, c), fma(e, b, c)
        f, g, h, i = fma(f, b, c), fma(g, b, c), fma(h, b, c), fma(i, b, c)
    x[0] = q + r + s + t + u + v + d + e + f + g + h + i


@njit
def divisions(p, n):
    """Four divisions and four square roots that do not wait for one another, n times."""
    x, b = p.x, p.b[0]
    q, r, s, t = x[0], x[1], x[2], x[3]
    u, v, d, e = x[4], x[5], x[6], x[7]
    for _ in range(n):
        q, r, s, t = b / q, b / r, b / s, b / t
        u, v, d, e = sqrt(u), sqrt(v), sqrt(d), sqrt(e)
    x[0] = q + r + s + t + u + v + d + e


@njit
def copies(p, n):
    """A load and a store, of as many numbers as a fish has coordinates and more, n times."""
    x, y = p.x, p.y
    for k in range(n):
        for i in range(x.size):
            y[i] = x[i]
        x[0] = y[k % 2] + zero(x)


LOOPS = {"arithmetic": (arithmetic, 12), "division": (divisions, 8), "memory": (copies, LENGTH)}


def best_times(kind: Kind) -> dict[str, float]:
    """Ns that one operation of each loop takes on a number of this kind."""
    kind = Kind(4) if kind.lanes == "xyz" else kind  # a vector's register
    pack = Pack("limits", x=kind.numbers(LENGTH), y=kind.numbers(LENGTH), b=kind.numbers(1), c=kind.numbers(1))

    def prepare():
        pack.x.memory[:], pack.b.memory[:], pack.c.memory[:] = 1.5, 0.999, 0.001

    runs = [(prepare, lambda loop=loop: loop(pack, OFTEN), OFTEN * number) for loop, number in LOOPS.values()]
    return {name: 1e3 * cost.time[1] for name, cost in zip(LOOPS, interleaved(runs, ROUNDS), strict=True)}


def bounds(kind: Kind, found: Counter, best: dict[str, float]) -> dict[str, float]:
    """Ns that a step takes at least, by each of the processor's units. One register holds a vector of one fish."""
    part = 1.0 / 3.0 if kind.lanes == "xyz" else 1.0  # nearly all arithmetic is that of vectors
    return {
        "arithmetic": part * sum(found[name] for name in ARITHMETIC) * best["arithmetic"],
        "division": sum(found[name] for name in DIVIDER) * best["division"],
        "memory": part * max(found["load"], found["store"]) * best["memory"],
    }


def measured(kind: Kind) -> float:
    """Ns that a step of a block of fish of this kind takes, median of several tanks."""
    fish = make_fish()
    options = {"lanes": kind.lanes, "dtype": kind.dtype, "refine": np.inf}
    found = [timed([Glide(swimming(fish, kind.width, **options))], ROUNDS)[0].time[1] for _ in range(SETS)]
    return 1e3 * float(np.median(found)) * kind.width


def main() -> None:
    """Count, measure, print and write."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    found, rows = operations(20), []
    print("one step:", ", ".join(f"{name} {number:.0f}" for name, number in found.most_common()))
    for name, kind in KINDS.items():
        best, taken = best_times(kind), measured(kind)
        least = bounds(kind, found, best)
        row = {"kind": name} | {f"{key}_count": round(found[key]) for key in (*ARITHMETIC, *DIVIDER, "load", "store")}
        row |= {f"{key}_ns": f"{value:.3g}" for key, value in best.items()}
        row |= {f"least_by_{key}_ns": f"{value:.0f}" for key, value in least.items()}
        rows.append(row | {"step_ns": f"{taken:.0f}", "over_longest": f"{taken / max(least.values()):.2f}"})
        print(f"{name:20s} {taken:6.0f} ns a step; at least", ", ".join(f"{k} {v:.0f}" for k, v in least.items()))
    print(f"written to {write_csv('speed/limits.csv', rows, COMMAND)}")


if __name__ == "__main__":
    main()
