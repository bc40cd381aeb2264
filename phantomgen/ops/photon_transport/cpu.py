"""Photon transport in numba, one photon after the other."""

from math import cos, exp, floor, log, pi, sin, sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.kernel_decorators import called, inlined
from phantomgen.ops.photon_transport.inputs import LOWEST
from spectra.elements.constants import ELECTRON_REST_ENERGY, PLANCK_LIGHT

_INFINITE = 1e30


@inlined
@no_type_check
def _between(row, position):
    """Value of a table at a position between its entries; that of the last entry beyond it."""
    index = min(int(position), row.size - 2)
    part = min(position - index, 1.0)
    return row[index] + part * (row[index + 1] - row[index])


@called
@no_type_check
def _first_above(row, value):
    """Index of the first entry of an ascending table that is above a value."""
    low, high = 0, row.size - 1
    while low < high:
        middle = (low + high) // 2
        if row[middle] > value:
            high = middle
        else:
            low = middle + 1
    return low


@inlined
@no_type_check
def _turned(ux, uy, uz, cosine):
    """A direction at an angle from another one, with a random azimuth."""
    sine = sqrt(max(1.0 - cosine * cosine, 0.0))
    azimuth = 2.0 * pi * np.random.random()
    a, b = sine * cos(azimuth), sine * sin(azimuth)
    flat = ux * ux + uy * uy
    if flat < 1e-12:
        return a, b, cosine if uz > 0 else -cosine
    root = sqrt(flat)
    vx = ux * cosine + (a * ux * uz - b * uy) / root
    vy = uy * cosine + (a * uy * uz + b * ux) / root
    vz = uz * cosine - a * root
    norm = 1.0 / sqrt(vx * vx + vy * vy + vz * vz)
    return vx * norm, vy * norm, vz * norm


@called
@no_type_check
def _compton(energy, incoherent, x_step):
    """Cosine of the angle, and energy after Compton scattering.

    Klein-Nishina by composition of two densities of k, times S(x) by rejection.
    """
    kappa = energy / ELECTRON_REST_ENERGY
    least = 1.0 / (1.0 + 2.0 * kappa)
    first, second = -log(least), 0.5 * (1.0 - least * least)
    while True:
        if np.random.random() * (first + second) < first:
            k = exp(-first * np.random.random())
        else:
            k = sqrt(least * least + (1.0 - least * least) * np.random.random())
        t = (1.0 - k) / (kappa * k)  # 1 - cos(theta)
        if np.random.random() > 1.0 - k * t * (2.0 - t) / (1.0 + k * k):
            continue
        x = energy / PLANCK_LIGHT * sqrt(0.5 * t)
        if np.random.random() <= _between(incoherent, x / x_step):
            return 1.0 - t, k * energy


@called
@no_type_check
def _rayleigh(energy, coherent, x_step):
    """Cosine of the angle of Rayleigh scattering: squared form factor by inversion, times 1 + cos^2 by rejection."""
    most = energy / PLANCK_LIGHT
    reached = _between(coherent, most / x_step)
    while True:
        wanted = np.random.random() * reached
        above = max(_first_above(coherent, wanted), 1)
        low, high = coherent[above - 1], coherent[above]
        part = (wanted - low) / (high - low) if high > low else 0.0
        x2_low, x2_high = ((above - 1) * x_step) ** 2, (above * x_step) ** 2
        cosine = 1.0 - 2.0 * min((x2_low + part * (x2_high - x2_low)) / (most * most), 1.0)
        if np.random.random() * 2.0 <= 1.0 + cosine * cosine:
            return cosine


