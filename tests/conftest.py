"""Settings shared by all tests: hypothesis without time limits, so that a busy machine fails nothing."""

import os

# before numpy is loaded: small matrices gain nothing from its threads, which on a busy machine take far longer
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

settings.register_profile("fish_env", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("fish_env")

LONGEST = (
    "test_every_method", "test_stability", "test_finite_elements", "test_kinds", "test_four_bodies", "test_tank",
    "test_integrators", "test_boundary", "test_envs", "test_benchmarks", "test_blocks", "test_extending",
    "test_examples",
)  # fmt: skip
"""Files that take longest. They begin first: processors share the tests by files, and none then ends much later."""


def pytest_collection_modifyitems(items):
    """Begin with the longest files."""
    place = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(LONGEST)))
