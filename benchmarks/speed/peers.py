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
BATCH = 256
PACKAGES = ("mujoco", "warp", "newton")
BARS = {1: 15.0, BATCH: 60.0}  # how many of our steps one of MuJoCo's is to take at least, by the number of fish


def spring_rows(num_fish: int) -> list[dict]:
    """Check, then time, every peer on the same springs; ours first."""
    from benchmarks.speed import mujoco_springs, newton_springs, scene, warp_springs

    peers = [*scene.ours(num_fish)]
    for module in (mujoco_springs, newton_springs, warp_springs):
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


def bars(rows: list[dict]) -> bool:
    """Print whether MuJoCo's fastest way takes as many of our steps as it should; True if so for each batch."""
    met = True
    for num_fish, least in BARS.items():
        ratio, name = min(
            (float(each["times_ours"]), each["name"])
            for each in rows
            if each["copies"] == num_fish and each["name"].startswith("MuJoCo")
        )
        met &= ratio >= least
        verdict = "met" if ratio >= least else "MISSED"
        print(f"{num_fish:3} fish: {name} takes {ratio:.3g} of our steps, bar {least:g}: {verdict}")
    return met


def main() -> int:
    """Measure, print, write, and compare with the bars; exit 1 if one is missed."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        print(f"{', '.join(missing)} not installed; pip install 'fish_env[peers]'", file=sys.stderr)
        return 2
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    from benchmarks.speed import environments

    rows = [each for num_fish in BARS for each in spring_rows(num_fish)]
    met = bars(rows)
    rows += environment_rows(environments.singles(), ROUNDS) + environment_rows(environments.vectors(), ROUNDS // 3)
    for each in rows:
        spread = f"{each['times_ours']} ({each['times_q1']}-{each['times_q3']})"
        print(f"{each['name']:44}{each['precision']:9}{each['copies']:4}{each['us']:>9} us  {spread} of ours")
    print(f"written to {write_csv('speed/peers.csv', rows, 'python -m benchmarks.speed.peers')}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
