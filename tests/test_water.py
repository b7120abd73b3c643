"""Water with inertia, against Lagrange's equations, potential theory and Lighthill's; and the masses of fish."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from moving import FIXED_STEP, inertia, moments, rows, tiered
from naive.forces import added_mass, reactive_force, sections_of, water_energy, water_momentum
from scipy.integrate import quad

import fish_env
from fish_env import INTEGRATORS, Tank, make_fish, make_water
from fish_env.bodies import mass_spring as tu
from fish_env.bodies.masses import WATER_DENSITY, continuum, layer_masses, match_moments
from fish_env.bodies.outline import read_outline
from fish_env.physics.body import fix, scale_body
from fish_env.physics.elements import make_sections
from fish_env.physics.forces.evaluate import Evaluator

WATER = make_water(drag_coefficient=0.0, current=(0.1, -0.2, 0.05), inertia=True, added_mass=(0.9, 0.7), righting=0.0)
BODIES = ("mass_spring", "planar", "two_layer", "tetrahedral")
each_body = pytest.mark.parametrize("name", tiered(BODIES, "all"))
plain = pytest.mark.usefixtures("kernels")


@cache
def trout(name="mass_spring", **options):
    """A fish with a trout's outline."""
    return make_fish(name, outline="trout", **options)


def shaken(body, seed=0, displacement=0.004, speed=0.3):
    """A body in motion: positions and velocities (N,3), none along fixed axes."""
    rng, free = np.random.default_rng(seed), body.inverse_mass > 0
    x = body.position + displacement * rng.normal(size=body.position.shape) * free
    return x, speed * rng.normal(size=x.shape) * free


def own_force(body, world, x, v):
    """Force of the water's inertia alone, with the resistance to the acceleration that it causes, (N,3)."""
    return Evaluator(body, world, ("reactive",)).force(body.springs.rest_length, x, v)


def folded(body, bend, height):
    """Positions with sections bent by `bend` rad each to the left, and upper edges at a part of their height."""
    x, angle, centre = body.position.copy(), 0.0, np.zeros(3)
    middle = [share @ body.position[nodes] for nodes, share in sections_of(body)]
    for k, (nodes, _) in enumerate(sections_of(body)):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, height]])
        x[nodes] = centre + (body.position[nodes] - middle[k]) @ turn.T
        if k + 1 < len(middle):
            centre, angle = centre + turn @ (middle[k + 1] - middle[k]), angle + bend
    return x


@plain
@each_body
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize(("bend", "height"), [(0.0, 1.0), (2.9, 1.0), (np.pi, 0.3)])
def test_equals_lagrange(name, fixed, bend, height):
    """Forces and accelerations are those of Lagrange's equations, by complex steps, also with nodes that are fixed.

    Where a body is folded or flattened, the directions of its sections fade, and the forces stay finite.
    """
    body = trout(name).body
    body = fix(fix(body, [5, 7]), [3], "x") if fixed else body
    x, v = shaken(body)
    x += folded(body, bend, height) - body.position
    wanted, free = reactive_force(body, WATER, x, v), body.inverse_mass.ravel() > 0
    a, inertia = np.zeros(x.size), added_mass(body, WATER, x)
    whole = inertia + np.diag(np.repeat(body.mass, 3))
    a[free] = np.linalg.solve(whole[np.ix_(free, free)], wanted.ravel()[free])
    found = own_force(body, WATER, x, v)
    np.testing.assert_allclose(
        found, wanted - (inertia @ a).reshape(x.shape), rtol=0, atol=1e-11 * np.abs(wanted).max()
    )
    energy = Evaluator(body, WATER, ("reactive",)).energies(body.springs.rest_length, x, v)["reactive"]
    np.testing.assert_allclose(energy, water_energy(body, WATER, x, v), rtol=1e-12)


