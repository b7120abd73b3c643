"""Recordings are replayed bit for bit; films and videos of them stand alone and hold what was recorded."""

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

import fish_env
from fish_env import __main__ as command_line
from fish_env.control import film, load_policy, load_recording, play, record, replay, write_film, write_video
from fish_env.control import recording as recordings
from fish_env.control.evaluation import evaluation_options, policy_controller
from fish_env.control.recording import SHAPES, Recording, arrays_of
from fish_env.scene.skin import skin_of

VARIED = {"stiffness": (0.5, 2.0), "mass": (0.8, 1.2), "drag": 1.3, "current": (0.2, 0.5), "roll": 0.4}
TASKS = ("Swim", "Turn", "LeftAfterRight", "Target", "Avoid", "FastStart")
CASES = [
    *((f"FishEnv/{task}-v0", {"variation": VARIED}, {}) for task in TASKS),
    ("FishEnv/Stub-v0", {}, {}),
    ("FishEnv/Swim-v0", {"muscle_groups": "pairs", "dt": 0.001}, {}),
    pytest.param("FishEnv/Swim-v0", {"integrator": "semi_implicit", "dt": 0.0002}, {}, marks=pytest.mark.slow),
    ("FishEnv/Swim-v0", {"water": {"drag_coefficient": np.float64(1.2)}}, {"mass": 1.3, "current": 0.3}),
    *(pytest.param(f"FishEnv/{task}-v0", {"body": body}, {}, marks=pytest.mark.slow)
      for task in TASKS for body in fish_env.BODIES if body != "mass_spring"),
]  # fmt: skip


def actions(env, steps):
    """Random ones, always the same."""
    return np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *env.action_space.shape))


def recorded(id="FishEnv/Swim-v0", steps=4, seed=5, options=None, **keywords) -> Recording:
    """An episode under random actions."""
    env = gym.make(id, **keywords)
    return record(env, actions(env, steps), seed, options)


@pytest.fixture(scope="module")
def one():
    """An episode with targets, recorded once."""
    return recorded("FishEnv/Target-v0", 12)


@pytest.mark.parametrize(("id", "keywords", "options"), CASES, ids=lambda case: str(case)[:40])
def test_replayed_bit_for_bit(id, keywords, options, tmp_path):
    """Every task, varied fish, a current, other methods and bodies: the file is replayed with the same bits."""
    found = replay(recorded(id, options=options, **keywords).save(tmp_path / "new" / "one.npz"))
    assert found.same and found.steps == 4 and "the same bits in all of 4 environment steps" in str(found)


def test_what_it_holds(tmp_path):
    """The arrays are those that the environment shows, state by state, and come back from the file unchanged."""
    env = gym.make("FishEnv/Avoid-v0", variation=VARIED)
    given = actions(env, 6)
    one = load_recording(record(env, given, 3).save(tmp_path / "one.npz"))
    other = gym.make("FishEnv/Avoid-v0", variation=VARIED)
    other.reset(seed=3)
    tank = other.unwrapped.tank
    for step in range(7):
        np.testing.assert_array_equal(one.position[step], tank.position[0])
        np.testing.assert_array_equal(one.velocity[step], tank.velocity[0])
        np.testing.assert_array_equal(one.rest_length[step], tank.rest_length[0])
        assert one.time[step] == tank.time[0] and one.failure[step] == 0
        if step < 6:
            assert other.step(given[step])[1] == one.reward[step]
    np.testing.assert_allclose(one.terms.sum(axis=1), one.reward, rtol=1e-12)
    np.testing.assert_array_equal(one.action, given)
    np.testing.assert_array_equal(one.variation, tank.variation[0])
    assert one.spheres.shape[2] == 4 and one.directions.shape[0] == 7 and one.steps == 6
    assert one.about["versions"]["numpy"] == np.__version__ and one.about["seed"] == 3
    assert one.about["term_names"][-1] == "failure" and one.about["env_id"] == "FishEnv/Avoid-v0"


