"""The tasks ask what they say they ask, measure what they say they measure, and refuse what cannot be asked."""

import itertools
import math

import numpy as np
import pytest
from gliding import GlidingVectorEnv, each_task, each_way
from scipy.spatial.transform import Rotation

import fish_env
from fish_env.envs import VARIATIONS, FishVectorEnv
from fish_env.envs.variation import vary
from fish_env.kernels.simd import vec3
from fish_env.physics.pose import Pose, packed_pose
from fish_env.tasks import avoid, rewards, start, turn, turns


def begun(task="swim", num_envs=1, seed=0, options=None, make=GlidingVectorEnv, **keywords):
    """A batch of fish after a reset, which glide, or are moved by the kernels of one fish."""
    env = make(num_envs, task=task, lanes="xyz", **keywords)
    env.reset(seed=seed, options=options)
    return env


def measured(env):
    """The named terms of what the task does in one environment step."""
    return {name: term.copy() for name, term in env.task.reward(env.tank, env._pose).items()}


def spun(env, yaw, place=0.0):
    """The terms of an environment step in which all fish are straight, at rest, turned to yaw (B,), at a place (3,)."""
    body, tank = env.tank.fish.body, env.tank
    rest = body.position - body.mass @ body.position / body.mass.sum()
    tank.position[:] = [rest @ start.rotation(angle, 0.0, 0.0).T + place for angle in yaw]
    tank.velocity[:] = 0.0
    env._measure()
    return measured(env)


# Start


def test_start_pose():
    """Yaw, pitch and roll of the options are those of the fish; without them the yaw is spread over the circle."""
    env = begun(num_envs=200)
    headings = np.arctan2(env._pose.axes[:, 0, 1], env._pose.axes[:, 0, 0])
    assert np.abs(np.mean(np.exp(1j * headings))) < 0.2
    env.reset(seed=0, options={"yaw": 1.0, "pitch": 0.3, "roll": 0.2})
    forward, left, up = env._pose.axes[0]
    np.testing.assert_allclose(forward, np.cos(0.3) * start.heading_vector(1.0) + [0, 0, np.sin(0.3)], atol=1e-12)
    assert left[2] == pytest.approx(np.sin(0.2) * np.cos(0.3), abs=1e-12)  # its left side is up, its right one down
    np.testing.assert_allclose(np.cross(forward, left), up, atol=1e-12)
    wanted = Rotation.from_euler("ZYX", [1.0, -0.3, 0.2]).as_matrix()
    np.testing.assert_allclose(start.rotation(1.0, 0.3, 0.2), wanted, atol=1e-12)


@each_task
def test_starts_differ(task):
    """Two seeds start differently, and so do an episode and the next."""
    env = GlidingVectorEnv(2, task=task)
    one = env.reset(seed=3)[0]
    assert (one[0] != one[1]).any() and (env.reset()[0] != one).any()


# Commanded turns


def test_turn_is_commanded_when_it_should_be():
    """The heading changes by the angle at the time; the latency is that of 90 % of it; the overshoot is a mean."""
    env = begun("turn", options={"yaw": 0.5, "turn": 1.0, "wait": 0.1})
    place, heading = np.zeros(3), [env.task.vectors(env.tank, env._pose)[0, 0].copy()]
    for k in range(60):
        yaw = 0.5 + min(max(k - 5, 0) * 0.07, 1.2)
        place = place + 0.02 * env.tank.fish.length * start.heading_vector(yaw)
        terms = spun(env, [yaw], place)
        heading.append(env.task.vectors(env.tank, env._pose)[0, 0].copy())
    assert terms["alignment"][0] == pytest.approx(-0.2 * 2 / np.pi * turns.ALIGNMENT_WEIGHT.default * 0.02, rel=1e-9)
    np.testing.assert_allclose(heading[:5], [start.heading_vector(0.5)] * 5, atol=1e-12)
    np.testing.assert_allclose(heading[5:], [start.heading_vector(1.5)] * 56, atol=1e-12)
    found = env.task.metrics(env.tank, 0, 1.2)
    # commanded at step 4 (0.1 s), pointing at 0.5; it turns from step 6 on, 0.91 rad are made at step 18
    wanted = {
        "latency": 14 * 0.02, "overshoot": math.degrees(0.2), "turning_rate": math.degrees(0.07 / 0.02),
        "radius": 14 * 0.02 / 0.91, "heading_error": math.degrees(0.2), "turn": math.degrees(1.0),
        "speed": np.linalg.norm(place) / env.tank.fish.length / 1.2,
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-6)
    assert not found["success"] and not found["settled"]
    for _ in range(30):
        spun(env, [1.55])
    assert env.task.metrics(env.tank, 0, 1.6)["success"]


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_reversal_comes_in_the_middle(side):
    """The second turn is commanded after the given part of the first, from where the fish points, to the other side."""
    options = {"yaw": 3.0, "first": 1.0, "second": 1.4, "side": side, "part": 0.5, "wait": 0.04}
    env = begun("left_after_right", seed=1, options=options)
    course, step = env.task.course, -1
    while course.stage[0] < 2:
        step += 1
        spun(env, [3.0 + side * 0.03 * step])
    # commanded at step 1, pointing at 3.03: the first turn is 0.97 from there, and its half 0.485
    assert step == 1 + math.ceil(0.485 / 0.03)
    facing = 3.0 + side * 0.03 * step
    assert rewards.wrap_angle(course.heading[0] - (facing - side * 1.4)) == pytest.approx(0.0, abs=1e-9)
    assert env.task.metrics(env.tank, 0, 1.0)["turn"] == pytest.approx(-side * math.degrees(1.4))


