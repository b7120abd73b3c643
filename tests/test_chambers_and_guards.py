"""Gas in chambers, guards, and what counts as a failure of the elements."""

import naive
import numpy as np
import pytest
import small_bodies
from small_bodies import ALL, close

from fish_env.body import ESCAPED, TORN
from fish_env.elements import chamber_volume, make_chambers
from fish_env.forces import guards, pressure, tets
from fish_env.integrators._common import check

# Gas


def test_volume_of_spheres():
    """The volume of a finer and finer polyhedron converges to that of its sphere at second order."""
    errors, lengths = [], []
    for levels in range(1, 6):
        points, faces = small_bodies.subdivided(levels)
        body = make_chambers(points, [faces], 1.0)
        volume = pressure.add_volume(body, 0, points, np.zeros_like(points))
        errors.append(4 / 3 * np.pi - volume)
        lengths.append(2.0**-levels)
    assert errors[-1] < 2e-3 * 4 / 3 * np.pi
    assert abs(np.polyfit(np.log(lengths[2:]), np.log(errors[2:]), 1)[0] - 2) < 0.02


def test_volume_far_from_the_origin():
    """A chamber 1000 km away encloses what it does at home, to rounding, and pushes alike."""
    points, faces = small_bodies.subdivided(1)
    points = np.round(points * 2**24) / 2**24  # so that no digit of a position is lost on the way
    chambers, far = make_chambers(points, [faces], 3.0), points + 2.0**20
    found = [np.zeros_like(points), np.zeros_like(points)]
    volumes = [pressure.add_volume(chambers, 0, x, slope) for x, slope in zip((points, far), found, strict=True)]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-14)
    close(found[1], found[0], 1e-14)
    assert volumes[0] == pytest.approx(chamber_volume(chambers, 0, points)[0], rel=1e-14)


def test_closed_chambers_push_all_round():
    """A sphere's gas pushes outward everywhere, with pressure times area; twice as wide, it has an eighth of it."""
    points, faces = small_bodies.subdivided(2)
    chambers, f, g = make_chambers(points, [faces], 7.0, 2.0), np.zeros_like(points), np.zeros_like(points)
    pressure.add_force(chambers, points, f)
    pressure.add_force(chambers, 2 * points, g)
    areas = [naive.area_vector(points[face]) for face in faces]
    assert np.sum(f * points, axis=1).min() > 0
    wanted = (7 - 2) * sum(area @ points[face[0]] for area, face in zip(areas, faces, strict=True))
    assert np.sum(f * points) == pytest.approx(wanted, rel=1e-12)
    close(g, f * 4 * (7 / 8 - 2) / (7 - 2))


# Guards


def test_barrier():
    """A guard does nothing while far, then pushes apart, ever harder; force and stiffness begin without a jump."""
    s = np.linspace(1e-6, 0.4, 4000)
    energy, first, second = np.array([guards.barrier(value) for value in s]).T
    near = s < guards.NEAR
    assert not np.any([energy[~near], first[~near], second[~near]])
    assert np.all(energy[near] > 0) and np.all(first[near] < 0) and np.all(second[near] > 0)
    below = guards.barrier(guards.NEAR - 1e-9)
    assert 0 < below[0] < 1e-25 and -1e-16 < below[1] < 0 and below[2] < 1e-7
    assert guards.barrier(1e-12)[1] < -1e10
    assert np.isnan(guards.barrier(0.0)).all() and np.isnan(guards.barrier(-1.0)).all()


def test_failures_of_the_elements():
    """A torn tetrahedron, an emptied chamber and a node that got out are found out, each by its name."""
    sound, v = ALL.position, np.zeros((20, 3))
    assert check(ALL, sound, v) == 0
    torn, empty, out = sound.copy(), sound.copy(), sound.copy()
    torn[18] += [0.0, 0.0, 0.6]
    assert not tets.all_shorter(ALL.tets, torn, 3.0)
    assert check(ALL, torn, v) == TORN
    empty[8:16] = empty[8:16].mean(axis=0) - 1e-3 * (empty[8:16] - empty[8:16].mean(axis=0))  # turned inside out
    assert not pressure.all_filled(ALL.chambers, empty) and check(ALL, empty, v) == ESCAPED
    out[8, 0] -= 0.04
    assert pressure.all_filled(ALL.chambers, out) and not guards.all_inside(ALL.guards, out)
    assert check(ALL, out, v) == ESCAPED
