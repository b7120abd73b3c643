"""How the shipped policies move on the environments of their ids: beat, sway, strain, stress and power of the muscles.

Muscle is half of every section of the trunk, and half of the body's mass; a muscle of the model stands for a quarter of
a section's. Of turns and starts, the sway along the path is not given.
"""

import numpy as np

from fish_env.bodies.mass_spring import LAYERS
from fish_env.control import FIRST_SEED, Policy, load_policy, make_eval_env, policy_controller
from fish_env.envs import FishVectorEnv
from fish_env.training.config import CONFIGS

FISH, SECONDS, SETTLING = 32, 3.0, 1.9  # s that are measured, after s that are not
MUSCLE = 0.5  # part of a section, and of the body's mass
STRAIGHT = ("swim",)  # tasks in which the path is straight
QUANTILE = 0.99  # of strain rates
SWAY = 0.95  # part of the time that the sway is taken over, so that a single stroke does not count


def areas(fish) -> np.ndarray:
    """Cross-section (M,) m2 of what each muscle stands for."""
    corners = fish.points(fish.body.position)[np.array(LAYERS[1:6])]
    quarter = np.prod(np.ptp(corners[:, :, 1:], axis=1), axis=1) / 4.0
    return MUSCLE * 0.5 * (quarter[:-1] + quarter[1:])[fish.segments]


def swum(env: FishVectorEnv, policy, steps: int) -> dict[str, np.ndarray]:
    """What fish did in so many environment steps, an array (T,B,...) each."""
    tank = env.tank
    obs, _ = env.reset(seed=FIRST_SEED)
    control, found = policy_controller(policy, env), []
    for k in range(steps):
        obs, *_ = env.step(control(obs, k * env.control_interval))
        found.append([part.copy() for part in (tank.position, tank.velocity, tank.rest_length, tank.work, tank.alive)])
    return dict(zip(("x", "v", "rest", "work", "alive"), map(np.array, zip(*found, strict=True)), strict=True))


def muscles(fish, run: dict) -> dict[str, float]:
    """Strain, its rate, stress and power of the muscles of fish that lived to the end."""
    springs, fit = fish.body.springs, run["alive"][-1]
    ends, natural = springs.nodes[fish.muscles], springs.rest_length[fish.muscles]
    apart, gaining = (part[:, fit][:, :, ends[:, 1]] - part[:, fit][:, :, ends[:, 0]] for part in (run["x"], run["v"]))
    length = np.linalg.norm(apart, axis=-1)
    strain, rate = length / natural - 1.0, (apart * gaining).sum(axis=-1) / length / natural
    pull = springs.stiffness[fish.muscles] * (length - run["rest"][:, fit][:, :, fish.muscles]) / areas(fish)
    seconds = (len(length) - 1) * fish.control_interval
    power = (run["work"][-1, fit] - run["work"][0, fit]) / seconds / (MUSCLE * fish.body.mass.sum())
    return {
        "half_strain_percent": 50.0 * float(np.ptp(strain, axis=0).mean()),
        "strain_rate": float(np.quantile(np.abs(rate), QUANTILE)),
        "stress_kpa": 1e-3 * float(np.sqrt((pull**2).mean())),
        "stress_peak_kpa": 1e-3 * float(np.quantile(np.abs(pull), QUANTILE)),
        "power_w_kg": float(power.mean()),
    }


def sway(fish, run: dict) -> dict[str, float]:
    """Speed, beat and sway of fish that swim straight."""
    fit, mass = run["alive"][-1], fish.body.mass / fish.body.mass.sum()
    x = run["x"][:, fit]
    centre = np.einsum("n,tbni->tbi", mass, x)
    path, seconds = centre[-1] - centre[0], (len(x) - 1) * fish.control_interval
    way = np.linalg.norm(path[:, :2], axis=1)
    across = np.stack([-path[:, 1], path[:, 0], np.zeros(len(path))], axis=1) / way[:, None]
    tail, nose = (np.einsum("tbi,bi->tb", part - centre, across) / fish.length
                  for part in (x[:, :, fish.tail].mean(axis=2), x[:, :, fish.nose]))  # fmt: skip
    low, high = 0.5 * (1.0 - SWAY), 0.5 * (1.0 + SWAY)
    sweep, head = (np.quantile(part, high, axis=0) - np.quantile(part, low, axis=0) for part in (tail, nose))
    waves = np.abs(np.fft.rfft(tail - tail.mean(axis=0), 8192, axis=0)).argmax(axis=0)
    beat, speed = waves / (8192 * fish.control_interval), way / seconds / fish.length
    return {
        "speed": float(speed.mean()), "beat_hz": float(beat.mean()), "sweep": float(sweep.mean()),
        "nose_over_tail": float((head / sweep).mean()), "strouhal": float((beat * sweep / speed).mean()),
    }  # fmt: skip


def row_of(task: str, policy: Policy, **options) -> dict:
    """How a policy moves in its task."""
    config = CONFIGS[task]
    env = make_eval_env(config.env_id, FISH, dict(config.env_options) | options)
    fish, interval = env.tank.fish, env.control_interval
    last = min(round((SETTLING + SECONDS) / interval), (env.max_episode_steps or 10**9) - 1)
    run = swum(env, policy, last)
    env.close()
    late = {name: part[-(round(SECONDS / interval) + 1) :] for name, part in run.items()}
    moved = sway(fish, late) if task in STRAIGHT else {}
    named = dict.fromkeys(("speed", "beat_hz", "sweep", "nose_over_tail", "strouhal"), "") | moved
    numbers = {name: f"{value:.4g}" if value != "" else "" for name, value in (named | muscles(fish, late)).items()}
    return numbers | {"fish": int(late["alive"][-1].sum())}


def shipped_rows() -> list[dict]:
    """A row for each shipped policy."""
    return [{"task": task} | row_of(task, load_policy(task)) for task in CONFIGS]
