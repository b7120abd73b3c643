"""What bodies, their elements and worlds cannot be made of is refused by its number."""

import numpy as np
import pytest

from fish_env.physics.body import make_body
from fish_env.physics.elements import make_barriers, make_compartments, make_tets
from fish_env.physics.world import make_anchors, make_world

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
GOOD = [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("nodes", "options", "text"),
    [
        ([GOOD, [0, 1, 2, 4]], {}, r"tetrahedron 1, of the nodes \[0, 1, 2, 4\], is flat"),
        ([GOOD, [1, 2, 4, 3]], {}, r"tetrahedron 1, of the nodes \[1, 2, 4, 3\], is inverted"),
        ([GOOD, [4, 1, 1, 3]], {}, r"tetrahedron 1, of the nodes \[4, 1, 1, 3\], names a node twice"),
        ([GOOD, [1, 4, 2, 3], [1, 2, 0, 3]], {}, r"tetrahedron 2, of the nodes \[1, 2, 0, 3\], is there twice"),
        ([[0, 1, 2, 7]], {}, "tetrahedra contain node 7; valid numbers are 0 to 4"),
        ([[0, 1, 2]], {}, r"tetrahedra have shape \(1, 3\)"),
        ([GOOD], {"poisson": 0.5}, "poisson is 0.5 in element 0; give numbers above -1 and below 0.5"),
        ([GOOD, [1, 4, 2, 3]], {"poisson": [0.3, -1.0]}, "poisson is -1 in element 1"),
        ([GOOD, [1, 4, 2, 3]], {"young": [1.0, 0.0]}, r"young \(Pa\) is 0.0 at \(1,\); give positive"),
        ([GOOD], {"young": float("nan")}, r"young \(Pa\) is nan at \(0,\)"),
        ([GOOD], {"relaxation_time": -1.0}, r"relaxation_time \(s\) is -1.0 at \(0,\); give zero or positive"),
    ],
)  # fmt: skip
def test_tets_refused(nodes, options, text):
    """Tetrahedra that are flat, inverted, repeated or of no material are refused by their number."""
    with pytest.raises(ValueError, match=text):
        make_tets(CORNERS, nodes, **{"young": 1.0, "poisson": 0.3, **options})


TETRAHEDRON = [[0, 2, 1, 1], [0, 1, 3, 3], [1, 2, 3, 3], [2, 0, 3, 3]]
SQUARE = [[0, 1], [1, 4], [4, 2], [2, 0]]


@pytest.mark.parametrize(
    ("surfaces", "options", "text"),
    [
        ([TETRAHEDRON, TETRAHEDRON[:3]], {}, r"compartment 1 is open at the edge from node 0 to 2; close its surface"),
        ([[*TETRAHEDRON[:3], [0, 2, 3, 3]]], {}, r"compartment 0 is open at the edge from node 0 to 2"),
        (
            [np.array(TETRAHEDRON)[:, [1, 0, 2, 3]]],
            {},
            r"compartment 0 encloses -0.166667; give its faces counter-clock",
        ),
        ([SQUARE, SQUARE[:3]], {}, "compartment 1 is open at node 0; give a closed ring"),
        ([np.array(SQUARE)[:, ::-1]], {}, "compartment 0 encloses -1; give its faces counter-clockwise"),
        ([[[0, 1, 2, 2], [0, 2, 1, 1]]], {}, "compartment 0 encloses 0; give its faces"),
        ([[]], {}, "compartment 0 has no faces; give a closed surface"),
        ([[[0, 1, 9, 9]]], {}, "faces of compartment 0 contain node 9; valid"),
        ([TETRAHEDRON], {"pressure": 0.0}, r"pressure \(Pa\) is 0.0 at \(0,\); give positive"),
        ([TETRAHEDRON], {"ambient": -1.0}, r"ambient \(Pa\) is -1.0 at \(0,\); give zero or positive"),
    ],
)
def test_compartments_refused(surfaces, options, text):
    """Compartments that are open, inside out or empty raise an error with their number, and where they are open."""
    with pytest.raises(ValueError, match=text):
        make_compartments(CORNERS, surfaces, **{"pressure": 1.0, **options})


