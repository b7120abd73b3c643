"""The hand that drags a node: it moves evenly between the events of a pointer, some twenty of them a second."""

import numpy as np

LEAST = 0.01  # s, between two events that are told apart
LONGEST = 0.1  # s, over which the hand covers the way to where the pointer is


class Hand:
    """A point that begins at `point` (3,) m, follows a pointer at an even speed, and drags a node of an object."""

    def __init__(self, specimen: int, node: int, point):
        self.specimen, self.node = specimen, node
        self.point = np.array(point, dtype=float)
        self.start = self.point.copy()
        """Position before the last move, (3,) m."""
        self.velocity = np.zeros(3)
        self._goal, self._left, self._waited = self.point.copy(), 0.0, LONGEST

    def aim(self, point) -> None:
        """Go to where the pointer is now, (3,) m, in as much time as lay between its last two events."""
        self._goal = np.array(point, dtype=float)
        self._left = min(max(self._waited, LEAST), LONGEST)
        self._waited = 0.0
        self.velocity = (self._goal - self.point) / self._left

    def advance(self, seconds: float) -> None:
        """Move on; `velocity` is then the mean of that time, and zero once the pointer is reached."""
        self.start = self.point.copy()
        part = min(seconds / self._left, 1.0) if self._left > 0.0 else 1.0
        self.point += part * (self._goal - self.point)
        self._left = max(self._left - seconds, 0.0)
        self._waited += seconds
        self.velocity = (self.point - self.start) / seconds
