"""The simulation: bodies and their surroundings, forces, methods, and the tank that moves fish."""