@inlined
@no_type_check
def _entry(px, py, pz, ux, uy, uz, low, high):
    """Distances at which a ray enters and leaves a box, (z, y, x) corners; the first is larger where it misses."""
    near, far = 0.0, _INFINITE
    for axis in range(3):
        p = pz if axis == 0 else (py if axis == 1 else px)
        u = uz if axis == 0 else (uy if axis == 1 else ux)
        if abs(u) < 1e-300:
            if p < low[axis] or p > high[axis]:
                near, far = 1.0, 0.0
        else:
            a, b = (low[axis] - p) / u, (high[axis] - p) / u
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@called
@no_type_check
def _drawn(beam):
    """Place, direction, energy and weight of a photon that leaves the source."""
    view = _first_above(beam.views, np.random.random())
    module = int(np.random.random() * beam.frames.shape[1])
    row, column = np.random.random() * beam.rows, np.random.random() * beam.columns
    number = _first_above(beam.spectrum, np.random.random())
    exponent = 0.0
    for part in range(beam.shape.shape[0]):
        exponent += beam.lengths[part, int(row), module * beam.columns + int(column)] * beam.shape[part, number]
    frame = beam.frames[view, module]
    ux = frame[1, 0] + (column - 0.5) * frame[2, 0] + (row - 0.5) * frame[3, 0]
    uy = frame[1, 1] + (column - 0.5) * frame[2, 1] + (row - 0.5) * frame[3, 1]
    uz = frame[1, 2] + (column - 0.5) * frame[2, 2] + (row - 0.5) * frame[3, 2]
    norm = 1.0 / sqrt(ux * ux + uy * uy + uz * uz)
    energy = beam.energy[number]
    return frame[0, 0], frame[0, 1], frame[0, 2], ux * norm, uy * norm, uz * norm, energy, exp(-exponent)


@called
@no_type_check
def _mixed(fractions, k, j, i, crossings, position, mu):
    """Attenuation and energy transfer of a voxel; `mu` becomes the cumulative attenuation of its materials."""
    there, transferred = 0.0, 0.0
    for m in range(mu.size):
        part = fractions[m, k, j, i]
        if part > 0.0:
            there += part * _between(crossings.total[m], position)
            transferred += part * _between(crossings.transferred[m], position)
        mu[m] = there
    return there, transferred


@called
@no_type_check
def _collided(m, energy, crossings):
    """Cosine of the angle and energy after a collision with a material; no energy where the photon is absorbed."""
    kind, position = np.random.random(), energy / crossings.step
    if kind < _between(crossings.photoelectric[m], position):
        return 1.0, 0.0
    if kind < _between(crossings.compton[m], position):
        cosine, left = _compton(energy, crossings.incoherent[m], crossings.x_step)
        return cosine, left if left >= LOWEST else 0.0
    return _rayleigh(energy, crossings.coherent[m], crossings.x_step), energy


@called
@no_type_check
def _measure(probes, px, py, pz, given, kerma, deposits):
    """Add energy and air kerma to the probes around a place."""
    for probe in range(probes.radius.size):
        dx, dy = px - probes.centre[probe, 0], py - probes.centre[probe, 1]
        inside = dx * dx + dy * dy < probes.radius[probe] ** 2
        if inside and probes.ends[probe, 0] < pz < probes.ends[probe, 1]:
            deposits.energy[probe] += given
            deposits.air[probe] += kerma


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def follow(count, seed, beam, medium, crossings, probes, deposits):
    """Follow photons, and add what they leave.

    Parameters
    ----------
    count, seed, beam, medium, crossings, probes : as in `phantomgen.ops.photon_transport.transport`
    deposits : added to
    """
    np.random.seed(seed)
    fractions, low, spacing = medium
    materials, depth, rows, columns = fractions.shape
    high = low + spacing * np.array((depth, rows, columns))
    mu = np.empty(materials)
    for _ in range(count):
        px, py, pz, ux, uy, uz, energy, weight = _drawn(beam)
        deposits.ends[0] += weight * energy
        near, far = _entry(px, py, pz, ux, uy, uz, low, high)
        if near >= far:
            deposits.ends[1] += weight * energy
            continue
        px, py, pz = px + near * ux, py + near * uy, pz + near * uz
        while energy > 0.0:
            position = energy / crossings.step
            largest = _between(crossings.largest, position)
            way = -log(1.0 - np.random.random()) / largest
            px, py, pz = px + way * ux, py + way * uy, pz + way * uz
            k = int(floor((pz - low[0]) / spacing[0]))
            j = int(floor((py - low[1]) / spacing[1]))
            i = int(floor((px - low[2]) / spacing[2]))
            if k < 0 or j < 0 or i < 0 or k >= depth or j >= rows or i >= columns:
                deposits.ends[1] += weight * energy
                break
            there, transferred = _mixed(fractions, k, j, i, crossings, position, mu)
            given = weight * energy * transferred / largest
            deposits.voxels[k, j, i] += given
            kerma = weight * energy * _between(crossings.air, position) / largest
            _measure(probes, px, py, pz, given, kerma, deposits)
            chance = np.random.random() * largest
            if chance < there:
                cosine, left = _collided(_first_above(mu, chance), energy, crossings)
                deposits.ends[2] += weight * (energy - left)
                energy = left
                ux, uy, uz = _turned(ux, uy, uz, cosine)
