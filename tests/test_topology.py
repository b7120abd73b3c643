"""The fish is the published one: 23 nodes, 91 units, 12 muscles (Tu 1996, ch. 4), rigid, symmetric and watertight."""

from collections import Counter
from itertools import combinations, pairwise

import naive
import numpy as np
import pytest

from fish_env import make_fish
from fish_env.bodies.mass_spring import CROSS, LAYERS, MUSCLE, OTHER, topology

LEFT_MUSCLES = [[(1, 5), (4, 8)], [(5, 9), (8, 12)], [(9, 13), (12, 16)]]
RIGHT_MUSCLES = [[(2, 6), (3, 7)], [(6, 10), (7, 11)], [(10, 14), (11, 15)]]


@pytest.fixture(params=naive.TU)
def fish(request):
    """Each body of the table."""
    return make_fish(request.param)


def pair_set(pairs):
    """Pairs of nodes without order."""
    return {tuple(sorted(map(int, pair))) for pair in pairs}


def test_counts():
    """There are 23 nodes, 91 units (46 cross, 12 muscles, 33 others) and 24 faces, four to each of six segments."""
    pairs, classes, sections, faces = topology()
    assert len({node for layer in LAYERS for node in layer}) == 23 == pairs.max() + 1
    assert len(pair_set(pairs)) == len(pairs) == len(sections) == 91
    assert Counter(classes.tolist()) == {CROSS: 46, MUSCLE: 12, OTHER: 33}
    assert faces.shape == (24, 4)
    for fish in map(make_fish, naive.TU):
        assert len(fish.body.mass) == 23
        np.testing.assert_array_equal(fish.body.springs.nodes, pairs)
        np.testing.assert_array_equal(fish.body.faces.nodes, faces)


def test_muscles(fish):
    """The twelve muscles are the straight links of the three segments, two a side, with their segment and side."""
    nodes = fish.body.springs.nodes[fish.muscles]
    for segment in range(3):
        for side, wanted in ((1, LEFT_MUSCLES), (-1, RIGHT_MUSCLES)):
            chosen = (fish.segments == segment) & (fish.sides == side)
            assert pair_set(nodes[chosen]) == set(wanted[segment])
    assert fish.num_muscles == len(set(fish.muscles.tolist())) == 12


def test_cross_units():
    """Cross units are the diagonals: of the squares, of the faces between them and of the tail fin."""
    pairs, classes, _, _ = topology()
    wanted = set()
    for layer in LAYERS[1:6]:
        wanted |= {(layer[0], layer[2]), (layer[1], layer[3])}
    for here, behind in pairwise(LAYERS[1:6]):
        wanted |= {(here[k], behind[(k + step) % 4]) for k in range(4) for step in (1, -1)}
    wanted |= {(17, 22), (18, 22), (19, 21), (20, 21)}
    assert pair_set(pairs[classes == CROSS]) == wanted


def test_only_space_diagonals_are_left_out():
    """All pairs inside a layer and between neighbouring layers are units, but for the 16 space diagonals."""
    pairs, _, _, _ = topology()
    near = {pair for layer in LAYERS for pair in combinations(layer, 2)}
    near |= {(i, j) for here, behind in pairwise(LAYERS) for i in here for j in behind}
    diagonals = {(here[k], behind[(k + 2) % 4]) for here, behind in pairwise(LAYERS[1:6]) for k in range(4)}
    assert len(diagonals) == 16
    assert near - pair_set(pairs) == diagonals
    assert pair_set(pairs) <= near


def test_band_and_skyline(fish):
    """The system matrix has half-bandwidth 7 and 126 stored entries, and every unit knows its own."""
    pairs, profile = fish.body.springs.nodes, fish.body.profile
    assert np.abs(pairs[:, 0] - pairs[:, 1]).max() == 7
    assert profile.start[-1] == 126
    where = {(i, j): profile.start[i] + j - profile.first[i] for i in range(23) for j in range(profile.first[i], i)}
    assert [where[max(i, j), min(i, j)] for i, j in pairs] == fish.body.springs.entry.tolist()


def test_six_zero_modes(fish):
    """The units make the body rigid: the linearised stiffness has the six motions of a rigid body and no other."""
    values = np.linalg.eigvalsh(naive.stiffness_matrix(fish.body))
    assert np.count_nonzero(values < 1e-12 * values[-1]) == 6
    assert values[6] > 1e-6 * values[-1]


