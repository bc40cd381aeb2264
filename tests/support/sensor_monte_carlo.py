"""Photons one by one through a pixelated sensor: the independent check of `spectra.detector.pulse_height`.

It shares cross sections and line energies with the model and nothing else: photons, fluorescence and charge have
places, pixels have pulses, and pulses are counted.
"""

import numpy as np
from scipy.special import ndtr

from spectra.elements.attenuation import k_lines, k_shell_share
from spectra.materials.material import Material

REACH = 4  # pixels on each side that pulses are followed in


def pulses_of(
    energy: float, sensor: Material, thickness: float, pitch: float, cloud: float, sigma: float, photons: int, seed: int
) -> np.ndarray:
    """Pulse heights [keV] of all pixels around, (photon, row, column), of absorbed photons of one energy."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-pitch / 2, pitch / 2, (photons, 2))
    mu = sensor.attenuation(np.array([energy]))[0]
    depth = -np.log1p(-rng.random(photons) * -np.expm1(-mu * thickness)) / mu
    line = _emitted(energy, sensor, photons, rng)
    heights = _collected(place, energy - line, pitch, cloud)
    emits = np.flatnonzero(line)
    mu_line = sensor.attenuation(line[emits])
    distance = rng.exponential(1 / mu_line)
    cosine, azimuth = rng.uniform(-1, 1, len(emits)), rng.uniform(0, 2 * np.pi, len(emits))
    across = (distance * np.sqrt(1 - cosine**2))[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    end = depth[emits] + distance * cosine
    inside = (end > 0) & (end < thickness)
    kept = emits[inside]
    heights[kept] += _collected(place[kept] + across[inside], line[kept], pitch, cloud)
    hit = heights > 1e-3
    heights[hit] += rng.normal(0, sigma, hit.sum())
    return np.where(hit, heights, 0.0)


def _emitted(energy: float, sensor: Material, photons: int, rng: np.random.Generator) -> np.ndarray:
    """Energy of the fluorescence of each photon, 0 where there is none."""
    lines, shares = [0.0], [0.0]
    for number in {"CdTe": (48, 52), "GaAs": (31, 33), "CZT": (48, 52, 30)}[sensor.name]:
        share = k_shell_share(sensor.composition, number, np.array([energy]))[0]
        for line, rate in k_lines(number):
            lines.append(line)
            shares.append(share * rate)
    shares[0] = 1 - sum(shares)
    return np.asarray(lines)[rng.choice(len(lines), photons, p=shares)]


def _collected(place: np.ndarray, energy: np.ndarray | float, pitch: float, cloud: float) -> np.ndarray:
    """Charge that each pixel around collects."""
    edges = (np.arange(-REACH, REACH + 2) - 0.5) * pitch
    if cloud == 0:
        parts = [np.diff(edges[None] < place[:, axis, None], axis=1) != 0 for axis in (0, 1)]
    else:
        parts = [np.diff(ndtr((edges[None] - place[:, axis, None]) / cloud), axis=1) for axis in (0, 1)]
    energy = np.broadcast_to(energy, len(place))
    return energy[:, None, None] * parts[0][:, :, None] * parts[1][:, None, :]