@plain
def test_derivatives():
    """Exact derivatives contain the resistance to acceleration: those of the force by differences."""
    body = trout().body
    x, v = shaken(body)
    evaluator, rest = Evaluator(body, WATER), body.springs.rest_length
    stiffness, damping = evaluator.jacobian(rest, x, v)
    way = np.random.default_rng(1).normal(size=x.shape)
    for matrix, step in ((stiffness, (1e-8 * way, 0 * way)), (damping, (0 * way, 1e-6 * way))):
        ahead, behind = (evaluator.force(rest, x + sign * step[0], v + sign * step[1]) for sign in (1, -1))
        slope = (behind - ahead).ravel() / 2 / (1e-8 if step[0].any() else 1e-6)
        np.testing.assert_allclose(matrix @ way.ravel(), slope, rtol=0, atol=1e-5 * np.abs(slope).max())


def ellipse(width=0.3, depth=0.8, count=9):
    """A straight body with equal elliptic sections of four nodes, 10 m long: mass, positions, sections."""
    place = np.linspace(0.0, 10.0, count)
    around = np.array([(0, 0.1, 0.1), (0, -0.1, 0.1), (0, -0.1, -0.1), (0, 0.1, -0.1)])
    position = (around + place[:, None, None] * (-1, 0, 0)).reshape(-1, 3)
    mass, nodes = np.full(4 * count, 2.0), np.arange(4 * count).reshape(count, 4)
    outline = place, np.full(count, width), np.full(count, depth)
    return (
        position,
        mass,
        make_sections(position, mass, list(nodes), [nodes[:, :2].ravel(), nodes[:, 2:].ravel()], outline),
    )


@plain
def test_ellipse_and_heaving_plate():
    """Added mass of an ellipse, pi rho times the square of the other half axis (Lamb 1932); of a plate the same.

    A body that heaves as a whole has the energy of that mass, and a force resists nothing but its acceleration.
    """
    density, width, depth = 1025.0, 0.3, 0.8
    position, mass, sections = ellipse(width, depth)
    body = trout().body._replace(position=position, mass=mass, inverse_mass=np.repeat(1.0 / mass[:, None], 3, axis=1),
                                 sections=sections)  # fmt: skip
    world = make_water(density, 0.0, inertia=True, righting=0.0)
    evaluator, rest = Evaluator(body, world, ("reactive",)), body.springs.rest_length
    for axis, half in ((1, depth), (2, width)):
        v, added = np.zeros_like(position), np.pi * density * half**2 * 10
        v[:, axis] = 0.7
        np.testing.assert_allclose(2 * evaluator.energies(rest, position, v)["reactive"] / 0.49, added, rtol=1e-10)
        assert np.abs(evaluator.force(rest, position, v)).max() <= 1e-10 * added
    np.testing.assert_allclose(sections.trailing, np.pi * depth**2, rtol=1e-14)


def test_ellipsoid():
    """What slender-body theory makes too much of the added mass of an ellipsoid (Lamb 1932, art. 114)."""
    outline = read_outline("trout")
    axes = np.array([0.5, outline.widths.max(), outline.depths.max()])
    for moved, across, factor in ((1, 2, 0.91), (2, 1, 0.92)):
        shape = quad(lambda t, s=axes[moved]: 1 / ((s**2 + t) * np.sqrt(np.prod(axes**2 + t))), 0, np.inf)[0]
        gamma = np.prod(axes) * shape
        assert axes[moved] / axes[across] * gamma / (2 - gamma) == pytest.approx(factor, abs=0.005)


def even(s):
    """Amplitude of a wave that stays the same, and its growth, body lengths at places s."""
    return 0.05 + 0.0 * s, 0.0 * s


def growing(s):
    """Amplitude of a wave that grows towards the tail as a fish's does, and its growth."""
    return 0.02 - 0.08 * s + 0.16 * s**2, -0.08 + 0.32 * s


