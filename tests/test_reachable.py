"""No array that a user can reach by public attributes ends the process: what kernels index with cannot be changed."""

import subprocess
import sys

WRITE = """
import gymnasium as gym
import numpy as np
import fish_env
from fish_env import Tank, make_fish
from fish_env.soft.objects import make_ring

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


CALLS = [f"env('FishEnv/{task}-v0', {single})"
         for task in ("Swim", "Turn", "LeftAfterRight", "Target", "Avoid", "FastStart")
         for single in ("True", "False, muscle_groups='pairs'")]  # fmt: skip
CALLS += ["tank('mass_spring')", "tank('mass_spring', True)", "tank('ring')"]


def test_huge_numbers_do_no_harm():
    """A huge number written to any array that an environment or a tank shows is refused, or does no harm."""
    code = WRITE + "\n".join(CALLS) + "\nprint('survived')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.endswith("survived\n"), (done.returncode, done.stdout, done.stderr)
    written = [line.partition("of them written:")[2] for line in done.stdout.splitlines() if " arrays, " in line]
    assert len(written) == len(CALLS)
    for line in written[:-3]:  # of environments
        for name in ("groups", "first_muscle", ".muscles", "node", "drives", "fibres", "left", "right", "landmarks"):
            assert name not in line, f"{name} can be written to"
