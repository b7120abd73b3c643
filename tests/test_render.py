"""Pictures: their shape and content, the window, and the tools of Gymnasium that use them."""

import os
import pickle
import subprocess
import sys
import warnings
from functools import partial
from types import SimpleNamespace

import gliding  # noqa: F401 - registers
import gymnasium as gym
import moviepy
import numpy as np
import pygame
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import AddRenderObservation, RecordVideo
from moving import tiered

from fish_env import make_sb3_vec_env
from fish_env.control import write_video
from fish_env.envs.options import CAMERAS
from fish_env.render import Format, Frame, Renderer, WindowClosed, draw, make_frame
from fish_env.render.labels import CENTRE, HEIGHT, PANEL, UNIT, WIDTH
from fish_env.scene.frame import Arrow, Body, command_arrows
from fish_env.scene.look import look_of
from fish_env.scene.skin import normals, skin_of
from fish_env.soft.objects import OBJECTS

STUB = "FishEnv/Stub-v0"


@pytest.fixture
def batch():
    """Two stub fish that have swum a little."""
    env = gym.make_vec(STUB, 2, vectorization_mode="vector_entry_point", render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    yield env.unwrapped
    env.close()


@pytest.fixture
def window(monkeypatch):
    """Windows open on SDL's dummy display, and none is left behind."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    yield
    pygame.display.quit()


def run_python(code, **changes):
    """Run code in a fresh interpreter; an environment variable changed to None is unset."""
    variables = {name: value for name, value in {**os.environ, **changes}.items() if value is not None}
    return subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, timeout=300)


def contracted(frame, value):
    """The frame with every muscle contracted by the same value, or by values (M,)."""
    (body,) = frame.bodies
    return frame._replace(bodies=[body._replace(contraction=np.broadcast_to(value, body.contraction.shape))])


def commanded(frame, command):
    """The frame with the arrow of a command (3,)."""
    return frame._replace(arrows=command_arrows(frame.middle, command, frame.length, frame.spheres, frame.touchable))


def with_sphere(frame, offset, radius, touchable):
    """The frame without command and with one sphere, offset (3,) body lengths from the fish, radius in body lengths."""
    centre = frame.middle + np.multiply(offset, frame.length)
    return frame._replace(arrows=[], spheres=np.array([[*centre, radius]]), touchable=touchable)


def at_rest(frame, fish):
    """The frame with its fish at rest at the origin, nose towards x, and no path."""
    body = frame.bodies[0]._replace(position=fish.body.position)
    return frame._replace(bodies=[body], middle=fish.points(fish.body.position).mean(axis=0), path=np.zeros((0, 3)))


def test_one_picture_a_fish(batch):
    """rgb_array: an (H,W,3) uint8 array for each fish, all different; the same state gives the same pixels."""
    pictures = batch.render()
    assert isinstance(pictures, tuple) and len(pictures) == 2
    for picture in pictures:
        assert picture.shape == (HEIGHT, WIDTH, 3) and picture.dtype == np.uint8
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 1000
    assert not np.array_equal(*pictures)
    for again in (batch.render(), Renderer(batch).render()):
        assert all(np.array_equal(a, b) for a, b in zip(pictures, again, strict=True))


@pytest.mark.parametrize("side", [1, -1])
def test_the_right_side_turns_red(batch, side):
    """Seen from above, contracted left muscles are red to the left of the fish's axis, right ones to its right."""
    fish = batch.tank.fish
    frame = at_rest(make_frame(batch, 0), fish)  # nose to the right
    relaxed = draw(contracted(frame, 0.0)).astype(int)
    tense = draw(contracted(frame, (fish.sides == side).astype(float))).astype(int)
    changed = (relaxed != tense).any(axis=2)
    redness = (tense - relaxed) @ (2, -1, -1)
    assert 100 < changed.sum() < 0.1 * changed.size and redness[changed].mean() > 50
    rows, _ = np.nonzero(redness[: PANEL.top - 5] > 60)
    assert len(rows) > 20
    assert (np.sign(CENTRE[1] - 0.5 - rows) == side).mean() > 0.95


def test_skin_faces_out_and_keeps_the_ends(batch):
    """The skin encloses its volume whichever way round the faces are given, and passes through nose and tail tips."""
    fish = batch.tank.fish
    rest, faces, muscles = fish.body.position, fish.body.faces.nodes, fish.body.springs.nodes[fish.muscles]
    for given in (faces, faces[:, ::-1]):
        skin, _ = skin_of(rest, given, muscles)
        points, closed = skin.weights @ rest, skin.faces[: skin.closed]
        middle = points[closed].mean(axis=1)
        outward = (normals(points, closed) * middle * (0, 1, 1)).sum(axis=1)
        assert (outward > 0).mean() > 0.95
        np.testing.assert_allclose(skin.weights.sum(axis=1), 1.0, atol=1e-9)
        for end in (fish.nose, *fish.tail):
            assert np.linalg.norm(points[: skin.weights.shape[0]] - rest[end], axis=1).min() < 1e-6 * fish.length


def test_path_grows_and_is_forgotten(batch):
    """The path is drawn, gains a point with every new place, and is forgotten by the fish that restart."""
    batch.render()
    for _ in range(40):
        batch.step(np.ones(batch.action_space.shape, dtype=np.float32))
        batch.render()
    renderer = batch._renderer
    assert [len(path) for path in renderer._paths] == [41, 41]
    swum = make_frame(batch, 1, renderer.path(1))
    assert not np.array_equal(draw(swum), draw(swum._replace(path=swum.path[-1:])))
    batch.reset(seed=3, options={"reset_mask": np.array([True, False])})
    assert [len(path) for path in renderer._paths] == [0, 41]


def test_solid_spheres_hide_what_is_below(batch):
    """From above, a stone over the fish veils it and one under it does not; a target never does."""
    frame = make_frame(batch, 0)._replace(arrows=[])
    for height, touchable, hidden in ((0.3, False, True), (-0.3, False, False), (0.3, True, False)):
        with_it = with_sphere(frame, (0.0, 0.0, height), 0.2, touchable)
        tense, relaxed = (draw(contracted(with_it, value)).astype(int) for value in (1.0, 0.0))
        bare = draw(contracted(frame, 1.0)).astype(int) - draw(contracted(frame, 0.0))
        near = np.s_[CENTRE[1] - 20 : CENTRE[1] + 20, CENTRE[0] - 20 : CENTRE[0] + 20]
        share = np.abs(tense - relaxed)[near].sum() / np.abs(bare)[near].sum()
        assert share < 0.6 if hidden else share > 0.9


@pytest.mark.parametrize("name", ["Target", "Avoid"])
def test_tasks_show_their_spheres(name):
    """Target shows where its target is; Avoid an obstacle once it has appeared; both only one arrow."""
    env = gym.make_vec(f"Gliding/{name}-v0", 2, vectorization_mode="vector_entry_point").unwrapped
    env.reset(seed=0)
    task = env.task
    if name == "Avoid":
        assert make_frame(env, 1).spheres.shape == (0, 4)
        task.present[1], task.obstacle[1] = True, (0.1, 0.2, 0.3)
        assert make_frame(env, 0).spheres.shape == (0, 4)
    frame = make_frame(env, 1)
    way = env._pose.centre[1] + task.vectors(env.tank, env._pose)[1, -1] * frame.length
    where = way if name == "Target" else (0.1, 0.2, 0.3)
    np.testing.assert_allclose(frame.spheres, [[*where, task.radius]], atol=1e-12)
    assert frame.touchable == (name == "Target") and len(frame.arrows) == 1
    env.close()


def test_no_arrow_past_the_target(batch):
    """Near a target no arrow is drawn, which would point from beyond it."""
    for distance, shown in ((0.5, False), (1.2, True)):
        silent = with_sphere(make_frame(batch, 0), (0.0, distance, 0.0), 0.15, True)
        assert shown == bool(commanded(silent, (0.0, distance, 0.0)).arrows)


@pytest.mark.parametrize("name", OBJECTS)
def test_draws_objects(name):
    """Elastic objects are drawn from the same record, where they are."""
    thing = OBJECTS[name].make()
    look, x = look_of(thing), thing.body.position
    bare = draw(Frame([Body(look, x + 99.0)], np.zeros(3), []))
    places = []
    for shift in (0.0, 0.2 * thing.length):
        rows, columns = np.nonzero(
            (draw(Frame([Body(look, x + shift * np.eye(3)[0])], np.zeros(3), [])) != bare).any(2)
        )
        assert len(rows) > (200 if name == "string" else 2000)
        places.append(columns.mean())
    assert places[1] - places[0] == pytest.approx(0.2 * UNIT, abs=0.12 * UNIT)


def turned(frame, angle):
    """The frame with the world turned about the vertical, counter-clockwise from above."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)])
    spheres = np.column_stack([frame.spheres[:, :3] @ turn, frame.spheres[:, 3]])
    bodies = [body._replace(position=body.position @ turn) for body in frame.bodies]
    arrows = [Arrow(arrow.start @ turn, arrow.way @ turn) for arrow in frame.arrows]
    return frame._replace(bodies=bodies, arrows=arrows, spheres=spheres, middle=frame.middle @ turn)


def place_of_change(before, after, form):
    """Where two pictures differ: to the right of and above the middle, body lengths; None if nowhere."""
    rows, columns = np.nonzero((before != after).any(axis=2))
    if not len(rows):
        return None
    return np.array([columns.mean() + 0.5 - form.width / 2, form.height / 2 - rows.mean() - 0.5]) / form.unit


SEEN = {  # to the right and upwards in the picture: what is ahead of the fish, to its left, and above it
    "above": ((1, 0), (0, 1), (0, 0)),
    "follow": ((0, 1), (-1, 0), (0, 0)),
    "side": ((1, 0), (0, 0), (0, 1)),
}


@pytest.mark.parametrize("size", [(84, 84), (240, 180)])
@pytest.mark.parametrize("camera", CAMERAS)
def test_cameras(batch, camera, size):
    """A target and a command are where the camera sees them; those of "follow" and "side" turn with the fish."""
    form, fish = Format(*size, camera, panel=False), batch.tank.fish
    frame = at_rest(make_frame(batch, 0), fish)._replace(arrows=[], touchable=True)
    middle = frame.middle
    for angle in (0.0, 2.0):
        bare = draw(turned(frame, angle), form)
        assert bare.shape == (*size[::-1], 3)
        assert np.array_equal(bare, draw(turned(frame, angle)._replace(time=9.0, speed=9.0, task="a task"), form))
        turn = angle if camera == "above" else 0.0
        back = np.array([(np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))])
        for way, seen in zip(np.eye(3), SEEN[camera], strict=True):
            target = frame._replace(spheres=np.array([[*(middle + 0.7 * fish.length * way), 0.15]]))
            found = place_of_change(bare, draw(turned(target, angle), form), form)
            np.testing.assert_allclose(found, 0.7 * back @ seen, atol=0.05)
            found = place_of_change(bare, draw(turned(commanded(frame, way), angle), form), form)
            if any(seen):
                np.testing.assert_allclose(found, 0.66 * back @ seen, atol=0.05)
            else:
                assert found is None


@pytest.mark.parametrize("size", [(320, 240), (1280, 500), (480, 640)])
def test_panel_of_any_size(batch, size):
    """Numbers, scale and second view lie in their corners, and the bar of the scale is a body length."""
    frame, form = make_frame(batch, 0), Format(*size)
    changed = (draw(frame, form) != draw(frame, form._replace(panel=False))).any(axis=2)
    rows, columns = size[1] // 4, size[0] // 4
    assert all(part.any() for part in (changed[:rows, :columns], changed[-rows:, :columns], changed[-rows:, -columns:]))
    dark = (draw(frame, form)[-rows:, : size[0] * 2 // 3] < 130).all(axis=2)
    assert abs(dark.sum(axis=1).max() - form.unit) < 0.05 * form.unit


def test_pictures_as_observations():
    """Keywords of the environment choose the picture, which Gymnasium's wrapper makes the observation."""
    look = {"width": 84, "height": 96, "camera": "follow", "panel": False}
    env = AddRenderObservation(gym.make(STUB, render_mode="rgb_array", **look))
    assert env.observation_space.shape == (96, 84, 3) and env.unwrapped.fish.picture == look
    first, _ = env.reset(seed=0)
    obs, *_ = env.step(np.ones(env.action_space.shape, dtype=np.float32))
    assert env.observation_space.contains(obs) and np.array_equal(obs, env.render()) and (obs != first).any()


@pytest.mark.parametrize("keywords", [
    {"width": 31}, {"height": 84.0}, {"width": 4097}, {"camera": "below"}, {"camera": None}, {"panel": 1},
    {"width": 84, "height": 84},
])  # fmt: skip
def test_pictures_that_are_refused(keywords):
    """Sizes and cameras that are not allowed are refused, in one line that says what is."""
    said = r"from 32 to 4096|'above', 'side', 'follow'|True or False|give panel=False, or .* at least 320 and 240"
    with pytest.raises(ValueError, match=rf"^[^\n]*({said})[^\n]*$"):
        gym.make(STUB, **keywords)


DISPLAYS = """
import sys, gymnasium, fish_env
assert "pygame" not in sys.modules, "pygame"
env = gymnasium.make("FishEnv/Stub-v0", render_mode="{mode}")
env.reset(seed=0)
env.step(env.action_space.sample())
picture = env.render()
import pygame
print(pygame.display.get_init(), pygame.display.get_init() and pygame.display.get_driver())
print((picture if picture is not None else pygame.surfarray.array3d(pygame.display.get_surface())).std() > 10)
env.close()
print(pygame.display.get_init())
"""


@pytest.mark.parametrize(
    ("mode", "driver", "said"),
    [("rgb_array", None, "False False True False"), ("human", "dummy", "True dummy True False")],
)
def test_without_a_display(mode, driver, said):
    """Importing is pygame-free. rgb_array starts no display; a window is drawn where SDL has none (dummy)."""
    code = DISPLAYS.format(mode=mode)
    done = run_python(code, DISPLAY=None, WAYLAND_DISPLAY=None, SDL_VIDEODRIVER=driver)
    assert done.stdout.split()[-4:] == said.split(), done.stderr


def test_missing_pygame_says_what_to_install():
    """Without pygame the error names the extra that brings it."""
    done = run_python("import sys; sys.modules['pygame'] = None; import fish_env.render")
    assert "DependencyNotInstalled" in done.stderr and 'pip install "fish_env[render]"' in done.stderr


def test_no_window_is_explained(batch, monkeypatch):
    """Where no window can be opened, the error says what to do instead."""
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "nosuchdriver")
    monkeypatch.setitem(vars(batch), "render_mode", "human")
    with pytest.raises(RuntimeError, match="rgb_array"):
        batch.render()


