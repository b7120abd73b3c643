"""Water around the bodies of a tank. Walls and anchors: `fish_env.soft`."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from fish_env.checks import check_names, checked_keywords, finite_array, frozen, positive_array, real
from fish_env.physics.records import World

GRAVITY = 9.81  # m/s2
RIGHTING = 0.005  # body lengths: without it, commands that differ above and below roll the fish over
BLASIUS = 1.328  # mean friction coefficient of a laminar boundary layer times the root of the Reynolds number
VACUUM = World(0.0, 0.0, frozen(np.zeros(3)))
LAWS = ("quadratic", "cross_flow", "linear")
WATERS = ("none", "drag", "reactive")
"""Levels of water that a `water` names: vacuum, the fish's own without inertia, and with it."""


@checked_keywords
def make_water(
    density=1000.0, drag_coefficient=1.5, law="quadratic", current=(0.0, 0.0, 0.0), inertia=False,
    added_mass=(1.0, 1.0), righting=None, friction=0.0, thinning=0.0, viscosity=1.0e-6,
) -> World:  # fmt: skip
    """Still or uniformly moving water that resists outward-moving faces (docs/physics.md, eq. 10-12).

    Args:
        density: density of the water, kg/m3 (quadratic law, inertia and friction).
        drag_coefficient: drag coefficient of a face moving along its normal, dimensionless (quadratic law). For the
            linear law, it is the coefficient itself, kg/(m2 s), whatever the density.
        law: "quadratic" (Terzopoulos, Tu & Grzeszczuk 1994); "cross_flow", in which only the velocity along a face's
            normal counts (Taylor 1952); or "linear" (Tu & Terzopoulos 1994; docs/physics-more.md, eq. 27).
        current: velocity of the water, (3,) m/s.
        inertia: True for reactive water, which also resists the acceleration of the body's sections, by their added
            mass (docs/physics.md, eq. 14-20); for bodies with sections.
        added_mass: factors on the lateral and on the vertical added mass of slender-body theory, (2,), zero or
            positive; for water with inertia.
        righting: height of the centre of buoyancy above the centre of mass, body lengths: a couple that turns the fish
            upright. None: 0.005 for water with inertia, else zero.
        friction: skin friction over that of a laminar boundary layer on a flat plate of the body's length
            (docs/physics.md, eq. 13), beside any law; 0 is none.
        thinning: part that friction grows by, times the square of the sine between the flow and the face, zero or
            positive: flow across a surface makes its boundary layer thinner.
        viscosity: kinematic viscosity of the water, m2/s, for friction; 1.0e-6 is that of water at 20 degrees Celsius.

    Raises:
        ValueError: for an unknown law, a negative or non-finite number, or a current that is not three finite numbers.
    """
    check_names("unknown water law", LAWS, law)
    for name, value in (("density", density), ("drag_coefficient", drag_coefficient), ("friction", friction),
                        ("thinning", thinning), ("viscosity", viscosity)):  # fmt: skip
        if not 0.0 <= real(value) < math.inf:
            raise ValueError(f"{name} is {value!r}; give a finite number, zero or positive")
    flow = finite_array(current, (3,), "current (m/s)")
    factors = positive_array(added_mass, (2,), "added_mass", zero=True)
    if inertia not in (True, False):
        raise ValueError(f"inertia is {inertia!r}; give True or False")
    heavy = real(density) * factors if inertia else None
    height = (RIGHTING if inertia else 0.0) if righting is None else righting
    upright = GRAVITY * float(finite_array(height, (), "righting (body lengths)"))
    rough = 0.5 * BLASIUS * real(friction) * real(density) * math.sqrt(real(viscosity))
    if not rough < math.inf:
        raise ValueError(f"friction {friction!r} times density {density!r} is infinite; give less")
    still = World(0.0, 0.0, flow, added_mass=heavy, righting=upright, friction=rough, thinning=real(thinning))
    if law == "linear":
        return still._replace(linear=real(drag_coefficient))
    quadratic = 0.5 * real(density) * real(drag_coefficient)
    if quadratic == math.inf:
        raise ValueError(f"density {density!r} times drag_coefficient {drag_coefficient!r} is infinite; give less")
    return still._replace(quadratic=quadratic, oblique=0.0 if law == "cross_flow" else 1.0)


def law_of(water: World) -> str:
    """The law of `make_water` by which a water resists faces."""
    return "linear" if water.linear > 0.0 else "quadratic" if water.oblique > 0.0 else "cross_flow"


def checked_water(given: str | Mapping[str, Any] | World, own: World) -> World:
    """Water of a name in WATERS, a fish's own with keywords of `make_water` changed, or as it is; else ValueError."""
    if isinstance(given, World):
        return given
    if isinstance(given, str):
        check_names("unknown water", WATERS, given)
        drag = own._replace(added_mass=None, righting=0.0)
        inert = change_water(drag, inertia=True) if own.added_mass is None else own
        return (VACUUM, drag, inert)[WATERS.index(given)]
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise ValueError(f"water is {given!r}; give keywords of fish_env.make_water, its result, or one of {WATERS}")
    return change_water(own, **given)


def change_water(water: World, /, **named) -> World:
    """Return water in which what is named has changed, keywords of `make_water`; everything else keeps its bits.

    The water is taken to have the density and the viscosity that are the defaults of `make_water`. A drag coefficient
    does not go from the linear law to another or back, a righting couple goes with inertia, unless they are named.
    ValueError as `make_water`, and for added mass without inertia, or viscosity without friction.
    """
    own: dict[str, Any] = {
        "density": 1000.0, "law": law_of(water), "current": water.current, "thinning": water.thinning,
        "drag_coefficient": water.linear or water.quadratic / 500.0, "inertia": water.added_mass is not None,
        "added_mass": (1.0, 1.0) if water.added_mass is None else water.added_mass / 1000.0,
        "righting": water.righting / GRAVITY, "friction": water.friction / (0.5 * BLASIUS),
    }  # fmt: skip
    given = own | named
    if "drag_coefficient" not in named and given["law"] != own["law"] and "linear" in (given["law"], own["law"]):
        del given["drag_coefficient"]  # the linear law's is of another kind
    if "righting" not in named and given["inertia"] != own["inertia"]:
        del given["righting"]
    for name, part in (("added_mass", "inertia"), ("viscosity", "friction"), ("thinning", "friction")):
        if name in named and not given[part]:
            raise ValueError(f"{name} changes nothing in water without {part}; name {part} too, or leave {name} out")
    before, after = (make_water(**each) for each in (own, given))
    fields: Any = zip(water._fields, before, after, strict=True)
    return water._replace(**{name: new for name, old, new in fields if not np.array_equal(old, new)})
