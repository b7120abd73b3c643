"""Settings shared by all tests: hypothesis without time limits, so that a busy machine fails nothing."""

import gc
import os
import sys

# before numpy is loaded: small matrices gain nothing from its threads, which on a busy machine take far longer
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

settings.register_profile("fish_env", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("fish_env")


def pytest_collection_finish():
    """What has been loaded stays: the garbage collector need not look through it again while kernels are compiled."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish():
    """The fuzz tests write down what they have called: a worker does not live long after this."""
    if "fuzzing" in sys.modules:
        sys.modules["fuzzing"].write_ledger()
