"""The controls that choose each object of the bench, and the tab of the page where objects are compared."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fish_env.bodies import BODIES
from fish_env.bodies.objects import OBJECTS
from fish_env.lab.controls import Plot
from fish_env.lab.fields import SPECIMENS
from fish_env.lab.specimen import FINEST, Entry, level_of
from fish_env.physics.integrators import INTEGRATORS

if TYPE_CHECKING:
    from fish_env.lab.panel import Panel

OWN, NOTHING = "own", "nothing"
RANKS = ("", "second ", "third ")  # begin the labels of each object's controls


class ObjectControls:
    """Controls that choose an object of the bench (0 to 2), its method, and the whole numbers that it is made with."""

    def __init__(self, panel: Panel, number: int):
        self.panel, self.controls, self.number = panel, panel.controls, number
        kinds = [*[NOTHING] * (number > 0), *OBJECTS, *BODIES]
        self.thing = self.controls.add(
            "dropdown", f"{RANKS[number]}object", kinds,
            action=lambda value: self.choose(value, self.integrator.value if number else OWN),
        )  # fmt: skip
        self.integrator = self.controls.add(
            "dropdown", f"{RANKS[number]}integrator", [OWN, *INTEGRATORS],
            action=lambda value: self.choose(NOTHING if self.entry is None else self.entry.thing, value),
        )  # fmt: skip
        self.folder = panel.controls.gui.add_folder(f"{RANKS[number]}made with", expand_by_default=False)
        self._numbers: dict[str, Any] = {}

    @property
    def entry(self) -> Entry | None:
        """The object's entry on the bench; what the controls show may be newer."""
        entries = self.panel.entries()
        return entries[self.number] if self.number < len(entries) else None

    def choose(self, thing: str, integrator: str) -> None:
        """Choose the object and its method.

        It keeps the numbers that it is made with; a new one of the first one's kind begins with those of the first.
        """
        entries, k = self.panel.entries(), self.number
        levels = [each.level for each in (*entries[k : k + 1], entries[0]) if each.thing == thing]
        method = "" if integrator == OWN else integrator
        chosen = [] if thing == NOTHING else [Entry(thing, method, *levels[:1])]
        self.panel.choose([*entries[:k], *chosen, *entries[k + 1 :]])

    def set_number(self, name: str, value) -> None:
        """Make the object with another whole number."""
        entries = self.panel.entries()
        entry = entries[self.number]
        entries[self.number] = entry._replace(level=tuple((dict(entry.level) | {name: int(value)}).items()))
        self.panel.choose(entries)

    def refresh(self) -> None:
        """Show the object that is on the bench."""
        entry, show = self.entry, self.controls.show
        show(self.thing, NOTHING if entry is None else entry.thing)
        defaults = {} if entry is None else level_of(entry.thing)
        if set(self._numbers) != set(defaults):
            for handle in self._numbers.values():
                self.controls.remove(handle)
            with self.folder:
                self._numbers = {name: self._add_number(name, value) for name, value in defaults.items()}
        self.folder.visible = bool(defaults)
        if entry is not None:
            show(self.integrator, entry.integrator or OWN)
            for name, value in (defaults | dict(entry.level)).items():
                show(self._numbers[name], value)

    def _add_number(self, name: str, value: int) -> Any:
        return self.controls.add(
            "number", f"{RANKS[self.number]}{name}", value, min=0, max=FINEST, step=1,
            action=lambda value: self.set_number(name, value),
        )  # fmt: skip


class Comparison:
    """The tab of the second and third object."""

    def __init__(self, panel: Panel, tab: Any):
        self.controls, self.bench = panel.controls, panel.session.bench
        gui = self.controls.gui
        gui.add_markdown("The same object by other methods, or other objects, under the same conditions.")
        self.others = [ObjectControls(panel, number) for number in (1, 2)]
        self.same_cost = self.controls.add(
            "checkbox", "same cost", False, hint="steps such that a second costs as much of the processor",
            action=lambda value: panel.choose(panel.entries(), same_cost=bool(value)),
        )  # fmt: skip
        lines = {str(k + 1): colour for k, colour in enumerate(SPECIMENS[1:])}
        self.distance = Plot(gui, tab, "distance from the first (lengths)", lines)
        self.steps = gui.add_markdown("")

    def refresh(self) -> None:
        """Show the objects on the bench."""
        for each in self.others:
            each.refresh()
        self.controls.show(self.same_cost, self.bench.same_cost)
        about = [f"{each.thing.name}: {each.method}, step {1e3 * each.tank.dt:.3g} ms" for each in self.bench.specimens]
        self.steps.content = "\n".join(f"{k}. {each}" for k, each in enumerate(about, 1))

    def update(self) -> None:
        """Draw how far the others are from the first."""
        if len(self.bench.specimens) > 1 and len(self.bench.distances) > 1:
            rows = list(np.array(list(self.bench.distances)).T)
            self.distance.draw(self.bench.series("energy")[0], rows)
