"""The command line of the package: what there is, and trained policies to watch and to evaluate.

python -m fish_env                      list environments, bodies, integrators and the policies that are shipped
python -m fish_env play turn            watch a policy in a window (or --save FILE.html, .mp4, .webp, .gif)
python -m fish_env evaluate turn swim   evaluate policies on fixed seeds: shipped ones by name, others by their file
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
from fish_env.control.console import run_command
from fish_env.control.evaluation import (
    EPISODES,
    FIRST_SEED,
    checked_episodes,
    evaluate,
    make_policy_env,
    means,
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
    add_policy_commands(commands)
    return parser.parse_args(arguments)


def add_policy_commands(commands) -> None:
    """Add `play` and `evaluate` to the commands of a parser; `run_policy_command` runs them."""
    known = f"a shipped policy ({', '.join(shipped_policies())}) or a policy file"
    for name, text, count, episodes, seed in (
        ("play", "watch a trained policy", "?", 1, 0),
        ("evaluate", "evaluate trained policies on fixed seeds", "*", EPISODES, FIRST_SEED),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("policies", nargs=count, metavar="policy", help=known)
        command.add_argument("--policy", type=Path, help="a policy file, whatever its name")
        command.add_argument("--body", help="on another body than the one it was trained with")
        command.add_argument("--integrator", help="under another integrator than the one it was trained with")
        command.add_argument("--dt", type=float, help="and with another step, s")
        command.add_argument("--seed", type=int, default=seed, help=f"of the first episode (default {seed})")
        command.add_argument("--episodes", type=int, default=episodes, help=f"how many (default {episodes})")
        if name == "play":
            command.add_argument("--save", "--to", "--video", type=Path, dest="to", help=f"write a file: {FILES}")
        else:
            command.add_argument("--to", type=Path, help="write the means to a .json file too")


def list_all() -> None:
    """Print the environments and what they may be made of."""
    print(f"fish_env {fish_env.__version__}\n\nEnvironments: gymnasium.make(id, body=..., integrator=...)")
    for id, spec in gym.registry.items():
        if id.startswith("FishEnv/"):
            print(f"  {id:30}{task_summary(spec)}")
    print("\nBodies")
    for body in fish_env.BODIES.values():
        print(f"  {body.name:30}{body.description}")
    print("\nIntegrators")
    for record in fish_env.INTEGRATORS.values():
        print(f"  {record.name:30}{record.kind}, order {record.order} ({record.source})")
    print(f"\nShipped policies: {', '.join(shipped_policies())}\nCommands: python -m fish_env --help")


def task_summary(spec) -> str:
    """Summary of the task of an environment: the first sentence of its docstring."""
    if "Stub" in spec.id:
        return "The spaces of Swim-v0 without physics, for unit tests."
    text = " ".join((inspect.getdoc(fish_env.TASKS[spec.kwargs["task"]]) or "").split("\n\n")[0].split())
    return text.split(". ")[0].removesuffix(".") + "."


def load_policies(arguments: argparse.Namespace) -> dict[str, Policy]:
    """Load the policies that the command line names, by name or file; ValueError if there are none."""
    given = arguments.policies if isinstance(arguments.policies, list) else [arguments.policies]
    named = [name for name in given if name is not None]
    found = {name: load_policy(name if name.endswith(".npz") else shipped_policy(name)) for name in named}
    if arguments.policy is not None:
        found[str(arguments.policy)] = load_policy(arguments.policy)
    if not found:
        raise ValueError(f"there is no policy; give one of {', '.join(shipped_policies())}, or a policy file")
    return found


def run_policy_command(arguments: argparse.Namespace) -> None:
    """Run `play` or `evaluate`.

    Raises:
        ValueError: for no policy or one that cannot be read, for `play` with several, and for options, episodes, seeds
            or files that are not allowed.
    """
    changes = {name: getattr(arguments, name) for name in ("body", "integrator", "dt")}
    if arguments.command == "evaluate":
        evaluate_policies(arguments, changes)
        return
    policies = load_policies(arguments)
    if len(policies) > 1:
        raise ValueError(f"{' and '.join(policies)} cannot be played at once; give one policy")
    (policy,) = policies.values()
    play(policy, arguments.seed, arguments.episodes, arguments.to, **changes)


def evaluate_policies(arguments: argparse.Namespace, changes: dict[str, str | float | None]) -> None:
    """Print the means over the episodes, a column for each policy, and write them to a file on request."""
    checked_episodes(arguments.episodes, arguments.seed)
    if arguments.to is not None:
        writable_file(arguments.to, (".json",))
    records = []
    for name, policy in load_policies(arguments).items():
        env = make_policy_env(policy, arguments.episodes, **changes)
        found = means(evaluate(env, policy, arguments.seed))
        env.close()
        about = {"env_id": policy.about["env_id"], "policy": name}
        records.append(
            about | {"episodes": arguments.episodes, "first_seed": arguments.seed, **changes, "means": found}
        )
    for env_id in dict.fromkeys(record["env_id"] for record in records):
        print_means(env_id, [record for record in records if record["env_id"] == env_id])
    if arguments.to is not None:
        write_text(arguments.to, json.dumps(records[0] if len(records) == 1 else records, indent=2) + "\n")


def print_means(env_id: str, records: list[dict]) -> None:
    """Print the metrics of one environment, a row each, and a column for each policy.

    Args:
        env_id: of the environment.
        records: of the policies, each with `policy` (its name), `means`, `episodes` and `first_seed`.
    """
    print(f"{env_id}: mean over {records[0]['episodes']} episodes, seeds from {records[0]['first_seed']}")
    names = [record["policy"] for record in records]
    names = [Path(name).parent.name if Path(name).name == "policy.npz" else name for name in names]
    widths = [max(12, len(name) + 2) for name in names]
    if len(records) > 1:
        print(" " * 22 + "".join(name.rjust(width) for name, width in zip(names, widths, strict=True)))
    for metric in dict.fromkeys(metric for record in records for metric in record["means"]):
        values = [record["means"].get(metric) for record in records]
        cells = ["-" if value is None else f"{value:.4g}" for value in values]
        print(f"  {metric:20}" + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))


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
    elif arguments.command == "replay":
        return replay_file(arguments.recording, arguments.save)
    else:
        run_policy_command(arguments)
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Run a command; errors that a user can correct are printed without a traceback."""
    return run_command("fish_env", lambda: run(parse(arguments)))


if __name__ == "__main__":
    sys.exit(main())
