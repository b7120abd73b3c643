"""Consistency checks of the records that kernels read: kernels use node numbers without bounds checks.

`make_body` and the builders check their arguments. Records that a user changed since then (by `_replace`,
`dataclasses.replace` or in place) are checked here: when a tank is made, a static problem is posed or forces are
evaluated.
"""

import numpy as np

from fish_env.checks import finite_array, positive_array
from fish_env.physics.body import joined
from fish_env.physics.fish import ElasticObject, Fish
from fish_env.physics.forces import FORCES
from fish_env.physics.linalg import ldlt
from fish_env.physics.records import Body, World

REMADE = "; make the body by make_body"


def check_numbers(name: str, array, shape: tuple, below: int, lowest: int = 0) -> None:
    """Raise ValueError unless `array` contains whole numbers from `lowest` to `below` - 1; None in the shape is any."""
    array = np.asarray(array)
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in "iu":
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}; give whole numbers ({wanted})")
    outside = array[(array < lowest) | (array >= below)]
    if outside.size:
        raise ValueError(f"{name} contains {outside[0]}; valid numbers are {lowest} to {below - 1}")


def check_problem(body: Body, world: World) -> None:
    """Raise ValueError unless all arrays of a body and its world are consistent, also with each other."""
    check_body(body)
    check_world(world, len(body.mass))


def check_body(body: Body) -> None:
    """Raise ValueError unless all arrays of a body are consistent, also the skyline of its system matrix."""
    check_elements(body)
    n = len(body.mass)
    check_numbers("fixed degrees of freedom", body.fixed, (None, 2), max(n, 3))
    check_numbers("fixed nodes", body.fixed[:, 0], (None,), n)
    check_numbers("fixed axes", body.fixed[:, 1], (None,), 3)
    shape = ldlt.profile(joined(body.springs.nodes, body.faces.nodes, body.tets, body.sections), n)
    if any(not np.array_equal(one, other) for one, other in zip(shape, body.profile, strict=True)):
        raise ValueError(f"the profile of the body is not that of its elements{REMADE}")
    if not np.array_equal(ldlt.entries(shape, body.springs.nodes), body.springs.entry):
        raise ValueError(f"springs.entry does not name the entries of the springs{REMADE}")


def check_elements(body: Body) -> None:
    """Raise ValueError unless the elements of a body contain valid node numbers, and their arrays are consistent."""
    if np.ndim(body.mass) != 1 or not len(body.mass):
        raise ValueError(f"mass has shape {np.shape(body.mass)}; give one mass a node, (N,) with N at least 1")
    n = len(body.mass)
    _check_floats("body", body, n, {"position": (3,), "mass": (), "inverse_mass": (3,)})
    for name, columns, lowest, floats in (
        ("springs", 2, 0, {"stiffness": (), "damping": (), "rest_length": ()}),
        ("faces", 4, 0, {"share": (4,), "drag": (), "depth": ()}),
        ("tets", 4, 0, {"gradient": (4, 3), "volume": (), "shear": (), "dilation": (), "relaxation_time": ()}),
        ("barriers", 4, -1, {"volume": (), "energy": ()}),
    ):
        part = getattr(body, name)
        if part is not None:
            check_numbers(f"{name}.nodes", part.nodes, (None, columns), n, lowest)
            _check_floats(name, part, len(part.nodes), floats)
    if body.sections is not None:
        _check_sections(body.sections, n)
    if body.compartments is not None:
        gas = body.compartments
        check_numbers("compartments.faces", gas.faces, (None, 4), n, -1)
        check_numbers("compartments.first", gas.first, (len(gas.gas) + 1,), len(gas.faces) + 1)
        _check_floats("compartments", gas, len(gas.gas), {"gas": (), "ambient": ()})
        if gas.first[0] or gas.first[-1] != len(gas.faces) or (np.diff(gas.first) < 0).any():
            raise ValueError(f"compartments.first is {gas.first}; give where each one's faces begin, and where all end")


