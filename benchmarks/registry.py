"""Every published number: the command that makes it, what it shows, what it is made with, and how long that takes.

One record a command. `makes` names the definitions that make the numbers, "module:name": the functions that measure,
without those that draw and write; what they refer to is found from the code (`benchmarks/freshness.py`). What no name
of Python leads to is named too: environments that are made by their id, and data files.
"""

import shutil
from dataclasses import dataclass

RESULTS, IMAGES = "benchmarks/results/", "docs/images/"
BODIES = "fish_env/bodies/*.json"
GAIT = "fish_env/control/gait.json"
MOTOR = "fish_env/control/motor_controllers.json"
POLICIES = "fish_env/control/pretrained/*/policy.npz"
DEFAULT = "fish_env/bodies/mass_spring.json"
FINEST = "fish_env/bodies/tetrahedral.json"
BATCH = "fish_env.envs.vector:FishVectorEnv"
SINGLE = "fish_env.envs.single:FishEnv"
RELIABILITY = ("benchmarks.stability.reliability:outcome", "benchmarks.stability.reliability:TRIALS")
LEARNED = ("swim", "turn", "left_after_right", "target", "target_3d", "avoid")


@dataclass(frozen=True)
class Result:
    """What one command publishes."""

    name: str
    """The room and a word."""
    shows: str
    command: str
    """What follows "python"."""
    minutes: float
    """On a machine with two cores, about."""
    outputs: tuple[str, ...]
    """Files below the repository's root."""
    makes: tuple[str, ...]
    data: tuple[str, ...] = (DEFAULT,)
    """Files and patterns of files that the numbers are made with."""
    one_core: bool = False
    """Whether it is a timing that is to stay on one core."""
    by_name: bool = False
    """Whether it replaces parameters of the package: it then runs only when it is named."""

    @property
    def room(self) -> str:
        """The part of the benchmarks that it belongs to."""
        return self.name.split(".")[0]

    @property
    def command_line(self) -> str:
        """The command as it is typed."""
        return f"{'taskset -c 1 ' if self.one_core else ''}python {self.command}"

    def arguments(self, python: str) -> list[str]:
        """The command for `subprocess`, by this interpreter; pinned to a core where `taskset` is installed."""
        pinned = ["taskset", "-c", "1"] if self.one_core and shutil.which("taskset") else []
        return [*pinned, python, *self.command.split()]


def csv(*names: str) -> tuple[str, ...]:
    """Tables and charts in benchmarks/results/."""
    return tuple(f"{RESULTS}{name}" if "." in name else f"{RESULTS}{name}.csv" for name in names)


def images(*names: str) -> tuple[str, ...]:
    """Pictures in docs/images/."""
    return tuple(f"{IMAGES}{name}" for name in names)


ACCURACY = (
    Result(
        "accuracy.work_precision", "error against computing time of every method on eight scenes; energy in vacuum",
        "-m benchmarks.accuracy.work_precision", 12,
        csv("work_precision", "work_precision_references", "energy", "work_precision_time.svg",
            "work_precision_turn.svg", "work_precision_forces.svg", "energy.svg"),
        ("benchmarks.accuracy.work_precision:sweep", "benchmarks.accuracy.work_precision:reference_of",
         "benchmarks.accuracy.work_precision:energy"), one_core=True,
    ),
    Result(
        "accuracy.refinement", "steps a control interval and intervals that are repeated: error, cost and stability",
        "-m benchmarks.accuracy.refinement", 3,
        csv("refinement", "refinement_stable") + images("refinement.svg"),
        ("benchmarks.accuracy.refinement:errors", "benchmarks.accuracy.refinement:stability"),
    ),
    Result(
        "accuracy.boundary", "prescribed displacements: a penalty against elimination",
        "-m benchmarks.accuracy.boundary", 0.5, csv("boundary") + images("boundary.svg"),
        ("benchmarks.accuracy.boundary:compare",),
    ),
    Result(
        "accuracy.finite_elements", "tetrahedra against beam theory; measures of strain in rotation and bending",
        "-m benchmarks.accuracy.finite_elements", 3,
        csv("elements_beam", "elements_strains") + images("elements.svg"),
        ("benchmarks.accuracy.finite_elements:refined", "benchmarks.accuracy.finite_elements:strains"), data=(),
    ),
    Result(
        "accuracy.rejected_methods", "rejected methods beside the default one: error against force evaluations",
        "-m benchmarks.accuracy.rejected_methods.survey", 2, csv("ideas", "ideas.svg"),
        ("benchmarks.accuracy.rejected_methods.survey:sweep",),
    ),
)  # fmt: skip

