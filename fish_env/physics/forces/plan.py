"""The numbers that one step of a method is told, a row of `control.plans` each; `control.row[0]` says which row holds.

All fish of a block share a row. Forces that are filtered or taken implicitly read their weights there.
"""

H = 0  # step, s
INNER = 1  # s, the step in a system matrix: H, or the part of it that a Rosenbrock method takes
LOWEST = 2  # N/m, least effective stiffness with which a spring enters a system matrix
STAGES = 3  # of the filter, and what follows
MIDPOINT = 4
FIRST = 5
FACTOR = 6  # on h^2 times stiffness, and twice on h times damping
LEAST = 7  # on h times damping, at least
POLYNOMIAL = 8  # first of the Chebyshev polynomials T_k at the midpoint
