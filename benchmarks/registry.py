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
        "accuracy.work_precision", "error against computing time of every method on eight scenes",
        "-m benchmarks.accuracy.work_precision", 12,
        csv("work_precision", "work_precision_references", "work_precision_time.svg", "work_precision_turn.svg"),
        ("benchmarks.accuracy.work_precision:sweep", "benchmarks.accuracy.work_precision:reference_of"), one_core=True,
    ),
    Result(
        "accuracy.refinement", "steps a control interval and intervals that are repeated: error, cost and stability",
        "-m benchmarks.accuracy.refinement", 3, csv("refinement", "refinement_stable"),
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
)  # fmt: skip

STABILITY = (
    Result(
        "stability.survey", "step-size limits of every method, on every body and against stiffness",
        "-m benchmarks.stability.survey", 9, csv("stability", "stability_limits", "stability.svg", "stability_map.svg"),
        ("benchmarks.stability.runs:cases", "benchmarks.stability.runs:reference", "benchmarks.stability.runs:sweep",
         "benchmarks.stability.linear:linear_limit"), data=(BODIES,), one_core=True,
    ),
    Result(
        "stability.attack", "failures of every body under random, bang-bang, oscillating and searched commands; also "
        "tests/worst.npz", "-m benchmarks.stability.attack", 10, csv("attack"),
        ("benchmarks.stability.attack:mistreat", "benchmarks.stability.attack_search:search",
         "benchmarks.stability.mistreatment:families"), data=(BODIES,),
    ),
    Result(
        "stability.reliability", "odd arguments, many processes, and the checkers of other packages: tests passed",
        "-m benchmarks.stability.reliability", 20, csv("reliability"),
        ("benchmarks.stability.reliability:outcome", "benchmarks.stability.reliability:TRIALS", BATCH, SINGLE),
        data=("tests/fuzzing.py", "tests/test_fuzz_*.py"),
    ),
    Result(
        "stability.repeatability", "the same bits in other processes, checkouts and numbers of threads",
        "-m benchmarks.stability.repeatability", 10, csv("repeatability"),
        ("benchmarks.stability.repeatability:compare", BATCH, SINGLE),
    ),
    Result(
        "stability.versions", "built, installed and tested on other versions of Python and of the dependencies",
        "-m benchmarks.stability.versions", 60, csv("versions"),
        ("benchmarks.stability.versions:trial", BATCH), data=("pyproject.toml", "constraints.txt"), by_name=True,
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
        csv("learning/seeds.csv", "learning/methods.csv", "learning/curves.csv") + images("curves.svg"),
        ("agents.train:train", "agents.results:publish_task", BATCH), data=(DEFAULT, GAIT, MOTOR), by_name=True,
    ),
    Result(
        "learning.integrators", "the shipped policies under every method and step",
        "train.py compare --integrators", 20,
        csv("integrators_policies", "integrators_policies.svg"),
        ("agents.integrators:replay", "agents.integrators:settings", "agents.integrators:differences", BATCH),
        data=(DEFAULT, POLICIES),
    ),
    Result(
        "learning.algorithms", "PPO, SAC and TD3 on Swim-v0 for the same wall time",
        "-m benchmarks.learning.algorithms --seconds 150", 12, csv("algorithms_swim"),
        ("benchmarks.learning.algorithms:METHODS", "benchmarks.learning.algorithms:Looks", BATCH),
    ),
    Result(
        "learning.transfer", "the shipped policies and the motor controllers on every body",
        "-m benchmarks.learning.transfer", 1, csv("transfer"),
        ("benchmarks.learning.transfer:shipped_rows", BATCH), data=(BODIES, POLICIES, MOTOR),
    ),
    Result(
        "learning.reversal", "one turn begun before another is over: path, heading, strain",
        "-m benchmarks.learning.reversal", 0.5, csv("reversal") + images("reversal.svg"),
        ("benchmarks.learning.reversal:swum", "benchmarks.learning.reversal:COMMAND", BATCH),
        data=(DEFAULT, MOTOR, POLICIES),
    ),
    Result(
        "learning.pictures", "a picture of a swimming fish, a video of every task, a film in 3-D",
        "-m benchmarks.learning.pictures", 3,
        (*images("swim.png"), *(f"docs/videos/{task}.mp4" for task in LEARNED), "docs/videos/left_after_right.html"),
        ("benchmarks.learning.pictures:play", "benchmarks.learning.pictures:film", BATCH), data=(DEFAULT, POLICIES),
        by_name=True,
    ),
)  # fmt: skip

REGISTRY = {
    result.name: result for result in (*ACCURACY, *STABILITY, *SPEED, *FIDELITY, *OBJECTS, *CALIBRATION, *LEARNING)
}
