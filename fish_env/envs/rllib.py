"""The runner for Ray RLlib that was here is gone: RLlib steps a batch of fish by itself."""

raise ImportError(
    "fish_env.envs.rllib and its FishEnvRunner are gone; use RLlib's own runner: "
    'config.environment("fish_env:FishEnv/Swim-v0").env_runners(gym_env_vectorize_mode="vector_entry_point"), '
    "as examples/train_rllib.py does"
)
