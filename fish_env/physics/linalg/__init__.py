"""Direct solvers for the small symmetric systems of one fish."""