STABILITY = (
    Result(
        "stability.survey", "step-size limits of every method, on every body and against stiffness",
        "-m benchmarks.stability.survey", 9,
        csv("stability", "stability_limits", "stability.svg", "stability_map.svg", "stability_published.svg"),
        ("benchmarks.stability.runs:cases", "benchmarks.stability.runs:reference", "benchmarks.stability.runs:sweep",
         "benchmarks.stability.linear:linear_limit"), data=(BODIES,), one_core=True,
    ),
    Result(
        "stability.margins", "the default step beside the largest stable one, in every task",
        "-m benchmarks.stability.margins", 1, csv("stability_margins"), ("benchmarks.stability.margins:margins",),
    ),
    Result(
        "stability.commands", "fish that fail in 10 s of random, bang-bang and oscillating commands, of every body",
        "-m benchmarks.stability.commands", 20, csv("commands"),
        ("benchmarks.stability.commands:measure", "benchmarks.stability.mistreatment:GOALS"), data=(BODIES,),
    ),
    Result(
        "stability.heavy_water", "fish of half the mass and twice the drag in water of up to 16 times its density: "
        "which fail, and how far the others are from a fine solution", "-m benchmarks.stability.heavy_water", 2,
        csv("heavy_water"),
        ("benchmarks.stability.heavy_water:measure", "benchmarks.stability.mistreatment:GOALS", BATCH), data=(BODIES,),
    ),
    Result(
        "stability.soak", "every task on every body under all kinds of actions at the extremes of the variation: what "
        "is not finite, failures, memory, speed",
        "-m benchmarks.stability.soak --steps 100000000", 60, csv("soak", "soak_sessions"),
        ("benchmarks.stability.soak:round_of", "benchmarks.stability.soak:extremes",
         "benchmarks.stability.soak:speed", BATCH), data=(BODIES,), one_core=True,
    ),
    Result(
        "stability.attack", "failures of every body under random, bang-bang, oscillating and searched commands; also "
        "tests/worst/",
        "-m benchmarks.stability.attack", 10, csv("attack"),
        ("benchmarks.stability.attack:mistreat", "benchmarks.stability.attack_search:search",
         "benchmarks.stability.mistreatment:families"), data=(BODIES,),
    ),
    Result(
        "stability.fuzz", "public calls, files and sequences of calls with odd arguments: refused, or done",
        "-m benchmarks.stability.reliability fuzz", 30, csv("reliability_fuzz", "reliability_calls"),
        (*RELIABILITY, BATCH, SINGLE), data=("tests/fuzzing.py", "tests/test_fuzz_*.py"),
    ),
    Result(
        "stability.bounds", "the tests of the physics with kernels that check their bounds",
        "-m benchmarks.stability.reliability bounds", 60, csv("reliability_bounds"), (*RELIABILITY, BATCH),
    ),
    Result(
        "stability.company", "start methods, threads, caches and many processes at once",
        "-m benchmarks.stability.reliability company", 5, csv("reliability_company"), (*RELIABILITY, BATCH),
    ),
    Result(
        "stability.checks", "checkers and wrappers of other packages over every id, body, option and method",
        "-m benchmarks.stability.reliability checks", 5, csv("reliability_checks"), (*RELIABILITY, BATCH, SINGLE),
    ),
    Result(
        "stability.versions", "built, installed and tested on other versions of Python and of the dependencies",
        "-m benchmarks.stability.versions", 60, csv("versions"),
        ("benchmarks.stability.versions:trial", BATCH), data=("pyproject.toml", "constraints.txt"),
    ),
    Result(
        "stability.repeatability", "the same bits in other processes, checkouts and numbers of threads",
        "-m benchmarks.stability.repeatability", 30, csv("repeatability"),
        ("benchmarks.stability.repeatability:compare", BATCH, SINGLE),
    ),
    Result(
        "stability.published_again", "published scores of policies and controllers, measured again",
        "-m benchmarks.stability.repeatability --published", 1, csv("published_again"),
        ("benchmarks.stability.repeatability:published_again", "benchmarks.stability.repeatability:all_scores", BATCH),
        data=(DEFAULT, GAIT, MOTOR, POLICIES, "benchmarks/results/learning/*.csv"),
    ),
)  # fmt: skip

