"""Tu & Terzopoulos' artificial fish: 23 nodes, 91 viscoelastic springs, 12 muscles (Tu 1996, ch. 4).

`make_mass_spring` builds the default, fitted to the motion of the finest body by `benchmarks/calibration/fit.py`, which
wrote `mass_spring.json`; `make_published` keeps the published masses and
constants, which barely swim.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from fish_env.bodies.fitted import read_calibration
from fish_env.bodies.masses import WATER_DENSITY, continuum, layer_masses, match_moments
from fish_env.bodies.outline import Outline, layers_for, outline_of, read_outline
from fish_env.bodies.sizes import REFERENCE_LENGTH, check_length, slowness, step_parts
from fish_env.checks import UnknownOptionError, check_names, finite_array, positive_array
from fish_env.physics.body import make_body
from fish_env.physics.elements import make_sections
from fish_env.physics.fish import Fish
from fish_env.physics.records import Body
from fish_env.physics.world import make_water

NOSE, TAIL = 0, (21, 22)
LAYERS = [[0], [1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [13, 14, 15, 16], [17, 18, 19, 20], [21, 22]]
EDGES = [[node for layer in LAYERS[1:6] for node in layer[k : k + 2]] for k in (0, 2)]  # upper and lower nodes
LEFT = np.array([node for layer in LAYERS[1:6] for node in (layer[0], layer[3])])
RIGHT = np.array([node for layer in LAYERS[1:6] for node in (layer[1], layer[2])])
CROSS, MUSCLE, OTHER = 0, 1, 2


def mirror_nodes() -> np.ndarray:
    """Node (23,) that each node becomes when left and right are exchanged."""
    mirror = np.arange(23)
    mirror[LEFT], mirror[RIGHT] = RIGHT, LEFT
    return mirror


def topology():
    """Pairs (91,2), class (91,) and section (91,) of the springs, and faces (24,4).

    A layer's nodes are numbered up-left, up-right, down-right, down-left. The class is CROSS, MUSCLE or OTHER. The
    section is where along the body a spring lies: 0 the head, 5 the tail fin, whole numbers for the springs between two
    layers and halves for those inside a layer.
    """
    pairs, classes, sections = [], [], []

    def spring(i, j, kind, section):
        pairs.append((i, j))
        classes.append(kind)
        sections.append(section)

    faces = []
    for side in range(4):  # the head: a pyramid
        a, b = LAYERS[1][side], LAYERS[1][(side + 1) % 4]
        spring(NOSE, a, OTHER, 0)
        faces.append((NOSE, a, b, b))
    for number, layer in enumerate(LAYERS[1:6], start=1):  # the square layers
        for side in range(4):
            i, j = sorted((layer[side], layer[(side + 1) % 4]))
            spring(i, j, OTHER, number - 0.5)
        spring(layer[0], layer[2], CROSS, number - 0.5)
        spring(layer[1], layer[3], CROSS, number - 0.5)
    for section in range(1, 5):  # between square layers
        here, behind = LAYERS[section], LAYERS[section + 1]
        for side in range(4):
            following = (side + 1) % 4
            spring(here[side], behind[side], MUSCLE if section < 4 else OTHER, section)
            spring(here[side], behind[following], CROSS, section)
            spring(here[following], behind[side], CROSS, section)
            faces.append((here[side], behind[side], behind[following], here[following]))
    upper, lower = TAIL
    for node in LAYERS[5]:  # the tail fin: a wedge
        near, far = (upper, lower) if node in LAYERS[5][:2] else (lower, upper)
        spring(node, near, OTHER, 5)
        spring(node, far, CROSS, 5)
    spring(upper, lower, OTHER, 5)
    up_left, up_right, down_right, down_left = LAYERS[5]
    faces += [
        (up_right, up_left, upper, upper),
        (down_left, down_right, lower, lower),
        (up_right, upper, lower, down_right),
        (down_left, lower, upper, up_left),
    ]
    return np.array(pairs), np.array(classes), np.array(sections, dtype=float), np.array(faces)


REFINE = 0.1  # relative change of a spring's length in a step, above which the default method takes shorter ones


@dataclass(frozen=True)
class MassSpringParameters:
    """Shape, material and muscles of the default fish; `calibrated()` are the values it has."""

    length: float
    """Nose to tail tip, 0.02 to 1 m, best 0.05 to 0.6. The tissue is the same (`fish_env/bodies/sizes.py`)."""
    layer_position: tuple[float, ...]
    """Distance of the five square layers from the nose, body lengths."""
    half_depth: tuple[float, ...]
    """Half the depth (z) of the five layers, body lengths."""
    half_width: tuple[float, ...]
    """Half the width (y) of the five layers, body lengths."""
    tail_half_span: float
    """Half the height of the caudal fin at its tips, body lengths."""
    stiffness: tuple[float, float, float]
    """c of the cross, muscle and other springs for a fish of 0.2 m, N/m."""
    taper: tuple[float, ...]
    """Factor on c in the head, the four sections between layers, and the tail fin."""
    relaxation_time: float
    """Damping over stiffness k/c, s."""
    damping_taper: tuple[float, ...]
    """Factor on k/c in the head, the four sections between layers, and the tail fin, of `mass_spring` and `planar`."""
    mass_factor: tuple[float, ...]
    """Factor on the mass of each layer, nose to tail tips, before masses get the mass, centre and inertia they have."""
    water_place: tuple[float, ...]
    """Place at which the drag acts on the head, the sections between layers and the tail fin, from 0 to 1 backward."""
    water_drag: tuple[float, ...]
    """Factor on the drag of the head, the four sections between layers, and the tail fin."""
    contracted: tuple[float, float, float]
    """Rest length at full contraction over natural length, for the three muscle segments."""
    drag_coefficient: float
    """Drag coefficient of the fish's own water, of a face moving along its normal."""
    friction: float
    """Skin friction of that water, over that of a laminar boundary layer on a flat plate."""
    law: str
    """By which that water resists faces along their normals: `law` of `make_water`."""
    thinning: float
    """Growth of that friction with the flow across a face (docs/physics.md, eq. 13)."""
    added_mass: tuple[float, float] | None
    """Factors on the lateral and the vertical added mass of that water; None: it has no inertia."""
    contraction_time: float
    """Shortest time from natural length to full contraction, s. Unless it is given, it grows with the length to the
    power of 0.52."""
    lengthening: float
    """Growth of a muscle's rest length as its antagonist contracts, over its shrinkage as it contracts itself."""
    time_step: float
    """Step of the default integrator, s, of which `two_layer` takes a quarter, `tetrahedral` a half or a quarter.
    Unless it is given, it is cut into whole parts for a fish below 0.2 m."""
    control_interval: float
    """Default length of an environment step, s."""
    outline: Outline | None = None
    """Finer stations, from which `half_depth`, `half_width` and `tail_half_span` are then taken, and all masses; None:
    rectangular cross-sections, straight from layer to layer."""

    def __post_init__(self):
        layers = positive_array(self.layer_position, (5,), "layer_position")
        if np.any(np.diff([0.0, *layers, 1.0]) <= 0):
            raise ValueError(f"layer_position is {self.layer_position}; give increasing numbers between 0 and 1")
        if self.outline is not None:
            self._follow(read_outline(self.outline))
        for name, size in (
            ("layer_position", 5), ("half_depth", 5), ("half_width", 5), ("stiffness", 3), ("taper", 6),
            ("mass_factor", 7), ("contracted", 3), ("water_drag", 6), ("water_place", 6), ("damping_taper", 6),
        ):  # fmt: skip
            object.__setattr__(self, name, tuple(positive_array(getattr(self, name), (size,), name).tolist()))
        for name in (
            "length", "tail_half_span", "drag_coefficient", "contraction_time", "time_step", "control_interval",
            "relaxation_time", "friction", "thinning", "lengthening",
        ):  # fmt: skip
            zero = name in ("relaxation_time", "friction", "thinning", "lengthening")
            object.__setattr__(self, name, float(positive_array(getattr(self, name), (), name, zero=zero)))
        for name, fractions in (("water_place", self.water_place), ("contracted", self.contracted)):
            if max(fractions) >= 1:
                raise ValueError(f"{name} is {fractions}; give fractions below 1")

    def _follow(self, outline: Outline) -> None:
        """Take the half sides of the layers from an outline: of the rectangles that have its cross-sections' areas."""
        layers = finite_array(self.layer_position, (5,), "layer_position")
        object.__setattr__(self, "outline", outline)
        object.__setattr__(self, "half_width", outline.side * outline.half_width(layers))
        object.__setattr__(self, "half_depth", outline.side * outline.half_depth(layers))
        object.__setattr__(self, "tail_half_span", outline.depths[-1])


