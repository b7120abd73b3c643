"""Start of every task: the fish at the origin, almost at rest, in a random or a given pose."""

import numpy as np

from fish_env.physics.fish import Fish
from fish_env.physics.tank import Tank
from fish_env.tasks.options import Option

NOISE = 0.01  # body lengths a second: standard deviation of the node velocities at the start

POSE_OPTIONS = {
    "yaw": Option(-np.pi, np.pi, "the fish's heading at the start, rad"),
    "pitch": Option(-np.pi / 2, np.pi / 2, "how far its nose points up at the start, rad"),
    "roll": Option(-np.pi, np.pi, "how far it lies over to its right at the start, rad"),
}


def place(tank: Tank, i, generator, yaw, options) -> np.ndarray:
    """Put fish i, freshly reset, at the origin, turned to `yaw` unless an option says else."""
    # Returns its centre of mass (3,), m. Raises ValueError if a flat fish is to pitch or roll.
    check_pose(tank.fish, options)
    body = tank.fish.body
    noise = generator.normal(0.0, NOISE * tank.fish.length, body.position.shape) * (body.inverse_mass > 0.0)
    pitch, roll = options.get("pitch", 0.0), options.get("roll", 0.0)
    turn = rotation(options.get("yaw", yaw), pitch, roll)
    tank.position[i] = (body.position - body.mass @ body.position / body.mass.sum()) @ turn.T
    tank.velocity[i] = noise
    return body.mass @ tank.position[i] / body.mass.sum()


def check_pose(fish: Fish, options) -> None:
    """Raise ValueError if a flat fish is to pitch or roll: a number in `options`, or a pair (lowest, highest)."""
    if fish.flat and np.any([options[name] for name in ("pitch", "roll") if name in options]):
        raise ValueError(f"the flat {fish.name!r} fish can neither pitch nor roll; take another body")


def rotation(yaw, pitch, roll) -> np.ndarray:
    """The rotation (3,3) that rolls, then pitches, then yaws."""
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return about_z @ about_y @ about_x


def heading_vector(angle) -> np.ndarray:
    """The horizontal unit vector (3,) in a direction, rad."""
    return np.array([np.cos(angle), np.sin(angle), 0.0])
