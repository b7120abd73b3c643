"""Tetrahedra, gas, guards, anchors, gravity and walls: their forces, energies, derivatives, and what is known of them.

Then every method on a body that has all of them, and what is refused.
"""

from functools import cache, partial

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.integrate import solve_ivp

from fish_env import INTEGRATORS, forces
from fish_env.body import ESCAPED, TORN, make_body, scaled
from fish_env.elements import chamber_volume, make_chambers, make_guards, make_tets
from fish_env.forces import anchors, contact, gravity, guards, pressure, tets
from fish_env.forces.polar import rotation
from fish_env.integrators import adaptive
from fish_env.integrators._common import check
from fish_env.world import VACUUM, make_anchors, make_world

BODIES = {
    name: small_bodies.completed(body)
    for name, body in {
        "block": small_bodies.block(),
        "linear block": small_bodies.block(corotational=False),
        "chamber": small_bodies.tetrahedral_chamber(),
        "two layers": small_bodies.two_layers(),
        "rings": small_bodies.rings(),
    }.items()
}
ALL = BODIES["two layers"]
PARTS = [
    (name, part)
    for name, body in BODIES.items()
    for part in ("tets", "chambers", "guards")
    if len(getattr(body, part)[0])
]
ADAPTIVE = [name for name, record in INTEGRATORS.items() if record.kind == "adaptive"]
FIXED_STEP = [name for name in INTEGRATORS if name not in ADAPTIVE]
seeds = st.integers(0, 2**32 - 1)
each_part = pytest.mark.parametrize(("name", "part"), PARTS)
each_fixed = pytest.mark.parametrize("name", FIXED_STEP)


def close(actual, wanted, tolerance=1e-12):
    """Equal up to `tolerance` times the largest element."""
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())


def bent(name, rng):
    """A turned and moved, bent and moving state of a body (of a flat one: in its plane); guards, if any, at work."""
    body = BODIES[name]
    flat = not np.ptp(body.position[:, 2])
    x, v = small_bodies.shaken(body, rng, 1e-3 if flat else 3e-3, squeezed=name == "two layers")
    if flat:
        x[8, 0] += 0.032
        angle = rng.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        x[:, 2], v[:, 2] = 0.0, 0.0
    else:
        turn = small_bodies.turned(rng)
    if name == "linear block":
        turn = np.eye(3)
    return x @ turn.T + rng.uniform(-0.3, 0.3, 3) * (1, 1, not flat), v @ turn.T


def force_of(part, body, x, v):
    """What the kernel of one kind of elements adds to no force."""
    f = np.zeros_like(x)
    if part == "tets":
        tets.add_force(body.tets, x, v, f)
    elif part == "chambers":
        pressure.add_force(body.chambers, x, f)
    else:
        guards.add_force(body.guards, x, f)
    return f


def energy_of(part, body, x):
    """What the kernel of one kind of elements takes for its energy."""
    return {"tets": tets, "chambers": pressure, "guards": guards}[part].energy(getattr(body, part), x)


def twin_of(part, body, x, v):
    """Force and energy of one kind of elements by the slow twin."""
    if part == "tets":
        return naive.tet_force(body, x, v), naive.tet_energy(body, x)
    if part == "chambers":
        return naive.gas_force(body.chambers, x), naive.gas_energy(body.chambers, x)
    return naive.guard_force(body.guards, x), naive.guard_energy(body.guards, x)


def gradient(energy, x, step):
    """Derivative (N,3) of energy(x), by central differences of fourth order."""
    slope = np.zeros_like(x)
    for place in np.ndindex(x.shape):
        for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):
            moved = x.copy()
            moved[place] += shift * step
            slope[place] += weight * energy(moved) / step
    return slope


# Forces of each kind


@each_part
@settings(max_examples=15)
@given(seed=seeds)
def test_kernels_equal_their_twins(name, part, seed):
    """Force and energy of tetrahedra, gas and guards are those of the textbook's formulas."""
    body = BODIES[name]
    x, v = bent(name, np.random.default_rng(seed))
    force, energy = twin_of(part, body, x, v)
    assert np.abs(force).max() > 0  # guards too are at work
    close(force_of(part, body, x, v), force)
    assert energy_of(part, body, x) == pytest.approx(energy, rel=1e-12)


