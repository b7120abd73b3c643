"""Without the compiler, environments and tanks do what they do with it: every kernel is also plain Python."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from moving import tiered
from pages import ROOT

from fish_env import TASKS
from fish_env.envs import FishVectorEnv

CASES = {
    **{f"{task}, 1 fish": {"task": task, "num_envs": 1} for task in TASKS},
    "2 fish in 8 lanes": {"num_envs": 2, "lanes": 8, "variation": {"mass": (0.5, 2.0), "current": (0.0, 1.0)}},
    **{
        f"{method} on {body}": {"num_envs": 1, "integrator": method, "body": body, "dt": dt}
        for body, shortest in (("mass_spring", 0.002), ("planar", 0.004), ("two_layer", 0.004))
        for method, dt in (("semi_implicit", shortest), ("linearly_implicit", 0.01), ("rk4", shortest))
    },
}
QUICK = {case for case in CASES if " fish" in case} | {"linearly_implicit on planar", "semi_implicit on mass_spring"}


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
def uncompiled(request):
    """The rows of the cases of this run, by a process without the compiler."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    variables = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": path}
    own = (item for item in request.session.items if item.path == Path(__file__))
    cases = [item.callspec.params["case"] for item in own]
    done = subprocess.run([sys.executable, __file__, *cases], env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", tiered(CASES, QUICK))
def test_the_same_without_the_compiler(case, uncompiled):
    """To rounding: a fused product is rounded twice there, observations are of single precision; the same counters."""
    np.testing.assert_allclose(uncompiled[case], stepped(CASES[case]), rtol=1e-4, atol=1e-6)


if __name__ == "__main__":
    np.seterr(all="ignore")  # compiled kernels say nothing either
    print(json.dumps({case: stepped(CASES[case]).tolist() for case in sys.argv[1:]}))