SPEED = (
    Result(
        "speed.environments", "environment steps a second, memory, time of a first use",
        "-m benchmarks.speed.throughput --environments", 2, csv("throughput"),
        ("benchmarks.speed.throughput:environments", BATCH, SINGLE),
    ),
    Result(
        "speed.kinds", "cost of one and of many fish by every kind of kernel and precision",
        "-m benchmarks.speed.throughput --kinds", 2, csv("kinds"),
        ("benchmarks.speed.costs:kinds", "benchmarks.speed.costs:threads"), data=(DEFAULT, GAIT),
    ),
    Result(
        "speed.steps", "cost of a step of every method",
        "-m benchmarks.speed.throughput --integrators", 1, csv("steps"),
        ("benchmarks.speed.costs:integrators",), data=(DEFAULT, GAIT),
    ),
    Result(
        "speed.bodies", "cost of a control interval of every body",
        "-m benchmarks.speed.throughput --bodies", 1, csv("bodies"),
        ("benchmarks.speed.costs:bodies",), data=(BODIES, GAIT),
    ),
    Result(
        "speed.scaling", "cost against the number of fish and against the number of nodes (needs 3 GB)",
        "-m benchmarks.speed.scaling", 5, csv("scaling_fish", "scaling_nodes") + images("scaling.svg"),
        ("benchmarks.speed.scaling:by_fish", "benchmarks.speed.scaling:by_nodes"), data=(BODIES, GAIT),
    ),
    Result(
        "speed.factorisation", "the skyline factorisation against a general sparse solver",
        "-m benchmarks.speed.factorisation", 1, csv("factorisation") + images("factorisation.svg"),
        ("benchmarks.speed.factorisation:slender", "benchmarks.speed.factorisation:measure"), data=(), one_core=True,
    ),
    Result(
        "speed.constant_matrix", "what the constant matrix of linear elasticity saves a step",
        "-m benchmarks.speed.constant_matrix", 1, csv("constant_matrix"),
        ("benchmarks.speed.constant_matrix:measure",), data=(), one_core=True,
    ),
    Result(
        "speed.limits", "operations of a step against what the processor can do",
        "-m benchmarks.speed.limits", 2, csv("speed/limits.csv"),
        ("benchmarks.speed.limits:operations", "benchmarks.speed.limits:best_times",
         "benchmarks.speed.limits:bounds", "benchmarks.speed.limits:measured"), data=(DEFAULT, GAIT), one_core=True,
    ),
    Result(
        "speed.cluster", "sampling and learning with one and more runners of Ray RLlib (needs the extra [cluster])",
        "-m benchmarks.speed.cluster", 1, csv("cluster"),
        ("benchmarks.speed.cluster:measure", "fish_env.envs.rllib:FishEnvRunner", BATCH),
        data=(DEFAULT, "examples/train_rllib.py"),
    ),
    Result(
        "speed.cluster_trainings", "Swim trained by Ray RLlib with two runners (needs the extra [cluster])",
        "-m benchmarks.speed.cluster --train", 4, csv("cluster_trainings"),
        ("benchmarks.speed.cluster:trained", "fish_env.envs.rllib:FishEnvRunner", BATCH),
        data=(DEFAULT, "examples/train_rllib.py"),
    ),
    Result(
        "speed.laboratory", "updates a second of every object in the laboratory (needs the extra [browser], Chromium)",
        "-m benchmarks.speed.laboratory --rates", 5, csv("speed/laboratory.csv"),
        ("benchmarks.speed.laboratory:rates", "fish_env.lab.drawing:Drawing", "fish_env.lab.bench:Bench"),
        data=(BODIES, GAIT),
    ),
    Result(
        "speed.laboratory_start", "time until the page of the laboratory is usable (needs the same)",
        "-m benchmarks.speed.laboratory --start", 1, csv("speed/laboratory_start.csv"),
        ("benchmarks.speed.laboratory:starts", "fish_env.lab.server:Laboratory"), data=(),
    ),
    Result(
        "speed.peers", "other simulators on the same springs, other environments (needs the extra [peers])",
        "-m benchmarks.speed.peers", 5, csv("speed/peers.csv"),
        ("benchmarks.speed.peers:spring_rows", "benchmarks.speed.environments:singles",
         "benchmarks.speed.environments:vectors", BATCH, SINGLE),
    ),
)  # fmt: skip