@each_part
def test_force_is_minus_gradient_of_energy(name, part):
    """The elastic force on each node is minus the gradient of the kind's energy."""
    body = BODIES[name]
    x, v = bent(name, np.random.default_rng(2))
    if part == "tets":
        body = body._replace(tets=body.tets._replace(relaxation_time=0 * body.tets.relaxation_time))
    slope = gradient(partial(energy_of, part, body), x, 2e-5)
    if not x[:, 2].any():
        slope[:, 2] = 0.0
    close(force_of(part, body, x, v), -slope, 1e-8)


@pytest.mark.parametrize("name", BODIES)
def test_total_and_its_derivatives(name):
    """All forces in a world with everything are the twins' sum, kept or not; so are the exact derivatives."""
    body, rng = BODIES[name], np.random.default_rng(3)
    x, v = bent(name, rng)
    world = small_bodies.world_with_all(body)
    rest = body.springs.rest_length
    f = np.full_like(x, np.nan)
    forces.total(body, world, rest, x, v, f)
    close(f, naive.total_force(body, world, rest, x, v))
    turned, compressed = tets.scratch(body.tets), pressure.scratch(body.chambers, len(x))
    kept = (np.empty((len(body.faces.depth), 5)), np.empty((7, rest.size)), turned, compressed)
    again = np.zeros_like(x)
    forces.add_total_kept(body, world, rest, x, v, again, kept)  # all but the drag of the air, which acts by itself
    close(again, naive.total_force(body, world._replace(viscosity=0.0), rest, x, v))
    stiffness, damping = np.full((x.size, x.size), np.nan), np.full((x.size, x.size), np.nan)
    forces.jacobian(body, world, rest, x, v, stiffness, damping)
    wanted = naive.derivatives(lambda x, v: naive.total_force(body, world, rest, x, v), x, v, 2e-5, 1e-3)
    close(stiffness, wanted[0], 1e-7)
    close(damping, wanted[1], 1e-7)


