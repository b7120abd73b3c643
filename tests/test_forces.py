"""Forces of every kind against their references, what theory says of springs and water."""

from functools import cache

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from moving import FISH, Block, close, force, rows, tiered
from naive.steps import filtered_matrix

from fish_env import make_fish, make_water
from fish_env.physics import forces
from fish_env.physics.body import make_body, scale_body
from fish_env.physics.failures import STRETCH_LIMIT
from fish_env.physics.forces import FORCES, rest_matrices
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.forces.springs import MOST_COMPRESSED
from fish_env.physics.linalg import rates
from fish_env.physics.records import World
from fish_env.physics.tank_options import apply_variation
from fish_env.physics.world import VACUUM

pytestmark = pytest.mark.usefixtures("kernels")
seeds = st.integers(0, 2**32 - 1)
LAWS = {"mass_spring": "quadratic", "published": "linear"}
ELEMENTS = {
    "block": ("tets",), "linear block": ("tets",), "green block": ("green_lagrange",),
    "compartment": ("springs", "pressure"), "two layers": ("springs", "tets", "pressure", "barriers"),
    "rings": ("springs", "pressure", "barriers"), "mass_spring": ("springs",), "published": ("springs",),
}  # fmt: skip
"""Bodies, and their internal forces; but for the fish they are those of small_bodies.py."""
INTERNAL = [(name, part) for name, parts in ELEMENTS.items() for part in parts]
each_body = pytest.mark.parametrize("name", tiered(ELEMENTS, "all"))
each_internal = pytest.mark.parametrize(("name", "part"), rows(INTERNAL))
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


@cache
def scene(name):
    """The body of this name, and its world: of a fish water; of others also gravity, air, anchors and walls, far."""
    if name in FISH:
        flow = naive.dense_water(FISH[name], LAWS[name], (0.3, -0.2, 0.1))
        return FISH[name].body, World(*flow, friction=make_water(friction=20.0).friction, oblique=0.3, thinning=5.0)
    import small_bodies

    return small_bodies.BODIES[name], small_bodies.world_with_all(small_bodies.BODIES[name])


def random_state(name, seed):
    """Positions, velocities and rest lengths of a body in motion; a spring of a fish is compressed strongly."""
    rng, natural = np.random.default_rng(seed), scene(name)[0].springs.rest_length
    if name in FISH:
        x, v = naive.random_state(FISH[name], rng)
    else:
        import small_bodies

        x, v = small_bodies.bent(name, rng)
    rest = natural * rng.uniform(0.9, 1.1, natural.size)
    rest[: 1 if name in FISH else 0] *= 1.5
    return x, v, rest


def reference_force(part, body, world, x, v, rest):
    """Force (N,3) of one kind by its reference implementation."""
    match part:
        case "springs":
            return naive.spring_force(body.springs, rest, x, v)
        case "water":
            return naive.water_force(body, world, x, v)
        case "pressure":
            return naive.gas_force(body.compartments, x)
        case "barriers":
            return naive.barrier_force(body.barriers, x)
        case "anchors":
            return naive.anchor_force(world.anchors, x, v)
        case "gravity":
            return body.mass[:, None] * world.gravity - world.viscosity * v
    return naive.tet_force(body, x, v)


# Every kernel equals its reference


@pytest.mark.parametrize(("name", "part"), rows([*INTERNAL, *((name, "water") for name in ("two layers", *FISH)),
                                                 ("two layers", "anchors"), ("two layers", "gravity")]))  # fmt: skip
@settings(max_examples=5)
@given(seed=seeds)
def test_force(name, part, seed):
    """The force of every kind is that of the textbook's formulas."""
    (body, world), (x, v, rest) = scene(name), random_state(name, seed)
    wanted = reference_force(part, body, world, x, v, rest)
    assert np.abs(wanted).max() > 0
    close(force(part, body, world, x, v, rest), wanted)