@pytest.mark.parametrize("num_fish", [1, 3, 6])
def test_window(window, num_fish):
    """human: render returns None, shows up to four fish in a grid, and close takes the window away."""
    env = gym.make_vec(STUB, num_fish, vectorization_mode="vector_entry_point", render_mode="human")
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))  # shows by itself
    screen = pygame.display.get_surface()
    assert env.unwrapped.render() is None
    assert screen.get_size() == {1: (WIDTH, HEIGHT), 3: (2 * WIDTH, 2 * HEIGHT), 6: (2 * WIDTH, 2 * HEIGHT)}[num_fish]
    shown = pygame.surfarray.array3d(screen).transpose(1, 0, 2)
    vars(env.unwrapped)["render_mode"] = "rgb_array"
    pictures = env.unwrapped.render()
    assert np.array_equal(shown[:HEIGHT, :WIDTH], pictures[0])
    if num_fish > 2:
        assert np.array_equal(shown[HEIGHT:, :WIDTH], pictures[2])
    env.close()
    assert not pygame.display.get_init()


def test_window_of_a_vec_env(window, monkeypatch):
    """human: Stable-Baselines3's batch shows the fish after a reset and after every step, too."""
    shown, render = [], Renderer.render
    monkeypatch.setattr(Renderer, "render", lambda self: shown.append(1) or render(self))
    env = make_sb3_vec_env(STUB, 2, seed=0, render_mode="human", max_episode_steps=2)
    env.reset()
    for _ in range(3):
        env.step(np.zeros((2, 12)))
    assert len(shown) == 4
    env.close()


