"""Searches that find the shipped parameters of bodies, gaits and motor controllers, and checks of what they found."""
