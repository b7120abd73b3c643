"""The scenes of the laboratory, one click each."""

from collections.abc import Callable

from fish_env.lab.bench import Bench
from fish_env.lab.own import Own, Watch
from fish_env.lab.specimen import Entry
from fish_env.lab.stage import Stage
from fish_env.lab.swimmers import Swimmers

FOLLOW = "Move the pointer, or touch the water: the fish swims there. Drag turns the view, the wheel zooms."

SCENES: dict[str, Callable[[], Stage]] = {
    "follow me": lambda: Swimmers("A trained fish", FOLLOW),
    "left after right": lambda: Swimmers(
        "Left after right", "Press L: a left turn begins before the right one is over.", "policy for abrupt turns",
        follow=False,
    ),
    "fast start": lambda: Swimmers(
        "Fast start", "Press F: the fish is told to get away, from rest.", "policy for fast starts", follow=False
    ),
    "school of 64": lambda: Swimmers("A school of 64", "One call of one policy moves all. " + FOLLOW, num_fish=64),
    "obstacles": lambda: Swimmers(
        "Obstacles", "Press on the water in front of the fish: a stone stands there.", "policy for obstacles"
    ),
    "targets": lambda: Swimmers("Targets", "Press on the water: the target moves there.", "policy for targets"),
    "what the method does": lambda: Bench(
        [Entry("ring"), Entry("ring", "explicit_euler"), Entry("ring", "rk4")], "Three methods at one cost",
        "Pull at a ring: all are pulled alike, and the plot shows how far they are apart.", same_cost=True,
    ),
    "what the body does": lambda: Bench(
        [Entry("mass_spring"), Entry("planar"), Entry("two_layer")], "Three bodies of one fish",
        "The same muscles contract in all; the plot shows how far they are apart.", "gait",
    ),
    "what the water does": lambda: Bench(
        [Entry("mass_spring", water="reactive"), Entry("mass_spring", water="drag")], "Inertia of the water, and drag",
        "Two fish turn abruptly: the first in water with inertia, the second in drag alone.", "abrupt turns",
    ),
    "soft objects": lambda: Bench(
        [Entry("uniform sphere")], "Soft objects", "Pull at the sphere. T throws it. Choose others under Objects.",
    ),
    "finite elements": lambda: Bench(
        [Entry("beam")], "Finite elements", "Pull at the beam; Twist and Invert show what it comes back from.",
    ),
}  # fmt: skip


def make_scene(name: str, own: Own) -> Stage:
    """The stage of a scene, "your own" or a key of SCENES."""
    return SCENES[name]() if name in SCENES else Watch(own)
