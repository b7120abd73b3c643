"""Elastic objects: a string, a ring and spheres of two layers filled with gas (Song 2009, ch. 3 and 4). SI units.

OBJECTS lists them, and the solids of finite elements of `solids.py`.

Every object is built at rest: its springs pull just as hard as its gas presses.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fish_env.checks import fits_memory, positive_array, representable
from fish_env.physics.body import fix, make_body
from fish_env.soft import solids
from fish_env.soft.layers import NO_FACES, TwoLayers, choose_materials, one_layer, two_layers
from fish_env.soft.room import GRAVITY, InRoom, room, whole
from fish_env.soft.skins import Skin, circle, even_factors, globe, octasphere

__all__ = ["GLOBE", "GRAVITY", "OBJECTS", "RING", "SOLIDS", "SONG", "SPHERE", "Layered", "make_ring", "make_sphere",
           "make_string", "make_uniform_sphere", "room"]  # fmt: skip
FINEST = 3  # level of a uniform sphere: 516 nodes; the gas joins every node to every other


class Layered(InRoom):
    """An elastic object of two layers, or of one and no inner one. The free nodes of a string are its outer layer.

    Its kinds of springs are "outer", "inner" (structural), "radius", "shear left" and "shear right".
    """


RING = TwoLayers(
    nodes=12, mass=0.24, inner_mass=0.12, stiffness=200.0, inner_stiffness=150.0, radius_stiffness=150.0,
    shear_stiffness=40.0, pressure=45.0, gap_pressure=30.0, barrier_energy=0.5,
)  # fmt: skip
SPHERE = TwoLayers(
    nodes=66, mass=0.3, inner_mass=0.15, stiffness=75.0, inner_stiffness=50.0, radius_stiffness=40.0,
    shear_stiffness=10.0, pressure=600.0, gap_pressure=400.0, barrier_energy=0.05,
)  # fmt: skip
GLOBE = replace(
    SPHERE, nodes=86, stiffness=150.0, inner_stiffness=100.0, barrier_energy=0.3,  # few springs carry the pressure
)  # fmt: skip


@representable("the string")
def make_string(nodes=2, *, length=0.2, mass=0.05, stiffness=8.0, relaxation_time=0.002, fixed=(0,)) -> Layered:
    """A string along x from the origin, that moves along x only (ch. 3.3).

    Args:
        nodes: at least 2.
        length: at rest, m.
        mass: kg, of all but one node, which are equal, or (nodes,) one each.
        stiffness: of the whole string, N/m.
        relaxation_time: damping over stiffness, s.
        fixed: numbers of the nodes that do not move, or a boolean mask (nodes,); none for ().

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    nodes = whole(nodes, "nodes", 2)
    fits_memory(nodes, 1000, "nodes")
    for name, value in (("length", length), ("stiffness", stiffness)):
        positive_array(value, (), name)
    mass = positive_array(mass, (nodes,) if np.ndim(mass) else (), "mass (kg)")
    positive_array(relaxation_time, (), "relaxation_time (s)", zero=True)
    count = nodes - 1
    position = np.zeros((nodes, 3))
    position[:, 0] = np.linspace(0.0, length, nodes)
    pairs = np.stack([np.arange(count), np.arange(1, nodes)], axis=1)
    constant = np.full(count, float(stiffness) * count)
    each = mass if mass.ndim else np.full(nodes, mass / count)
    body = make_body(position, each, pairs, constant, constant * relaxation_time,
                     np.full(count, length / count), NO_FACES)  # fmt: skip
    body = fix(fix(body, np.arange(nodes), "yz"), fixed if np.size(fixed) else np.zeros(0, np.int64))
    down = np.array([1.0, 0.0, 0.0])
    return Layered(
        name="string", body=body, length=length, water=room(down, 1.2 * length), time_step=1 / 960,
        control_interval=1 / 60, down=down, outer=np.flatnonzero(body.inverse_mass[:, 0]), inner=np.zeros(0, np.int64),
        skin=np.zeros((0, 2), np.int64), kinds={"outer": slice(0, count)},
    )  # fmt: skip


