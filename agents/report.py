"""The report of a run: a table with the baselines, a learning curve, the paths of a few fish, a video."""

import csv
import json
from pathlib import Path

import numpy as np

from agents.build import export_policy, make_env, make_model
from agents.config import CONFIGS, RESULTS, TrainConfig
from agents.records import pyplot
from fish_env.control import (
    EPISODES,
    FIRST_SEED,
    Controller,
    Policy,
    best_gait,
    evaluate,
    evaluation_options,
    gait_controller,
    load_policy,
    make_eval_env,
    make_policy_env,
    means,
    policy_controller,
    random_actions,
    run_episodes,
    scripted,
    shipped_policies,
    write_video,
)
from fish_env.control.files import replacing, write_text
from fish_env.envs import FishVectorEnv


def baselines(env: FishVectorEnv) -> dict[str, Controller]:
    """The controllers without learning."""
    return {
        "random": random_actions(env),
        "best open-loop gait": gait_controller(best_gait(), env),
        "motor controllers": scripted(env),
    }


def measured(env: FishVectorEnv, policies: dict[str, Policy], beside: bool) -> dict[str, dict]:
    """Means over the evaluation episodes of policies, after those of the baselines."""
    controllers = (baselines(env) if beside else {}) | {n: policy_controller(p, env) for n, p in policies.items()}
    return {name: means(evaluate(controller, env)) for name, controller in controllers.items()}


def report(folder: Path, task: str, config: TrainConfig, seed: int, pictures: bool = True) -> None:
    """Evaluate on fixed seeds; write results.json and the pictures, print the table and the command to play it."""
    policy = load_policy(folder / "policy.npz", config.env_id)
    policies = ({"untrained policy": untrained(config, seed)} if pictures else {}) | {"trained policy": policy}
    rows = measured(make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options)), policies, pictures)
    results = {"episodes": EPISODES, "first_seed": FIRST_SEED, "rows": rows}
    write_text(folder / "results.json", json.dumps(results, indent=2) + "\n")
    if not pictures:
        return
    metric = RESULTS[task].score
    draw_curve(folder / "curve.csv", folder / "curve.png", metric, rows)
    draw_path(config, policy, "best open-loop gait" if task == "swim" else "motor controllers", folder / "path.png")
    record_video(config, policy, folder / f"{task}.mp4")
    print_table(task, rows)
    print(f"\nSaved in {folder}: model.zip, policy.npz, config.json, results.json, curve.png, path.png, {task}.mp4")
    print(f"Watch it: python train.py play {folder / 'policy.npz'}")


def untrained(config: TrainConfig, seed: int):
    """The policy before any training."""
    env = make_env(config, 1, seed)
    return export_policy(make_model(config, env, seed), {"env_id": config.env_id, "env_options": config.env_options})


def print_table(task: str, rows: dict[str, dict]) -> None:
    """The means of every controller over the fixed evaluation episodes."""
    columns = (*RESULTS[task].metrics, "return", "failed")
    print(f"\n{task}: mean over {EPISODES} episodes (metrics and their units: docs/envs/)")
    widths = [max(12, len(name) + 2) for name in columns]
    print(" " * 20 + "".join(name.rjust(width) for name, width in zip(columns, widths, strict=True)))
    for name, row in rows.items():
        cells = ["-" if row.get(column) is None else f"{row[column]:.3f}" for column in columns]
        print(name.ljust(20) + "".join(cell.rjust(width) for cell, width in zip(cells, widths, strict=True)))
    if task == "swim" and "best open-loop gait" in rows:
        gait, policy = rows["best open-loop gait"], rows["trained policy"]
        along, own = (policy["speed"] / speed for speed in (gait["speed"], own_speed(gait)))
        print(f"The policy swims at {along:.2f} times the gait's speed along the heading; at {own:.2f} times the "
              "speed that the gait, which cannot steer, has along its own line.")  # fmt: skip


def own_speed(row: dict) -> float:
    """Distance between start and end over time, in any direction, body lengths per second; from means, so about."""
    return float(np.hypot(row["speed"], row["sideways"]))