@each_body
def test_energies(name):
    """The energies are the textbook's; the gradient of their sum is minus the force on a body that does not move."""
    (body, world), (x, v, rest) = scene(name), random_state(name, 5)
    world = world._replace(linear=0.0, quadratic=0.0, friction=0.0)
    evaluator, still = Evaluator(body, world), np.zeros_like(x)
    found = evaluator.energies(rest, x, v)
    wanted = {"kinetic": naive.kinetic_energy(body.mass, v)}
    for part in ELEMENTS[name]:
        wanted[part] = {
            "springs": lambda: naive.spring_energy(body.springs, rest, x),
            "tets": lambda: naive.tet_energy(body, x), "green_lagrange": lambda: naive.tet_energy(body, x),
            "pressure": lambda: naive.gas_energy(body.compartments, x),
            "barriers": lambda: naive.barrier_energy(body.barriers, x),
        }[part]()  # fmt: skip
    if world.anchors is not None:
        wanted |= {"gravity": naive.weight_energy(body, world, x), "anchors": naive.anchor_energy(world.anchors, x)}
        world = world._replace(anchors=world.anchors._replace(velocity=np.zeros((3, 3))))
    assert {part: found[part] for part in wanted} == pytest.approx(wanted, rel=1e-12)
    assert all(value == 0.0 for part, value in found.items() if part not in wanted)
    assert min(abs(found[part]) for part in wanted) > 0
    evaluator, step, rng = Evaluator(body, world), 1e-4 * np.ptp(body.position), np.random.default_rng(5)
    force = evaluator.force(rest, x, still)
    for way in rng.uniform(-1, 1, (4, *x.shape)):
        slope = 0.0
        for shift, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):  # differences of fourth order
            slope += weight * sum(evaluator.energies(rest, x + shift * step * way, still).values()) / step
        assert (force * way).sum() == pytest.approx(-slope, abs=1e-7 * np.abs(force).max())


@each_body
def test_total(name):
    """The sum of all forces is that of the references, also with cached data; its change is that of the water's.

    The cached sum is that of a step of no duration: the water then pushes no more than stops its face.
    """
    (body, world), (x, v, rest) = scene(name), random_state(name, 3)
    evaluator = Evaluator(body, world)
    for _ in range(2):  # whatever was evaluated before
        close(evaluator.force(rest, x, v), naive.total_force(body, world, rest, x, v))
        close(evaluator.force(rest, x, 2 * v), naive.total_force(body, world, rest, x, 2 * v))
    block, still = Block(None, body, world, rest_length=rest, h=0.0), world._replace(viscosity=0.0)
    found = block.set(x, v).add("add_force_cached", "add_force")
    close(found, naive.total_force(body, still, rest, x, v))  # the drag of the air acts by itself
    if len(body.faces.nodes):
        later = v + 0.1 * np.abs(v).max() * np.random.default_rng(4).normal(size=v.shape)
        change = naive.water_force(body, world, x, later) - naive.water_force(body, world, x, v)
        close(block.add("add_change", v=later), change)


@pytest.mark.parametrize("name", tiered(ELEMENTS, ("two layers", "mass_spring")))
def test_derivatives(name):
    """The exact derivatives are the differences of the textbook forces, of all forces together."""
    (body, world), (x, v, rest) = scene(name), random_state(name, 3)
    found, some = Evaluator(body, world).jacobian(rest, x, v), range(0, x.size, 5)
    wanted = naive.derivatives(lambda x, v: naive.total_force(body, world, rest, x, v), x, v, 2e-5, 1e-3, some)
    for part in range(2):
        close(found[part][:, some], wanted[part][:, some], 1e-6)
    assert np.abs(found[0] - found[0].T).max() > 1e-6 * np.abs(found[0]).max()