def off_lighthill(fish, length, advance, wave=even):
    """Mean thrust of a swimming wave over that of Lighthill (1971), less 1.

    It is what the trailing edge sheds: with the tail's lateral velocity w and slope, m w (dh/dt) - m w^2 / 2. The wave
    beats once a second; `advance` is how fast the fish swims over how fast the wave runs. Sections move sideways.
    """
    size, s = fish.length, -fish.body.position[:, 0] / fish.length
    body, k, (amplitude, growth) = fish.body, 2 * np.pi / length, wave(np.append(s, 1.0))
    world = make_water(drag_coefficient=0.0, inertia=True, righting=0.0)
    evaluator = Evaluator(body._replace(sections=only_edge(body.sections)), world, ("reactive",))
    found, wanted, m = 0.0, 0.0, 1000.0 * body.sections.trailing
    for phase in 2 * np.pi * np.arange(40) / 40:
        sin, cos = np.sin(k * np.append(s, 1.0) - phase), np.cos(k * np.append(s, 1.0) - phase)
        x, v = body.position.copy(), np.zeros_like(body.position)
        x[:, 1] += size * (amplitude * sin)[:-1]
        v[:, 0], v[:, 1] = advance * length * size, -2 * np.pi * size * (amplitude * cos)[:-1]
        found += evaluator.force(body.springs.rest_length, x, v)[:, 0].sum()
        slope = (growth * sin + amplitude * k * cos)[-1]
        t = np.array([-1.0, slope]) / np.hypot(1.0, slope)  # backward along the midline
        n = np.array([-t[1], t[0]])
        speed = size * np.array([advance * length, -2 * np.pi * (amplitude * cos)[-1]])
        w, u = speed @ n, speed @ t
        wanted += m * u * w * n[0] + 0.5 * m * w**2 * u / np.hypot(u, w) * t[0]
    return found / wanted - 1.0


THRUSTS = [("mass_spring", None, 0.022, 0.06, 0.38), ("tetrahedral", 3, 0.002, 0.04, 0.15)]


@pytest.mark.parametrize(("name", "level", "near", "slow", "fast"), rows(THRUSTS, THRUSTS[:1]))
def test_thrust_of_lighthill(name, level, near, slow, fast):
    """The mean thrust of an even wave is Lighthill's, also of other lengths and speeds; that of a growing one is more.

    The thrust of a wave that grows, and is hardly faster than the fish, is a small difference.
    """
    fish = trout(name) if level is None else trout(name, level=level)
    for length in (0.8, 0.9, 1.0, 1.1, 1.2):
        for advance in (0.5, 0.6, 0.7):
            assert abs(off_lighthill(fish, length, advance)) < near, (length, advance)
    assert 0 < off_lighthill(fish, 0.95, 0.5, growing) < slow < off_lighthill(fish, 0.95, 0.7, growing) < fast


@pytest.mark.parametrize(("parts", "momentum", "energy"), [(1, 1e-3, 3e-3), (4, 1e-4, 3e-3)])
def test_conserved(parts, momentum, energy):
    """Without drag, wake, damping and muscles, momentum drifts with the square of the step, and energy hardly.

    No vibration of the fish for drag is in resonance with these steps; damping, which all fish have, ends those.
    """
    fish = make_fish(water="drag")
    springs, none = fish.body.springs._replace(damping=np.zeros(91)), np.zeros(7)
    sections = fish.body.sections._replace(trailing=0.0, narrowing=none)
    body = fish.body._replace(springs=springs, sections=sections, max_damping_eigenvalue=0.0)
    world = make_water(drag_coefficient=1e-300, inertia=True, righting=1e-300)  # none, with the kernels of a fish
    tank = Tank(replace(fish, body=body), 1, dt=fish.time_step / parts, water=world, refine=np.inf)
    along = 2 * np.pi * body.position[:, 0] / fish.length
    tank.velocity[0] = np.stack([np.full(23, 0.2), 0.1 * np.cos(along), 0.02 * np.sin(along)], axis=1)
    evaluator = Evaluator(body, world)

    def state():
        x, v = tank.position[0], tank.velocity[0]
        total = (body.mass[:, None] * v + water_momentum(body, world, x, v)).sum(axis=0)
        return total, sum(evaluator.energies(springs.rest_length, x, v).values())

    before = state()
    tank.advance(round(2.0 / tank.dt))
    after = state()
    assert tank.alive.all()
    assert np.linalg.norm(after[0] - before[0]) < momentum * np.linalg.norm(before[0])
    assert abs(after[1] / before[1] - 1.0) < energy


