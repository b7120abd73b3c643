"""Controllers and trained policies: all that is needed to run, evaluate and watch them, with numpy alone.

- `Policy`, `Normalisation`, `load_policy`, `shipped_policy`, `shipped_policies`: trained policies as plain numbers;
- `Gait`, `best_gait`: the open-loop gait; `Sequencer`, `scripted`: Tu's motor controllers (Tu 1996, ch. 5);
- `evaluate`, `compare`, `run_episodes`, `means`: episodes on fixed seeds, for what `as_controller` takes: a policy, its
  name or file, a model of Stable-Baselines3, or a function such as `gait_controller` and `random_actions` return; in
  the batch that `make_eval_env` or `make_policy_env` makes;
- `record`, `load_recording`, `replay`: an episode as a file, simulated again and compared bit for bit;
- `play`, `write_film`, `write_video`: in a window, as a page that turns in 3-D or as a video, with the extra [render].

`export_policy` makes a `Policy` of a model of Stable-Baselines3; `fish_env.control.equivariant` is a policy for it that
is equivariant under the left-right reflection. Both need the extra [train], and are imported when they are first used.
"""

from typing import TYPE_CHECKING

from fish_env.control.evaluation import (
    EPISODES,
    FIRST_SEED,
    Controller,
    PolicyLike,
    Scores,
    as_controller,
    evaluate,
    evaluation_options,
    gait_controller,
    make_eval_env,
    make_policy_env,
    policy_controller,
    run_episodes,
)
from fish_env.control.film import write_film
from fish_env.control.gait import Gait, best_gait
from fish_env.control.motor import MotorTables, load_tables
from fish_env.control.playback import play
from fish_env.control.policy import Normalisation, Policy, load_policy, shipped_policies, shipped_policy
from fish_env.control.recording import Recording, load_recording
from fish_env.control.replaying import Replay, record, replay
from fish_env.control.sequencer import Sequencer, SequencerConfig, random_actions, scripted
from fish_env.control.statistics import Comparison, Interval, compare, means
from fish_env.control.video import write_video
from fish_env.physics.lazy import lazy_names

if TYPE_CHECKING:
    from fish_env.control.equivariant import export_policy  # noqa: F401

__all__ = [
    "EPISODES", "FIRST_SEED", "Comparison", "Controller", "Gait", "Interval", "MotorTables", "Normalisation", "Policy",
    "PolicyLike", "Recording", "Replay", "Scores", "Sequencer", "SequencerConfig", "as_controller", "best_gait",
    "compare", "evaluate", "evaluation_options", "gait_controller", "load_policy", "load_recording", "load_tables",
    "make_eval_env", "make_policy_env", "means", "play", "policy_controller", "random_actions", "record", "replay",
    "run_episodes", "scripted", "shipped_policies", "shipped_policy", "write_film", "write_video",
]  # fmt: skip

__getattr__ = lazy_names(__name__, {"export_policy": "fish_env.control.equivariant:export_policy"})
