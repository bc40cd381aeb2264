"""Beam quality: half-value layers, mean and effective energy, and air kerma of a source.

Integrals run over the source's piecewise-linear density by Gauss-Legendre rules between its corners and all edges, and
over its lines one by one, so that what is left is the error of the attenuation tables. Half-value layers are those of
air kerma, as dosimetry defines and measures them (ICRU Report 85a); a source of one energy gives ln 2 / mu.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from spectra.elements.attenuation import HIGHEST_ENERGY, LOWEST_ENERGY
from spectra.energy.grid import EnergyArray
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Source

ALUMINIUM, COPPER = Material("aluminium", composition="Al"), Material("copper", composition="Cu")

# Mass energy-absorption coefficient of dry air [cm^2/g] at [keV]: NIST SRD 126 (Hubbell & Seltzer), table 4.
# Two tables, as argon's K edge divides them.
_AIR_BELOW_EDGE = {1: 3599, 1.5: 1188, 2: 526.2, 3: 161.4, 3.2029: 133.0}
_AIR_ABOVE_EDGE = {
    **{3.20291: 146.0, 4: 76.36, 5: 39.31, 6: 22.70, 8: 9.446, 10: 4.742, 15: 1.334, 20: 0.5389, 30: 0.1537},
    **{40: 0.06833, 50: 0.04098, 60: 0.03041, 80: 0.02407, 100: 0.02325, 150: 0.02496, 200: 0.02672, 300: 0.02872},
    **{400: 0.02949, 500: 0.02966, 600: 0.02953, 800: 0.02882},
}
# Energy [keV] between the two tables, just above the last one of the first.
_ARGON_EDGE = 3.20290001
# Exact in the SI since 2019.
_JOULE_PER_KEV = 1.602176634e-16
# 1 cm^2/g is 0.1 m^2/kg, and 1 m^2 is 10^6 mm^2.
_GRAY_MM2 = _JOULE_PER_KEV * 0.1 * 1e6
_WIDEST, _NODES = 0.5, 3  # keV between nodes of the rules, and nodes in each interval
# Most steps of the search for a thickness, which converges in a few.
_MOST_STEPS = 200


@dataclass(frozen=True)
class BeamQuality:
    """Beam quality of a source, as measured with a dosimeter behind metal sheets.

    Parameters
    ----------
    mean_energy : of the photons [keV]
    kerma_per_fluence : air kerma per photon and area [Gy mm^2]
    hvl1, hvl2 : first and second half-value layer of air kerma [mm]
    effective_energy : of a single-energy source with the same first half-value layer [keV]
    """

    mean_energy: float
    kerma_per_fluence: float
    hvl1: float
    hvl2: float
    effective_energy: float

    @classmethod
    def of(cls, source: Source, material: Material = ALUMINIUM) -> "BeamQuality":
        """Compute the beam quality of a source.

        Parameters
        ----------
        source : spectrum
        material : of the attenuating layers

        Returns
        -------
        mean energy, kerma, half-value layers and effective energy
        """
        first, second = half_value_layers(source, material)
        kerma = kerma_per_fluence(source)
        return cls(mean_energy(source), kerma, first, second, effective_energy(source, material))

    @property
    def homogeneity(self) -> float:
        """First over second half-value layer, 1 for a single energy."""
        return self.hvl1 / self.hvl2


def mean_energy(source: Source) -> float:
    """Compute the mean energy of the photons.

    Parameters
    ----------
    source : spectrum

    Returns
    -------
    energy [keV]
    """
    photons, mean = source.photons_in(np.array([0.0, source.maximum]))
    return float(mean[0] if photons[0] > 0 else source.maximum)


def kerma_per_fluence(source: Source) -> float:
    """Compute the air kerma per photon fluence.

    Parameters
    ----------
    source : spectrum

    Returns
    -------
    kerma per fluence [Gy mm^2]; times photons per mm^2 it is air kerma in Gy
    """
    energy, photons = _nodes(source, ())
    return float(photons @ (energy * air_absorption(energy)) / photons.sum()) * _GRAY_MM2


def half_value_layers(source: Source, material: Material = ALUMINIUM) -> tuple[float, float]:
    """Compute the first and the second half-value layer of air kerma.

    Parameters
    ----------
    source : spectrum
    material : of the layers

    Returns
    -------
    thickness that halves the air kerma, and further thickness that halves it again [mm]
    """
    half, quarter = (attenuating_thickness(source, material, part) for part in (0.5, 0.25))
    return half, quarter - half


def attenuating_thickness(source: Source, material: Material, fraction: float) -> float:
    """Compute the thickness of `material` that transmits `fraction` of the air kerma.

    Parameters
    ----------
    source : spectrum
    material : of the sheet
    fraction : air kerma behind the sheet over air kerma without it, between 0 and 1

    Returns
    -------
    thickness [mm]

    Raises
    ------
    InputError
        When the fraction is not between 0 and 1.

    Notes
    -----
    The logarithm of the kerma is convex in the thickness, so that Newton's steps from 0 never go too far; for a single
    energy the first one arrives.
    """
    if not 0 < fraction < 1:
        raise InputError(f"the fraction of air kerma that is left must lie between 0 and 1, got {fraction:g}")
    energy, photons = _nodes(source, material.k_edges(0.0, source.maximum))
    kerma, mu = photons * energy * air_absorption(energy), material.attenuation(energy)
    thickness, goal = 0.0, np.log(fraction)
    for _ in range(_MOST_STEPS):
        shift = (mu * thickness).min()
        left = kerma * np.exp(shift - mu * thickness)
        step = float((np.log(left.sum() / kerma.sum()) - shift - goal) * left.sum() / (left @ mu))
        thickness += step
        if abs(step) <= 1e-12 * thickness:
            break
    return thickness


def effective_energy(source: Source, material: Material = ALUMINIUM) -> float:
    """Compute the energy of a single-energy source with the same first half-value layer.

    Where K edges make several energies possible, the one next to the mean energy.

    Parameters
    ----------
    source : spectrum
    material : of the layers

    Returns
    -------
    energy [keV]
    """
    if source.is_monochromatic:
        return source.maximum
    target = np.log(2) / attenuating_thickness(source, material, 0.5)

    def excess(energy: float) -> float:
        return float(material.attenuation(np.array([energy]))[0] - target)

    grid = np.geomspace(LOWEST_ENERGY, source.maximum, 2000)
    above = material.attenuation(grid) > target
    falls = np.flatnonzero(above[:-1] & ~above[1:])
    found = np.array([brentq(excess, grid[i], grid[i + 1], xtol=1e-10) for i in falls])
    return float(found[np.argmin(np.abs(found - mean_energy(source)))])


def air_absorption(energy: EnergyArray) -> EnergyArray:
    """Compute the mass energy-absorption coefficient of dry air.

    Cubic splines of the logarithms through the printed values, one on either side of argon's K edge.

    Parameters
    ----------
    energy : photon energies, 1 to 800 keV

    Returns
    -------
    coefficient [cm^2/g]

    Raises
    ------
    InputError
        When an energy is outside the table.
    """
    energy = np.asarray(energy, dtype=np.float64)
    if not ((energy >= LOWEST_ENERGY) & (energy <= HIGHEST_ENERGY)).all():
        raise InputError(f"the absorption of air is known from {LOWEST_ENERGY:g} to {HIGHEST_ENERGY:g} keV only")
    below, above = (_spline(table)(np.log(energy)) for table in (_AIR_BELOW_EDGE, _AIR_ABOVE_EDGE))
    return np.exp(np.where(energy < _ARGON_EDGE, below, above))


def _spline(table: dict[float, float]) -> CubicSpline:
    """Logarithm of a coefficient over that of energy."""
    return CubicSpline(np.log(list(table)), np.log(list(table.values())))


def _nodes(source: Source, edges: tuple[float, ...]) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Energies [keV] and photons whose sums are the integrals over a source; lines are nodes of their own."""
    if len(source.energy) < 2:
        return source.line_energy, source.line_photons
    low, high = float(source.energy[0]), float(source.energy[-1])
    inside = [edge for edge in (*edges, _ARGON_EDGE) if low < edge < high]
    even = np.linspace(low, high, ceil((high - low) / _WIDEST) + 1)
    cuts = np.unique(np.concatenate([source.energy, inside, even]))
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    width = np.diff(cuts)[:, None]
    energy = (cuts[:-1, None] + width * (1 + node) / 2).ravel()
    photons = np.append((width * weight / 2).ravel() * source.density_at(energy), source.line_photons)
    seen = photons > 0
    return np.append(energy, source.line_energy)[seen], photons[seen]
