"""What a fish observes: the named parts of its observation, sensors, noise, delays, history and goals.

Most of it is measured of fish that glide or stand anywhere, without compilation; `test_compiled` compares kernels.
"""

import copy
import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gliding import ID, GlidingVectorEnv, each_task
from gymnasium.utils.env_checker import check_env
from moving import tiered

import fish_env
from fish_env import BODIES
from fish_env.control import evaluate, record, replay
from fish_env.envs import Layout
from fish_env.envs.step import compile_measure_and_observe
from fish_env.envs.variation import FACTORS
from fish_env.tasks import Direction
from fish_env.tasks.target import GoalTask, TargetTask

SWIM, STUB, TARGET = "FishEnv/Swim-v0", "FishEnv/Stub-v0", ID["target"]
ALL = {
    "observation_noise": {"velocity": 0.1, "position": 0.01}, "action_noise": 0.1, "observation_delay": (0, 3),
    "action_delay": (0, 2), "history": 2, "privileged": True,
    "variation": {"strength": (0.8, 1.1), "contraction_time": (0.8, 1.2), "length": (0.9, 1.1)},
}  # fmt: skip
ACTIONS = np.random.default_rng(1).uniform(-1.0, 1.0, (12, 16, 12)).astype(np.float32)


def run(num_envs, id=STUB, actions=ACTIONS, steps=12, **keywords):
    """Observations (T+1,B,D) of a batch under these actions, and the environment."""
    env = gym.make_vec(id, num_envs, **keywords).unwrapped
    found = [env.reset(seed=0)[0]]
    for action in actions[:steps]:
        found.append(env.step(action[:num_envs])[0])
    return np.array(found), env


def shake(env):
    """Move every node of the fish a little, and give it a velocity of its own; what is observed then."""
    rng, shape = np.random.default_rng(7), env.tank.position.shape
    env.tank.position[:] += 0.02 * env.tank.fish.length * rng.normal(size=shape)
    env.tank.velocity[:] = env.tank.fish.length * rng.normal(size=shape)
    env._measure()
    return env.observe()


@pytest.mark.parametrize("id", tiered((STUB, SWIM), (STUB,)))
def test_fish_alone_and_among_others(id):
    """With everything on, a fish has the same bits alone, in a batch, in any lanes and threads."""
    batch, _ = run(8, id, lanes=8, threads=2, **ALL)
    four, _ = run(4, id, threads=1, **ALL)
    np.testing.assert_array_equal(batch[:, :4], four)
    for i in (0, 3):
        env = gym.make(id, **ALL)
        alone = [env.reset(seed=i)[0], *(env.step(action[i])[0] for action in ACTIONS)]
        np.testing.assert_array_equal(alone, four[:, i])


