"""Settings shared by all tests: hypothesis without time limits, so that a busy machine fails nothing."""

from hypothesis import settings

settings.register_profile("fish_env", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("fish_env")
