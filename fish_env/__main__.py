"""The command line of the package: what there is, and trained policies to watch and to evaluate.

python -m fish_env                      list environments, bodies, integrators and the policies that are shipped
python -m fish_env play turn            watch a shipped policy in a window (or --save FILE.html, .mp4, .webp, .gif)
python -m fish_env evaluate turn        evaluate a shipped policy on fixed seeds
python -m fish_env replay FILE.npz       simulate a recorded episode again and compare bit for bit
python -m fish_env lab                  open the laboratory in the browser: look at soft bodies, pull and change them
python -m fish_env compile swim         compile its kernels ahead of their first use, for an image or a shared folder
python -m fish_env versions             name the versions of what it runs with
"""

import argparse
import inspect
import json
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import gymnasium as gym

import fish_env
from fish_env.control.console import answered
from fish_env.control.evaluation import (
    EPISODES,
    FIRST_SEED,
    checked_episodes,
    evaluate,
    make_policy_env,
    means,
    policy_controller,
)
from fish_env.control.files import writable_file, write_text
from fish_env.control.film import write_film
from fish_env.control.playback import play
from fish_env.control.policy import Policy, load_policy, shipped_policies, shipped_policy
from fish_env.control.recording import load_recording
from fish_env.control.replaying import replay
from fish_env.envs.ahead import compile_ahead, stored_kernels
from fish_env.lab import LOOPBACK, serve

PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch", "pygame-ce", "moviepy")

FILES = "an .html page that turns in 3-D, an .mp4, .webp or .gif video, or an .npz recording"


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m fish_env", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command")
    laboratory = commands.add_parser("lab", help="open the laboratory in the browser, for this machine only")
    laboratory.add_argument(
        "--host", default=LOOPBACK, help=f"address to listen at (default {LOOPBACK}, which only this machine can open; "
        "0.0.0.0 can be opened by every machine that reaches this one, without a password)",
    )  # fmt: skip
    laboratory.add_argument("--port", type=int, default=8080, help="TCP port (default 8080, or the next free one)")
    command = commands.add_parser("compile", help="compile kernels ahead of their first use, into FISH_ENV_CACHE")
    command.add_argument("task", nargs="*", metavar="task", help=f"which (default all): {', '.join(fish_env.TASKS)}")
    command.add_argument("--body", nargs="+", default=["mass_spring"], help="on which bodies (default mass_spring)")
    command.add_argument("--dtype", nargs="+", default=["float64"], help="float64, float32 or both (default float64)")
    command.add_argument("--integrator", help="with this integrator instead of the body's own")
    commands.add_parser("versions", help="name the versions of Python and of the packages it runs with")
    command = commands.add_parser("replay", help="simulate a recorded episode again and compare bit for bit")
    command.add_argument("recording", type=Path, help="a file of fish_env.control.record")
    command.add_argument("--save", type=Path, help="show it too: a page or a video")
    for name, text in (("play", "watch a trained policy"), ("evaluate", "evaluate a trained policy on fixed seeds")):
        command = commands.add_parser(name, help=text)
        command.add_argument("task", nargs="?", help=f"which shipped policy: {', '.join(shipped_policies())}")
        command.add_argument("--policy", type=Path, help="this policy file instead of the shipped one")
        command.add_argument("--body", help="on another body than the one it was trained with")
        command.add_argument("--integrator", help="under another integrator than the one it was trained with")
        if name == "play":
            command.add_argument("--save", "--to", type=Path, dest="to", help=f"write a file, no window: {FILES}")
            command.add_argument("--seed", type=int, default=0, help="of the first episode (default 0)")
            command.add_argument("--episodes", type=int, default=1, help="how many (default 1)")
        else:
            command.add_argument("--to", type=Path, help="write the means to a .json file too")
            command.add_argument("--seed", type=int, default=FIRST_SEED, help=f"of the first (default {FIRST_SEED})")
            command.add_argument("--episodes", type=int, default=EPISODES, help=f"how many (default {EPISODES})")
    return parser.parse_args(arguments)