@representable("the ring")
def make_ring(nodes=12, layers=2, **materials) -> Layered:
    """A ring of two layers in the xy plane: n nodes each, gas inside and between them (ch. 3.4).

    Args:
        nodes: of a layer, at least 3.
        layers: 2, or 1 for the outer layer alone, filled with gas at `pressure`.
        materials: fields of `TwoLayers`; those not given are those of RING.

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    nodes = whole(nodes, "nodes", 3)
    fits_memory(nodes, 64 * nodes, "nodes")  # the gas joins every node to every other
    return layered_object("ring", circle(nodes), layers, RING, materials, (0.0, -1.0, 0.0))


@representable("the sphere")
def make_sphere(slices=12, stacks=8, layers=2, **materials) -> Layered:
    """A sphere of two layers between circles of latitude, whose faces are smaller near the poles (ch. 3.5.1).

    Args:
        slices: around, at least 3.
        stacks: from pole to pole, at least 2.
        layers: as of `make_ring`.
        materials: fields of `TwoLayers`; those not given are those of GLOBE.

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    slices, stacks = whole(slices, "slices", 3), whole(stacks, "stacks", 2)
    fits_memory(slices * stacks, 64 * slices * stacks, "slices times stacks")
    thing = layered_object("sphere", globe(slices, stacks), layers, GLOBE, materials, (0.0, 0.0, -1.0))
    return replace(thing, time_step=1 / 3840)  # light nodes near the poles


@representable("the sphere")
def make_uniform_sphere(level=2, correction=True, layers=2, **materials) -> Layered:
    """A sphere of two layers of triangles of nearly one size: an octahedron divided `level` times (ch. 3.5.2).

    Args:
        level: 0 to 3.
        correction: whether springs are as stiff as their places need, so that the ball stays round under any pressure
            (`skins.even_factors`).
        layers: 2, or 1 for the outer layer alone, filled with gas at `pressure`.
        materials: fields of `TwoLayers`; those not given are those of SPHERE.

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    skin = octasphere(whole(level, "level", 0, FINEST))
    factor = even_factors(skin) if correction else np.ones(len(skin.edges))
    return layered_object("uniform sphere", skin, layers, SPHERE, materials, (0.0, 0.0, -1.0), factor)


def layered_object(
    name, skin: Skin, layers, standard: TwoLayers, materials: dict, down, factor: float | np.ndarray = 1.0
) -> Layered:
    """The object of a skin, of one layer or two, in a room three radii from its middle to the walls."""
    layers = whole(layers, "layers", 1, 2)
    chosen = choose_materials(standard, materials, layers)
    body, kinds, skin = (one_layer if layers == 1 else two_layers)(skin, chosen, factor)
    n = len(skin.place)
    if skin.faces.shape[1] == 2:
        body = fix(body, np.arange(len(body.mass)), "z")
    return Layered(
        name=name, body=body, length=2.0 * chosen.radius, water=room(down, 3.0 * chosen.radius), time_step=1 / 1920,
        control_interval=1 / 60, down=np.array(down), outer=np.arange(n), inner=np.arange(n, layers * n),
        skin=skin.faces, kinds=kinds,
    )  # fmt: skip


@dataclass(frozen=True)
class ObjectKind:
    """A way to build an elastic object."""

    name: str
    description: str
    make: Callable[..., InRoom]


SONG: dict[str, ObjectKind] = {
    record.name: record
    for record in (
        ObjectKind("string", "a line fixed at one end, moving along itself", make_string),
        ObjectKind("ring", "two circles joined by springs, gas inside and between, in the plane", make_ring),
        ObjectKind("sphere", "two spheres of circles of latitude, closed by triangles", make_sphere),
        ObjectKind("uniform sphere", "two spheres of triangles of nearly one size", make_uniform_sphere),
    )
}
"""Song's objects, of springs and gas."""
SOLIDS: dict[str, ObjectKind] = {
    record.name: record
    for record in (
        ObjectKind("beam", "a square beam of tetrahedra", solids.make_beam),
        ObjectKind("block", "a cube of tetrahedra", solids.make_block),
        ObjectKind("ball", "a ball of tetrahedra", solids.make_ball),
        ObjectKind("two materials", "a bar of tetrahedra, one half ten times as stiff", solids.make_two_materials),
    )
}
"""Solids of finite elements."""
OBJECTS: dict[str, ObjectKind] = {**SONG, **SOLIDS}
