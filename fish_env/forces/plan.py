"""The numbers that one step of a method is told, a row of `control.plans` each; `control.row[0]` says which row holds.

All fish of a block share a row. Forces that are filtered or taken implicitly read their weights there.
"""

H = 0  # step, s
LOWEST = 1  # N/m, least effective stiffness with which a spring enters a system matrix
STAGES = 2  # of the filter, and what follows
MIDPOINT = 3
FIRST = 4
FACTOR = 5  # on h^2 times stiffness, and twice on h times damping
LEAST = 6  # on h times damping, at least
POLYNOMIAL = 7  # first of the Chebyshev polynomials T_k at the midpoint