def list_all() -> None:
    """Print the environments and what they may be made of."""
    print(f"fish_env {fish_env.__version__}\n\nEnvironments: gymnasium.make(id, body=..., integrator=...)")
    for id, spec in gym.registry.items():
        if id.startswith("FishEnv/"):
            print(f"  {id:30}{asked(spec)}")
    print("\nBodies")
    for body in fish_env.BODIES.values():
        print(f"  {body.name:30}{body.description}")
    print("\nIntegrators")
    for record in fish_env.INTEGRATORS.values():
        print(f"  {record.name:30}{record.kind}, order {record.order} ({record.source})")
    print(f"\nShipped policies: {', '.join(shipped_policies())}\nCommands: python -m fish_env --help")


def asked(spec) -> str:
    """Summary of the task of an environment: the first sentence of its docstring."""
    if "Stub" in spec.id:
        return "The spaces of Swim-v0 without physics, for unit tests."
    text = " ".join((inspect.getdoc(fish_env.TASKS[spec.kwargs["task"]]) or "").split("\n\n")[0].split())
    return text.split(". ")[0].removesuffix(".") + "."


def chosen_policy(arguments: argparse.Namespace) -> Policy:
    """The policy that the command line names.

    Raises:
        ValueError: if it names none, or a file for another environment than that of the task.
    """
    shipped = None if arguments.task is None else load_policy(shipped_policy(arguments.task))
    if arguments.policy is not None:
        return load_policy(arguments.policy, None if shipped is None else shipped.about["env_id"])
    if shipped is None:
        raise ValueError(f"give one of {', '.join(shipped_policies())}, or --policy FILE")
    return shipped


def evaluate_policy(arguments: argparse.Namespace) -> None:
    """Print the means over the episodes, and write them to a file on request."""
    checked_episodes(arguments.episodes, arguments.seed)
    if arguments.to is not None:
        writable_file(arguments.to, (".json",))
    policy = chosen_policy(arguments)
    env = make_policy_env(policy, arguments.episodes, body=arguments.body, integrator=arguments.integrator)
    found = means(evaluate(policy_controller(policy, env), env, arguments.seed))
    env.close()
    print(f"{policy.about['env_id']}: mean over {arguments.episodes} episodes, seeds from {arguments.seed}")
    for name, value in found.items():
        print(f"  {name:20}{'-' if value is None else f'{value:.4g}'}")
    if arguments.to is not None:
        record = {"env_id": policy.about["env_id"], "episodes": arguments.episodes, "first_seed": arguments.seed,
                  "body": arguments.body, "integrator": arguments.integrator, "means": found}  # fmt: skip
        write_text(arguments.to, json.dumps(record, indent=2) + "\n")


def replay_file(path: Path, save: Path | None) -> int:
    """Print the result of a replay, and write a film on request; return 1 for a replay that differs."""
    recording = load_recording(path)
    found = replay(recording)
    print(found)
    if save is not None:
        print(f"written to {write_film(recording, save)}")
    return 0 if found.same else 1


def compile_kernels(arguments: argparse.Namespace) -> None:
    """Compile the requested kernels, and print how many are stored where."""
    tasks = arguments.task or list(fish_env.TASKS)
    for name, new, total in compile_ahead(tasks, arguments.body, arguments.dtype, arguments.integrator):
        print(f"{name}: {new} new kernels, {total} in all", flush=True)
    folder, files = stored_kernels()
    print(f"{sum(path.stat().st_size for path in files) / 1e6:.0f} MB in {folder}")


def installed(package: str) -> str:
    """The version of a package, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def print_versions() -> None:
    """Print the version of Python, of this package and of those that it uses."""
    found = {"python": platform.python_version(), "fish_env": fish_env.__version__}
    for name, text in (found | {package: installed(package) for package in PACKAGES}).items():
        print(f"{name:20}{text}")


def run(arguments: argparse.Namespace) -> int:
    """Run a command; the exit status, 1 for a replay that differs."""
    if arguments.command is None:
        list_all()
    elif arguments.command == "versions":
        print_versions()
    elif arguments.command == "compile":
        compile_kernels(arguments)
    elif arguments.command == "lab":
        serve(arguments.host, arguments.port)
    elif arguments.command == "evaluate":
        evaluate_policy(arguments)
    elif arguments.command == "replay":
        return replay_file(arguments.recording, arguments.save)
    else:
        play(chosen_policy(arguments), arguments.seed, arguments.episodes, arguments.to,
             body=arguments.body, integrator=arguments.integrator)  # fmt: skip
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Run a command; errors that a user can correct are printed without a traceback."""
    return answered("fish_env", lambda: run(parse(arguments)))


if __name__ == "__main__":
    sys.exit(main())