@pytest.mark.parametrize("projected", [False, True])
@pytest.mark.parametrize("name", BODIES)
def test_system_equals_its_twin(name, projected):
    """The matrix of the linearly implicit methods, and the force of its stiffness, are those of the dense K and D."""
    body, rng, h = BODIES[name], np.random.default_rng(4), 0.02
    x, v = bent(name, rng)
    world, rest = small_bodies.world_with_all(body), body.springs.rest_length * 1.05
    lowest = 0.0 if projected else -np.inf
    a = np.empty((body.profile.start[-1], 3, 3))
    forces.system(body, world, rest, x, v, h, lowest, True, a)
    stiffness, damping = naive.implicit_matrices(body, world, rest, x, v, projected, wet=True)
    wanted = np.diag(np.repeat(body.mass, 3)) + h * damping + h**2 * stiffness
    found = np.zeros_like(wanted)
    for i, first in enumerate(body.profile.first):
        for j in range(first, i + 1):
            found[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = a[body.profile.start[i] + j - first]
    close(np.tril(found), np.tril(wanted))
    y, pull = rng.normal(size=x.shape), np.zeros_like(x)
    forces.add_stiffness_force(body, world, rest, x, v, y, h, lowest, pull)
    close(pull.ravel(), -h * stiffness @ y.ravel())


def test_all_energies():
    """The energies of all kinds, added up, fall by what the forces that come from them do."""
    rng, still = np.random.default_rng(5), np.zeros((20, 3))
    x, v = bent("two layers", rng)
    world, rest = small_bodies.world_with_all(ALL, drag=0.0), ALL.springs.rest_length
    found = forces.energies(ALL, world, rest, x, v)
    wanted = {
        "kinetic": naive.kinetic_energy(ALL.mass, v),
        "springs": naive.spring_energy(ALL.springs, rest, x),
        "tets": naive.tet_energy(ALL, x),
        "gas": naive.gas_energy(ALL.chambers, x),
        "guards": naive.guard_energy(ALL.guards, x),
        "weight": naive.weight_energy(ALL, world, x),
        "anchors": naive.anchor_energy(world.anchors, x),
    }
    assert found == pytest.approx(wanted, rel=1e-12) and min(map(abs, found.values())) > 0
    world = world._replace(anchors=world.anchors._replace(velocity=np.zeros((3, 3))))
    slope = gradient(lambda x: sum(forces.energies(ALL, world, rest, x, still).values()), x, 2e-5)
    close(naive.total_force(ALL, world, rest, x, still), -slope, 1e-8)


# What is known of the forces without computing them


@each_part
@given(seed=seeds)
def test_internal_forces_have_no_force_and_no_torque(name, part, seed):
    """No kind of elements pushes the whole body; none but plain linear ones turns it. Nor does damping push it."""
    body = BODIES[name]
    x, v = bent(name, np.random.default_rng(seed))
    f = force_of(part, body, x, 0 * v)
    moving = force_of(part, body, x, v)
    if part == "chambers":  # what the gas does before the sum cancels: the push on every face
        volume = np.array([naive.gas_volume(body.chambers, c, x)[0] for c in range(body.chambers.gas.size)])
        size = max(body.chambers.gas / volume) * (0.1 if name == "rings" else 0.01)
    else:
        size = np.abs(f).max()
    assert np.abs(f.sum(axis=0)).max() <= 1e-14 * size
    assert np.abs(moving.sum(axis=0)).max() <= 1e-14 * np.abs(moving).max()
    torque = np.abs(np.cross(x - x.mean(axis=0), f).sum(axis=0)).max()
    if name == "linear block":
        assert torque > 1e-5 * size
    else:
        assert torque <= 1e-14 * size


@given(seed=seeds)
def test_rigid_motion_costs_nothing(seed):
    """Turned and moved, corotational elements feel nothing; plain linear ones take the rotation for strain."""
    rng = np.random.default_rng(seed)
    turn, shift = small_bodies.turned(rng), rng.uniform(-1, 1, 3)
    for name, exact in (("block", True), ("linear block", False)):
        body = BODIES[name]
        stiffness = np.abs(naive.stiffness_matrix(body)).max() * np.ptp(body.position)
        rest = np.zeros_like(body.position)
        f = force_of("tets", body, body.position @ turn.T + shift, rest)
        energy = energy_of("tets", body, body.position @ turn.T + shift)
        if exact:
            assert np.abs(f).max() <= 3e-15 * stiffness and energy <= 1e-28 * stiffness
        else:
            angle = np.linalg.norm(turn - np.eye(3))
            assert np.abs(f).max() > 1e-3 * angle**2 * stiffness


@given(seed=seeds)
def test_damping_only_takes_energy_away(seed):
    """The viscous part of the tetrahedra takes energy from every motion but a rigid one of the body at rest.

    The strain whose rate is damped is that in the elements' frames, so that a rigid motion of a strained body is damped
    as the strain goes: by no more than strain times viscosity.
    """
    rng = np.random.default_rng(seed)
    body, (x, v) = BODIES["block"], bent("block", rng)
    still = np.zeros_like(v)

    def drag(x, v):
        return force_of("tets", body, x, v) - force_of("tets", body, x, still)

    assert np.sum(drag(x, v) * v) < 0
    spin, turn = np.cross(rng.normal(size=3), np.eye(3)), small_bodies.turned(rng)
    size = 2e4 * 2e-3 * 0.1 * 0.1 * np.linalg.norm(spin)  # viscosity times area times rate
    undeformed = body.position @ turn.T
    elastic = np.abs(np.abs(undeformed).max() * naive.stiffness_matrix(body)).max()
    assert np.abs(drag(undeformed, undeformed @ spin + rng.normal(size=3))).max() <= 1e-15 * (10 * size + elastic)
    strain = max(np.abs(naive.strain_of(r, f)).max() for *_, f, r in naive.tets_of(body, x))
    assert 1e-4 * strain * size < np.abs(drag(x, x @ spin + rng.normal(size=3))).max() < 10 * strain * size


def test_uniform_strain():
    """A block stretched uniformly pulls on its ends with the stress of an isotropic material times their area."""
    for name in ("block", "linear block"):
        body, strain = BODIES[name], np.diag([2e-3, -1e-3, 3e-4])
        x = body.position @ (np.eye(3) + strain).T
        f = force_of("tets", body, x, np.zeros_like(x))
        shear, dilation = 2e4 / 2.6, 2e4 * 0.3 / (1.3 * 0.4)  # of Young's 20 kPa and Poisson's 0.3
        stress = 2 * shear * strain + dilation * np.trace(strain) * np.eye(3)
        volume = body.tets.volume.sum()
        np.testing.assert_allclose(-f.T @ body.position / volume, stress, rtol=0, atol=1e-11 * np.abs(stress).max())


def test_scaled():
    """Factors on stiffness and damping of a body multiply its elastic and viscous forces, of all kinds of elements."""
    x, v = bent("two layers", np.random.default_rng(6))
    still, rest = np.zeros_like(v), ALL.springs.rest_length
    world = small_bodies.completed_world(VACUUM)
    once, twice = ALL, scaled(ALL, 3.0, 5.0, 2.0)
    found = []
    for body in (once, twice):
        elastic, both = np.empty_like(x), np.empty_like(x)
        forces.total(body, world, rest, x, still, elastic)
        forces.total(body, world, rest, x, v, both)
        found.append((elastic, both - elastic))
    close(found[1][0], 3.0 * found[0][0])
    close(found[1][1], 5.0 * found[0][1], 1e-11)
    for body in (once, twice):
        assert body.elastic_rate == pytest.approx(naive.highest_rate(body, naive.stiffness_matrix(body)), rel=1e-12)
        assert body.viscous_rate == pytest.approx(
            naive.highest_rate(body, naive.stiffness_matrix(body, "damping")), rel=1e-12
        )


# The nearest rotation


def nearest(matrix):
    """The kernel's rotation as a matrix."""
    return np.array(rotation(*map(float, matrix.ravel()))).reshape(3, 3)


def check_rotation(matrix):
    """It is a rotation, and as near as any: tr(R^T F) = s1 + s2 + s3, s3 negative where F is inverted."""
    turn = nearest(matrix)
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), rtol=0, atol=2e-11)
    assert np.linalg.det(turn) > 0
    values = np.linalg.svd(matrix, compute_uv=False)
    values[2] *= 1.0 if np.linalg.det(matrix) >= 0 else -1.0
    np.testing.assert_allclose(np.sum(turn * matrix), values.sum(), rtol=0, atol=1e-12 * values[0])
    return turn, (values[1] + values[2]) / max(values[0], np.finfo(float).tiny)