def _check_sections(sections, n: int) -> None:
    """Raise ValueError unless the sections contain valid node numbers, and their arrays are consistent."""
    k, p = len(sections.lateral), len(sections.nodes)
    check_numbers("sections.nodes", sections.nodes, (None,), n)
    check_numbers("sections.first", sections.first, (k + 1,), p + 1)
    check_numbers("sections.upper", sections.upper, (None,), n)
    check_numbers("sections.lower", sections.lower, np.shape(sections.upper), n)
    if sections.first[0] or sections.first[-1] != p or (np.diff(sections.first) < 1).any():
        raise ValueError(f"sections.first is {sections.first}; give where each one's nodes begin, and where all end")
    _check_floats("sections", sections, k, {"slope": (3,), "lateral": (), "vertical": (), "narrowing": ()})
    _check_floats("sections", sections, p, {"share": ()})
    check_numbers("sections.fin", sections.fin, (), k)
    for name in ("height", "trailing", "leverage"):
        finite_array(getattr(sections, name), (), f"{name} of the sections")


def check_world(world: World, nodes: int) -> None:
    """Raise ValueError unless the parts of a world are consistent, and its anchors contain valid node numbers."""
    if not isinstance(world, World):
        raise ValueError(f"water is a {type(world).__name__}; give fish_env.make_water(...), or None for vacuum")
    finite_array(world.current, (3,), "current of the water (m/s)")
    if world.gravity is not None:
        finite_array(world.gravity, (3,), "gravity of the water (m/s2)")
    if world.added_mass is not None:
        finite_array(world.added_mass, (2,), "added_mass of the water (kg/m3)")
    finite_array(world.righting, (), "righting of the water (m/s2)")
    positive_array(world.friction, (), "friction of the water (kg s^-1/2 m^-2)", zero=True)
    for name in world.extra or {}:
        if name not in FORCES:
            raise ValueError(f"extra of the water is for a force {name!r}; choose from {', '.join(map(repr, FORCES))}")
    if world.planes is not None:
        finite_array(world.planes, (len(world.planes), 5), "planes of the water")
    if world.anchors is not None:
        count = len(world.anchors.node)
        check_numbers("anchors", world.anchors.node, (count,), nodes)
        for name, tail in (("point", (3,)), ("velocity", (3,)), ("stiffness", ()), ("damping", ()),
                           ("rest_length", ())):  # fmt: skip
            finite_array(getattr(world.anchors, name), (count, *tail), f"{name} of the anchors")


def _check_floats(name: str, part, count: int, tails: dict[str, tuple]) -> None:
    for field, tail in tails.items():
        finite_array(getattr(part, field), (count, *tail), f"{field} of {name}")


def check_fish(fish: ElasticObject) -> None:
    """Raise ValueError unless muscles and landmarks of a fish contain valid numbers of springs and nodes."""
    check_body(fish.body)
    springs, nodes, m = len(fish.body.springs.nodes), len(fish.body.mass), fish.num_muscles
    check_numbers("muscles", fish.muscles, (m,), springs)
    finite_array(fish.contracted, (m,), "contracted")
    check_numbers("fibres", fish.fibres, (None,), springs)
    check_numbers("drives", fish.drives, (len(fish.fibres), 2), m)
    if not isinstance(fish, Fish):
        return
    marks, count = fish.landmarks, len(fish.landmarks.node)
    check_numbers("sides", fish.sides, (None,), 2, -1)
    for name, array, shape, below in (
        ("segments", fish.segments, (None,), springs), ("nose", fish.nose, (), nodes),
        ("tail", fish.tail, (None,), nodes), ("left", fish.left, (None,), nodes),
        ("right", fish.right, np.shape(fish.left), nodes), ("mirror", fish.mirror, (nodes,), nodes),
        ("landmarks.node", marks.node, (count,), nodes), ("landmarks.faces", marks.faces, (None, 4), count),
        ("landmarks.muscles", marks.muscles, (None, 2), count), ("landmarks.mirror", marks.mirror, (count,), count),
    ):  # fmt: skip
        check_numbers(name, array, shape, below)
    _check_floats("landmarks", marks, count, {"height": (), "mass": ()})
