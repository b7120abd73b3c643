"""The program `fish_env` in short form, with what only a checkout can do.

python train.py swim                      train a policy: the same as fish_env train swim
python train.py all                       train every task with all its seeds; can be stopped and resumed
python train.py all --integrator rk4      the same with another integrator
python train.py compare --integrators     replay the shipped policies with every integrator
python train.py play runs/swim/<time>     as fish_env does; also evaluate, compare, report, and all the others
"""

import argparse
import os
import sys
from collections.abc import Collection
from pathlib import Path

INSTALL = 'pip install -c constraints.txt -e ".[train]"'
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy and torch are loaded
    os.environ.setdefault(_name, "1")


def make_parser() -> tuple[argparse.ArgumentParser, Collection[str]]:
    """The parser of `fish_env` with the commands of the checkout, and the names of all commands."""
    from fish_env.__main__ import make_parser

    parser, commands = make_parser("train.py")
    parser.description = __doc__
    command = commands.add_parser("all", help="train every task with all its seeds, and publish the results")
    command.set_defaults(run=train_everything)
    command.add_argument("--runs", type=Path, help="where runs are saved (default runs/all)")
    command.add_argument("--tasks", nargs="+", help="only these")
    command.add_argument("--jobs", type=int, help="runs side by side (default one on each processor)")
    command.add_argument("--integrator", help="with this method, in runs/all_<integrator>")
    command.add_argument("--dt", type=float, help="by steps of so many s (default those of the method)")
    command = commands.choices["compare"]
    command.add_argument("--integrators", action="store_true", help="under every integrator, RK4 as the reference")
    command.set_defaults(run=compare)
    return parser, commands.choices


def compare(arguments: argparse.Namespace) -> None:
    """Compare policies with the controllers without learning, or under every integrator."""
    from fish_env.__main__ import compare_policies, find_policy

    if arguments.integrators:
        usual = make_parser()[0].parse_args(["compare", *arguments.policies, "--integrators"])
        if other := sorted(name for name in vars(usual) if vars(usual)[name] != vars(arguments)[name]):
            raise ValueError(f"--integrators goes with names of policies alone; leave out {', '.join(other)}")
        from benchmarks.learning.integrators import compare_integrators

        compare_integrators([find_policy(name) for name in arguments.policies])
    else:
        compare_policies(arguments)


def train_everything(arguments: argparse.Namespace) -> None:
    """Train and publish; a signal saves the runs."""
    from agents.train_all import train_all
    from benchmarks.learning.publish import publish, publish_method
    from fish_env.control.console import interrupt_once

    integrator, signals = arguments.integrator, arguments.signals
    runs = arguments.runs or Path("runs", f"all_{integrator}" if integrator else "all")
    if arguments.dt is not None and integrator is None:
        raise ValueError("--dt goes with --integrator: name the method whose step it is")
    with interrupt_once(signals):
        try:
            train_all(runs, arguments.tasks, arguments.jobs, integrator, arguments.dt, lambda: bool(signals))
        finally:
            if signals:
                print(f"\nResume: python train.py {' '.join(sys.argv[1:])}", file=sys.stderr)
        if integrator is None:
            publish(runs, arguments.tasks)
        else:
            publish_method(runs, integrator, arguments.tasks)


def main() -> int:
    """The exit status of the command line; a first word that is no command is a task to train."""
    try:
        from fish_env.__main__ import main

        parser, commands = make_parser()
    except ImportError as error:
        print(f"train.py: {error}; install what it needs: {INSTALL}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nStopped.", file=sys.stderr)
        return 130
    words = sys.argv[1:]
    if words and words[0] not in commands and not words[0].startswith("-"):
        words = ["train", *words]
    return main(words, parser, INSTALL)


if __name__ == "__main__":
    sys.exit(main())
