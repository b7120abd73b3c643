"""The controls of the page, in tabs. What they hand over is checked by the bench, like any other input."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fish_env.bodies.detail import LevelOfDetail
from fish_env.lab.comparison import Comparison, ObjectControls
from fish_env.lab.controls import Controls, Plot
from fish_env.lab.fields import SPECIMENS
from fish_env.lab.settings import SETTINGS, WALLS, is_finite
from fish_env.lab.specimen import Entry, level_of
from fish_env.lab.steering import Steering

if TYPE_CHECKING:
    from fish_env.lab.session import Session

DETAILED = "uniform sphere"
"""The object whose level of detail its distance from the camera can choose."""
PLOTS = {
    "energy": "energy (J)",
    "power": "power of the muscles (W)",
    "volume": "volume over rest",
    "strain": "largest strain",
}
EVERY = 0.2  # s between two drawings of the plots
COLOURS = """Springs and tetrahedra: blue shortened, grey at rest, orange stretched (30 % at the ends). Muscles: grey
relaxed, red contracted. Forces: their length goes with the square root."""


class Panel:
    """All controls of one browser, which act on its session."""

    def __init__(self, session: Session):
        self.session, self.controls = session, Controls(session)
        self.mouse, self._drawn = "drag", 0.0
        self._detail: LevelOfDetail | None = None  # of the first object, if its level is chosen by its distance
        gui = self.controls.gui
        self.status = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Object"):
            self._add_object()
        with tabs.add_tab("Change"):
            self._numbers: dict[str, Any] = {
                name: self.controls.add(
                    "slider", each.label, each.low, each.high, 0.01, each.default, hint=each.meaning,
                    action=lambda value, name=name: session.bench.set(name, value),
                )
                for name, each in SETTINGS.items()
            }  # fmt: skip
            self.walls = self.controls.add("dropdown", "walls", list(WALLS), action=self.set_walls)
        with tabs.add_tab("Compare") as tab:
            self.comparison = Comparison(self, tab)
        with tabs.add_tab("Steer") as tab:
            self.steering = Steering(self, tab)
        with tabs.add_tab("View"):
            for view, shown in session.drawing.shown.items():
                self.controls.add(
                    "checkbox", view, shown, action=lambda value, view=view: session.drawing.show(view, value)
                )
            self.controls.add_button("Look again", session.look)
            gui.add_markdown(COLOURS)
        with gui.add_folder("Measured") as folder:
            lines = {str(k): colour for k, colour in enumerate(SPECIMENS, 1)}
            self._plots = {name: Plot(gui, folder, label, lines) for name, label in PLOTS.items()}
        for hotkey, label, action in (
            ("R", "Start again", self.restart), ("T", "Throw", session.bench.throw), ("N", "One step", self.one_step),
            ("space", "Pause", lambda: self.set_paused(not session.paused)),
        ):  # fmt: skip
            self.controls.add_key(hotkey, label, action)
        self.refresh()

    def _add_object(self) -> None:
        add, bench = self.controls.add, self.session.bench
        self.first = ObjectControls(self, 0)
        self.by_distance = add(
            "checkbox", "level by distance", False, hint="as coarse as nobody sees from the camera",
            action=self.set_by_distance,
        )  # fmt: skip
        add("dropdown", "mouse", ["drag", "fix or release"], hint="what pressing a node does", action=self.set_mouse)
        add("slider", "strength of hand", 0.2, 10.0, 0.2, 1.0, action=bench.set_strength)
        for label, action, hint in (
            ("Drop: start again (R)", self.restart, None),
            ("Throw (T)", bench.throw, None),
            ("Twist", lambda: bench.distort("twisted"), "at rest, turned by half a turn from end to end"),
            ("Invert", lambda: bench.distort("inverted"), "at rest, turned inside out"),
            ("Release fixed nodes", bench.release_all, None),
        ):
            self.controls.add_button(label, action, hint)
        self.pause = add("checkbox", "pause (space)", False, action=self.set_paused)
        self.controls.add_button("One step (N)", self.one_step)
        add("slider", "speed", 0.02, 2.0, 0.02, 1.0, hint="over real time", action=self.set_speed)
        self.gait = add("checkbox", "fish swim by the gait", False, action=bench.swim)

    def entries(self) -> list[Entry]:
        """Entries on the bench; a choice changes these, and not the values of the controls, which may be newer."""
        return [specimen.entry for specimen in self.session.bench.specimens]

    def choose(self, entries: list[Entry], same_cost: bool | None = None) -> None:
        """Put objects on the bench."""
        self.session.wait("Compiling, or reading compiled code ...")
        self.session.bench.choose(entries, same_cost)
        self.session.bench.warm()
        self.session.show_bench()

    def restart(self) -> None:
        """Put everything back to rest."""
        (self.session.school or self.session.bench).reset()

    def one_step(self) -> None:
        """Pause, and take one step."""
        self.set_paused(True)
        self.session.step()

    def set_paused(self, value) -> None:
        """Pause or resume the simulation."""
        self.session.paused = bool(value)
        self.controls.show(self.pause, self.session.paused)

    def set_speed(self, value) -> None:
        """Set the time of the simulation over real time."""
        if not (is_finite(value) and 0.01 <= value <= 2.0):
            raise ValueError(f"speed is {value!r}; give a number from 0.01 to 2")
        self.session.speed = float(value)

    def set_mouse(self, value) -> None:
        """Choose the action of the mouse."""
        self.mouse = "drag" if value == "drag" else "fix"

    def set_walls(self, value) -> None:
        """Choose the walls, and draw them."""
        self.session.bench.set_walls(value)
        if self.session.school is None:
            self.session.drawing.build_room()

    def set_by_distance(self, value) -> None:
        """Let the distance of the camera choose the level of the first object, or not."""
        thing = self.session.bench.specimens[0].thing
        self._detail = LevelOfDetail(radius=0.5 * thing.length) if value and thing.name == DETAILED else None

    def _adapt_level(self) -> None:
        """Give the first object the level for its distance, unless a node of it is dragged or fixed."""
        bench = self.session.bench
        if self._detail is None or bench.hand is not None or bench.specimens[0].fixed:
            return
        try:
            level = self._detail.choose(*self.session.drawing.seen_from(0))
        except ValueError as error:
            self.set_by_distance(False)
            self.refresh()
            self.session.tell(str(error))
            return
        if level != (level_of(DETAILED) | dict(bench.specimens[0].entry.level))["level"]:
            bench.set_detail(0, level)
            self.session.drawing.build(look=False)
            self.refresh()

    def press(self, number: int, point) -> None:
        """Begin a drag of the mouse at a point of the scene: grab the node there, or fix it."""
        bench = self.session.bench
        (bench.fix if self.mouse == "fix" else bench.grab)(number, self.session.drawing.place(number, point))

    def drag(self, number: int, point) -> None:
        """Drag to a point of the scene."""
        if self.session.bench.hand is not None:
            self.session.bench.drag(self.session.drawing.place(number, point))

    def refresh(self) -> None:
        """Show the present state of the bench in all controls."""
        bench, show = self.session.bench, self.controls.show
        first = bench.specimens[0]
        for part in (self.steering, self.first, self.comparison):
            part.refresh()
        self.by_distance.visible = first.entry.thing == DETAILED
        if first.entry.thing != DETAILED:
            self._detail = None
        show(self.by_distance, self._detail is not None)
        for name, handle in self._numbers.items():
            show(handle, bench.numbers[name])
        show(self.walls, bench.walls)
        self.gait.disabled = not any(specimen.is_fish for specimen in bench.specimens)
        show(self.gait, first.swimming)

    def update(self, now: float) -> None:
        """Draw the plots, now and then; `now` is the time, s."""
        if now < self._drawn + EVERY:
            return
        rate = f"{self.session.frames / max(now - self._drawn, 1e-3):.0f} pictures a second"
        self._drawn, self.session.frames = now, 0
        if self.session.school is not None:
            self.status.content = f"{self.steering.update()}, {rate}"
            return
        self._adapt_level()
        bench = self.session.bench
        for name, plot in self._plots.items():
            times, *rows = bench.series(name)
            if len(times) > 1:
                plot.draw(times, rows)
        self.comparison.update()
        names = ", ".join(f"**{each.thing.name}** by {each.method}" for each in bench.specimens)
        self.status.content = f"{names}: {bench.nodes} nodes, {bench.clock:.1f} s, {rate}"
