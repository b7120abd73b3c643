"""The command line of the package, `fish_env` or `python -m fish_env`: train policies, watch and measure them.

fish_env list                         list environments, bodies, integrators and the policies that are shipped
fish_env train swim --seeds 0 1       train policies (extra [train]); also of an environment of yours, my_module:My-v0
fish_env play turn                    watch a policy in a window (or --save FILE.html, .mp4, .webp or .gif)
fish_env evaluate turn runs/swim/...  evaluate policies on fixed seeds (--env-kwargs angle=3.0: in another task)
fish_env compare swim runs/swim/...   compare two policies with intervals, or one with the controllers without learning
fish_env report runs/swim/...         write one HTML page of a run, or of several beside each other
fish_env replay FILE.npz              simulate a recorded episode again and compare bit for bit
fish_env chart --body planar          measure which integrator and step to take; also for module:function of yours
fish_env benchmark mine:learn         compare a learner of yours with others by a fixed protocol (or ppo, or its .json)
fish_env lab                          open the laboratory in the browser: look at soft bodies, pull and change them
fish_env compile swim                 compile its kernels ahead of their first use, for an image or a shared folder
fish_env versions                     name the versions of what it runs with

A policy is named by the task of one that is shipped, by its file, or by the folder of its run.
"""

import argparse
import inspect
import json
import math
import os
import platform
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import gymnasium as gym

import fish_env
from fish_env.bodies.fitted import WATERS
from fish_env.checks import check_names, similar
from fish_env.control.chart import chart
from fish_env.control.console import INSTALL, Parser, import_from_here, interrupt_once, run_command
from fish_env.control.evaluation import EPISODES, FIRST_SEED, checked_episodes
from fish_env.control.files import writable_file, write_text
from fish_env.control.film import write_film
from fish_env.control.playback import play
from fish_env.control.policy import Policy, load_policy, shipped_policies
from fish_env.control.printing import print_comparison, print_means
from fish_env.control.protocols import BUDGETS, LEVELS, SEEDS, TASKS
from fish_env.control.recording import load_recording
from fish_env.control.replaying import replay
from fish_env.control.statistics import compare, same_environments
from fish_env.envs.ahead import compile_ahead, stored_kernels
from fish_env.envs.options import fish_for
from fish_env.physics.world import checked_water
from fish_env.training.config import CONFIGS, FINE_TUNING, Request, TrainConfig, as_tuples, check_options, settings_for
from fish_env.training.report import measure_policy

PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch", "pygame-ce", "moviepy")
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
PAIRS: dict[str, Any] = {"nargs": "+", "default": [], "metavar": "NAME=VALUE"}
FILES = "an .html page that turns in 3-D, an .mp4, .webp or .gif video, or an .npz recording"


