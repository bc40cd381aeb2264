"""Exposure of the views: expected signals and their noise."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, Shaped

from phantomgen.effects.random_streams import Stream
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.energy_grids import NO_CUTS, compressed_transmission, photon_groups
from phantomgen.simulation.forward_model.photon_noise import compound_signal, dead_time_counts, poisson_counts
from spectra.detector.dead_time import DeadTime
from spectra.detector.pile_up import PileUp, edges_of
from spectra.transmission import Transmission

Images = Float[np.ndarray, "channel row column"]
Groups = Float[np.ndarray, "group row column"]


@dataclass(frozen=True, eq=False)
class Exposure:
    """Expected signals and their noise.

    Parameters
    ----------
    groups : path lengths to expected signals; one channel for each channel of the detector where photons are counted,
        one for each group of photons where their energy is summed up, or for each group of heights that pile up
    names : of the detector's channels
    channels : of the detector, that each group belongs to
    quanta : signal of one photon of each group [keV]; None where photons are counted
    dead_time : of the pixels, None where every event is recorded
    pile_up : of pulses in a dead time, whose heights are those of the groups; None where later pulses are only lost
    """

    groups: Transmission
    names: tuple[str, ...]
    channels: Int[np.ndarray, " group"]
    quanta: Float[np.ndarray, " group"] | None
    dead_time: DeadTime | None = None
    pile_up: PileUp | None = None

    @classmethod
    def of(
        cls,
        scan: Scan,
        lengths: Float[np.ndarray, "ray material"],
        tolerance: float,
        refine: bool = True,
        cuts: Float[np.ndarray, " cut"] = NO_CUTS,
    ) -> tuple["Exposure", float]:
        """Create the exposure for rays with given path lengths, with few energy nodes.

        Parameters
        ----------
        scan : what is simulated
        lengths : path lengths of rays that meet every object [mm]
        tolerance : worst error of log signals that is wanted
        refine : whether nodes may be of no single energy, and fewer
        cuts : of the bins that nodes replace [keV], see `fine_cuts`; the error is that against these

        Returns
        -------
        the exposure, and the worst error of log signals
        """
        groups, error = compressed_transmission(scan, lengths, tolerance, cuts, refine, grouped=True)
        channels, quanta = np.arange(len(scan.detector)), None
        if (photons := photon_groups(scan, groups, lengths, cuts)) is not None:
            groups, channels, quanta = photons
        aperture = scan.effects.aperture
        if aperture is not None:
            groups = replace(groups, weights=groups.weights * aperture.area)
        if scan.effects.grid is not None:
            groups = replace(groups, weights=groups.weights * scan.effects.grid.primary)
        pile_up = None
        if scan.pulses is not None and scan.dead_time is not None:
            pile_up = PileUp(scan.dead_time, scan.detector.thresholds, edges_of(scan.pulses))
            channels = pile_up.channels
        return cls(groups, scan.detector.names, channels, quanta, scan.dead_time, pile_up), error

    @property
    def firsts(self) -> Int[np.ndarray, " channel"]:
        """First group of each channel."""
        return np.searchsorted(self.channels, np.arange(len(self.names)))

    @property
    def transmission(self) -> Transmission:
        """Transmission with the same nodes, and the channels of the detector."""
        starts = self.groups.starts[[*self.firsts, -1]]
        return Transmission(self.groups.columns, self.groups.weights, starts, self.names)

    @property
    def warnings(self) -> list[str]:
        """A sentence where dead time makes counts of the open beam useless."""
        if self.dead_time is None:
            return []
        load = self.dead_time.per_count * float(self.groups.open_beam.sum())
        highest = self.dead_time.highest_load if self.pile_up is None else self.pile_up.highest_load
        if load <= highest:
            return []
        return [
            f"a pixel in the open beam has {load:.3g} events per dead time, more than {highest:g}: "
            "such counts cannot be corrected; use a longer exposure, smaller pixels or fewer photons"
        ]

    def mean(self, expected: Groups) -> Images:
        """Compute the expected signal of each channel.

        Parameters
        ----------
        expected : signals, (group, row, column)

        Returns
        -------
        signals, (channel, row, column)
        """
        if self.pile_up is not None:
            return self.pile_up.recorded(expected)
        if self.dead_time is not None:
            return self.dead_time.recorded(expected)
        return expected if self.quanta is None else np.add.reduceat(expected, self.firsts, axis=0)

    def noisy(self, expected: Groups, seed: int, frame: int, stream: Stream) -> list[Shaped[np.ndarray, "row column"]]:
        """Draw one frame with noise, channel by channel.

        Parameters
        ----------
        expected : signals, (group, row, column)
        seed, frame, stream : key of the noise

        Returns
        -------
        images of all channels
        """
        if self.dead_time is not None:
            parts = expected if self.pile_up is None else self.pile_up.recorded(expected)
            return list(dead_time_counts(parts, expected.sum(axis=0), self.dead_time, seed, frame, stream))
        if self.quanta is None:
            return [poisson_counts(image, seed, frame, c, stream) for c, image in enumerate(expected)]
        parts = zip(np.split(expected, self.firsts[1:]), np.split(self.quanta, self.firsts[1:]), strict=True)
        return [compound_signal(mean, quanta, seed, frame, c, stream) for c, (mean, quanta) in enumerate(parts)]
