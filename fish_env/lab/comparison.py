"""The tab of the page where objects are put side by side, and the numbers that each object is made with."""

from typing import Any

import numpy as np

from fish_env.bodies import BODIES
from fish_env.bodies.objects import OBJECTS
from fish_env.lab import colours
from fish_env.lab.plots import add_plot, padded
from fish_env.lab.requests import PanelLike
from fish_env.lab.specimen import Entry, level_of
from fish_env.physics.integrators import INTEGRATORS

OWN, NOTHING = "own", "nothing"
OTHERS = ("second", "third")


def method(integrator: str) -> str:
    """The name of a method as an Entry has it."""
    return "" if integrator == OWN else integrator


class MadeWith:
    """A folder of the whole numbers that an object is made with.

    Args:
        panel: chooses the objects.
        number: of the object.
        rank: prefix of the labels, "" for the first object.
    """

    def __init__(self, panel: PanelLike, number: int, rank: str = ""):
        self.panel, self.number, self.rank = panel, number, rank
        self.folder = panel.gui.add_folder(f"{rank} made with".strip(), expand_by_default=False)
        self._numbers: dict[str, Any] = {}

    def refresh(self, entry: Entry | None) -> None:
        """Show the numbers of an entry of the bench; None hides them."""
        defaults = {} if entry is None else level_of(entry.thing)
        if set(self._numbers) != set(defaults):
            for handle in self._numbers.values():
                self.panel.forget(handle)
            with self.folder:
                self._numbers = {name: self._add(name, value) for name, value in defaults.items()}
        self.folder.visible = bool(defaults)
        for name, value in ({} if entry is None else defaults | dict(entry.level)).items():
            self.panel.show(self._numbers[name], value)

    def _add(self, name: str, value: int) -> Any:
        handle = self.panel.gui.add_number(f"{self.rank} {name}".strip(), value, min=0, max=24, step=1)
        return self.panel.when(handle, lambda value: self.panel.set_level(self.number, name, value))


class Comparison:
    """The controls of the second and third object.

    Args:
        panel: whose tab they fill.
    """

    def __init__(self, panel: PanelLike):
        self.panel, self.bench, gui = panel, panel.session.bench, panel.gui
        gui.add_markdown("The same object by other methods, or other objects, under the same conditions.")
        self.things, self.integrators, self.made = [], [], []
        for k, rank in enumerate(OTHERS, 1):
            thing = gui.add_dropdown(f"{rank} object", [NOTHING, *OBJECTS, *BODIES])
            integrator = gui.add_dropdown(f"{rank} integrator", [OWN, *INTEGRATORS])
            self.things.append(panel.when(thing, lambda value, k=k: self.compare(k, value, self.method_of(k))))
            self.integrators.append(panel.when(integrator, lambda value, k=k: self.compare(k, self.compared(k), value)))
            self.made.append(MadeWith(panel, k, rank))
        self.same_cost = panel.when(
            gui.add_checkbox("same cost", False, hint="steps such that a second costs as much of the processor"),
            lambda value: panel.choose(*panel.entries(), same_cost=bool(value)),
        )
        lines = {str(k + 1): colour for k, colour in enumerate(colours.SPECIMENS[1:3])}
        self.distance = add_plot(gui, "distance from the first (lengths)", lines, 150)
        self.steps = gui.add_markdown("")

    def compared(self, rank: int) -> str:
        """The second or third object, rank 1 or 2, or NOTHING."""
        entries = self.panel.entries()
        return entries[rank].thing if rank < len(entries) else NOTHING

    def method_of(self, rank: int) -> str:
        """The method that the list of the second or third object says."""
        return self.integrators[rank - 1].value

    def compare(self, rank: int, thing: str, integrator: str) -> None:
        """Choose the second or third object, rank 1 or 2, and its method.

        It keeps the numbers that it is made with; a new one of the first one's kind begins with those of the first.
        """
        entries = self.panel.entries()
        alike = [each.level for each in (*entries[rank : rank + 1], entries[0]) if each.thing == thing]
        chosen = [] if thing == NOTHING else [Entry(thing, method(integrator), *alike[:1])]
        self.panel.choose(*entries[:rank], *chosen, *entries[rank + 1 :])

    def refresh(self) -> None:
        """Show the objects on the bench."""
        bench, entries = self.bench, self.panel.entries()
        for k in range(1, len(OTHERS) + 1):
            entry = entries[k] if k < len(entries) else None
            self.panel.show(self.things[k - 1], self.compared(k))
            if entry is not None:
                self.panel.show(self.integrators[k - 1], entry.integrator or OWN)
            self.made[k - 1].refresh(entry)
        self.panel.show(self.same_cost, bench.same_cost)
        about = [f"{s.thing.name}: {s.tank.integrator.name}, step {1e3 * s.tank.dt:.3g} ms" for s in bench.specimens]
        self.steps.content = "\n".join(f"{k + 1}. {each}" for k, each in enumerate(about))

    def update(self) -> None:
        """Draw how far the others are from the first."""
        if len(self.bench.specimens) > 1 and len(self.bench.distances) > 1:
            rows = list(np.array(list(self.bench.distances)).T)
            self.distance.data = padded(self.bench.series("energy")[0], rows, 2)