def test_policy_and_function():
    """A policy acts as `policy_controller` does; a function sees observations and time; the time limit ends both."""
    policy = load_policy("swim")
    env = gym.make("FishEnv/Swim-v0", max_episode_steps=5, **evaluation_options(policy.about["env_options"]))
    one, seen = record(env, policy, 1), []
    assert one.steps == 5 and replay(one).same
    act = policy_controller(policy, env.unwrapped.fish)
    by_hand = record(env, lambda obs, time: (seen.append(time), act(obs, time))[1], 1, steps=3)
    np.testing.assert_array_equal(by_hand.position, one.position[:4])
    np.testing.assert_allclose(seen, [0.0, 0.02, 0.04])


def test_targets_that_are_replaced():
    """A target that is reached and replaced is drawn again by the replay, from the same generator."""
    env = gym.make("FishEnv/Target-v0", distance=0.8, radius=0.25)
    one = record(env, load_policy("target"), 0, steps=100)
    assert len(np.unique(one.spheres[:, 0], axis=0)) > 1
    assert replay(one).same


@pytest.mark.parametrize("name", [name for name in SHAPES if name != "action"])
def test_changed_bit_is_found(name, one, tmp_path):
    """One changed bit of a state, a reward or a term is found, with its step and place; what comes before agrees."""
    arrays = {key: array.copy() for key, array in arrays_of(one).items()}
    place = (0,) * arrays[name].ndim if name == "variation" else (2, *(0,) * (arrays[name].ndim - 1))
    bits = arrays[name].view(np.int64) if arrays[name].dtype == np.float64 else arrays[name]
    bits[place] ^= 1
    found = replay(Recording(about=one.about, **arrays).save(tmp_path / "changed.npz"))
    step = 0 if name == "variation" else 3 if name in ("reward", "terms", "terminated") else 2
    assert not found.same and found.steps == step
    assert f"after environment step {step} " in found.message and f"in {name}[" in found.message
    assert "the versions are the same" in found.message


def test_changed_action_and_other_versions(one):
    """A changed action is found by the motion that follows, also one that is missing; other versions are named."""
    action = one.action.copy()
    action[1] *= 0.5
    about = one.about | {"versions": one.about["versions"] | {"numpy": "1.0.0"}}
    found = replay(Recording(about=about, **arrays_of(one) | {"action": action}))
    assert found.steps == 2 and f"numpy 1.0.0 then, {np.__version__} now" in found.message
    assert replay(replace(one, action=one.action[:3])).steps == 3


def test_a_large_recording_is_read_again(tmp_path, monkeypatch):
    """One whose numbers hardly differ, and which would shrink more than a file may unpack to, is written as it is."""
    one = recorded("FishEnv/Stub-v0", 2)
    small = one.save(tmp_path / "small.npz").stat().st_size
    for place, number in ((fish_env.control.files, 1000), (recordings, 1000)):
        monkeypatch.setattr(place, "LARGEST", number)
    monkeypatch.setattr(fish_env.control.files, "RATIO", 1)
    with pytest.raises(ValueError, match="unpacks to"):
        load_recording(tmp_path / "small.npz")
    assert load_recording(one.save(tmp_path / "large.npz")).steps == 2
    assert (tmp_path / "large.npz").stat().st_size > 1.5 * small


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (lambda: gym.make("FishEnv/Stub-v0", body=fish_env.make_fish()), {},
         "body.* is a Fish, which a recording cannot hold; .* a body by its name"),
        (lambda: gym.wrappers.ClipAction(gym.make("FishEnv/Stub-v0")), {}, "a wrapper ClipAction, which may change"),
        (lambda: fish_env.FishEnv(task="swim"), {}, "not made by gym.make alone"),
        (lambda: gym.make("CartPole-v1"), {}, "give one fish"),
        (None, {"seed": -1}, "seed is -1"),
        (None, {"options": {"depth": 1.0}}, "unknown reset option"),
        (None, {"policy": np.zeros((2, 11))}, "actions has shape"),
        (None, {"policy": lambda obs, time: np.zeros(3)}, "action"),
        (None, {"steps": 0}, "steps is 0"),
    ],
)  # fmt: skip
def test_what_cannot_be_recorded(make, arguments, message):
    """An environment, keyword, controller or seed that cannot be recorded is refused with the reason."""
    with pytest.raises(ValueError, match=message):
        record(gym.make("FishEnv/Stub-v0") if make is None else make(), **{"policy": np.zeros((2, 12))} | arguments)


