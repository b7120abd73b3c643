"""A task of one's own: swim round a circle, with all that an environment of the package has.

    python custom_task.py

A task is batched: row i of its arrays belongs to fish i. It may be copied into a package of one's own as it is; see
register_elsewhere/ for how a package registers an environment, and docs/extending.md for the protocol.
"""

import gymnasium as gym
import numpy as np

import fish_env
from fish_env.tasks import POSE_OPTIONS, Direction, Option, place

RADIUS = Option(0.5, 20.0, "radius of the circle, body lengths")
OFFSET_WEIGHT = 0.5  # body lengths of progress that a body length off the circle costs, a second


class CircleTask:
    """Swim along a circle, counter-clockwise seen from above, as fast as possible.

    Args:
        radius: of the circle, body lengths, a number or a pair (lowest, highest) to draw it from.

    Raises:
        ValueError: for a number out of range, saying what is allowed.
    """

    term_names = ("progress", "offset")
    episode_steps = 500
    directions = (
        Direction("tangent of the circle", "in the body frame", 1.0, 0.3),
        Direction("way to the circle", "body lengths, in the body frame", 20.0, 0.5),
    )

    def __init__(self, radius=(1.5, 3.0)):
        self.radius = RADIUS.checked_range("radius", radius)
        self.reset_options = {**POSE_OPTIONS, "radius": RADIUS}

    def prepare(self, tank, interval):
        """Make the arrays for the fish of a tank, environment steps `interval` seconds apart."""
        self.interval = interval
        self.wanted, self.angle, self.turned = np.zeros((3, tank.num_fish))

    def start(self, tank, i, generator, options):
        """Place fish i on its circle, whose centre is one radius to the left of it."""
        place(tank, i, generator, np.pi / 2, options)  # at the origin, heading along y
        self.wanted[i] = options.get("radius", generator.uniform(*self.radius))
        tank.position[i, :, 0] += self.wanted[i] * tank.fish.length
        self.angle[i] = self.turned[i] = 0.0

    def geometry(self, tank, pose):
        """Outward unit vectors (B,3), distances from the centre (B,) in body lengths, angles round it (B,) rad."""
        outward = pose.centre * (1.0, 1.0, 0.0)
        distance = np.linalg.norm(outward, axis=1)
        outward = outward / np.maximum(distance, 1e-9)[:, None]
        return outward, distance / tank.fish.length, np.arctan2(outward[:, 1], outward[:, 0])

    def vectors(self, tank, pose):
        """The tangent and the way to the circle, world vectors (B,2,3); each fish sees them in its own frame."""
        outward, distance, _ = self.geometry(tank, pose)
        tangent = np.stack([-outward[:, 1], outward[:, 0], np.zeros(tank.num_fish)], axis=1)
        return np.stack([tangent, (self.wanted - distance)[:, None] * outward], axis=1)

    def reward(self, tank, pose):
        """Arc swum, body lengths, less a penalty for being off the circle."""
        _, distance, angle = self.geometry(tank, pose)
        change = (angle - self.angle + np.pi) % (2.0 * np.pi) - np.pi
        self.angle, self.turned = angle, self.turned + change
        offset = np.abs(distance - self.wanted)
        return {"progress": change * self.wanted, "offset": -OFFSET_WEIGHT * self.interval * offset}

    def done(self, tank, pose):
        """(B,) never: episodes end by their time limit, or because the physics fails."""
        return np.zeros(tank.num_fish, dtype=bool)

    def metrics(self, tank, i, seconds):
        """Rounds swum, and the mean speed along the circle, body lengths per second."""
        speed = self.turned[i] * self.wanted[i] / seconds
        return {"rounds": float(self.turned[i] / (2.0 * np.pi)), "speed": float(speed)}


def main() -> None:
    """Register the task, and run an episode of a few fish with random actions."""
    fish_env.TASKS["circle"] = CircleTask
    gym.register(
        "Examples/Circle-v0",
        entry_point="fish_env.envs:FishEnv",
        vector_entry_point="fish_env.envs:FishVectorEnv",
        max_episode_steps=CircleTask.episode_steps,
        kwargs={"task": "circle"},
    )
    envs = gym.make_vec("Examples/Circle-v0", num_envs=4, radius=2.0, max_episode_steps=50)
    envs.action_space.seed(0)
    envs.reset(seed=0)
    over = np.zeros(4, dtype=bool)
    while not over.any():
        _, _, terminated, truncated, infos = envs.step(envs.action_space.sample())
        over = terminated | truncated
    print("speed along the circle, body lengths per second:", np.round(infos["speed"], 2))
    envs.close()


if __name__ == "__main__":
    main()