@settings(max_examples=200)
@given(hnp.arrays(float, (3, 3), elements=st.floats(-10, 10, width=32)))
def test_rotation_of_any_matrix(matrix):
    """The nearest rotation of any matrix, regular, flat, inverted or null; where it is unique, the SVD's."""
    turn, gap = check_rotation(matrix)
    if gap > 1e-3:
        np.testing.assert_allclose(turn, naive.nearest_rotation(matrix), rtol=0, atol=1e-13 / gap**2)


@settings(max_examples=200)
@given(seed=seeds, exponent=st.floats(-16, -0.5))
def test_rotation_near_a_rotation(seed, exponent):
    """Of what is almost a rotation, as all elements are while strains are small, every digit is right."""
    rng = np.random.default_rng(seed)
    turn = small_bodies.turned(rng)
    matrix = turn @ (np.eye(3) + 10**exponent * rng.uniform(-1, 1, (3, 3)))
    found = nearest(matrix)
    np.testing.assert_allclose(found.T @ found, np.eye(3), rtol=0, atol=4e-15)
    np.testing.assert_allclose(found, naive.nearest_rotation(matrix), rtol=0, atol=1e-14)  # as exact as that one is


@settings(max_examples=200)
@given(seed=seeds, values=st.sampled_from([
    (1, 1, 0), (1, 0.5, 0), (1, 0, 0), (0, 0, 0), (1, 1, -1), (1, 0.6, -0.2), (1, 1, -0.999999),
    (1e-200, 1e-200, 1e-200), (1, 1e-7, 1e-7), (1, 1e-3, -1e-9), (2, 2, -2), (1e70, 1e69, 1e68),
]))  # fmt: skip
def test_rotation_of_hard_cases(seed, values):
    """Flat, inverted, tiny and huge matrices, those without a unique nearest rotation among them."""
    rng = np.random.default_rng(seed)
    check_rotation(small_bodies.turned(rng) @ np.diag(np.array(values, float)) @ small_bodies.turned(rng))


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


