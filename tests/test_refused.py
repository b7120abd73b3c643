"""What bodies, their elements and worlds cannot be made of is refused by its number."""

from functools import partial

import numpy as np
import pytest

from fish_env.physics.body import make_body
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_barriers, make_compartments, make_tets
from fish_env.soft.room import make_world

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
GOOD = [0, 1, 2, 3]
TETRAHEDRON = [[0, 2, 1, 1], [0, 1, 3, 3], [1, 2, 3, 3], [2, 0, 3, 3]]
SQUARE = [[0, 1], [1, 4], [4, 2], [2, 0]]
NAN = float("nan")


def tets(nodes, **options):
    """A call that makes tetrahedra."""
    return partial(make_tets, CORNERS, nodes, **{"young": 1.0, "poisson": 0.3, **options})


def gas(surfaces, **options):
    """A call that makes compartments."""
    return partial(make_compartments, CORNERS, surfaces, **{"pressure": 1.0, **options})


def barriers(faces, inner, energy=1.0):
    """A call that makes barriers."""
    return partial(make_barriers, CORNERS, faces, inner, energy)


def body(**parts):
    """A call that makes a body of nodes alone, and of some parts."""
    rest = {name: [] for name in ("pairs", "stiffness", "damping", "rest_length", "faces")}
    return partial(make_body, CORNERS, **{"mass": np.ones(5), **rest, **parts})


def beyond(point):
    """The corners and a node that the body has not."""
    return np.vstack([CORNERS, [point]])


