"""Every published number: the command that makes it, what it shows, what it follows, and how long that takes.

One record a command. `follows` names the reference trajectories (`benchmarks/common/reference.py`) that the numbers
depend on: where one of them changes, they are stale.
"""

import shutil
from dataclasses import dataclass

RESULTS, IMAGES = "benchmarks/results/", "docs/images/"
GAIT = "fish_env/control/gait.json"
MOTOR = "fish_env/control/motor_controllers.json"
DEFAULT, EVERY_BODY, EVERY_TASK = ("body mass_spring",), ("body *",), ("body mass_spring", "task *")
FINEST_BODY = ("body tetrahedral",)
TRAINED = (*EVERY_TASK, "policy *")


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
        csv("work_precision", "work_precision_references", "work_precision.svg"),
        one_core=True,
    ),
    Result(
        "accuracy.held_out", "errors and prices of methods on 64 random scenes that nothing was fitted to, every body",
        "-m benchmarks.accuracy.held_out", 15,
        csv("held_out", "held_out.svg"),
        one_core=True, follows=(*EVERY_BODY, "water drag"),
    ),
    Result(
        "accuracy.finite_elements", "tetrahedra against beam theory; measures of strain in rotation and bending",
        "-m benchmarks.accuracy.finite_elements", 3,
        csv("elements_beam", "elements_strains") + images("elements.svg"),
        follows=("object *",),
    ),
)  # fmt: skip

STABILITY = (
    Result(
        "stability.survey", "step-size limits of every method, on every body and against stiffness",
        "-m benchmarks.stability.survey", 20, csv("stability_limits", "stability.svg"),
        one_core=True, follows=EVERY_BODY,
    ),
    Result(
        "stability.attack", "failures of every body under random, bang-bang, oscillating and searched commands; also "
        "tests/worst.npz", "-m benchmarks.stability.attack", 10, csv("attack"),
        follows=EVERY_BODY,
    ),
    Result(
        "stability.water", "failures and rolls, largest steps and the abrupt turn in water with inertia",
        "-m benchmarks.stability.water", 18, csv("water_stability", "water_limits", "water_turn"),
        one_core=True, follows=(*DEFAULT, "water *"),
    ),
)  # fmt: skip

WATER = (
    Result(
        "water.prices", "cost of a step in each level of water, over that with drag alone",
        "-m benchmarks.water.prices", 3, csv("water_prices"),
        one_core=True, follows=(*DEFAULT, "water *"),
    ),
    Result(
        "water.levels", "what each level of water gives scenes, beside living fish; also the tables of "
        "docs/choosing-the-water.md", "-m benchmarks.water.levels", 3, csv("water_levels", "water_levels.svg"),
        follows=(*EVERY_TASK, "water *"),
    ),
)  # fmt: skip

SPEED = (
    Result(
        "speed.throughput", "environment steps a second, memory, first use; a control interval of one fish and of many",
        "-m benchmarks.speed.throughput", 2, csv("throughput"),
        follows=("body mass_spring", "task swim"),
    ),
    Result(
        "speed.scaling", "cost against the number of fish and against the number of nodes (needs 3 GB)",
        "-m benchmarks.speed.scaling", 5, csv("scaling") + images("scaling.svg"),
        follows=EVERY_BODY,
    ),
    Result(
        "speed.peers", "MuJoCo on the same springs, and its environments (needs the extra [peers])",
        "-m benchmarks.speed.peers", 2, csv("speed/peers.csv"),
    ),
)  # fmt: skip

FIDELITY = (
    Result(
        "bodies.fidelity", "distance of every body to the finest, and its cost, in a scene of every task",
        "-m benchmarks.bodies.fidelity", 3, csv("fidelity") + images("fidelity.svg"),
        follows=EVERY_BODY,
    ),
)  # fmt: skip

OBJECTS = (
    Result(
        "objects.survey", "elastic objects dropped, thrown and dragged; largest steps and errors of Song's methods",
        "-m benchmarks.objects.survey", 3,
        csv("objects_scenes", "objects_methods", "objects_methods.svg"),
        follows=("object *",),
    ),
    Result(
        "objects.layers", "one layer and two on a floor, by the pressure of their gas",
        "-m benchmarks.objects.layers", 1, csv("objects_layers", "objects_layers.svg"),
        follows=("object *",),
    ),
    Result(
        "objects.solids", "solids of finite elements: errors, costs and largest steps of every method",
        "-m benchmarks.objects.solids", 2, csv("solids_methods", "solids_methods.svg"),
        follows=("object *",),
    ),
)  # fmt: skip

