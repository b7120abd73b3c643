"""Elastic objects of finite elements: a beam, a block, a ball and a bar of two materials, of tetrahedra. SI units.

They complement Song's objects of springs and gas, in rooms of the same kind, with the same walls, gravity and drag
spring. There is no plasticity: what is not torn returns to its shape.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from fish_env.checks import check_names, positive_array, representable
from fish_env.physics.body import fix, make_body
from fish_env.soft.elements import make_tets
from fish_env.soft.mesh import Mesh, grid, lumped_mass
from fish_env.soft.room import InRoom, room, whole

DOWN = np.array([0.0, 0.0, -1.0])
SPACIOUS = 1.5  # from the middle of an object to the walls, over its longest side
MOST_NODES = 50_000  # more take minutes to build
STEP, FRAME = 1 / 1920, 1 / 60  # s


@dataclass(frozen=True)
class SolidMaterial:
    """An isotropic, viscoelastic material."""

    young: float = 2e4
    """Young's modulus, Pa."""
    poisson: float = 0.3
    """Poisson's ratio, above -1 and below 0.5."""
    density: float = 500.0
    """kg/m3."""
    relaxation_time: float = 0.004
    """Damping over stiffness, s."""


SOFT = SolidMaterial()
STIFF = replace(SOFT, young=2e5, density=1000.0)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Solid(InRoom):
    """An elastic object of tetrahedra."""

    material: np.ndarray
    """(T,) which of its materials each tetrahedron is of, from 0 on."""


@representable("the beam")
def make_beam(cells=10, *, across=2, length=0.4, thickness=0.08, clamped=False, strain="corotational",
              lumping="quarter", **material) -> Solid:  # fmt: skip
    """A beam along x with a square cross-section.

    Args:
        cells: along it, at least 1.
        across: cells across and upward, an even number, at least 2.
        length: m.
        thickness: m.
        clamped: whether the end at the smallest x is fixed, by elimination.
        strain: the measure of strain (`make_tets`).
        lumping: how the mass is shared among the nodes (`lumped_mass`).
        material: fields of `SolidMaterial`; those not given are those of SOFT.

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    mesh = bar(cells, across, length, thickness)
    return solid("beam", mesh, (choose_material(SOFT, material),), strain, lumping, clamped)


@representable("the block")
def make_block(cells=4, *, side=0.16, strain="corotational", lumping="quarter", **material) -> Solid:
    """A cube of so many cells along each edge, an even number; `side` m, all else as of `make_beam`."""
    return solid("block", bar(cells, cells, side, side), (choose_material(SOFT, material),), strain, lumping)


@representable("the ball")
def make_ball(cells=4, *, radius=0.1, strain="corotational", lumping="quarter", **material) -> Solid:
    """A ball: a cube's grid of so many cells along each edge, an even number, each of its shells made a sphere.

    Args:
        cells: along each edge, even, at least 2.
        radius: m.
        strain: the measure of strain (`make_tets`).
        lumping: how the mass is shared among the nodes (`lumped_mass`).
        material: fields of `SolidMaterial`; those not given are those of SOFT.

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    positive_array(radius, (), "radius (m)")
    mesh = bar(cells, cells, 2.0, 2.0)
    x, y, z = mesh.position.T
    round_ = np.stack([
        x * np.sqrt(1 - y**2 / 2 - z**2 / 2 + y**2 * z**2 / 3),
        y * np.sqrt(1 - z**2 / 2 - x**2 / 2 + z**2 * x**2 / 3),
        z * np.sqrt(1 - x**2 / 2 - y**2 / 2 + x**2 * y**2 / 3),
    ], axis=1)  # fmt: skip
    thing = solid("ball", mesh._replace(position=radius * round_), (choose_material(SOFT, material),), strain, lumping)
    return replace(thing, time_step=0.5 * STEP)  # elements at the cube's edges are flat, and stiff for their mass


@representable("the bar of two materials")
def make_two_materials(cells=8, *, across=2, length=0.32, thickness=0.08, soft=SOFT, stiff=STIFF,
                       strain="corotational", lumping="quarter") -> Solid:  # fmt: skip
    """A bar along x of two materials: `soft` where x is negative, `stiff` where it is positive.

    Args:
        cells: along it, an even number, at least 2: as many of each material.
        across: cells across and upward, an even number.
        length: m.
        thickness: m.
        soft: a `SolidMaterial`.
        stiff: a `SolidMaterial`.
        strain: the measure of strain (`make_tets`).
        lumping: how the mass is shared among the nodes (`lumped_mass`).

    Raises:
        ValueError: naming the argument, its value, and what is allowed.
    """
    if whole(cells, "cells", 2) % 2:
        raise ValueError(f"cells is {cells}; give an even number, half of them for each material")
    for name, material in (("soft", soft), ("stiff", stiff)):
        if not isinstance(material, SolidMaterial):
            raise ValueError(f"{name} is a {type(material).__name__}; give a SolidMaterial")
    return solid("two materials", bar(cells, across, length, thickness), (soft, stiff), strain, lumping)


def choose_material(standard: SolidMaterial, given: dict) -> SolidMaterial:
    """Change some fields of a material; ValueError for an unknown one."""
    check_names("a material has no field", [field.name for field in fields(SolidMaterial)], *given)
    return replace(standard, **given)


def bar(cells, across, length, thickness) -> Mesh:
    """A bar of so many cells along x, its middle at the origin."""
    along, across = whole(cells, "cells", 1), whole(across, "across", 2)
    if (along + 1) * (across + 1) ** 2 > MOST_NODES:
        raise ValueError(f"{along} x {across} x {across} cells have more than {MOST_NODES} nodes; give fewer cells")
    length, thickness = (float(positive_array(value, (), f"{name} (m)"))
                         for name, value in (("length", length), ("thickness", thickness)))  # fmt: skip
    half = np.full(along + 1, 0.5 * thickness)
    return grid(np.linspace(-0.5 * length, 0.5 * length, along + 1), half, half, across, across)


def solid(name: str, mesh: Mesh, materials: tuple[SolidMaterial, ...], strain, lumping, clamped=False) -> Solid:
    """The object of a mesh in its room; of two materials the second is where x is positive."""
    middle = mesh.position[mesh.tets, 0].mean(axis=1)
    which = (middle > 0.0).astype(np.int64) if len(materials) > 1 else np.zeros(len(mesh.tets), np.int64)
    young, poisson, density, relaxation = (
        np.array([getattr(material, field.name) for material in materials])[which] for field in fields(SolidMaterial)
    )
    tets = make_tets(mesh.position, mesh.tets, young, poisson, relaxation, strain)
    mass = lumped_mass(mesh.position, mesh.tets, density, lumping)
    body = make_body(mesh.position, mass, [], [], [], [], mesh.faces, tets=tets)
    if clamped:
        body = fix(body, mesh.position[:, 0] == mesh.position[:, 0].min())
    length, *others = np.ptp(mesh.position, axis=0).tolist()
    return Solid(
        name=name, body=body, length=length, water=room(DOWN, SPACIOUS * max(length, *others)), time_step=STEP,
        control_interval=FRAME, down=DOWN, outer=np.unique(mesh.faces), skin=mesh.faces, material=which,
    )  # fmt: skip