@pytest.mark.parametrize("projected", [False, True])
@each_body
def test_system(name, projected):
    """The matrix of the linearly implicit methods, with the water, and the restoring force of its K are the dense ones.

    Projected, that of a fish has no negative eigenvalue; otherwise a compressed one has.
    """
    (body, world), (x, v, rest), h = scene(name), random_state(name, 4), 0.02
    lowest = 0.0 if projected else -np.inf
    stiffness, damping = naive.implicit_matrices(body, world, rest, x, v, projected, wet=True)
    block = Block(None, body, world, rest_length=rest, h=h, lowest=lowest).set(x, v)
    close(block.matrix("add_system") + block.matrix("add_damping"), h * damping + h**2 * stiffness)
    y = np.random.default_rng(4).normal(size=x.shape)
    implicit = tuple(name for name in block.names if hasattr(FORCES[name], "add_system"))
    pull = Block(implicit, body, world, rest_length=rest, h=h, lowest=lowest).set(x, v)
    pull.blocks("add_system")
    close(pull.add("add_tangent", v=y).ravel(), -stiffness @ y.ravel())
    close(block.add("add_tangent", v=y), pull.add("add_tangent", v=y))  # gas stays explicit
    if name in FISH:
        undamped = body._replace(springs=body.springs._replace(damping=np.zeros(91)))
        block = Block(None, undamped, world, rest_length=1.3 * body.springs.rest_length, h=1.0, lowest=lowest)
        values = np.linalg.eigvalsh(block.set(x, v).matrix("add_system"))
        assert values[0] > -1e-13 * values[-1] if projected else values[0] < -1e-6 * values[-1]
        values = np.linalg.eigvalsh(block.matrix("add_damping"))
        assert values[0] > -1e-13 * values[-1] and values[-1] > 0


def test_system_is_part_of_the_derivatives():
    """At rest, the springs' matrix is their exact derivative; square to a flow, so is that of the water."""
    (body, around), (x, v, rest), h = scene("mass_spring"), random_state("mass_spring", 6), 0.37
    stiffness, damping = Evaluator(body, around, ("springs",)).jacobian(rest, x, 0 * v)
    block = Block(("springs",), body, around, rest_length=rest, h=0.0, inner=h).set(x, 0 * v)
    close(block.matrix("add_system"), h * damping + h**2 * stiffness)
    plate, world = make_body(SQUARE, np.ones(4), [], [], [], [], [(0, 1, 2, 3)]), make_water()
    for speed in (0.7, -0.7):
        flow = np.tile([0.0, 0.0, speed], (4, 1))
        stiffness, damping = Evaluator(plate, world).jacobian(np.zeros(0), SQUARE, flow)
        assert (stiffness.any(), damping.any()) == (speed > 0, speed > 0)  # a face that moves inward feels nothing
        np.testing.assert_allclose(
            Block(("water",), plate, world, h=1.0).set(SQUARE, flow).matrix("add_damping"), damping, atol=1e-9
        )


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(("factor", "least"), [(1.3, 0.0), (1e-9, 0.6)])
@each_body
def test_tangent(name, factor, least, many):
    """The stiffness by which a step is filtered is the dense matrix of every kind of elements and anchors.

    With many stages, tetrahedra assemble theirs on their sides. A compressed spring has that of MOST_COMPRESSED.
    """
    (body, world), (x, v, rest), h, stages = scene(name), random_state(name, 7), 0.02, 0
    if name in FISH:
        i, j = body.springs.nodes[0]
        assert 1.0 - rest[0] / np.linalg.norm(x[j] - x[i]) < MOST_COMPRESSED
    else:
        from fish_env.soft.forces.tets import MANY_STAGES

        stages = MANY_STAGES - 1 + many
    block = Block(None, body, world, rest_length=rest, h=h, factor=factor, least=least, stages=stages).set(x, v)
    y = np.random.default_rng(7).normal(size=x.shape)
    wanted = -filtered_matrix(body, world, rest, h, least, x, factor) @ y.ravel()
    for _ in range(2):  # nothing is left of the step before
        block.add("add_force_cached", "add_force")
        close(block.add("add_tangent", v=y).ravel(), wanted)
        block.set(x, v)


def test_system_of_the_added_mass():
    """The blocks of a turned, bent fish in water with inertia are, column by column, what `add_inertia` adds."""
    fish = make_fish(water="reactive")
    x, _ = naive.random_state(fish, np.random.default_rng(8), displacement=0.002)
    x = x @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    block = Block(("reactive",), fish.body, fish.water, h=0.01).set(x, np.zeros_like(x))
    columns = [block.add("add_inertia", v=way.reshape(x.shape)).ravel() for way in np.eye(x.size)]
    close(block.matrix("add_system"), np.array(columns).T)


@each_body
def test_rest_matrices(name):
    """The element matrices of all kinds at rest add up to the dense stiffness and damping."""
    body, _ = scene(name)
    for elastic, kind in ((True, "stiffness"), (False, "damping")):
        close(rates.assemble(rest_matrices(body, elastic), body.position.size), naive.stiffness_matrix(body, kind))


