"""Train a fish, measure what it learnt, watch it.

python train.py swim                                 train, then show what was learnt
python train.py swim --resume runs/swim/<time>       go on with a run that was stopped
python train.py evaluate runs/swim/<time>/policy.npz measure a policy on the fixed evaluation seeds
python train.py play runs/swim/<time>/policy.npz     watch it in a window (or --video file.mp4)
"""

import argparse
import os
import sys
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def parse() -> argparse.Namespace:
    """The command line."""
    from agents.config import CONFIGS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    for task, config in CONFIGS.items():
        command = commands.add_parser(task, help=f"train {config.env_id}")
        command.add_argument("--seed", type=int, default=0, help="of the learner (default 0)")
        command.add_argument("--timesteps", type=int, help=f"decisions to train for (default {config.timesteps:,})")
        command.add_argument("--num-envs", type=int, help=f"fish trained side by side (default {config.num_envs})")
        command.add_argument("--resume", type=Path, help="folder of a run to go on with")
        command.add_argument("--runs", type=Path, default=Path("runs"), help="where runs are kept (default runs)")
        command.add_argument("--torch-threads", type=int, default=1, help="more is often slower (default 1)")
    command = commands.add_parser("evaluate", help="measure a policy on fixed seeds")
    command.add_argument("policy", type=Path)
    command.add_argument("--integrator", help="measure under another integrator than the one it was trained with")
    command.add_argument("--dt", type=float, help="and with another step, s")
    command = commands.add_parser("play", help="watch a policy")
    command.add_argument("policy", type=Path)
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--episodes", type=int, default=3)
    command.add_argument("--video", type=Path, help="write a video instead of opening a window")
    return parser.parse_args()


def main() -> int:
    """Run a command; errors a user can mend are printed without a traceback."""
    for name in THREADS:  # before numpy and torch are loaded
        os.environ.setdefault(name, "1")
    arguments = parse()
    try:
        if arguments.command == "evaluate":
            from agents.report import evaluate_file

            evaluate_file(arguments.policy, integrator=arguments.integrator, dt=arguments.dt)
        elif arguments.command == "play":
            from agents.play import play

            play(arguments.policy, arguments.seed, arguments.episodes, arguments.video)
        else:
            import torch

            torch.set_num_threads(arguments.torch_threads)
            from agents.train import train

            train(arguments.command, arguments.seed, arguments.runs, arguments.resume,
                  timesteps=arguments.timesteps, num_envs=arguments.num_envs)  # fmt: skip
    except (ValueError, FileNotFoundError) as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
