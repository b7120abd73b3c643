"""Films of recorded episodes: pages that stand alone and hold what was recorded, and videos of the same pictures."""

import base64
import json
import re
import shutil
import tracemalloc
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("pygame")

from fish_env import __main__ as command_line
from fish_env.control import film, load_policy, load_recording, play, record, shipped_policy, write_film
from fish_env.control.recording import Recording, arrays_of
from fish_env.scene.skin import skin_of


def recorded(id="FishEnv/Target-v0", steps=12, seed=5, **keywords) -> Recording:
    """An episode under random actions."""
    env = gym.make(id, **keywords)
    return record(env, np.random.default_rng(1).uniform(-1.0, 1.0, (steps, *env.action_space.shape)), seed)


def data_of(text):
    """What a page holds."""
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def unpacked(part, *shape):
    """Numbers of 16 bits back to float64."""
    whole = np.frombuffer(base64.b64decode(part["data"]), "<u2").reshape(*shape)
    return np.array(part["low"]) + np.array(part["step"]) * whole


@pytest.fixture(scope="module")
def one():
    """An episode, recorded once."""
    return recorded()


def test_page_stands_alone(one, tmp_path):
    """A page of two episodes is far below 3 MB, and nothing in it is loaded from anywhere."""
    path = write_film([one, recorded(seed=6)], tmp_path / "new" / "film.html")
    text = path.read_text()
    assert 50_000 < len(text) < 400_000
    for loaded in ("http", "//cdn", "src=", "href=", "import(", "import ", "fetch(", "XMLHttp", "url("):
        assert loaded not in text, loaded
    assert text.count("</script>") == 2 and "/*DATA*/" not in text and "/*SCRIPT*/" not in text
    assert [reel["title"] for reel in data_of(text)["reels"]] == ["seed 5", "seed 6"]


def test_page_holds_what_was_recorded(one, tmp_path):
    """Landmarks, centre, targets, return and muscles come back within half a step of 16 bits, the skin as drawn."""
    data = data_of(write_film(one, tmp_path / "film.html").read_text())
    env = gym.make("FishEnv/Target-v0")
    tank, reel = env.unwrapped.tank, data["reels"][0]
    fish, states = tank.fish, one.steps + 1
    assert reel["states"] == states and data["touchable"] and data["task"] == "target"

    def agree(part, wanted):
        step = np.array(part["step"])
        assert (np.abs(unpacked(part, *wanted.shape) - wanted) <= 0.501 * step + 1e-12).all()
        assert (step <= np.ptp(wanted.reshape(-1, wanted.shape[-1]), axis=0).max() / 65535 * 1.001).all()

    agree(reel["points"], fish.points(one.position))
    agree(reel["spheres"], one.spheres)
    agree(reel["centre"], np.einsum("n,tnk->tk", fish.body.mass, one.position) / fish.body.mass.sum())
    agree(reel["gained"], np.concatenate([[0.0], np.cumsum(one.reward)])[:, None])
    env.reset(seed=5)
    for step in range(one.steps):
        env.step(one.action[step])
    shown = np.frombuffer(base64.b64decode(reel["contraction"]), np.uint8).reshape(states, -1)[-1] / 255
    np.testing.assert_allclose(shown, np.clip(tank.contraction[0], 0, 1), atol=0.5 / 255 + 1e-12)
    direction = env.unwrapped.fish._vectors[0, 0]
    np.testing.assert_allclose(
        unpacked(reel["command"], states, 3)[-1], direction / np.linalg.norm(direction), atol=1e-4
    )
    rest = fish.points(fish.body.position)
    skin, wanted_eyes = skin_of(rest, fish.landmarks.faces, fish.landmarks.muscles)
    (surface,) = data["look"]["surfaces"]
    weights = unpacked(surface["weights"], len(skin.weights), len(rest))
    eyes = unpacked(data["look"]["eyes"], 2, len(rest))
    for found, wanted in ((weights, skin.weights), (eyes, wanted_eyes)):
        np.testing.assert_allclose(found @ rest, wanted @ rest, atol=1e-4 * fish.length)
    quads = np.frombuffer(base64.b64decode(surface["faces"]), "<u2").reshape(-1, 4)
    np.testing.assert_array_equal(quads, skin.faces)
    assert rest[data["nose"], 0] == rest[:, 0].max() and rest[data["tail"], 0] == rest[:, 0].min()