each_scaled = pytest.mark.parametrize("name", tiered(("mass_spring", "two layers"), "all"))


@each_scaled
def test_scaled(name):
    """Factors on stiffness and damping of a body multiply its elastic and viscous forces, of all kinds of elements."""
    (body, world), (x, v, _) = scene(name), random_state(name, 6)
    rest, found = body.springs.rest_length, []
    for each in (body, twice := scale_body(body, 3.0, 5.0, 2.0)):
        evaluator = Evaluator(each, world, forces.present(body, VACUUM))
        elastic, both = (evaluator.force(rest, x, velocity) for velocity in (0 * v, v))
        found.append((elastic, both - elastic))
        for value, kind in ((each.max_stiffness_eigenvalue, "stiffness"), (each.max_damping_eigenvalue, "damping")):
            assert value == pytest.approx(naive.highest_rate(each, naive.stiffness_matrix(each, kind)), rel=1e-12)
    np.testing.assert_array_equal(twice.mass, 2.0 * body.mass)
    close(found[1][0], 3.0 * found[0][0])
    close(found[1][1], 5.0 * found[0][1], 1e-11)


@each_scaled
@settings(max_examples=5)
@given(seed=seeds)
def test_variation_is_a_scaled_body(name, seed):
    """A varied fish has, over its factor on mass, the forces of a scaled body; anchors and air do not scale."""
    rng, (x, v, _), (body, world) = np.random.default_rng(seed), random_state(name, seed), scene(name)
    (stiffness, mass, drag), current = rng.uniform(0.5, 2.0, 3), rng.uniform(-1, 1, 3)
    found = Block(None, body, world, variation=[stiffness, mass, drag, *current]).set(x, v).add("add_force")
    _, around = apply_variation(body, world, [stiffness, mass, drag, *current])
    scaled = scale_body(body, stiffness, stiffness, mass)
    close(mass * found, naive.total_force(scaled, around, body.springs.rest_length, x, v))


# Internal forces in theory


@each_internal
@settings(max_examples=10)
@given(seed=seeds)
def test_no_resultant(name, part, seed):
    """No kind of elements pushes the whole body; none but plain linear ones turns it. Nor does damping push it."""
    (body, world), (x, v, rest) = scene(name), random_state(name, seed)
    f, moving = (force(part, body, world, x, velocity, rest) for velocity in (0 * v, v))
    size = np.abs(f).max()
    if part == "pressure":  # the push of the gas on every face, before the sum cancels
        volume = np.array([naive.gas_volume(body.compartments, c, x)[0] for c in range(body.compartments.gas.size)])
        size = max(body.compartments.gas / volume) * (0.1 if name == "rings" else 0.01)
    rounding = 1e-14 * (100 if part == "springs" else 1)
    assert np.abs(f.sum(axis=0)).max() <= rounding * size
    assert np.abs(moving.sum(axis=0)).max() <= rounding * np.abs(moving).max()
    torque = np.abs(np.cross(x - x.mean(axis=0), f).sum(axis=0)).max()
    assert torque > 1e-5 * size if name == "linear block" else torque <= rounding * size


DAMPED = [("block", "tets"), ("green block", "green_lagrange"), ("mass_spring", "springs"), ("published", "springs")]