def test_severity_widens_the_turns():
    """Angles grow with the severity, up to half a circle; left and right first are equally frequent."""
    for severity in (1.0, 2.0):
        course = begun("left_after_right", 400, severity=severity).task.course
        angles = course.angle[:, :2]
        assert np.abs(angles).min() >= severity * np.pi / 4 and np.abs(angles).max() <= severity * np.pi / 2
        assert (angles[:, 0] * angles[:, 1] < 0).all()
        assert abs(np.sign(angles[:, 0]).mean()) < 0.15
        assert 0.4 < np.isfinite(course.part[:, 1]).mean() < 0.6


@pytest.mark.parametrize("task", ["turn", "fast_start"])
def test_single_turns_are_drawn_from_their_range(task):
    """Angles to both sides, equally often, within the range of the task."""
    angle = begun(task, 400).task.course.angle[:, 0]
    low, high = begun(task).task.angle
    assert low <= np.abs(angle).min() < low + 0.1 and high - 0.1 < np.abs(angle).max() <= high
    assert abs(np.sign(angle).mean()) < 0.15


def test_follow_agrees_with_its_twin():
    """The compiled course is followed as an obvious program follows it, on random motions."""
    rng, interval, window = np.random.default_rng(0), 0.02, 13
    for _ in range(6):
        reversals, seed = int(rng.integers(1, 3)), int(rng.integers(1000))
        env = begun("left_after_right", seed=seed, reversals=reversals)
        task, angle, wait, part = env.task, *(getattr(env.task.course, n)[0].copy() for n in ("angle", "wait", "part"))
        yaw, heading = float(task.course.yaw[0]), float(task.course.heading[0])
        facing, history, stage, since, origin, latency = yaw, [], 0, 0.0, yaw, None
        drift = rng.normal(0, 6)
        for _ in range(200):
            target_rate = 4.0 * rewards.wrap_angle(heading - yaw) + drift * rng.normal()
            yaw = facing = facing + target_rate * interval
            history.append(facing)
            since += interval
            wanted = angle[stage - 1] if stage else 0.0
            left = abs(rewards.wrap_angle(heading - yaw))
            if stage and latency is None and ((facing - origin) / wanted >= 0.9 or left <= 0.1 * abs(wanted)):
                latency = since
            if stage < task.course.count[0]:
                reached = stage > 0 and (facing - origin) / wanted >= part[stage]
                if reached or since >= wait[stage] - 1e-9:
                    base = heading if stage == 0 else yaw
                    heading = base + angle[stage]
                    angle[stage] += rewards.wrap_angle(base - yaw)
                    stage, since, origin, latency = stage + 1, 0.0, facing, None
            spun(env, [yaw])
        assert task.course.stage[0] == stage
        assert rewards.wrap_angle(task.course.heading[0] - heading) == pytest.approx(0.0, abs=1e-9)
        assert task.course.since[0] == pytest.approx(since)
        beat = np.ones(window) / window
        mean = np.convolve(np.convolve(history, beat, "valid"), beat, "valid")[-1]
        found = task.metrics(env.tank, 0, 4.0)
        assert found["heading_error"] == pytest.approx(abs(math.degrees(rewards.wrap_angle(heading - mean))), abs=1e-6)
        assert found["latency"] == pytest.approx(math.nan if latency is None else latency, nan_ok=True)


