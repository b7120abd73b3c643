"""Slow, obvious reference implementations of the compiled kernels, from the equations, in plain numpy and Python loops.

Nothing here calls a kernel. Every function takes one body (no batch) and returns new arrays.
"""

from naive.elements import (
    barrier_energy,
    barrier_force,
    barrier_law,
    barrier_shares,
    barrier_stiffness,
    gas_energy,
    gas_force,
    gas_volume,
    nearest_rotation,
    strain_of,
    tet_energy,
    tet_force,
    tets_of,
)
from naive.scenes import (
    SHORTER,
    TU,
    angular_momentum,
    dense_water,
    enclosed_volume,
    kinetic_energy,
    mirrored_muscles,
    momentum,
    polygon,
    random_state,
)
from naive.springs_and_water import area_vector, face_force, shares, spring_energy, spring_force, water_force
from naive.steps import STEPS, advance, tu_system
from naive.sums import derivatives, highest_frequency, highest_rate, implicit_matrices, stiffness_matrix, total_force
from naive.surroundings import anchor_energy, anchor_force, bounce, weight_energy, with_reaction

__all__ = [
    "SHORTER",
    "STEPS",
    "TU",
    "advance",
    "anchor_energy",
    "anchor_force",
    "angular_momentum",
    "area_vector",
    "barrier_energy",
    "barrier_force",
    "barrier_law",
    "barrier_shares",
    "barrier_stiffness",
    "bounce",
    "dense_water",
    "derivatives",
    "enclosed_volume",
    "face_force",
    "gas_energy",
    "gas_force",
    "gas_volume",
    "highest_frequency",
    "highest_rate",
    "implicit_matrices",
    "kinetic_energy",
    "mirrored_muscles",
    "momentum",
    "nearest_rotation",
    "polygon",
    "random_state",
    "shares",
    "spring_energy",
    "spring_force",
    "stiffness_matrix",
    "strain_of",
    "tet_energy",
    "tet_force",
    "tets_of",
    "total_force",
    "tu_system",
    "water_force",
    "weight_energy",
    "with_reaction",
]
