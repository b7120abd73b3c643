"""The gallery: moving pictures of every environment and of every scene of the laboratory.

python docs/site/gallery.py                    writes docs/images/gallery/
python docs/site/gallery.py ring env_turn      these only

Needs the extra [browser] and Chromium; FISH_ENV_CHROMIUM names one that is installed.
"""

import argparse
import base64
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium as gym
from PIL import Image
from playwright.sync_api import sync_playwright

from fish_env.control import load_policy, record, shipped_policies
from fish_env.control.film import film_text
from fish_env.control.recording import Recording
from fish_env.lab.server import Laboratory
from fish_env.lab.swimmers import UserScene

FOLDER = Path(__file__).parents[1] / "images" / "gallery"
COMMANDS = {"left_after_right": {"yaw": 2.2, "side": -1, "first": 2.0, "second": 2.2, "part": 0.7, "wait": 0.8}}
"""With what an episode of a task begins; of others as usual."""
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZE, RATE, SECONDS = (420, 300), 15, 4.0  # pixels, pictures a second, s
EPISODE = 2.8  # s of an environment, played at half speed
RENDERERS = "renderers"
LARGEST = 600_000  # bytes
PATIENCE = 180e3  # ms
TAKE = """([count, passed]) => new Promise((done) => {
  const found = [];
  lab.passed = passed;
  lab.heard = () => {
    found.push(document.getElementById("view").toDataURL("image/png"));
    if (found.length >= count) { Object.assign(lab, { heard: null, passed: 0 }); done(found); }
  };
})"""
ABOVE = "Object.assign(VIEW, { yaw: -Math.PI / 2, pitch: 1.5707, distance: 2.365 })"  # two lengths wide, x to the right
CLEAN = "#facts, #panel, #bottom, #plots, #toast, #busy { display: none !important; }"


def play(task: str) -> list[Image.Image]:
    """Pictures of an episode with the shipped policy, one every 0.04 s."""
    policy, frames = load_policy(task), []
    env = gym.make(policy.about["env_id"], render_mode="rgb_array", **policy.about["env_options"])
    obs, _ = env.reset(seed=0, options=COMMANDS.get(task))
    for step in range(round(EPISODE / env.unwrapped.fish.control_interval)):
        obs, _, terminated, truncated, _ = env.step(policy(obs))
        if terminated or truncated:
            break
        if env.unwrapped.fish.control_interval > 0.03 or step % 2:
            frames.append(Image.fromarray(env.render()).resize((420, 315), Image.Resampling.LANCZOS))
    env.close()
    return frames


@contextmanager
def opened(user: Callable[[], Any] | None = None, size=SIZE, port=18300) -> Iterator[Any]:
    """A page of a laboratory, without its panels; `user` makes its first scene."""
    laboratory = Laboratory("127.0.0.1", port, user)
    with sync_playwright() as running:
        path = os.environ.get("FISH_ENV_CHROMIUM") or shutil.which("chromium")
        chromium = running.chromium.launch(executable_path=path, args=FLAGS)
        page = chromium.new_page(viewport={"width": size[0], "height": size[1]}, bypass_csp=True)
        page.set_default_timeout(PATIENCE)
        page.goto(f"http://127.0.0.1:{laboratory.port}")
        page.wait_for_function("lab.drawn > 0")
        page.evaluate("lab.bare = true; lab.passed = 0; ratio = 1")
        page.add_style_tag(content=CLEAN)
        yield page
        chromium.close()
    laboratory.close()


def recorded(side: int) -> Recording:
    """An episode of a turn, whose pictures are squares of so many pixels."""
    policy = load_policy("turn")
    options = policy.about["env_options"] | {"width": side, "height": side, "panel": False}
    env = gym.make(policy.about["env_id"], **options)
    recording = record(env, policy, 0)
    env.close()
    return recording


def window_at(step: int, side=480) -> Image.Image:
    """The picture of the window after so many steps, from above."""
    recording = recorded(side)
    env = gym.make(recording.about["env_id"], render_mode="rgb_array", **recording.about["env_options"])
    env.reset(seed=0)
    env.render()
    for action in recording.action[:step]:
        env.step(action)
        picture = env.render()
    env.close()
    return Image.fromarray(picture)


def three_renderers(step: int, side=480) -> tuple[Image.Image, ...]:
    """The same moment from above, by the window, the film and the laboratory."""
    recording = recorded(side)
    interval = float(recording.about["control_interval"])
    with opened(lambda: UserScene(None, load_policy("turn")), (side, side)) as page:
        page.evaluate("send({ do: 'set', name: 'reset' })")
        page.wait_for_function("lab.frame.time === 0")
        page.evaluate(TAKE, [step + 2, interval])  # the page shows a step while the next one is simulated
        page.evaluate("lab.still = true; " + ABOVE.replace("VIEW", "lab.view"))
        *_, laboratory = page.evaluate(TAKE, [2, 0.0])
        page.goto("about:blank")
        page.set_content(film_text([recording]))
        page.add_style_tag(content=".card { display: none !important; }")
        page.evaluate(ABOVE.replace("VIEW", "film"))
        page.evaluate(
            "(time) => { reels[0].ground = -0.5; Object.assign(film, { playing: false, time }); show(); }",
            step * interval,
        )
        film = page.evaluate("document.getElementById('view').toDataURL('image/png')")
    return window_at(step, side), image_of(film), image_of(laboratory)


