"""Derivatives of a control interval are those of the motion itself: beside central differences of the same method."""

import gymnasium as gym
import numpy as np
import pytest
from moving import rows

import fish_env
from fish_env.bodies.fitted import WATERS

SMALL = 1e-6  # of a body length, of a body length in 0.1 s, and of a full contraction
SETTLE = 10  # intervals before, which leave the fish bent and moving
PLAIN: dict = {}  # no change of the fish


def tanks(fish, integrator, count, change):
    """A tank of fish, each with a change; all in water that grabs them if the change says so."""
    tank = fish_env.Tank(fish, count, integrator, water=fish.water, threads=1, energy=change.get("energy", False))
    for i in range(count):
        tank.vary(i, **change.get("vary", {}))
    if "grab" in change:
        tank.grab(0, change["grab"], stiffness=5.0, damping=0.1)
    if "fix" in change:
        tank.fix(change["fix"], method="penalty")
    return tank


def moved(fish, integrator=None, change=PLAIN):
    """A tank of one fish in motion, and contractions that all muscles reach within an interval."""
    tank, generator = tanks(fish, integrator, 1, change), np.random.default_rng(0)
    steps = round(fish.control_interval / tank.dt)
    for _ in range(SETTLE):
        goal = generator.uniform(size=(1, fish.num_muscles))
        tank.drive(goal, steps)
    reached = np.clip(tank.contraction / tank.muscle_variation[0, 0], 0.01, 0.99)
    return tank, reached + 0.1 * (np.clip(goal, 0.01, 0.99) - reached), steps


def state_of(tank):
    """States (B,S) in the order of the Jacobians."""
    parts = tank.position, tank.velocity, tank.rest_length[:, np.unique(tank.fish.fibres)]
    return np.concatenate([part.reshape(tank.num_fish, -1) for part in parts], axis=1)


def differences(fish, integrator, tank, goal, steps, change=PLAIN):
    """Central differences of the interval, (S,S + M), and the sizes (S + M,) of a change of each number."""
    nodes, fibres, muscles = 3 * len(fish.body.mass), np.unique(fish.fibres), fish.num_muscles
    size = np.repeat([fish.length, 10.0 * fish.length, fish.length, 1.0], [nodes, nodes, len(fibres), muscles])
    shift = SMALL * np.vstack([np.diag(size), -np.diag(size)])
    many = tanks(fish, integrator, len(shift), change)
    many.position[:] = tank.position + shift[:, :nodes].reshape(len(shift), -1, 3)
    many.velocity[:] = tank.velocity + shift[:, nodes : 2 * nodes].reshape(len(shift), -1, 3)
    many.rest_length[:] = tank.rest_length
    many.rest_length[:, fibres] += shift[:, 2 * nodes : -muscles]
    many.drive(goal + shift[:, -muscles:], steps)
    assert many.alive.all()
    above, below = np.split(state_of(many), 2)
    return (above - below).T / (2.0 * SMALL * size), size


FACTORS = {"stiffness": 1.4, "mass": 1.2, "drag": 0.8, "current": (0.05, 0.02, 0.0), "strength": 0.8,
           "contraction_time": 1.5, "length": 1.3}  # fmt: skip
CASES = [(water, "mass_spring", name, {}) for water in WATERS for name in (None, "rk4", "semi_implicit")]
CASES += [("reactive", "planar", None, {}), ("reactive", "mass_spring", "linearly_implicit", {}),
          ("drag", "tetrahedral", None, {}), ("reactive", "mass_spring", None, {"vary": FACTORS}),
          ("drag", "planar", None, {"vary": FACTORS}), ("reactive", "mass_spring", None, {"grab": (0.02, 0.01, 0.0)}),
          ("reactive", "mass_spring", None, {"fix": [3], "energy": True})]  # fmt: skip