CALIBRATED = tuple(f"fish_env/bodies/{name}.json" for name in ("tetrahedral", "mass_spring", "planar", "two_layer"))
CALIBRATION = (
    Result(
        "calibration.living_fish", "every body and the best gait beside living fish: speed, sweep, sway of the midline",
        "-m benchmarks.calibration.living_fish", 6, csv("living_fish", "strength", "gait", "living_fish.svg"),
        follows=EVERY_BODY,
    ),
    Result(
        "calibration.fit_tests", "the fitted bodies on seeds and families of commands that they were not fitted to",
        "-m benchmarks.calibration.fit", 16, csv("fit_tests"),
        follows=EVERY_BODY,
    ),
    Result(
        "calibration.all", "bodies, gaits and motor controllers of a level of water, from the outline",
        "-m benchmarks.calibrate", 50, (*CALIBRATED, GAIT, MOTOR), by_name=True,
        follows=EVERY_BODY,
    ),
)  # fmt: skip

VALIDATION = (
    Result(
        "validation.sizes", "the fastest gait against the length of the fish, beside living fish",
        "-m benchmarks.validation.sizes", 1, csv("validation/sizes.csv", "validation/sizes.svg"),
    ),
    Result(
        "validation.lamprey", "the midline of a lamprey imposed on its body: speed and sweep",
        "-m benchmarks.validation.lamprey", 0.5, csv("validation/lamprey.csv", "validation/lamprey.svg"),
        follows=FINEST_BODY,
    ),
    Result(
        "validation.eel", "the midline of a computed eel imposed on its body: speed",
        "-m benchmarks.validation.eel", 0.3, csv("validation/eel.csv", "validation/eel.svg"),
        follows=FINEST_BODY,
    ),
    Result(
        "validation.torque", "the midlines of a mackerel and an eel imposed on their bodies: bending torque",
        "-m benchmarks.validation.torque", 1, csv("validation/torque.csv", "validation/torque.svg"),
        follows=FINEST_BODY,
    ),
    Result(
        "validation.robot", "the strokes of a robot imposed on its body: one number fitted to two trials, six told",
        "-m benchmarks.validation.robot", 1, csv("validation/robot.csv", "validation/robot.svg"),
        follows=FINEST_BODY,
    ),
    Result(
        "validation.coasting", "drag coefficient of straight bodies, beside coasting fish",
        "-m benchmarks.validation.coasting", 0.2, csv("validation/coasting.csv", "validation/coasting.svg"),
        follows=(*DEFAULT, *FINEST_BODY),
    ),
    Result(
        "validation.strength", "all muscles of one side: force, speed and power at the base of the tail, beside trout",
        "-m benchmarks.validation.strength", 0.3, csv("validation/strength.csv", "validation/strength.svg"),
        follows=(*DEFAULT, *FINEST_BODY),
    ),
)  # fmt: skip

LEARNING = (
    Result(
        "learning.all", "every task trained with all its seeds; reuses finished runs, replaces the shipped policies",
        "train.py all", 80,
        csv("learning/seeds.csv", "learning/methods.csv", "learning/curves.csv") + images("curves.svg"), by_name=True,
        follows=TRAINED,
    ),
    Result(
        "learning.integrators", "the shipped policies under every method and step",
        "train.py compare --integrators", 30,
        csv("integrators_policies", "integrators_policies.svg"),
        follows=TRAINED,
    ),
    Result(
        "learning.transfer", "the shipped policies and the motor controllers on every body",
        "-m benchmarks.learning.transfer", 1, csv("transfer"),
        follows=(*EVERY_BODY, "task *", "policy *"),
    ),
    Result(
        "learning.sensing", "what sensors cost, and what policies keep under held-out conditions; trains 18 policies",
        "-m benchmarks.learning.sensing", 35,
        csv("learning/sensing.csv", "learning/held_out.csv") + images("held_out.svg"), follows=TRAINED,
    ),
    Result(
        "learning.bound", "what optimal control reaches in turns, fast starts and swimming, beside shipped policies",
        "-m benchmarks.learning.bound", 40, csv("learning/bound.csv"),
        follows=TRAINED,
    ),
    Result(
        "learning.reversal", "one turn begun before another is over: path, heading, strain",
        "-m benchmarks.learning.reversal", 0.5, csv("reversal") + images("reversal.svg"),
        follows=TRAINED,
    ),
)  # fmt: skip

REGISTRY = {
    result.name: result
    for result in (*ACCURACY, *STABILITY, *WATER, *SPEED, *FIDELITY, *OBJECTS, *CALIBRATION, *VALIDATION, *LEARNING)
}
