"""A fish with a trout's outline, and its waters: what is measured of reactive water until a calibration is done.

The trout has twice the default fish's mass. Its springs are therefore stiffer and more damped, and its faces have plain
drag, since the factors of the default fish were fitted to another body in water without inertia.
"""

import numpy as np

from fish_env import make_fish, make_water
from fish_env.bodies import Fish
from fish_env.bodies.fitted import read_calibration

STIFFNESS, RELAXATION = 3.0, 2.0  # factors on the calibrated stiffness and relaxation time
DENSITY, DRAG_COEFFICIENT = 1000.0, 1.0  # kg/m3; of a face moving along its normal
WATERS = {
    "drag": make_water(DENSITY, DRAG_COEFFICIENT),
    "reactive": make_water(DENSITY, DRAG_COEFFICIENT, inertia=True),
}


def trout(body="mass_spring", stiffness=STIFFNESS, relaxation=RELAXATION, **parameters) -> Fish:
    """The trout as a body of `BODIES` with an outline; its own water is WATERS["drag"].

    Args:
        body: its name.
        stiffness: factor on the calibrated stiffness of its springs, and of its solid.
        relaxation: factor on the calibrated relaxation time.
        parameters: further ones of `make_fish`.
    """
    own = read_calibration("tetrahedral" if body == "tetrahedral" else "mass_spring")
    if body == "tetrahedral":
        parameters = {"young": stiffness * np.array(own["young"])} | parameters
    else:
        parameters = {"water_place": (0.5,) * 6, "water_drag": (1.0,) * 6} | parameters
    known = own["parameters"]
    return make_fish(
        body, outline="trout", stiffness=tuple(stiffness * np.array(known["stiffness"])),
        relaxation_time=relaxation * known["relaxation_time"], drag_coefficient=DRAG_COEFFICIENT, **parameters,
    )  # fmt: skip
