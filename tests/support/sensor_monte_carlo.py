"""Photons one by one through a pixelated sensor: the independent check of `spectra.detector.pulse_height`.

It shares cross sections and line energies with the model and nothing else: photons, fluorescence and charge have
places, pixels have pulses, and pulses are counted.
"""

import numpy as np
from scipy.special import ndtr

from spectra.elements.attenuation import attenuation_parts, k_lines, k_shell_share, scattering_functions
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


def counts_with_compton(
    energy: float, sensor: Material, thickness: float, pitch: float, cloud: float, sigma: float,
    thresholds: tuple[float, ...], photons: int, seed: int,
) -> np.ndarray:  # fmt: skip
    """Pixels above each threshold per photon that arrives; photons scatter in the sensor, and nothing fluoresces."""
    rng = np.random.default_rng(seed)
    deposits, alive = [], np.arange(photons)
    place = np.column_stack([rng.uniform(-pitch / 2, pitch / 2, (photons, 2)), np.zeros(photons)])
    direction = np.tile([0.0, 0.0, 1.0], (photons, 1))
    left = np.full(photons, float(energy))
    while len(alive):
        absorbed, compton, _ = attenuation_parts(sensor.composition, left[alive]) * sensor.density / 10
        place[alive] += direction[alive] * rng.exponential(1 / (absorbed + compton))[:, None]
        inside = (place[alive, 2] > 0) & (place[alive, 2] < thickness)
        alive, chance = alive[inside], (compton / (absorbed + compton))[inside]
        scatters = rng.random(len(alive)) < chance
        stopped, alive = alive[~scatters], alive[scatters]
        deposits.append((stopped, place[stopped, :2].copy(), left[stopped].copy()))
        before = left[alive].copy()
        cosine = _scattered(before, sensor, rng)
        left[alive] = before / (1 + before / 510.99895 * (1 - cosine))
        direction[alive] = _turned(direction[alive], cosine, rng.uniform(0, 2 * np.pi, len(alive)))
        deposits.append((alive, place[alive, :2].copy(), before - left[alive]))
        alive = alive[left[alive] > 1]
    return _pixels_above(deposits, pitch, cloud, sigma, thresholds, rng) / photons


def _scattered(energy: np.ndarray, sensor: Material, rng: np.random.Generator) -> np.ndarray:
    """Cosines of angles of Compton scattering, by rejection."""
    cosine, open_ = np.empty(len(energy)), np.arange(len(energy))
    while len(open_):
        guess = rng.uniform(-1, 1, len(open_))
        ratio = 1 / (1 + energy[open_] / 510.99895 * (1 - guess))
        density = ratio**2 * (ratio + 1 / ratio - 1 + guess**2) / 2
        transfer = energy[open_] / 12.398419843 * np.sqrt((1 - guess) / 2)
        density *= scattering_functions(sensor.composition, transfer)[0]
        taken = rng.random(len(open_)) < density
        cosine[open_[taken]] = guess[taken]
        open_ = open_[~taken]
    return cosine


def _turned(direction: np.ndarray, cosine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Directions at an angle to others."""
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    one = np.cross(direction, helper)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    other, sine = np.cross(direction, one), np.sqrt(1 - cosine**2)
    return (
        cosine[:, None] * direction
        + (sine * np.cos(azimuth))[:, None] * one
        + (sine * np.sin(azimuth))[:, None] * other
    )


def _pixels_above(
    deposits: list[tuple[np.ndarray, np.ndarray, np.ndarray]], pitch: float, cloud: float, sigma: float,
    thresholds: tuple[float, ...], rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Number of pixels above each threshold, all charge of a photon in a pixel together."""
    photon, place, energy = (np.concatenate(parts) for parts in zip(*deposits, strict=True))
    own = np.round(place / pitch)
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(9, 2)
    pixels = own[:, None] + around
    low = (pixels - 0.5) * pitch - place[:, None]
    if cloud > 0:
        part = (ndtr((low + pitch) / cloud) - ndtr(low / cloud)).prod(axis=2)
    else:
        part = np.broadcast_to((np.abs(around).sum(axis=1) == 0) * 1.0, pixels.shape[:2])
    keys = np.column_stack([np.repeat(photon, 9), pixels.reshape(-1, 2)])
    found, number = np.unique(keys, axis=0, return_inverse=True)
    height = np.bincount(number.ravel(), (part * energy[:, None]).ravel(), len(found))
    height = height[height > 1e-3]
    height += rng.normal(0, sigma, len(height))
    return np.array([(height >= t).sum() for t in thresholds])
