"""Hook of the documentation site: the film of Left after right is made when the site is built, by the shipped policy.

In the repository, pages link to this file where the site has the film.
"""

import gymnasium as gym
from mkdocs.structure.files import File, Files

from fish_env.control import load_policy, record
from fish_env.control.film import film_text

TASK, EPISODES = "left_after_right", 3
HERE, FILM = "site/film.py", f"videos/{TASK}.html"


def film(episodes=EPISODES) -> str:
    """The page with episodes of the shipped policy, in 3-D."""
    policy = load_policy(TASK)
    env = gym.make(policy.about["env_id"], **policy.about["env_options"])
    text = film_text([record(env, policy, seed) for seed in range(episodes)])
    env.close()
    return text


def on_files(files: Files, config) -> Files:
    """Add the film."""
    files.append(File.generated(config, FILM, content=film()))
    return files


def on_page_markdown(markdown: str, page, config, files: Files) -> str:
    """Turn links to this file into links to the film."""
    return markdown.replace(f"({HERE})", f"({FILM})")
