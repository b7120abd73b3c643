"""Materials of a body of two layers, and how they make it of a skin: springs, gas, barriers, all at rest."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from fish_env.checks import check_names, real
from fish_env.physics.body import make_body
from fish_env.physics.records import Body
from fish_env.soft.elements import fill, make_barriers
from fish_env.soft.skins import Skin, barrier_pairs, layer_springs, tensions

NO_FACES = np.zeros((0, 4), np.int64)
OPTIONAL = ("outer_relaxation_time", "inner_relaxation_time", "radius_relaxation_time", "shear_relaxation_time",
            "density", "inner_density")  # fmt: skip
BETWEEN = ("inner_", "gap_", "radius_", "shear_", "barrier_")
"""Prefixes of the materials that an object of a single layer does not have."""


@dataclass(frozen=True, kw_only=True)
class TwoLayers:
    """Materials of a ring or a sphere. Pressures of the flat ring are in N/m.

    Stiffnesses and the barriers' energy are those of a mesh of `nodes` nodes a layer. On another mesh they are scaled,
    so that the object remains as stiff (`crowded`).
    """

    radius: float = 0.1
    """Radius of the outer layer, m."""
    inner_radius: float = 0.07
    """Radius of the inner layer, m, less than the outer one."""
    mass: float
    """Mass of the outer layer, kg, the same for each of its nodes."""
    inner_mass: float
    """Mass of the inner layer, kg."""
    stiffness: float
    """Stiffness of a structural spring of the outer layer, N/m."""
    inner_stiffness: float
    """Stiffness of a structural spring of the inner layer, N/m."""
    radius_stiffness: float
    """Stiffness of a radius spring, N/m."""
    shear_stiffness: float
    """Stiffness of a shear spring, N/m."""
    relaxation_time: float = 0.002
    """Damping over stiffness of every spring whose kind has none of its own below, s; may be zero."""
    outer_relaxation_time: float | None = None
    """Relaxation time of the structural springs of the outer layer, s.

    None takes `relaxation_time`, as for the next three.
    """
    inner_relaxation_time: float | None = None
    """Relaxation time of the structural springs of the inner layer, s."""
    radius_relaxation_time: float | None = None
    """Relaxation time of the radius springs, s."""
    shear_relaxation_time: float | None = None
    """Relaxation time of the shear springs, left and right ones, s."""
    density: float | None = None
    """Density of the outer layer, kg/m2 of its faces (kg/m for a ring); replaces `mass`. Faces share it among nodes."""
    inner_density: float | None = None
    """Density of the inner layer; replaces `inner_mass`."""
    pressure: float
    """Pressure of the gas in the inner layer at rest, Pa above that outside; zero for none."""
    gap_pressure: float
    """Pressure of the gas between the layers at rest, Pa above that outside; zero for none."""
    barrier_energy: float = 0.02
    """Scale of the barrier that keeps an inner node behind an outer face, J."""
    nodes: int
    """Nodes of a layer for which the stiffnesses and the energy are given."""

    def __post_init__(self):
        for name, value in vars(self).items():
            if value is None and name in OPTIONAL:
                continue
            zero = name in ("pressure", "gap_pressure") or name.endswith("relaxation_time")
            number = np.nan if isinstance(value, bool) else real(value)
            if not (np.isfinite(number) and (number > 0 or (zero and number == 0))):
                none = ", or None" * (name in OPTIONAL)
                raise ValueError(f"{name} is {value!r}; give a finite, positive number{' or zero' * zero}{none}")
        if not self.inner_radius < self.radius:
            raise ValueError(f"inner_radius is {self.inner_radius} m; give less than the radius, {self.radius} m")

    def crowded(self, count: int, flat: bool) -> TwoLayers:
        """The materials of a mesh of `count` nodes a layer."""
        # Radius springs and barriers act side by side, and share what they bear. Springs along a line are in a row, and
        # so are the shear springs, which lean less the closer the nodes are; on a surface both effects balance.
        along, share = count / self.nodes if flat else 1.0, self.nodes / count
        return replace(
            self, nodes=count, stiffness=along * self.stiffness, inner_stiffness=along * self.inner_stiffness,
            shear_stiffness=along * self.shear_stiffness, radius_stiffness=share * self.radius_stiffness,
            barrier_energy=share * self.barrier_energy,
        )  # fmt: skip

    def damping_times(self) -> tuple[float, ...]:
        """Damping over stiffness, s, of each kind of spring, in the order of `skins.KINDS`."""
        own = (self.outer_relaxation_time, self.inner_relaxation_time, self.radius_relaxation_time,
               self.shear_relaxation_time, self.shear_relaxation_time)  # fmt: skip
        return tuple(self.relaxation_time if time is None else time for time in own)


def choose_materials(standard: TwoLayers, changes: dict, layers=2) -> TwoLayers:
    """Change some of the standard materials, for one layer or two.

    Raises:
        ValueError: for an unknown name, a value that is not allowed, a mass and a density of the same layer, or a
            material of the inner layer, of its gas or of what joins it where there is one layer only.
    """
    names = [field.name for field in fields(TwoLayers)]
    for name in changes:
        check_names("unknown material", names, name)
        if layers == 1 and name.startswith(BETWEEN):
            raise ValueError(f"{name} is given for one layer, which has none; give layers=2, or leave it out")
    for layer in ("", "inner_"):
        if {layer + "mass", layer + "density"} <= changes.keys() and changes[layer + "density"] is not None:
            raise ValueError(f"{layer}mass and {layer}density are both given; give one of them")
    return replace(standard, **changes)


def node_masses(skin: Skin, radius: float, mass: float, density: float | None) -> np.ndarray:
    """Masses (n,) kg of a layer: equal ones, or by the density kg/m2 (of a ring kg/m) of the faces around a node."""
    n = len(skin.place)
    if density is None:
        return np.full(n, mass / n)
    place = radius * skin.place
    p, q = place[skin.faces[:, 0]], place[skin.faces[:, 1]]
    if skin.faces.shape[1] == 2:
        size, corners = np.linalg.norm(q - p, axis=1), [[0, 1]] * len(skin.faces)
    else:
        r, s = place[skin.faces[:, 2]], place[skin.faces[:, 3]]
        size = 0.5 * (np.linalg.norm(np.cross(q - p, r - p), axis=1) + np.linalg.norm(np.cross(s - r, p - r), axis=1))
        corners = [[0, 1, 2] if third == fourth else [0, 1, 2, 3] for third, fourth in skin.faces[:, 2:]]
    found = np.zeros(n)
    for face, which, area in zip(skin.faces, corners, size, strict=True):
        found[face[which]] += density * area / len(which)
    return found


def natural_lengths(length, pull, stiffness, name: str, given: float) -> np.ndarray:
    """Natural lengths (E,) m of springs that pull with `pull` (E,) N at `length`; ValueError if one is not positive.

    Their stiffness follows from the material `name`, which is `given`, N/m.
    """
    natural = length - pull / stiffness
    if natural.min() <= 0:
        least = given * (pull / (length * stiffness)).max()
        raise ValueError(f"the pressure would stretch springs by more than their length; give {name} above {least:.4g}")
    return natural


def one_layer(skin: Skin, chosen: TwoLayers, factor: float | np.ndarray = 1.0) -> tuple[Body, dict[str, slice], Skin]:
    """A body at rest of the outer skin alone, filled with gas: what two layers are compared with (ch. 1.5, 2.1)."""
    own, chosen = chosen, chosen.crowded(len(skin.place), skin.faces.shape[1] == 2)
    position = chosen.radius * skin.place
    stiffness = chosen.stiffness * factor * np.ones(len(skin.edges))
    length = np.linalg.norm(position[skin.edges[:, 1]] - position[skin.edges[:, 0]], axis=1)
    power = 1 if skin.faces.shape[1] == 2 else 2
    pull = chosen.pressure * chosen.radius**power * tensions(skin)
    length = natural_lengths(length, pull, stiffness, "stiffness", own.stiffness)
    gas = fill(position, [skin.faces], [chosen.pressure])
    body = make_body(
        position, node_masses(skin, chosen.radius, chosen.mass, chosen.density), skin.edges, stiffness,
        stiffness * chosen.damping_times()[0], length, NO_FACES, compartments=gas,
    )  # fmt: skip
    return body, {"outer": slice(0, len(skin.edges))}, skin


def two_layers(skin: Skin, chosen: TwoLayers, factor: float | np.ndarray = 1.0) -> tuple[Body, dict[str, slice], Skin]:
    """A body at rest of an outer skin and its inner copy, joined by springs; factor (E,) on those along the edges."""
    n, count, flat = len(skin.place), len(skin.edges), skin.faces.shape[1] == 2
    own, chosen = chosen, chosen.crowded(n, flat)
    pairs, kinds = layer_springs(skin)
    radii = np.repeat([chosen.radius, chosen.inner_radius], n)
    position = radii[:, None] * np.tile(skin.place, (2, 1))
    even = factor * np.ones(count)
    stiffness = np.concatenate([
        chosen.stiffness * even, chosen.inner_stiffness * even, np.full(n, chosen.radius_stiffness),
        chosen.shear_stiffness * even, chosen.shear_stiffness * even,
    ])  # fmt: skip
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    pull, power = tensions(skin), 1 if flat else 2
    outward = chosen.gap_pressure, chosen.pressure - chosen.gap_pressure
    for k, name in enumerate(("stiffness", "inner_stiffness")):
        which, pulling = slice(k * count, (k + 1) * count), outward[k] * radii[k * n] ** power * pull
        length[which] = natural_lengths(length[which], pulling, stiffness[which], name, getattr(own, name))
    time = np.repeat(chosen.damping_times(), [which.stop - which.start for which in kinds.values()])
    outer = node_masses(skin, chosen.radius, chosen.mass, chosen.density)
    inner = node_masses(skin, chosen.inner_radius, chosen.inner_mass, chosen.inner_density)
    turned = skin.faces[:, ::-1] if flat else skin.faces[:, [0, 3, 2, 1]]
    turned = turned if flat else np.where(turned[:, 1:2] == turned[:, 2:3], turned[:, [0, 2, 3, 3]], turned)
    surfaces = [skin.faces + n, np.concatenate([skin.faces, turned + n])]
    gas = fill(position, surfaces, (chosen.pressure, chosen.gap_pressure))
    faces, nodes = barrier_pairs(skin)
    body = make_body(
        position, np.concatenate([outer, inner]), pairs, stiffness, stiffness * time, length, NO_FACES,
        compartments=gas, barriers=make_barriers(position, faces, nodes, chosen.barrier_energy),
    )  # fmt: skip
    return body, kinds, skin
