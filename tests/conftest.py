"""Settings shared by all tests: hypothesis without time limits, so that a busy machine fails nothing."""

import gc
import math
import os
import shutil
import signal
from pathlib import Path

# before numpy is loaded: small matrices gain nothing from its threads, which on a busy machine take far longer
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

settings.register_profile("fish_env", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("fish_env")


SECONDS = float(os.environ.get("FISH_ENV_TEST_SECONDS", "inf"))
"""Processor time after which a test is given up, s: without the compiler (`.ci/coverage`) some would take days."""


class GivenUp(BaseException):
    """A test took longer than it may; no handler of exceptions takes this for an error of the program."""


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call():
    """Give a test up that takes too long."""

    def give_up(number, frame):
        raise GivenUp

    if math.isfinite(SECONDS):
        signal.signal(signal.SIGPROF, give_up)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
    yield
    if math.isfinite(SECONDS):
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def pytest_collection_finish():
    """What has been loaded stays: the garbage collector need not look through it again while kernels are compiled."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    """The folder of a short run of Swim, which must not be changed."""
    from trainings import train_short

    return train_short(folder=tmp_path_factory.mktemp("trained") / "run")


@pytest.fixture
def run_copy(trained, tmp_path):
    """The folder of a copy of the short run, which may be changed."""
    return Path(shutil.copytree(trained, tmp_path / "run"))
