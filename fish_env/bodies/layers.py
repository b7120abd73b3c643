"""Materials of a body of two layers, and how they make it of a skin: springs, gas, barriers, all at rest."""

from dataclasses import asdict, dataclass, fields, replace
from numbers import Real

import numpy as np

from fish_env.bodies.skins import Skin, layered, tensions, watched
from fish_env.body import Body, make_body
from fish_env.elements import make_barriers, make_compartments

NO_FACES = np.zeros((0, 4), np.int64)


@dataclass(frozen=True, kw_only=True)
class TwoLayers:
    """Materials of a ring or a sphere. Of the flat ring, pressures are in N/m."""

    radius: float = 0.1
    """Of the outer layer, m."""
    inner_radius: float = 0.07
    """Of the inner layer, m, less than the outer one."""
    mass: float
    """Of the outer layer, kg, the same for each of its nodes."""
    inner_mass: float
    """Of the inner layer, kg."""
    stiffness: float
    """Of a structural spring of the outer layer, N/m."""
    inner_stiffness: float
    """Of a structural spring of the inner layer, N/m."""
    radius_stiffness: float
    """Of a radius spring, N/m."""
    shear_stiffness: float
    """Of a shear spring, N/m."""
    relaxation_time: float = 0.002
    """Damping over stiffness of every spring, s; may be zero."""
    pressure: float
    """Of the gas in the inner layer at rest, Pa over that outside; zero for none."""
    gap_pressure: float
    """Of the gas between the layers at rest, Pa over that outside; zero for none."""
    barrier_energy: float = 0.02
    """Scale of the barrier that keeps an inner node behind an outer face, J."""

    def __post_init__(self):
        for name, value in asdict(self).items():
            zero = name in ("relaxation_time", "pressure", "gap_pressure")
            number = float(value) if isinstance(value, Real) else np.nan
            if not (np.isfinite(number) and (number > 0 or (zero and number == 0))):
                raise ValueError(f"{name} is {value!r}; give a finite, positive number{' or zero' * zero}")
        if not self.inner_radius < self.radius:
            raise ValueError(f"inner_radius is {self.inner_radius} m; give less than the radius, {self.radius} m")


def chosen_materials(standard: TwoLayers, changes: dict) -> TwoLayers:
    """The standard materials with some changed; ValueError for an unknown name or a value that is not allowed."""
    names = [field.name for field in fields(TwoLayers)]
    for name in changes:
        if name not in names:
            raise ValueError(f"unknown material {name!r}; choose from {', '.join(names)}")
    return replace(standard, **changes)


def two_layers(skin: Skin, chosen: TwoLayers, factor: float | np.ndarray = 1.0) -> tuple[Body, dict[str, slice], Skin]:
    """A body at rest of an outer skin and its inner copy, joined by springs; factor (E,) on those along the edges."""
    n, count, flat = len(skin.place), len(skin.edges), skin.faces.shape[1] == 2
    pairs, kinds = layered(skin)
    radii = np.repeat([chosen.radius, chosen.inner_radius], n)
    position = radii[:, None] * np.tile(skin.place, (2, 1))
    even = factor * np.ones(count)
    stiffness = np.concatenate([
        chosen.stiffness * even, chosen.inner_stiffness * even, np.full(n, chosen.radius_stiffness),
        chosen.shear_stiffness * even, chosen.shear_stiffness * even,
    ])  # fmt: skip
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    pull, power = tensions(skin), 1 if flat else 2
    inward = np.concatenate([
        chosen.gap_pressure * chosen.radius**power * pull,
        (chosen.pressure - chosen.gap_pressure) * chosen.inner_radius**power * pull,
    ])  # fmt: skip
    length[: 2 * count] -= inward / stiffness[: 2 * count]
    if length.min() <= 0:
        worst = int(np.argmin(length))
        raise ValueError(
            f"the pressure would stretch spring {worst} by more than its length; give a stiffness above "
            f"{stiffness[worst] * (1 - length.min() / (length.min() + inward[worst] / stiffness[worst])):.3g} N/m"
        )
    turned = skin.faces[:, ::-1] if flat else skin.faces[:, [0, 3, 2, 1]]
    turned = turned if flat else np.where(turned[:, 1:2] == turned[:, 2:3], turned[:, [0, 2, 3, 3]], turned)
    surfaces = [skin.faces + n, np.concatenate([skin.faces, turned + n])]
    filled = [(surface, p) for surface, p in zip(surfaces, (chosen.pressure, chosen.gap_pressure), strict=True) if p]
    gas = make_compartments(position, [surface for surface, _ in filled], [p for _, p in filled]) if filled else None
    faces, nodes = watched(skin)
    body = make_body(
        position, np.repeat([chosen.mass / n, chosen.inner_mass / n], n), pairs, stiffness,
        stiffness * chosen.relaxation_time, length, NO_FACES, compartments=gas,
        barriers=make_barriers(position, faces, nodes, chosen.barrier_energy),
    )  # fmt: skip
    return body, kinds, skin