# World


@given(seed=seeds)
def test_world_equals_its_twins(seed):
    """Anchors, gravity and air, and walls at work are those of the textbook's formulas; so are the impacts."""
    rng = np.random.default_rng(seed)
    x, v = small_bodies.shaken(ALL, rng)
    world, f = small_bodies.world_with_all(ALL, offset=0.07), np.zeros((20, 3))
    anchors.add_force(world.anchors, x, v, f)
    close(f, naive.anchor_force(world.anchors, x, v))
    assert anchors.energy(world.anchors, x) == pytest.approx(naive.anchor_energy(world.anchors, x), rel=1e-12)
    f[:] = 0.0
    gravity.add_force(ALL.mass, world.gravity, world.viscosity, v, f)
    close(f, ALL.mass[:, None] * world.gravity - world.viscosity * v)
    assert gravity.energy(ALL.mass, world.gravity, x) == pytest.approx(naive.weight_energy(ALL, world, x), rel=1e-12)
    v[0, 2], f = -0.1, rng.normal(size=x.shape)
    f[0] = [0.0, 0.0, -1.0]  # onto the walls, behind which it is
    wanted = naive.with_reaction(world.planes, x, v, f)
    assert np.abs(wanted - f).max() > 0
    contact.add_reaction(world.planes, x, v, f)
    close(f, wanted)
    wanted, before, h = naive.bounce(ALL, world, 0.005, x, v), v.copy(), 0.005
    contact.bounce(world.planes, ALL.inverse_mass, world.gravity, h, x, v)
    close(v, wanted)
    assert (v != before).any()
    assert np.sum(v**2, axis=1) @ ALL.mass < np.sum(before**2, axis=1) @ ALL.mass


def test_anchor_at_its_point():
    """An anchor with a length whose node is at its very point has no direction, and pulls nowhere."""
    x, f = np.zeros((1, 3)), np.zeros((1, 3))
    anchor = make_anchors([0], np.zeros(3), 5.0, 1.0, 0.3, [1.0, 0.0, 0.0])
    anchors.add_force(anchor, x, np.zeros((1, 3)), f)
    stiffness, damping = np.zeros((3, 3)), np.zeros((3, 3))
    anchors.add_jacobian(anchor, x, np.zeros((1, 3)), stiffness, damping)
    assert not f.any() and not stiffness.any() and not damping.any()


# Every method on a body with all of it


def advance(name, world, x, v, rest, rate, h, n, body=ALL):
    """Motion of one sound body after n steps, (x, v)."""
    state = small_bodies.start(x, v)
    INTEGRATORS[name].advance(body, world, state, small_bodies.control(rest, rate), h, n)
    assert state.failure[0] == 0
    return state.x[0], state.v[0]


