"""Swim-v0: swim along a commanded heading."""

import numpy as np

from fish_env.tasks import rewards

EFFORT_WEIGHT = 0.1  # body lengths a second, the price of moving every muscle at its fastest all the time
START_NOISE = 0.01  # body lengths a second: standard deviation of the node velocities at the start


class SwimTask:
    """Cover as many body lengths along the commanded heading as the episode allows.

    Args:
        heading_error: the largest angle between the commanded heading and the fish's own at the start, rad; drawn
            uniformly to either side.

    Raises:
        ValueError: unless 0 <= heading_error <= pi.
    """

    num_vectors = 1
    vector_names = ("commanded heading",)
    vector_limit = 1.0
    term_names = ("progress", "effort")
    reset_options = {
        "yaw": "the fish's heading at the start, rad",
        "heading": "the commanded heading, rad",
    }

    def __init__(self, heading_error: float = 0.5):
        if not (np.isscalar(heading_error) and 0 <= heading_error <= np.pi):
            raise ValueError(f"heading_error is {heading_error!r}; give an angle from 0 to pi, in radians")
        self.heading_error = float(heading_error)
        self._heading = np.zeros((0, 3))

    def start(self, tank, fish, generators, options):
        """Place each fish at the origin with a random yaw, almost at rest, and draw its commanded heading."""
        if len(self._heading) != tank.num_fish:
            self._heading = np.zeros((tank.num_fish, 3))
            self._before = np.zeros((tank.num_fish, 3))
            self._start = np.zeros((tank.num_fish, 3))
        body, length = tank.fish.body, tank.fish.length
        centre = body.mass @ body.position / body.mass.sum()
        for i, generator in zip(fish, generators, strict=True):
            yaw, error = generator.uniform(-1.0, 1.0, 2) * (np.pi, self.heading_error)
            noise = generator.normal(0.0, START_NOISE * length, body.position.shape)
            yaw = options.get("yaw", yaw)
            heading = options.get("heading", yaw + error)
            c, s = np.cos(yaw), np.sin(yaw)
            tank.position[i] = (body.position - centre) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            tank.velocity[i] = noise
            self._heading[i] = np.cos(heading), np.sin(heading), 0.0
            self._before[i] = self._start[i] = body.mass @ tank.position[i] / body.mass.sum()

    def vectors(self, tank, pose):
        """The commanded heading, a unit vector, (B,1,3)."""
        return self._heading[:, None]

    def reward(self, tank, pose, interval):
        """Progress along the heading, body lengths, less the effort of moving the muscles."""
        progress = rewards.progress(pose.centre, self._before, self._heading, tank.fish.length)  # (19)
        self._before[:] = pose.centre
        return {"progress": progress, "effort": tank.effort * (-EFFORT_WEIGHT * interval)}  # (20)

    def done(self, tank, pose):
        """Never: the episode ends at the time limit."""
        return np.zeros(tank.num_fish, dtype=bool)

    def metrics(self, tank, fish, seconds):
        """Mean speed along the commanded heading and across it, body lengths per second."""
        travel = (self._before[fish] - self._start[fish]) / tank.fish.length / seconds
        along = float(travel @ self._heading[fish])
        return {"speed": along, "sideways": float(np.linalg.norm(travel - along * self._heading[fish]))}
