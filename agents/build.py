"""The name by which older models refer to their learning rate, so that `PPO.load` of Stable-Baselines3 reads them."""

from fish_env.training.build import falling as falling