@pytest.mark.parametrize("name", INTEGRATORS)
@settings(max_examples=3)
@given(seed=seeds, reach=st.sampled_from([0.3, 1.5]))
def test_step_equals_its_twin(name, seed, reach):
    """One step, short and long, equals the textbook's; an adaptive method's is as accurate as its tolerance."""
    rng = np.random.default_rng(seed)
    x, v = small_bodies.shaken(ALL, rng)
    world, rest = small_bodies.world_with_all(ALL), ALL.springs.rest_length * rng.uniform(0.95, 1.05, 36)
    h = reach / np.sqrt(ALL.elastic_rate)
    rate = rest * rng.uniform(-0.3, 0.3, rest.size)
    if name in ADAPTIVE:
        h = min(h, 0.3 / np.sqrt(ALL.elastic_rate))
    moved = advance(name, world, x, v, rest, rate, h, 1)
    wanted = naive.advance(name, ALL, world, rest, rate, x, v, h, 1)
    if name in ADAPTIVE:
        allowed = 100 * adaptive.TOLERANCE * np.ptp(ALL.position, axis=0).max() * np.array([1.0, 1.0 / h])
    else:
        allowed = 1e-12 * np.abs(wanted[0] - x).max(), 1e-12 * np.abs(wanted[1]).max()
    np.testing.assert_allclose(moved[0] - x, wanted[0] - x, rtol=0, atol=allowed[0])
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=allowed[1])


@each_fixed
def test_steps_at_walls_equal_their_twin(name):
    """Eight steps among walls that nodes run into and rest on equal the textbook's."""
    x, v = small_bodies.shaken(ALL, np.random.default_rng(8), speed=0.3)
    world, h = small_bodies.world_with_all(ALL, offset=0.03), 0.2 / np.sqrt(ALL.elastic_rate)
    rest = ALL.springs.rest_length
    moved = advance(name, world, x, v, rest, 0 * rest, h, 8)
    wanted = naive.advance(name, ALL, world, rest, 0 * rest, x, v, h, 8)
    free = naive.advance(name, ALL, world._replace(planes=None), rest, 0 * rest, x, v, h, 8)
    assert np.abs(free[1] - wanted[1]).max() > 0.05
    close(moved[0] - x, wanted[0] - x, 1e-11)
    close(moved[1], wanted[1], 1e-11)


@each_fixed
def test_comes_to_rest_on_a_wall(name):
    """A block dropped on the floor comes to rest there, however it is moved, and does not sink in."""
    body = small_bodies.completed(small_bodies.block(relaxation_time=1e-2))
    world = small_bodies.completed_world(make_world((0.0, 0.0, -9.8), [((0, 0, 1), -0.02, 0.5)], 0.1))
    h = 0.2 * INTEGRATORS[name].limit(body)
    n = round(1.5 / h)
    x, v = advance(name, world, body.position, 0 * body.position, np.zeros(0), np.zeros(0), h, n, body)
    lowest = x[:, 2].min() + 0.02
    deepest = h * 1.0  # what a node moves in a step at 1 m/s, which it reaches in a fall of 5 cm
    assert np.abs(v).max() < 0.02 and -deepest < lowest < 1e-4
    x, v = advance(name, world, x, v, np.zeros(0), np.zeros(0), h, n, body)
    assert np.abs(v).max() < 2e-3 and x[:, 2].min() + 0.02 > lowest - 2e-5


@cache
def smooth_motion():
    """A motion to measure orders on, and its end: what guards act, and which faces move outward, stays as it was."""
    rng = np.random.default_rng(9)
    x, v = small_bodies.shaken(ALL, rng, displacement=5e-4, speed=0.01)
    world = small_bodies.world_with_all(ALL)
    rest = ALL.springs.rest_length
    rate, duration, seen = 0.2 * rest * rng.uniform(-1, 1, rest.size), 1.0 / np.sqrt(ALL.elastic_rate), set()

    def slope(t, y):
        positions, velocities = y.reshape(2, -1, 3)
        f = np.empty_like(positions)
        forces.total(ALL, world, rest + t * rate, positions, velocities, f)
        through = np.einsum("fc,fck->fk", ALL.faces.share, velocities[ALL.faces.nodes]) - world.current
        areas = np.array([naive.area_vector(positions[face]) for face in ALL.faces.nodes])
        acting = tuple(k for k, _, s, _ in naive.guard_shares(ALL.guards, positions) if s < guards.NEAR)
        seen.add((acting, tuple(np.sum(areas * through, axis=1) > 0)))
        return np.concatenate([velocities.ravel(), (f / ALL.mass[:, None]).ravel()])

    y = np.concatenate([x.ravel(), v.ravel()])
    end = solve_ivp(slope, (0, duration), y, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1].reshape(2, -1, 3)
    assert len(seen) == 1 and next(iter(seen))[0], "a face or a guard changed its mind: the scene is not smooth"
    return (world, x, v, rest, rate, duration), end


