"""The task: swim along a commanded heading that may be any, behind the fish too."""

import math

from fish_env.tasks import SwimTask


class AnyHeadingTask(SwimTask):
    """`Swim`, begun at any angle to the commanded heading.

    Args:
        heading_error: the largest angle between the commanded heading and the fish's own at the start, rad.
        speed: commanded speed, body lengths per second, or a pair to draw it from; None: as fast as possible.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    def __init__(self, heading_error: float = math.pi, speed: float | tuple[float, float] | None = None):
        super().__init__(heading_error, speed)

    def metrics(self, tank, i: int, seconds: float) -> dict[str, float]:
        """Those of `Swim`, and whether the fish has made more way along the heading than across it."""
        found = super().metrics(tank, i, seconds)
        return found | {"turned": float(found["speed"] > found["sideways"])}