FIDELITY = (
    Result(
        "bodies.fidelity", "distance of every body to the finest, and its cost, in a scene of every task",
        "-m benchmarks.bodies.fidelity", 12, csv("fidelity") + images("fidelity.svg"),
        ("benchmarks.bodies.fidelity:run",), data=(BODIES, MOTOR),
    ),
    Result(
        "bodies.costs", "cost of every body beside the default one",
        "-m benchmarks.bodies.fidelity --cost", 2, csv("body_costs"),
        ("benchmarks.bodies.fidelity:costs", "benchmarks.bodies.fidelity:every_fish"), data=(BODIES, MOTOR),
        one_core=True,
    ),
    Result(
        "bodies.convergence", "what the finest body lacks: levels 1 to 3 against level 4, in a scene of every task",
        "-m benchmarks.bodies.convergence", 30, csv("convergence"), ("benchmarks.bodies.convergence:run",),
        data=(FINEST, DEFAULT, MOTOR),
    ),
    Result(
        "bodies.roll", "by how much every body rolls in strong gaits, after a small disturbance",
        "-m benchmarks.bodies.roll", 0.5, csv("roll"), ("benchmarks.bodies.roll:measure",), data=(BODIES,),
    ),
    Result(
        "bodies.inertia", "mass, centre and moments of inertia of every body beside those of the outline's continuum",
        "-m benchmarks.bodies.inertia", 0.1, csv("inertia"), ("benchmarks.bodies.inertia:measure",), data=(BODIES,),
    ),
)  # fmt: skip

OBJECTS = (
    Result(
        "objects.survey", "elastic objects dropped, thrown and dragged; largest steps and errors of Song's methods",
        "-m benchmarks.objects.survey", 3,
        csv("objects_scenes", "objects_methods", "objects_methods.svg") + images("objects.webp"),
        ("benchmarks.objects.survey:passes", "benchmarks.objects.survey:methods"), data=(),
    ),
    Result(
        "objects.layers", "one layer and two on a floor, by the pressure of their gas; layers against each other",
        "-m benchmarks.objects.layers", 1, csv("objects_layers", "objects_layer_modes", "objects_layers.svg"),
        ("benchmarks.objects.layers:collapse", "benchmarks.objects.layers:against_each_other"), data=(),
    ),
    Result(
        "objects.solids", "solids of finite elements: errors, costs and largest steps of every method; recovery",
        "-m benchmarks.objects.solids", 2, csv("solids_methods", "solids_recovery", "solids_methods.svg"),
        ("benchmarks.objects.solids:methods", "benchmarks.objects.solids:recovered"), data=(),
    ),
)  # fmt: skip

