"""Published numbers: what makes them, how long that takes, and whether they are stale.

    python -m benchmarks                      list every published number
    python -m benchmarks stability.survey     make one of them again, or several; a room stands for all of its numbers
    python -m benchmarks --stale              make those again that are stale
    python -m benchmarks --all                make all of them again but those made at this very commit

Each runs in a process of its own; a failure does not stop the others. Those that replace parameters or policies of the
package run only when they are named. A number is stale where a reference trajectory that it follows has changed
(benchmarks/common/reference.py). Every command can be run by itself, too, and most have options: see its --help.
"""

import subprocess
import sys
import textwrap
import time

from benchmarks.common.tables import make_parser
from benchmarks.freshness import CURRENT, MISSING, STALE, status_of
from benchmarks.registry import REGISTRY, Result
from fish_env.training.checkout import ROOT, present_commit

WHOLE_WORDS = {"break_long_words": False, "break_on_hyphens": False}


def span(minutes: float) -> str:
    """Minutes as people say them."""
    return f"{minutes / 60:.3g} h" if minutes >= 90 else f"{60 * minutes:.0f} s" if minutes < 1 else f"{minutes:g} min"


def show(results: list[Result]) -> None:
    """Print every number with its command and its status."""
    room, count = "", {}
    for result in results:
        if result.room != room:
            room = result.room
            print(f"{room}\n{'-' * len(room)}")
        status = status_of(result.outputs, result.follows)
        count[status.state] = count.get(status.state, 0) + 1
        about = f"{status.commit} {status.date}".strip()
        print(f"{result.name:32}{status.state:22}{about:26}{span(result.minutes)}")
        note = status.why + "; " * bool(status.why and result.by_name) + "runs only by its name" * result.by_name
        outputs = ", ".join(name.removeprefix("benchmarks/results/") for name in result.outputs)
        for text in (result.shows, result.command_line, outputs, note):
            if text:
                print(textwrap.fill(text, 116, initial_indent="    ", subsequent_indent="      ", **WHOLE_WORDS))
        print()
    print(", ".join(f"{number} {state}" for state, number in count.items()))


def chosen(names: list[str], everything: bool, stale: bool) -> list[Result]:
    """The results that are asked for.

    Raises:
        ValueError: for a name that is neither a number's nor a room's.
    """
    if names:
        found = []
        for name in names:
            of_room = [result for result in REGISTRY.values() if result.room == name and not result.by_name]
            if name not in REGISTRY and not of_room:
                rooms = ", ".join(dict.fromkeys(result.room for result in REGISTRY.values()))
                raise ValueError(f"unknown name {name!r}; choose one that `python -m benchmarks` lists, or of {rooms}")
            found += [REGISTRY[name]] if name in REGISTRY else of_room
        return list(dict.fromkeys(found))
    found = [result for result in REGISTRY.values() if not result.by_name]
    if everything:  # what an interrupted run has made already has the commit in its head
        commit = present_commit()
        return [result for result in found if status_of(result.outputs, result.follows)[:2] != (CURRENT, commit)]
    return [result for result in found if stale and status_of(result.outputs, result.follows).state in (STALE, MISSING)]


def run(results: list[Result]) -> list[str]:
    """Run commands one after another; the names of those that failed."""
    print(f"{len(results)} to make, about {span(sum(result.minutes for result in results))} on two cores", flush=True)
    failed = []
    for number, result in enumerate(results, start=1):
        left = span(sum(each.minutes for each in results[number - 1 :]))
        print(f"\n[{number}/{len(results)}] {result.name}, about {left} left: {result.command_line}", flush=True)
        begin = time.perf_counter()
        code = subprocess.run(result.arguments(sys.executable), cwd=ROOT, check=False).returncode
        verdict = "done" if code == 0 else f"FAILED with exit status {code}"
        print(
            f"[{number}/{len(results)}] {result.name}: {verdict}, {span((time.perf_counter() - begin) / 60)}",
            flush=True,
        )
        failed += [result.name] * (code != 0)
    return failed


def main(arguments: list[str] | None = None) -> int:
    """The command line; exit status 1 if a command failed, 2 for a wrong name."""
    parser = make_parser(__doc__)
    parser.prog = "python -m benchmarks"
    parser.add_argument("names", nargs="*", metavar="name", help="a number or a room; default: list them all")
    parser.add_argument("--all", action="store_true", help="make all of them again")
    parser.add_argument("--stale", action="store_true", help="make those again that are stale")
    given = parser.parse_args(arguments)
    if (given.names and (given.all or given.stale)) or (given.all and given.stale):
        parser.error("give names, or --all, or --stale")
    if not (given.names or given.all or given.stale):
        show(list(REGISTRY.values()))
        return 0
    try:
        results = chosen(given.names, given.all, given.stale)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    try:
        failed = run(results)
    except KeyboardInterrupt:
        print("\ninterrupted", file=sys.stderr)
        return 130
    if failed:
        print(f"\nfailed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
