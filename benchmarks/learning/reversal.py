"""One left turn begun before a right turn is over, drawn: path, heading with its command, and strain.

And how often the shipped policy succeeds at twice the severity.
"""

from functools import cache

import numpy as np

from benchmarks.common.charts import BLUE, ORANGE, WIDTH, legend_below, pyplot, save
from benchmarks.common.statistics import rounded
from benchmarks.common.tables import IMAGES, publish
from fish_env.bodies.mass_spring import LAYERS
from fish_env.control import evaluate, evaluation_options, load_policy, make_eval_env, policy_controller, scripted
from fish_env.control.policy import PRETRAINED
from fish_env.control.statistics import interval
from fish_env.envs import FishVectorEnv
from fish_env.training.config import CONFIGS

COMMAND = {"yaw": 0.0, "side": -1, "first": 1.3, "second": 1.3, "part": 0.6, "wait": 1.0}
SEED = 0
DRAWN = 2.8  # s of the path
EPISODES, SEVERITY = 10_000, 2.0
COLOURS = {"motor controllers": ORANGE, "PPO": BLUE}


def swum(controller, env: FishVectorEnv) -> dict[str, np.ndarray]:
    """An episode with the fixed command, a row a step: place, BL, heading and command, degrees, strain, midline."""
    obs, _ = env.reset(seed=SEED, options=COMMAND)
    tank, task, length = env.tank, env.task, env.tank.fish.length
    springs, line = tank.fish.body.springs, tank.fish.line
    rows: dict[str, list] = {name: [] for name in ("time", "place", "heading", "command", "strain", "midline")}
    for _ in range(env.max_episode_steps - 1):
        action = np.broadcast_to(controller(obs, tank.time[0]), env.action_space.shape)
        obs, *_ = env.step(action)
        x = tank.position[0]
        forward = line @ x
        ends = x[springs.nodes]
        stretch = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / springs.rest_length - 1.0
        rows["time"].append(tank.time[0])
        rows["place"].append(env._pose.centre[0, :2] / length)
        rows["heading"].append(np.degrees(np.arctan2(forward[1], forward[0])))
        rows["command"].append(np.degrees(task.course.heading[0]))
        rows["strain"].append(np.abs(stretch).max())
        rows["midline"].append([x[list(nodes), :2].mean(axis=0) / length for nodes in LAYERS])
    return {name: np.array(values) for name, values in rows.items()}


def draw() -> None:
    """Path with the body every tenth of a second, heading against time with the command, strain against time."""
    figure, places = pyplot().subplot_mosaic("AA;HS", figsize=(WIDTH, 6.4), height_ratios=(1.1, 1))
    above, heading, strain = (places[name] for name in "AHS")
    for k, (name, run) in enumerate(runs().items()):
        colour, apart = COLOURS[name], np.array([[0.0, -k]])
        shown = run["time"] < DRAWN
        above.plot(*(run["place"][shown] + apart).T, color=colour, lw=1.5, label=name)
        for body in run["midline"][shown][:: round(0.1 / run["time"][0])]:
            above.plot(*(body + apart).T, color=colour, lw=1.0, alpha=0.6)
        heading.plot(run["time"], np.degrees(np.unwrap(np.radians(run["heading"]))), color=colour, lw=1.5, label=name)
        heading.plot(run["time"], run["command"], color=colour, lw=1, ls="--")
        strain.plot(run["time"], 100 * run["strain"], color=colour, lw=1)
    above.set(aspect="equal", xlabel="body lengths", title=f"path in {DRAWN} s; midlines every 0.1 s", yticks=[])
    heading.set(xlabel="time, s", ylabel="heading, degrees", title="heading; dashed: the command")
    strain.set(xlabel="time, s", ylabel="largest strain, %", title="largest strain of any spring")
    legend_below(figure, 2)
    save(figure, IMAGES / "reversal.svg")


@cache
def runs() -> dict[str, dict]:
    """An episode of the motor controllers, and one of the shipped policy."""
    config = CONFIGS["left_after_right"]
    env = make_eval_env(config.env_id, 1, evaluation_options(config.env_options))
    policy = policy_controller(load_policy(PRETRAINED / "left_after_right" / "policy.npz"), env)
    return {"motor controllers": swum(scripted(env), env), "PPO": swum(policy, env)}


def measure() -> list[dict]:
    """A row for each controller and control interval."""
    return [
        {"controller": name, "time": round(run["time"][k], 4), "x": round(run["place"][k, 0], 4),
         "y": round(run["place"][k, 1], 4), "heading": round(run["heading"][k], 2),
         "command": round(run["command"][k], 2), "strain": round(run["strain"][k], 4)}
        for name, run in runs().items() for k in range(len(run["time"]))
    ]  # fmt: skip


def measure_severe() -> list[dict]:
    """Success and failures of the shipped policy in many episodes at twice the severity."""
    config = CONFIGS["left_after_right"]
    env = make_eval_env(config.env_id, EPISODES, evaluation_options(config.env_options) | {"severity": SEVERITY})
    scores = evaluate(env, load_policy("left_after_right"))
    env.close()
    found = {name: interval([scores], name, np.random.default_rng(0)) for name in ("success", "failed")}
    return [{"metric": name, "episodes": EPISODES} | dict(zip(each._fields, map(rounded, each), strict=True))
            for name, each in found.items()]  # fmt: skip


if __name__ == "__main__":
    publish(__doc__, {"reversal.csv": measure, "learning/severe.csv": measure_severe}, draw)