UNUSED = {
    "tetrahedral": ("water_drag", "water_place", "mass_factor", "damping_taper"), "two_layer": ("damping_taper",),
}  # fmt: skip
"""Parameters that change nothing in these bodies."""
OUTLINED = ("half_depth", "half_width", "tail_half_span")


def calibrated(water: str | None = None) -> dict:
    """The parameters calibrated for a level of water, from `mass_spring.json` (which also says how they were found)."""
    # Those for reactive water have an outline, and lack what follows from it, which is then that for drag.
    return read_calibration("mass_spring", "drag")["parameters"] | read_calibration("mass_spring", water)["parameters"]


def place_nodes(stations, half_depths, half_widths, end, half_span) -> np.ndarray:
    """Positions (23,3): nose at the origin, square layers at five stations along -x, tail tips at the end."""
    position = np.zeros((23, 3))
    for layer, x, depth, width in zip(LAYERS[1:6], stations, half_depths, half_widths, strict=True):
        position[layer] = [(-x, sy * width, sz * depth) for sy, sz in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    position[list(TAIL)] = [(-end, 0.0, half_span), (-end, 0.0, -half_span)]
    return position


def shape(p: MassSpringParameters) -> np.ndarray:
    """Rest positions (23,3) m: nose at the origin, body along -x, y to the left, z up."""
    return place_nodes(p.layer_position, p.half_depth, p.half_width, 1.0, p.tail_half_span) * p.length


def masses(parameters: MassSpringParameters) -> np.ndarray:
    """Node masses (23,) kg with mass, centre and yaw inertia of the outline (`fish_env/bodies/masses.py`)."""
    # Pitch and roll inertia are larger than the outline's: all 23 nodes lie on it, above and below the axis.
    mass = np.empty(23)
    for nodes, share in zip(LAYERS, layer_masses(parameters) * parameters.mass_factor, strict=True):
        mass[nodes] = share / len(nodes)
    return match_moments(mass, shape(parameters), continuum(parameters), solid=False)


def along(factors, sections) -> np.ndarray:
    """Factors (6,) of the six sections, at any places between them, as `topology` numbers these."""
    return np.exp(np.interp(sections, np.arange(6), np.log(factors)))


def drag_points(p: MassSpringParameters, factor=1.0) -> tuple[np.ndarray, np.ndarray]:
    """Weights (24,4) of the corners in the point of each face of `topology` where its drag acts; drag factors (24,)."""
    # A section bends and rotates, and a single point of a face samples neither. Place and factor are therefore fitted.
    # On the two faces that close the tail fin above and below, the drag acts in their middle.
    *_, faces = topology()
    layer = np.repeat(np.arange(7), [len(nodes) for nodes in LAYERS])[faces]
    section = layer.min(axis=1)
    place = np.array(p.water_place)[section]
    place[20:22] = 1 / 3
    return shares(faces, layer > section[:, None], place), (factor * np.array(p.water_drag))[section]


def shares(faces, behind, place) -> np.ndarray:
    """Part (F,4) of each corner in a point of a face (F,4), from 0 between its front corners to 1 between the rear."""
    # `behind` (F,4): which corners are the rear ones. `place` (F,): of the point. A triangle's third node is given
    # twice.
    twice = np.where(faces[:, 2:3] == faces[:, 3:4], [[1.0, 1.0, 0.5, 0.5]], 1.0)
    ends = [weight / weight.sum(axis=1, keepdims=True) for weight in (twice * ~behind, twice * behind)]
    return (1.0 - place)[:, None] * ends[0] + place[:, None] * ends[1]


def check_parameters(
    body: str, parameters: dict, water: str | None = None, own: dict | None = None
) -> MassSpringParameters:
    """Replace some of the calibrated parameters; ValueError, which names the body, for one there is not."""
    # A length outside the range in which the model is meant is warned of. Times that a user did not give are those of
    # the fish's length (`sizes.py`). `own` replaces the default fish's parameters in this body, unless they are given.
    allowed = [field.name for field in fields(MassSpringParameters)]
    allowed = [name for name in allowed if name not in UNUSED.get(body, ())]
    check_names(f"the {body} fish has no parameter", allowed, *parameters, error=UnknownOptionError)
    standard = calibrated(water)
    shaped = [name for name in OUTLINED if name in parameters]
    if shaped and parameters.get("outline") is not None:
        raise ValueError(f"{shaped[0]} and an outline, which has it, are both given; give one of them")
    outline = parameters.get("outline", None if shaped else standard.get("outline"))
    standard["outline"] = outline
    if outline is not None:
        standard["layer_position"] = layers_for(read_outline(outline), standard["layer_position"])
    p = MassSpringParameters(**(standard | (own or {}) | parameters))
    check_length(p.length)
    if p.length == REFERENCE_LENGTH:
        return p
    slower = slowness(p.length / REFERENCE_LENGTH)
    times = {"contraction_time": slower * p.contraction_time, "time_step": p.time_step / step_parts(p.length)}
    return replace(p, **{name: time for name, time in times.items() if name not in parameters})


def make_mass_spring(water=None, **parameters) -> Fish:
    """The default fish, in SI units; keywords are the fields of `MassSpringParameters`.

    Args:
        water: "drag" or "reactive", the water that it is calibrated for; None: the default one.
        parameters: those that are to be other than calibrated.

    Raises:
        ValueError: for an unknown parameter or a value that is not allowed.
    """
    p = check_parameters("mass_spring", parameters, water)
    pairs, classes, sections, faces = topology()
    position = shape(p)
    stiffness = np.array(p.stiffness)[classes] * along(p.taper, sections) * (p.length / REFERENCE_LENGTH)
    damping = p.relaxation_time * along(p.damping_taper, sections) * stiffness
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    share, drag = drag_points(p)
    mass = masses(p)
    body = make_body(
        position, mass, pairs, stiffness, damping, natural, faces, share=share, drag=drag,
        sections=make_sections(position, mass, LAYERS, EDGES, outline_of(p).stations),
    )  # fmt: skip
    return _fish("mass_spring", body, p.contracted, time_step=p.time_step, refine=REFINE, **common_fields(p))


def make_published(contracted=(0.7, 0.7, 0.7), contraction_time=0.73, time_step=0.0275) -> Fish:
    """The fish with the published masses (107.03 in all), stiffness 38, 28, 30 and viscosity 0.1, in graphics units.

    Dimensions and contracted length were never printed; these are a re-implementation's
    (vanish87/UnityFishSimulation, 2020), as is `contraction_time`, its fastest half beat. The water is linear, as the
    published one, and thick enough to survive hard jerks at half the published step of 0.055. See docs/physics-more.md.
    """
    half = (2, 3, 2, 1, 0.8)
    position = place_nodes((5, 10, 15, 20, 22), half, half, 26, 3)
    mass = np.full(23, 1.1)
    mass[1:5] = mass[9:13] = 6.6
    mass[5:9] = 11.0
    mass[21:] = 0.165
    pairs, classes, _, faces = topology()
    natural = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    body = make_body(position, mass, pairs, np.array([38.0, 28.0, 30.0])[classes], np.full(91, 0.1), natural, faces)
    water = make_water(law="linear", drag_coefficient=3.0)
    return _fish(
        "published", body, finite_array(contracted, (3,), "contracted"), length=26.0, time_step=float(time_step),
        contraction_time=float(contraction_time), control_interval=float(8 * time_step), water=water,
    )  # fmt: skip


def common_fields(p: MassSpringParameters) -> dict:
    """Fields of `Fish` that every body takes from the parameters as they are, and its own water."""
    inertia = {} if p.added_mass is None else {"inertia": True, "added_mass": p.added_mass}
    return {
        "length": p.length, "contraction_time": p.contraction_time, "lengthening": p.lengthening,
        "control_interval": p.control_interval, "water": make_water(
            WATER_DENSITY, p.drag_coefficient, p.law, friction=p.friction, thinning=p.thinning, **inertia),
    }  # fmt: skip


def _fish(name: str, body: Body, contracted, **others) -> Fish:
    """Add the muscles, the head and the tail to a body with this topology."""
    pairs, classes, sections, _ = topology()
    muscles = np.flatnonzero(classes == MUSCLE)
    segments = sections[muscles].astype(int) - 1
    return Fish(
        name=name, body=body, muscles=muscles, sides=np.where(np.isin(pairs[muscles, 0], LEFT), 1, -1),
        segments=segments, contracted=np.array(contracted)[segments], nose=NOSE, tail=np.array(TAIL),
        left=LEFT.copy(), right=RIGHT.copy(), mirror=mirror_nodes(), **others,
    )  # fmt: skip
