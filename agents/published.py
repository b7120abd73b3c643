"""The published controllers: the settings of their training, which the package has, and their seeds."""

from fish_env.training.config import CONFIGS as CONFIGS

SEEDS = {"swim": 5, "turn": 3, "left_after_right": 3, "target": 3, "target_3d": 3, "avoid": 3, "fast_start": 3}
"""Number of seeds of each task that `train.py all` trains; the median one is shipped."""
