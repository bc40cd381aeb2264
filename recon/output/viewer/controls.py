"""Keys of a window: other bases, and planes that move through all volumes together."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from phantomgen.display.viewer.content import Triple, layer_at
from phantomgen.display.viewer.panes import Pane
from recon.output.viewer.content import RunContent


@dataclass
class Controls:
    """State of a window.

    Parameters
    ----------
    content : content that is shown
    panes : panels of slices, by their kind and by the position of their basis in `bases`
    draw : function that draws a panel from its kind, its basis and the positions of the planes
    bases : numbers of the bases that are shown
    at : positions of the planes (x, y, z) [mm]
    drawn : called after the panels were drawn anew, which removes all text
    """

    content: RunContent
    panes: dict[tuple[str, int], Pane]
    draw: Callable[[Pane, str, int, Triple], None]
    bases: list[int]
    at: Triple
    drawn: Callable[[], None] = lambda: None

    def turn(self, step: int) -> None:
        """Show other bases.

        Parameters
        ----------
        step : number of bases by which to go on
        """
        count = len(self.content.basis_names)
        self.bases = [(basis + step) % count for basis in self.bases]
        self._redraw()

    def move(self, axis: str, step: int) -> None:
        """Move a plane, not beyond the volume.

        Parameters
        ----------
        axis : ``x``, ``y`` or ``z``
        step : number of voxels
        """
        i, places = "xyz".index(axis), self.content.grid.axis(axis)
        layer = min(max(layer_at(self.content.grid, axis, self.at[i]) + step, 0), len(places) - 1)
        x, y, z = (float(places[layer]) if j == i else value for j, value in enumerate(self.at))
        self.at = (x, y, z)
        self._redraw()

    def bind(self) -> None:
        """Connect the keys of the window."""
        plotter: Any = next(iter(self.panes.values())).plotter  # whose wrapped methods confuse type checkers
        plotter.add_key_event("Right", partial(self.turn, 1))
        plotter.add_key_event("Left", partial(self.turn, -1))
        for axis in "xyz":
            plotter.add_key_event(axis, partial(self.move, axis, 1))
            plotter.add_key_event(axis.upper(), partial(self.move, axis, -1))

    def _redraw(self) -> None:
        plotter = next(iter(self.panes.values())).plotter
        plotter.suppress_rendering = True
        for (kind, i), pane in self.panes.items():
            pane.clear()
            self.draw(pane, kind, self.bases[i], self.at)
            pane.finish()
        self.drawn()
        plotter.suppress_rendering = False
        plotter.render()