def lateral_force(fish, length=0.95, advance=0.7):
    """Lateral force (60,) N of the water on a body that swims by a wave whose amplitude grows towards the tail."""
    s, y = -fish.body.position[:, 0] / fish.length, fish.body.position[:, 1]
    amplitude, growth, wave = 0.02 - 0.08 * s + 0.16 * s**2, -0.08 + 0.32 * s, 2 * np.pi / length
    momentum = []
    for phase in 2 * np.pi * np.arange(60) / 60:
        sin, cos = np.sin(wave * s - phase), np.cos(wave * s - phase)
        slope = growth * sin + amplitude * wave * cos
        turning = 2 * np.pi * (amplitude * wave * sin - growth * cos) / (1 + slope**2)
        angle = np.arctan(slope)
        x, v = fish.body.position.copy(), np.zeros_like(fish.body.position)
        x[:, 0] += y * np.sin(angle)
        x[:, 1] = fish.length * amplitude * sin + y * np.cos(angle)
        v[:, 0] = advance * length * fish.length + y * np.cos(angle) * turning
        v[:, 1] = -2 * np.pi * fish.length * amplitude * cos - y * np.sin(angle) * turning
        momentum.append(water_momentum(fish.body, REACTIVE, x, v)[:, 1].sum())
    return np.fft.irfft(2j * np.pi * np.arange(31) * np.fft.rfft(momentum), 60)


@pytest.mark.soft
def test_sections_converge():
    """The lateral force on the whole body, a rest of parts that nearly cancel, converges with the number of sections.

    Bodies with the same sections have the same force.
    """
    finest = lateral_force(trout("tetrahedral", level=4))
    off = {level: np.linalg.norm(lateral_force(trout("tetrahedral", level=level)) - finest) for level in (1, 2, 3)}
    size = np.linalg.norm(finest)
    assert off[1] < 0.4 * size and off[2] < 0.12 * size and off[3] < 0.035 * size
    for name in ("mass_spring", "planar"):
        np.testing.assert_allclose(
            lateral_force(trout(name)), lateral_force(trout("tetrahedral")), rtol=0, atol=1e-4 * size
        )


def only_edge(sections):
    """Sections that move no water, but shed at the tail: what is left is the mean thrust of a periodic motion."""
    none = np.zeros_like(sections.lateral)
    return sections._replace(lateral=none, vertical=none, narrowing=none)


def swum(name, steps, fish, **options):
    """Positions of fish (B,N,3) after four control intervals, the first moved by both sides in turn."""
    tank = Tank(
        fish, integrator=name, dt=fish.control_interval / steps, refine=np.inf, threads=1, water=REACTIVE, **options
    )
    for side in (1, 1, -1, 1):
        tank.swim(np.where(fish.sides == side, 0.8, -0.5), fish.control_interval)
    assert tank.alive.all()
    return tank.position.copy()


REACTIVE = make_water(drag_coefficient=1.0, inertia=True)
STEPS = {"semi_implicit": 96, "explicit_euler": 768, "symplectic_euler": 96, "linearly_implicit": 48,
         "linearly_implicit_projected": 48, "linearly_implicit_water": 48, "rosenbrock": 24, "leapfrog_chebyshev": 24,
         "midpoint": 96, "rk4": 96}  # fmt: skip


@pytest.mark.parametrize("name", tiered(FIXED_STEP, ("leapfrog_chebyshev", "semi_implicit", "rk4")))
def test_methods_converge(name):
    """Every method tends to the same motion in water with inertia, with its order."""
    fish = trout(water="drag")
    truth = swum("rk4", 768, fish)
    errors = [np.abs(swum(name, STEPS[name] * k, fish) - truth).max() / fish.length for k in (1, 2)]
    falls = errors[0] / errors[1] > 0.8 * 2 ** min(2, INTEGRATORS[name].order)
    assert errors[1] < 3e-4 and (falls or errors[1] < 1e-8), errors


def test_wake_is_of_second_order():
    """With few dampers, whose order is one, a tail that beats while the fish swims sheds with nearly second order."""
    fish = trout(water="drag")
    fish = replace(fish, body=scale_body(fish.body, 3.0, 0.3, 1.0))

    def beaten(name, steps):
        tank = Tank(fish, 1, name, dt=fish.control_interval / steps, refine=np.inf, water=REACTIVE)
        tank.velocity[:] = (0.5, 0.0, 0.0)
        for k in range(20):
            tank.swim(np.where(fish.sides == (1 if k % 10 < 5 else -1), 1.0, -1.0), fish.control_interval)
        return tank.position.copy()

    truth = beaten("rk4", 768)
    errors = [np.abs(beaten("leapfrog_chebyshev", steps) - truth).max() for steps in (24, 48)]
    assert errors[0] > 2.7 * errors[1], errors


