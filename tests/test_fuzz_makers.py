"""Makers, given anything: what they return is finite and can be simulated, or they refuse it by a documented error."""

import contextlib
from functools import partial

import numpy as np
import pytest
from fuzzing import EDGES, FACTOR, WHOLE, call, examples, numbers, odd, scaled, unsound
from hypothesis import given
from hypothesis import strategies as st
from moving import tiered

from fish_env import BODIES, INTEGRATORS, Tank, make_body, make_fish, make_water, make_world
from fish_env.bodies.mass_spring import calibrated
from fish_env.control import Gait
from fish_env.kernels.simd import Kind
from fish_env.physics.body import fix
from fish_env.soft.conditions import make_anchors
from fish_env.soft.elements import make_barriers, make_compartments, make_tets
from fish_env.soft.objects import OBJECTS, RING, room
from fish_env.soft.solids import SolidMaterial
from fish_env.soft.statics import NoEquilibrium, equilibrium
from fish_env.tasks import TASKS

FISH = make_fish()
B = FISH.body
PARAMETERS = {name: np.array(value) for name, value in calibrated().items() if value is not None}
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SURFACE = np.array([[0, 2, 1, 1], [0, 1, 3, 3], [1, 2, 3, 3], [2, 0, 3, 3]])
MATERIALS = {name: np.array(value) for name, value in vars(RING).items() if value is not None}
SOLID = vars(SolidMaterial()) | {"strain": "linear"}
PARTS = {"position": B.position, "mass": B.mass, "pairs": B.springs.nodes, "stiffness": B.springs.stiffness,
         "damping": B.springs.damping, "rest_length": B.springs.rest_length, "faces": B.faces.nodes,
         "share": B.faces.share, "drag": B.faces.drag, "depth": B.faces.depth}  # fmt: skip
OF_BODY = {
    "planar": {"bending": np.ones(5), "pull": np.ones(3), "shear": 1.0, "drag": np.ones(6)},
    "two_layer": {"bending": np.ones(5), "pull": np.ones(3), "shear": 1.0, "inner_size": 0.5, "inner_mass": 0.8,
                  "inner_stiffness": 0.3, "pressure": 1e3, "gap_pressure": 1e3, "barrier_energy": 3e-3},
    "tetrahedral": {"level": 1, "young": np.full(6, 1e4), "poisson": 0.4, "strain": "linear",
                    "lumping": "uniform"},
    "published": {"contracted": np.full(3, 0.7), "contraction_time": 0.7, "time_step": 0.02},
}  # fmt: skip
MAKERS = {
    "make_body": (make_body, PARTS, PARTS),
    "make_tets": (make_tets, {"position": CORNERS, "nodes": [[0, 1, 2, 3]], "young": 1.0, "poisson": 0.3},
                  {"relaxation_time": 0.1, "strain": "green_lagrange"}),
    "make_compartments": (make_compartments, {"position": CORNERS, "surfaces": [SURFACE], "pressure": 1.0},
                          {"ambient": 0.0}),
    "make_barriers": (make_barriers, {"position": CORNERS, "faces": [[1, 2, 3]], "inner": [0], "energy": 1.0}, {}),
    "make_water": (make_water, {}, {"density": 1e3, "drag_coefficient": 1.0, "law": "linear", "current": np.zeros(3),
                                    "friction": 2.0, "viscosity": 1e-6}),
    "make_world": (make_world, {}, {"gravity": np.zeros(3), "planes": (((0, 0, 1), -1.0, 0.5),), "viscosity": 0.1,
                                    "water": make_water()}),
    "make_anchors": (make_anchors, {"node": [0, 5], "point": np.zeros((2, 3)), "stiffness": np.ones(2)},
                     {"damping": np.ones(2), "rest_length": np.ones(2), "velocity": np.zeros((2, 3))}),
    "room": (room, {"down": np.array([0.0, 0.0, -1.0]), "size": 1.0}, {"restitution": 0.5, "gravity": 9.8}),
    "fix": (fix, {"body": B, "nodes": np.array([0, 3])}, {"axes": "xy"}),
    "Gait": (Gait, {"frequency": 2.0, "amplitude": np.ones(3), "lag": np.zeros(3)}, {}),
    "Kind": (Kind, {}, {"lanes": 8, "dtype": "float64"}),
}  # fmt: skip
FORMS = {"string": {"nodes": 3, "length": 0.2, "mass": 0.1, "stiffness": 8.0, "relaxation_time": 0.002},
         "ring": MATERIALS | {"nodes": 12, "layers": 2}, "sphere": MATERIALS | {"slices": 4, "stacks": 3},
         "uniform sphere": MATERIALS | {"level": 1, "correction": True, "layers": 1},
         "beam": SOLID | {"cells": 4, "across": 2, "length": 0.4, "thickness": 0.08, "clamped": True},
         "block": SOLID | {"cells": 2, "side": 0.16}, "ball": SOLID | {"cells": 2, "radius": 0.1},
         "two materials": {"cells": 4, "across": 2, "length": 0.3, "thickness": 0.1, "soft": SolidMaterial(),
                           "stiff": SolidMaterial(), "strain": "linear"}}  # fmt: skip