FINER = {"explicit_euler": 8, "linearly_implicit": 16, "linearly_implicit_projected": 16, "linearly_implicit_water": 16}
"""How many times the steps of `test_order` a method takes."""


@each_fixed
def test_order(name):
    """The error falls with the method's order, all kinds of elements at work in a world with everything."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = smooth_motion()
    steps = FINER.get(name, 1) * np.array([32, 64, 128])
    errors = []
    for n in steps:
        near_x, near_v = advance(name, world, x, v, rest, rate, duration / n, n)
        errors.append(np.linalg.norm(near_x - true_x) + duration * np.linalg.norm(near_v - true_v))
    order = np.polyfit(np.log(duration / steps), np.log(errors), 1)[0]
    assert abs(order - INTEGRATORS[name].order) <= 0.15, f"measured order {order:.3f}, errors {errors}"


@pytest.mark.parametrize("name", ADAPTIVE)
def test_adaptive_is_exact(name):
    """An adaptive method ends where the true motion ends, to its tolerance, on this body and on one without springs."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = smooth_motion()
    near_x, near_v = advance(name, world, x, v, rest, rate, duration, 1)
    assert np.abs(near_x - true_x).max() < 5e-9 * np.linalg.norm(true_x - x)
    assert np.abs(near_v - true_v).max() < 5e-9 * np.linalg.norm(true_v)
    body = BODIES["block"]
    x, v = bent("block", np.random.default_rng(7))
    vacuum, none, h = small_bodies.completed_world(VACUUM), np.zeros(0), 1.0 / np.sqrt(body.elastic_rate)
    moved = advance(name, vacuum, x, v, none, none, h, 1, body)
    wanted = naive.advance(name, body, vacuum, none, none, x, v, h, 1)
    np.testing.assert_allclose(moved[0] - x, wanted[0] - x, rtol=0, atol=1e-7 * np.abs(wanted[0] - x).max())
    np.testing.assert_allclose(moved[1], wanted[1], rtol=0, atol=1e-7 * np.abs(wanted[1]).max())


@pytest.mark.parametrize("name", INTEGRATORS)
def test_batch_is_one_by_one(name):
    """Bodies moved in one call end, bit for bit, where each ends alone; a failed one in their midst stands still."""
    rng, rest = np.random.default_rng(10), ALL.springs.rest_length
    world = small_bodies.world_with_all(ALL, offset=-100.0 if name in ADAPTIVE else 0.04)
    states = [small_bodies.shaken(ALL, rng) for _ in range(3)]
    batch = small_bodies.start(*map(np.array, zip(*states, strict=True)))
    batch.failure[1] = TORN
    h = 0.1 / np.sqrt(ALL.elastic_rate)
    INTEGRATORS[name].advance(ALL, world, batch, small_bodies.control(rest, copies=3), h, 5)
    np.testing.assert_array_equal(batch.x[1], states[1][0])
    for b in (0, 2):
        alone = small_bodies.start(*states[b])
        INTEGRATORS[name].advance(ALL, world, alone, small_bodies.control(rest), h, 5)
        np.testing.assert_array_equal(batch.x[b], alone.x[0])
        np.testing.assert_array_equal(batch.v[b], alone.v[0])