def test_factors_of_a_fish():
    """A fish of twice the mass, stiffness and drag, in water of twice the density, moves as the fish itself."""
    fish, tank = trout(), None
    paths = []
    for factor in (1.0, 2.0):
        tank = Tank(fish, 1, water=make_water(1000.0 * factor, 1.0, inertia=True))
        tank.vary(0, stiffness=factor, mass=factor)
        tank.swim(np.where(fish.sides > 0, 1.0, -1.0), 5 * fish.control_interval)
        paths.append(tank.position.copy())
    np.testing.assert_allclose(*paths, rtol=0, atol=1e-12)


def walled():
    """A wall below water with inertia."""
    return fish_env.make_world(planes=[((0, 0, 1), -1.0, 0.0)], water=REACTIVE)


@pytest.mark.parametrize(("make", "words"), [
    (lambda: Tank(make_fish("published"), water=REACTIVE), "'published' has no sections"),
    pytest.param(lambda: Tank(trout(), water=walled()), "beside walls", marks=pytest.mark.soft),
    (lambda: make_water(inertia="yes"), "inertia is 'yes'; give True or False"),
    (lambda: make_water(inertia=True, added_mass=(1.0, -1.0)), "added_mass"),
    (lambda: make_water(righting=np.nan), "righting"),
    (lambda: make_sections(np.zeros((3, 3)), np.ones(3), [[0], [1], [2]], [[0], [1]], [[0, 1]] * 3), "at least four"),
])  # fmt: skip
def test_refused(make, words):
    """What cannot be is refused with the reason."""
    with pytest.raises(ValueError, match=words):
        make()


# Masses: those of the outline by another way, and what the bodies have

PARAMETERS = tu.check_parameters("mass_spring", {})
WANTED = continuum(PARAMETERS)
STRAIGHT = tu.check_parameters("mass_spring", {}, "drag")  # between its layers, with rectangular sections
SOLIDS = [("two_layer", None), *(("tetrahedral", level) for level in (1, 2, 3))]


def tetrahedra(cells):
    """Mass, centre and squares (3,) of the outline cut into tetrahedra, whose own moments are exact; and the mesh."""
    length, stations = STRAIGHT.length, np.arange(6 * cells + 1) / cells
    rows = ([0.0, *STRAIGHT.layer_position, 1.0], [0.0, *STRAIGHT.half_width, 0.0],
            [0.0, *STRAIGHT.half_depth, STRAIGHT.tail_half_span])  # fmt: skip
    along, width, depth = (length * np.interp(stations, np.arange(7), row) for row in rows)
    from fish_env.soft.mesh import grid

    mesh = grid(-along, width, depth, 4, 4)
    corners = mesh.position[mesh.tets]
    mass = WATER_DENSITY * np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    total = mass.sum()
    middle = np.einsum("t,tk->k", mass, corners.mean(axis=1)) / total
    away = corners - middle
    squares = np.einsum("t,tk->k", mass, ((away.sum(axis=1)) ** 2 + (away**2).sum(axis=1)) / 20)  # of a tetrahedron
    return total, middle[0], squares, mesh


@pytest.mark.soft
@pytest.mark.parametrize("cells", [1, 3])
def test_the_continuum_is_that_of_tetrahedra(cells):
    """The outline has flat sides, so that tetrahedra fill it: their exact moments are those of Gauss' rule."""
    (total, centre, squares, mesh), wanted = tetrahedra(cells), continuum(STRAIGHT)
    assert (total, centre) == pytest.approx((wanted.mass, wanted.centre), rel=1e-12)
    np.testing.assert_allclose(squares, wanted.squares, rtol=1e-12)
    from fish_env.soft.mesh import lumped_mass

    assert lumped_mass(mesh.position, mesh.tets, WATER_DENSITY).sum() == pytest.approx(total, rel=1e-12)


