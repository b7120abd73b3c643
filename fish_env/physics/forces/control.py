"""Control of a block of fish: rest lengths, the factors of each fish, and the step coefficients of the method."""

import numpy as np

from fish_env.kernels.simd import Kind, Pack
from fish_env.physics.records import FLOWS, Body

STIFFNESS, MASS, DRAG, CURRENT = 0, 1, 2, 3  # columns of a fish's factors and current, as in NOMINAL
NOMINAL = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
"""Default factors on stiffness (and damping), mass and drag, and additional current, m/s."""
NO_PLAN = np.zeros((1, 8))
FACTORS = ("stiffness", "drag", "lightness", "shortness")  # of each fish of a block


def make_control(body: Body, kind: Kind, driven=(), plans=NO_PLAN, costs=None, constant=False, line=None) -> Pack:
    """Make the control of a block of fish with default factors, at their natural lengths.

    Fields with one lane per fish: rest_length (E,) m; start (D,) m and rate (D,) m/s of the driven springs (D,) at the
    start of a call; stiffness, drag and lightness (1,), factors over the factor on mass; shortness (1,), 1 over the
    factor on length; current (1,) m/s; fastest (1,) 1/s, the largest relative rate of a spring's length so far; work
    (1,) J over the factor on stiffness, done by the driven springs so far; pivots and untrusted (1,), counts of
    non-positive and untrusted pivots. Shared fields: plans (P,K), row (1,) and costs (P,3)
    (`fish_env.physics.forces.plan`); elapsed (1,) s, the time of the evaluation since the start of the call; constant,
    True if the forces' system matrix does not depend on the motion; reused (1,), the number of steps of a call that
    reused the factors of the previous step; flows, what `common.make_measure` reads and writes, empty for None instead
    of the weights `line` (N,) of the forward direction.
    """
    count = 0 if line is None else len(body.mass)
    control = Pack(
        "control",
        rest_length=kind.numbers(len(body.springs.rest_length)),
        start=kind.numbers(len(driven)),
        rate=kind.numbers(len(driven)),
        driven=np.array(driven, dtype=np.int64),
        **{name: kind.numbers(1) for name in (*FACTORS, "fastest", "work", "pivots", "untrusted")},
        current=kind.vectors(1),
        plans=plans,
        costs=np.zeros((len(plans), 3), dtype=np.int64) if costs is None else costs,
        row=kind.scratch(1, "int64"),
        elapsed=kind.scratch(1),
        constant=bool(constant),
        reused=kind.scratch(1, "int64"),
        flows=Pack(
            "flows",
            total=kind.numbers(len(FLOWS) if count else 0),
            line=np.zeros(0) if line is None else line,
            **{name: kind.vectors(count) for name in ("v", "a", "f")},
        ),
    )
    control.rest_length.memory[:, : kind.width] = body.springs.rest_length[:, None]
    for name in FACTORS:
        getattr(control, name).memory[:, : kind.width] = 1.0
    return control