@pytest.mark.parametrize(
    ("faces", "inner", "energy", "text"),
    [
        (
            [[1, 2, 3], [0, 1, 2]],
            [0, 3],
            1.0,
            r"barrier 1: node 3 is not behind the face \[0, 1, 2\]; give outer faces",
        ),
        ([[0, 1, 2]], [4], 1.0, r"barrier 0: node 4 is not behind the face \[0, 1, 2\]"),
        ([[0, 1], [0, 2]], [4, 1], 1.0, r"barrier 1: node 1 is not behind the face \[0, 2\]"),
        ([[1, 2, 3]], [0], 0.0, r"energy of the barriers \(J\) is 0.0 at \(0,\); give positive"),
        ([[1, 2, 3]], [0, 1], 1.0, "there are 2 inner nodes for 1 faces; give one each"),
        ([[1, 2, 9]], [0], 1.0, "faces of the barriers contain node 9; valid"),
        ([[1, 2, 3]], [9], 1.0, "inner nodes contain node 9; valid"),
    ],
)
def test_barriers_refused(faces, inner, energy, text):
    """Barriers whose node is not behind their face are refused by their number."""
    with pytest.raises(ValueError, match=text):
        make_barriers(CORNERS, faces, inner, energy)


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ({"mass": [1.0, 1, 0, 1, 1]}, r"mass \(kg\) is 0.0 at \(2,\); give positive"),
        ({"mass": [1.0, 1, 1, 1, -2]}, r"mass \(kg\) is -2.0 at \(4,\)"),
        ({"tets": make_tets(np.vstack([CORNERS, [[2, 2, 2]]]), [[1, 4, 2, 5]], 1.0, 0.3)}, "tets contain node 5"),
        ({"compartments": make_compartments(np.vstack([CORNERS, [[0, 0, 2]]]),
                                    [np.where(np.array(TETRAHEDRON) == 3, 5, TETRAHEDRON)], 1.0)},
         "compartments contain node 5"),
        (
            {"barriers": make_barriers(np.vstack([CORNERS, [[0, 0, -1]]]), [[0, 1, 2]], [5], 1.0)},
            "barriers contain node 5",
        ),
    ],
)  # fmt: skip
def test_bodies_refused(part, text):
    """Masses that are not positive are refused by their node, and so are elements of nodes that are not there."""
    with pytest.raises(ValueError, match=text):
        make_body(CORNERS, **{"mass": np.ones(5), **part}, pairs=[], stiffness=[], damping=[], rest_length=[], faces=[])


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"planes": [((0, 0, 1), 0, 0), ((0, 0, 0), 0, 0)]}, r"normal of plane 1 is \[0. 0. 0.\]; give a vector"),
        (
            {"planes": [((0, 0, 1), 0, 0), ((0, 0, 1), 0, 1.1)]},
            "restitution of plane 1 is 1.1; give a number from 0",
        ),
        ({"planes": [((0, 0, 1), 0, -0.1)]}, "restitution of plane 0 is -0.1"),
        ({"planes": [((0, 0, 1), 0, float("nan"))]}, "restitution of plane 0 is nan"),
        ({"planes": [((0, 0, 1), 0, 0), ((0, 0, 1), 0)]}, r"plane 1 is \(\(0, 0, 1\), 0\); give \(normal \(3,\)"),
        ({"planes": [((0, 0), 0, 0)]}, r"normal of plane 0 has shape \(2,\)"),
        ({"gravity": (0, 0)}, r"gravity \(m/s2\) has shape \(2,\)"),
        ({"viscosity": -1.0}, r"viscosity \(N s/m\) is -1.0"),
    ],
)
def test_worlds_refused(options, text):
    """Walls without a direction, or that would add energy, are refused by their number."""
    with pytest.raises(ValueError, match=text):
        make_world(**options)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([0, -1], np.zeros(3), 1.0), "anchors contain node -1; valid"),
        (([0.5], np.zeros(3), 1.0), "anchors have shape"),
        (([0, 1], np.zeros(3), [1.0, -1.0]), r"stiffness \(N/m\) is -1.0 at \(1,\); give zero or positive"),
        (([0, 1], np.zeros(3), 1.0, -1.0), r"damping \(N s/m\) is -1.0 at \(0,\)"),
        (([0, 1], np.zeros(3), 1.0, 0.0, [0.0, -1.0]), r"rest_length \(m\) is -1.0 at \(1,\)"),
        (([0, 1], np.zeros((3, 3)), 1.0), "of the anchors"),
        (([0], [[0.0, np.inf, 0.0]], 1.0), r"point \(m\) is inf at \(0, 1\)"),
    ],
)
def test_anchors_refused(arguments, text):
    """Anchors of no node, or that would push or feed energy, are refused by their number."""
    with pytest.raises(ValueError, match=text):
        make_anchors(*arguments)
