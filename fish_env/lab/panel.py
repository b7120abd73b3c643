"""The controls of the page, in tabs. What they hand over is checked by the bench, like any other input."""

from typing import Any

from fish_env.bodies import BODIES
from fish_env.bodies.detail import LevelOfDetail
from fish_env.bodies.objects import OBJECTS
from fish_env.lab import colours
from fish_env.lab.comparison import OWN, Comparison, MadeWith, method
from fish_env.lab.plots import EVERY, PLOTS, add_plot, padded
from fish_env.lab.requests import SessionLike
from fish_env.lab.settings import SETTINGS, WALLS
from fish_env.lab.specimen import Entry, level_of
from fish_env.lab.steering import Steering
from fish_env.physics.integrators import INTEGRATORS

DETAILED = "uniform sphere"
"""The object whose level of detail its distance from the camera can choose."""


class Panel:
    """All controls of one browser.

    Args:
        session: what they act on.
    """

    def __init__(self, session: SessionLike):
        self.session, self.gui = session, session.client.gui
        self.mouse, self._drawn = "drag", 0.0
        self._detail: LevelOfDetail | None = None  # of the first object, if its level is chosen by its distance
        self._shown: dict[int, Any] = {}  # what a control was last set to, by its id: viser's have no hash
        self._numbers: dict[str, Any] = {}
        self._plots: dict[str, Any] = {}
        self.status = self.gui.add_markdown("")
        tabs = self.gui.add_tab_group()
        with tabs.add_tab("Object"):
            self._object()
        with tabs.add_tab("Change"):
            self._change()
        with tabs.add_tab("Compare"):
            self.comparison = Comparison(self)
        with tabs.add_tab("Steer"):
            self.steering = Steering(self)
        with tabs.add_tab("View"):
            self._view()
        with self.gui.add_folder("Measured"):
            self._measured()
        self._keys()
        self.refresh()

    def when(self, handle, action) -> Any:
        """Have `action(value)` done in the simulation's thread when the user changes a control."""

        async def changed(event) -> None:
            if event.client_id is not None:  # else the program has set it
                value = event.target.value
                self.session.ask(lambda: take(value))

        def take(value) -> None:
            self._shown[id(handle)] = value
            action(value)

        handle.on_update(changed)
        return handle

    def show(self, handle, value) -> None:
        """Show a value unless it is shown already: what the user has chosen since then, and asks for, is left alone."""
        if self._shown.get(id(handle), handle.value) != value:
            handle.value = value
        self._shown[id(handle)] = value

    def forget(self, handle) -> None:
        """Take a control away."""
        self._shown.pop(id(handle), None)
        handle.remove()

    def button(self, label: str, action, hint: str | None = None) -> Any:
        """A button that has `action()` done in the simulation's thread."""
        handle = self.gui.add_button(label, hint=hint)

        async def pressed(event) -> None:
            self.session.ask(action)

        handle.on_click(pressed)
        return handle

    def _object(self) -> None:
        session, bench = self.session, self.session.bench
        self.thing = self.when(
            self.gui.add_dropdown("object", [*OBJECTS, *BODIES], initial_value=bench.specimens[0].entry.thing),
            lambda value: self.choose(Entry(value), *self.entries()[1:]),
        )
        self.made = MadeWith(self, 0)
        self.by_distance = self.when(
            self.gui.add_checkbox("level by distance", False, hint="as coarse as nobody sees from the camera"),
            self.set_by_distance,
        )
        self.integrator = self.when(
            self.gui.add_dropdown("integrator", [OWN, *INTEGRATORS]),
            lambda value: self.change(integrator=method(value)),
        )
        self.when(
            self.gui.add_dropdown("mouse", ["drag", "fix or release"], hint="what pressing a node does"), self.set_mouse
        )
        self.when(self.gui.add_slider("strength of hand", 0.2, 10.0, 0.2, 1.0), bench.set_strength)
        self.button("Drop: start again (R)", self.restart)
        self.button("Throw (T)", bench.throw)
        self.button("Twist", lambda: bench.distort("twisted"), "at rest, turned by half a turn from end to end")
        self.button("Invert", lambda: bench.distort("inverted"), "at rest, turned inside out")
        self.button("Release fixed nodes", bench.release_all)
        self.pause = self.when(self.gui.add_checkbox("pause (space)", False), self.set_paused)
        self.button("One step (N)", self.one_step)
        self.when(self.gui.add_slider("speed", 0.02, 2.0, 0.02, 1.0, hint="over real time"), self.set_speed)
        self.gait = self.when(self.gui.add_checkbox("fish swim by the gait", False), session.bench.swim)

    def _change(self) -> None:
        for name, setting in SETTINGS.items():
            self._numbers[name] = self.when(
                self.gui.add_slider(
                    setting.label, setting.low, setting.high, 0.01, setting.default, hint=setting.meaning
                ),
                lambda value, name=name: self.session.bench.set(name, value),
            )
        self.walls = self.when(self.gui.add_dropdown("walls", list(WALLS)), self.set_walls)

    def _view(self) -> None:
        drawing = self.session.drawing
        for view, shown in drawing.shown.items():
            self.when(self.gui.add_checkbox(view, shown), lambda value, view=view: drawing.show(view, value))
        self.button("Look again", self.session.look)
        self.gui.add_markdown(
            "Springs and tetrahedra: blue shortened, grey at rest, orange stretched (30 % at the ends). Muscles: grey "
            "relaxed, red contracted. Forces: their length goes with the square root."
        )

    def _measured(self) -> None:
        for name, label in PLOTS.items():
            self._plots[name] = self._plot(label, colours.SPECIMENS[:3])

    def _plot(self, label, palette) -> Any:
        return add_plot(self.gui, label, {str(k + 1): colour for k, colour in enumerate(palette)}, 150)

    def _keys(self) -> None:
        self.key("R", "Start again", self.restart)
        self.key("T", "Throw", self.session.bench.throw)
        self.key("N", "One step", self.one_step)
        self.key("space", "Pause", lambda: self.set_paused(not self.session.paused))

    def key(self, hotkey, label: str, action) -> None:
        """A key that has `action()` done in the simulation's thread."""
        command: Any = self.gui.add_command(label, hotkey=hotkey)

        async def triggered(event) -> None:
            self.session.ask(action)

        command.on_trigger(triggered)

    def entries(self) -> list[Entry]:
        """Entries on the bench; a choice changes these, and not the values of the controls, which may be newer."""
        return [specimen.entry for specimen in self.session.bench.specimens]

    def change(self, **parts) -> None:
        """Change a part of the first object's entry."""
        first, *others = self.entries()
        self.choose(first._replace(**parts), *others)

    def choose(self, first: Entry, *others: Entry, same_cost: bool | None = None) -> None:
        """Put objects on the bench."""
        self.session.wait("Compiling, or reading compiled code ...")
        self.session.bench.choose([first, *others], same_cost)
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
        self.show(self.pause, self.session.paused)

    def set_speed(self, value) -> None:
        """Time of the simulation over real time."""
        if not 0.01 <= float(value) <= 2.0:
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

    def _adapt(self) -> None:
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
        now = level_of(DETAILED) | dict(bench.specimens[0].entry.level)
        if level != now["level"]:
            bench.set_detail(0, level)
            self.session.drawing.build(look=False)
            self.refresh()

    def press(self, number: int, point) -> None:
        """The mouse begins to drag at a point of the scene."""
        place = self.session.drawing.place(number, point)
        if self.mouse == "fix":
            self.session.bench.fix(number, place)
        else:
            self.session.bench.grab(number, place)

    def drag(self, number: int, point) -> None:
        """The mouse drags to a point of the scene."""
        if self.session.bench.hand is not None:
            self.session.bench.drag(self.session.drawing.place(number, point))

    def refresh(self) -> None:
        """Show the present state of the bench in all controls."""
        bench = self.session.bench
        first = bench.specimens[0].entry
        self.steering.refresh()
        self.show(self.thing, first.thing)
        self.show(self.integrator, first.integrator or OWN)
        self.made.refresh(first)
        self.by_distance.visible = first.thing == DETAILED
        if first.thing != DETAILED:
            self._detail = None
        self.show(self.by_distance, self._detail is not None)
        self.comparison.refresh()
        for name, handle in self._numbers.items():
            self.show(handle, bench.numbers[name])
        self.show(self.walls, bench.walls)
        self.gait.disabled = not any(specimen.is_fish for specimen in bench.specimens)
        self.show(self.gait, bench.specimens[0].swimming)

    def set_level(self, number: int, name: str, value) -> None:
        """Make an object with another whole number."""
        entries = self.entries()
        entry = entries[number]
        entries[number] = entry._replace(level=tuple((dict(entry.level) | {name: int(value)}).items()))
        self.choose(*entries)

    def update(self, now: float) -> None:
        """Draw the plots, now and then; `now` is the time, s."""
        if now < self._drawn + EVERY:
            return
        rate = f"{self.session.frames / max(now - self._drawn, 1e-3):.0f} pictures a second"
        self._drawn, self.session.frames = now, 0
        if self.session.school is not None:
            self.status.content = f"{self.steering.update()}, {rate}"
            return
        self._adapt()
        bench = self.session.bench
        for name, handle in self._plots.items():
            times, *rows = bench.series(name)
            if len(times) > 1:
                handle.data = padded(times, rows, 3)
        self.comparison.update()
        names = ", ".join(f"**{s.thing.name}** by {s.tank.integrator.name}" for s in bench.specimens)
        self.status.content = f"{names}: {bench.nodes} nodes, {bench.clock:.1f} s, {rate}"
