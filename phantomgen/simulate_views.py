"""The frames of a scan: expected signals, and what the detector makes of them.

A frame passes these stages, in this order. What a scene does not ask for is left out and costs nothing.

1. `Views.expected`: rays through the objects, averaged over pixels; tube output
2. `Views.measured`: noise of photons
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Shaped

from phantomgen.noise import Stream
from phantomgen.ops.expose import expose
from phantomgen.scene import Scan
from phantomgen.settings import Settings
from phantomgen.simulate_noise import Exposure, Groups, Images
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Views:
    """Projections and flats of a scan, one frame at a time; frames are independent of each other.

    Parameters
    ----------
    scan : what is scanned
    exposure : energies, and how noise is drawn
    settings : how finely views are computed
    output : of the tube, in each view and in each flat, relative to the exposure that is asked for
    """

    scan: Scan
    exposure: Exposure
    settings: Settings = field(default_factory=Settings)
    output: dict[Stream, Float[np.ndarray, " frame"]] = field(init=False)

    def __post_init__(self) -> None:
        frames = {Stream.PROJECTION: len(self.scan.geometry), Stream.FLAT: self.scan.flats}
        tube = self.scan.effects.tube_output
        ones = {stream: np.ones(count) for stream, count in frames.items()}
        output = ones if tube is None else {s: tube.factors(self.scan.seed, s, count) for s, count in frames.items()}
        object.__setattr__(self, "output", output)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Views, channels, rows, columns."""
        scan = self.scan
        return len(scan.geometry), len(scan.detector), scan.geometry.panel.rows, scan.geometry.panel.columns

    @property
    def recorded_exposure(self) -> Float[np.ndarray, " view"] | Float[np.ndarray, "view channel"] | None:
        """Exposure of each view [and channel] that the dataset tells; None where all are 1."""
        tube = self.scan.effects.tube_output
        if tube is None or not tube.recorded:
            return self.scan.exposure
        output = self.output[Stream.PROJECTION]
        return output if self.scan.exposure is None else self.scan.exposure * output[:, None]

    def expected(self, frame: int, stream: Stream = Stream.PROJECTION) -> Groups:
        """Expected signals of one view, or of one flat, before the detector."""
        groups = self.exposure.groups
        if stream is Stream.FLAT:
            return open_beam(self.scan, groups) * self.output[stream][frame]
        primary = expected_view(self.scan, groups, frame, self.settings)
        if self.scan.exposure is not None:
            primary *= self.scan.exposure[frame][self.exposure.channels][:, None, None]
        primary *= self.output[stream][frame]
        return primary

    def mean(self, expected: Groups) -> Images:
        """Signals of a frame without noise."""
        return self.exposure.mean(expected)

    def measured(
        self, expected: Groups, frame: int, stream: Stream = Stream.PROJECTION
    ) -> list[Shaped[np.ndarray, "row column"]]:
        """Signals of a frame with noise, channel by channel; without, where the scan has none."""
        if not self.scan.noise:
            return [image.astype(np.float32) for image in self.mean(expected)]
        return self.exposure.noisy(expected, self.scan.seed, frame, stream)


def expected_view(scan: Scan, transmission: Transmission, view: int, settings: Settings) -> Groups:
    """Expected signals of one view and group of photons, averaged over each pixel's area."""
    panel = scan.geometry.panel
    return expose(
        scan.geometry.ray_frames()[view],
        panel.rows,
        panel.columns,
        scan.scene.solids,
        transmission.columns,
        transmission.weights,
        transmission.starts,
        scan.scene.background,
        profile=None if scan.profile is None else scan.profile.lengths,
        **settings.pixels,
    ).counts


def open_beam(scan: Scan, transmission: Transmission) -> Groups:
    """Expected signals of one view without any object."""
    pixels = (scan.geometry.panel.rows, scan.geometry.panel.columns)
    if scan.profile is None:
        return np.broadcast_to(transmission.open_beam[:, None, None], (len(transmission), *pixels))
    lengths = np.zeros((*pixels, len(transmission.columns)))
    lengths[:, :, -len(scan.profile.names) :] = np.moveaxis(scan.profile.lengths, 0, -1)
    return np.moveaxis(transmission.expected(lengths), -1, 0)
