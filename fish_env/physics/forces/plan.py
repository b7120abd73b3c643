"""Coefficients of one step of a method, a row of `control.plans` each; `control.row[0]` is the row in use.

All fish of a block share a row. Filtered and implicit forces read their weights there.
"""

H = 0  # step, s
INNER = 1  # s, the step in a system matrix: H, or gamma H for a Rosenbrock method
LOWEST = 2  # N/m, least effective stiffness of a spring in a system matrix
STAGES = 3  # number of stages of the filter; the next columns are its coefficients
MIDPOINT = 4
FIRST = 5
FACTOR = 6  # on h^2 times stiffness, and twice on h times damping
LEAST = 7  # lower bound of the factor on h times damping
POLYNOMIAL = 8  # first of the Chebyshev polynomials T_k at the midpoint
