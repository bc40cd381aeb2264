"""Sensitivities of counting channels as a function of tube voltage, filter, thresholds and resolution.

A calibration changes these numbers until expected counts agree with measured ones, so that they must follow smoothly
and fast: photons of the bare tube are tabulated at whole kilovolts and interpolated between them, on one energy grid.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import floor

import numpy as np
from jaxtyping import Float

from spectra.detector.detector import AnyDetector, Detector, channels_between
from spectra.detector.pulse_height import PulseHeightDetector
from spectra.energy.grid import Energies
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

# Width of the energy bins [keV]: attenuation changes little inside, and thresholds cut bins in proportion.
_BIN = 0.25

Values = Float[np.ndarray, " argument"]


@dataclass(frozen=True)
class Tube:
    """A reflection tube with what is known about it.

    Parameters
    ----------
    anode : ``tungsten``, ``molybdenum``, ``rhodium`` or ``silver``
    angle : anode angle [degree]
    filters : known filtration, besides that which is to be found
    """

    anode: str = "tungsten"
    angle: float = 12.0
    filters: tuple[Filter, ...] = ()

    def photons(self, voltage: float, edges: Float[np.ndarray, " energy_plus_1"]) -> Float[np.ndarray, " energy"]:
        """Compute the photons that the bare target emits into each bin, per cm^2 and mAs at 1 m.

        Parameters
        ----------
        voltage : tube voltage [kV]
        edges : bin edges [keV]

        Returns
        -------
        photons; linear in the voltage between whole kilovolts, which differs from SpekPy by less than 1e-4
        """
        below = floor(voltage)
        part, key = voltage - below, edges.tobytes()
        photons = _photons(self.anode, self.angle, float(below), key)
        if part == 0:
            return photons
        return (1 - part) * photons + part * _photons(self.anode, self.angle, below + 1.0, key)


@dataclass(frozen=True, eq=False)
class ChannelModel:
    """Map from tube voltage, filter thickness, thresholds and resolution to sensitivities of channels.

    Its argument is one vector: voltage [kV], thickness of the filter [mm], thresholds [keV], and the full width at half
    maximum of the photopeak [keV].

    Parameters
    ----------
    tube : anode and known filters
    filter : material of the filter whose thickness is an argument
    sensor : material of the sensor
    thickness : of the sensor [mm]
    energies : bins on which sensitivities are computed
    fluorescence : whether K fluorescence leaves the sensor; needs a resolution
    """

    tube: Tube
    filter: Material
    sensor: Material
    thickness: float
    energies: Energies
    fluorescence: bool = False

    @staticmethod
    def grid(tube: Tube, materials: tuple[Material, ...], low: float, high: float) -> Energies:
        """Create fine energy bins that do not depend on the arguments of the model.

        Parameters
        ----------
        tube : whose lines get bins of their own
        materials : filters, sensor and absorbers, whose K edges become edges of bins
        low, high : limits of the grid [keV]

        Returns
        -------
        the bins
        """
        bare = Source.tube(high, None, tube.angle, (), tube.anode)
        breaks = [*bare.breaks, *(edge for m in materials for edge in m.k_edges(low, high))]
        return Energies.snapped(low, high, round((high - low) / _BIN), breaks, bare.line_energy)

    def weights(self, values: Values) -> Float[np.ndarray, "channel energy"]:
        """Compute photons x response of every channel and energy bin.

        Parameters
        ----------
        values : voltage [kV], filter [mm], thresholds [keV] and resolution [keV], in this order

        Returns
        -------
        counts of the open beam, per cm^2 and mAs at 1 m

        Raises
        ------
        InputError
            When thresholds do not ascend or are too low for the resolution.
        """
        voltage, thickness = float(values[0]), float(values[1])
        bare = self.tube.photons(voltage, self.energies.edges) * self._known
        return bare * np.exp(-thickness * self._mu) * self.detector(values).response(self.energies)

    def source(self, values: Values) -> Source:
        """Create the source of these values, by SpekPy at this very voltage.

        Parameters
        ----------
        values : as for `weights`

        Returns
        -------
        the source, per cm^2 and mAs at 1 m
        """
        sheets = (*self.tube.filters, Filter(self.filter, float(values[1])))
        return Source.tube(float(values[0]), None, self.tube.angle, sheets, self.tube.anode)

    def detector(self, values: Values, top: float | None = None) -> AnyDetector:
        """Create the detector of these values.

        Parameters
        ----------
        values : as for `weights`
        top : stated end of the last channel [keV]; that of the energy grid where left out

        Returns
        -------
        the detector
        """
        resolution = float(values[-1])
        end = float(self.energies.edges[-1]) if top is None else top
        channels = channels_between([float(t) for t in values[2:-1]], end)
        if resolution == 0:
            return Detector(channels, self.sensor, self.thickness)
        return PulseHeightDetector(channels, self.sensor, self.thickness, resolution, self.fluorescence)

    @cached_property
    def _mu(self) -> Float[np.ndarray, " energy"]:
        """Attenuation of the filter [1/mm]."""
        return self.filter.attenuation(self.energies.nodes)

    @cached_property
    def _known(self) -> Float[np.ndarray, " energy"]:
        """Part of the photons that passes the known filters."""
        passed = [sheet.transmission(self.energies.nodes) for sheet in self.tube.filters]
        return np.prod([np.ones(len(self.energies.nodes)), *passed], axis=0)


def parameter_names(channels: int) -> tuple[str, ...]:
    """Return names of the arguments of a `ChannelModel`.

    Parameters
    ----------
    channels : number of channels

    Returns
    -------
    ``voltage``, ``filter``, ``threshold_0`` and so on, ``resolution``
    """
    return ("voltage", "filter", *(f"threshold_{c}" for c in range(channels)), "resolution")


@lru_cache(maxsize=64)
def _photons(anode: str, angle: float, voltage: float, edges: bytes) -> Float[np.ndarray, " energy"]:
    """Photons of a bare tube in bins, whose edges are given as bytes to be a key of the cache."""
    source = Source.tube(voltage, None, angle, (), anode)
    return np.asarray(source.photons_in(np.frombuffer(edges))[0])
