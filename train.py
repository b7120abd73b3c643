"""Train a policy, evaluate it, watch it.

python train.py swim                                 train, then report (tasks: see below)
python train.py swim --resume runs/swim/<time>       resume a run that was stopped
python train.py swim --body two_layer                train on another body (planar, mass_spring, two_layer, tetrahedral)
python train.py swim --integrator semi_implicit      train with another integrator (and, with --dt, another step)
python train.py swim --body tetrahedral --start-from runs/swim/<time>   start from a policy trained on another
python train.py all                                  train every task with all its seeds; can be stopped and resumed
python train.py all --integrator semi_implicit       the same with another integrator, three seeds a task
python train.py evaluate runs/swim/<time>/policy.npz evaluate policies on the fixed seeds
python train.py compare runs/swim/<time>/policy.npz  the same, beside the controllers without learning
python train.py compare --integrators                replay the shipped policies with every integrator
python train.py report runs/swim/<time>              one HTML page of a run, or of several beside each other
python train.py play runs/swim/<time>/policy.npz     watch it in a window (or --save FILE.html, .mp4)
"""

import argparse
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

MOST_THREADS = 1024
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def parse() -> argparse.Namespace:
    """The command line."""
    from agents.config import CONFIGS, FINE_TUNING
    from fish_env.__main__ import add_policy_commands

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for task, config in CONFIGS.items():
        command = commands.add_parser(task, help=f"train {config.env_id}")
        command.add_argument("--seed", type=int, help="of the learner (default 0)")
        command.add_argument(
            "--timesteps", type=int, help=f"environment steps to train for (default {config.timesteps:,})"
        )
        command.add_argument("--num-envs", type=int, help=f"fish trained side by side (default {config.num_envs})")
        command.add_argument("--resume", type=Path, help="folder of a run to resume")
        command.add_argument("--body", help="train on this body (default mass_spring)")
        command.add_argument("--integrator", help="move the fish by this method (default the body's own)")
        command.add_argument("--dt", type=float, help="by steps of so many s (default those of the method)")
        command.add_argument("--start-from", type=Path, help="fine-tune the policy of this run, by default for "
                             f"{FINE_TUNING['timesteps']:,} steps of {FINE_TUNING['num_envs']} fish")  # fmt: skip
        command.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are saved (default runs)")
        command.add_argument("--folder", type=Path, help="save the run in this folder")
        command.add_argument("--no-pictures", action="store_true", help="only evaluate the policy at the end")
        command.add_argument("--torch-threads", type=int, default=1, help="threads of the updates (default 1)")
    command = commands.add_parser("all", help="train every task with all its seeds, and publish the results")
    command.add_argument("--runs", type=Path, help="where runs are saved (default runs/all)")
    command.add_argument("--tasks", nargs="+", help="only these")
    command.add_argument("--jobs", type=int, help="runs side by side (default one on each processor)")
    command.add_argument("--ray", metavar="ADDRESS", help="on a Ray cluster (local: one that is begun here)")
    command.add_argument("--integrator", help="with this method, three seeds a task, in runs/all_<integrator>")
    command.add_argument("--dt", type=float, help="by steps of so many s (default those of the method)")
    command = commands.add_parser("compare", help="evaluate policies beside the controllers without learning")
    command.add_argument("policies", type=Path, nargs="*", help="default: those that are shipped")
    command.add_argument("--integrators", action="store_true", help="under every integrator, RK4 as the reference")
    command = commands.add_parser("report", help="write an HTML page of a run, or of several beside each other")
    command.add_argument("folders", type=Path, nargs="+", help="of runs; seeds are put together")
    command.add_argument("--save", type=Path, help="the page (default report.html in the folder of all)")
    command.add_argument("--episodes", type=int, default=100, help="that each policy is measured in (default 100)")
    add_policy_commands(commands)
    return parser.parse_args()


