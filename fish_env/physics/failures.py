"""Reasons that end a simulation: a failure is a value, an index into FAILURES, and never an exception."""

STRETCH_LIMIT = 3.0  # an element longer than this many natural lengths counts as torn
FAILURES = (
    "",
    "non-finite: a position, a velocity or the clock is not a number or infinite",
    f"torn: an element is stretched beyond {STRETCH_LIMIT:g} times its natural length",
    "untrusted solve: a pivot of the system matrix has lost nine digits or is not finite",
    "no convergence: the adaptive method gave up",
    "escaped: a gas compartment has no volume left, or a node of an inner layer has left the outer one",
    "out of range: too far from the origin for float32, in a world that is not the same everywhere",
)
NON_FINITE, TORN, UNTRUSTED_SOLVE, NO_CONVERGENCE, ESCAPED, OUT_OF_RANGE = 1, 2, 3, 4, 5, 6