def test_window_keeps_to_real_time(window, monkeypatch):
    """human: pictures come no faster than the control intervals they show."""
    rates = []
    monkeypatch.setattr(pygame.time, "Clock", lambda: SimpleNamespace(tick=rates.append))
    env = gym.make(STUB, render_mode="human", control_interval=0.04)
    env.reset(seed=0)
    env.step(np.zeros(12, dtype=np.float32))
    assert set(rates) == {25.0}
    env.close()


@pytest.mark.parametrize("event", [{"type": pygame.QUIT}, {"type": pygame.KEYDOWN, "key": pygame.K_ESCAPE}, None])
def test_closing_the_window(window, event):
    """The user's closing the window is an error that can be caught, another library's is none; a new one opens."""
    env = gym.make(STUB, render_mode="human")
    env.reset(seed=0)
    if event is None:
        pygame.quit()
    else:
        pygame.event.post(pygame.event.Event(event.pop("type"), **event))
        with pytest.raises(WindowClosed):
            env.step(np.zeros(12, dtype=np.float32))
        assert not pygame.display.get_init()
    env.step(np.zeros(12, dtype=np.float32))
    assert pygame.display.get_init()
    env.close()


def test_render_before_reset():
    """A picture before the first reset is refused as Gymnasium refuses it."""
    env = gym.make_vec(STUB, 1, vectorization_mode="vector_entry_point", render_mode="rgb_array")
    with pytest.raises(gym.error.ResetNeeded):
        env.unwrapped.render()


