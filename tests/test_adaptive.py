"""The methods of scipy: exact to their tolerance, counted, and how they give up."""

import naive
import numpy as np
import pytest
import scipy.integrate
from moving import FISH, each_adaptive, each_body, run_into_failure, scene, tank_of, world_of
from scipy.integrate import solve_ivp
from small_bodies import control, start

from fish_env import Tank
from fish_env.physics.failures import NO_CONVERGENCE
from fish_env.physics.forces.evaluate import Evaluator
from fish_env.physics.records import FORCES
from fish_env.physics.world import VACUUM
from fish_env.soft import adaptive

DEFAULT, STILL = FISH["mass_spring"], np.zeros((23, 3))
METHOD = {"dop853": "DOP853", "radau": "Radau"}


@each_adaptive
@each_body
@pytest.mark.parametrize("medium", ["vacuum", "water", "stiff"])
def test_adaptive_is_exact(name, body, medium):
    """An adaptive method ends at the reference solution, to its tolerance; a wider one is less exact and costs less."""
    (world, x, v, rest, rate, duration), (true_x, true_v) = scene(body, medium)
    errors, costs = [], []
    for tolerance in (1e-10, 1e-4):
        state = start(x, v)
        adaptive.solve(FISH[body].body, world, state, control(rest, rate), duration, METHOD[name], tolerance)
        assert state.failure[0] == 0 and state.t[0] == duration
        error = np.linalg.norm(state.x[0] - true_x) + duration * np.linalg.norm(state.v[0] - true_v)
        errors.append(error / (np.linalg.norm(true_x - x) + duration * np.linalg.norm(true_v)))
        costs.append(state.counters[0, FORCES])
    assert errors[0] <= 2e-7 and 1e-7 <= errors[1] <= 0.2 and costs[1] < costs[0]


@each_adaptive
def test_adaptive_counters(name, monkeypatch):
    """An adaptive method counts every evaluation of the forces, and the factorisations that scipy tells of."""
    evaluations, found, force = [], [], Evaluator.force

    def counted(*arguments):
        evaluations.append(arguments)
        return force(*arguments)

    def remember(*arguments, **options):
        found.append(solve_ivp(*arguments, **options))
        return found[-1]

    monkeypatch.setattr(Evaluator, "force", counted)
    monkeypatch.setattr(scipy.integrate, "solve_ivp", remember)
    tank = Tank(DEFAULT, 1, name, water=world_of(DEFAULT))
    tank.advance(2)
    tank.advance(1)
    assert len(found) == 2 and found[0].nfev + found[1].nfev == len(evaluations) == tank.counters["force_evaluations"]
    assert tank.counters["factorisations"] == found[0].nlu + found[1].nlu
    assert (tank.counters["factorisations"] > 0) == (name == "radau") and tank.counters["solves"] == 0


@each_adaptive
def test_adaptive_gives_up(name, monkeypatch):
    """A motion that takes more evaluations than are allowed fails as not converged, and is put back; counters stay."""
    monkeypatch.setattr(adaptive, "MOST_EVALUATIONS", 100)
    x, v = naive.random_state(DEFAULT, np.random.default_rng(13))
    tank = tank_of(name, DEFAULT, VACUUM, x, v, 1.0)
    assert run_into_failure(tank, 1) == NO_CONVERGENCE
    np.testing.assert_array_equal(tank.position[0], x)
    assert tank.state.counters[0, FORCES] == 101


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"method": "RK45"}, "unknown method 'RK45'; choose from 'DOP853', 'Radau'"),
        ({"tolerance": 1e-14}, "tolerance is 1e-14; give a number from 1e-13 to 0.01"),
        ({"tolerance": 0.1}, "tolerance is 0.1; give a number"),
        ({"tolerance": float("nan")}, "tolerance is nan; give a number"),
        ({"tolerance": "fine"}, "tolerance is 'fine'; give a number"),
        ({"duration": -1.0}, "duration is -1.0; give a finite number of seconds, zero or more"),
        ({"duration": float("inf")}, "duration is inf; give a finite number"),
    ],
    ids=str,
)
def test_adaptive_refuses(arguments, text):
    """A method, tolerance or duration that is not allowed is refused before anything moves."""
    state, rest = start(DEFAULT.body.position, STILL), control(DEFAULT.body.springs.rest_length)
    with pytest.raises(ValueError, match=text):
        adaptive.solve(DEFAULT.body, VACUUM, state, rest, **{"duration": 0.1, **arguments})
    np.testing.assert_array_equal(state.x[0], DEFAULT.body.position)
