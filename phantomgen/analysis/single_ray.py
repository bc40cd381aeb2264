"""Counts of a single ray, and how well the channels separate the basis functions, in air and behind an object."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.scene.scan import Scan
from spectra.cramer_rao import least_deviations
from spectra.elements.attenuation import LOWEST_ENERGY
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.transmission import Transmission

BEHIND = "20 cm water"
STEP = 0.25  # keV, bins between edges; halving it moves bounds by less than 1e-4
_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_LAYER = re.compile(r"\s*([0-9.eE+-]*[0-9.])\s*(mm|cm|m)\s+(\S.*?)\s*$")


@dataclass(frozen=True)
class Layer:
    """Slab of material in the beam.

    Parameters
    ----------
    material : of the slab
    thickness : [mm]
    """

    material: Material
    thickness: float


@dataclass(frozen=True, eq=False)
class SingleRayBound:
    """Expected counts of one ray, and the Cramer-Rao bound of its basis line integrals.

    Parameters
    ----------
    transmission : basis line integrals on top of what is in the beam, to counts; sums of energies are in units in
        which their variance is their mean
    unit : of each channel: 1 for counts, else the signal [keV] that stands for one
    """

    transmission: Transmission
    unit: Float[np.ndarray, " channel"]

    @classmethod
    def of(
        cls, scan: Scan, layers: tuple[Layer, ...] = (), traces: Mapping[str, float] | None = None
    ) -> "SingleRayBound":
        """Create the channels of a scan behind layers, which attenuate by their exact curves.

        Parameters
        ----------
        scan : source, channels and basis
        layers : what is in the beam
        traces : line integrals of basis functions that are in the beam as well [no unit]

        Returns
        -------
        the bound
        """
        energies, photons = scan_photons(scan, layers)
        columns = scan.basis.evaluate(energies.nodes)
        lengths = np.array([(traces or {}).get(name, 0.0) for name in scan.basis.names])
        weights = scan.detector.response(energies) * photons * np.exp(-lengths @ columns)
        unit, variance = np.ones(len(weights)), scan.detector.variance(energies)
        if variance is not None:
            signal = weights.sum(axis=1)
            varying = (variance * photons * np.exp(-lengths @ columns)).sum(axis=1)
            unit = np.divide(varying, signal, out=unit, where=signal > 0)
        return cls(Transmission.from_spectrum(weights / unit[:, None], columns, scan.detector.names), unit)

    @property
    def counts(self) -> Float[np.ndarray, " channel"]:
        """Expected counts per pixel and view, or their energy [keV] where the detector sums that up."""
        return self.transmission.open_beam * self.unit

    @property
    def bounds(self) -> Float[np.ndarray, " basis"]:
        """Cramer-Rao bounds of the basis line integrals [no unit]; infinite where channels cannot separate them."""
        return least_deviations(self.transmission.fisher(np.zeros(len(self.transmission.columns))))

    @property
    def slopes(self) -> Float[np.ndarray, "channel basis"]:
        """Derivatives of the log projections by the line integrals [no unit]."""
        return self.transmission.log_projection_and_slopes(np.zeros(len(self.transmission.columns)))[1]


def scan_photons(scan: Scan, layers: tuple[Layer, ...] = ()) -> tuple[Energies, Float[np.ndarray, " energy"]]:
    """Return energy bins that break at every edge, and photons per pixel and view behind layers.

    Parameters
    ----------
    scan : source and channels
    layers : slabs in the beam

    Returns
    -------
    bins, and photons in each
    """
    source, detector, basis = scan.source, scan.detector, scan.basis
    low = max(LOWEST_ENERGY, float(np.concatenate([source.energy, source.line_energy]).min()) - STEP)
    edges = (edge for layer in layers for edge in layer.material.k_edges(low, source.maximum))
    count = ceil((source.maximum - low) / STEP)
    energies, photons = source.sampled(source.grid(low, count, (*detector.breaks, *basis.breaks, *edges)))
    for layer in layers:
        photons = photons * np.exp(-layer.thickness * layer.material.attenuation(energies.nodes, basis))
    return energies, photons


def layers_of(text: str, scan: Scan) -> tuple[Layer, ...]:
    """Parse layers from text such as ``20 cm water + 5 mm bone``.

    Materials are those of the scene, else known by name.

    Parameters
    ----------
    text : the layers
    scan : the scan

    Returns
    -------
    the layers
    """
    return tuple(_layer(part, text, scan) for part in text.split("+")) if text.strip() else ()


def _layer(part: str, text: str, scan: Scan) -> Layer:
    """One layer."""
    found = _LAYER.match(part)
    if found is None:
        raise InputError(f"--behind {text!r}: write thickness, unit and material, such as '20 cm water + 5 mm bone'")
    number, unit, name = found.groups()
    try:
        thickness = float(number) * _MILLIMETRES[unit]
    except ValueError:
        raise InputError(f"--behind {text!r}: {number!r} is no number") from None
    if not 0 <= thickness < np.inf:
        raise InputError(f"--behind {text!r}: a thickness must be finite and not negative, got {number} {unit}")
    own = {material.name: material for material in scan.scene.materials}
    return Layer(own[name] if name in own else Material(name, composition=name), thickness)
