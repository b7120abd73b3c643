"""Run a policy that comes with fish_env: in a window, or into a video where there is no display.

    python play.py left_after_right
    python play.py avoid --video avoid.mp4 --seed 3

It needs fish_env with the extra [render]. `fish_env play` does the same; this is what it takes in a program of
your own. A policy is a function of the observation and needs numpy alone.
"""

import argparse

import gymnasium as gym

import fish_env  # noqa: F401 - registers the environments
from fish_env.control import load_policy, shipped_policies, shipped_policy, write_video


def main() -> None:
    """Play some episodes, and print what each achieved."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", help=f"a policy.npz, or one of {', '.join(shipped_policies())}")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode (default 0)")
    parser.add_argument("--episodes", type=int, default=2, help="default 2")
    parser.add_argument("--steps", type=int, help="end every episode after so many environment steps")
    parser.add_argument("--video", help="an .mp4, .webp or .gif to write instead of opening a window")
    args = parser.parse_args()

    policy = load_policy(shipped_policy(args.policy) if args.policy in shipped_policies() else args.policy)
    options = dict(policy.about["env_options"])  # the task and the control interval that it was trained with
    if args.steps:
        options["max_episode_steps"] = args.steps
    env = gym.make(policy.about["env_id"], render_mode="rgb_array" if args.video else "human", **options)
    frames = []
    for episode in range(args.episodes):
        obs, _ = env.reset(seed=args.seed + episode)
        over = False
        while not over:
            obs, _, terminated, truncated, _ = env.step(policy(obs))
            over = terminated or truncated
            if args.video:
                frames.append(env.render())
        found = env.get_wrapper_attr("episode_info")()  # at any time; the last step of an episode has it in `info`
        numbers = {name: round(value, 2) for name, value in found.items() if isinstance(value, int | float)}
        print(f"episode {episode}: {numbers}")
    if args.video:
        write_video(frames, env.metadata["render_fps"], args.video)
        print(f"written: {args.video}, in real time")
    env.close()


if __name__ == "__main__":
    main()