@pytest.mark.parametrize(("water", "body", "integrator", "change"), rows(CASES, CASES[:2] + CASES[3:4] + CASES[6:7]))
def test_central_differences(water, body, integrator, change):
    """Derivatives with respect to all of the state and to the command, in the scale of the fish; nothing moves."""
    fish = fish_env.make_fish(body, water=water)
    tank, goal, steps = moved(fish, integrator, change)
    before = tank.get_state()
    found = np.hstack([part[0] for part in tank.linearise(goal, steps)])
    assert all(np.array_equal(before[name], part) for name, part in tank.get_state().items())
    expected, size = differences(fish, integrator, tank, goal, steps, change)
    scale = size / size[: len(found), None]
    assert np.linalg.norm((found - expected) * scale) < 1e-6 * np.linalg.norm(expected * scale)


def test_muscles_at_their_limits():
    """A muscle too far from its command moves as fast as it can: its command has no effect, and its state all."""
    fish = fish_env.make_fish()
    tank, _, steps = moved(fish)
    goal = (tank.contraction < 0.5) * 1.0
    found = tank.linearise(goal, steps)
    assert not found.command.any()
    expected, _ = differences(fish, None, tank, np.clip(goal, 2 * SMALL, 1 - 2 * SMALL), steps)
    rest = -len(fish.fibres)
    np.testing.assert_allclose(found.state[0, rest:], expected[rest:, : found.state.shape[2]], atol=1e-7)


def test_refined_interval():
    """Where a motion is too violent for the step, the derivatives are those of the shorter steps that it takes."""
    fish = fish_env.make_fish()
    tank, goal, steps = moved(fish)
    tank.velocity[0, 21] += [0.0, 8.0, 0.0]
    expected, size = differences(fish, None, tank, goal, steps)
    found = np.hstack([part[0] for part in tank.linearise(goal, steps)])
    tank.drive(goal, steps)
    assert tank.counters["refinements"][0] > 0
    scale = size / size[: len(found), None]
    assert np.linalg.norm((found - expected) * scale) < 1e-5 * np.linalg.norm(expected * scale)


@pytest.mark.parametrize("groups", ["muscles", "pairs"])
def test_environments(groups):
    """The same of a single fish, in a batch and of the tank; a column for each action, zero for one that is clipped."""
    one, many = (
        gym.make("FishEnv/Turn-v0", muscle_groups=groups),
        gym.make_vec("FishEnv/Turn-v0", 3, muscle_groups=groups),
    )
    action = np.linspace(-0.9, 0.9, one.action_space.shape[0])
    one.reset(seed=5), many.reset(seed=[4, 5, 6])
    for _ in range(3):
        one.step(action), many.step(np.tile(action, (3, 1)))
    single, batch = (env.unwrapped.linearise(a) for env, a in ((one, action), (many, np.tile(action, (3, 1)))))
    assert all(np.array_equal(a, b[1]) for a, b in zip(single, batch, strict=True))
    tank = one.unwrapped.tank
    muscles = tank.linearise(
        0.5 * (action[one.unwrapped.fish.groups] + 1.0)[None], round(tank.fish.control_interval / tank.dt)
    )
    assert np.array_equal(muscles.state[0], single.state)
    np.testing.assert_allclose(single.command.sum(axis=1), 0.5 * muscles.command[0].sum(axis=1), atol=1e-12)
    action[0] = 1.5
    assert not one.unwrapped.linearise(action).command[:, 0].any()


def test_what_has_no_derivatives():
    """Adaptive methods, prescribed nodes, failed fish and odd arguments are refused, and the tank is unchanged."""
    fish = fish_env.make_fish()
    goal = np.full((1, 12), 0.5)
    with pytest.raises(ValueError, match="adapts its steps"):
        fish_env.Tank(fish, 1, "dop853", water=fish.water).linearise(goal, 1)
    tank = fish_env.Tank(fish, 1, water=fish.water)
    for bad in (goal[0], 2.0 * goal + 0.1):
        with pytest.raises(ValueError, match="contraction"):
            tank.linearise(bad, 16)
    tank.velocity[0, 3] = 1e6
    with pytest.raises(ValueError, match=r"fish 0 fails in this interval \(.*; give smaller steps"):
        tank.linearise(goal, 16)
    assert not tank.control.rate.any() and not tank.effort.any() and tank.alive[0]
    tank.reset()
    tank.fix([0])
    with pytest.raises(ValueError, match="release the nodes"):
        tank.linearise(goal, 16)
