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
        ("benchmarks.accuracy.boundary:measure",),
    ),
    Result(
        "accuracy.strain_measures", "linear, corotational and quadratic strain in rotation, extension, bending; costs",
        "-m benchmarks.accuracy.strain_measures", 3,
        csv("strain_rotation", "strain_extension", "strain_bending", "strain_costs")
        + images("strain_measures.svg"),
        ("benchmarks.accuracy.strain_measures:rotated", "benchmarks.accuracy.strain_measures:drawn",
         "benchmarks.accuracy.strain_measures:bent", "benchmarks.accuracy.strain_measures:costs"), data=(),
    ),
    Result(
        "accuracy.finite_elements", "the finite-element body against beam theory; recovery, vibration",
        "-m benchmarks.accuracy.finite_elements", 5,
        csv(*(f"finite_elements_{name}" for name in ("beam", "bending", "shapes", "recovery", "vibration")))
        + images(*(f"finite_elements_{name}.svg" for name in ("beam", "bending", "vibration"))),
        ("benchmarks.accuracy.beam_bending:converging", "benchmarks.accuracy.beam_bending:bending",
         "benchmarks.accuracy.block_recovery:recovering", "benchmarks.accuracy.beam_vibration:vibrating"), data=(),
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
        "speed.throughput", "environment steps a second, memory, first use; kinds of kernels, methods and bodies",
        "-m benchmarks.speed.throughput", 6, csv("throughput", "kinds", "costs"),
        ("benchmarks.speed.throughput:environments", "benchmarks.speed.throughput:kinds",
         "benchmarks.speed.throughput:integrators", "benchmarks.speed.throughput:bodies", BATCH, SINGLE),
        data=(BODIES, GAIT),
    ),
    Result(
        "speed.scaling", "cost against the number of fish and against the number of nodes (needs 3 GB)",
        "-m benchmarks.speed.scaling", 5, csv("scaling") + images("scaling.svg"),
        ("benchmarks.speed.scaling:by_fish", "benchmarks.speed.scaling:by_nodes"), data=(BODIES, GAIT),
    ),
    Result(
        "speed.peers", "other simulators on the same springs, other environments (needs the extra [peers])",
        "-m benchmarks.speed.peers", 5, csv("speed/peers.csv"),
        ("benchmarks.speed.peers:spring_rows", "benchmarks.speed.environments:singles",
         "benchmarks.speed.environments:vectors", BATCH, SINGLE),
    ),
    Result(
        "speed.laboratory", "the laboratory: its start, and updates a second of every object (needs the extra "
        "[browser], Chromium)",
        "-m benchmarks.speed.laboratory", 6, csv("speed/laboratory.csv"),
        ("benchmarks.speed.laboratory:starts", "benchmarks.speed.laboratory:rates", "fish_env.lab.drawing:Drawing",
         "fish_env.lab.bench:Bench", "fish_env.lab.server:Laboratory"), data=(BODIES, GAIT),
    ),
    Result(
        "speed.cluster", "sampling and learning with one and more runners of Ray RLlib (needs the extra [cluster])",
        "-m benchmarks.speed.cluster", 2, csv("cluster"),
        ("benchmarks.speed.cluster:measure", "fish_env.envs.rllib:FishEnvRunner", BATCH),
        data=(DEFAULT, "examples/train_rllib.py"),
    ),
)  # fmt: skip

FIDELITY = (
    Result(
        "bodies.fidelity", "distance of every body to the finest, and its cost, in a scene of every task",
        "-m benchmarks.bodies.fidelity", 12, csv("fidelity") + images("fidelity.svg"),
        ("benchmarks.bodies.fidelity:run",), data=(BODIES, MOTOR),
    ),
    Result(
        "bodies.convergence", "levels 1 to 3 of the finest body against level 4, in scenes of two tasks",
        "-m benchmarks.bodies.convergence", 8, csv("convergence"), ("benchmarks.bodies.convergence:run",),
        data=(FINEST, DEFAULT, MOTOR),
    ),
    Result(
        "bodies.inertia", "mass, centre and inertia of every body beside its outline's continuum; roll in strong gaits",
        "-m benchmarks.bodies.inertia", 1, csv("inertia"), ("benchmarks.bodies.inertia:measure",), data=(BODIES,),
    ),
)  # fmt: skip