def test_mirror_symmetry(fish):
    """Exchanging left and right leaves positions, masses (to their last digit), units and the faces as they are."""
    body, mirror = fish.body, fish.mirror
    np.testing.assert_array_equal(mirror[mirror], np.arange(23))
    np.testing.assert_array_equal(body.position[mirror], body.position * [1, -1, 1])
    np.testing.assert_allclose(body.mass[mirror], body.mass, rtol=1e-15)
    springs = body.springs
    units = {
        frozenset(map(int, pair)): values
        for pair, *values in zip(springs.nodes, springs.stiffness, springs.damping, springs.rest_length, strict=True)
    }
    for pair, values in units.items():
        assert units[frozenset(int(mirror[i]) for i in pair)] == pytest.approx(values, rel=1e-15)

    def cycle(nodes):
        start = nodes.index(min(nodes))
        return tuple(nodes[start:] + nodes[:start])

    outward = {cycle([int(i) for i in naive.polygon(face)]) for face in body.faces.nodes}
    reflected = {cycle([int(mirror[i]) for i in naive.polygon(face)][::-1]) for face in body.faces.nodes}
    assert reflected == outward


def test_surface_is_closed(fish):
    """Every edge is shared by two faces that run along it in opposite directions, and all look outward."""
    edges = Counter()
    for face in fish.body.faces.nodes:
        nodes = naive.polygon(face)
        edges.update(zip(nodes, nodes[1:] + nodes[:1], strict=True))
    assert set(edges.values()) == {1}
    assert {(j, i) for i, j in edges} == set(edges)
    areas = np.array([naive.area_vector(fish.body.position[face]) for face in fish.body.faces.nodes])
    assert np.abs(areas.sum(axis=0)).max() <= 1e-14 * np.abs(areas).sum()
    assert naive.enclosed_volume(fish.body.faces, fish.body.position) > 0


def test_shares():
    """The corners of a face carry all of its force: quarters, or thirds for the three nodes of a triangle."""
    body = make_fish("published").body
    np.testing.assert_allclose(body.faces.share, [naive.shares(face) for face in body.faces.nodes], rtol=1e-15)
    for face, share in zip(body.faces.nodes, body.faces.share, strict=True):
        carried = [share[face == node].sum() for node in naive.polygon(face)]
        np.testing.assert_allclose(carried, 1 / len(carried), rtol=1e-15)


@pytest.mark.parametrize("length", [0.05, 0.2, 0.6])
def test_neutral_buoyancy(length):
    """A fish of any length weighs as much as the water it displaces: 1000 kg/m3 times the enclosed volume.

    Where its sections are rectangles: flat faces cut off a part of elliptic ones, whose mass is in `test_bodies.py`.
    """
    body = make_fish("mass_spring", length=length, water="drag").body
    displaced = 1000.0 * naive.enclosed_volume(body.faces, body.position)
    assert body.mass.sum() == pytest.approx(displaced, rel=1e-12)


def test_deeper_than_wide():
    """The default fish is deeper than wide at every layer, as long as asked, and its tail ends in a vertical edge."""
    fish = make_fish("mass_spring", length=0.3)
    for layer in LAYERS[1:]:
        width, depth = np.ptp(fish.body.position[layer, 1]), np.ptp(fish.body.position[layer, 2])
        assert depth > width
    assert np.ptp(fish.body.position[:, 0]) == pytest.approx(0.3, rel=1e-15) == fish.length
    assert np.ptp(fish.body.position[fish.tail, 1]) == 0 and fish.body.position[fish.nose, 0] == 0


def test_published_constants():
    """The published body has the published masses, stiffness by class and viscosity."""
    body = make_fish("published").body
    _, classes, _, _ = topology()
    assert body.mass.sum() == pytest.approx(107.03, rel=1e-14)
    assert Counter(body.mass.tolist()) == {1.1: 9, 6.6: 8, 11.0: 4, 0.165: 2}
    for kind, stiffness in ((CROSS, 38.0), (MUSCLE, 28.0), (OTHER, 30.0)):
        assert set(body.springs.stiffness[classes == kind]) == {stiffness}
    assert set(body.springs.damping) == {0.1}
