"""Tetrahedra, gas and barriers: their forces, energies, derivatives, and what is known of them by theory."""

from functools import partial

import naive
import numpy as np
import pytest
import small_bodies
from hypothesis import given, settings
from hypothesis import strategies as st
from kernels import Block, energy, force
from moving import tiered
from naive.leapfrog import filtered_matrix
from small_bodies import ALL, BODIES, bent, close

from fish_env.physics.body import scaled
from fish_env.physics.forces import FORCES, rest_matrices, tets
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.linalg import rates
from fish_env.physics.world import VACUUM

MODULES = {"tets": "tets", "compartments": "pressure", "barriers": "barriers"}
"""The force of each part of a body."""
PARTS = [(name, part) for name, body in BODIES.items() for part in MODULES if len(getattr(body, part)[0])]
seeds = st.integers(0, 2**32 - 1)
each_part = pytest.mark.parametrize(("name", "part"), PARTS)


def module_of(part, body):
    """The force of a part of a body: that of tetrahedra depends on their measure of strain."""
    return "green_lagrange" if part == "tets" and body.tets.quadratic else MODULES[part]


def force_of(part, body, x, v):
    """What the kernel of one kind of elements adds to no force."""
    return force(module_of(part, body), body, VACUUM, x, v)


def energy_of(part, body, x):
    """What the kernel of one kind of elements takes for its energy."""
    return energy(module_of(part, body), body, VACUUM, x)


def reference_of(part, body, x, v):
    """Force and energy of one kind of elements by the reference implementation."""
    if part == "tets":
        return naive.tet_force(body, x, v), naive.tet_energy(body, x)
    if part == "compartments":
        return naive.gas_force(body.compartments, x), naive.gas_energy(body.compartments, x)
    return naive.barrier_force(body.barriers, x), naive.barrier_energy(body.barriers, x)


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
def test_kernels_equal_their_reference(name, part, seed):
    """Force and energy of tetrahedra, gas and barriers are those of the textbook's formulas."""
    body = BODIES[name]
    x, v = bent(name, np.random.default_rng(seed))
    wanted, stored = reference_of(part, body, x, v)
    assert np.abs(wanted).max() > 0  # barriers too are at work
    close(force_of(part, body, x, v), wanted)
    assert energy_of(part, body, x) == pytest.approx(stored, rel=1e-12)


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


@pytest.mark.parametrize("name", tiered(BODIES, ("two layers",)))
def test_total_and_its_derivatives(name):
    """All forces in a world with everything are the sum of the references, cached or not; so are the derivatives.

    In a step of no duration, for what is cached: no push of the water is then more than what stops its face.
    """
    body, rng = BODIES[name], np.random.default_rng(3)
    x, v = bent(name, rng)
    world = small_bodies.world_with_all(body)
    rest = body.springs.rest_length
    evaluator = Evaluator(body, world)
    close(evaluator.force(rest, x, v), naive.total_force(body, world, rest, x, v))
    cached = Block(None, body, world, h=0.0).set(x, v).add("add_force_cached", "add_force")
    still = world._replace(viscosity=0.0)  # the drag of the air acts by itself
    close(cached, naive.total_force(body, still, rest, x, v))
    stiffness, damping = evaluator.jacobian(rest, x, v)
    wanted = naive.derivatives(lambda x, v: naive.total_force(body, world, rest, x, v), x, v, 2e-5, 1e-3)
    close(stiffness, wanted[0], 1e-7)
    close(damping, wanted[1], 1e-7)


@pytest.mark.parametrize("projected", [False, True])
@pytest.mark.parametrize("name", BODIES)
def test_system_equals_its_reference(name, projected):
    """What the forces add to the matrix of the linearly implicit methods, and the pull of its K, are the dense ones."""
    body, rng, h = BODIES[name], np.random.default_rng(4), 0.02
    x, v = bent(name, rng)
    world, rest = small_bodies.world_with_all(body), body.springs.rest_length * 1.05
    stiffness, damping = naive.implicit_matrices(body, world, rest, x, v, projected, wet=True)
    block = Block(None, body, world, rest_length=rest, h=h, lowest=0.0 if projected else -np.inf).set(x, v)
    close(block.matrix("add_system") + block.matrix("add_damping"), h * damping + h**2 * stiffness)
    y = rng.normal(size=x.shape)
    implicit = tuple(name for name in block.names if hasattr(FORCES[name], "add_system"))
    pull = Block(implicit, body, world, rest_length=rest, h=h, lowest=0.0 if projected else -np.inf).set(x, v)
    pull.blocks("add_system")
    close(pull.add("add_tangent", v=y).ravel(), -stiffness @ y.ravel())
    close(block.add("add_tangent", v=y), pull.add("add_tangent", v=y))  # gas stays explicit