OBJECTS = (
    Result(
        "objects.survey", "elastic objects: scenes against their bars, Song's methods and estimates, roundness",
        "-m benchmarks.objects.survey", 5,
        csv(*(f"song_{name}" for name in ("estimates", "round", "scenes", "stable", "methods", "references")),
            "song_methods.svg", "song_estimates.svg"),
        ("benchmarks.objects.survey:scenes", "benchmarks.objects.shapes:estimates",
         "benchmarks.objects.shapes:roundness", "benchmarks.objects.methods:largest_stable",
         "benchmarks.objects.methods:sweep"), data=(),
    ),
    Result(
        "objects.argument", "objects of one layer and of two on a floor, by the pressure of their gas",
        "-m benchmarks.objects.argument", 2, csv("song_collapse", "song_collapse.svg"),
        ("benchmarks.objects.argument:collapse",), data=(),
    ),
    Result(
        "objects.inner", "the inner layer against the outer: natural frequencies beside simulated ones, an impact",
        "-m benchmarks.objects.inner", 1, csv("song_inner", "song_inner_impact", "song_inner.svg"),
        ("benchmarks.objects.inner:compared", "benchmarks.objects.inner:thrown"), data=(),
    ),
    Result(
        "objects.closed", "objects thrown in a closed room by every method; the energy of falls of rings that differ",
        "-m benchmarks.objects.closed", 2, csv("song_room", "song_falls"),
        ("benchmarks.objects.closed:survey", "benchmarks.objects.closed:fall"), data=(),
    ),
    Result(
        "objects.impact", "Song's methods through impact and drag, what their steps cost, the forces of spheres",
        "-m benchmarks.objects.impact", 15,
        csv("song_impact", "song_costs", "song_forces", "song_impact.svg", "song_forces.svg"),
        ("benchmarks.objects.impact:passages", "benchmarks.objects.impact:costs",
         "benchmarks.objects.impact:force_errors"), data=(),
    ),
    Result(
        "objects.detail", "what a level of detail of the uniform sphere costs, and from which distance on it is enough",
        "-m benchmarks.objects.detail", 0.2, csv("song_detail"), ("benchmarks.objects.detail:costs",), data=(),
    ),
    Result(
        "objects.hand", "a drag spring that has the hand's velocity, beside one whose hand jumps",
        "-m benchmarks.objects.hand", 0.3, csv("song_hand"), ("benchmarks.objects.hand:compare",), data=(),
    ),
    Result(
        "objects.parameters", "what each parameter of the ring does to a fall on the floor",
        "-m benchmarks.objects.parameters", 0.5, csv("song_parameters", "song_parameters.svg"),
        ("benchmarks.objects.parameters:fall",), data=(),
    ),
    Result(
        "objects.solids", "solids of finite elements: scenes, every method's error against cost, and where each fails",
        "-m benchmarks.objects.solids", 8,
        csv("solid_scenes", "solid_recovery", "solid_methods", "solid_stable", "solid_robust", "solid_references",
            "solid_methods.svg"),
        ("benchmarks.objects.solids:scenes", "benchmarks.objects.solids:longest_step", "benchmarks.objects.methods:one",
         "benchmarks.objects.methods:largest_stable"), data=(),
    ),
    Result(
        "objects.solid_pictures", "the strip of pictures of solids in docs/elastic-objects.md",
        "-m benchmarks.objects.solids --picture", 0.2, images("objects_solids.png"),
        ("benchmarks.objects.solids:picture",), data=(),
    ),
    Result(
        "objects.frames", "pictures a second of every elastic object, with drawing",
        "-m benchmarks.objects.survey --frames", 0.5, csv("song_frames"), ("benchmarks.objects.survey:frames",),
        data=(),
    ),
    Result(
        "objects.pictures", "the strips of pictures of docs/elastic-objects.md",
        "-m benchmarks.objects.survey --pictures", 0.5,
        images("objects_dropped.png", "objects_thrown.png", "objects_dragged.png"),
        ("benchmarks.objects.survey:pictures",), data=(),
    ),
)  # fmt: skip

COMMANDS = "benchmarks/calibration/task_commands.npz"
CALIBRATION = (
    Result(
        "calibration.check", "the best open-loop gait beside living fish",
        "-m benchmarks.calibration.check", 0.2, csv("gait"), ("benchmarks.calibration.check:check",),
        data=(DEFAULT, GAIT),
    ),
    Result(
        "calibration.living_fish", "every body beside a living trout: speed, sweep and the sway of the midline",
        "-m benchmarks.calibration.living_fish --check", 3, csv("living_fish", "living_fish.svg"),
        ("benchmarks.calibration.living_fish:check",), data=(BODIES,),
    ),
    Result(
        "calibration.fit_tests", "the fitted bodies on seeds and families of commands that they were not fitted to",
        "-m benchmarks.calibration.fit --test", 8, csv("fit_tests"), ("benchmarks.calibration.fit:tested",),
        data=(BODIES, MOTOR),
    ),
    Result(
        "calibration.finest", "material of the finest body, and three gaits, calibrated to living fish",
        "-m benchmarks.calibration.living_fish", 8, (FINEST,), ("benchmarks.calibration.living_fish:cost_at",),
        data=(), by_name=True,
    ),
    Result(
        "calibration.commands", "adds what the motor controllers command in each task to what bodies are fitted to",
        "-m benchmarks.calibration.commands", 1, (COMMANDS,), ("benchmarks.calibration.commands:main",),
        data=(DEFAULT, MOTOR), by_name=True,
    ),
    Result(
        "calibration.fit", "parameters of the other bodies, fitted in motion to the finest one",
        "-m benchmarks.calibration.fit", 40,
        tuple(f"fish_env/bodies/{name}.json" for name in ("mass_spring", "planar", "two_layer")),
        ("benchmarks.calibration.fit:search",), data=(FINEST, COMMANDS), by_name=True,
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