# Films


def data_of(path):
    """What a page holds."""
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text(), re.S)[1])


def unpacked(part, *shape):
    """Numbers of 16 bits back to float64."""
    whole = np.frombuffer(base64.b64decode(part["data"]), "<u2").reshape(*shape)
    return np.array(part["low"]) + np.array(part["step"]) * whole


def test_page_stands_alone(one, tmp_path):
    """A page of two episodes is far below 3 MB, and nothing in it is loaded from anywhere."""
    path = write_film([one, recorded("FishEnv/Target-v0", seed=6)], tmp_path / "new" / "film.html")
    text = path.read_text()
    assert 50_000 < len(text) < 400_000
    for loaded in ("http", "//cdn", "src=", "href=", "import(", "import ", "fetch(", "XMLHttp", "url("):
        assert loaded not in text, loaded
    assert text.count("</script>") == 2 and "/*DATA*/" not in text and "/*SCRIPT*/" not in text
    assert [episode["title"] for episode in data_of(path)["reels"]] == ["seed 5", "seed 6"]


def test_page_holds_what_was_recorded(one, tmp_path):
    """Landmarks, centre, targets, return and muscles come back within half a step of 16 bits, the skin as drawn."""
    data = data_of(write_film(one, tmp_path / "film.html"))
    env = gym.make("FishEnv/Target-v0")
    tank, shown = env.unwrapped.tank, data["reels"][0]
    fish, states = tank.fish, one.steps + 1
    assert shown["states"] == states and data["touchable"] and data["task"] == "target"
    for name, wanted in {
        "points": fish.points(one.position),
        "spheres": one.spheres,
        "centre": np.einsum("n,tnk->tk", fish.body.mass, one.position) / fish.body.mass.sum(),
        "gained": np.concatenate([[0.0], np.cumsum(one.reward)])[:, None],
    }.items():
        step = np.array(shown[name]["step"])
        assert (np.abs(unpacked(shown[name], *wanted.shape) - wanted) <= 0.501 * step + 1e-12).all()
        assert (step <= np.ptp(wanted.reshape(-1, wanted.shape[-1]), axis=0).max() / 65535 * 1.001).all()
    env.reset(seed=5)
    for step in range(one.steps):
        env.step(one.action[step])
    contraction = np.frombuffer(base64.b64decode(shown["contraction"]), np.uint8).reshape(states, -1)[-1] / 255
    np.testing.assert_allclose(contraction, np.clip(tank.contraction[0], 0, 1), atol=0.5 / 255 + 1e-12)
    direction = env.unwrapped.fish._vectors[0, 0]
    command = unpacked(shown["command"], states, 3)[-1]
    np.testing.assert_allclose(command, direction / np.linalg.norm(direction), atol=1e-4)
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


@pytest.mark.soft
@pytest.mark.parametrize("body", ["planar", "tetrahedral"])
def test_other_bodies(body, tmp_path):
    """Flat and solid fish are shown by their landmarks; a page names why the physics failed."""
    one = recorded("FishEnv/Stub-v0", 2, body=body)
    data = data_of(write_film(replace(one, failure=one.failure + 2), tmp_path / "film.html"))
    assert len(data["look"]["surfaces"][0]["weights"]["low"]) == 23 and not data["touchable"]
    assert data["reels"][0]["sphereCount"] == 0 and data["reels"][0]["note"] == "torn"


