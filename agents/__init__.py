"""Training, evaluation and controllers on top of fish_env."""
