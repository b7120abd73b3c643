"""Results that are published: means over seeds and their intervals, tables, pages and shipped policies."""

import numpy as np
import pytest
from scipy import stats
from trainings import train_short

import fish_env
from benchmarks.common import tables
from benchmarks.common.tables import read_rows
from benchmarks.learning import integrators, publish, transfer
from fish_env.control import load_policy, shipped_policy, statistics
from fish_env.training.config import CONFIGS


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """A folder for the tables; few episodes, few resamples, and no reference trajectories."""
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(tables, "trajectories", dict)
    monkeypatch.setattr(publish, "EPISODES", 3)
    monkeypatch.setattr(statistics, "RESAMPLES", 20)
    return tmp_path


@pytest.mark.parametrize(("hardness", "spread", "noise", "least"), [(0.0, 0.5, 1.0, 24), (1.0, 0.1, 0.3, 25)])
def test_interval_mostly_has_the_true_mean(hardness, spread, noise, least, monkeypatch):
    """Of independent seeds, and of seeds that play the same episodes, some of which are hard for all."""
    monkeypatch.setattr(statistics, "RESAMPLES", 300)
    rng, inside = np.random.default_rng(0), 0
    for _ in range(30):
        hard, levels = rng.normal(0.0, 1.0, 50), rng.normal(3.0, spread, 8)
        scores = [{"return": level + hardness * hard + rng.normal(0.0, noise, 50)} for level in levels]
        value, low, high = statistics.interval(scores, "return", rng)
        assert low < value < high
        inside += low < 3.0 < high
    assert inside >= least


def test_interquartile_mean():
    """It is scipy's trimmed mean where a quarter is whole; what is not finite is left out."""
    values = np.random.default_rng(0).normal(size=12)
    assert statistics.interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))
    assert statistics.interquartile_mean(np.array([1.0, 2.0, np.nan])) == pytest.approx(1.5)


def test_publishing_fills_in_page_and_files(quick, trained, monkeypatch):
    """Publishing writes seeds, methods and curves, ships the median seed, and fills in the table of the page."""
    monkeypatch.setattr(publish, "LEARNING", quick / "learning")
    monkeypatch.setattr(publish, "PRETRAINED", quick / "pretrained")
    monkeypatch.setattr(publish, "SEEDS", 2)
    page, readme = quick / "results.md", quick / "README.md"
    monkeypatch.setattr(publish, "PAGE", page)
    monkeypatch.setattr(publish, "README", readme)
    page.write_text("before <!-- swim --> old <!-- end --> after")
    readme.write_text("<!-- summary -->\nold\n<!-- end -->")
    (quick / "runs/swim").mkdir(parents=True)
    for seed in range(2):
        train_short(seed=seed, folder=quick / f"runs/swim/seed_{seed}")
        (quick / f"runs/swim/seed_{seed}/results.json").write_text("{}")
    publish.publish(quick / "runs", ["swim"])
    text = page.read_text()
    assert "| PPO, 2 seeds |" in text and "old" not in text and text.endswith("after")
    assert "[`Swim-v0`](docs/envs/swim.md)" in readme.read_text() and "old" not in readme.read_text()
    assert load_policy(quick / "pretrained/swim/policy.npz")
    assert [row["seed"] for row in publish.read_stored("seeds")] == ["0", "1"]
    publish.replace_rows("seeds", "turn", [{"seed": 5, "latency": 0.5}])
    publish.replace_rows("seeds", "swim", [{"seed": 7, "speed": 2.0}])
    found = [(row["task"], row["seed"], row["latency"], row["speed"]) for row in publish.read_stored("seeds")]
    assert found == [("swim", "7", "", "2.0"), ("turn", "5", "0.5", "")]
    with pytest.raises(FileNotFoundError, match=r"no run of swim in .* is finished"):
        publish.publish(quick / "nowhere", ["swim"])


def test_another_integrator_is_published(quick, capsys):
    """What was trained with another integrator is measured under it and under the default, in a table of its own."""
    folder = train_short(folder=quick / "swim/seed_0", integrator="semi_implicit", dt=0.002)
    (folder / "results.json").write_text("{}")
    publish.publish_method(quick, "semi_implicit", ["swim"])
    rows = read_rows(quick / "trained_with_semi_implicit.csv")
    assert [row["moved_by"] for row in rows] == ["semi_implicit"] * 3 + ["the default"] * 3
    assert {(row["dt"], row["seeds"]) for row in rows} == {("0.002", "1")}
    text = (quick / "trained_with_semi_implicit.csv").read_text()
    assert "# command: python train.py all --integrator semi_implicit --dt 0.002\n" in text
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| swim")]
    assert len(lines) == 3 and all(line.count("|") == 6 for line in lines) and "speed, BL/s" in lines[0]
    with pytest.raises(FileNotFoundError, match="no run of turn"):
        publish.publish_method(quick, "semi_implicit", ["turn"])


def test_the_pages_hold_what_the_tables_hold():
    """The tables of the page of results and of the README are those of the CSV file; no trained policy has failed."""
    page = publish.PAGE.read_text()
    assert publish.fill_in_tables(page) == page and all(f"<!-- {task} -->" in page for task in CONFIGS)
    assert f"<!-- summary -->\n{publish.summary()}<!-- end -->" in publish.README.read_text()
    assert {float(row["value"]) for row in publish.read_stored("methods") if row["metric"] == "failed"} == {0.0}


def test_integrator_check_sees_a_difference():
    """A policy replayed with the same method does the same; a coarse step shows in return and path."""
    path = shipped_policy("swim")
    fine = integrators.replay(path, ("rk4", 0.0005, None), 3)
    same = integrators.differences(*fine, *fine)
    found = integrators.differences(*integrators.replay(path, ("semi_implicit", 0.00025, None), 3), *fine)
    assert same["failed"] == found["failed"] == 0 and same["path_difference"] == 0.0 < 0.01 < found["path_difference"]
    fish = fish_env.make_fish()
    names = [name for name, _, _ in integrators.settings(fish)]
    assert (fish.integrator, fish.time_step, fish.refine) in integrators.settings(fish)
    fixed = {name for name, record in fish_env.INTEGRATORS.items() if record.kind != "adaptive"}
    assert names[0] == "rk4" and set(names) == fixed


def test_policies_on_other_bodies(monkeypatch):
    """The shipped policy and the motor controllers are measured on each body, with intervals."""
    monkeypatch.setattr(transfer, "SHIPPED", ("swim",))
    monkeypatch.setattr(transfer, "BODIES", {"planar": 2, "mass_spring": 3})
    rows = transfer.shipped_rows()
    found = [(row["body"], row["who"], row["metric"], row["episodes"]) for row in rows]
    assert found == [(body, who, metric, count) for body, count in (("planar", 2), ("mass_spring", 3))
                     for who in ("policy", "motor controllers") for metric in ("speed", "failed")]  # fmt: skip
    for row in rows:
        assert float(row["low"]) <= float(row["mean"]) <= float(row["high"])
        assert row["mean"] == "0" if row["metric"] == "failed" else float(row["mean"]) > 1.0