def test_long_films_leave_states_out(one, tmp_path, monkeypatch):
    """A page with more states than it may hold shows every so many-th one, at the right time; too large is refused."""
    monkeypatch.setattr(film, "STATES", 5)
    shown = data_of(write_film(one, tmp_path / "film.html"))["reels"][0]
    assert shown["states"] == 5 and shown["interval"] == pytest.approx(3 * 0.02)
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


def test_what_is_no_film(one, tmp_path, monkeypatch):
    """No recording, recordings of two environments, unknown endings and what no memory holds are refused."""
    monkeypatch.setattr("fish_env.checks.available_memory", lambda: 10 * 3 * 640 * 480)
    monkeypatch.setattr(film, "_pictures", lambda *given: pytest.fail("it was drawn"))
    other = replace(one, about=one.about | {"control_interval": 0.021})
    for given, ending, message in (
        ([], ".html", "there are 0 recordings; give at least one"),
        ([one, recorded("FishEnv/Stub-v0", 2)], ".html", r"there are 2 recordings; give .* of one environment"),
        (one, ".avi", r"ends in '.avi'; give a name that ends in .html or .mp4"),
        (one, ".gif", "the number of states of the video is 13, which takes"),
        (other, ".html", "holds a state every 0.021 s, and its environment makes one every"),
    ):
        with pytest.raises(ValueError, match=message):
            write_film(given, tmp_path / f"film{ending}")


@pytest.mark.parametrize("ending", [".gif", ".html"])
@pytest.mark.parametrize(("name", "number"), [("position", 1e300), ("velocity", 1e300), ("rest_length", 1e300),
                                              ("directions", 1e6), ("spheres", 1e6), ("time", 1e300)])  # fmt: skip
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
            json.dumps(data_of(tmp_path / "film.html"), allow_nan=False)  # else an error


@pytest.mark.parametrize(("radius", "count"), [(0.15, 1), (100.0, 1), (1.0, 26)])
def test_videos_of_large_spheres(one, radius, count, tmp_path):
    """Spheres are drawn with little memory, or refused where they are larger or more than any task has."""
    spheres = np.full((one.steps + 1, count, 4), radius)
    spheres[..., :3] = one.position[:, :1]
    tracemalloc.start()
    try:
        if count * radius**2 <= film.AREA:
            assert write_film(replace(one, spheres=spheres), tmp_path / "film.gif").stat().st_size > 3000
        else:
            with pytest.raises(ValueError, match=r"spheres add up to .* write an \.html page|too large"):
                write_film(replace(one, spheres=spheres), tmp_path / "film.gif")
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()


def test_play_and_replay(tmp_path, capsys):
    """`play` writes a page of its episodes or a recording of one; `replay` prints its finding, and makes a page."""
    policy, path, page = load_policy("swim"), tmp_path / "one.npz", tmp_path / "replayed.html"
    play(policy, 3, 2, tmp_path / "film.html", max_episode_steps=3)
    data = data_of(tmp_path / "film.html")
    assert [episode["title"] for episode in data["reels"]] == ["seed 3", "seed 4"]
    assert "episode 1: seconds 0.06" in capsys.readouterr().out
    with pytest.raises(ValueError, match=r"an .npz file holds one episode, not 2; ask for one, or for an .html page"):
        play(policy, 3, 2, path, max_episode_steps=3)
    play(policy, 3, 1, path, max_episode_steps=3)
    assert command_line.main(["replay", str(path), "--save", str(page)]) == 0
    assert "the same bits" in capsys.readouterr().out and data_of(page)["reels"] == data["reels"][:1]
    one = load_recording(path)
    assert one.steps == 3
    replace(one, reward=one.reward + 1.0).save(path)
    assert command_line.main(["replay", str(path)]) == 1
    assert "differs first after environment step 1 (0.02 s), in reward[0]" in capsys.readouterr().out
    assert command_line.main(["replay", str(tmp_path / "missing.npz")]) == 2
    assert "there is no recording" in capsys.readouterr().err


