"""The published controllers: the settings of their training, which the package has, and their seeds."""

from fish_env.training.config import CONFIGS as CONFIGS

SEEDS = 3
"""Number of seeds of each task that `train.py all` trains; the median one is shipped."""