@pytest.mark.parametrize("body", ["planar", "tetrahedral"])
def test_other_bodies(body, tmp_path):
    """Flat and solid fish are shown by their landmarks; a page names why the physics failed."""
    one = recorded("FishEnv/Stub-v0", 2, body=body)
    data = data_of(write_film(replace(one, failure=one.failure + 2), tmp_path / "film.html").read_text())
    assert len(data["look"]["surfaces"][0]["weights"]["low"]) == 23 and not data["touchable"]
    assert data["reels"][0]["sphereCount"] == 0 and data["reels"][0]["note"] == "torn"
    assert data["reels"][0]["spheres"]["data"] == ""


def test_long_films_leave_states_out(one, tmp_path, monkeypatch):
    """A page with more states than it may hold shows every so many-th one, at the right time; too large is refused."""
    monkeypatch.setattr(film, "STATES", 5)
    reel = data_of(write_film(one, tmp_path / "film.html").read_text())["reels"][0]
    assert reel["states"] == 5 and reel["interval"] == pytest.approx(3 * 0.02)
    monkeypatch.setattr(film, "LARGEST", 1000)
    with pytest.raises(ValueError, match=r"bytes, more than 1,000; give fewer episodes"):
        write_film(one, tmp_path / "other.html")
    assert not (tmp_path / "other.html").exists()


@pytest.mark.parametrize("look", [{}, {"width": 84, "height": 96, "camera": "follow", "panel": False}])
def test_videos_are_the_pictures_of_the_environment(look, tmp_path, monkeypatch):
    """A recording is drawn as the environment draws itself, and says "half speed", which its video is played at."""
    one = recorded("FishEnv/Avoid-v0", 4, **look)
    env, wanted = gym.make("FishEnv/Avoid-v0", render_mode="rgb_array", **look), []
    env.reset(seed=5)
    env.render()
    for step in range(4):
        env.step(one.action[step])
        wanted.append(env.render())
    written = []
    monkeypatch.setattr(film, "write_video", lambda frames, fps, path: written.extend([frames, fps]))
    write_film(one, tmp_path / "film.gif")
    frames, fps = written
    assert fps == pytest.approx(25) and len(frames) == 4
    words = np.s_[:20, :60] if look else np.s_[15:45, 150:260]
    for frame, picture in zip(frames, wanted, strict=True):
        changed = (frame != picture).any(axis=-1)
        assert changed[words].mean() > 0.1
        changed[words] = False
        assert changed.mean() < 1e-3