@pytest.mark.parametrize("stages", [tets.MANY - 1, tets.MANY])
@pytest.mark.parametrize(("factor", "least"), [(1.3, 0.0), (1e-9, 0.6)])
@pytest.mark.parametrize("name", BODIES)
def test_tangent_equals_its_reference(name, factor, least, stages):
    """What resists the acceleration in a filtered step is the dense matrix of every kind of elements and anchors.

    With few stages as with many, for which tetrahedra share out their stiffness to their sides.
    """
    body, rng, h = BODIES[name], np.random.default_rng(7), 0.02
    x, v = bent(name, rng)
    world, rest = small_bodies.world_with_all(body), body.springs.rest_length * 1.01
    block = Block(None, body, world, rest_length=rest, h=h, factor=factor, least=least, stages=stages).set(x, v)
    y = rng.normal(size=x.shape)
    wanted = -filtered_matrix(body, world, rest, h, least, x, factor) @ y.ravel()
    for _ in range(2):  # nothing is left of the step before
        block.add("add_force_cached", "add_force")
        close(block.add("add_tangent", v=y).ravel(), wanted)
        block.set(x, v)


def test_all_energies():
    """The energies of all kinds, added up, fall by what the forces that come from them do."""
    rng, still = np.random.default_rng(5), np.zeros((20, 3))
    x, v = bent("two layers", rng)
    world, rest = small_bodies.world_with_all(ALL, drag=0.0), ALL.springs.rest_length
    found = Evaluator(ALL, world).energies(rest, x, v)
    wanted = {
        "kinetic": naive.kinetic_energy(ALL.mass, v),
        "springs": naive.spring_energy(ALL.springs, rest, x),
        "tets": naive.tet_energy(ALL, x),
        "pressure": naive.gas_energy(ALL.compartments, x),
        "barriers": naive.barrier_energy(ALL.barriers, x),
        "gravity": naive.weight_energy(ALL, world, x),
        "anchors": naive.anchor_energy(world.anchors, x),
    }
    assert found == pytest.approx(wanted, rel=1e-12) and min(map(abs, found.values())) > 0
    world = world._replace(anchors=world.anchors._replace(velocity=np.zeros((3, 3))))
    evaluator = Evaluator(ALL, world)
    slope = gradient(lambda x: sum(evaluator.energies(rest, x, still).values()), x, 2e-5)
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
    if part == "compartments":  # what the gas does before the sum cancels: the push on every face
        volume = np.array([naive.gas_volume(body.compartments, c, x)[0] for c in range(body.compartments.gas.size)])
        size = max(body.compartments.gas / volume) * (0.1 if name == "rings" else 0.01)
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
    """Turned and moved, elements feel nothing; plain linear ones take the rotation for strain."""
    rng = np.random.default_rng(seed)
    turn, shift = small_bodies.turned(rng), rng.uniform(-1, 1, 3)
    for name, exact in (("block", True), ("green block", True), ("linear block", False)):
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


@pytest.mark.parametrize("name", ["block", "green block"])
@given(seed=seeds)
def test_damping_only_takes_energy_away(name, seed):
    """The viscous part of the tetrahedra takes energy from every motion but a rigid one of the body at rest.

    The strain whose rate is damped is that in the elements' frames, so that a rigid motion of a strained body is damped
    as the strain goes: by no more than strain times viscosity. Quadratic strain has no rate in a rigid motion.
    """
    rng = np.random.default_rng(seed)
    body, (x, v) = BODIES[name], bent(name, rng)
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
    rigid = np.abs(drag(x, x @ spin + rng.normal(size=3))).max()
    if body.tets.quadratic:
        assert rigid <= 1e-15 * (10 * size + elastic)
    else:
        assert 1e-4 * strain * size < rigid < 10 * strain * size


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
    once, twice = ALL, scaled(ALL, 3.0, 5.0, 2.0)
    found = []
    for body in (once, twice):
        evaluator = Evaluator(body, VACUUM)
        elastic, both = (evaluator.force(rest, x, velocity) for velocity in (still, v))
        found.append((elastic, both - elastic))
    close(found[1][0], 3.0 * found[0][0])
    close(found[1][1], 5.0 * found[0][1], 1e-11)
    for body in (once, twice):
        assert body.max_stiffness_eigenvalue == pytest.approx(
            naive.highest_rate(body, naive.stiffness_matrix(body)), rel=1e-12
        )
        assert body.max_damping_eigenvalue == pytest.approx(
            naive.highest_rate(body, naive.stiffness_matrix(body, "damping")), rel=1e-12
        )


@pytest.mark.parametrize("name", BODIES)
def test_rest_matrices(name):
    """The element matrices of all kinds at rest add up to the dense stiffness and damping."""
    body = BODIES[name]
    for elastic, kind in ((True, "stiffness"), (False, "damping")):
        found = rates.assemble(rest_matrices(body, elastic), body.position.size)
        close(found, naive.stiffness_matrix(body, kind))


@settings(max_examples=20)
@given(seed=seeds)
def test_variation_is_a_scaled_body(seed):
    """A fish set apart has, over its factor on mass, the forces of a body made so; anchors and air do not scale."""
    rng = np.random.default_rng(seed)
    x, v = bent("two layers", rng)
    world = small_bodies.world_with_all(ALL)
    stiffness, mass, drag = rng.uniform(0.5, 2.0, 3)
    current = rng.uniform(-1, 1, 3)
    found = Block(None, ALL, world, variation=[stiffness, mass, drag, *current]).set(x, v).add("add_force")
    body = scaled(ALL, stiffness, stiffness, mass)
    around = world._replace(
        linear=world.linear * drag, quadratic=world.quadratic * drag, current=world.current + current
    )
    close(mass * found, naive.total_force(body, around, ALL.springs.rest_length, x, v))
