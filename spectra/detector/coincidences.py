"""Photons that count in two neighbouring pixels, by shared charge or by fluorescence that moved.

A pixel's counts are Poisson numbers, but a photon that counts in two pixels adds to both. The covariance of the counts
of channel a in a pixel and of channel b in a neighbour is the mean number of photons that count in both.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls
from scipy.special import ndtr

from spectra.detector.pulse_height import PulseHeightDetector
from spectra.detector.semiconductor import collected, escape, fluorescence_paths, lattice
from spectra.elements.attenuation import k_shell_share
from spectra.energy.grid import Energies
from spectra.threads import run_parallel

# Neighbours: along a row or a column, and across a corner.
STEPS = ((0, 1), (1, 1))
_EVENTS = 2048  # 1 % rms of the coincidences
_REACH = 2  # pixels on each side of the photon's own in which charge is followed
_ENERGIES = 2  # tabulated energies per standard deviation of the resolution, between which cubic splines are taken
_DARK = 5.0  # standard deviations below the lowest threshold, where no pulse counts

Coincidences = Float[np.ndarray, "step channel channel energy"]


@dataclass(frozen=True, eq=False)
class CoincidenceShares:
    """Coincidences as sums of mean counts, which determine them well enough whatever the photons have passed.

    Parameters
    ----------
    shares : coincidences of channels a and b in neighbours of each kind of `STEPS`, per count of each channel c
    error : largest error of a coefficient of correlation on the rays that shares were fitted to
    part : of the coincidences that `shares` has; below 1 where so many photons count in three or four pixels that pairs
        alone would be more than there are counts
    """

    shares: Float[np.ndarray, "step channel channel channel"]
    error: float
    part: float

    @classmethod
    def of(
        cls, detector: PulseHeightDetector, energies: Energies, photons: Float[np.ndarray, "ray energy"]
    ) -> "CoincidenceShares":
        """Fit the shares, none of them negative.

        Parameters
        ----------
        detector : with shared charge
        energies : energy bins
        photons : that arrive along some rays, in each bin

        Returns
        -------
        the shares
        """
        counts = photons @ detector.response(energies).T
        at_once = detector.absorption(energies.nodes) * coincidences(detector, energies.nodes)
        exact = np.einsum("re,sabe->rsab", photons, at_once)
        partners = 4 * exact.sum(axis=(1, 3))
        part = min(1.0, float(np.min(counts / np.maximum(partners, 1e-300), where=partners > 0, initial=1.0)))
        shares, error = np.zeros((*exact.shape[1:], len(detector))), 0.0
        for step, a, b in np.ndindex(*exact.shape[1:]):
            scale = np.sqrt(np.maximum(counts[:, a] * counts[:, b], 1e-300))
            found, _ = nnls(counts / scale[:, None], exact[:, step, a, b] / scale)
            shares[step, a, b] = found
            error = max(error, float(np.abs((counts @ found - exact[:, step, a, b]) / scale).max()))
        return cls(part * shares, error, part)


def coincidences(detector: PulseHeightDetector, energy: Float[np.ndarray, " energy"]) -> Coincidences:
    """Compute how many photons count in two neighbouring pixels, per absorbed photon and for one of its neighbours.

    Photons fall uniformly on the sensor, and all pixels are counted. Every pixel has four neighbours of each kind.

    Parameters
    ----------
    detector : with shared charge
    energy : photon energies [keV]

    Returns
    -------
    coincidences of channel a in a pixel and channel b in its neighbour, symmetric in both, for the kinds of `STEPS`
    """
    emitted = [(line, rate * k_shell_share(detector.composition, z, energy)) for z, line, rate in detector.lines]
    tables = run_parallel(lambda line: _table(detector, line), [0.0, *(line for line, _ in emitted)])
    whole, *moved = tables
    found = _at(whole, energy)
    for (line, share), table in zip(emitted, moved, strict=True):
        escaped = escape(detector.material.attenuation(energy), _attenuation(detector, line), detector.thickness)
        without = escaped * _at(whole, np.maximum(energy - line, 0.0)) + _at(table, np.maximum(energy, line))
        found = found + share * (without - _at(whole, energy))
    return np.maximum(found, 0.0)


def _at(table: CubicSpline, energy: Float[np.ndarray, " energy"]) -> Coincidences:
    """Values of a table between its energies."""
    return np.asarray(table(energy))


def _attenuation(detector: PulseHeightDetector, line: float) -> float:
    """Attenuation of a line in the sensor [1/mm]."""
    return float(detector.material.attenuation(np.array([line]))[0])


def _table(detector: PulseHeightDetector, line: float) -> CubicSpline:
    """Coincidences per photon whose fluorescence of `line` stays in the sensor; of photons without any for line 0."""
    energies = detector.energy_grid(line, _ENERGIES)
    return CubicSpline(energies, np.stack([_sums(detector, line, e) for e in energies], axis=-1), axis=-1)


def _sums(detector: PulseHeightDetector, line: float, energy: float) -> Float[np.ndarray, "step channel channel"]:
    """Sums over events of one energy."""
    weights, heights = _heights(detector, line, energy)
    counted = heights > detector.thresholds[0] - _DARK * detector.sigma
    above = np.zeros((len(detector) + 1, *heights.shape))
    above[:-1, counted] = ndtr((heights[counted] - np.array(detector.thresholds)[:, None]) / detector.sigma)
    chance = above[:-1] - above[1:]  # that a pixel counts in each channel
    found, size = np.zeros((len(STEPS), len(detector), len(detector))), chance.shape[2]
    for step, (down, right) in enumerate(STEPS):
        for turned in (chance, np.swapaxes(chance, 2, 3)):  # down and right, and right and down
            first, second = turned[:, :, : size - down, : size - right], turned[:, :, down:, right:]
            weighted = first * weights[:, None, None]
            one_way = weighted.reshape(len(detector), -1) @ second.reshape(len(detector), -1).T
            found[step] += (one_way + one_way.T) / 4
    return found


def _heights(
    detector: PulseHeightDetector, line: float, energy: float
) -> tuple[Float[np.ndarray, " event"], Float[np.ndarray, "event row column"]]:
    """Weights of events, and the energy that each pixel around collects [keV]."""
    assert detector.charge_sharing is not None
    pitch, cloud = detector.charge_sharing.pitch, detector.charge_sharing.cloud
    share, azimuth, flight, x, y, cosine = lattice(_EVENTS, 6)
    place = (np.stack([y, x], axis=1) - 0.5) * pitch
    reach = _REACH if line else 1
    centres = np.arange(-reach, reach + 1) * pitch

    def charge(at: Float[np.ndarray, "event 2"]) -> Float[np.ndarray, "event row column"]:
        down, right = (collected(at[:, axis, None] - centres, pitch, cloud) for axis in (0, 1))
        return down[:, :, None] * right[:, None, :]

    if line == 0:
        return np.full(_EVENTS, 1 / _EVENTS), energy * charge(place)
    mu, mu_line = (_attenuation(detector, e) for e in (energy, line))
    inside, across = fluorescence_paths(mu, mu_line, detector.thickness, share, flight, 2 * cosine - 1)
    angle = 2 * np.pi * azimuth
    end = place + across[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return inside / _EVENTS, (energy - line) * charge(place) + line * charge(end)
