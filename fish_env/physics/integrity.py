"""Consistency checks of the records that kernels read: kernels use node numbers without bounds checks.

`make_body` and the builders check their arguments. Records that a user changed since then (by `_replace`,
`dataclasses.replace` or in place) are checked here: when a tank is made, a static problem is posed or forces are
evaluated.
"""

import numpy as np

from fish_env.checks import check_names, check_numbers, check_record, positive_array
from fish_env.physics.fish import ElasticObject, Fish
from fish_env.physics.forces import FORCES
from fish_env.physics.linalg import ldlt
from fish_env.physics.records import Body, World

ELEMENTS = {
    "mass": "N", "position": "N 3", "inverse_mass": "N 3",
    "springs.nodes": "E 2 < N", "springs.stiffness": "E", "springs.damping": "E", "springs.rest_length": "E",
    "faces.nodes": "F 4 < N", "faces.share": "F 4", "faces.drag": "F", "faces.depth": "F",
    "tets.nodes": "T 4 < N", "tets.gradient": "T 4 3", "tets.volume": "T", "tets.shear": "T", "tets.dilation": "T",
    "tets.relaxation_time": "T",
    "barriers.nodes": "K 4 < N from -1", "barriers.volume": "K", "barriers.energy": "K",
    "compartments.gas": "C", "compartments.ambient": "C", "compartments.faces": "Q 4 < N from -1",
    "sections.lateral": "S", "sections.vertical": "S", "sections.narrowing": "S", "sections.slope": "S 3",
    "sections.nodes": "P < N", "sections.share": "P", "sections.upper": "U < N", "sections.lower": "U < N",
    "sections.fin": "< S", "sections.height": "", "sections.trailing": "", "sections.leverage": "",
}  # fmt: skip
"""Arrays of a body, with their shapes (`check_record`)."""
FIRST = (("compartments", "faces", "gas"), ("sections", "nodes", "lateral"))
"""Parts of a body whose `first` says where the rows of each element begin: the field with the rows, and one with an
entry for each element."""
WORLD = {
    "current": "3", "gravity": "?3", "added_mass": "?2", "righting": "", "planes": "?W 5",
    "anchors.node": "A < N", "anchors.point": "A 3", "anchors.velocity": "A 3", "anchors.stiffness": "A",
    "anchors.damping": "A", "anchors.rest_length": "A",
}  # fmt: skip
OBJECT = {"muscles": "M < E", "contracted": "M", "fibres": "K < E", "drives": "K 2 < M"}
FISH = {
    "sides": "M < 2 from -1", "segments": "M < E", "nose": "< N", "tail": "D < N", "left": "L < N", "right": "L < N",
    "mirror": "N < N", "landmarks.node": "R < N", "landmarks.height": "R", "landmarks.mass": "R",
    "landmarks.faces": "F 4 < R", "landmarks.muscles": "M 2 < R", "landmarks.mirror": "R < R",
}  # fmt: skip


def check_elements(body: Body) -> None:
    """Raise ValueError unless the elements of a body contain valid node numbers, and their arrays are consistent."""
    if not isinstance(body, Body):
        raise ValueError(f"body is a {type(body).__name__}; give a Body, such as that of an object: thing.body")
    if np.ndim(body.mass) != 1 or not len(body.mass):
        raise ValueError(f"mass has shape {np.shape(body.mass)}; give one mass a node, (N,) with N at least 1")
    check_record("", body, ELEMENTS)
    for name, rows, elements in FIRST:
        part = getattr(body, name)
        if part is not None:
            count, first = len(getattr(part, rows)), part.first
            check_record(f"{name}.", part, {"first": "I < R"}, I=1 + len(getattr(part, elements)), R=count + 1)
            if first[0] or first[-1] != count or (np.diff(first) < (name == "sections")).any():
                raise ValueError(f"{name}.first is {first}; give where the {rows} of each begin, and where all end")


def check_world(world: World, nodes: int) -> None:
    """Raise ValueError unless the parts of a world are consistent, and its anchors contain valid node numbers."""
    if not isinstance(world, World):
        raise ValueError(f"water is a {type(world).__name__}; give fish_env.make_water(...), or None for vacuum")
    check_record("water.", world, WORLD, N=nodes)
    positive_array(world.friction, (), "friction of the water (kg s^-1/2 m^-2)", zero=True)
    check_names("extra of the water is for a force", FORCES, *(world.extra or {}))


def check_problem(body: Body, world: World) -> None:
    """Raise ValueError unless all arrays of a body and its world are consistent, also with each other."""
    check_elements(body)
    check_world(world, len(body.mass))
    check_numbers("fixed degrees of freedom", body.fixed, (None, 2), max(len(body.mass), 3))
    check_numbers("fixed nodes", body.fixed[:, 0], (None,), len(body.mass))
    check_numbers("fixed axes", body.fixed[:, 1], (None,), 3)
    shape = ldlt.profile_of(body)
    if any(not np.array_equal(one, other) for one, other in zip(shape, body.profile, strict=True)):
        raise ValueError("the profile of the body is not that of its elements; make the body by make_body")
    if not np.array_equal(ldlt.entries(shape, body.springs.nodes), body.springs.entry):
        raise ValueError("springs.entry does not name the entries of the springs; make the body by make_body")


def check_objects(fish: ElasticObject, world: World) -> None:
    """Raise ValueError as `check_problem`, and unless muscles and landmarks are valid numbers of springs and nodes."""
    check_problem(fish.body, world)
    sizes = {"N": len(fish.body.mass), "E": len(fish.body.springs.nodes), "M": fish.num_muscles}
    check_record("", fish, OBJECT | (FISH if isinstance(fish, Fish) else {}), **sizes)