def test_alignment_is_linear_in_the_angle():
    """0 along the heading, -1 across, -2 away, and a degree costs the same everywhere."""
    axes = np.zeros((7, 3, 3))
    axes[:, 0] = [start.heading_vector(a) for a in np.linspace(0, np.pi, 7)]
    pose = packed_pose(Pose(np.zeros((7, 3)), np.zeros((7, 3)), axes))
    found = [rewards.alignment(pose, vec3(*start.heading_vector(0.0)), b) for b in range(7)]  # as Python
    np.testing.assert_allclose(found, np.linspace(0, -2, 7), atol=1e-7)


@pytest.mark.parametrize(
    ("task", "weight", "options"),
    [
        ("turn", turn.OVERSHOOT_WEIGHT.default, {"turn": -0.8}),
        ("left_after_right", turns.OVERSHOOT_WEIGHT.default, {"first": 0.8, "side": -1, "dwell": 2.0}),
    ],
)
def test_turning_too_far_costs(task, weight, options):
    """The overshoot term is the mean heading beyond the turn, nothing before that, and at most that of half a turn."""
    env = begun(task, 3, options={"yaw": 0.5, "wait": 0.02} | options)
    paid = [spun(env, [0.5 - min(0.03 * k, 1.0), 0.5 - min(0.03 * k, 0.7), 0.5 - 0.3 * k]) for k in range(60)]
    too_far, right, spinning = np.array([terms["overshoot"] for terms in paid]).T
    assert (too_far[:20] == 0).all() and (right == 0).all()
    assert too_far[-1] == pytest.approx(-weight * 0.02 * 2 / np.pi * 0.2, rel=1e-6)
    assert spinning[-1] == spinning.min() == pytest.approx(-2.0 * weight * 0.02, rel=1e-12)


def test_a_turn_before_is_no_overshoot():
    """A turn back that ends exactly on its command costs nothing, although the mean is still over the turn before."""
    options = {"yaw": 0.0, "first": math.pi / 2, "second": math.pi / 4, "part": 0.8, "side": 1, "wait": 0.1}
    env = begun("left_after_right", severity=0.5, options=options)
    yaw, course, paid = 0.0, env.task.course, 0.0
    for _ in range(100):
        yaw += float(np.clip(rewards.wrap_angle(course.heading[0] - yaw), -0.1, 0.1))
        paid += spun(env, [yaw])["overshoot"][0]
    found = env.task.metrics(env.tank, 0, 2.0)
    assert found["success"] and course.stage[0] == 2
    assert (paid, found["overshoot"]) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("task", ["swim", "turn", "left_after_right"])
def test_a_swaying_head_costs(task):
    """The weight times the nose's speed to the side of the fish, over that of its centre, and the interval."""
    env = begun(task, 6, sway_weight=0.8)
    tank, fish, yaw = env.tank, env.tank.fish, np.linspace(-3.0, 3.0, 6)
    spun(env, yaw)
    tank.velocity[:] = np.random.default_rng(3).normal(size=tank.velocity.shape)
    env._measure()
    apart = tank.velocity[:, fish.nose] - fish.body.mass @ tank.velocity / fish.body.mass.sum()
    aside = apart[:, 1] * np.cos(yaw) - apart[:, 0] * np.sin(yaw)
    wanted = -0.8 * np.abs(aside) / fish.length * env.control_interval
    np.testing.assert_allclose(measured(env)["sway"], wanted, rtol=1e-9)


def test_swaying_is_no_overshoot():
    """A fish that sways about the commanded heading holds it, whatever its beat: less than 3 % of the sway is left."""
    beats, sway = np.array([3.3, 3.9, 4.6]), math.radians(8.0)
    env = begun("turn", 3, options={"yaw": 0.0, "turn": 1.0, "wait": 0.02})
    for k in range(200):
        spun(env, min(0.05 * k, 1.0) + sway * np.sin(2 * np.pi * beats * 0.02 * k))
    for found in (env.task.metrics(env.tank, i, 4.0) for i in range(3)):
        assert found["overshoot"] < 0.03 * 8.0
        assert found["heading_error"] < 0.03 * 8.0


# Fast start