def make_parser(program: str = "fish_env") -> tuple[argparse.ArgumentParser, Any]:
    """The parser of the command line, and its commands (what `add_subparsers` returns), to which others can be added.

    A command sets `run`, a function of the parsed arguments that returns the exit status, or None for 0.
    """
    parser = Parser(prog=program, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.set_defaults(run=list_all, task_module=None)
    commands = parser.add_subparsers(dest="command")
    module, simulation, policies = (Parser(add_help=False) for _ in range(3))
    module.add_argument("--task-module", metavar="MODULE", help="a module that registers environments, imported first")
    simulation.add_argument("--body", help=f"on another body: {', '.join(fish_env.BODIES)}")
    simulation.add_argument("--integrator", help="with another integrator than the body's own, or that of the training")
    simulation.add_argument("--dt", type=float, help="and with another step, s")
    text = "keywords of the environment: speed=1.0 'variation={\"mass\": [0.8, 1.2]}' (JSON, or text)"
    simulation.add_argument("--env-kwargs", **PAIRS, help=text)
    known = f"a shipped policy ({', '.join(shipped_policies())}), a policy file, or the folder of a run"
    policies.add_argument("policies", nargs="*", metavar="policy", help=known)
    policies.add_argument("--policy", type=Path, help="a policy file, whatever its name")

    def add(name: str, run: Callable, text: str, *parents: Parser) -> Parser:
        command = commands.add_parser(name, help=text, parents=parents)
        command.set_defaults(run=run)
        return command

    add("list", list_all, "list environments, bodies, integrators and shipped policies")
    add_training_options(add("train", run_training, "train a policy by PPO, then report", module, simulation))
    play_it = add("play", play_policy, "watch a trained policy", policies, simulation, module)
    play_it.add_argument("--save", "--to", "--video", type=Path, dest="to", help=f"write a file: {FILES}")
    score = add("evaluate", evaluate_policies, "evaluate policies on fixed seeds", policies, simulation, module)
    score.add_argument("--save", "--to", type=Path, dest="to", help="write the means to a .json file too")
    text = "evaluate two policies in the same episodes, or any beside the controllers without learning"
    beside = add("compare", compare_policies, text, policies, simulation, module)
    for command, seed, count in ((play_it, 0, 1), *((each, FIRST_SEED, EPISODES) for each in (score, beside))):
        command.add_argument("--seed", type=int, default=seed, help=f"of the first episode (default {seed})")
        command.add_argument("--episodes", type=int, default=count, help=f"how many (default {count})")
    command = add("report", run_report, "write an HTML page of one run or more", module)
    command.add_argument("folders", type=Path, nargs="+", help="of runs; seeds are put together")
    command.add_argument("--save", type=Path, help="the page (default report.html in the folder of all)")
    command.add_argument("--episodes", type=int, default=EPISODES, help=f"of each policy (default {EPISODES})")
    command = add("replay", replay_file, "simulate a recorded episode again, compare bit for bit", module)
    command.add_argument("recording", type=Path, help="a file of fish_env.control.record")
    command.add_argument("--save", type=Path, help="show it too: a page or a video")
    add_chart_options(add("chart", chart_methods, "measure which integrator and step a fish should take"))
    add_benchmark_options(add("benchmark", run_benchmark, "compare a learner with others by a fixed protocol"))
    command = add("lab", open_laboratory, "open the laboratory, for this machine only", module)
    command.add_argument("--task", metavar="ID", help="an environment of your own, registered by --task-module")
    command.add_argument("--policy", help="a policy of your own, a file or the folder of a run")
    command.add_argument("--host", default="127.0.0.1", help="address to listen at (default 127.0.0.1, which only "
                         "this machine can open; at 0.0.0.0, all that reach it can, without a password)")  # fmt: skip
    command.add_argument("--port", type=int, default=8080, help="TCP port (default 8080, or the next free one)")
    command = add("compile", compile_kernels, "compile kernels ahead of use, into FISH_ENV_CACHE")
    command.add_argument("task", nargs="*", metavar="task", help=f"which (default all): {', '.join(fish_env.TASKS)}")
    command.add_argument("--body", nargs="+", default=["mass_spring"], help="on which bodies (default mass_spring)")
    command.add_argument("--dtype", nargs="+", default=["float64"], help="float64, float32 or both (default float64)")
    command.add_argument("--integrator", help="with this integrator instead of the body's own")
    add("versions", print_versions, "name the versions of Python and of the packages it runs with")
    return parser, commands


def add_training_options(command: argparse.ArgumentParser) -> None:
    """Add what `train` takes beside body, integrator, step and module."""
    command.add_argument("task", help=f"{', '.join(CONFIGS)}, the id of an environment, or module:Id")
    text = "settings of the training: learning_rate=3e-4 rollout=64 hidden=[32,32]"
    command.add_argument("--hyperparameters", **PAIRS, help=text)
    seeds = command.add_mutually_exclusive_group()
    seeds.add_argument("--seed", type=int, help="of the learner (default 0)")
    seeds.add_argument("--seeds", type=int, nargs="+", metavar="SEED", help="a run for each, one after the other")
    command.add_argument("--timesteps", type=int, help="environment steps to train for (default that of the task)")
    command.add_argument("--num-envs", type=int, help="fish trained side by side (default 256)")
    command.add_argument("--resume", type=Path, help="folder of a run to resume")
    command.add_argument("--start-from", type=Path, help="fine-tune the policy of this run, by default for "
                         f"{FINE_TUNING['timesteps']:,} steps of {FINE_TUNING['num_envs']} fish")  # fmt: skip
    command.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are saved (default runs)")
    command.add_argument("--folder", type=Path, help="save the run in this folder")
    command.add_argument("--no-pictures", action="store_true", help="only evaluate the policy at the end")
    command.add_argument("--torch-threads", type=int, default=1, help="threads of the updates (default 1)")


def add_chart_options(command: argparse.ArgumentParser) -> None:
    """Add what `chart` takes."""
    text = f"a fish (default mass_spring): {', '.join(fish_env.BODIES)}, or module:function, which returns one"
    command.add_argument("--body", default="mass_spring", help=text)
    command.add_argument("--water", choices=WATERS, help="its water (default the fish's own)")
    command.add_argument("--task", help="with the commands of the shipped policy of a task, instead of random ones")
    command.add_argument("--error", type=percent, default=1.0,
                         metavar="PERCENT", help="wanted mean error, of the body length (default 1%%)")  # fmt: skip
    command.add_argument("--save", type=Path, default=Path("chart.svg"),
                         help="the .svg chart, beside a .csv table (default chart.svg)")  # fmt: skip


def add_benchmark_options(command: argparse.ArgumentParser) -> None:
    """Add what `benchmark` takes."""
    text = "ppo, module:function, which takes a Trial and returns a policy, or the .json file of one, to be shown"
    command.add_argument("learner", help=text)
    for name, usual in {"tasks": TASKS, "levels": LEVELS, "steps": BUDGETS, "seeds": SEEDS}.items():
        kind = type(next(iter(usual)))
        command.add_argument(f"--{name}", type=kind, nargs="+", help=f"(default {' '.join(map(str, usual))})")
    text = "where trials are kept; those that it has are not repeated (default benchmark.json)"
    command.add_argument("--save", type=Path, help=text)


def percent(text: str) -> float:
    """The number of a text such as "1%" or "1"."""
    return float(text.removesuffix("%"))


def list_all(arguments: argparse.Namespace) -> None:
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
    print(f"\nShipped policies: {', '.join(shipped_policies())}\nCommands: fish_env --help")


def task_summary(spec) -> str:
    """Summary of the task of an environment: the first sentence of its docstring."""
    if "Stub" in spec.id:
        return "The spaces of Swim-v0 without physics, for unit tests."
    text = " ".join((inspect.getdoc(fish_env.TASKS[spec.kwargs["task"]]) or "").split("\n\n")[0].split())
    return text.split(". ")[0].removesuffix(".") + "."


def settings_from(option: str, words: Sequence[str]) -> dict[str, Any]:
    """The settings that words NAME=VALUE give; ValueError for any other word."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals or not name.isidentifier():
            raise ValueError(f"{option} has {word!r}; give NAME=VALUE, such as speed=1.0")
        try:
            found[name] = as_tuples(json.loads(text))
        except ValueError:
            found[name] = math.inf if text == "inf" else text
    return found


def fish_of(name: str, water: str | None) -> fish_env.Fish:
    """The fish of a name, or that a module:function returns; ValueError if there is none."""
    module, colon, function = name.rpartition(":")
    if not colon:
        return fish_for(name, water)
    make = getattr(import_from_here(module), function, None)
    if callable(make) and isinstance(fish := make(), fish_env.Fish):
        return fish
    raise ValueError(f"{name!r} is no function that returns a fish_env.Fish; give module:function of one")


def run_training(arguments: argparse.Namespace) -> None:
    """Train a run for each seed; a signal saves it, and no other begins."""
    changes = settings_from("--hyperparameters", arguments.hyperparameters)
    check_names("unknown setting", vars(TrainConfig("")), *changes)
    counts = {name: getattr(arguments, name) for name in ("timesteps", "num_envs")}
    changes |= {name: count for name, count in counts.items() if count is not None}
    module, colon, name = arguments.task.rpartition(":")
    if colon:
        import_from_here(module)
    module = module or arguments.task_module or ""
    task = next((short for short, config in CONFIGS.items() if config.env_id == name), name)
    if task not in {*CONFIGS, *gym.registry} and similar(task, CONFIGS):
        check_names("unknown task", CONFIGS, task)
    if arguments.seeds and (arguments.folder or arguments.resume):
        raise ValueError("--seeds begins several runs, and --folder and --resume are of one; give --runs, or --seed")
    if arguments.folder and arguments.resume:
        raise ValueError("a run is resumed in its own folder; give --resume alone, or --folder for a new run")
    request = Request(
        task=task,
        module=module,
        seed=arguments.seed,
        root=arguments.runs,
        folder=arguments.folder,
        resume=arguments.resume,
        start=arguments.start_from,
        env_options=simulation(arguments),
        changes=changes,
        pictures=not arguments.no_pictures,
        torch_threads=arguments.torch_threads,
        stopped=lambda: bool(arguments.signals),
    )
    requests = [replace(request, seed=seed) for seed in dict.fromkeys(arguments.seeds or [arguments.seed])]
    with interrupt_once(arguments.signals):
        from fish_env.training.train import train

        for each in requests if arguments.seeds else ():
            settings_for(each)  # a mistake in the last seed is found before the first run
        folders = [train(each) for each in requests]
    if arguments.seeds:
        imported = ["--task-module", module] if module else []
        print(f"Compare:  {shlex.join(['fish_env', 'report', *map(str, folders), *imported])}")


def find_policy(name: str) -> str | Path:
    """The policy file of a folder, and any other word as it is."""
    return Path(name, "policy.npz") if name not in shipped_policies() and os.path.isdir(name) else name


def load_policies(arguments: argparse.Namespace) -> dict[str, Policy]:
    """Load the policies that the command line names; ValueError if there are none."""
    found = {name: load_policy(find_policy(name)) for name in arguments.policies}
    if arguments.policy is not None:
        found[str(arguments.policy)] = load_policy(arguments.policy)
    if not found:
        raise ValueError(f"there is no policy; give one of {', '.join(shipped_policies())}, or a policy file")
    return found


def simulation(arguments: argparse.Namespace) -> dict[str, Any]:
    """Keywords of the environment that the command line gives; ValueError for those that a command sets itself."""
    keywords = settings_from("--env-kwargs", arguments.env_kwargs)
    check_options(keywords)
    options = {name: getattr(arguments, name) for name in ("body", "integrator", "dt")}
    return keywords | {name: value for name, value in options.items() if value is not None}


def play_policy(arguments: argparse.Namespace) -> None:
    """Play the policy; ValueError for several."""
    policies = load_policies(arguments)
    if len(policies) > 1:
        raise ValueError(f"{' and '.join(policies)} cannot be played at once; give one policy")
    (policy,) = policies.values()
    play(policy, arguments.seed, arguments.episodes, arguments.to, **simulation(arguments))


def evaluate_policies(arguments: argparse.Namespace) -> None:
    """Print the means over the episodes, a column for each policy, and write them to a file on request."""
    about = checked_episodes(arguments.episodes, arguments.seed)
    if arguments.to is not None:
        writable_file(arguments.to, (".json",))
    changes = simulation(arguments)
    simulated = {"body": None, "integrator": None, "dt": None, **changes}
    records = [simulated | measure_policy(*one, False, changes, *about)[0] for one in load_policies(arguments).items()]
    for env_id in dict.fromkeys(record["env_id"] for record in records):
        print_means([record for record in records if record["env_id"] == env_id])
    if arguments.to is not None:
        write_text(arguments.to, json.dumps(records[0] if len(records) == 1 else records, indent=2) + "\n")


def compare_policies(arguments: argparse.Namespace) -> None:
    """Print the difference of two policies with intervals, or means of others beside those of simple controllers."""
    changes, (episodes, seed) = simulation(arguments), checked_episodes(arguments.episodes, arguments.seed)
    if not arguments.policies and arguments.policy is None:
        arguments.policies = list(shipped_policies())
    policies = load_policies(arguments)
    if len(policies) == 2:
        first, second = policies.values()
        found = compare(first, second, seed=seed, episodes=episodes, **changes)
        about = f"{episodes} episodes, seeds from {seed}"
        print_comparison(same_environments([first, second], changes), list(policies), found, about)
    else:
        for name, policy in policies.items():
            print_means(measure_policy(name, policy, True, changes, episodes, seed))


def run_report(arguments: argparse.Namespace) -> None:
    """Write the page of runs, and print where."""
    from fish_env.training.report_page import write_report

    print(f"written to {write_report(arguments.folders, arguments.save, arguments.episodes)}")


def replay_file(arguments: argparse.Namespace) -> int:
    """Print the result of a replay, and write a film on request; return 1 for a replay that differs."""
    recording = load_recording(arguments.recording)
    found = replay(recording)
    print(found)
    if arguments.save is not None:
        print(f"written to {write_film(recording, arguments.save)}")
    return 0 if found.same else 1


def chart_methods(arguments: argparse.Namespace) -> None:
    """Measure methods and steps on a fish, and print which to take."""
    fish = fish_of(arguments.body, arguments.water)
    world = fish.water if arguments.water is None else checked_water(arguments.water, fish.water)
    print(chart(fish, world, arguments.save, arguments.error / 100, arguments.task))
    print(f"written to {arguments.save} and {arguments.save.with_suffix('.csv')}")


def run_benchmark(arguments: argparse.Namespace) -> None:
    """Run a learner's trials, or read them, and print their scores."""
    from fish_env.training.benchmark import benchmark, read_result, score_rows

    names = {"tasks": "tasks", "levels": "levels", "steps": "budgets", "seeds": "seeds"}
    given = {names[name]: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if arguments.learner.endswith(".json"):
        if given or arguments.save:
            raise ValueError(f"{arguments.learner} is shown as it is; leave out the other options, or name its learner")
        result = read_result(arguments.learner)
    else:
        save = writable_file(arguments.save or "benchmark.json", (".json",))
        result = benchmark(arguments.learner, save, **given)
        print(f"written to {save}")
    rows = score_rows(result)
    table = [list(rows[0]), *([str(value) for value in row.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for line in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def open_laboratory(arguments: argparse.Namespace) -> None:
    """Open the laboratory until it is interrupted."""
    from fish_env.lab import serve

    user = None
    if arguments.task or arguments.policy:
        from fish_env.lab.swimmers import UserScene

        policy = load_policy(find_policy(arguments.policy)) if arguments.policy else None
        user = partial(UserScene, arguments.task, policy)
        user().close()  # an environment that cannot be made is named here
    serve(arguments.host, arguments.port, user)


def compile_kernels(arguments: argparse.Namespace) -> None:
    """Compile the requested kernels, and print how many are stored where."""
    tasks = arguments.task or list(fish_env.TASKS)
    for name, new, total in compile_ahead(tasks, arguments.body, arguments.dtype, arguments.integrator):
        print(f"{name}: {new} new kernels, {total} in all", flush=True)
    folder, files = stored_kernels()
    print(f"{sum(path.stat().st_size for path in files) / 1e6:.0f} MB in {folder}")


def print_versions(arguments: argparse.Namespace) -> None:
    """Print the version of Python, of this package and of those that it uses."""
    print(f"{'python':20}{platform.python_version()}\n{'fish_env':20}{fish_env.__version__}")
    for package in PACKAGES:
        try:
            print(f"{package:20}{version(package)}")
        except PackageNotFoundError:
            print(f"{package:20}not installed")


def run(parser: argparse.ArgumentParser, words: Sequence[str] | None, signals: list[int]) -> int:
    """Run a command; the exit status. Signals that are to stop it are added to `signals`."""
    arguments = parser.parse_args(words, argparse.Namespace(signals=signals))
    if arguments.task_module is not None:
        import_from_here(arguments.task_module)
    return arguments.run(arguments) or 0


def main(
    words: Sequence[str] | None = None, parser: argparse.ArgumentParser | None = None, install: str = INSTALL
) -> int:
    """Run a command; errors that a user can correct are printed without a traceback.

    Args:
        words: of the command line; None for those of this program.
        parser: the parser; None for that of `make_parser`.
        install: the command that installs what is missing.

    Returns:
        The exit status: 128 and the number of the signal, if one has stopped a training.
    """
    for name in THREADS:  # before torch is loaded
        os.environ.setdefault(name, "1")
    parser, signals = parser or make_parser()[0], []
    status = run_command(parser.prog, lambda: run(parser, words, signals), install)
    return 128 + signals[0] if signals else status


if __name__ == "__main__":
    sys.exit(main())