def run(arguments: argparse.Namespace, came: list[int]) -> None:
    """Run a command; `came` gets the signals that are to stop it."""
    if arguments.command in ("evaluate", "play"):
        from fish_env.__main__ import run_policy_command

        run_policy_command(arguments)
    elif arguments.command == "compare" and arguments.integrators:
        from benchmarks.learning.integrators import compare_integrators

        compare_integrators(arguments.policies)
    elif arguments.command == "compare":
        from agents.report import compare

        compare(arguments.policies)
    elif arguments.command == "report":
        from agents.run_report import write_report

        print(f"written to {write_report(arguments.folders, arguments.save, arguments.episodes)}")
    elif arguments.command == "all":
        from agents.train_all import train_all
        from benchmarks.learning.publish import publish, publish_method

        integrator = arguments.integrator
        runs = arguments.runs or Path("runs", f"all_{integrator}" if integrator else "all")
        if arguments.dt is not None and integrator is None:
            raise ValueError("--dt goes with --integrator: name the method whose step it is")
        train_all(runs, arguments.tasks, arguments.jobs, integrator, arguments.dt, arguments.ray, lambda: bool(came))
        if integrator is None:
            publish(runs, arguments.tasks)
        else:
            publish_method(runs, integrator, arguments.tasks)
    else:
        import torch

        from agents.train import Request, train

        if not 1 <= arguments.torch_threads <= MOST_THREADS:
            raise ValueError(f"--torch-threads is {arguments.torch_threads}; give 1 to {MOST_THREADS}")
        torch.set_num_threads(arguments.torch_threads)

        train(
            Request(
                arguments.command, arguments.seed, arguments.runs, arguments.folder, arguments.resume,
                arguments.start_from, arguments.body, integrator=arguments.integrator,
                dt=arguments.dt, pictures=not arguments.no_pictures,
                changes={"timesteps": arguments.timesteps, "num_envs": arguments.num_envs}, stopped=lambda: bool(came),
            )
        )  # fmt: skip


@contextmanager
def hear_first_signal() -> Iterator[list[int]]:
    """A context in which SIGTERM and SIGHUP do what Ctrl-C does; after the first of them, no other interrupts.

    A second one would end the saving. It yields the list of those that came. `nohup` works as usual.
    """
    came: list[int] = []

    def stop(number, frame):
        came.append(number)
        if len(came) == 1:
            raise KeyboardInterrupt

    numbers, hangup = [signal.SIGINT, signal.SIGTERM], getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) is not signal.SIG_IGN:
        numbers.append(hangup)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def print_error(text: str) -> None:
    """Print to stderr, unless the terminal is closed."""
    with suppress(OSError):
        print(text, file=sys.stderr)


def run_command_line(came: list[int]) -> int:
    """Run the command of the command line; errors that a user can correct are one line without a traceback."""
    try:
        from fish_env.control.console import run_command

        return run_command("train.py", lambda: command(came))
    except ImportError as error:
        print_error(f'train.py: {error}; install it, in the checkout: pip install -c constraints.txt -e ".[train]"')
        return 2


def command(came: list[int]) -> int:
    """Read the command line and run it; the exit status."""
    try:
        run(parse(), came)
    except KeyboardInterrupt as stop:
        if type(stop) is KeyboardInterrupt:  # else the saved files were printed already
            print_error("\nStopped.")
        if sys.argv[1:2] == ["all"]:
            print_error(f"Resume: python train.py {' '.join(sys.argv[1:])}")
        return 128 + signal.SIGINT
    return 0


def main() -> int:
    """The command line; its exit status is 128 and the number of the signal, if one has stopped it."""
    for name in THREADS:  # before numpy and torch are loaded
        os.environ.setdefault(name, "1")
    saves = sys.argv[1:2] not in [["evaluate"], ["compare"], ["report"], ["play"]]
    with hear_first_signal() if saves else nullcontext([]) as came:
        status = run_command_line(came)
    return 128 + came[0] if came else status


if __name__ == "__main__":
    sys.exit(main())
