"""Step-size limits of the methods, and attempts to make the simulation fail."""
