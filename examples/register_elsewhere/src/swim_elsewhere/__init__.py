"""A package that registers an environment on top of fish_env.

Importing it registers `Elsewhere/AnyHeading-v0`. Neither fish_env nor its compiler is loaded before the first
`gym.make`: the entry points are strings.
"""

import gymnasium as gym

gym.register(
    id="Elsewhere/AnyHeading-v0",
    entry_point="swim_elsewhere.envs:FishEnv",
    vector_entry_point="swim_elsewhere.envs:FishVectorEnv",
    max_episode_steps=250,
    kwargs={"task": "any_heading"},
)
