"""How fast other simulators compute the same springs, and other environments a step: results/speed/peers.csv.

    pip install -e ".[peers]"
    python -m benchmarks.speed.peers

Everything runs in one process on one core (the last one it may use), measured in turn. No spring is timed before its
masses arrive, after 1000 steps of the same method, where ours do.
"""

import argparse
import os
import sys
from functools import partial
from importlib.util import find_spec

from benchmarks.common.tables import write_csv
from benchmarks.common.timing import interleaved

ROUNDS = 15
SAMPLE = 0.04  # s that a peer runs in a round, about
BATCHES = (1, 256)
PACKAGES = ("mujoco", "newton")


def spring_rows(num_fish: int) -> list[dict]:
    """Check, then time, every peer on the same springs; ours first."""
    from benchmarks.speed import mujoco_springs, newton_springs, scene

    peers = [*scene.ours(num_fish)]
    for module in (mujoco_springs, newton_springs):
        peers += module.peers(num_fish)
    runs, agreed = [], []
    for peer in peers:
        agreed.append(scene.disagreement(peer))
        print(f"{peer.name:28}{peer.precision}, {num_fish:3} fish: {agreed[-1]:.1e} BL from ours", flush=True)
        probe = interleaved([(peer.start, partial(peer.advance, peer.chunk), peer.chunk)], 3)[0].time[1]
        steps = peer.chunk * max(1, round(SAMPLE / (probe * 1e-6 * peer.chunk)))
        runs.append((peer.start, partial(peer.advance, steps), steps * num_fish))
    costs = interleaved(runs, ROUNDS)
    return [
        row("springs", peer.name, peer.package, num_fish, cost, peer.precision, scene.STEP, found)
        for peer, cost, found in zip(peers, costs, agreed, strict=True)
    ]


def environment_rows(environments: list, rounds: int) -> list[dict]:
    """Time environment steps; ours first."""
    costs = interleaved([(lambda: None, each.run, each.steps) for each in environments], rounds)
    return [
        row("environment step", each.name, each.package, each.copies, cost, "", each.interval)
        for each, cost in zip(environments, costs, strict=True)
    ]


def row(what, name, package, copies, cost, precision, interval, found=None) -> dict:
    """One line of the table; `interval` is the simulated time of a step, s."""
    times, ratios = cost.time, cost.ratio
    return {
        "what": what, "name": name, "package": package, "copies": copies, "precision": precision,
        "simulated_s": interval, "us": f"{times[1]:.4g}", "us_q1": f"{times[0]:.4g}", "us_q3": f"{times[2]:.4g}",
        "times_ours": f"{ratios[1]:.3g}", "times_q1": f"{ratios[0]:.3g}", "times_q3": f"{ratios[2]:.3g}",
        "disagreement_bl": "" if found is None else f"{found:.1e}",
    }  # fmt: skip


def main() -> int:
    """Measure, print and write."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        print(f"{', '.join(missing)} not installed; pip install 'fish_env[peers]'", file=sys.stderr)
        return 2
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    from benchmarks.speed import environments

    rows = [each for num_fish in BATCHES for each in spring_rows(num_fish)]
    rows += environment_rows(environments.singles(), ROUNDS) + environment_rows(environments.vectors(), ROUNDS // 3)
    for each in rows:
        spread = f"{each['times_ours']} ({each['times_q1']}-{each['times_q3']})"
        print(f"{each['name']:44}{each['precision']:9}{each['copies']:4}{each['us']:>9} us  {spread} of ours")
    print(f"written to {write_csv('speed/peers.csv', rows, 'python -m benchmarks.speed.peers')}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
