"""The frames of a scan: expected signals, and what the detector makes of them.

A frame passes these stages, in this order. What a scene does not ask for is left out and costs nothing.

1. `Views.expected`: rays through the objects, averaged over pixels and focal spot; scatter; tube output
2. `Views.registered`: photon noise, blur and gain of the detector (`phantomgen.simulation.forward_model.detector`)
3. afterglow, the only stage in which frames depend on each other (`phantomgen.simulation.forward_model.readout`)
4. `Views.read`: the electronics, then dead and hot pixels
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.detector import DetectorStages, Frame
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import expected_view, open_beam
from phantomgen.simulation.forward_model.exposure import Exposure, Groups, Images
from phantomgen.simulation.forward_model.tube_output import tube_output
from spectra.transmission import Transmission

if TYPE_CHECKING:
    from phantomgen.simulation.forward_model.scatter import Scatter

Primary = Callable[[int, Transmission], Groups]


@dataclass(frozen=True, eq=False)
class Views:
    """Projections and flats of a scan, one frame at a time; frames are independent of each other.

    Parameters
    ----------
    scan : what is scanned
    exposure : energies, and how noise is drawn
    settings : how finely views are computed
    cached : function that returns primary signals of a view, in place of rays through objects; None where rays are
        traced

    Attributes
    ----------
    output : of the tube, in each view and in each flat, relative to the exposure of the scan
    known_output : what the dataset states of that of the views; None where that is 1
    detector : stages of the detector
    scatter : function of a view and its primary signal that returns the scattered signal; None where there is none
    """

    scan: Scan
    exposure: Exposure
    settings: Settings = field(default_factory=Settings)
    output: dict[Stream, Float[np.ndarray, " frame"]] = field(init=False)
    known_output: Float[np.ndarray, " view"] | None = field(init=False)
    detector: DetectorStages = field(init=False)
    scatter: "Scatter | None" = field(init=False)
    cached: Primary | None = None

    def __post_init__(self) -> None:
        output, known = tube_output(self.scan, self.exposure.groups)
        object.__setattr__(self, "output", output)
        object.__setattr__(self, "known_output", known)
        object.__setattr__(self, "detector", DetectorStages(self.scan, self.exposure))
        object.__setattr__(self, "scatter", self._scatter())

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Views, channels, rows, columns."""
        scan = self.scan
        return len(scan.geometry), len(scan.detector), scan.geometry.panel.rows, scan.geometry.panel.columns

    @property
    def recorded_exposure(self) -> Float[np.ndarray, " view"] | Float[np.ndarray, "view channel"] | None:
        """Exposure of each view [and channel] that the dataset states; None where all are 1."""
        if self.known_output is None:
            return self.scan.exposure
        return self.known_output if self.scan.exposure is None else self.scan.exposure * self.known_output[:, None]

    def expected(self, frame: int, stream: Stream = Stream.PROJECTION) -> Groups:
        """Compute the expected signals of one view, or of one flat, before the detector.

        Parameters
        ----------
        frame : number of the frame
        stream : kind of the frame

        Returns
        -------
        signals, (group, row, column)
        """
        groups = self.exposure.groups
        if stream is Stream.FLAT:
            return open_beam(self.scan, groups) * self.output[stream][frame]
        primary = self.primary(frame, groups)
        if self.scatter is not None:
            primary += self.scatter(frame, primary)
        if self.scan.exposure is not None:
            primary *= self.scan.exposure[frame][self.exposure.channels][:, None, None]
        primary *= self.output[stream][frame]
        return primary

    def primary(self, view: int, transmission: Transmission) -> Groups:
        """Compute the expected signals of unscattered photons.

        Parameters
        ----------
        view : number of the view
        transmission : path lengths to signals, with the groups of the exposure or its channels

        Returns
        -------
        signals, (group, row, column)
        """
        if self.cached is not None:
            return self.cached(view, transmission)
        return expected_view(self.scan, transmission, view, self.settings)

    def _scatter(self) -> "Scatter | None":
        """Model of scatter, whose strength the first view decides."""
        if self.scan.effects.scatter is None:
            return None
        from phantomgen.simulation.forward_model.scatter import scatter_of  # noqa: PLC0415 - only where there is scatter

        groups = self.exposure.groups
        first = self.primary(0, groups)
        return scatter_of(self.scan, self.exposure, self.settings, first, open_beam(self.scan, groups))

    def registered(
        self, expected: Groups, frame: int, stream: Stream = Stream.PROJECTION, noise: bool | None = None
    ) -> Frame:
        """Compute the signals that a frame leaves in the sensor.

        Parameters
        ----------
        expected : expected signals, (group, row, column)
        frame : number of the frame
        stream : kind of the frame
        noise : whether photon noise is added; as the scan has it where not given

        Returns
        -------
        signals of each channel
        """
        return self.detector.registered(expected, frame, stream, self.scan.noise if noise is None else noise)

    def read(
        self, signals: Frame | Images, frame: int, stream: Stream = Stream.PROJECTION, noise: bool | None = None
    ) -> Frame:
        """Compute the readings of signals, channel by channel.

        Parameters
        ----------
        signals : signals of each channel
        frame : number of the frame
        stream : kind of the frame
        noise : whether electronic noise is added; as the scan has it where not given

        Returns
        -------
        readings of each channel
        """
        return self.detector.read(signals, frame, stream, self.scan.noise if noise is None else noise)
