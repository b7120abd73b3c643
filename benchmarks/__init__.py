"""Measurements and calibration: every published number has a command here. `python -m benchmarks` lists them all."""
