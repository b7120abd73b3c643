"""Comparisons with published measurements to which nothing was fitted."""
