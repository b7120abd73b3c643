"""Settings shared by all tests: hypothesis without time limits, so that a busy machine fails nothing."""

import gc
import math
import os
import re
import shutil
import signal
import sys
from pathlib import Path

# before numpy is loaded: small matrices gain nothing from its threads, which on a busy machine take far longer
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "fish_env", deadline=None, max_examples=50, print_blob=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],  # `kernels` is the same for all examples
)  # fmt: skip
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


# Physics: the core by itself, and kernels as plain Python

BESIDE = ("fish_env.soft", "fish_env.lab", "fish_env.gpu")


def pytest_addoption(parser):
    """Offer `--core`."""
    parser.addoption("--core", action="store_true", help=f"run the tests that need none of {', '.join(BESIDE)}")


def pytest_configure(config):
    """With `--core`, no module of the packages beside the core can be imported."""
    config.addinivalue_line("markers", "soft: needs fish_env.soft; not run with --core")
    if config.getoption("core"):
        sys.modules.update(dict.fromkeys(BESIDE))


def pytest_ignore_collect(collection_path, config):
    """With `--core`, the files of tests that import these packages, or benchmarks, which do, are left out."""
    if not config.getoption("core") or collection_path.name == "naive":
        return None
    text = collection_path.read_text() if collection_path.suffix == ".py" else ""
    beside = re.search(r"^(from|import) (fish_env\.(soft|lab|gpu)|benchmarks|small_bodies|emulated_gpu)\b", text, re.M)
    return True if collection_path.name == "soft" or beside else None


def pytest_collection_modifyitems(config, items):
    """With `--core`, so are the tests marked as soft."""
    if config.getoption("core"):
        items[:] = [item for item in items if not item.get_closest_marker("soft")]


@pytest.fixture(params=["plain", pytest.param("compiled", marks=pytest.mark.slow)])
def kernels(request):
    """Kernels as plain Python, which is far faster than to compile them for a few nodes and steps; slow: compiled."""
    if request.param == "compiled":
        yield
        return
    import moving

    from fish_env.physics import engine
    from fish_env.physics.forces import evaluate

    def plain(make):
        return lambda *args: getattr(compiled := make(*args), "py_func", compiled)

    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        for module, name in ((engine, "make_call"), (evaluate, "compiled"), (evaluate, "compiled_jacobian"),
                             (moving, "entry")):  # fmt: skip
            patch.setattr(module, name, plain(getattr(module, name)))
        yield
