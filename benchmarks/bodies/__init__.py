"""Bodies of different fidelity beside one another."""
