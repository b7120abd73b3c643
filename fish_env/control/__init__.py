"""Controllers and trained policies: all that is needed to run, evaluate and watch them, with numpy alone.

- `Policy`, `load_policy`, `shipped_policy`, `shipped_policies`: trained policies as files of plain numbers;
- `Gait`, `best_gait`: the open-loop gait; `Sequencer`, `scripted`: Tu's motor controllers (Tu 1996, ch. 5);
- `evaluate`, `run_episodes`, `means`: episodes on fixed seeds, with `policy_controller`, `gait_controller`,
  `random_actions` or a controller of your own in the batch that `make_eval_env` or `make_policy_env` makes;
- `record`, `load_recording`, `replay`: an episode as a file, simulated again and compared bit for bit;
- `play`, `write_film`, `write_video`: in a window, as a page that turns in 3-D or as a video, with the extra [render].

`fish_env.control.equivariant`, a policy for Stable-Baselines3 that is equivariant under the left-right reflection,
needs the extra [train] and is not imported here.
"""

from fish_env.control.evaluation import (
    EPISODES,
    FIRST_SEED,
    Controller,
    Scores,
    evaluate,
    evaluation_options,
    gait_controller,
    make_eval_env,
    make_policy_env,
    means,
    policy_controller,
    run_episodes,
)
from fish_env.control.film import write_film
from fish_env.control.gait import Gait, best_gait
from fish_env.control.motor import MotorTables, load_tables
from fish_env.control.playback import play
from fish_env.control.policy import Policy, load_policy, shipped_policies, shipped_policy
from fish_env.control.recording import Recording, load_recording
from fish_env.control.replaying import Replay, record, replay
from fish_env.control.sequencer import Habits, Sequencer, random_actions, scripted
from fish_env.control.video import write_video

__all__ = [
    "EPISODES",
    "FIRST_SEED",
    "Controller",
    "Gait",
    "Habits",
    "MotorTables",
    "Policy",
    "Recording",
    "Replay",
    "Scores",
    "Sequencer",
    "best_gait",
    "evaluate",
    "evaluation_options",
    "gait_controller",
    "load_policy",
    "load_recording",
    "load_tables",
    "make_eval_env",
    "make_policy_env",
    "means",
    "play",
    "policy_controller",
    "random_actions",
    "record",
    "replay",
    "run_episodes",
    "scripted",
    "shipped_policies",
    "shipped_policy",
    "write_film",
    "write_video",
]