@pytest.mark.parametrize("interval", [0.02, 0.04])
def test_fast_start_is_measured_as_it_is_defined(interval):
    """Metrics and reward are those that numpy finds from the positions and velocities of the nodes, at each step."""
    env = GlidingVectorEnv(2, task="fast_start", control_interval=interval, max_episode_steps=100)
    body, line, length = env.tank.fish.body, env.tank.fish.line, env.tank.fish.length
    turn, told = (2.0, -1.2), (0, math.ceil(0.1 / interval))  # environment steps until the command
    for i in range(2):
        options = {"yaw": 3.0, "turn": turn[i], "wait": told[i] * interval, "speed": 1.5}
        env.reset(seed=i, options={**options, "reset_mask": np.arange(2) == i})
    seen = [[env.tank.position.copy(), env.tank.velocity.copy(), env.task.vectors(env.tank, env._pose)[:, 0]]]
    for action in np.random.default_rng(0).uniform(-1, 1, (50, 2, 12)):
        env.step(action)
        seen.append([env.tank.position.copy(), env.tank.velocity.copy(), env.task.vectors(env.tank, env._pose)[:, 0]])
    position, velocity, commands = map(np.array, zip(*seen, strict=True))
    for i, k in enumerate(told):
        centre, speed = (body.mass @ each[:, i] / body.mass.sum() for each in (position, velocity))
        yaw = np.unwrap(np.arctan2(*(line @ position[:, i])[:, 1::-1].T))
        way = heading_after(3.0 + turn[i], commands[:, i], k)
        after = {seconds: k + int(seconds / interval + 0.5) for seconds in (0.04, 0.1, 0.2, 0.3, 0.8)}
        along = (centre - centre[k]) @ way / length
        over = after[0.04] - k
        change = [np.linalg.norm(speed[j + over] - speed[j]) for j in range(k, after[0.3] - over + 1)]
        found = env.episode_info(i)
        angles = np.degrees(np.sign(turn[i]) * (yaw - yaw[k]))
        ahead = position[:, i, env.tank.fish.nose] - centre
        snout = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
        snouts = np.degrees(np.sign(turn[i]) * (snout - snout[k]))
        wanted = {f"angle_{1000 * t:.0f}ms": angles[after[t]] for t in (0.1, 0.2, 0.3)} | {
            **{f"snout_{1000 * t:.0f}ms": snouts[after[t]] for t in (0.1, 0.2, 0.3)},
            "distance_200ms": np.linalg.norm(np.diff(centre[k : after[0.2] + 1], axis=0), axis=1).sum() / length,
            "speed_200ms": np.linalg.norm(speed[after[0.2]]) / length,
            "peak_acceleration": max(change) / (over * interval), "escape_distance": along[-1],
            "success": along[k : after[0.8] + 1].max() >= 0.5,
        }  # fmt: skip
        assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-6, abs=1e-6)
        assert found["terms"]["progress"] == pytest.approx(along[-1], rel=1e-9)
        assert np.linalg.norm(speed[0]) == pytest.approx(1.5 * length, rel=0.01)


def heading_after(angle, commands, step):
    """The direction of an angle, after a check that the fish is told it from a step on, and nothing before."""
    way = start.heading_vector(angle)
    assert (commands[:step] == 0.0).all()
    np.testing.assert_allclose(commands[step:], np.broadcast_to(way, commands[step:].shape), atol=1e-9)
    return way


# Strain and energy


def test_strain_against_its_definition():
    """Largest strain over all springs at the ends of steps, as numpy finds it."""
    env, rng = begun("turn"), np.random.default_rng(0)
    tank, springs, strain = env.tank, env.tank.fish.body.springs, 0.0
    for _ in range(30):
        x = tank.fish.body.position + rng.normal(0.0, 0.002, tank.fish.body.position.shape)
        tank.position[0] = x
        env._measure()
        measured(env)
        length = np.linalg.norm(x[springs.nodes[:, 0]] - x[springs.nodes[:, 1]], axis=1)
        strain = max(strain, np.abs(length / springs.rest_length - 1).max())
    assert env.task.metrics(env.tank, 0, 0.6)["peak_strain"] == pytest.approx(strain, rel=1e-12)


