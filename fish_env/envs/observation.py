"""Kernels that fill in what a fish observes, as `layout.py` lays it out: a row b of out (B,D) float32.

What lies beyond the bounds of the observation space is set to the bound. `starts` (P,) says where each part of the
`Layout` begins, `limits` (P,) its bound; the directions of the task come last.
"""

import math

import numpy as np

from fish_env.bodies import Fish
from fish_env.envs.layout import DIRECTIONS, POSITION, REST_LENGTH, VELOCITY, VERTICAL, Layout, pressure_faces, stations
from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Kind, Pack, Vectors, cross, dot, fma, sqrt, vec3
from fish_env.physics.forces.control import CURRENT, DRAG
from fish_env.physics.forces.water import square_of
from fish_env.physics.muscles import contraction
from fish_env.physics.pose import FORWARD, LEFT, UP
from fish_env.physics.records import World

BODY_VELOCITY, ANGULAR_VELOCITY, TILT, CURVATURE, MUSCLE_LENGTH, PRESSURE, SENSOR_DIRECTIONS = range(7)
"""The places of the parts of "sensors" in `Layout.parts`."""


@kernel
def observe_nodes(env, rows, b):
    """Fill row b with positions, velocities, rest lengths, the vertical and the task's vectors."""
    tank, pose, starts, limits, out = env.tank, env.pose, rows.starts, rows.limits, rows.observation
    axes, centre, scale = pose.axes, pose.centre[b], 1.0 / tank.length
    forward, left, up = axes[b, FORWARD], axes[b, LEFT], axes[b, UP]
    for i in range(tank.node.size):
        n = INDEX(tank.node[i])
        r = tank.position[b, n] + vec3(0.0, 0.0, tank.height[i]) - centre
        write(forward, left, up, scale * r, limits[POSITION], b, starts[POSITION] + 3 * i, out)
        write(forward, left, up, scale * tank.velocity[b, n], limits[VELOCITY], b, starts[VELOCITY] + 3 * i, out)
    for m in range(tank.muscles.size):
        contracted = contraction(tank, b, INDEX(tank.first_fibre[m]))
        out[b, INDEX(starts[REST_LENGTH] + m)] = clip(2.0 * contracted - 1.0, limits[REST_LENGTH])
    write(forward, left, up, vec3(0.0, 0.0, 1.0), limits[VERTICAL], b, starts[VERTICAL], out)
    for p in range(DIRECTIONS, starts.size):
        write(forward, left, up, env.episode.vectors[b, p - DIRECTIONS], limits[p], b, starts[p], out)


@kernel
def observe_sensors(env, rows, b):
    """Fill row b with what a robot could measure, and the task's vectors."""
    tank, pose, starts, limits, out = env.tank, env.pose, rows.starts, rows.limits, rows.observation
    axes, scale = pose.axes, 1.0 / tank.length
    forward, left, up = axes[b, FORWARD], axes[b, LEFT], axes[b, UP]
    write(forward, left, up, scale * pose.velocity[b], limits[BODY_VELOCITY], b, starts[BODY_VELOCITY], out)
    spin = angular_velocity(tank, forward, left, up, b)
    write(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0), spin, limits[ANGULAR_VELOCITY], b,
          starts[ANGULAR_VELOCITY], out)  # fmt: skip
    write(forward, left, up, vec3(0.0, 0.0, 1.0), limits[TILT], b, starts[TILT], out)
    write_curvature(tank, env.sensors, up, b, starts[CURVATURE], limits[CURVATURE], out)
    for m in range(tank.muscles.size):
        marks = env.sensors.muscles
        r = landmark(tank, b, marks[m, 1]) - landmark(tank, b, marks[m, 0])
        out[b, INDEX(starts[MUSCLE_LENGTH] + m)] = clip(
            sqrt(dot(r, r)) / env.sensors.natural[m] - 1.0, limits[MUSCLE_LENGTH]
        )
    for k in range(env.sensors.faces.shape[0]):
        out[b, INDEX(starts[PRESSURE] + k)] = clip(pressure_on(tank, env.sensors, b, k), limits[PRESSURE])
    for p in range(SENSOR_DIRECTIONS, starts.size):
        write(forward, left, up, env.episode.vectors[b, p - SENSOR_DIRECTIONS], limits[p], b, starts[p], out)


def make_sensors(fish: Fish, world: World) -> Pack:
    """What `observe_sensors` reads: landmarks by station, ends of muscles, faces, and the law of the water."""
    order, first = stations(fish)
    ends = fish.points(fish.body.position)[np.array(fish.landmarks.muscles)]  # (M,2,3)
    return Pack(
        "sensors", order=order, first=first, muscles=np.array(fish.landmarks.muscles), faces=pressure_faces(fish),
        natural=np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
        linear=float(world.linear), quadratic=float(world.quadratic),
        oblique=float(world.oblique),
        current=Vectors(np.array([world.current], dtype=float), Kind(1)),
    )  # fmt: skip


