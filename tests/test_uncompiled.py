"""Without the compiler, environments and tanks do what they do with it: every kernel is also plain Python."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from pages import ROOT

from fish_env import TASKS
from fish_env.envs import FishVectorEnv

CASES = {
    **{f"{task}, 1 fish": {"task": task, "num_envs": 1} for task in TASKS},
    "2 fish in 4 lanes": {"num_envs": 2, "lanes": 4, "variation": {"mass": (0.5, 2.0), "current": (0.0, 1.0)}},
    "semi_implicit": {"num_envs": 1, "integrator": "semi_implicit", "dt": 0.002},
    "linearly implicit": {"num_envs": 1, "integrator": "linearly_implicit", "dt": 0.01},
    "rk4 on the flat fish": {"num_envs": 1, "body": "planar", "integrator": "rk4", "dt": 0.004},
    "semi_implicit on the flat fish": {"num_envs": 1, "body": "planar", "integrator": "semi_implicit", "dt": 0.004},
    "linearly implicit on the flat fish": {
        "num_envs": 1,
        "body": "planar",
        "integrator": "linearly_implicit",
        "dt": 0.01,
    },
    "semi_implicit on two layers": {"num_envs": 1, "body": "two_layer", "integrator": "semi_implicit", "dt": 0.004},
    "linearly implicit on two layers": {
        "num_envs": 1,
        "body": "two_layer",
        "integrator": "linearly_implicit",
        "dt": 0.01,
    },
}


def stepped(options):
    """Observations, rewards and positions of two environment steps, as one row."""
    env = FishVectorEnv(**options, threads=1)
    action = np.random.default_rng(3).uniform(-1.0, 1.0, (2, *env.action_space.shape)).astype(np.float32)
    found = [env.reset(seed=5)[0]]
    for each in action:
        obs, reward, *_ = env.step(each)
        found += [obs, reward]
    found += [env.tank.position, [list(count) for count in env.tank.counters.values()]]
    env.close()
    return np.concatenate([np.ravel(part).astype(float) for part in found])


@pytest.fixture(scope="module")
def uncompiled():
    """The rows of all cases, by a process without the compiler."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    variables = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path}
    done = subprocess.run([sys.executable, __file__], env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", CASES)
def test_the_same_without_the_compiler(case, uncompiled):
    """To rounding: a fused product is rounded twice there, observations are of single precision; the same counters."""
    np.testing.assert_allclose(uncompiled[case], stepped(CASES[case]), rtol=1e-4, atol=1e-6)


if __name__ == "__main__":
    np.seterr(all="ignore")  # compiled kernels say nothing either
    print(json.dumps({case: stepped(options).tolist() for case, options in CASES.items()}))