@each_task
def test_energy_of_an_episode(task):
    """Work, power and cost of transport are those of the tank's work, the fish's own mass, the time and the path."""
    env = begun(task, 2, options={"mass": 1.5})
    assert env.episode_info(0)["work"] == 0.0 and math.isnan(env.episode_info(0)["cost_of_transport"])
    mass, path = 1.5 * env.tank.fish.body.mass.sum(), [env._pose.centre.copy()]
    for action in np.random.default_rng(0).uniform(-1, 1, (30, 2, 12)):
        env.step(action)
        path.append(env._pose.centre.copy())
    travelled = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0)
    for i, work in enumerate(env.tank.work / mass):
        found = env.episode_info(i)
        assert work > 0
        wanted = {"work": work, "power": work / found["seconds"], "cost_of_transport": work / travelled[i]}
        assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-9)


# Target


def test_targets_follow_one_another():
    """A target that the nose reaches pays the bonus and the next appears; one that waits too long is missed."""
    env = begun("target", patience=1.0, reach_bonus=3.0, options={"yaw": 0.0, "distance": 1.5, "bearing": 0.4})
    task, length = env.task, env.tank.fish.length
    direction, way = task.vectors(env.tank, env._pose)[0]
    np.testing.assert_allclose([direction, way / 1.5], [start.heading_vector(0.4)] * 2, atol=1e-9)
    goal, nose, total = task._target[0].copy(), env.tank.position[0, 0].copy(), 0.0
    first = np.linalg.norm(goal - nose) / length
    while not task.reached[0]:
        env.tank.position[0] += 0.1 * (goal - nose)
        env._measure()
        terms = measured(env)
        total += terms["progress"][0]
    assert total == pytest.approx(first - np.linalg.norm(goal - env.tank.position[0, 0]) / length, rel=1e-9)
    assert terms["reached"][0] == 3.0
    assert (task._target[0] != goal).any()
    for _ in range(50):
        measured(env)
    assert task.missed[0] == 1
    found = task.metrics(env.tank, 0, 2.0)
    assert found["targets"] == 1 and found["success"] == 0.5 and found["time_per_target"] == 2.0
    task.reached[0] = 3
    assert task.metrics(env.tank, 0, 6.0) == {"targets": 3, "missed": 1, "success": 0.75, "time_per_target": 2.0}


@pytest.mark.parametrize(("dimensions", "least", "most"), [(2, 0.0, 1e-6), (3, 1.0, 2 * np.sin(0.6) + 1e-6)])
def test_targets_in_three_dimensions(dimensions, least, most):
    """Planar targets are level; in three dimensions they lie above and below, within the elevation."""
    env = begun("target", 300, dimensions=dimensions, elevation=0.6, distance=2.0)
    way = env.task.vectors(env.tank, env._pose)[:, 1]
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 2.0, rtol=1e-6)
    assert least <= np.abs(way[:, 2]).max() <= most


# Avoid


def test_obstacles_are_drawn_from_their_ranges():
    """Times, gaps and drifts of 400 obstacles fill their ranges; turns are commanded 0.1 to 0.4 s before."""
    task = begun("avoid", 400).task
    drift, appears, turned = task._drift, task._appears, task.course.wait[:, 0]
    moving = drift[drift != 0.0]
    for found, (low, high) in ((np.abs(moving), task.drift), (appears, task.wait), (task._gap, task.gap)):
        assert low <= found.min() < low + 0.1 * (high - low) and high - 0.1 * (high - low) < found.max() <= high
    assert 0.4 < (moving > 0.0).mean() < 0.6
    lead = (appears - turned)[turned > 0.0]
    assert avoid.LEAD[0] - 1e-12 <= lead.min() and lead.max() <= avoid.LEAD[1] + 1e-12


@pytest.mark.parametrize("drift", [0.0, 0.8])
def test_obstacle_appears_ahead_and_moves(drift):
    """The sphere stands the given gap ahead of the nose when it is due; a sweeping one comes from the side."""
    options = {"yaw": 0.0, "turn": 0.0, "wait": 0.1, "gap": 1.0, "aside": 0.0, "drift": drift}
    env = begun("avoid", options=options)
    task, length = env.task, env.tank.fish.length
    assert not task.vectors(env.tank, env._pose)[0, 1:].any()
    for _ in range(5):
        spun(env, [0.0])
    ahead = 1.0 + task.radius
    expected = env.tank.position[0, 0] + length * np.array([ahead, -drift * ahead / avoid.CRUISE, 0.0])
    np.testing.assert_allclose(task.obstacle[0], expected, atol=1e-9)
    way = (expected - env._pose.centre[0]) / length
    distance = np.linalg.norm(way)
    nearness, velocity = task.vectors(env.tank, env._pose)[0, 1:]
    np.testing.assert_allclose(nearness, way / distance / (1 + distance - task.radius), atol=1e-9)
    np.testing.assert_allclose(velocity, [0.0, drift, 0.0], atol=1e-12)
    for _ in range(10):
        measured(env)
    np.testing.assert_allclose(task.obstacle[0], expected + np.array([0.0, drift * 0.2 * length, 0.0]), atol=1e-9)


