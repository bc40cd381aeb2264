"""Counts, voxels and pixels at the limits, against closed forms."""

from collections.abc import Iterator
from decimal import Decimal, localcontext
from math import pi, sqrt

import numpy as np
from scipy.stats import poisson

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Sphere, solids_of
from phantomgen.simulation.forward_model.photon_noise import poisson_counts
from phantomgen.stress.case import Point
from spectra.transmission import Transmission

_PIXELS = 400  # per axis; so many samples of the noise


def metal() -> Iterator[Point]:
    """Ever thicker metal in two energies, until 1 photon of 1e8 is left, and far beyond.

    The sum of exponentials is evaluated with 50 decimals.

    Yields
    ------
    part of the photons that is absorbed, as its exponent of ten
    """
    attenuation, photons = np.array([[0.9, 0.35]]), np.array([[3e5, 7e5]])
    transmission = Transmission.from_spectrum(photons, attenuation)
    for exponent in (1, 2, 4, 6, 8, 12, 20, 50, 100):
        length = exponent * float(np.log(10)) / 0.35
        found = float(transmission.log_projection(np.array([[length]]))[0, 0])
        with localcontext() as context:
            context.prec = 50
            pairs = zip(photons[0], attenuation[0], strict=True)
            left = sum(Decimal(p) * (-Decimal(mu) * Decimal(length)).exp() for p, mu in pairs)
            expected = float(-(left / Decimal(1_000_000)).ln())
        yield Point(exponent, found, expected, abs(found - expected))


def starvation() -> Iterator[Point]:
    """Ever fewer photons per pixel: mean of the logarithm of counts, where a pixel without any counts as one half.

    The expectation is a sum over the Poisson distribution. The error is in standard errors of the mean.

    Yields
    ------
    photons per pixel
    """
    for number, photons in enumerate((1e5, 1e4, 1e3, 100.0, 30.0, 10.0, 3.0, 1.0)):
        counts = poisson_counts(np.full((_PIXELS, _PIXELS), photons), 1, number, 0)
        found = -np.log(np.maximum(counts, 0.5) / photons)
        reach = np.arange(int(photons + 12 * sqrt(photons) + 40) + 1)
        chance, value = poisson.pmf(reach, photons), -np.log(np.maximum(reach, 0.5) / photons)
        mean = float(chance @ value)
        deviation = sqrt(float(chance @ (value - mean) ** 2))
        yield Point(photons, float(found.mean()), mean, abs(float(found.mean()) - mean) / (deviation / _PIXELS))


def one_voxel() -> Iterator[Point]:
    """An ever smaller ball in a single voxel of 1 mm: the part that it fills, against 4/3 pi r^3.

    Yields
    ------
    radius [mm]
    """
    for radius in (0.45, 0.3, 0.1, 0.03, 0.01):
        found = fractions(Grid.cube(1, 1.0), solids_of([(Sphere((0.02, 0.01, 0.03), radius), 0)]), 1)[0, 0, 0, 0]
        expected = 4 / 3 * pi * radius**3
        yield Point(radius, float(found), expected, abs(float(found) - expected))


def flat_voxels() -> Iterator[Point]:
    """A ball in ever flatter voxels: its volume in all, against 4/3 pi r^3.

    Yields
    ------
    ratio of the longest and the shortest edge
    """
    expected = 4 / 3 * pi * 10**3
    for ratio in (1, 2, 5, 20, 100):
        shape, spacing = (2 * ratio, 12, 2), (12.0 / ratio, 2.0, 12.0)
        grid = Grid(shape, spacing, (-12.0 + spacing[0] / 2, -11.0, -6.0))
        filled = fractions(grid, solids_of([(Sphere((0, 0, 0), 10.0), 0)]), 1)
        found = float(filled.sum(dtype=np.float64) * np.prod(spacing))
        yield Point(ratio, found, expected, abs(found / expected - 1))