FRESH = {
    "string": {}, "ring": {"nodes": 6}, "sphere": {"slices": 4, "stacks": 3}, "uniform sphere": {"level": 0},
    "beam": {"cells": 2}, "block": {"cells": 2}, "ball": {"cells": 2}, "two materials": {"cells": 2},
}  # fmt: skip


def near(value):
    """A value that is nearly allowed: of this shape with an extreme number in it, or anything at all."""
    plain = isinstance(value, float | int | np.ndarray | list) and not isinstance(value, bool)
    numeric = plain and np.asarray(value).dtype.kind in "fi"
    whole = np.asarray(value).dtype.kind == "i" if numeric else False
    close = st.sampled_from(WHOLE) if isinstance(value, int) or (whole and np.ndim(value) == 0) else st.nothing()
    if numeric and not whole:
        close = scaled(value) if np.ndim(value) else st.sampled_from(EDGES) | st.floats(0.0, 2.0).map(value.__mul__)
    elif whole and np.ndim(value):
        close = scaled(value).map(lambda array: np.nan_to_num(array, posinf=9e18, neginf=-9e18).clip(-9e18, 9e18))
        close = close.map(lambda array: array.astype(np.int64))
    return st.one_of(close, close, odd, st.just(value))


@st.composite
def keywords(draw, needed, others, most=2):
    """Keywords of a maker, one or two of them odd."""
    names = draw(st.lists(st.sampled_from([*needed, *others, "unknown"]), min_size=1, max_size=most, unique=True))
    every = needed | others
    return needed | {name: draw(near(every[name]) if name in every else odd) for name in names}


def simulated(thing):
    """A few steps of what was made: it moves to finite places, or is said to have failed."""
    tank = call(Tank, thing, 1, water=thing.water)
    if tank is None:
        return
    tank.advance(2)
    assert np.isfinite(tank.position).all() and np.isfinite(tank.velocity).all()
    assert tank.alive.all() or tank.failure[0]


@pytest.mark.parametrize("name", MAKERS)
@examples(15)
@given(data=st.data())
def test_makers(name, data):
    """Parts of bodies, worlds, anchors, gaits and kinds."""
    make, needed, others = MAKERS[name]
    made = call(make, **data.draw(keywords(needed, others)))
    assert made is None or not unsound(made, infinite=("phase",)), unsound(made)


def moved(names, quick):
    """Parameters: each is made, and also moved; kernels are compiled for one of them, and those of others are slow."""
    slow = [pytest.mark.slow]
    return [pytest.param(name, moves, marks=slow * (moves and name != quick)) for moves in (0, 1) for name in names]


@pytest.mark.parametrize(("body", "moves"), moved(BODIES, "mass_spring"))
@examples(8)
@given(data=st.data())
def test_fish(body, moves, data):
    """Every body, with every parameter that it has."""
    own = {"drag": np.ones(6)} if body in ("planar", "two_layer") else {}
    others = OF_BODY.get(body, {}) | own | (PARAMETERS if body != "published" else {})
    made = call(make_fish, body, **data.draw(keywords({}, others)))
    if made is not None:
        assert not unsound(made, infinite=("refine",)), unsound(made, infinite=("refine",))
        if moves:
            simulated(made)


@pytest.mark.parametrize(("name", "moves"), moved(OBJECTS, "string"))
@examples(6)
@given(data=st.data())
def test_objects(name, moves, data):
    """Every elastic object, with every material."""
    made = call(OBJECTS[name].make, **FRESH[name] | data.draw(keywords({}, FORMS[name])))
    if made is not None:
        assert not unsound(made, infinite=("refine",)), unsound(made, infinite=("refine",))
        if moves:
            simulated(made)