def test_touching_ends_the_episode():
    """A fish that swims straight into the sphere pays the penalty and is done; one far away is not."""
    options = {"yaw": 0.0, "turn": 0.0, "wait": 0.0, "gap": 0.5, "aside": 0.0, "drift": 0.0}
    env = begun("avoid", 2, options=options, touch_penalty=7.0)
    spun(env, [0.0, 0.0])
    for way, touched in ((0.45, False), (0.1, True)):
        env.tank.position[0, :, 0] += way * env.tank.fish.length
        env._measure()
        assert measured(env)["touch"].tolist() == [-7.0 * touched, 0.0]
        assert env.task.done(None, None).tolist() == [touched, False]
    one, other = (env.task.metrics(env.tank, i, 1.0) for i in range(2))
    assert not one["avoided"] and one["clearance"] < 0 < other["clearance"] and other["avoided"]
    assert not other["passed"] and not other["success"]


# All tasks


@each_task
def test_terms_add_up(task):
    """The rewards of an episode add up to its named terms; the metrics are numbers."""
    env, total = begun(task, seed=2), 0.0
    for action in np.random.default_rng(0).uniform(-1, 1, (60, 1, 12)):
        total += env.step(action)[1][0]
    info = env.episode_info(0)
    assert sum(info["terms"].values()) == pytest.approx(total, rel=1e-9)
    assert set(info["terms"]) == {*env.task.term_names, "failure"}
    assert all(isinstance(value, float | int) for name, value in info.items() if name not in ("terms", "failure"))


@each_task
def test_weights_scale_their_terms(task):
    """Twice every weight is exactly twice its term and no other, from the next step if it is set while running."""
    weights = {name: 2.0 * option.default for name, option in fish_env.TASKS[task].weights.items()}
    plain, doubled = begun(task, 2), begun(task, 2, **weights)
    changed = begun(task, 2, **dict.fromkeys(weights, 0.0))
    scaled = {term for term in plain.task.term_names for name in weights if term.startswith(name.split("_")[0])}
    assert len(scaled) == len(weights)
    actions = np.random.default_rng(0).uniform(-1, 1, (6, 2, 12))
    for step, action in enumerate(actions):
        if step == 3:
            for name, value in weights.items():
                changed.set_attr(name, value)
                assert changed.get_attr(name) == (value, value)
        for env in (plain, doubled, changed):
            env.step(action)
        found = (env._arrays["terms"] for env in (plain, doubled, changed))
        for name, one, two, three in zip(plain._names, *found, strict=True):
            np.testing.assert_array_equal(two, one * (2.0 if name in scaled else 1.0))
            np.testing.assert_array_equal(three, two * (step >= 3 or name not in scaled))
    assert (doubled._arrays["totals"] != plain._arrays["totals"]).any()


@each_way
def test_mirrored_fish_is_paid_the_same(task, make):
    """A mirrored start, command and action give the mirrored motion and the same reward."""
    env = make(2, task=task)
    fish = env.tank.fish
    options = {"yaw": 0.0, "turn": 0.9, "wait": 0.1, "heading": 0.3, "side": 1, "dwell": 0.1, "first": 0.9,
               "second": 1.2, "bearing": 0.5, "distance": 2.0, "gap": 0.5, "aside": 0.3, "drift": 0.5}  # fmt: skip
    signed = {"turn", "heading", "side", "bearing", "aside", "drift"}
    given = {name: value for name, value in options.items() if name in env.reset_options}
    for i, sign in enumerate((1.0, -1.0)):
        turned = {name: sign * value if name in signed else value for name, value in given.items()}
        env.reset(seed=0, options={**turned, "reset_mask": np.arange(2) == i})
    env.tank.velocity[:] = 0.0
    env.tank.position[1] = (env.tank.position[0] * [1, -1, 1])[fish.mirror]
    env._measure()
    for action in np.random.default_rng(0).uniform(-1, 1, (40, 12)):
        _, reward, *_ = env.step(np.stack([action, action[fish.mirrored_muscles]]))
        assert reward[0] == pytest.approx(reward[1], rel=1e-6, abs=1e-9)
    np.testing.assert_allclose(env.tank.position[0], env.tank.position[1][fish.mirror] * [1, -1, 1], atol=1e-9)


