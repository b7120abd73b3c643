"""Ideal gas at constant temperature in closed compartments (Song 2009, ch. 4.5).

The pressure is n R T over the volume. Its force is the pressure times the gradient of the volume, which is minus
the gradient of the gas' energy. It is exact for surfaces of triangles, of bilinear patches, and for flat rings of
edges. Gas without a volume exerts no force, and `failed` reports it.

Legend: c compartment; i node; slope gradient of the volume of c, at c N + i.
"""

import numpy as np

from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack, dot, fma, log, nowhere, select, sqrt, zero
from fish_env.physics.failures import ESCAPED
from fish_env.physics.forces.plan import FACTOR, H
from fish_env.physics.records import Body, World
from fish_env.soft.volume import add_volume, curvature_of, volume_of

FAILURE = ESCAPED
ANYWHERE = True


def present(body: Body, world: World) -> bool:
    """Return True if the body has gas compartments."""
    return body.compartments is not None


def make_cache(body: Body, world: World, kind) -> Pack:
    """Data of `add_tangent`: volume gradients (C N,) times the root of nRT / V^2, and its weight (1,), s2."""
    assert body.compartments is not None  # else the force is not present
    return Pack("pressure", slope=kind.vectors(len(body.compartments.gas) * len(body.mass)), weight=kind.scratch(1))


def rest_matrices(body: Body, elastic):
    """Stiffness of the gas at rest, N/m, for each compartment; it has no damping."""
    # That of compression joins all nodes (1,N), by a matrix (1,3N,3N); that of the pressure, whose direction turns with
    # the faces, the nodes of each.
    if body.compartments is None or not elastic:
        return
    first = body.compartments.first
    for c, (gas, ambient) in enumerate(zip(body.compartments.gas, body.compartments.ambient, strict=True)):
        faces = body.compartments.faces[first[c] : first[c + 1]]
        volume, slope = volume_of(faces, body.position)
        yield np.arange(len(slope))[None], (gas / volume**2 * np.outer(slope, slope))[None]
        nodes, curvature = curvature_of(faces, body.position)
        yield nodes, (ambient - gas / volume) * curvature


@kernel
def volume(body, c, x, slope):
    """Return the volume of compartment c, and write its gradient to slope."""
    compartments, count = body.compartments, x.size
    for i in range(count):
        slope[INDEX(c * count + i)] = zero(slope)
    return add_volume(compartments.faces, compartments.first[c], compartments.first[c + 1], x, slope, c * count)


@kernel
def push(body, c, space):
    """Gauge pressure in compartment c, and 1 / V; both zero without a volume."""
    inverse = select(space > 0.0, 1.0 / space, 0.0)
    outside = select(space > 0.0, body.compartments.ambient[c] + 0.0 * space, 0.0)
    return fma(body.compartments.gas[c], inverse, -outside), inverse  # (78)


@kernel
def add_force(body, world, control, x, v, f, cache):
    """Add the force of the gas on the walls of its compartments."""
    count, slope, factor = x.size, cache.slope, control.stiffness[0]
    for c in range(body.compartments.gas.size):
        pressure = factor * push(body, c, volume(body, c, x, slope))[0]
        for i in range(count):
            f[i] = fma(pressure, slope[INDEX(c * count + i)], f[i])


@kernel
def add_force_cached(body, world, control, x, v, f, cache):
    """Add the force of the gas, and store the data of `add_tangent` for a filtered step."""
    count, slope, factor, root = x.size, cache.slope, control.stiffness[0], sqrt(control.stiffness[0])
    step = control.plans[control.row[0], H]
    cache.weight[0] = control.plans[control.row[0], FACTOR] * step * step
    for c in range(body.compartments.gas.size):
        pressure, inverse = push(body, c, volume(body, c, x, slope))
        pressure, stiff = factor * pressure, root * sqrt(body.compartments.gas[c]) * inverse
        for i in range(count):
            place = INDEX(c * count + i)
            g = slope[place]
            f[i] = fma(pressure, g, f[i])
            slope[place] = stiff * g


@kernel
def add_tangent(body, world, control, x, y, f, cache):
    """Add the restoring force of displacements y by the gas' compression, if `add_force_cached` stored its data."""
    count, slope, weight = x.size, cache.slope, cache.weight[0]
    if weight == 0.0:
        return
    for c in range(body.compartments.gas.size):
        change = zero(control.stiffness)
        for i in range(count):
            change += dot(slope[INDEX(c * count + i)], y[i])
        change *= -weight
        for i in range(count):
            f[i] = fma(change, slope[INDEX(c * count + i)], f[i])  # (79)


@kernel
def energy(body, world, control, x, v, f, cache):
    """Energy of the gas and of the displaced surroundings, J, relative to compartments of one cubic metre."""
    total = zero(control.stiffness)
    for c in range(body.compartments.gas.size):
        space = volume(body, c, x, cache.slope)
        total += fma(body.compartments.ambient[c], space, -body.compartments.gas[c] * log(space))
    return control.stiffness[0] * total


@kernel
def failed(body, world, control, x, v, f, cache):
    """Mask of the fish in which a compartment has no positive volume."""
    empty = nowhere(x)
    for c in range(body.compartments.gas.size):
        empty = empty | (volume(body, c, x, cache.slope) <= 0.0)
    return empty
