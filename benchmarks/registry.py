"""Every published number: the command that makes it, what it shows, what it follows, and how long that takes.

One record a command. `follows` names the reference trajectories (`benchmarks/common/reference.py`) that the numbers
depend on: where one of them changes, they are stale.
"""

import shutil
from dataclasses import dataclass

RESULTS = "benchmarks/results/"
DEFAULT, EVERY_BODY, EVERY_TASK = ("body mass_spring",), ("body *",), ("body mass_spring", "task *")
FINEST_BODY = ("body tetrahedral",)
TRAINED = ("task *", "policy *")
COMPARED = tuple(
    f"{what} {task}" for what in ("task", "policy") for task in ("swim", "turn", "left_after_right", "fast_start")
)


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
    follows: tuple[str, ...] = DEFAULT
    """Patterns of the names of reference trajectories."""
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


def published(name: str, shows: str, minutes: float, *files: str, command: str = "", **more) -> Result:
    """A record whose command is by default the module of its name, and whose files lie by default in results/."""
    outputs = tuple(file if file.startswith(("docs/", "fish_env/")) else RESULTS + file for file in files)
    return Result(name, shows, command or f"-m benchmarks.{name}", minutes, outputs, **more)


REGISTRY = {result.name: result for result in (
    published(
        "accuracy.work_precision", "error against computing time of every method on eight scenes",
        12, "work_precision.csv", "work_precision_references.csv", "work_precision.svg", one_core=True,
    ),
    published(
        "accuracy.held_out", "errors and costs of methods on 64 random held-out scenes, every body",
        15, "held_out.csv", "held_out.svg", one_core=True, follows=(*EVERY_BODY, "water drag"),
    ),
    published(
        "stability.claim", "share of failed fish over the step of six methods, and what the steps cost",
        1.5, "stability_claim.csv", "stability_claim.svg", "docs/images/claim.svg", one_core=True,
        follows=("body mass_spring", "body published", "water *"),
    ),
    published(
        "stability.survey", "step-size limits of every method, on every body and against stiffness",
        20, "stability_limits.csv", "stability.svg", one_core=True, follows=EVERY_BODY,
    ),
    published(
        "stability.stress",
        "failures of every body under random, bang-bang, oscillating and searched commands; also tests/worst.npz",
        10, "stress.csv", follows=EVERY_BODY,
    ),
    published(
        "stability.water", "failures and rolls, largest steps and the abrupt turn in water with inertia",
        18, "water_stability.csv", "water_limits.csv", "water_turn.csv", one_core=True, follows=(*DEFAULT, "water *"),
    ),
    published(
        "water.prices", "cost of a step in each level of water, over that with drag alone",
        3, "water_prices.csv", one_core=True, follows=(*DEFAULT, "water *"),
    ),
    published(
        "water.levels",
        "what each level of water gives scenes, beside living fish; also the tables of docs/choosing-the-water.md",
        3, "water_levels.csv", "water_levels.svg", follows=(*EVERY_TASK, "water *"),
    ),
    published(
        "speed.throughput", "environment steps a second, memory, first use; a control interval of one fish and of many",
        2, "throughput.csv", follows=("body mass_spring", "task swim"),
    ),
    published(
        "speed.scaling", "cost against the number of fish and against the number of nodes (needs 3 GB)",
        5, "scaling.csv", "docs/images/scaling.svg", follows=EVERY_BODY,
    ),
    published(
        "speed.peers", "MuJoCo on the same springs, environments of MuJoCo and dm_control (needs the extra [peers])",
        3, "speed/peers.csv",
    ),
    published(
        "bodies.fidelity", "distance of every body to the finest, and its cost, in a scene of every task",
        3, "fidelity.csv", "docs/images/fidelity.svg", follows=EVERY_BODY,
    ),
    published(
        "objects.survey",
        "elastic objects dropped, thrown and dragged; Song's methods; one layer and two; order and time of the matrix",
        5, "objects_scenes.csv", "objects_methods.csv", "objects_methods.svg", "objects_layers.csv",
        "objects_layers.svg", "objects_skyline.csv", "objects_costs.csv", "objects_texts.svg", follows=("object *",),
    ),
    published(
        "objects.solids",
        "solids of finite elements: errors, costs and largest steps of every method; elements against beam theory",
        5, "solids_methods.csv", "solids_methods.svg", "elements_beam.csv", "elements_strains.csv",
        "docs/images/elements.svg", follows=("object *",),
    ),
    published(
        "calibration.living_fish", "every body and the best gait beside living fish: speed, sweep, sway of the midline",
        6, "living_fish.csv", "strength.csv", "gait.csv", "living_fish.svg", follows=EVERY_BODY,
    ),
    published(
        "calibration.fit_tests", "the fitted bodies on seeds and families of commands that they were not fitted to",
        16, "fit_tests.csv", command="-m benchmarks.calibration.fit", follows=EVERY_BODY,
    ),
    published(
        "calibration.all", "bodies, gaits and motor controllers of a level of water, from the outline",
        50, "fish_env/bodies/tetrahedral.json", "fish_env/bodies/mass_spring.json", "fish_env/bodies/planar.json",
        "fish_env/bodies/two_layer.json", "fish_env/control/gait.json", "fish_env/control/motor_controllers.json",
        command="-m benchmarks.calibrate", by_name=True, follows=EVERY_BODY,
    ),
    published(
        "validation.sizes", "the fastest gait against the length of the fish, beside living fish",
        1, "validation/sizes.csv", "validation/sizes.svg",
    ),
    published(
        "validation.lamprey", "the midline of a lamprey imposed on its body: speed and sweep",
        0.5, "validation/lamprey.csv", "validation/lamprey.svg", follows=FINEST_BODY,
    ),
    published(
        "validation.eel", "the midline of a computed eel imposed on its body: speed",
        0.3, "validation/eel.csv", "validation/eel.svg", follows=FINEST_BODY,
    ),
    published(
        "validation.torque", "the midlines of a mackerel and an eel imposed on their bodies: bending torque",
        1, "validation/torque.csv", "validation/torque.svg", follows=FINEST_BODY,
    ),
    published(
        "validation.robot", "the strokes of a robot imposed on its body: one number fitted to two trials, six told",
        1, "validation/robot.csv", "validation/robot.svg", follows=FINEST_BODY,
    ),
    published(
        "validation.coasting", "drag coefficient of straight bodies, beside coasting fish",
        0.2, "validation/coasting.csv", "validation/coasting.svg", follows=(*DEFAULT, *FINEST_BODY),
    ),
    published(
        "validation.strength", "all muscles of one side: force, speed and power at the base of the tail, beside trout",
        0.3, "validation/strength.csv", "validation/strength.svg", follows=(*DEFAULT, *FINEST_BODY),
    ),
    published(
        "learning.all", "every task trained with all its seeds; reuses finished runs, replaces the shipped policies",
        120, "learning/seeds.csv", "learning/methods.csv", "learning/curves.csv", "docs/images/curves.svg",
        command="train.py all", by_name=True, follows=TRAINED,
    ),
    published(
        "learning.integrators", "the shipped policies under every method and step",
        30, "integrators_policies.csv", "integrators_policies.svg", command="train.py compare --integrators",
        follows=TRAINED,
    ),
    published(
        "learning.transfer", "the shipped policies and motor controllers on every body, and how the policies move",
        1.5, "transfer.csv", "learning/kinematics.csv", follows=(*EVERY_BODY, "task *", "policy *"),
    ),
    published(
        "learning.learners", "learners by the protocol of fish_env benchmark; trains 160 policies, keeps finished ones",
        240, "learning/learners.csv", "learning/learner_curves.csv", "docs/images/learners.svg", by_name=True,
        follows=COMPARED,
    ),
    published(
        "learning.weights", "Swim with other weights of effort and of a swaying head; trains 8 policies",
        20, "learning/weights.csv", follows=(*DEFAULT, "task swim"),
    ),
    published(
        "learning.bound", "what optimal control reaches in turns, fast starts and swimming, beside shipped policies",
        100, "learning/bound.csv",
        follows=COMPARED,
    ),
    published(
        "learning.reversal", "one turn begun before another is over: path, heading, strain; success where it is severe",
        3, "reversal.csv", "learning/severe.csv", "docs/images/reversal.svg", follows=COMPARED,
    ),
)}  # fmt: skip
