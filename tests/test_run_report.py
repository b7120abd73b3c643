"""Reports of training runs: what they measure is right, and the pages hold it and stand alone."""

import json
import re
import shutil
from dataclasses import asdict, replace

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from fish_env.control import evaluate, make_policy_env, record, shipped_policy
from fish_env.training import run_charts, run_measures, run_report
from fish_env.training.config import CONFIGS


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The files that a report reads, of two runs that differ in their seeds and of one with another learning rate."""
    root = tmp_path_factory.mktemp("runs")
    for name, seed, rate, gain in (("seed0", 0, 1e-3, 1.0), ("seed1", 1, 1e-3, 1.5), ("other", 1, 5e-4, 3.0)):
        (root / name).mkdir()
        config = replace(CONFIGS["swim"], timesteps=5000, learning_rate=rate)
        command = f"fish_env train swim --seed {seed} --timesteps 5000"
        saved = {
            "task": "swim",
            "seed": seed,
            "config": asdict(config),
            "command": command,
            "commit": "-",
            "start": None,
        }
        (root / name / "config.json").write_text(json.dumps(saved))
        shutil.copy(shipped_policy("swim"), root / name)
        rows = [f"{1000 * k},{k},10,{gain * k},{2 * gain * k}" for k in range(1, 6)]
        (root / name / "curve.csv").write_text("\n".join(["timesteps,seconds,episodes,score,return", *rows, ""]))
    return root


def sections(text):
    """The text of a page by its headings."""
    parts = re.split(r"<h2>(.*?)</h2>", text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_page_of_a_run(runs):
    """One run: settings, metrics, curve, failures, path, gait and film; nothing is loaded."""
    path = run_report.write_report([runs / "seed0"], episodes=3)
    assert path == runs / "seed0" / "report.html"
    text = path.read_text()
    found = sections(text)
    assert list(found) == ["swim: results", "Learning curves", "Cost of transport", "Failures", "Path", "Gait", "Film"]
    for name in ("Learning curves", "Cost of transport", "Path", "Gait"):
        assert "<svg" in found[name], name
    assert "speed, body lengths/s, in training" in found["Learning curves"]
    assert "fish_env train swim --seed 0 --timesteps 5000" in text and "<td>learning_rate</td>" in text
    assert "seed 0: none of 3 episodes" in found["Failures"]
    assert "srcdoc=" in found["Film"] and "film_player" not in found["Film"]
    for loaded in ("http", 'src="', "@import", "<link"):
        assert loaded not in text, loaded
    assert len(text) < 3_000_000
    policy = run_measures.read_run(runs / "seed0").policy
    env = make_policy_env(policy, 3)
    speed = evaluate(env, policy)["speed"].mean()
    assert f"<td>speed</td><td class=number>{speed:.3f} (" in found["swim: results"]


def test_page_of_several_runs(runs, tmp_path):
    """Seeds are put together, other settings are named, and every chart shows both groups."""
    path = run_report.write_report([runs / name for name in ("seed0", "other", "seed1", "seed0")], episodes=2)
    assert path == runs / "report.html"
    text = path.read_text()
    found = sections(text)
    assert "3 training runs" in text and "<iframe" not in text
    assert found["swim: the runs"].count("<tr>") == 4 and "<td>learning_rate 0.001</td>" in found["swim: the runs"]
    assert "learning_rate 0.001 (2 seeds)" in found["swim: results"]
    for name in ("Learning curves", "Cost of transport", "Path", "Gait"):
        assert "learning_rate 0.0005" in found[name] and "learning_rate 0.001" in found[name], name
    assert run_report.write_report([runs / "seed0", runs / "seed1"], tmp_path / "new" / "two.html", 2).exists()
    assert "all seeds (2 seeds)" in (tmp_path / "new" / "two.html").read_text()


def test_no_run(runs, tmp_path):
    """A folder that is no run, and one whose files are damaged, are refused with the reason; no page is written."""
    bad = tmp_path / "bad"

    def refused(message, folders=(bad,), **options):
        with pytest.raises(ValueError, match=message):
            run_report.write_report(folders, tmp_path / "page.html", **{"episodes": 2} | options)

    refused("bad is not a training run: it is not a folder")
    bad.mkdir()
    refused("bad is not a training run: it holds no config.json, curve.csv, policy.npz; give a folder that")
    for name in ("config.json", "policy.npz", "curve.csv"):
        shutil.copy(runs / "seed0" / name, bad)
    good = (bad / "config.json").read_text()
    for text, message in (("{", "config.json cannot be used"), ("[]", "not a mapping"),
                          (good.replace('"task": "swim"', '"task": "fly"'), "unknown task 'fly'"),
                          (good.replace("Swim-v0", "Turn-v0"), "'FishEnv/Turn-v0' is not that of a task 'swim'"),
                          (good.replace("FishEnv/Swim-v0", "os:Swim-v0"), "'os:Swim-v0' is not that of"),
                          (good.replace("Swim-v0", "Turn-v0").replace('"swim"', '"turn"'),
                           "was trained for FishEnv/Swim-v0")):  # fmt: skip
        (bad / "config.json").write_text(text)
        refused(message)
    (bad / "config.json").write_text(good)
    (bad / "curve.csv").write_text("timesteps,seconds\n1,2\n")
    refused("its head is 'timesteps,seconds'")
    (bad / "curve.csv").write_text("timesteps,seconds,episodes,score,return\n")
    assert run_report.write_report([bad], tmp_path / "empty.html", 2).exists()  # interrupted before the first row
    refused("--episodes is 0", episodes=0)
    refused("there is no folder", [])
    with pytest.raises(ValueError, match=r"give a name that ends in .html"):
        run_report.write_report([bad], tmp_path / "page.pdf", 2)
    assert not (tmp_path / "page.html").exists()


def test_score_of_an_environment_of_another_package():
    """Its score is the return."""
    curve = {"timesteps": np.array([100.0, 200.0]), "score": np.ones(2), "return": np.ones(2)}
    assert run_charts.draw_learning_curves([("mine", [curve])], "return").count("return, per episode, in training") == 2


def test_too_many_groups(runs, monkeypatch):
    """More groups than colours are refused instead of being left out."""
    monkeypatch.setattr(run_charts, "COLOURS", run_charts.COLOURS[:1])
    with pytest.raises(ValueError, match="2 different settings; compare at most 1"):
        run_report.write_report([runs / "seed0", runs / "other"], episodes=2)


def test_failures_are_counted_and_listed(runs):
    """Episodes that the physics ended are counted, and the worst ones are listed with their seeds."""
    group = run_report.measure_group("a", [run_measures.read_run(runs / "seed0")], 3)
    scores = group.episodes[0]
    assert not scores["failed"].any()
    failing = scores | {"failed": np.array([1.0, 0.0, 1.0])}
    text = run_report.list_failures(replace(group, episodes=[failing, failing]))
    assert "a: 4 of 6 episodes were ended by a failure" in text and "class=bad" in text
    assert all(f">{1_000_000 + k}<" in text for k in range(3))


def test_motion_of_a_stiff_fish():
    """A stiff fish that is carried about has the path, the heading and the tail that it was given."""
    env = gym.make("FishEnv/Swim-v0")
    fish = env.unwrapped.tank.fish
    one = record(env, np.zeros((40, 12)), 1)
    angle = np.linspace(0.2, 0.2 + 1.5 * np.pi, 41)  # past half a turn
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.zeros((41, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, -sin, sin, cos, 1.0
    centre = np.column_stack([np.linspace(0, 1, 41), np.linspace(0, -2, 41) ** 2, np.zeros(41)]) * fish.length
    rest = fish.body.position - fish.body.mass @ fish.body.position / fish.body.mass.sum()
    bent = rest.copy()
    bent[fish.tail, 1] += 0.1 * fish.length
    bent_centre = fish.body.mass @ bent / fish.body.mass.sum()
    one.position[:] = np.einsum("tij,nj->tni", turn, bent) + centre[:, None]
    one.directions[:, 0] = (0.0, 1.0, 0.0)
    found = run_measures.measure_motion(one, fish)
    middle = (np.einsum("tij,j->ti", turn, bent_centre) + centre)[:, :2] / fish.length
    moved = middle - middle[0]
    np.testing.assert_allclose(found.path, np.column_stack([moved[:, 1], -moved[:, 0]]), atol=1e-12)  # +x is +y
    order, names = run_report.order_muscles(fish)
    assert sorted(order) == list(range(12)) and names[0] == "Lu 1" and names[-1] == "Rl 3"
    assert (fish.sides[order[:6]] > 0).all()


def test_command(runs, monkeypatch, capsys, tmp_path):
    """`fish_env report` writes the page and says where; a folder that is no run is answered in one line."""
    train = pytest.importorskip("train")
    page = tmp_path / "page.html"
    arguments = ["train.py", "report", str(runs / "seed0"), "--episodes", "2", "--save", str(page)]
    monkeypatch.setattr("sys.argv", arguments)
    assert train.main() == 0 and page.exists()
    assert f"written to {page}" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["train.py", "report", str(tmp_path)])
    assert train.main() == 2
    assert "is not a training run: it holds no config.json" in capsys.readouterr().err


@pytest.mark.slow
def test_in_a_browser(runs, tmp_path):
    """Headless Chromium without network: no message on the console, charts of the page's width, and the film plays."""
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright, and install chromium")
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    if browser_path is None:
        pytest.skip("there is no chromium")
    path = run_report.write_report([runs / "seed0"], tmp_path / "page.html", 2)
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page = browser.new_context(offline=True, viewport={"width": 1000, "height": 800}).new_page()
        said = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto(path.as_uri())
        widths = page.eval_on_selector_all("svg", "found => found.map(one => one.getBoundingClientRect().width)")
        assert len(widths) == 4 and min(widths) > 900
        film = page.frames[1]
        film.wait_for_function("film.drawn > 2 && film.time > 0.02")
        assert not said
        browser.close()