def make_rows(layout: Layout, observation: np.ndarray) -> Pack:
    """Where the kernels write: the starts and limits of the parts of the present, and the rows."""
    starts, limits = np.array([(part.start, part.limit) for part in layout.parts[: layout.num_present]]).T
    return Pack("rows", starts=starts.astype(np.int64), limits=np.array(limits), observation=observation)


@kernel
def landmark(tank, b, i):
    """Position of landmark i of fish b, m."""
    return tank.position[b, INDEX(tank.node[INDEX(i)])] + vec3(0.0, 0.0, tank.height[INDEX(i)])


@kernel
def angular_velocity(tank, forward, left, up, b):
    """Rate of rotation of fish b about its axes, rad/s: the derivative of what `pose.measure` computes."""
    x, v = tank.position, tank.velocity
    ahead = ahead_rate = aside = aside_rate = vec3(0.0, 0.0, 0.0)
    for i in range(tank.mass.size):
        ahead = fma(tank.line[i], x[b, i], ahead)
        ahead_rate = fma(tank.line[i], v[b, i], ahead_rate)
    for i in range(tank.left.size):
        p, q = INDEX(tank.left[i]), INDEX(tank.right[i])
        aside += x[b, p] - x[b, q]
        aside_rate += v[b, p] - v[b, q]
    length, width = max(dot(ahead, forward), TINY), max(dot(aside, left), TINY)
    pitching, yawing = -dot(ahead_rate, up) / length, dot(ahead_rate, left) / length
    rolling = (dot(aside_rate, up) + dot(aside, forward) * pitching) / width
    return vec3(rolling, pitching, yawing)


TINY = 1e-300  # m: an axis that has no length does not rotate


@kernel
def write_curvature(tank, sensors, up, b, start, limit, out):
    """Write the curvature of the midline at every station but the first and the last."""
    before, here = vec3(0.0, 0.0, 0.0), midpoint(tank, sensors, b, 0)
    way = vec3(0.0, 0.0, 0.0)
    for s in range(1, sensors.first.size - 1):
        before, here = here, midpoint(tank, sensors, b, s)
        last, way = way, here - before
        if s > 1:
            bend = math.atan2(-dot(cross(last, way), up), dot(last, way))
            arc = 0.5 * (sqrt(dot(last, last)) + sqrt(dot(way, way)))
            out[b, INDEX(start + s - 2)] = clip(bend * tank.length / max(arc, TINY), limit)


@kernel
def midpoint(tank, sensors, b, s):
    """Mean position of the landmarks of station s of fish b, m."""
    total, lo, hi = vec3(0.0, 0.0, 0.0), sensors.first[s], sensors.first[s + 1]
    for i in range(lo, hi):
        total += landmark(tank, b, sensors.order[i])
    return total / (hi - lo)


@kernel
def pressure_on(tank, sensors, b, k):
    """Pressure of the water on a face that moves outward through it, Pa; zero on one that does not."""
    # It is the law of `fish_env.physics.forces.water` between the landmarks, without the calibrated factor of a face.
    faces, v, node = sensors.faces, tank.velocity, tank.node
    p, q, r, s = faces[k, 0], faces[k, 1], faces[k, 2], faces[k, 3]
    factors = tank.variation
    current = sensors.current[0] + vec3(factors[b, CURRENT], factors[b, CURRENT + 1], factors[b, CURRENT + 2])
    total = v[b, INDEX(node[p])] + v[b, INDEX(node[q])] + v[b, INDEX(node[r])] + v[b, INDEX(node[s])]
    w = 0.25 * total - current
    a = cross(landmark(tank, b, r) - landmark(tank, b, p), landmark(tank, b, s) - landmark(tank, b, q))
    outward = dot(a, w) / max(sqrt(dot(a, a)), TINY)
    speed = sqrt(square_of(sensors.oblique, outward, w))
    linear = sensors.linear / tank.length_variation[b]
    return factors[b, DRAG] * (linear + sensors.quadratic * speed) * max(outward, 0.0)


@kernel
def write(forward, left, up, vector, limit, b, place, out):
    """Put a vector into out[b, place:place + 3], by its parts along the axes, no further from zero than limit."""
    out[b, INDEX(place)] = clip(dot(forward, vector), limit)
    out[b, INDEX(place + 1)] = clip(dot(left, vector), limit)
    out[b, INDEX(place + 2)] = clip(dot(up, vector), limit)


@kernel
def clip(value, limit):
    """value, no further from zero than limit."""
    return min(max(value, -limit), limit)