@each_task
@pytest.mark.parametrize("observation", ["nodes", "sensors"])
def test_compiled(task, observation):
    """What a task and an observation are compiled to makes of ten steps what they make as Python."""
    options = {"task": task, "observation": observation} | ({} if observation == "sensors" else ALL)
    plain, compiled = (GlidingVectorEnv(2, **options) for _ in range(2))
    compiled._measure_and_observe = compile_measure_and_observe(compiled._kernels, compiled._sensing)
    for one, other in zip(plain.reset(seed=0), compiled.reset(seed=0), strict=True):
        if not isinstance(one, dict):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)
    for action in ACTIONS[:10, :2]:
        for one, other in zip(plain.step(action)[:4], compiled.step(action)[:4], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(plain._arrays["totals"], compiled._arrays["totals"], rtol=1e-9, atol=1e-9)


def test_action_arrives_k_steps_later():
    """Under a delay of k steps the fish moves, to the bit, as one that first relaxes for k steps."""
    relaxed = np.full((1, 16, 12), -1.0, dtype=np.float32)
    for k in (0, 1, 4):
        late, env = run(3, action_delay=k)
        _, plain = run(3, actions=np.concatenate([*[relaxed] * k, ACTIONS]), steps=len(ACTIONS))
        np.testing.assert_array_equal(env.tank.position, plain.tank.position)
    assert late.shape == (13, 3, 156)


def test_observation_delay_and_history():
    """A late observation is that of d steps before; a history has the observations and actions of before, by name."""
    plain, _ = run(3)
    late, _ = run(3, observation_delay=2)
    np.testing.assert_array_equal(late, plain[np.maximum(np.arange(13) - 2, 0)])
    found, env = run(3, history=2, observation_delay=1)
    layout = env.layout
    np.testing.assert_array_equal(found[..., : layout.present], plain[np.maximum(np.arange(13) - 1, 0)])
    for t in (0, 1, 2, 9):
        for k in (1, 2):
            for name in ("position", "rest length", "commanded heading"):
                seen = layout.read(found[t], f"past {k}: {name}")
                np.testing.assert_array_equal(seen, layout.read(found[max(t - k, 0)], name), err_msg=f"{t} {k} {name}")
            given = ACTIONS[t - k, :3] if t >= k else -np.ones((3, 12))
            np.testing.assert_array_equal(layout.read(found[t], f"past {k}: action"), np.float32(given))
    drawn = gym.make_vec(STUB, 64, observation_delay=(1, 3)).unwrapped
    drawn.reset(seed=0)
    assert set(drawn._memory["delay"][:, 0].tolist()) == {1, 2, 3}


def test_noise():
    """Noise is normal, of the deviation asked for, on its own parts only, new in each step, episode and fish."""
    plain, _ = run(16)
    found, env = run(16, observation_noise={"velocity": 0.2, "vertical": 0.01})
    noise = (found - plain)[..., env.layout["velocity"].slice]
    assert noise.std() == pytest.approx(0.2, rel=0.03) and abs(noise.mean()) < 0.01
    assert (np.abs(noise) < 0.2).mean() == pytest.approx(0.683, abs=0.02)
    rows = noise.reshape(-1, noise.shape[-1])
    together = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(together).max() < 0.6  # 69 numbers: 0.12 each
    assert len({row.tobytes() for row in rows}) == len(rows)
    np.testing.assert_array_equal(found[..., env.layout["position"].slice], plain[..., env.layout["position"].slice])
    assert np.abs(found[..., env.layout["vertical"].slice]).max() <= 1.0
    again = env.reset(seed=0)[0]
    np.testing.assert_array_equal(again, found[0])
    assert not np.array_equal(env.reset()[0][:, env.layout["vertical"].slice], again[:, env.layout["vertical"].slice])
    still = np.zeros((2, 16, 12), dtype=np.float32)
    _, noisy = run(16, actions=still, steps=2, action_noise=0.1)
    _, quiet = run(16, actions=still, steps=2)
    assert np.array_equal(quiet._contraction, np.full((16, 12), 0.5))
    assert (noisy._contraction - 0.5).std() == pytest.approx(0.05, rel=0.15)


def test_task_is_the_same_with_and_without_noise():
    """Delays and the noise's key are drawn last, so that an episode of a seed is the same one."""
    for keywords in ({"action_noise": 0.1}, {"action_delay": (0, 2)}):
        env = gym.make_vec(TARGET, 2, **keywords).unwrapped
        env.reset(seed=3)
        plain = gym.make_vec(TARGET, 2).unwrapped
        plain.reset(seed=3)
        np.testing.assert_array_equal(env.task._target, plain.task._target)


@pytest.mark.parametrize(
    ("body", "law"), [("mass_spring", "quadratic"), ("mass_spring", "cross_flow"), ("planar", "quadratic")]
)
def test_sensors(body, law):
    """Every sensor agrees with its definition, calculated by numpy from positions and velocities."""
    _, env = run(
        2, observation="sensors", body=body, water={"law": law}, variation={"drag": 1.5, "current": 0.3}, steps=0
    )
    found = shake(env)
    layout, tank, fish = env.layout, env.tank, env.tank.fish
    seen = {part.name: layout.read(found, part.name)[1].astype(float) for part in layout}
    x, v, mass = tank.position[1], tank.velocity[1], fish.body.mass / fish.body.mass.sum()

    def axes(x):
        forward = fish.line @ x / np.linalg.norm(fish.line @ x)
        aside = (x[fish.left] - x[fish.right]).sum(axis=0)
        left = aside - aside @ forward * forward
        left /= np.linalg.norm(left)
        return np.array([forward, left, np.cross(forward, left)])

    frame, h = axes(x), 1e-6
    np.testing.assert_allclose(seen["body velocity"], frame @ (mass @ v) / fish.length, atol=1e-6)
    spin = (axes(x + h * v) - axes(x - h * v)) / (2 * h) @ frame.T  # d(axis)/dt along the axes
    np.testing.assert_allclose(seen["angular velocity"], [spin[1, 2], spin[2, 0], spin[0, 1]], rtol=1e-4, atol=1e-5)
    points, marks = fish.points(x), fish.landmarks
    along = np.round(fish.points(fish.body.position)[:, 0], 6)
    middle = np.array([points[along == each].mean(axis=0) for each in np.unique(along)[::-1]])
    way = np.diff(middle, axis=0)
    size = np.linalg.norm(way, axis=1)
    bend = np.arctan2(-np.cross(way[:-1], way[1:]) @ frame[2], (way[:-1] * way[1:]).sum(axis=1))
    np.testing.assert_allclose(seen["curvature"], bend / (0.5 * (size[1:] + size[:-1]) / fish.length), rtol=1e-5)
    ends, at_rest = points[marks.muscles], fish.points(fish.body.position)[marks.muscles]
    long, natural = (np.linalg.norm(each[:, 1] - each[:, 0], axis=1) for each in (ends, at_rest))
    stretch = long / natural - 1.0
    np.testing.assert_allclose(seen["muscle length"], stretch, atol=1e-6)
    flow = v[marks.node] - (tank.world.current + tank.variation[1, 3:])
    for k, pressure in enumerate(seen["pressure"]):
        ring = [each for each in marks.faces if {*marks.muscles[fish.segments == k // 2].ravel()} >= set(each)]
        (face,) = [each for each in ring if (fish.points(fish.body.position)[each, 1] > 0).all() == (k % 2 == 0)
                   and len({*np.sign(fish.points(fish.body.position)[each, 1])}) == 1]  # fmt: skip
        p, q, r, s = points[face]
        normal = np.cross(r - p, s - q)
        wind = flow[face].mean(axis=0)
        out = max(0.0, wind @ normal / np.linalg.norm(normal))
        speed = np.sqrt(out**2 + tank.world.oblique * (wind @ wind - out**2))
        expected = tank.variation[1, 2] * (tank.world.linear + tank.world.quadratic * speed) * out
        assert pressure == pytest.approx(expected, rel=1e-5, abs=1e-9)
    assert (seen["pressure"] > 0).any() and seen["vertical"] @ seen["vertical"] == pytest.approx(1.0, abs=1e-6)


def test_mirror_image():
    """The observation of a mirrored fish, sensors and history, is the reflection that the layout states."""
    _, env = run(2, observation="sensors", history=1, muscle_groups="pairs", actions=ACTIONS[..., :6])
    shake(env)
    tank, fish = env.tank, env.tank.fish
    tank.state.x[1] = tank.state.x[0, fish.mirror] * (1.0, -1.0, 1.0)
    tank.state.v[1] = tank.state.v[0, fish.mirror] * (1.0, -1.0, 1.0)
    env.task._heading[1] = env.task._heading[0] * (1.0, -1.0, 1.0)
    env._measure()
    obs = env.observe()[:, : env.layout.present]
    place, sign = (each[: env.layout.present] for each in env.layout.reflection())
    np.testing.assert_allclose(obs[1], obs[0, place] * sign, rtol=1e-4, atol=1e-5)
    past = env.layout["past 1: action"]
    assert (env.layout.reflection()[0][past.slice] - past.start).tolist() == [1, 0, 3, 2, 5, 4]


def test_privileged():
    """The privileged observation is the exact one of all nodes, with the fish's factors, always."""
    plain, _ = run(2, variation={"mass": (0.8, 1.2)})
    env = gym.make_vec(STUB, 2, observation="sensors", observation_delay=2, privileged=True,
                       variation={"mass": (0.8, 1.2)}, max_episode_steps=5,
                       autoreset_mode="SameStep").unwrapped  # fmt: skip
    infos = [env.reset(seed=0)[1], *(env.step(action[:2])[4] for action in ACTIONS[:5])]
    for t in range(5):
        np.testing.assert_array_equal(infos[t]["privileged"][:, :156], plain[t])
        mass = infos[0]["variation"]["mass"].astype(np.float32)
        np.testing.assert_array_equal(infos[t]["privileged"][:, 157], mass)
    np.testing.assert_array_equal(infos[5]["final_info"]["privileged"][0][:156], plain[5, 0])
    assert infos[5]["variation"]["mass"][0] != infos[0]["variation"]["mass"][0]
    assert infos[5]["final_info"]["variation"]["mass"][0] == infos[0]["variation"]["mass"][0]
    one = gym.make(STUB, privileged=True)
    assert one.reset(seed=0)[1]["privileged"].shape == (165,)
    one.unwrapped.tank.vary(0, mass=1.25, length=1.5)
    told = one.step(one.action_space.sample())[4]["privileged"][-len(FACTORS) :]
    assert dict(zip(FACTORS, told, strict=True))["mass"] == 1.25 and told[-1] == 1.5
    vec = fish_env.make_sb3_vec_env(STUB, 2, seed=0, monitor=False, privileged=True)
    vec.reset()
    assert vec.reset_infos[0]["privileged"].shape == vec.step(ACTIONS[0, :2])[3][1]["privileged"].shape == (165,)


def test_varied_muscles_and_length():
    """Strength scales the contraction, contraction_time its speed."""
    tank = fish_env.Tank(fish_env.make_fish(), 3, lanes="xyz")
    tank.vary(1, strength=0.5)
    tank.vary(2, contraction_time=2.0)
    tank.swim(np.ones(12), 0.02)
    plain, weak, slow = tank.contraction
    np.testing.assert_allclose(weak, 0.5 * plain)
    np.testing.assert_allclose(slow, 0.5 * plain)  # the muscles of this body contract at a limited rate
    tank.swim(np.ones(12), 2.0)
    np.testing.assert_allclose(tank.contraction[:, 0], [1.0, 0.5, 1.0], atol=1e-6)
    for factors, message in (
        ({"strength": 2.0}, "give factors from 0"), ({"length": 0.0}, "factors on stiffness, mass and length is 0.0"),
        ({"length": 200.0}, "the factor on length is 200; give a number from 0.01 to 100"),
        ({"stiffness": 1e9}, "stiffness over mass and squared length is 1e[+]09, too much for the shortest parts"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            tank.vary(0, **factors)
    np.testing.assert_array_equal(tank.variation[0], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("water", tiered((None, "drag"), (None,)))
def test_varied_length(water):
    """A fish varied to another length is the fish that is built so, in its own lengths: in a batch, alone, in a tank.

    What differs is rounding, which a regular stroke does not magnify.
    """
    own = {} if water is None else {"water": water}
    batch = gym.make_vec(SWIM, 4, lanes="xyz", **own).unwrapped
    batch.reset(seed=0)
    ratios, fish, interval = (0.5, 0.7, 1.5, 2.0), batch.tank.fish, batch.control_interval
    alone = gym.make(SWIM, **own, variation={"length": 0.7, "contraction_time": 0.7**0.52}).unwrapped
    alone.reset(seed=1)
    batch.tank.position[1], batch.tank.velocity[1] = alone.tank.position[0], alone.tank.velocity[0]
    tanks = []
    for i, ratio in enumerate(ratios):
        batch.tank.vary(i, length=ratio, contraction_time=ratio**0.52)
        built = fish_env.make_fish(length=ratio * fish.length, **own)
        tanks.append(fish_env.Tank(built, 1, dt=batch.tank.dt, water=built.water, threads=1))
        tanks[i].position[:], tanks[i].velocity[:] = ratio * batch.tank.position[i], ratio * batch.tank.velocity[i]
    for k in range(round(1.0 / interval)):
        action = (fish.sides * np.sin(4.0 * np.pi * interval * k - fish.segments)).astype(np.float32)
        batch.step(np.tile(action, (4, 1)))
        alone.step(action)
        for tank in tanks:
            tank.swim(action.astype(float), interval)
    found = [tank.position[0] / tank.fish.length for tank in tanks]
    np.testing.assert_allclose(batch.tank.position / fish.length, found, rtol=0, atol=1e-9)
    np.testing.assert_allclose(alone.tank.position[0] / fish.length, found[1], rtol=0, atol=1e-9)
    assert np.abs(found[1] - found[2]).max() > 0.01


def test_recorded_and_replayed():
    """An episode with noise and drawn delays is recorded and replayed to the bit."""
    with gym.make(STUB, **ALL) as env:
        assert replay(record(env, ACTIONS[:, 0], seed=4)).same


def test_a_task_with_goals_is_of_its_own_class():
    """`TargetTask(goal_env=True)` is a `GoalTask`, also as a copy or a pickle; a class made of it cannot be one."""
    task = TargetTask(goal_env=True, radius=0.2)
    for each in (task, copy.deepcopy(task), pickle.loads(pickle.dumps(task))):
        assert type(each) is GoalTask and each.radius == 0.2
    assert type(TargetTask(goal_env=False)) is TargetTask and type(GoalTask(goal_env=True)) is GoalTask
    for make, value in ((TargetTask, 1), (type("Other", (TargetTask,), {}), True)):
        with pytest.raises(ValueError, match="goal_env is"):
            make(goal_env=value)


def test_goals_are_exact():
    """Noise and delays are those of the observation alone: the goals are exact and of the present."""
    exact = gym.make(TARGET, goal_env=True)
    worse = gym.make(TARGET, goal_env=True, observation_noise={"position": 0.1}, observation_delay=3)
    seen = []
    for env in (exact, worse):
        env.reset(seed=0)
        seen.append([env.step(np.full(12, (-1.0) ** (k // 5)))[0] for k in range(10)])
    for one, other in zip(*seen, strict=True):
        np.testing.assert_array_equal(one["achieved_goal"], other["achieved_goal"])
        assert not np.array_equal(one["observation"], other["observation"])


def test_rest_lengths_of_strong_muscles():
    """The rest length of a muscle that contracts further than 1 is observed as 1, as the page of Swim says."""
    env = gym.make(SWIM, variation={"strength": 1.25})
    env.reset(seed=0)
    for _ in range(10):
        obs = env.step(np.ones(12))[0]
    bare = env.unwrapped
    assert (bare.tank.contraction > 1.2).all() and (bare.layout.read(obs, "rest length") == 1.0).all()


def test_goals():
    """With goal_env=True, rewards are those of the goals in the observation, and the checker is silent."""
    with gym.make(TARGET, goal_env=True, radius=0.25, disable_env_checker=True) as env:
        check_env(env.unwrapped, skip_render_check=True)
        obs, _ = env.reset(seed=0, options={"distance": 0.8, "bearing": 0.0})
        target, nose = obs["desired_goal"], env.unwrapped.tank.fish.nose
        rewards = []
        for _ in range(3):
            obs, reward, *_, info = env.step(env.action_space.sample())
            assert reward == env.unwrapped.compute_reward(obs["achieved_goal"], obs["desired_goal"], info)
            np.testing.assert_array_equal(obs["desired_goal"], target)
            length = env.unwrapped.tank.fish.length
            np.testing.assert_allclose(obs["achieved_goal"], env.unwrapped.tank.position[0, nose] / length, rtol=1e-6)
            rewards.append(reward)
            env.unwrapped.tank.position[:] += target * length - env.unwrapped.tank.position[0, nose]
        again = env.unwrapped.set_state(env.unwrapped.get_state())
        np.testing.assert_array_equal(again["achieved_goal"], env.unwrapped.fish.observe()["achieved_goal"][0])
        assert rewards == [-1.0, 0.0, 0.0]
        found = env.unwrapped.episode_info()
        assert found["success"] and found["reached"] and 0 < found["time_to_target"] < 0.1
        assert replay(record(env, ACTIONS[:3, 0])).same
    batch = gym.make_vec(TARGET, 2, goal_env=True, max_episode_steps=2, autoreset_mode="SameStep")
    assert batch.reset(seed=0)[0]["desired_goal"].shape == (2, 3)
    for _ in range(2):
        obs, *_, infos = batch.step(batch.action_space.sample())
    assert obs["observation"].shape == (2, 159) and infos["final_obs"][1]["achieved_goal"].shape == (3,)
    started = batch.call("reset", seed=3)
    moved = batch.call("set_state", batch.call("get_state")[0])
    for each in (started[0][0], started[1][0], *moved):
        np.testing.assert_array_equal(each["desired_goal"], started[0][0]["desired_goal"])
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.SAC("MultiInputPolicy", fish_env.make_sb3_vec_env(TARGET, 2, seed=0, goal_env=True))
    assert set(evaluate(batch.unwrapped, model)["success"]) <= {0.0, 1.0}
    many = np.zeros((5, 3)), np.linspace(0, 1, 15).reshape(5, 3)
    assert batch.unwrapped.compute_reward(*many).tolist() == [
        0.0 if r <= 0.15 else -1.0 for r in np.linalg.norm(many[1], axis=1)
    ]
    assert not hasattr(gym.make(STUB).unwrapped, "compute_reward")


@pytest.mark.parametrize(
    ("keywords", "message"),
    [({"observation": "camera"}, "unknown observation 'camera'; choose from 'nodes', 'sensors'"),
     ({"observation": np.array(["nodes"])}, "unknown observation"),
     ({"observation_noise": 0.1}, "give a dict: a standard deviation for each part"),
     ({"observation_noise": {"speed": 0.1}}, "observation_noise has 'speed'; choose from 'position', 'velocity'"),
     ({"observation_noise": {"velocity": -0.1}}, "velocity'. is -0.1; give a number from 0 to 10"),
     ({"action_noise": np.nan}, "action_noise is nan"),
     ({"action_noise": "much"}, "action_noise is 'much'; give a number"),
     ({"observation_delay": 250}, "observation_delay is 250; give a whole number of environment steps from 0 to 249"),
     ({"action_delay": (3, 1)}, r"action_delay is \(3, 1\); give a whole number of environment steps"),
     ({"action_delay": 1.5}, "action_delay is 1.5; give a whole number"),
     ({"action_delay": True}, "action_delay is True"),
     ({"action_delay": np.array(3)}, r"action_delay is array\(3\); give a whole number"),
     ({"history": -1}, "history is -1; give a whole number of steps from 0 to 100"),
     ({"privileged": 1}, "privileged is 1; give True or False"),
     ({"variation": {"strength": 2.0}}, r"variation\['strength'\] is 2; give a number from 0.25 to 1.25")],
)  # fmt: skip
def test_bad_settings(keywords, message):
    """What is not allowed is one clear line, of one fish at its reset where the time limit is what forbids it."""
    for make in (gym.make, lambda id, **options: gym.make_vec(id, 2, **options)):
        with pytest.raises(ValueError, match=message):
            make(STUB, **keywords).reset()


def test_a_delay_may_be_as_long_as_the_episode():
    """That of the time limit which is asked for."""
    for make in (gym.make, partial(gym.make_vec, num_envs=2)):
        make(STUB, max_episode_steps=1000, observation_delay=400).reset(seed=0)


@pytest.mark.parametrize("body", tiered(BODIES, ["mass_spring", "planar"]))
def test_muscles_at_rest_have_no_strain(body):
    """That which sensors show is over the length at rest, on a flat body too."""
    env = gym.make(STUB, body=body, observation="sensors")
    strain = env.unwrapped.layout.read(env.reset(seed=0)[0], "muscle length")
    np.testing.assert_allclose(strain, 0.0, atol=1e-6)


def test_noise_follows_the_unit():
    """The noise of a part may be as large as the part; a part that is not there is named, whatever its noise."""
    for part in gym.make(STUB, observation="sensors").unwrapped.layout:
        gym.make(STUB, observation="sensors", observation_noise={part.name: part.limit})
        with pytest.raises(ValueError, match=rf"from 0 to {part.limit:g} \(standard deviation, "):
            gym.make(STUB, observation="sensors", observation_noise={part.name: 1.01 * part.limit})
    with pytest.raises(ValueError, match=r"observation_noise has 'presure' .did you mean 'pressure'"):
        gym.make(STUB, observation="sensors", observation_noise={"presure": 0.0})


# The layout


@pytest.mark.parametrize(
    ("id", "keywords"),
    [*((id, {}) for id in ID.values()), (STUB, {"speed": 1.0}), (STUB, {"body": "planar"}),
     (STUB, {"observation": "sensors", "history": 3})],
)  # fmt: skip
def test_parts_follow_one_another(id, keywords):
    """The parts fill the observation without gaps, in their shapes, and the bounds are those of the space."""
    env = gym.make_vec(id, 2, **keywords).unwrapped
    layout, obs = env.layout, env.reset(seed=0)[0]
    end = 0
    for part in layout:
        assert part.start == end and part.size == np.prod(part.shape) == len(part.labels)
        assert all(label.startswith(part.name) for label in part.labels)
        assert layout.read(obs, part.name).shape == (2, *part.shape)
        assert np.shares_memory(layout.read(obs, part.name), obs)
        end = part.slice.stop
    assert end == layout.size == env.single_observation_space.shape[0]
    np.testing.assert_array_equal(layout.bounds(), env.single_observation_space.high)
    np.testing.assert_array_equal(-layout.bounds(), env.single_observation_space.low)


def test_parts_are_what_they_say():
    """Positions, velocities, rest lengths and directions are those of the tank in the body's frame."""
    env = gym.make(SWIM).unwrapped
    obs, _ = env.reset(seed=5, options={"yaw": 0.7, "heading": 1.2})
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 12)):
        obs = env.step(action)[0]
    tank, fish = env.tank, env.tank.fish
    rows = env.layout.table()
    assert len(rows) == obs.size == env.layout.size == len({name for name, _, _ in rows})
    seen = {part.name: env.layout.read(obs, part.name) for part in env.layout}
    mass = fish.body.mass / fish.body.mass.sum()
    x = tank.position[0] - mass @ tank.position[0]
    forward = fish.line @ x
    forward /= np.linalg.norm(forward)
    np.testing.assert_allclose(seen["position"][:, 0], x @ forward / fish.length, atol=1e-6)
    np.testing.assert_allclose(seen["velocity"][:, 0], tank.velocity[0] @ forward / fish.length, atol=1e-5)
    np.testing.assert_allclose(seen["rest length"], 2 * tank.contraction[0] - 1, atol=1e-6)
    assert seen["vertical"][0] == pytest.approx(forward[2], abs=1e-6)
    assert seen["vertical"] @ seen["vertical"] == pytest.approx(1, abs=1e-6)
    assert seen["commanded heading"][0] == pytest.approx(forward @ [np.cos(1.2), np.sin(1.2), 0], abs=1e-6)
    assert seen["commanded heading"] @ seen["commanded heading"] == pytest.approx(1, abs=1e-6)


@pytest.mark.soft
@pytest.mark.parametrize("body", fish_env.BODIES)
def test_scaled_observation_of_a_fish_at_rest_is_zero(body):
    """A relaxed fish at rest, level, is seen as zeros but for what the task shows."""
    env = gym.make_vec(STUB, 1, body=body).unwrapped
    env.reset(seed=0)
    env.tank.position[:], env.tank.velocity[:] = env.tank.fish.body.position, 0.0
    env._measure()
    offset, scale = env.layout.scaling()
    scaled = ((env.observe()[0] - offset) / scale)[: env.layout["commanded heading"].start]
    relaxed = env.layout["rest length"]
    np.testing.assert_allclose(scaled[relaxed.slice], -1.0, atol=1e-6)
    scaled[relaxed.slice] = 0.0
    np.testing.assert_allclose(scaled, 0.0, atol=1e-4)


def test_layout_is_asked_by_id():
    """`observation_layout` is the layout of the environment that Gymnasium makes; the stub's is Swim's."""
    asked = fish_env.observation_layout("FishEnv/Avoid-v0")
    env = gym.make("FishEnv/Avoid-v0").unwrapped
    assert asked.table() == env.layout.table() and asked.version == env.layout.version == 1
    swim, stub = (fish_env.observation_layout(f"FishEnv/{name}-v0") for name in ("Swim", "Stub"))
    assert swim.table() == stub.table() and "commanded heading" in swim
    assert "commanded velocity" in fish_env.observation_layout("FishEnv/Swim-v0", speed=1.0)
    assert pickle.loads(pickle.dumps(env.layout)).table() == env.layout.table()
    with pytest.raises(ValueError, match="CartPole-v1 has no observation layout"):
        fish_env.observation_layout("CartPole-v1")
    with pytest.raises(KeyError, match="no part 'speed'; its parts are position, velocity, rest length, vertical"):
        swim["speed"]


def test_parts_need_different_names():
    """A task whose direction has the name of another part is an error."""
    with pytest.raises(ValueError, match="give every direction a name of its own"):
        Layout(fish_env.make_fish(), (Direction("velocity", "body lengths/s", 1.0, 1.0),))