@examples(25)
@given(data=st.data())
def test_tanks(data):
    """Every option of a tank, and two of them together."""
    options = {"num_fish": 2, "integrator": "rk4", "dt": 0.0005, "threads": 2, "dtype": "float32", "lanes": 4,
               "refine": 0.1, "water": FISH.water}  # fmt: skip
    tank = call(Tank, **{"fish": FISH} | data.draw(keywords({}, options)))
    if tank is not None and (
        FACTOR > 1 or (tank.kind, tank.integrator.name) == (Kind(), FISH.integrator)
    ):  # others are compiled
        tank.advance(2)
        assert np.isfinite(tank.position).all() and np.isfinite(tank.velocity).all()
        tank.close()


@pytest.mark.parametrize("name", tiered(INTEGRATORS, (FISH.integrator,)))
@examples(2)
@given(stiffness=st.sampled_from(EDGES[2:]), mass=st.sampled_from(EDGES[2:]), drag=numbers, dt=st.sampled_from(EDGES))
def test_plans_of_extreme_fish(name, stiffness, mass, drag, dt):
    """Every method plans its steps for fish of any stiffness and mass that is accepted, with any step."""
    tank = call(Tank, FISH, 1, name, dt, FISH.water) or Tank(FISH, 1, name, water=FISH.water)
    call(tank.vary, 0, stiffness, mass, drag)
    if INTEGRATORS[name].kind != "adaptive":
        tank.advance(1)
        assert np.isfinite(tank.position).all() and np.isfinite(tank.velocity).all()


@pytest.mark.parametrize("task", TASKS)
@examples(10)
@given(data=st.data())
def test_tasks(task, data):
    """Every keyword of every task."""
    defaults = TASKS[task].__init__.__defaults__ or ()
    names = TASKS[task].__init__.__code__.co_varnames[1 : 1 + len(defaults)]
    call(TASKS[task], **data.draw(keywords({}, dict(zip(names, defaults, strict=True)))))


@examples(6)
@given(data=st.data())
def test_statics(data):
    """An equilibrium is found or refused, for any gravity and any start."""
    gravity, start = data.draw(scaled([0.0, 0.0, -0.01])), data.draw(near(B.position))
    world = call(make_world, gravity)
    if world is not None:
        held = world._replace(anchors=make_anchors([0, 1, 2, 22], B.position[[0, 1, 2, 22]], 50.0))
        with contextlib.suppress(NoEquilibrium):
            found = call(equilibrium, B, held, start=start)
            assert found is None or np.isfinite(found).all()


# What is refused by its number

FIVE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]])
GOOD = [0, 1, 2, 3]
TETRAHEDRON = SURFACE.tolist()
SQUARE = [[0, 1], [1, 4], [4, 2], [2, 0]]


def tets(nodes, **options):
    """A call that makes tetrahedra."""
    return partial(make_tets, FIVE, nodes, **{"young": 1.0, "poisson": 0.3, **options})


def gas(surfaces, **options):
    """A call that makes compartments."""
    return partial(make_compartments, FIVE, surfaces, **{"pressure": 1.0, **options})


def barriers(faces, inner, energy=1.0):
    """A call that makes barriers."""
    return partial(make_barriers, FIVE, faces, inner, energy)


def body(**parts):
    """A call that makes a body of nodes alone, and of some parts."""
    rest = {name: [] for name in ("pairs", "stiffness", "damping", "rest_length", "faces")}
    return partial(make_body, FIVE, **{"mass": np.ones(5), **rest, **parts})


def beyond(point):
    """The corners and a node that the body has not."""
    return np.vstack([FIVE, [point]])


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
    (tets([GOOD], young=np.nan), r"young \(Pa\) is nan at \(0,\)"),
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
    (partial(make_world, planes=[(UP, 0, np.nan)]), "restitution of plane 0 is nan"),
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
    (partial(Tank, FISH, water=make_water()._replace(extra={"sof_floor": 1})), "for a force 'sof_floor'; choose from"),
    (partial(make_anchors, [0], [[0.0, np.inf, 0.0]], 1.0), r"point \(m\) is inf at \(0, 1\)"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "text"), REFUSED, ids=[text for _, text in REFUSED])
def test_refused(make, text):
    """Elements that are flat, open, inside out or of no material, and worlds that would feed energy, are refused."""
    with pytest.raises(ValueError, match=text):
        make()
