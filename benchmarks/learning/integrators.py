"""Check that no policy exploits the integrator: replay it under RK4 at an eighth of the step, and every other method.

`python train.py compare --integrators` writes benchmarks/results/integrators_policies.csv and .svg; with the name of a
shipped policy, its rows again. The last rows of the table are those of many more episodes, by the reference and the
default method alone.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.common.charts import METHOD_STYLE, legend_below, panels, save, words
from benchmarks.common.statistics import rounded
from benchmarks.common.tables import RESULTS, read_table, replace_rows, select
from fish_env import INTEGRATORS
from fish_env.control import Scores, load_policy, make_policy_env, run_episodes, shipped_policies
from fish_env.control.evaluation import episode_scores, scores_by_name
from fish_env.control.files import writable_folder
from fish_env.envs import FishVectorEnv

EPISODES = 50
MANY = 1000  # for the default method: its difference is smaller than the standard error of fifty episodes
COMMAND, TABLE = "python train.py compare --integrators", "integrators_policies.csv"
WIDTHS = (18, 32, 10, 7, 8, 9, 15, 16, 9, 16, 17, 8)  # of the columns of the table that is printed
NOT_DRAWN = {"midpoint", "symplectic_euler", "linearly_implicit_projected", "linearly_implicit_water"}
FINER = 8  # the reference takes this part of the fish's own step


def settings(fish) -> list[tuple[str, float, float | None]]:
    """Methods, steps and what refines them, the reference first: each method at its own step and half of it.

    The default method, which alone refines its steps, is tried at coarser ones too.
    """
    from fish_env.physics.tank_options import own_step

    own = fish.control_interval / fish.time_step
    found: list[tuple[str, float, float | None]] = [("rk4", fish.control_interval / (FINER * own), None)]
    for record in INTEGRATORS.values():
        if record.kind == "adaptive":
            continue  # adaptive methods choose their own step, and take a hundred times as long
        steps = round(fish.control_interval / own_step(fish, record))
        default = record.name == fish.integrator
        counts = [steps, 2 * steps, *([steps // 2, steps // 4] if default else [])]
        found += [(record.name, fish.control_interval / count, fish.refine if default else None) for count in counts]
    return found


def replay(path: str | Path, how: tuple[str, float, float | None], episodes: int) -> tuple[Scores, np.ndarray]:
    """Scores (B,) and path (T,B,3), body lengths, of the policy under one of `settings`; the path ends in NaN."""
    integrator, dt, refine = how
    policy = load_policy(path)
    env = make_policy_env(policy, episodes, integrator=integrator, dt=dt, refine=refine)
    results, track = [{}] * env.num_envs, []
    for ended, done, infos in run_episodes(env, policy):
        for i in np.flatnonzero(ended).tolist():
            results[i] = episode_scores(infos["final_info"], i)
        track.append(np.where(done[:, None], np.nan, places(env)))
    return scores_by_name(results), np.array(track)


def places(env: FishVectorEnv) -> np.ndarray:
    """Centres of mass now, (B,3) body lengths."""
    mass = env.tank.fish.body.mass
    return np.tensordot(mass, env.tank.position, (0, 1)) / mass.sum() / env.tank.fish.length


def replays(path: str | Path, hows: Iterable[tuple[str, float, float | None]], episodes: int) -> list[dict]:
    """A row for each of some `settings`: scores of the policy, and their differences from those of the first."""
    rows, reference, task = [], None, load_policy(path).about["task"]
    for how in tqdm(hows, desc=task, unit=" settings"):
        scores, track = replay(path, how, episodes)
        reference = reference or (scores, track)
        integrator, dt, refine = how
        rows.append({"task": task, "integrator": integrator, "dt_ms": round(1e3 * dt, 6), "refine": refine or np.inf,
                     "episodes": episodes} | differences(scores, track, *reference))  # fmt: skip
    return rows


def compare_integrators(names: list[str | Path] | None = None) -> list[dict]:
    """Replay policies under every method and print what changes; write the rows of shipped ones, and the chart, too.

    `names` are of shipped policies, or files of others, of which nothing is published; None for all shipped ones.
    """
    shipped = shipped_policies()
    published = not names or {str(name) for name in names} <= shipped.keys()
    if published:
        writable_folder(RESULTS)
    fish = {path: make_policy_env(load_policy(path), 1).tank.fish for path in names or shipped}
    rows = [row for path in fish for row in replays(path, settings(fish[path]), EPISODES)]
    if published:
        for path, own in fish.items():
            rows += replays(path, (settings(own)[0], (own.integrator, own.time_step, own.refine)), MANY)
        replace_rows(TABLE, rows, shipped, COMMAND)
        draw()
    for row in ({name: name for name in rows[0]}, *rows):
        print(" ".join(str(value).rjust(width) for value, width in zip(row.values(), WIDTHS, strict=True)))
    return rows


def differences(scores: Scores, track: np.ndarray, reference: Scores, reference_track: np.ndarray) -> dict:
    """Differences of scores and paths from those of the reference."""
    count = min(len(track), len(reference_track))
    apart = np.linalg.norm(track[:count] - reference_track[:count], axis=2)
    finite = np.isfinite(apart).any(axis=0)
    total, wanted = scores["return"].mean(), reference["return"].mean()
    change = (scores["return"] - reference["return"]) / abs(wanted)
    success = "success" if "success" in scores else None
    return {
        "return": rounded(total),
        "return_change": rounded(change.mean()),
        "standard_error": rounded(change.std(ddof=1) / np.sqrt(change.size)),
        "success": rounded(scores[success].mean()) if success else "",
        "success_change": rounded(scores[success].mean() - reference[success].mean()) if success else "",
        "path_difference": rounded(float(np.median(np.nanmax(apart[:, finite], axis=0)))) if finite.any() else "",
        "failed": int(scores["failed"].sum()),
    }


def draw() -> None:
    """Change of the return against the step, a panel for each task, a colour for each method."""
    rows = read_table(TABLE, episodes=EPISODES)
    tasks, names = (list(dict.fromkeys(row[key] for row in rows)) for key in ("task", "integrator"))
    figure, grid = panels(3, 6.6, 2, sharex=True, sharey=True)
    for axes, task in zip(grid, (task for task in tasks if task != "left_after_right"), strict=True):
        for name in (name for name in names if name not in NOT_DRAWN):
            points = [(row["dt_ms"], max(abs(row["return_change"]), 1e-4))
                      for row in select(rows, task=task, integrator=name) if row["return_change"] != 0]  # fmt: skip
            if points:
                colour, marker = METHOD_STYLE[name]
                axes.loglog(*np.array(sorted(points)).T, color=colour, marker=marker, label=words(name))
        axes.axhline(0.02, color="black", lw=0.8, ls=":")
        axes.set(title=words(task), ylim=(5e-5, 1))
    grid[-2].set_xlabel("step, ms")
    figure.supylabel("change of the return, relative (dotted: 0.02)")
    legend_below(figure, 3)
    save(figure, RESULTS / "integrators_policies.svg")