@pytest.mark.parametrize("name", tiered(("Stub", "Swim"), ("Stub",)))
def test_check_env(window, name):
    """Gymnasium's checker, with its check of every render mode, has no complaint."""
    env = gym.make(f"FishEnv/{name}-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("fps", [0.67, 30])
def test_videos_of_any_rate(window, fps, tmp_path):
    """Gymnasium's `RecordVideo` and the package's own writer take any rate: a frame a step, and one before."""
    inner = gym.make(STUB, render_mode="rgb_array")
    inner.unwrapped.metadata["render_fps"] = fps
    env = RecordVideo(inner, str(tmp_path / "gymnasium"), disable_logger=True)
    env.reset(seed=0)
    for _ in range(11):
        env.step(env.action_space.sample())
    frames = [inner.render()] * 12
    env.close()
    for ending in ("mp4", "gif", "webp"):
        write_video(frames, fps, tmp_path / f"own.{ending}")
    paths = list(tmp_path.rglob("*.mp4"))
    assert len(paths) == 2
    for path in paths:
        with moviepy.VideoFileClip(str(path)) as clip:
            assert clip.fps == pytest.approx(fps, rel=0.01) and clip.size == [WIDTH, HEIGHT]
            assert abs(clip.n_frames - 12) <= 1  # moviepy counts by duration, which it rounds


@pytest.mark.parametrize("interval", [0.4, 1.5, 0.02, 0.035])
def test_rate_of_pictures(interval):
    """The rate of pictures is the exact inverse of the control interval, in every kind of environment."""
    interval = round(800 * interval) / 800
    for make in (gym.make, partial(gym.make_vec, num_envs=2), partial(make_sb3_vec_env, monitor=False)):
        assert make(STUB, control_interval=interval).metadata["render_fps"] == 1.0 / interval


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_lists_of_pictures(window, mode):
    """`render_mode="rgb_array_list"` gives what Gymnasium's batch of single fish gives: as many pictures, the same."""
    options = {"render_mode": "rgb_array_list", "max_episode_steps": 3}
    native = gym.make_vec(STUB, 2, autoreset_mode=mode, **options)
    own = SyncVectorEnv([lambda: gym.make(STUB, **options)] * 2, autoreset_mode=mode)
    for env in (native, own):
        env.reset(seed=0)
    for steps in (1, 2, 2):
        for _ in range(steps):
            over, _ = (env.step(np.zeros((2, 12), dtype=np.float32))[3] for env in (native, own))
        one, other = native.render(), own.render()
        assert [len(each) for each in one] == [len(each) for each in other]
        np.testing.assert_array_equal(one, other)
        for env in (native, own) if mode is AutoresetMode.DISABLED and over.any() else ():
            env.reset(options={"reset_mask": over})
    with pytest.raises(ValueError, match=r"unknown render_mode 'rgb_array_list' .*; choose from 'human', 'rgb_array'"):
        make_sb3_vec_env(STUB, render_mode="rgb_array_list")


def test_pickles_after_drawing():
    """An environment that has drawn can be pickled, and its copy draws the same."""
    env = gym.make(STUB, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    picture = env.render()
    assert np.array_equal(pickle.loads(pickle.dumps(env)).render(), picture)


FAR_AWAY = """
import gymnasium as gym, numpy as np, fish_env
env = gym.make("gliding:Gliding/Target-v0", render_mode={mode!r})
tank = env.unwrapped.tank
for how in ("all", "down", "node", "stretched", "fast", "path", "muscles"):
    for far in (-1e15, 1e300, np.nan):
        env.reset(seed=0)
        if how == "all": tank.position[:] += far
        elif how == "down": tank.position[..., 2] = far
        elif how == "node": tank.position[0, 3] = far
        elif how == "stretched": tank.position[:] *= far
        elif how == "fast": tank.velocity[:] = far
        elif how == "path": env.render(); tank.position[..., 0] += far
        else: tank.rest_length[0, tank.fish.muscles[0]] = far; tank.time[:] = far
        env.unwrapped.fish._measure()
        picture = env.render()
        assert picture is None or (picture.shape == (480, 640, 3) and picture.std() > 5)
env.close()
print("drawn")
"""


@pytest.mark.parametrize("mode", ["rgb_array", pytest.param("human", marks=pytest.mark.slow)])
def test_far_away(mode):
    """A fish, or a part of it, at 1e15 m, at 1e300 m or nowhere is drawn, and ends no process."""
    done = run_python(
        FAR_AWAY.format(mode=mode),
        SDL_VIDEODRIVER="dummy",
        PYTHONWARNINGS="ignore",
        PYTHONPATH=os.pathsep.join(sys.path),
    )
    assert done.returncode == 0 and done.stdout == "drawn\n", (done.returncode, done.stderr[-2000:])