@pytest.mark.parametrize(("name", "part"), rows(DAMPED))
@settings(max_examples=10)
@given(seed=seeds)
def test_damping_only_takes_energy_away(name, part, seed):
    """The viscous part takes energy from every motion but a rigid one; for tetrahedra, one of the body at rest.

    Corotational strain is damped in the elements' frames, so a rigid motion of a strained body is damped a little: by
    no more than strain times viscosity. Quadratic strain has no rate in a rigid motion, nor has a spring.
    """
    rng, (body, world) = np.random.default_rng(seed), scene(name)
    x, v, rest = random_state(name, seed)

    def drag(x, v):
        return force(part, body, world, x, v, rest) - force(part, body, world, x, 0 * v, rest)

    assert np.sum(drag(x, v) * v) < 0
    spin, shift = np.cross(rng.normal(size=3), np.eye(3)), rng.normal(size=3)
    rigid = np.abs(drag(x, x @ spin + shift)).max()
    if part == "springs":
        stiff = body.springs.stiffness.max() * np.ptp(x)
        assert rigid <= 1e-13 * (body.springs.damping.max() * np.abs(x @ spin + shift).max() + stiff)
        return
    size = 2e4 * 2e-3 * 0.1 * 0.1 * np.linalg.norm(spin)  # viscosity times area times rate
    undeformed = body.position @ naive.turned(rng).T
    elastic = np.abs(undeformed).max() * np.abs(naive.stiffness_matrix(body)).max()
    assert np.abs(drag(undeformed, undeformed @ spin + shift)).max() <= 1e-15 * (10 * size + elastic)
    strain = max(np.abs(naive.strain_of(r, f)).max() for *_, f, r in naive.tets_of(body, x))
    assert rigid <= 1e-15 * (10 * size + elastic) if part == "green_lagrange" else rigid < 10 * strain * size


@pytest.mark.parametrize("name", FISH)
def test_torn_spring(name):
    """A spring is torn beyond STRETCH_LIMIT times its natural length, and no sooner."""
    (body, world), (x, v, _) = scene(name), random_state(name, 5)
    springs, ends = body.springs, x[body.springs.nodes]
    ratio = (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / springs.rest_length).max()
    for part, torn in ((1 - 1e-12, False), (1 + 1e-12, True)):
        natural = springs.rest_length * ratio / (part * STRETCH_LIMIT)
        varied = body._replace(springs=springs._replace(rest_length=natural))
        assert bool(Block(("springs",), varied, world).set(x, v).number("failed")) == torn


# Water in theory


@given(
    name=st.sampled_from(list(FISH)), displacement=hnp.arrays(float, (23, 3), elements=st.floats(-0.3, 0.3)),
    velocity=hnp.arrays(float, (23, 3), elements=st.floats(-10, 10)),
    current=hnp.arrays(float, 3, elements=st.floats(-3, 3)),
)  # fmt: skip
def test_water_only_takes_energy_away(name, displacement, velocity, current):
    """The water does no positive work on the motion through it, and only that motion counts, however the body moves."""
    fish, body, world = FISH[name], FISH[name].body, scene(name)[1]._replace(current=current)
    x, v = body.position + fish.length * displacement, fish.length / fish.contraction_time * velocity
    f = force("water", body, world, x, v)
    work = f * (v - current)
    assert work.sum() <= 1e-14 * np.abs(work).sum()
    still = force("water", body, world._replace(current=np.zeros(3)), x, v - current)
    np.testing.assert_allclose(still, f, rtol=0, atol=1e-11 * max(1e-3, np.abs(f).max()))


@pytest.mark.parametrize("faces", [[(0, 1, 2, 3)], [(0, 1, 2, 2), (0, 2, 3, 3)]], ids=["quadrilateral", "triangles"])
@given(seed=seeds, size=st.floats(0.1, 10), speed=st.floats(1e-3, 1e3), outward=st.booleans())
def test_flat_plate(faces, seed, size, speed, outward):
    """A plate moving along its normal at speed U is pushed back with half rho C_d A U^2; the other way, not at all."""
    turn = naive.turned(np.random.default_rng(seed))
    corners, normal = size * SQUARE @ turn.T, turn[:, 2]
    body, v = (
        make_body(corners, np.ones(4), [], [], [], [], faces),
        np.tile(normal * speed * (1 if outward else -1), (4, 1)),
    )
    for world, wanted in ((make_water(998.0, 1.17), 0.5 * 998.0 * 1.17 * size**2 * speed**2),
                          (make_water(drag_coefficient=1.17, law="linear"), 1.17 * size**2 * speed)):  # fmt: skip
        f = force("water", body, world, corners, v).sum(axis=0)
        np.testing.assert_allclose(f, -wanted * outward * normal, rtol=0, atol=1e-12 * wanted)