def test_layers_share_the_mass_of_their_sections():
    """Linear shape functions keep the mass and the centre; by quadrature with a thousand slices a section."""
    slices = 1000
    share = (np.arange(6 * slices) + 0.5) / slices
    stations = STRAIGHT.length * np.array([0.0, *STRAIGHT.layer_position, 1.0])
    rows = ([0.0, *STRAIGHT.half_width, 0.0], [0.0, *STRAIGHT.half_depth, STRAIGHT.tail_half_span])
    width, depth = (STRAIGHT.length * np.interp(share, np.arange(7), row) for row in rows)
    slice_mass = 4 * WATER_DENSITY * width * depth * np.repeat(np.diff(stations) / slices, slices)
    wanted = [slice_mass @ np.maximum(1.0 - np.abs(share - k), 0.0) for k in range(7)]
    layers = layer_masses(STRAIGHT)
    np.testing.assert_allclose(layers, wanted, rtol=1e-5)
    whole = continuum(STRAIGHT)
    assert layers.sum() == pytest.approx(whole.mass, rel=1e-12)
    assert -layers @ stations / layers.sum() == pytest.approx(whole.centre, rel=1e-12)


INERTIA = [*((*solid, slice(3)) for solid in SOLIDS), ("mass_spring", None, 2), ("planar", None, 2)]


@pytest.mark.parametrize(("name", "level", "axes"), rows(INERTIA), ids=str)
def test_bodies_have_the_inertia_of_the_outline(name, level, axes):
    """Mass, centre and moments of inertia; nodes on the outline itself, too far from the axis, have but that of yaw."""
    body = make_fish(name, **({} if level is None else {"level": level})).body
    found = moments(body.mass, body.position)
    assert (found.mass, found.centre) == pytest.approx((WANTED.mass, WANTED.centre), rel=1e-9)
    np.testing.assert_allclose(inertia(found)[axes], inertia(WANTED)[axes], rtol=1e-8)
    assert body.mass.min() > 0.0


def test_roll_and_pitch_of_the_default_fish():
    """They are larger than the outline's, as docs/choosing-a-body.md says."""
    body = make_fish().body
    found = moments(body.mass, body.position)
    np.testing.assert_allclose(inertia(found)[:2] / inertia(WANTED)[:2], [3.2, 1.1], rtol=0.02)


def test_masses_are_the_nearest_in_relative_entropy():
    """Any other masses with the same moments are farther from those given."""
    position, given = tu.shape(PARAMETERS), np.ones(23) / 23 * WANTED.mass
    found = match_moments(given, position, WANTED, solid=False)

    def entropy(mass):
        return (mass * np.log(mass / given)).sum()

    x, y = position[:, 0] - WANTED.centre, position[:, 1]
    rows = np.stack([np.ones(23), x, x**2 + y**2])
    free = np.linalg.svd(rows)[2][3:]
    for direction in np.vstack([free, -free]):
        other = found + 1e-2 * found.min() * direction
        np.testing.assert_allclose(rows @ other, rows @ found, rtol=0, atol=1e-15)
        assert entropy(other) > entropy(found)


def test_masses_are_found_whatever_is_given():
    """Whether masses have the moments depends on where the nodes are, not on the masses to start from."""
    generator = np.random.default_rng(0)
    for factor in np.exp(generator.uniform(np.log(0.25), np.log(4.0), (100, 7))):
        mass = tu.masses(replace(PARAMETERS, mass_factor=tuple(factor)))
        found = moments(mass, tu.shape(PARAMETERS))
        assert found.mass == pytest.approx(WANTED.mass, rel=1e-11) and mass.min() > 0.0
        np.testing.assert_allclose([found.centre, inertia(found)[2]], [WANTED.centre, inertia(WANTED)[2]], rtol=1e-9)


def test_what_cannot_be_had_is_refused():
    """Nodes on the outline cannot have its roll inertia; nor does any outline do."""
    position = tu.shape(PARAMETERS)
    with pytest.raises(ValueError, match="no masses of these nodes have the inertia of the outline; give an outline"):
        match_moments(tu.masses(PARAMETERS), position, WANTED, solid=True)
    with pytest.raises(ValueError, match="no masses of these nodes"):
        tu.masses(replace(PARAMETERS, layer_position=(0.001, 0.002, 0.003, 0.004, 0.005)))
