"""Model cards of the shipped policies, as Hugging Face reads them, each beside the files that it describes.

python -m benchmarks.learning.cards --out cards    writes cards/<task>/README.md, policy.npz and config.json

Settings are those of the run (config.json beside the policy); scores are those of benchmarks/results/learning/.
"""

import json
import shutil
from pathlib import Path

from benchmarks.common.tables import make_parser, markdown, number, read_stored, select
from benchmarks.learning.publish import METHODS, PUBLICATIONS, SEEDS_TABLE, UNITS, cell
from fish_env.control import EPISODES, load_policy, shipped_policies

TEXT = """
# {name}
A policy that makes a simulated fish {goal}: a multilayer perceptron, trained by the PPO of Stable-Baselines3.

## Use
```python
import gymnasium as gym
from fish_env.control import load_policy  # pip install fish_env
policy = load_policy("policy.npz")
env = gym.make(policy.about["env_id"], **policy.about["env_options"])
obs, info = env.reset(seed=0)
obs, reward, terminated, truncated, info = env.step(policy(obs))
```

## Training
No recorded data: {num_envs} simulated fish met random episodes of the environment.
```sh
{command}
```
Of {seeds} seeds, the one of median score: {seed}. It took {minutes:.0f} minutes on one core, with {versions}.

{settings}
## Scores
Means of {episodes} episodes that the training did not use; of others, interquartile means and 95 % intervals: bootstrap
ones, and Wilson's of shares.

{scores}
## Intended use and limits
- For research and teaching: a baseline for the environment, and a controller of its default fish.
- It is for that body, water, step and observation (layout {layout}), without noise or delays. Others need a training.
- Nothing was measured on a robot or on a living fish. Do not control machines with it.
"""


def card(task: str) -> str:
    """The card of a shipped policy: YAML, here as JSON, which is YAML too, and Markdown."""
    path = shipped_policies()[task]
    run = json.loads((path.parent / "config.json").read_text(encoding="utf-8"))
    config, env_id = run["config"], run["config"]["env_id"]
    seeds, methods = (select(read_stored(name), task=task, condition="") for name in (SEEDS_TABLE, METHODS))
    (mine,) = select(seeds, seed=str(run["seed"]))
    table, metrics = [], []
    for name in ("return", *PUBLICATIONS[task].metrics, "failed"):
        heading, factor, digits = UNITS[name]
        by = {row["method"]: cell(row) for row in select(methods, metric=name)}
        score = f"{factor * float(mine[name]):.{digits}f}" if mine[name] else "-"
        table.append([heading, score, by["PPO"], by.get("motor controllers", "-")])
        kind = "mean_reward" if name == "return" else name
        metrics += [{"type": kind, "name": heading, "value": number(score)}] * bool(mine[name])
    learning, goal = "reinforcement-learning", PUBLICATIONS[task].goal.replace("the same", PUBLICATIONS["target"].goal)
    result = {"task": {"type": learning, "name": learning}, "dataset": {"name": env_id, "type": env_id},
              "metrics": metrics}  # fmt: skip
    head = {"library_name": "stable-baselines3", "license": "mit", "pipeline_tag": learning,
            "tags": [learning, "deep-reinforcement-learning", "ppo", "gymnasium", "fish_env", env_id],
            "model-index": [{"name": f"PPO-{task}", "results": [result]}]}  # fmt: skip
    settings = markdown(["Setting", "Value"], [[f"`{key}`", f"`{value}`"] for key, value in config.items()])
    text = TEXT.format(
        name=f"PPO for {env_id}", goal=goal, num_envs=config["num_envs"], seed=run["seed"],
        command=run["command"].replace(" && ", "\n"), seeds=len(seeds), minutes=float(mine["training_seconds"]) / 60,
        versions=", ".join(f"{key} {value}" for key, value in run["versions"].items()), settings=settings,
        episodes=EPISODES, layout=load_policy(path).layout_version,
        scores=markdown(["", "this policy", f"PPO, {len(seeds)} seeds", "motor controllers"], table),
    )  # fmt: skip
    return f"---\n{json.dumps(head, indent=2, ensure_ascii=False)}\n---\n{text}"


if __name__ == "__main__":
    parser = make_parser(__doc__)
    parser.add_argument("--out", type=Path, required=True, help="a folder for the cards")
    out = parser.parse_args().out
    for task, path in shipped_policies().items():
        folder = out / task
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("policy.npz", "config.json"):
            shutil.copy(path.parent / name, folder)
        (folder / "README.md").write_text(card(task), encoding="utf-8")