# What is refused

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
GOOD = [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("nodes", "options", "text"),
    [
        ([GOOD, [0, 1, 2, 4]], {}, r"tetrahedron 1, of the nodes \[0, 1, 2, 4\], is flat"),
        ([GOOD, [1, 2, 4, 3]], {}, r"tetrahedron 1, of the nodes \[1, 2, 4, 3\], is inverted"),
        ([GOOD, [4, 1, 1, 3]], {}, r"tetrahedron 1, of the nodes \[4, 1, 1, 3\], names a node twice"),
        ([GOOD, [1, 4, 2, 3], [1, 2, 0, 3]], {}, r"tetrahedron 2, of the nodes \[1, 2, 0, 3\], is there twice"),
        ([[0, 1, 2, 7]], {}, "tetrahedra name node 7, which is missing; nodes are numbered 0 to 4"),
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
        ([TETRAHEDRON, TETRAHEDRON[:3]], {}, r"chamber 1 is open at the edge from node 0 to 2; close its surface"),
        ([[*TETRAHEDRON[:3], [0, 2, 3, 3]]], {}, r"chamber 0 is open at the edge from node 0 to 2"),
        ([np.array(TETRAHEDRON)[:, [1, 0, 2, 3]]], {}, r"chamber 0 encloses -0.166667; give its faces counter-clock"),
        ([SQUARE, SQUARE[:3]], {}, "chamber 1 is open at node 0; give a closed ring"),
        ([np.array(SQUARE)[:, ::-1]], {}, "chamber 0 encloses -1; give its faces counter-clockwise"),
        ([[[0, 1, 2, 2], [0, 2, 1, 1]]], {}, "chamber 0 encloses 0; give its faces"),
        ([[]], {}, "chamber 0 has no faces; give a closed surface"),
        ([[[0, 1, 9, 9]]], {}, "faces of chamber 0 name node 9, which is missing"),
        ([TETRAHEDRON], {"pressure": 0.0}, r"pressure \(Pa\) is 0.0 at \(0,\); give positive"),
        ([TETRAHEDRON], {"ambient": -1.0}, r"ambient \(Pa\) is -1.0 at \(0,\); give zero or positive"),
    ],
)
def test_chambers_refused(surfaces, options, text):
    """Chambers that are open, inside out or empty are refused by their number, with the place where they are open."""
    with pytest.raises(ValueError, match=text):
        make_chambers(CORNERS, surfaces, **{"pressure": 1.0, **options})


@pytest.mark.parametrize(
    ("faces", "inner", "energy", "text"),
    [
        ([[1, 2, 3], [0, 1, 2]], [0, 3], 1.0, r"guard 1: node 3 is not behind the face \[0, 1, 2\]; give outer faces"),
        ([[0, 1, 2]], [4], 1.0, r"guard 0: node 4 is not behind the face \[0, 1, 2\]"),
        ([[0, 1], [0, 2]], [4, 1], 1.0, r"guard 1: node 1 is not behind the face \[0, 2\]"),
        ([[1, 2, 3]], [0], 0.0, r"energy of the guards \(J\) is 0.0 at \(0,\); give positive"),
        ([[1, 2, 3]], [0, 1], 1.0, "there are 2 inner nodes for 1 faces; give one each"),
        ([[1, 2, 9]], [0], 1.0, "faces of the guards name node 9, which is missing"),
        ([[1, 2, 3]], [9], 1.0, "inner nodes name node 9, which is missing"),
    ],
)
def test_guards_refused(faces, inner, energy, text):
    """Guards whose node is not behind their face are refused by their number."""
    with pytest.raises(ValueError, match=text):
        make_guards(CORNERS, faces, inner, energy)


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ({"mass": [1.0, 1, 0, 1, 1]}, r"mass \(kg\) is 0.0 at \(2,\); give positive"),
        ({"mass": [1.0, 1, 1, 1, -2]}, r"mass \(kg\) is -2.0 at \(4,\)"),
        ({"tets": make_tets(np.vstack([CORNERS, [[2, 2, 2]]]), [[1, 4, 2, 5]], 1.0, 0.3)}, "tets name node 5"),
        ({"chambers": make_chambers(np.vstack([CORNERS, [[0, 0, 2]]]),
                                    [np.where(np.array(TETRAHEDRON) == 3, 5, TETRAHEDRON)], 1.0)},
         "chambers name node 5"),
        ({"guards": make_guards(np.vstack([CORNERS, [[0, 0, -1]]]), [[0, 1, 2]], [5], 1.0)}, "guards name node 5"),
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
        (([0, -1], np.zeros(3), 1.0), "anchors name node -1, which is missing"),
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