CALIBRATION = (
    Result(
        "calibration.check", "the best open-loop gait against its bars",
        "-m benchmarks.calibration.check", 1, csv("gait"), ("benchmarks.calibration.check:check",),
        data=(DEFAULT, GAIT),
    ),
    Result(
        "calibration.living_fish", "every body beside a living trout: speed, sweep and the sway of the midline",
        "-m benchmarks.calibration.living_fish --check", 3, csv("living_fish", "living_fish.svg"),
        ("benchmarks.calibration.living_fish:check",), data=(BODIES,),
    ),
    Result(
        "calibration.fits", "five fits of each inexpensive body, on what they were not fitted to",
        "-m benchmarks.calibration.fit --spread --body mass_spring planar", 8, csv("fits"),
        ("benchmarks.calibration.fit:search", "benchmarks.calibration.fit:tested"),
        data=(FINEST, "benchmarks/calibration/task_commands.npz", MOTOR),
    ),
    Result(
        "calibration.limits", "what the default fish could be with other stable steps: distances, cost",
        "-m benchmarks.calibration.fit --limits", 8, csv("fit_limits"),
        ("benchmarks.calibration.fit:search", "benchmarks.calibration.fit:tested"),
        data=(FINEST, "benchmarks/calibration/task_commands.npz", MOTOR),
    ),
    Result(
        "calibration.fit_tests", "the fitted bodies on seeds and families of commands that they were not fitted to",
        "-m benchmarks.calibration.fit --test", 8, csv("fit_tests"), ("benchmarks.calibration.fit:tested",),
        data=(BODIES, MOTOR),
    ),
    Result(
        "calibration.coarse_water", "a fine solid with the water on coarse faces, beside the finest body",
        "-m benchmarks.calibration.coarse_water", 3, csv("coarse_water"),
        ("benchmarks.calibration.coarse_water:variants",), data=(FINEST, "benchmarks/calibration/task_commands.npz"),
    ),
    Result(
        "calibration.finest", "material of the finest body, and three gaits, calibrated to living fish",
        "-m benchmarks.calibration.living_fish", 8, (FINEST,), ("benchmarks.calibration.living_fish:cost_at",),
        data=(), by_name=True,
    ),
    Result(
        "calibration.commands", "adds what the motor controllers command in each task to what bodies are fitted to",
        "-m benchmarks.calibration.commands", 1, ("benchmarks/calibration/task_commands.npz",),
        ("benchmarks.calibration.commands:main",), data=(DEFAULT, MOTOR), by_name=True,
    ),
    Result(
        "calibration.fit", "parameters of the other bodies, fitted in motion to the finest one",
        "-m benchmarks.calibration.fit", 40,
        tuple(f"fish_env/bodies/{name}.json" for name in ("mass_spring", "planar", "two_layer")),
        ("benchmarks.calibration.fit:search",), data=(FINEST, "benchmarks/calibration/task_commands.npz"), by_name=True,
    ),
    Result(
        "calibration.gait_search", "the best open-loop gait",
        "-m benchmarks.calibration.gait_search", 4, (GAIT,), ("benchmarks.calibration.gait_search:write_gait", BATCH),
        by_name=True,
    ),
    Result(
        "calibration.motor_controllers", "tables of the motor controllers",
        "-m benchmarks.calibration.motor_controllers --search", 5, (MOTOR,),
        ("benchmarks.calibration.motor_controllers:search_turns",
         "benchmarks.calibration.motor_controllers:search_swims"), data=(DEFAULT, GAIT), by_name=True,
    ),
)  # fmt: skip

