"""Every method in kernels of every kind: the same bits in float64, close to them in float32, found again on disk."""

import os
import subprocess
import sys
from pathlib import Path

import naive
import numpy as np
import pytest
from moving import FIXED_STEP, SEMI_IMPLICIT, each_fixed, tank_of, tiered, world_of

from fish_env import INTEGRATORS, make_fish
from fish_env.bodies import BODIES
from fish_env.kernels.fingerprint import fingerprint
from fish_env.physics import forces
from fish_env.physics.engine import make_advance
from fish_env.physics.integrators import get_integrator
from fish_env.physics.tank_options import own_step

FISH = {name: make_fish(name) for name in BODIES}
COUNT = 18  # two full blocks of eight and two that are left over, or one of sixteen
QUICK = "mass_spring"


def moved(name, body, kind, steps=5, **options):
    """A tank of COUNT fish in water, shaken and driven, every third with a stiffness, mass and current of its own.

    Bodies that tear more easily than QUICK are shaken a fifth as much, and take half the step.
    """
    calm, part = (1.0, 1.0) if body == QUICK else (0.2, 0.5)
    fish, rng = FISH[body], np.random.default_rng(2)
    free = fish.body.inverse_mass > 0
    x = fish.body.position + calm * 0.005 * fish.length * rng.uniform(-1, 1, (COUNT, *free.shape)) * free
    v = calm * 0.2 * fish.length / fish.contraction_time * rng.uniform(-1, 1, x.shape) * free
    natural = fish.body.springs.rest_length
    rest = natural * rng.uniform(1 - 0.03 * calm, 1 + 0.03 * calm, (COUNT, len(natural)))
    rate = 0.1 * rest * rng.uniform(-1, 1, rest.shape) / fish.contraction_time
    h = part * naive.SHORTER.get(name, 1) * own_step(fish, INTEGRATORS["symplectic_euler"])
    tank = tank_of(name, fish, world_of(fish), x, v, h, rest, rate, lanes=kind, **options)
    for i in range(0, COUNT, 3):
        tank.vary(i, stiffness=1.1, mass=0.9, drag=1.2, current=(0.01, 0.02, 0.0))
    tank.advance(steps)
    assert tank.alive.all()
    return tank


@each_fixed
@pytest.mark.parametrize("body", tiered(BODIES, (QUICK,)))
@pytest.mark.parametrize("lanes", tiered((1, 4, 8, 16), (8,)))
def test_bits(name, body, lanes):
    """Fish side by side in lanes end, bit for bit, where each ends alone with its coordinates in a register."""
    alone, together = moved(name, body, "xyz"), moved(name, body, lanes)
    for one, many in zip(alone.state, together.state, strict=True):
        np.testing.assert_array_equal(one, many)
    assert np.abs(alone.position[1] - alone.position[2]).max() > 1e-4 * alone.fish.length


@pytest.mark.parametrize("name", tiered(FIXED_STEP, SEMI_IMPLICIT))
@pytest.mark.parametrize("lanes", tiered((16, "xyz", 1), (16,)))
def test_single_precision(name, lanes):
    """In float32 every method moves the fish as in float64, to that precision."""
    exact, near = moved(name, QUICK, "xyz"), moved(name, QUICK, lanes, dtype="float32")
    way = np.abs(exact.velocity).max() * exact.time[0]
    size = np.abs(exact.position).max()
    np.testing.assert_allclose(near.position, exact.position, rtol=0, atol=1e-3 * way + 1e-6 * size)
    np.testing.assert_allclose(near.velocity, exact.velocity, rtol=0, atol=2e-3 * np.abs(exact.velocity).max())


def code(name):
    """What the compiled loop of a method is found by on disk: a hash of the code that goes into it."""
    body, world = FISH[QUICK].body, world_of(FISH[QUICK])
    run = make_advance(forces.present(body, world), get_integrator(name).method.make_run)
    return fingerprint(run.py_func)


def test_code_on_disk_has_the_same_name_in_every_process():
    """Methods are told apart by what they do, and in no process by where they stand in memory."""
    root = Path(__file__).parent
    script = "from test_method_kinds import FIXED_STEP, code\nfor name in FIXED_STEP:\n    print(code(name))\n"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (root, root.parent))), "PYTHONHASHSEED": "7"}
    other = subprocess.run([sys.executable, "-c", script], env=environment, cwd=root.parent, text=True, check=True,
                           capture_output=True).stdout.split()  # fmt: skip
    ours = [code(name) for name in FIXED_STEP]
    assert ours == other
    assert len(set(ours)) == len(ours) - 1  # the projected method differs from the plain one by a number of its plan
    for name in FIXED_STEP:
        assert hash(get_integrator(name).method) == hash(get_integrator(name).method)
