"""The survey of stable steps, and the worst that attacks found, done again."""

import naive
import numpy as np
import pytest
from moving import tiered

from benchmarks.common.tables import read_table
from benchmarks.stability import attack, attack_search, cases, mistreatment, survey
from fish_env import BODIES, make_fish
from fish_env.bodies.mass_spring import LAYERS
from fish_env.physics.failures import FAILURES, STRETCH_LIMIT

FISH = make_fish()
CASES = cases.stored()
OTHERS = [pytest.mark.slow]
each_case = pytest.mark.parametrize(
    "case", [pytest.param(case, marks=OTHERS * (case["body"] != FISH.name)) for case in CASES.values()], ids=CASES
)


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


@pytest.mark.slow
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


@pytest.mark.parametrize("name", tiered(BODIES, (FISH.name,)))
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
