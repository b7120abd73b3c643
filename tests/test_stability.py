"""Stability: linear theory against formulas, the survey of steps, and the worst that was found, done again."""

import naive
import numpy as np
import pytest
from moving import STABILISED, tiered

from benchmarks.common.problems import FIXED, scaled
from benchmarks.common.tables import read_table
from benchmarks.stability import attack, attack_search, cases, linear, mistreatment, survey
from fish_env import BODIES, INTEGRATORS, Tank, make_fish
from fish_env.bodies.mass_spring import LAYERS
from fish_env.physics.failures import FAILURES, STRETCH_LIMIT, TORN

FISH = make_fish()
LONGEST = 5 * FISH.control_interval
ALIKE = make_fish("mass_spring", relaxation_time=0.0003, damping_taper=[1.0] * 6)
"""All springs relax alike, so that every vibration is damped on its own, and there are formulas."""
OMEGA = np.sqrt(ALIKE.body.max_stiffness_eigenvalue)
THETA = ALIKE.body.springs.damping[0] / ALIKE.body.springs.stiffness[0]
CASES = cases.stored()
each_case = pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=() if case["body"] in naive.TU else pytest.mark.slow) for case in CASES.values()],
    ids=CASES,
)


# Linear theory


def test_modes_are_those_of_the_body():
    """As many vibrations as coordinates less six; the highest is the body's, all relax in the units' time."""
    squares, damping = linear.modes(ALIKE.body)
    assert squares.size == 3 * ALIKE.body.mass.size - 6
    assert np.isclose(squares.max(), ALIKE.body.max_stiffness_eigenvalue, rtol=1e-12)
    assert np.allclose(damping, THETA * squares, rtol=1e-9, atol=0)


FORMULAS = {
    "symplectic_euler": (lambda w, s: (np.sqrt((w * s) ** 2 + 4.0) - w * s) / w, 1e-5),
    "semi_implicit": (lambda w, s: (np.sqrt((w * s) ** 2 + 4.0) - w * s) / w, 1e-5),
    "explicit_euler": (lambda w, s: s, 1e-3),  # where every mode is lightly damped
}
"""Limit of a method by the highest frequency and the relaxation time, and the relative error that is allowed."""


@pytest.mark.parametrize("factor", [1.0, 100.0])
@pytest.mark.parametrize("name", FORMULAS)
def test_linear_limits(name, factor):
    """The limit of a body whose stiffness is multiplied by a factor is that of the formula."""
    body, (formula, error) = scaled(ALIKE, stiffness=factor).body, FORMULAS[name]
    expected = formula(OMEGA * np.sqrt(factor), THETA / factor)
    assert np.isclose(linear.linear_limit(name, body, LONGEST), expected, rtol=error)


def test_limit_of_rk4_undamped():
    """2 sqrt(2) over the highest frequency: its stability region's end on the imaginary axis."""
    body = scaled(ALIKE, damping=0.0).body
    assert np.isclose(linear.linear_limit("rk4", body, LONGEST), np.sqrt(8.0) / OMEGA, rtol=1e-5)


@pytest.mark.parametrize("name", tiered((n for n in FIXED if INTEGRATORS[n].kind != "explicit"), STABILISED))
def test_no_linear_limit(name):
    """A method that solves for, or filters, all stiffness is stable at long steps on a hundredfold stiff body at rest.

    Up to 30 ms the leapfrog's 1000 stages do.
    """
    body, longest = scaled(FISH, stiffness=100.0).body, 1.5 * FISH.control_interval
    assert np.isinf(linear.linear_limit(name, body, longest)) == (name != "semi_implicit")


# The survey


def test_limit_is_below_every_unstable_step():
    """A stable step beyond an unstable one does not count."""
    found = {1.0: False, 0.5: True, 0.3: False, 0.2: True, 0.1: True}
    assert survey.limit(found) == (0.2, 0.3)
    assert survey.limit({0.1: True}) == (0.1, np.inf)
    assert np.isnan(survey.limit({1.0: False})[0])


def test_the_survey_covers_every_body():
    """Every body as it is, and the default one at every stiffness."""
    found = [(name, factor) for name, factor, _ in survey.cases()]
    assert {name for name, factor in found if factor == 1.0} == set(BODIES)
    assert [factor for name, factor in found if name == FISH.name] == list(survey.STIFFNESS)


def test_limit_of_tus_method():
    """A sweep finds the limit that the table has."""
    fish = make_fish()
    (row,) = [row for row in read_table("stability_limits.csv") if row["body"] == fish.name and row["stiffness"] == 1.0
              and row["integrator"] == "semi_implicit"]  # fmt: skip
    found = survey.sweep(fish, "semi_implicit", survey.reference_energy(fish))
    assert survey.limit(found) == (row["largest_stable_s"], row["unstable_from_s"])


# The worst that was found


def test_worst_cases_are_there():
    """Every body has survivors, and the kept cases are small."""
    assert {case["body"] for case in CASES.values() if not case["failure"]} == set(BODIES)
    assert cases.WORST.stat().st_size < 100_000


