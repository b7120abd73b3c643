"""What a run learnt: a table beside the baselines, a learning curve, the swum path, a video."""

import csv
import json
from pathlib import Path

import numpy as np

from agents.build import export_policy, make_env, make_model
from agents.config import TrainConfig
from agents.controllers import best_gait
from agents.evaluate import FIRST_SEED, Controller, Scores, evaluate, gait_controller, make_eval_env, policy_controller
from agents.play import write_video
from agents.policy import load_policy
from fish_env.envs import FishVectorEnv

EPISODES = 100


def report(folder: Path, task: str, config: TrainConfig, seed: int) -> None:
    """Evaluate on fixed seeds, write results.json and the pictures, print the table and the command to play it."""
    env = make_eval_env(config.env_id, EPISODES, config.env_options)
    policy = load_policy(folder / "policy.npz", config.env_id)
    controllers: dict[str, Controller] = {
        "untrained policy": policy_controller(untrained(config, seed)),
        "best open-loop gait": gait_controller(best_gait(), env),
        "trained policy": policy_controller(policy),
    }
    scores = {name: evaluate(controller, env) for name, controller in controllers.items()}
    rows = [table_row(name, s) for name, s in scores.items()]
    ratios = speed_ratios(rows)
    results = {"episodes": EPISODES, "first_seed": FIRST_SEED, "ratios": ratios, "rows": rows}
    (folder / "results.json").write_text(json.dumps(results, indent=2) + "\n")
    draw_curve(folder / "curve.csv", folder / "curve.png", rows[1]["own_speed"])
    draw_path(config, {name: controllers[name] for name in list(controllers)[1:]}, folder / "path.png")
    record_video(config, controllers["trained policy"], folder / "swim.mp4")
    print_table(rows, ratios)
    print(f"\nKept in {folder}: model.zip, policy.npz, config.json, results.json, curve.png, path.png, swim.mp4")
    print(f"See it swim: python train.py play {folder / 'policy.npz'}")


def untrained(config: TrainConfig, seed: int):
    """The policy as it was before any training."""
    env = make_env(config, 1, seed)
    return export_policy(make_model(config, env, seed), {"env_id": config.env_id})


def table_row(name: str, scores: Scores) -> dict:
    """The scores of one controller as a row of the table."""
    return {
        "controller": name,
        "speed": round(float(scores.speed.mean()), 4),
        "lowest": round(float(scores.speed.min()), 4),
        "own_speed": round(float(scores.own_speed.mean()), 4),
        "return": round(float(scores.total.mean()), 4),
        "failures": scores.failures,
    }


def speed_ratios(rows) -> list[float]:
    """Speed of the last row over that of the one before: along the heading, and along the other one's own line."""
    return [rows[-1]["speed"] / rows[-2][speed] for speed in ("speed", "own_speed")]


def print_table(rows, ratios=None) -> None:
    """Speeds in body lengths per second, over the fixed evaluation episodes."""
    print(f"\nMean over {EPISODES} episodes, speeds in body lengths per second:")
    print(f"{'':22}{'along heading':>14}{'slowest':>9}{'own line':>10}{'return':>8}{'failures':>10}")
    for row in rows:
        print(f"{row['controller']:22}{row['speed']:14.3f}{row['lowest']:9.3f}{row['own_speed']:10.3f}"
              f"{row['return']:8.2f}{row['failures']:10d}")  # fmt: skip
    if ratios is not None:
        print("The policy swims at {:.2f} times the gait's speed along the heading; at {:.2f} times what the gait, "
              "which cannot steer, makes along its own line.".format(*ratios))  # fmt: skip


def draw_curve(data: Path, picture: Path, gait_speed: float) -> None:
    """Speed against training time, with the gait's speed as a line."""
    plt = _pyplot()
    with data.open() as file:
        rows = [(float(r["timesteps"]), float(r["speed"])) for r in csv.DictReader(file)]
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    if rows:
        axes.plot(*np.array(rows).T, color="#0b7a99", label="policy, while training")
    axes.axhline(gait_speed, color="#c0562f", linestyle="--", label="best open-loop gait, along its own line")
    axes.set(xlabel="decisions", ylabel="speed along the heading, lengths/s", ylim=(0, None))
    axes.legend(frameon=False)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def draw_path(config: TrainConfig, controllers: dict[str, Controller], picture: Path, fish: int = 6) -> None:
    """Paths of a few fish seen from above, turned so that each commanded heading points to the right."""
    plt = _pyplot()
    env = make_eval_env(config.env_id, fish, config.env_options | {"info_every_step": True})
    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    for colour, (name, controller) in zip(("#c0562f", "#0b7a99"), controllers.items(), strict=True):
        tracks = swum_tracks(controller, env)
        for i, track in enumerate(tracks):
            axes.plot(*track.T, color=colour, lw=1.2, label=name if i == 0 else None)
    axes.set(xlabel="along the commanded heading, body lengths", ylabel="across, body lengths", aspect="equal")
    axes.legend(frameon=False)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def swum_tracks(controller: Controller, env: FishVectorEnv) -> np.ndarray:
    """Centre of mass of each fish over one episode, (B,T,2) body lengths, commanded heading along +x."""
    obs, _ = env.reset(seed=FIRST_SEED)
    heading = env.task.vectors(env.tank, env._pose)[:, 0, :2].copy()
    track, time = [np.zeros((env.num_envs, 3))], 0.0
    while True:
        action = np.broadcast_to(controller(obs, time), env.action_space.shape)
        obs, _, terminated, truncated, infos = env.step(action)
        time += env.control_interval
        if (terminated | truncated).any():
            break
        track.append(infos["position"])
    flat = np.array(track).transpose(1, 0, 2)[..., :2]
    across = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
    return np.stack([np.einsum("btk,bk->bt", flat, d) for d in (heading, across)], axis=-1)


def record_video(config: TrainConfig, controller: Controller, path: Path, seconds: float = 6.0) -> None:
    """One episode as an .mp4 at half speed (a tail beats faster than the eye follows)."""
    env = make_eval_env(config.env_id, 1, config.env_options | {"render_mode": "rgb_array"})
    obs, _ = env.reset(seed=FIRST_SEED)
    frames, time = [env.render()[0]], 0.0
    while time < seconds:
        obs, _, terminated, truncated, _ = env.step(np.broadcast_to(controller(obs, time), env.action_space.shape))
        time += env.control_interval
        if (terminated | truncated).any():
            break
        frames.append(env.render()[0])
    write_video(frames, env.metadata["render_fps"] / 2, path)
    env.close()


def _pyplot():
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def evaluate_file(path: Path, **options) -> None:
    """Measure a policy file on the fixed seeds beside the open-loop gait; options of the environment may differ."""
    policy = load_policy(path)
    changes = {name: value for name, value in options.items() if value is not None}
    env = make_eval_env(policy.about["env_id"], EPISODES, dict(policy.about["env_options"]) | changes)
    controllers = {"best open-loop gait": gait_controller(best_gait(), env), "policy": policy_controller(policy)}
    rows = [table_row(name, evaluate(controller, env)) for name, controller in controllers.items()]
    print_table(rows, speed_ratios(rows))