LEARNING = (
    Result(
        "learning.all", "every task trained with all its seeds; reuses finished runs, replaces the shipped policies",
        "train.py all", 120,
        tuple(f"{RESULTS}learning/{task}_{what}.csv" for task in LEARNED for what in ("seeds", "methods", "curves"))
        + images("curves.svg"),
        ("agents.train:train", "agents.results:publish_task", BATCH), data=(DEFAULT, GAIT, MOTOR), by_name=True,
    ),
    Result(
        "learning.semi_implicit", "every task trained with Tu's method, three seeds each, beside the default",
        "train.py all --integrator semi_implicit --dt 0.000625", 60,
        (f"{RESULTS}learning/trained_with_semi_implicit.csv",),
        ("agents.results:publish_method", "agents.train:train", BATCH), data=(DEFAULT,), by_name=True,
    ),
    Result(
        "learning.integrators", "the shipped policies under every method and step",
        "train.py compare --integrators", 20,
        csv("integrators_policies", "integrators_default", "integrators_policies.svg"),
        ("agents.integrators:replay", "agents.integrators:settings", "agents.integrators:differences", BATCH),
        data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.speed", "cost of an environment step during training, both learners",
        "-m benchmarks.learning.learning_speed", 3, csv("learning_speed"),
        ("benchmarks.learning.learning_speed:Run", BATCH),
    ),
    Result(
        "learning.kills", "training that is killed at random and resumed: broken files, what is lost, the policy",
        "-m benchmarks.learning.kills", 20, csv("kills"),
        ("benchmarks.learning.kills:Killed", "benchmarks.learning.kills:start", BATCH),
    ),
    Result(
        "learning.gait_seconds", "seconds of training to the speed of the best gait",
        "-m benchmarks.learning.learning_speed --gait", 2, csv("gait_seconds"),
        ("benchmarks.learning.learning_speed:time_to_gait", BATCH), data=(DEFAULT, GAIT),
    ),
    Result(
        "learning.ablations", "LeftAfterRight-v0 trained with one choice undone at a time",
        "-m benchmarks.learning.ablations --seeds 1 --fresh", 22, csv("ablations_left_after_right"),
        ("benchmarks.learning.ablations:learn", "benchmarks.learning.ablations:LEFT_AFTER_RIGHT", BATCH),
    ),
    Result(
        "learning.ablations_turn", "Turn-v0 trained with other weights of the overshoot",
        "-m benchmarks.learning.ablations --task turn --seeds 1 --fresh", 24, csv("ablations_turn"),
        ("benchmarks.learning.ablations:learn", "benchmarks.learning.ablations:TURN", BATCH),
    ),
    Result(
        "learning.algorithms", "PPO, SAC and TD3 on Swim-v0 for the same wall time",
        "-m benchmarks.learning.algorithms --seconds 150", 12, csv("algorithms_swim"),
        ("benchmarks.learning.algorithms:METHODS", "benchmarks.learning.algorithms:Looks", BATCH),
    ),
    Result(
        "learning.transfer", "policies trained on one body, replayed and fine-tuned on others; reuses finished runs",
        "-m benchmarks.learning.transfer", 60,
        csv("transfer_matrix", "transfer_curves", "transfer_savings") + images("transfer.svg"),
        ("benchmarks.learning.transfer_runs:learn", "benchmarks.learning.transfer_runs:measured",
         "benchmarks.learning.transfer_runs:runs", "benchmarks.learning.transfer_chart:saving_rows", BATCH),
        data=(BODIES,),
    ),
    Result(
        "learning.transfer_shipped", "the shipped policies and the motor controllers on every body",
        "-m benchmarks.learning.transfer --shipped", 1, csv("transfer"),
        ("benchmarks.learning.transfer:shipped_rows", BATCH), data=(BODIES, POLICIES, MOTOR),
    ),
    Result(
        "learning.optimal_control", "the fastest stroke by optimal control, replanned, beside gait and policy",
        "-m benchmarks.learning.optimal_control", 30, csv("optimal_control"),
        ("benchmarks.learning.optimal_control:Episode", "benchmarks.learning.optimal_control:planned"),
        data=(DEFAULT, GAIT, POLICIES),
    ),
    Result(
        "learning.optimal_control_feedback", "recorded commands of the policy, changed by little, without feedback",
        "-m benchmarks.learning.optimal_control --feedback", 0.1, csv("optimal_control_feedback"),
        ("benchmarks.learning.optimal_control:feedback_rows",), data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.muscles", "muscles at a limited rate beside first-order activation: swimming, reversals, transfer",
        "-m benchmarks.learning.muscles", 7, csv("muscles"), ("benchmarks.learning.muscles:run", BATCH),
    ),
    Result(
        "learning.turning", "radius and rate of turns beside those of living fish",
        "-m benchmarks.learning.turning", 1, csv("turning"),
        ("benchmarks.learning.turning:bend", "benchmarks.learning.turning:turn_of",
         "benchmarks.learning.turning:LIVING", BATCH), data=(DEFAULT, GAIT, MOTOR, POLICIES),
    ),
    Result(
        "learning.reversals", "failures in 10,000 abrupt reversals",
        "-m benchmarks.learning.turning --reversals", 5, csv("reversals"),
        ("benchmarks.learning.turning:reversals", BATCH), data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.reversal", "one turn begun before another is over: path, heading, strain",
        "-m benchmarks.learning.reversal", 0.5, csv("reversal") + images("reversal.svg"),
        ("benchmarks.learning.reversal:swum", "benchmarks.learning.reversal:COMMAND", BATCH),
        data=(DEFAULT, MOTOR, POLICIES),
    ),
    Result(
        "learning.waveforms", "the best periodic stroke beside the best sinusoidal gait",
        "-m benchmarks.learning.waveforms --seeds 1 --generations 100", 10, csv("waveforms"),
        ("benchmarks.learning.waveforms:speeds", "benchmarks.learning.waveforms:from_gait"), data=(DEFAULT, GAIT),
    ),
    Result(
        "learning.pictures", "the picture of the README, from the shipped policy",
        "-m benchmarks.learning.pictures", 0.5, images("swim.png"),
        ("benchmarks.learning.pictures:play", BATCH), data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.videos", "a short video of every task",
        "-m benchmarks.learning.pictures --videos", 2, tuple(f"docs/videos/{task}.mp4" for task in LEARNED),
        ("benchmarks.learning.pictures:play", BATCH), data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.film", "episodes of the shipped policy of LeftAfterRight as a page that turns in 3-D",
        "-m benchmarks.learning.pictures --film", 0.5, ("docs/videos/left_after_right.html",),
        ("benchmarks.learning.pictures:film", BATCH), data=(DEFAULT, POLICIES),
    ),
)  # fmt: skip

REGISTRY = {
    result.name: result for result in (*ACCURACY, *STABILITY, *SPEED, *FIDELITY, *OBJECTS, *CALIBRATION, *LEARNING)
}
