"""Where energy goes: flows against the forces themselves, and balances that close on every body and in both waters."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from naive.reactive import added_mass, reactive_force

from fish_env import Tank, make_fish, make_water
from fish_env.control.gait import best_gait
from fish_env.physics.forces.evaluate import Evaluator

BODIES = ("mass_spring", "planar", "two_layer", "tetrahedral")
CURRENT = np.array([0.05, -0.02, 0.0])  # m/s; planar bodies are held in their plane
VARIED = {"stiffness": 0.9, "mass": 0.8, "drag": 1.3, "current": (-0.02, 0.03, 0.0)}
SECONDS = 0.5


@cache
def scene(name: str, inertia: bool):
    """A fish and water of the level that it is calibrated for, but with more friction."""
    fish = make_fish(name, water="reactive" if inertia else "drag")
    return fish, make_water(drag_coefficient=1.0, current=CURRENT, inertia=inertia, friction=4.0)


def swim(tank: Tank, seconds: float = SECONDS) -> None:
    """Swim by half of the open-loop gait, which all fish survive."""
    fish, interval = tank.fish, tank.fish.control_interval
    for k in range(round(seconds / interval)):
        contraction = 0.5 * best_gait().contraction(fish, (k + 1) * interval)
        tank.drive(np.tile(contraction, (tank.num_fish, 1)), round(interval / tank.dt))
    assert tank.alive.all(), tank.failure


def imbalance(name, inertia, parts, integrator=None):
    """Energy that a nominal and a varied fish lose beyond the flows, over their positive work, (2,); and the tank."""
    fish, water = scene(name, inertia)
    tank = Tank(fish, 2, integrator, fish.time_step / parts, water, threads=1, energy=True)
    tank.vary(1, **VARIED)
    before = sum(tank.energies().values())
    swim(tank)
    flows, after = tank.flows, sum(tank.energies().values())
    assert (flows["positive_work"] > tank.work).all() and (flows["damping"] > 0).all() and (flows["water"] > 0).all()
    lost = tank.work - flows["damping"] - flows["water"] - (after - before)
    return np.abs(lost) / flows["positive_work"], tank


@pytest.mark.parametrize("inertia", [False, True], ids=["drag", "reactive"])
@pytest.mark.parametrize("name", BODIES)
def test_balance_closes(name, inertia):
    """Work is what is stored, damped and left to the water: to 1 % at the default step, 0.1 % at a quarter of it."""
    assert imbalance(name, inertia, 4)[0].max() <= 1e-3
    assert imbalance(name, inertia, 1)[0].max() <= 1e-2


@pytest.mark.parametrize(
    ("method", "parts", "allowed"), [("rk4", 8, 1e-5), ("semi_implicit", 256, 1e-3), ("rosenbrock", 8, 1e-3)]
)
def test_balance_closes_in_every_kind_of_method(method, parts, allowed):
    """The same, to their order, of methods that measure in other places; all agree on the thrust."""
    (found, tank), (_, default) = imbalance("mass_spring", True, parts, method), imbalance("mass_spring", True, 4)
    assert found.max() <= allowed
    np.testing.assert_allclose(tank.flows["thrust"], default.flows["thrust"], rtol=0.02)


def test_flows_of_one_step():
    """Flows are powers of the forces at the middle of a step, at the mean of the velocities before and after it."""
    fish, water = scene("mass_spring", True)
    body, rest = fish.body, fish.body.springs.rest_length
    tank, rng = Tank(fish, 1, water=water, energy=True, refine=np.inf), np.random.default_rng(2)
    tank.position[:] += 0.0005 * rng.normal(size=tank.position.shape)
    tank.velocity[:] = [0.3, 0.0, 0.0] + 0.1 * rng.normal(size=tank.position.shape)
    tank.advance(4)  # vibrations that the filter slows die out
    x, v, before = tank.position[0].copy(), tank.velocity[0].copy(), {k: a[0] for k, a in tank.flows.items()}
    tank.advance(1)
    h, mean, a = tank.dt, 0.5 * (v + tank.velocity[0]), (tank.velocity[0] - v) / tank.dt
    x, through = x + 0.5 * h * v, mean - CURRENT

    def force(names, speed):
        return Evaluator(body, water, names).force(rest, x, speed)

    drag, moving = force(("water",), mean), reactive_force(body, water, x, mean)
    moving -= (added_mass(body, water, x) @ a.ravel()).reshape(x.shape)
    later, sooner = (
        Evaluator(body, water).energies(rest, x + sign * 1e-6 * through, mean + sign * 1e-6 * a)["reactive"]
        for sign in (1, -1)
    )
    ahead = fish.line @ x
    ahead /= np.linalg.norm(ahead)
    wanted = {
        "positive_work": 0.0,  # the muscles hold still
        "damping": -((force(("springs",), mean) - force(("springs",), 0.0 * mean)) * mean).sum(),
        "water": -((drag + moving) * through).sum() - (later - sooner) / 2e-6,
        "thrust": np.maximum((drag + moving) @ ahead, 0.0).sum() * (body.mass @ through / body.mass.sum() @ ahead),
    }
    assert wanted["water"] > 0.0 and abs(wanted["thrust"]) > 0.0
    for name, value in wanted.items():
        assert tank.flows[name][0] - before[name] == pytest.approx(h * value, rel=1e-6, abs=1e-18), name


def test_measuring_changes_nothing():
    """Motion has the bits of a tank that does not measure; flows those of a single fish, whatever the lanes."""
    fish, rng, count = make_fish(), np.random.default_rng(4), 33
    actions = rng.uniform(-1, 1, (8, count, fish.num_muscles))
    options = ({"threads": 2, "energy": True}, {"threads": 1}, {"energy": True})
    tanks = [Tank(fish, many, water=fish.water, **each) for many, each in zip((count, count, 1), options, strict=True)]
    for action in actions:
        for tank in tanks:
            tank.swim(action[-tank.num_fish :], fish.control_interval)
    batch, plain, single = tanks
    assert (batch.position == plain.position).all() and (batch.work == plain.work).all()
    assert (batch.flow[-1] == single.flow[0]).all() and (batch.flow[:, :3] > 0.0).all()
    saved = batch.get_state()
    batch.reset(np.arange(count) < 5)
    assert not batch.flow[:5].any() and (batch.flow[5:] == saved["flow"][5:]).all()
    batch.set_state(saved)
    assert (batch.flow == saved["flow"]).all() and set(plain.get_state()) == set(saved) - {"flow"}


@pytest.mark.parametrize("water", ["drag", "reactive"])
def test_work_in_info(water):
    """The work of an episode is that at a tenth of the step, to 0.5 %."""
    found = []
    for parts in (1, 10):
        env = gym.make(
            "FishEnv/Swim-v0",
            water=water,
            dt=make_fish().time_step / parts,
        )
        env.reset(seed=0)
        fish = env.unwrapped.tank.fish
        for k in range(50):
            env.step(best_gait().action(fish, (k + 1) * fish.control_interval))
        found.append(env.unwrapped.episode_info())
        env.close()
    assert found[0]["work"] == pytest.approx(found[1]["work"], rel=5e-3)


def test_refused():
    """What cannot be measured is refused, saying why."""
    for energy, integrator, text in ((1, None, "give True or False"), (True, "dop853", "does not measure energy")):
        with pytest.raises(ValueError, match=text):
            Tank(make_fish(), 1, integrator, energy=energy)
    with pytest.raises(AttributeError, match="energy=True"):
        _ = Tank(make_fish()).flows
