"""Tetrahedra, gas and guards: their forces, energies, derivatives, and what is known of them without computing them."""

from functools import partial

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from small_bodies import ALL, BODIES, bent, close

from fish_env import forces
from fish_env.body import scaled
from fish_env.forces import guards, pressure, tets
from fish_env.world import VACUUM

PARTS = [
    (name, part)
    for name, body in BODIES.items()
    for part in ("tets", "chambers", "guards")
    if len(getattr(body, part)[0])
]
seeds = st.integers(0, 2**32 - 1)
each_part = pytest.mark.parametrize(("name", "part"), PARTS)


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