def test_commanded_speed_pays_for_keeping_it():
    """The reward is greatest at the commanded speed, and the commanded velocity is what the fish sees."""
    env = begun(speed=(0.5, 2.0), options={"yaw": 0.0, "heading": 0.0, "speed": 1.5})
    np.testing.assert_allclose(env.task.vectors(env.tank, env._pose)[0, 0], [1.5, 0.0, 0.0])
    env.task._before[:] = env._pose.centre
    paid = []
    for speed in (1.0, 1.5, 2.0):
        env._pose.centre[:, 0] += speed * 0.02 * env.tank.fish.length
        paid.append(measured(env)["progress"][0])
    np.testing.assert_allclose(paid, [0.02, 0.03, 0.02], atol=1e-12)
    found = env.task.metrics(env.tank, 0, 0.06)
    assert found["speed_error"] == pytest.approx(0.0, abs=1e-9) and found["commanded_speed"] == 1.5


# Variation


def test_variation_reaches_the_physics():
    """Drawn or given, stiffness, mass, drag and current are those the fish is moved with; else it is as made."""
    both = {"stiffness": (0.5, 2.0), "mass": (0.5, 2.0)}
    one, other = (begun(variation=ranges).tank for ranges in (both, dict(reversed(both.items()))))
    np.testing.assert_array_equal(one.variation, other.variation)  # the order of the keys does not matter
    env = begun(num_envs=3, variation={"stiffness": (0.5, 2.0), "current": 0.4}, make=FishVectorEnv)
    rows, length = env.tank.variation.copy(), env.tank.fish.length
    assert len(set(rows[:, 0])) == 3 and (rows[:, 0] >= 0.5).all() and (rows[:, 0] <= 2.0).all()
    np.testing.assert_allclose(np.linalg.norm(rows[:, 3:], axis=1), 0.4 * length)
    options = {"stiffness": 1.5, "mass": 2.0, "drag": 0.5, "current": 1.0, "current_heading": np.pi / 2}
    env.reset(seed=0, options=options)
    np.testing.assert_allclose(env.tank.variation, [[1.5, 2.0, 0.5, 0.0, length, 0.0]] * 3, atol=1e-12)
    for _ in range(10):
        env.step(-np.ones((3, 12)))
    assert (env._pose.velocity[:, 1] > 0.1 * length).all()  # it is carried along
    plain = begun(options={"mass": 2.0})
    plain.reset(seed=0)
    np.testing.assert_array_equal(plain.tank.variation, [[1, 1, 1, 0, 0, 0]])


def test_the_default_method_survives_every_variation():
    """In every corner of what may be varied, random actions break no fish."""
    names = ("stiffness", "mass", "drag", "current")
    corners = list(itertools.product(*(VARIATIONS[name][:2] for name in names)))
    env = begun(num_envs=2 * len(corners), make=FishVectorEnv)
    for i in range(env.num_envs):
        vary(env.tank, i, dict(zip(names, corners[i % len(corners)], strict=True)))
    rng = np.random.default_rng(0)
    for _ in range(100):
        env.step(rng.choice([-1.0, 0.0, 1.0], (env.num_envs, 12)))
    assert env.tank.alive.all(), env.tank.failure[~env.tank.alive]


@pytest.mark.parametrize(
    ("task", "wrong"),
    [
        ("turn", {"turn": 4.0, "stiffness": 0.0, "current": 9.0, "mass": "2"}),
        ("left_after_right", {"first": 0.0, "part": 1.5}),
        ("avoid", {"gap": 0.0}),
    ],
)
def test_impossible_commands_are_refused(task, wrong):
    """Commands out of range are refused with the range, and nothing moves."""
    env = begun(task)
    before = env.tank.get_state()
    for name, value in (wrong | {"yaw": 7.0, "wait": -1.0}).items():
        with pytest.raises(ValueError, match=rf"options\['{name}'\] is .*; give a number from"):
            env.reset(options={name: value})
    for name, value in env.tank.get_state().items():
        np.testing.assert_array_equal(value, before[name])