@pytest.mark.parametrize(("interval", "count"), [(0.02, 1), (0.04, 7), (0.0175, 40)])
@pytest.mark.parametrize("ending", [".mp4", ".webp", ".gif"])
def test_videos(ending, interval, count, tmp_path, monkeypatch):
    """A video has every picture, of half the size where it moves, and replaces another one only when complete."""
    moviepy, pictures = pytest.importorskip("moviepy"), pytest.importorskip("PIL.Image")
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    frames = [np.full((240, 400, 3), 200, dtype=np.uint8) for _ in range(count)]
    for k, frame in enumerate(frames):  # equal pictures would be one that is shown longer
        frame[80:160, 8 * k : 8 * k + 80] = (20, 90, 180)
    path = tmp_path / f"video{ending}"
    path.write_bytes(b"before")
    with monkeypatch.context() as patch:
        patch.setattr(moviepy.ImageSequenceClip, "write_videofile", lambda *a, **k: 1 / 0)
        patch.setattr(pictures.Image, "save", lambda *a, **k: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            write_video(frames, 1.0 / interval, path)
    assert path.read_bytes() == b"before"
    write_video(frames, 1.0 / interval, path)
    assert path.stat().st_size < 20_000 and list(tmp_path.iterdir()) == [path]
    if ending == ".mp4":
        assert ffmpeg.count_frames_and_secs(path)[0] == count
        return
    with pictures.open(path) as found:
        assert found.size == (200, 120) and found.n_frames == count
        assert count == 1 or found.info["loop"] == 0  # without end
        found.seek(count // 2)
        found.load()
        blue = np.asarray(found.convert("RGB"))[60, 4 * (count // 2) + 20].astype(int)
        assert np.abs(blue - (20, 90, 180)).max() < 30


@pytest.mark.slow
def test_in_a_browser(tmp_path):
    """Headless Chromium without network: no message on the console, the fish is seen, and a drag turns the view."""
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright, and install chromium")
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    if browser_path is None:
        pytest.skip("there is no chromium")
    episodes = [recorded("FishEnv/Target-v0", steps, seed) for steps, seed in ((30, 5), (5, 6))]
    path = write_film(episodes, tmp_path / "film.html")
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=flags)
        page, printed = browser.new_context(offline=True, viewport={"width": 800, "height": 600}).new_page(), []
        page.on("console", lambda message: printed.append(message.text))
        page.on("pageerror", lambda error: printed.append(str(error)))
        page.on("request", lambda request: printed.append(request.url) if request.url != path.as_uri() else None)
        page.goto(path.as_uri())
        page.wait_for_function("film.drawn > 2 && film.time > 0.02")
        page.click("#play")
        assert page.inner_text("#play") == "Play" and page.inner_text("#task") == "Target, seed 5"
        page.fill("#scrub", "20")
        page.wait_for_function("document.getElementById('time').textContent == '0.40'")

        def picture():
            page.wait_for_function(f"film.drawn > {page.evaluate('film.drawn') + 1}")
            return page.screenshot(clip={"x": 200, "y": 150, "width": 400, "height": 300})

        before, (yaw, pitch, distance) = picture(), page.evaluate("[film.yaw, film.pitch, film.distance]")
        assert picture() == before, "a film that is paused stands still"
        page.mouse.move(400, 300)
        page.mouse.down()
        page.mouse.move(500, 350, steps=4)
        page.mouse.up()
        assert page.evaluate("[film.yaw, film.pitch]") == pytest.approx([yaw - 0.8, min(1.55, pitch + 0.4)])
        assert picture() != before
        page.mouse.wheel(0, -200)
        page.wait_for_function(f"film.distance < {distance}")
        page.select_option("#reel", "1")
        page.wait_for_function("document.getElementById('task').textContent == 'Target, seed 6'")
        page.click("#play")
        page.wait_for_function("film.playing && film.time > 0")
        assert not printed
        browser.close()
