"""Values under the pointer of a window: coefficients, CT number and concentrations."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.display.viewer.content import Triple, layer_at
from phantomgen.display.viewer.panes import Pane
from recon.output.viewer.content import RunContent
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.read_run import open_model
from spectra.basis.basis import pretty

ENERGY = 70.0  # keV; of the CT number, where the spectrum has it; as in the page of slices


@dataclass(frozen=True, eq=False)
class PointerValues:
    """Values of a run and of its truth at any place.

    Parameters
    ----------
    content : volumes
    readouts : conversion to other quantities; None where the run lacks some basis functions of the truth
    """

    content: RunContent
    readouts: Readouts | None

    @classmethod
    def of(cls, folder: Path, content: RunContent) -> "PointerValues":
        """Read the spectral model of a run.

        Parameters
        ----------
        folder : run folder
        content : volumes of this run

        Returns
        -------
        the values
        """
        stored = open_model(folder)
        if stored.basis.names != content.basis_names:
            return cls(content, None)
        return cls(content, Readouts.of(stored.basis, *detected_spectrum(stored.basis, stored.transmission)))

    def text(self, kind: str, place: Triple) -> str:
        """Describe what a panel shows at a place.

        Parameters
        ----------
        kind : ``truth``, ``result`` or ``difference``
        place : (x, y, z) [mm]

        Returns
        -------
        lines: the place, the coefficient of each basis [1/mm], CT number [HU] and concentrations [mg/ml]
        """
        content = self.content
        z, y, x = (layer_at(content.grid, axis, place["xyz".index(axis)]) for axis in "zyx")
        values = content.result[:, z, y, x]
        true = values if content.true is None else content.true[:, z, y, x]

        def shown(quantity: Callable[[Float[np.ndarray, " basis"]], Any]) -> float:
            if kind == "difference":
                return float(quantity(values) - quantity(true))
            return float(quantity(true if kind == "truth" else values))

        at = ", ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", place, strict=True))
        lines = [f"{at} mm"]
        lines += [f"{pretty(n)} {shown(lambda v, i=i: v[i]):.4f} 1/mm" for i, n in enumerate(content.basis_names)]
        if self.readouts is not None:
            readouts, (low, high) = self.readouts, self.readouts.span
            energy = float(np.clip(ENERGY, low, high))
            lines.append(f"{shown(lambda v: readouts.hounsfield(v, energy)):.0f} HU at {energy:.0f} keV")
            lines += [f"{e} {shown(lambda v, e=e: readouts.concentration(v, e)):.2f} mg/ml" for e in readouts.agents]
        return "\n".join(lines)


class Pointer:
    """Text in the panel that the pointer is over.

    Parameters
    ----------
    panes : panels of slices, by their kind and by the position of their basis
    values : what is told
    """

    def __init__(self, panes: Mapping[tuple[str, int], Pane], values: PointerValues) -> None:
        self.panes, self.values = panes, values
        self.told = dict.fromkeys(panes, "")
        self.place: tuple[int, int] | None = None
        self.plotter: Any = next(iter(panes.values())).plotter  # whose wrapped methods confuse type checkers
        self.plotter.iren.picker = "cell"

    def bind(self) -> None:
        """Follow the pointer of the window."""
        window = self.plotter.iren
        window.add_observer("MouseMoveEvent", lambda *_: self.move(*window.get_event_position()))

    def again(self) -> None:
        """Tell the values under the last place once more, where panels were drawn anew."""
        self.told = dict.fromkeys(self.panes, "")
        if self.place is not None:
            self.move(*self.place)

    def move(self, x: int, y: int) -> None:
        """Tell the values under a place of the window.

        Parameters
        ----------
        x, y : from the lower left corner [pixel]
        """
        self.place = x, y
        width, height = self.plotter.window_size
        picker = self.plotter.iren.picker
        before = dict(self.told)
        for key, pane in self.panes.items():
            left, bottom, right, top = pane.viewport
            over = left <= x / width < right and bottom <= y / height < top
            hit = over and picker.Pick(x, y, 0, pane.renderer)
            place: Triple = picker.GetPickPosition()
            self.told[key] = self.values.text(key[0], place) if hit else ""
            if self.told[key] != before[key]:
                pane.tell(self.told[key])
        if self.told != before:
            self.plotter.render()
