"""Vector notation for kernels: one source for one fish and for a block of them, float64 and float32.

A kernel is written with `r = x[j] - x[i]`, `dot(r, u)`, `select(outward > 0.0, push, 0.0)`; the element type of `x`
determines the compiled code. `Kind` makes such arrays, `Pack` passes them to kernels.
"""

from fish_env.kernels.simd import products  # noqa: F401  (tells numba how to compile them)
from fish_env.kernels.simd.arrays import block_size, directions, epsilon, floats, nowhere, zero
from fish_env.kernels.simd.functions import all_lanes, any_lane, cross, dot, exp, fma, lane, log, select, sqrt, vec3
from fish_env.kernels.simd.kinds import LANES, Kind, Numbers, Scratch, Vectors
from fish_env.kernels.simd.packs import Pack, field, pack_at, packed

__all__ = [
    "LANES", "Kind", "Numbers", "Pack", "Scratch", "Vectors", "all_lanes", "any_lane", "block_size",
    "cross", "directions", "dot", "epsilon", "exp", "field", "floats", "fma", "lane", "log", "nowhere", "pack_at",
    "packed", "select", "sqrt", "vec3", "zero",
]  # fmt: skip