@pytest.mark.parametrize("law", ["quadratic", "linear"])
@given(seed=seeds, length=st.floats(0.05, 5.0), speed=st.floats(1e-3, 10.0), angle=st.floats(0.0, 6.3))
def test_plate_along_itself(law, seed, length, speed, angle):
    """A plate moved along itself, however turned, has a factor times the friction of Blasius; at rest it has none."""
    turn, world = naive.turned(np.random.default_rng(seed)), make_water(998.0, 1.17, law, friction=2.5, thinning=9.0)
    plate = make_body(length * SQUARE, np.ones(4), [], [], [], [], [(0, 1, 2, 3)], drag=[0.3])
    ahead = turn @ [np.cos(angle), np.sin(angle), 0.0]
    f = force("water", plate, world, length * SQUARE @ turn.T, np.tile(speed * ahead, (4, 1))).sum(axis=0)
    drag = 0.5 * 998.0 * 2.5 * 1.328 / np.sqrt(speed * length / 1e-6) * length**2 * speed**2
    np.testing.assert_allclose(f, -drag * ahead, rtol=0, atol=1e-9 * drag)
    still = Evaluator(plate, world)
    assert not still.force(np.zeros(0), length * SQUARE, np.zeros((4, 3))).any()
    assert not np.any(still.jacobian(np.zeros(0), length * SQUARE, np.zeros((4, 3))))


@given(seed=seeds, speed=st.floats(1e-3, 10.0), angle=st.floats(0.05, 1.5))
def test_plate_at_an_angle(seed, speed, angle):
    """In cross-flow a plate feels, along its normal, the velocity along it alone; friction grows with the angle."""
    turn, length, thinning = naive.turned(np.random.default_rng(seed)), 0.4, 7.0
    world = make_water(998.0, 1.17, "cross_flow", friction=2.5, thinning=thinning)
    plate = make_body(length * SQUARE, np.ones(4), [], [], [], [], [(0, 1, 2, 3)])
    across, along = speed * np.sin(angle), speed * np.cos(angle)
    v = np.tile(turn @ [along, 0.0, across], (4, 1))
    f = turn.T @ force("water", plate, world, length * SQUARE @ turn.T, v).sum(axis=0)
    rough = 0.5 * 998.0 * 2.5 * 1.328 * np.sqrt(1e-6 * speed / length) * length**2 * along
    rough *= 1.0 + thinning * np.sin(angle) ** 2
    wanted = np.array([-rough, 0.0, -0.5 * 998.0 * 1.17 * length**2 * across**2])
    np.testing.assert_allclose(f, wanted, rtol=1e-9, atol=1e-14 * np.abs(wanted).max())


def test_make_water():
    """Water holds the coefficient of its law and no other: half density times drag coefficient, or the linear one."""
    quadratic, linear = make_water(998.0, 1.2, current=(1, 2, 3)), make_water(drag_coefficient=3.0, law="linear")
    assert (quadratic.linear, quadratic.quadratic) == (0.0, 0.5 * 998.0 * 1.2)
    np.testing.assert_array_equal(quadratic.current, [1.0, 2.0, 3.0])
    assert (linear.linear, linear.quadratic) == (3.0, 0.0)
    assert (quadratic.friction, linear.friction) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"law": "cubic"}, "unknown water law 'cubic'; choose from 'quadratic', 'cross_flow', 'linear'"),
        ({"density": -1.0}, "density is -1.0"),
        ({"density": float("nan")}, "density is nan"),
        ({"density": [1.0]}, "density is"),
        ({"friction": -1.0}, "friction is -1.0; give a finite number, zero or positive"),
        ({"thinning": -1.0}, "thinning is -1.0; give a finite number, zero or positive"),
        ({"viscosity": float("nan")}, "viscosity is nan"),
        ({"friction": 1e308, "density": 1e9}, "friction .* is infinite; give less"),
        ({"drag_coefficient": float("inf")}, "drag_coefficient is inf"),
        ({"current": (0.0, 0.0)}, r"current \(m/s\) has shape \(2,\); give shape \(3,\)"),
        ({"current": (0.0, float("nan"), 0.0)}, r"current \(m/s\) is nan at \(1,\)"),
        ({"current": "fast"}, "current .* is 'fast'"),
    ],
)
def test_make_water_refuses(arguments, text):
    """Water with an unknown law or an invalid number raises an error that says what is allowed."""
    with pytest.raises(ValueError, match=text):
        make_water(**arguments)