def test_mistakes(one, tmp_path, monkeypatch):
    """No recording, recordings of two environments, unknown endings and what no memory holds are refused."""
    monkeypatch.setattr("fish_env.checks.available_memory", lambda: 10 * 3 * 640 * 480)
    monkeypatch.setattr(film, "_pictures", lambda *given: pytest.fail("it was drawn"))
    for recordings, ending, message in (
        ([], ".html", "there are 0 recordings; give at least one"),
        ([one, recorded("FishEnv/Stub-v0", 2)], ".html", r"there are 2 recordings; give .* of one environment"),
        (one, ".avi", r"ends in '.avi'; give a name that ends in .html or .mp4"),
        (one, ".gif", "the number of states of the video is 13, which takes"),
        *((replace(one, about=one.about | {"control_interval": interval}), ending,
           rf"holds a state every {interval} s, and its environment makes one every")
          for interval in (1e-300, 0.021, 5.0) for ending in (".gif", ".html")),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            write_film(recordings, tmp_path / f"film{ending}")


def test_play_and_replay_write_them(tmp_path, capsys):
    """`play` writes a page of its episodes or a recording of one; `replay --save` makes a page of a recording."""
    policy = load_policy(shipped_policy("swim"))
    play(policy, 3, 2, tmp_path / "film.html", max_episode_steps=3)
    data = data_of((tmp_path / "film.html").read_text())
    assert [reel["title"] for reel in data["reels"]] == ["seed 3", "seed 4"]
    assert "episode 1: seconds 0.06" in capsys.readouterr().out
    with pytest.raises(ValueError, match=r"an .npz file holds one episode, not 2; ask for one, or for an .html page"):
        play(policy, 3, 2, tmp_path / "one.npz", max_episode_steps=3)
    play(policy, 3, 1, tmp_path / "one.npz", max_episode_steps=3)
    assert load_recording(tmp_path / "one.npz").steps == 3
    page = tmp_path / "replayed.html"
    assert command_line.main(["replay", str(tmp_path / "one.npz"), "--save", str(page)]) == 0
    assert data_of(page.read_text())["reels"] == data["reels"][:1]


@pytest.mark.slow
def test_in_a_browser(tmp_path):
    """Headless Chromium without network: no message on the console, the fish is seen, and a drag turns the view."""
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright, and install chromium")
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    if browser_path is None:
        pytest.skip("there is no chromium")
    path = write_film([recorded(steps=30), recorded(steps=5, seed=6)], tmp_path / "film.html")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page, said = browser.new_context(offline=True, viewport={"width": 800, "height": 600}).new_page(), []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: said.append(request.url) if request.url != path.as_uri() else None)
        page.goto(path.as_uri())
        page.wait_for_function("film.drawn > 2 && film.time > 0.02")
        page.click("#play")
        assert page.inner_text("#play") == "Play" and page.inner_text("#task") == "Target, seed 5"
        page.fill("#scrub", "20")
        page.wait_for_function(
            "film.time.toFixed(3) == '0.400' && document.getElementById('time').textContent == '0.40'"
        )

        def picture():
            page.wait_for_function(f"film.drawn > {page.evaluate('film.drawn') + 1}")
            return page.screenshot(clip={"x": 200, "y": 150, "width": 400, "height": 300})

        before, (yaw, pitch, distance) = picture(), page.evaluate("[film.yaw, film.pitch, film.distance]")
        assert picture() == before, "a film that is paused stands still"
        page.mouse.move(400, 300)
        page.mouse.down()
        page.mouse.move(500, 350, steps=4)
        page.mouse.up()
        page.mouse.move(420, 300)
        assert page.evaluate("[film.yaw, film.pitch]") == pytest.approx([yaw - 0.8, min(1.55, pitch + 0.4)])
        assert picture() != before
        page.mouse.wheel(0, -200)
        page.wait_for_function(f"film.distance < {distance}")
        page.select_option("#reel", "1")
        page.wait_for_function("document.getElementById('task').textContent == 'Target, seed 6'")
        page.click("#play")
        page.wait_for_function("film.playing && film.time > 0")
        assert not said
        browser.close()


@pytest.mark.parametrize("ending", [".gif", ".html"])
@pytest.mark.parametrize("number", [1e6, 1e300])
@pytest.mark.parametrize("name", ["position", "velocity", "rest_length", "directions", "spheres", "time", "reward"])
def test_numbers_of_any_size(one, name, number, ending, tmp_path):
    """Numbers that no fish has, in a damaged file or one of a stranger, are drawn, or refused in a sentence."""
    shorter = {key: value[-2 if len(value) > one.steps else -1 :] for key, value in arrays_of(one).items()}
    array = shorter[name].copy()
    array.flat[-1] = array.flat[array.size // 2] = number
    strange = replace(one, **shorter | {"variation": one.variation, name: array})
    try:
        write_film(strange, tmp_path / f"film{ending}")
    except ValueError as error:
        assert re.search("too large or too small|add up to", str(error)) and not list(tmp_path.iterdir())
    else:
        if ending == ".html":
            json.dumps(data_of((tmp_path / "film.html").read_text()), allow_nan=False)  # else an error


@pytest.mark.parametrize(("radius", "count"), [(0.15, 1), (100.0, 1), (1e200, 1), (1.0, 26)])
def test_videos_of_large_spheres(one, radius, count, tmp_path):
    """Spheres are drawn with little memory, or refused where they are larger or more than any task has."""
    spheres = np.full((one.steps + 1, count, 4), radius)
    spheres[..., :3] = one.position[:, :1]
    tracemalloc.start()
    try:
        if radius < 1e100 and count * radius**2 <= film.AREA:
            assert write_film(replace(one, spheres=spheres), tmp_path / "film.gif").stat().st_size > 3000
        else:
            with pytest.raises(ValueError, match=r"spheres add up to .* write an \.html page|too large"):
                write_film(replace(one, spheres=spheres), tmp_path / "film.gif")
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()
