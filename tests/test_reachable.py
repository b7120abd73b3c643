"""No array that a user can reach by public attributes ends the process: what kernels index with cannot be changed."""

import subprocess
import sys

import pytest

WRITE = """
import gymnasium as gym
import numpy as np
import fish_env
from fish_env import Tank, make_fish
from fish_env.bodies.objects import make_ring

HUGE = 10**9


def reachable(value, place, seen):
    # Whole numbers in arrays that public attributes lead to, by where they are.
    if id(value) in seen:
        return
    seen[id(value)] = value
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "iu":
            yield place, value
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from reachable(part, f"{place}[{key!r}]", seen)
    elif isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        for k, part in enumerate(value):
            yield from reachable(part, f"{place}[{k}]", seen)
    elif type(value).__module__.startswith("fish_env"):
        for name in dir(value):
            if not name.startswith("_") and not callable(part := getattr(value, name, None)):
                yield from reachable(part, f"{place}.{name}", seen)


def attack(thing, place, use):
    # Write a huge number, and its negative, to each; use the thing; put it back.
    found = list(reachable(thing, place, {}))
    written = []
    for name, array in found:
        before = array.copy()
        for number in (HUGE, -HUGE):
            try:
                array[...] = number
            except ValueError:  # read-only
                continue
            written.append(name)
            try:
                use()
            except (ValueError, IndexError, OverflowError) as error:
                print("refused", name, error)
            array[...] = before
    print(place, len(found), "arrays,", len(set(written)), "of them written:", *sorted(set(written)))


def env(id, single, **options):
    made = gym.make(id, **options).unwrapped if single else gym.make_vec(id, 2, **options)
    made.reset(seed=0)
    zero = np.zeros(made.action_space.shape, dtype=np.float32)

    def use():
        for _ in range(70):  # commands are given by then
            made.step(zero)
        made.call("episode_info") if not single else made.episode_info()
        made.reset(seed=0)

    attack(made, f"{id[8:-3]}{' single' * single}", use)


def tank(name, held=False):
    made = Tank(make_ring() if name == 'ring' else make_fish(name), 2)
    if held:
        made.fix([0, 1])
        made.grab(2, np.zeros(3), 1.0)

    def use():
        if made.fish.num_muscles:
            made.swim(np.zeros(made.fish.num_muscles), 3 * made.dt)
        made.advance(3)
        made.failure
        made.reset()

    attack(made, f"tank of {name}{' held' * held}", use)
"""


def survived(*calls):
    """What a process prints that does this; it must end by itself."""
    code = WRITE + "\n".join(calls) + "\nprint('survived')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.endswith("survived\n"), (done.returncode, done.stdout, done.stderr)
    return done.stdout


@pytest.mark.parametrize("task", ["Swim", "Turn", "LeftAfterRight", "Target", "Avoid"])
def test_environments(task):
    """A huge number written to any array that an environment shows is refused, or does no harm."""
    printed = survived(f"env('FishEnv/{task}-v0', True)", f"env('FishEnv/{task}-v0', False, muscle_groups='pairs')")
    written = printed.partition("of them written:")[2]
    for name in ("groups", "first_muscle", ".muscles", "node", "drives", "fibres", "left", "right", "landmarks"):
        assert name not in written, f"{name} can be written to"


def test_tanks():
    """So it is for tanks, of a fish, of one that is held, and of another elastic object."""
    survived("tank('mass_spring')", "tank('mass_spring', True)", "tank('ring')")