@each_case
def test_replay(case):
    """A survivor survives; a fish that fails says why and keeps a sound state. Alone or among others: the same.

    Whether a fish on the brink fails may hang on the last digit, so a kept failure need not fail again.
    """
    alone, stretch = cases.replay(case)
    batch, stretches = cases.replay(case, copies=33, threads=2)
    batch.close()
    for one, many in zip(alone.state, batch.state, strict=True):
        assert np.isfinite(one).all()
        assert np.array_equal(np.repeat(one, 33, axis=0), many)
    assert np.all(stretches == stretch)
    assert stretch[0] <= STRETCH_LIMIT
    assert alone.alive[0] == (alone.failure[0] == "")
    assert alone.failure[0] in FAILURES
    if not case["failure"]:
        assert alone.alive[0]


@pytest.mark.parametrize(
    "name", [name for name, case in CASES.items() if case["body"] == FISH.name and not case["failure"]]
)
def test_the_worst_at_the_default_step(name):
    """What stretched the default fish most, at the step it has now: it survives, and what it stretches is bounded."""
    tank, stretch = cases.replay(CASES[name], cases.own_settings(FISH))
    assert tank.alive[0] and stretch[0] < 0.9 * STRETCH_LIMIT


@pytest.mark.parametrize("name", BODIES)
def test_every_body_can_be_crumpled(name):
    """Every start moves a body's free axes only; its sections mirror themselves, and are those of the landmarks."""
    fish = make_fish(name)
    free = np.broadcast_to(fish.body.inverse_mass > 0.0, (2, *fish.body.position.shape))
    for start in mistreatment.STARTS:
        x, v = mistreatment.beginning(start, fish, 2, np.random.default_rng(0))
        assert np.isfinite([x, v]).all() and not v[~free].any() and not (fish.flat and x[:, :, 2].any())
    sections = mistreatment.cross_sections(fish)
    assert len(sections) == 5 and all(np.array_equal(np.sort(fish.mirror[nodes]), nodes) for nodes in sections)
    if name in naive.TU:
        np.testing.assert_array_equal(sections, np.sort(LAYERS[1:6], axis=1))


@pytest.mark.parametrize("name", tiered(BODIES, (FISH.name, "planar")))
def test_an_attack_from_beginning_to_end(name, monkeypatch):
    """Every family and every search, with few fish and short sequences; a trial writes nothing."""
    monkeypatch.setattr(mistreatment, "INTERVALS", 12)
    monkeypatch.setattr(attack_search, "POPULATION", 3)
    monkeypatch.setattr(attack_search, "SEARCHED", 8)
    monkeypatch.setattr(attack, "write_csv", lambda *_: pytest.fail("a trial is not published"))
    monkeypatch.setattr(attack, "store", lambda *_: pytest.fail("cases of a trial are not stored"))
    rows = attack.attack((name,), fish=100 if name == FISH.name else 100 * attack.OTHERS, evaluations=1)
    assert [row["family"] for row in rows[:-4]] == [family.name for family in mistreatment.families()]
    assert all(row["family"].startswith("search for ") for row in rows[-4:])
    for row in rows:
        assert row["body"] == name and row["fish"] >= 2 and 0 <= row["failures"] <= row["fish"]
        assert row["rerun_with_rk4"] == min(row["failures"], cases.EXPLAINED) >= row["rk4_fails_too"]
        survived = row["worst_stretch"] > 1.0 and row["peak_energy_over_gait"] > 0.0
        assert survived or row["failures"] == row["fish"]
    assert any(row["failures"] == 0 for row in rows)
    attack.report(rows)


def test_stored_cases_are_read_back(tmp_path):
    """What is stored is read back: settings, states to 32 bits, and commands."""
    case = next(iter(CASES.values()))
    cases.store([case, case | {"failure": "torn"}], tmp_path / "worst.npz")
    found = cases.stored(tmp_path / "worst.npz")
    assert [again["failure"] for again in found.values()] == ["", "torn"]
    for again in found.values():
        assert again.keys() == case.keys() and np.array_equal(again["goals"], case["goals"])
        assert np.array_equal(again["position"], case["position"])


def test_a_failure_leaves_its_neighbours_alone():
    """A fish torn between two that swim: it is put back to rest, they are bit for bit those of a tank without it."""
    goals = np.random.default_rng(0).uniform(size=(20, 1, FISH.num_muscles))
    three, two = Tank(FISH, 3, water=FISH.water, threads=1), Tank(FISH, 2, water=FISH.water, threads=1)
    three.position[1] *= 5.0 * STRETCH_LIMIT
    substeps = round(FISH.control_interval / three.dt)
    for goal in goals:
        three.drive(np.repeat(goal, 3, axis=0), substeps)
        two.drive(np.repeat(goal, 2, axis=0), substeps)
    assert list(three.failure) == ["", FAILURES[TORN], ""]
    assert np.array_equal(three.position[1], FISH.body.position)
    for many, few in zip(three.state, two.state, strict=True):
        assert np.array_equal(many[[0, 2]], few)
