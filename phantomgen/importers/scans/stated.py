"""Facts about a scan that a user or a file states; what neither does is asked for in one sentence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from spectra.errors import InputError


@dataclass(frozen=True)
class Stated:
    """Facts about a scan; None for those that are not known. What the user states goes before what a file states.

    Parameters
    ----------
    kvp : tube voltage [kV]
    anode, anode_angle : material of the tube's target, and its angle [degree]
    filters : layers in the beam, such as ``2.5 mm Al + 0.2 mm Cu``; ``none`` for no filter
    energy : of a beam of one energy [keV]
    spectrum : table of two columns, energy [keV] and photons per bin
    thresholds : lower limits of the channels of a photon-counting detector [keV]
    sensor : of that detector, such as ``1.6 mm CdTe``
    scintillator : of a detector that adds energies, such as ``CsI`` or ``0.6 mm CsI``
    photons : incident per pixel of the file and view in the open beam
    sod, sdd : distance from the source to the axis and to the panel [mm]
    pitch : of pixels, along rows and along columns [mm]
    axis_column : column of the panel that the rotation axis is projected to
    white : reading of a pixel in the open beam
    reverse : whether the source turns the other way than the file is taken to say
    mirror, flip_rows : whether columns, or rows, are stored in the opposite order
    """

    kvp: float | None = None
    anode: str = "tungsten"
    anode_angle: float = 12.0
    filters: str | None = None
    energy: float | None = None
    spectrum: Path | None = None
    thresholds: tuple[float, ...] | None = None
    sensor: str = "1.6 mm CdTe"
    scintillator: str | None = None
    photons: float | None = None
    sod: float | None = None
    sdd: float | None = None
    pitch: tuple[float, float] | None = None
    axis_column: float | None = None
    white: float | None = None
    reverse: bool = False
    mirror: bool = False
    flip_rows: bool = False

    def completed(self, found: Mapping[str, Any]) -> "Stated":
        """Fill in what a file states.

        Parameters
        ----------
        found : values by name; None for what the file does not state

        Returns
        -------
        the facts; those that the user stated are unchanged
        """
        found = dict(found)
        if self.has_beam:
            found = {name: value for name, value in found.items() if name not in _BEAM}
        if self.thresholds is not None or self.scintillator is not None:
            found = {name: value for name, value in found.items() if name not in ("thresholds", "scintillator")}
        return replace(self, **{name: value for name, value in found.items() if getattr(self, name) is None})

    def require(self, path: Path, names: Sequence[str]) -> None:
        """Ask for all that is missing at once.

        Parameters
        ----------
        path : of the file, for the message
        names : facts that are needed besides the spectrum and the kind of detector

        Raises
        ------
        InputError
            When something is missing; it names the options.
        """
        wanted = ["beam", "filters", "detector", *names]
        missing = [_ASKED[name] for name in wanted if self._lacks(name)]
        if missing:
            what, options = zip(*missing, strict=True)
            raise InputError(f"{path} does not state {_listed(what)}: give {_listed(options)}")

    @property
    def has_beam(self) -> bool:
        """True where the spectrum is known."""
        return any(value is not None for value in (self.kvp, self.energy, self.spectrum))

    def _lacks(self, name: str) -> bool:
        if name == "beam":
            return not self.has_beam
        if name == "filters":
            return self.kvp is not None and self.filters is None
        if name == "detector":
            return self.thresholds is None and self.scintillator is None
        return getattr(self, name) is None


_BEAM = ("kvp", "energy", "spectrum", "filters")
_ASKED = {  # what is missing, and the options that state it
    "beam": ("the spectrum", "--kvp KV, --energy KEV or --spectrum FILE"),
    "filters": ("the filters, inherent ones included", "--filter '2.5 mm Al' (or none)"),
    "detector": ("what a pixel measures", "--thresholds KEV,... for counts or --scintillator CsI for signals"),
    "photons": ("the photons per pixel and view in the open beam", "--photons N"),
    "sod": ("the distance from source to axis", "--sod MM"),
    "sdd": ("the distance from source to panel", "--sdd MM"),
    "pitch": ("the pixel pitch", "--pitch MM"),
    "white": ("the reading in the open beam", "--white LEVEL or --air ROWS,COLUMNS"),
}


def _listed(parts: Sequence[str]) -> str:
    """Parts of a sentence, the last one after an ``and``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
