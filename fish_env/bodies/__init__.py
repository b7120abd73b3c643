"""Fish and the BODIES table: parameters in, a `Fish` out. No physics here."""

import inspect
from dataclasses import dataclass
from typing import Any

from fish_env.bodies.fitted import WATERS
from fish_env.bodies.mass_spring import MassSpringParameters, make_mass_spring, make_published
from fish_env.bodies.planar import make_planar
from fish_env.checks import UnknownOptionError, check_names, representable
from fish_env.physics.fish import ElasticObject, Fish, Landmarks
from fish_env.physics.lazy import load_texts

__all__ = ["BODIES", "BodyKind", "ElasticObject", "Fish", "Landmarks", "MassSpringParameters", "make_fish"]


@dataclass(frozen=True)
class BodyKind:
    """A way to build a fish."""

    name: str
    description: str
    make: Any
    """The function that builds it, or a text "module:function", which is loaded when it is called."""
    waters: tuple[str, ...] = ()
    """Levels of water that it is calibrated for, which `make` then takes as `water`."""

    def __post_init__(self):
        load_texts(self, "make")


BODIES: dict[str, BodyKind] = {
    record.name: record
    for record in (
        BodyKind(
            "mass_spring", "23 nodes, 91 springs, 12 muscles, calibrated to swim, SI units", make_mass_spring, WATERS
        ),
        BodyKind("planar", "the same fish in the plane: 12 nodes, 12 muscles", make_planar, WATERS),
        BodyKind(
            "two_layer",
            "the same fish as two skins with gas inside and between, 46 nodes",
            "fish_env.soft.two_layer:make_two_layer",
            WATERS,
        ),
        BodyKind(
            "tetrahedral",
            "the same fish as corotational finite elements, 49 nodes or more",
            "fish_env.soft.tetrahedral:make_tetrahedral",
            WATERS,
        ),
        BodyKind(
            "published", "the same topology with the published masses and constants, graphics units", make_published
        ),
    )
}


def make_fish(body: str = "mass_spring", **parameters) -> Fish:
    """Build a fish by name: `make_fish("mass_spring", length=0.3)`.

    Args:
        body: a key of `BODIES`.
        parameters: passed to that body; for "mass_spring" the fields of `MassSpringParameters`.

    Raises:
        ValueError: for an unknown body, an unknown parameter or a value that is not allowed.
    """
    check_names("the object has no muscles:" if isinstance(body, ElasticObject) else "unknown body", BODIES, body)
    make = BODIES[body].make
    allowed = inspect.signature(make).parameters
    if not any(p.kind is p.VAR_KEYWORD for p in allowed.values()):
        check_names(f"the {body} fish has no parameter", allowed, *parameters, error=UnknownOptionError)
    with representable(f"the {body} fish"):
        return make(**parameters)