def draw_curve(data: Path, picture: Path, metric: str, rows: dict[str, dict]) -> None:
    """The score against training time, with the baselines as lines."""
    plt = pyplot()
    with data.open() as file:
        points = [(float(r["timesteps"]), float(r["score"])) for r in csv.DictReader(file)]
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    if points:
        axes.plot(*np.array(points).T, color="#0b7a99", label="policy, while training")
    for name, colour in (("best open-loop gait", "#c0562f"), ("motor controllers", "#7a7a2f")):
        axes.axhline(rows[name][metric], color=colour, linestyle="--", label=name)
    axes.set(xlabel="environment steps", ylabel=metric, ylim=(0, None))
    axes.legend(frameon=False)
    with replacing(picture) as partial:
        figure.savefig(partial, dpi=110)
    plt.close(figure)


def draw_path(config: TrainConfig, policy: Policy, beside: str, picture: Path, fish: int = 6) -> None:
    """Paths of a few fish, by the policy and by a baseline, seen from above, each starting to the right."""
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    for colour, name in (("#c0562f", beside), ("#0b7a99", "trained policy")):
        env = make_eval_env(config.env_id, fish, evaluation_options(config.env_options) | {"info_every_step": True})
        controller = policy_controller(policy, env) if name == "trained policy" else baselines(env)[beside]
        for i, track in enumerate(tracks_of(controller, env)):
            axes.plot(*track.T, color=colour, lw=1.2, label=name if i == 0 else None)
    axes.set(xlabel="along the first command, body lengths", ylabel="across, body lengths", aspect="equal")
    axes.legend(frameon=False)
    with replacing(picture) as partial:
        figure.savefig(partial, dpi=110)
    plt.close(figure)


def tracks_of(controller: Controller, env: FishVectorEnv) -> list[np.ndarray]:
    """Centre of mass of each fish over one episode, (T,2) body lengths, its first command along +x."""
    for _, done, infos in run_episodes(controller, env):
        if not infos:  # just reset
            heading = env.task.vectors(env.tank, env._pose)[:, 0, :2].copy()
            heading /= np.linalg.norm(heading, axis=1, keepdims=True)
            tracks = [[np.zeros(3)] for _ in heading]
            continue
        for i in np.flatnonzero(~done):
            tracks[i].append(infos["position"][i])
    across = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
    return [
        np.array(track)[:, :2] @ np.stack(axes, axis=1) for track, *axes in zip(tracks, heading, across, strict=True)
    ]


def record_video(config: TrainConfig, policy: Policy, path: Path, seconds: float = 6.0) -> None:
    """One episode as an .mp4 at half speed (a tail beats faster than the eye follows)."""
    env = make_eval_env(config.env_id, 1, evaluation_options(config.env_options) | {"render_mode": "rgb_array"})
    frames = []
    for _, done, _ in run_episodes(policy_controller(policy, env), env):
        if done.any() or env.tank.time[0] > seconds:
            break
        pictures = env.render()
        assert pictures is not None  # as they are with this render_mode
        frames.append(pictures[0])
    write_video(frames, env.metadata["render_fps"] / 2, path)
    env.close()


def opened(path: Path, episodes: int = EPISODES, **changes) -> tuple[str, Policy, FishVectorEnv]:
    """A policy file: its task, the policy, and an environment to evaluate it in; `changes` are options of that."""
    policy = load_policy(path)
    task = policy.about.get("task")
    if not isinstance(task, str) or task not in CONFIGS or policy.about["env_id"] != CONFIGS[task].env_id:
        what = f"task {task!r} in {policy.about['env_id']!r}"
        raise ValueError(f"{path} is for {what}; choose a policy for one of {', '.join(CONFIGS)}")
    return task, policy, make_policy_env(policy, episodes, **changes)


def measure(paths: list[Path], **options) -> dict[Path, dict]:
    """Evaluate policy files on the fixed seeds; options of the environment may differ from those of the training."""
    rows = {}
    for path in paths:
        task, policy, env = opened(path, **options)
        rows[path] = means(evaluate(policy_controller(policy, env), env))
        print_table(task, {task: rows[path]})
    return rows


def compare(paths: list[Path]) -> dict[Path, dict]:
    """Evaluate policy files (or those that are shipped) on the fixed seeds, with the controllers without learning."""
    found = {}
    for path in paths or shipped_policies().values():
        task, policy, env = opened(path)
        found[path] = measured(env, {"trained policy": policy}, beside=True)
        print_table(task, found[path])
    return found