FAR_GAS = [np.where(np.array(TETRAHEDRON) == 3, 5, TETRAHEDRON)]
UP = (0, 0, 1)
REFUSED = [
    (tets([GOOD, [0, 1, 2, 4]]), r"tetrahedron 1, of the nodes \[0, 1, 2, 4\], is flat"),
    (tets([GOOD, [1, 2, 4, 3]]), r"tetrahedron 1, of the nodes \[1, 2, 4, 3\], is inverted"),
    (tets([GOOD, [4, 1, 1, 3]]), r"tetrahedron 1, of the nodes \[4, 1, 1, 3\], names a node twice"),
    (tets([GOOD, [1, 4, 2, 3], [1, 2, 0, 3]]), r"tetrahedron 2, of the nodes \[1, 2, 0, 3\], is there twice"),
    (tets([[0, 1, 2, 7]]), "tetrahedra contain node 7; valid numbers are 0 to 4"),
    (tets([[0, 1, 2]]), r"tetrahedra have shape \(1, 3\)"),
    (tets([GOOD], poisson=0.5), "poisson is 0.5 in element 0; give numbers above -1 and below 0.5"),
    (tets([GOOD, [1, 4, 2, 3]], poisson=[0.3, -1.0]), "poisson is -1 in element 1"),
    (tets([GOOD, [1, 4, 2, 3]], young=[1.0, 0.0]), r"young \(Pa\) is 0.0 at \(1,\); give positive"),
    (tets([GOOD], young=NAN), r"young \(Pa\) is nan at \(0,\)"),
    (tets([GOOD], relaxation_time=-1.0), r"relaxation_time \(s\) is -1.0 at \(0,\); give zero or positive"),
    (gas([TETRAHEDRON, TETRAHEDRON[:3]]), "compartment 1 is open at the edge from node 0 to 2; close its surface"),
    (gas([[*TETRAHEDRON[:3], [0, 2, 3, 3]]]), "compartment 0 is open at the edge from node 0 to 2"),
    (gas([np.array(TETRAHEDRON)[:, [1, 0, 2, 3]]]), "compartment 0 encloses -0.166667; give its faces counter-clock"),
    (gas([SQUARE, SQUARE[:3]]), "compartment 1 is open at node 0; give a closed ring"),
    (gas([np.array(SQUARE)[:, ::-1]]), "compartment 0 encloses -1; give its faces counter-clockwise"),
    (gas([[[0, 1, 2, 2], [0, 2, 1, 1]]]), "compartment 0 encloses 0; give its faces"),
    (gas([[]]), "compartment 0 has no faces; give a closed surface"),
    (gas([[[0, 1, 9, 9]]]), "faces of compartment 0 contain node 9; valid"),
    (gas([TETRAHEDRON], pressure=0.0), r"pressure \(Pa\) is 0.0 at \(0,\); give positive"),
    (gas([TETRAHEDRON], ambient=-1.0), r"ambient \(Pa\) is -1.0 at \(0,\); give zero or positive"),
    (barriers([[1, 2, 3], [0, 1, 2]], [0, 3]), r"barrier 1: node 3 is not behind the face \[0, 1, 2\]; give outer"),
    (barriers([[0, 1, 2]], [4]), r"barrier 0: node 4 is not behind the face \[0, 1, 2\]"),
    (barriers([[0, 1], [0, 2]], [4, 1]), r"barrier 1: node 1 is not behind the face \[0, 2\]"),
    (barriers([[1, 2, 3]], [0], 0.0), r"energy of the barriers \(J\) is 0.0 at \(0,\); give positive"),
    (barriers([[1, 2, 3]], [0, 1]), "there are 2 inner nodes for 1 faces; give one each"),
    (barriers([[1, 2, 9]], [0]), "faces of the barriers contain node 9; valid"),
    (barriers([[1, 2, 3]], [9]), "inner nodes contain node 9; valid"),
    (body(mass=[1.0, 1, 0, 1, 1]), r"mass \(kg\) is 0.0 at \(2,\); give positive"),
    (body(mass=[1.0, 1, 1, 1, -2]), r"mass \(kg\) is -2.0 at \(4,\)"),
    (body(tets=make_tets(beyond([2, 2, 2]), [[1, 4, 2, 5]], 1.0, 0.3)), "tets contain node 5"),
    (body(compartments=make_compartments(beyond([0, 0, 2]), FAR_GAS, 1.0)), "compartments contain node 5"),
    (body(barriers=make_barriers(beyond([0, 0, -1]), [[0, 1, 2]], [5], 1.0)), "barriers contain node 5"),
    (partial(make_world, planes=[(UP, 0, 0), ((0, 0, 0), 0, 0)]), r"normal of plane 1 is \[0. 0. 0.\]; give a vector"),
    (partial(make_world, planes=[(UP, 0, 0), (UP, 0, 1.1)]), "restitution of plane 1 is 1.1; give a number from 0"),
    (partial(make_world, planes=[(UP, 0, -0.1)]), "restitution of plane 0 is -0.1"),
    (partial(make_world, planes=[(UP, 0, NAN)]), "restitution of plane 0 is nan"),
    (partial(make_world, planes=[(UP, 0, 0), (UP, 0)]), r"plane 1 is \(\(0, 0, 1\), 0\); give \(normal \(3,\)"),
    (partial(make_world, planes=[((0, 0), 0, 0)]), r"normal of plane 0 has shape \(2,\)"),
    (partial(make_world, gravity=(0, 0)), r"gravity \(m/s2\) has shape \(2,\)"),
    (partial(make_world, viscosity=-1.0), r"viscosity \(N s/m\) is -1.0"),
    (partial(make_anchors, [0, -1], np.zeros(3), 1.0), "anchors contain node -1; valid"),
    (partial(make_anchors, [0.5], np.zeros(3), 1.0), "anchors have shape"),
    (partial(make_anchors, [0, 1], np.zeros(3), [1.0, -1.0]), r"stiffness \(N/m\) is -1.0 at \(1,\); give zero or pos"),
    (partial(make_anchors, [0, 1], np.zeros(3), 1.0, -1.0), r"damping \(N s/m\) is -1.0 at \(0,\)"),
    (partial(make_anchors, [0, 1], np.zeros(3), 1.0, 0.0, [0.0, -1.0]), r"rest_length \(m\) is -1.0 at \(1,\)"),
    (partial(make_anchors, [0, 1], np.zeros((3, 3)), 1.0), "of the anchors"),
    (partial(make_anchors, [0], [[0.0, np.inf, 0.0]], 1.0), r"point \(m\) is inf at \(0, 1\)"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "text"), REFUSED, ids=[text for _, text in REFUSED])
def test_refused(make, text):
    """Elements that are flat, open, inside out or of no material, and worlds that would feed energy, are refused."""
    with pytest.raises(ValueError, match=text):
        make()