def image_of(url: str) -> Image.Image:
    """The image of a data URL."""
    return Image.open(BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")


def setting(name: str, value: Any = None) -> Callable[[Any], None]:
    """Set a control."""
    return lambda page: page.evaluate("([name, value]) => set(name, value)", [name, value])


def pressing(x: float, y: float) -> Callable[[Any], None]:
    """Press on the water, at parts of the picture's width and height."""
    return lambda page: page.mouse.click(x * SIZE[0], y * SIZE[1])


def looking(distance: float) -> Callable[[Any], None]:
    """Look from so many lengths away."""
    return lambda page: page.evaluate("(far) => { lab.view.distance = far; }", distance)


def objects(*names: str, integrators=()) -> list[tuple[float, Callable]]:
    """Put objects side by side, with their methods."""
    found = [(0.0, setting(f"object {k}", name)) for k, name in enumerate(names)]
    return found + [(0.0, setting(f"integrator {k}", name)) for k, name in enumerate(integrators) if name]


SCENES: dict[str, tuple[str, list[tuple[float, Callable]]]] = {
    "follow": ("follow me", [(0.0, looking(1.5)), (1.0, setting("left")), (2.2, setting("right"))]),
    "left_after_right": ("left after right", [(0.0, looking(1.3)), (0.9, setting("left_after_right"))]),
    "fast_start": ("fast start", [(0.0, looking(1.9)), (0.4, setting("fast_start")), (2.0, setting("fast_start"))]),
    "school": ("school of 64", [(1.0, setting("left")), (1.0, setting("left"))]),
    "obstacles": ("obstacles", [(0.0, looking(2.2)), (0.8, pressing(0.62, 0.4)), (2.0, pressing(0.62, 0.4))]),
    "targets": ("targets", [(0.0, looking(2.2)), (0.5, pressing(0.4, 0.4)), (2.2, pressing(0.75, 0.5))]),
    "methods": ("what the method does", [(0.0, looking(6.5)), (0.2, setting("throw"))]),
    "bodies": ("what the body does", [(0.0, looking(2.8))]),
    "waters": ("what the water does", []),
    "string": ("soft objects", [*objects("string"), (0.0, looking(3.6)), (0.0, setting("speed", 0.2))]),
    "ring": ("soft objects", [*objects("ring"), (0.0, looking(3.6)), (0.4, setting("throw"))]),
    "sphere": ("soft objects", [*objects("sphere"), (0.0, looking(3.4)), (0.4, setting("throw"))]),
    "uniform_sphere": ("soft objects", [(0.0, looking(4.5)), (0.0, setting("show springs", True)),
                                        (0.4, setting("throw"))]),
    "beam": ("finite elements", [(0.0, looking(1.7)), (0.0, setting("show strain", True)),
                                 (0.4, setting("twisted"))]),
    "block": ("finite elements", [*objects("block"), (0.0, looking(3.0)), (0.0, setting("show strain", True)),
                                  (0.4, setting("inverted"))]),
    "ball": ("finite elements", [*objects("ball"), (0.0, looking(3.0)), (0.0, setting("show strain", True)),
                                 (0.4, setting("throw"))]),
    "two_materials": ("finite elements", [*objects("two materials"), (0.0, looking(1.9)),
                                          (0.0, setting("show strain", True)), (0.4, setting("throw"))]),
    "muscles": ("what the body does", [(0.0, setting("object 1", "none")), (0.0, setting("show springs", True)),
                                       (0.0, looking(1.7))]),
}  # fmt: skip
"""What is shown: a scene of the laboratory, and what is done in it after so many seconds."""


def side_by_side(images) -> Image.Image:
    """Images of one size in a row."""
    width, height = images[0].size
    row = Image.new("RGB", (len(images) * width, height))
    for k, image in enumerate(images):
        row.paste(image, (k * width, 0))
    return row


def moving(page, scene: str, actions: list[tuple[float, Callable]]) -> list[Image.Image]:
    """Pictures of a scene."""
    page.evaluate("(name) => { lab.before = lab.scene; send({ do: 'scene', name }); }", scene)
    page.wait_for_function("lab.scene !== lab.before && lab.frame")
    frames, done = [], 0.0
    for time, action in [*actions, (SECONDS, lambda page: None)]:
        if time > done:
            count = round((time - done) * RATE)
            for data in page.evaluate(TAKE, [count, 1 / RATE]):
                frames.append(image_of(data))
            done = time
        action(page)
        page.wait_for_timeout(300)
    return frames


def save(name: str, frames: list[Image.Image], rate: float) -> None:
    """Write a moving picture, as good as LARGEST allows."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{name}.webp"
    for quality in (50, 35, 20):
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=round(1000 / rate), loop=0,
                       quality=quality, method=4)  # fmt: skip
        if path.stat().st_size <= LARGEST:
            break
    print(f"{path}: {path.stat().st_size // 1000} kB", flush=True)


def main() -> None:
    """The command line."""
    tasks = [f"env_{task}" for task in shipped_policies()]
    everything = [RENDERERS, *SCENES, *tasks]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="name", help=f"of {', '.join(everything)}")
    names = parser.parse_args().names or everything
    if unknown := set(names) - set(everything):
        parser.error(f"unknown {', '.join(sorted(unknown))}; choose from {', '.join(everything)}")
    for name in names:
        if name == RENDERERS:
            save(name, [side_by_side(three_renderers(30))], 1.0)
        if name in tasks:
            save(name, play(name.removeprefix("env_")), 12.5)
    shown = [name for name in names if name in SCENES]
    if shown:
        with opened() as page:
            for name in shown:
                save(name, moving(page, *SCENES[name]), RATE)


if __name__ == "__main__":
    main()
