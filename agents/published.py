"""The published controllers: the settings of their training, which the package has, and their seeds."""

from fish_env.training.config import CONFIGS as CONFIGS

SEEDS = {"swim": 10, "turn": 5, "left_after_right": 10, "target": 5, "target_3d": 5, "avoid": 5, "fast_start": 5}
"""Number of seeds of each task that `train.py all` trains; the median one is shipped."""
