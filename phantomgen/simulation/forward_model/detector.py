"""Detector stages: signal and readings from the photons that reach the detector, in the order of physics.

1. `DetectorStages.registered`: what each frame leaves in the sensor.
   Counters: blur of expected counts, gain, dead time and photon noise; sums above thresholds where these are counted.
   Energy-integrating detectors: photon noise, blur of the light, gain.
2. afterglow, from view to view: `phantomgen.effects.lag`, which `phantomgen.simulation.forward_model.readout` applies
    in order.
3. `DetectorStages.read`: offset and noise of the electronics, then dead and hot pixels.

What a scene does not ask for is left out: then images pass as they are, bit by bit.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Shaped, UInt32

from phantomgen.effects.blur import Kernel, blurred
from phantomgen.effects.defects import stuck
from phantomgen.effects.random_streams import Stream
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.energy_grids import photons_behind
from phantomgen.simulation.forward_model.exposure import Exposure, Groups, Images
from phantomgen.simulation.forward_model.photon_noise import coincident_counts
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from spectra.detector.coincidences import CoincidenceShares
from spectra.detector.counters import above_thresholds
from spectra.detector.pulse_height import PulseHeightDetector

Frame = list[Shaped[np.ndarray, "row column"]]


@dataclass(frozen=True, eq=False)
class DetectorStages:
    """Stages of a scan's detector, with the patterns that all of its frames share.

    Parameters
    ----------
    scan : what is scanned
    exposure : energies, and how noise is drawn

    Attributes
    ----------
    kernels : of the blur along columns and rows; None where there is none
    gains : of every pixel in views and in flats; empty where there is no gain map
    mask : bits that say what is wrong with each pixel; None where nothing is
    coincidences : photons that count in two pixels; None where counts of pixels are independent
    """

    scan: Scan
    exposure: Exposure
    kernels: tuple[Kernel, Kernel] | None = field(init=False)
    gains: dict[Stream, Float[np.ndarray, "channel row column"]] = field(init=False)
    mask: UInt32[np.ndarray, "row column"] | None = field(init=False)
    coincidences: CoincidenceShares | None = field(init=False)

    def __post_init__(self) -> None:
        seed, effects, panel = self.scan.seed, self.scan.effects, self.scan.geometry.panel
        shape, gain = (panel.rows, panel.columns), effects.gain
        gains = (
            {}
            if gain is None
            else {s: gain.maps(seed, len(self.scan.detector), *shape, s) for s in (Stream.PROJECTION, Stream.FLAT)}
        )
        object.__setattr__(self, "kernels", None if effects.blur is None else effects.blur.kernels(panel))
        object.__setattr__(self, "gains", gains)
        object.__setattr__(self, "mask", None if effects.defects is None else effects.defects.mask(seed, *shape))
        object.__setattr__(self, "coincidences", self._coincidences())

    def _coincidences(self) -> CoincidenceShares | None:
        """Photons that count twice, where counts of neighbours are drawn together."""
        detector = self.scan.detector
        if not (self.scan.noise and isinstance(detector, PulseHeightDetector) and detector.charge_sharing is not None):
            return None
        if not detector.charge_sharing.covariance:
            return None
        return CoincidenceShares.of(detector, *photons_behind(self.scan, sampled_lengths(self.scan)))

    @property
    def warnings(self) -> list[str]:
        """A sentence where the covariance of neighbours is not whole."""
        if self.coincidences is None or self.coincidences.part == 1:
            return []
        return [
            f"so many photons count in three or four pixels that the covariance of neighbours is drawn with "
            f"{self.coincidences.part:.0%} of its size: mean counts are right"
        ]

    @property
    def recorded_mask(self) -> UInt32[np.ndarray, "row column"] | None:
        """Mask that the dataset states; None where there is none, or where it is withheld."""
        defects = self.scan.effects.defects
        return self.mask if defects is not None and defects.masked else None

    @property
    def counts_photons(self) -> bool:
        """True when photons are counted; otherwise their energies are added."""
        return self.exposure.quanta is None

    @property
    def reads_zero(self) -> bool:
        """True when frames without beam contain nothing."""
        return self.mask is None and self.scan.effects.electronics is None

    def registered(self, expected: Groups, frame: int, stream: Stream, noise: bool) -> Frame:
        """Compute the signals that a frame leaves in the sensor, channel by channel.

        Parameters
        ----------
        expected : expected signals of each group of photons
        frame : number of the frame
        stream : kind of the frame
        noise : whether photon noise is added

        Returns
        -------
        signals of each channel, (row, column)
        """
        if self.counts_photons:
            counts = self._exposed(self._shaped(expected, stream), frame, stream, noise)
            return list(above_thresholds(np.stack(counts))) if self.scan.cumulative else counts
        signals = self._exposed(expected, frame, stream, noise)
        return list(self._shaped(np.stack(signals), stream)) if self.kernels or self.gains else signals

    def read(self, signals: Frame | Images, frame: int, stream: Stream, noise: bool) -> Frame:
        """Compute the readings of signals by the electronics.

        Parameters
        ----------
        signals : signals of each channel
        frame : number of the frame
        stream : kind of the frame
        noise : whether electronic noise is added

        Returns
        -------
        readings of each channel, (row, column)
        """
        kind = np.int32 if noise and self.counts_photons else np.float32
        images = [image.astype(kind, copy=False) for image in self._offset(signals, frame, stream, noise)]
        return images if self.mask is None else [self._stuck(image, c) for c, image in enumerate(images)]

    def _exposed(self, expected: Groups, frame: int, stream: Stream, noise: bool) -> Frame:
        """Signals by photons."""
        if not noise:
            return list(self.exposure.mean(expected))
        if self.coincidences is None:
            return self.exposure.noisy(expected, self.scan.seed, frame, stream)
        detector, panel = self.scan.detector, self.scan.geometry.panel
        assert isinstance(detector, PulseHeightDetector)
        assert detector.charge_sharing is not None
        down, right = (pitch / detector.charge_sharing.pitch for pitch in (panel.row_pitch, panel.column_pitch))
        return list(coincident_counts(expected, self.coincidences.shares, (down, right), self.scan.seed, frame, stream))

    def _shaped(self, images: Groups, stream: Stream) -> Groups:
        """Images blurred, and times the gain of each pixel."""
        if self.kernels is not None:
            images = np.stack([blurred(image, self.kernels) for image in images])
        if not self.gains:
            return images
        gains = self.gains[stream]
        return images * (gains[self.exposure.channels] if self.counts_photons else gains)

    def _offset(self, signals: Frame | Images, frame: int, stream: Stream, noise: bool) -> Frame:
        """Signals after the amplifier."""
        electronics = self.scan.effects.electronics
        if electronics is None:
            return list(signals)
        if not noise:
            return [image + electronics.offset for image in signals]
        return [electronics.reading(s, self.scan.seed, frame, c, stream) for c, s in enumerate(signals)]

    def _stuck(self, image: Shaped[np.ndarray, "row column"], channel: int) -> Shaped[np.ndarray, "row column"]:
        """An image with the readings of defective pixels."""
        defects = self.scan.effects.defects
        if defects is None or self.mask is None:
            return image
        beam = self.exposure.transmission.open_beam
        level = (above_thresholds(beam) if self.scan.cumulative else beam)[channel]
        return stuck(image, self.mask, defects.level * float(level))
