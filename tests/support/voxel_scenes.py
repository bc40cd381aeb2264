"""Small scans of voxels that several tests share; data come through the projector that reconstructs them."""

import numpy as np
from support.gaussian_scenes import NAMES, circular, spectral_model

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements
from recon.voxel.iterative.likelihood import forward

SIZE = 12.0  # edge of the volume [mm]


def balls(voxels=12, bases=3, height=0.05):
    """Volumes with a ball in each basis, one inside the other, and their grid."""
    grid = Grid.cube(voxels, SIZE)
    axes = (grid.axis(name) for name in "zyx")
    radius = np.sqrt(sum(a**2 for a in np.meshgrid(*axes, indexing="ij")))
    return np.stack([height * (radius < (0.42 - 0.1 * m) * SIZE) for m in range(bases)]).astype(np.float32), grid


def voxel_scan(truth, grid, views=12, pixels=16, seed=None, photons=1e5, geometry=None, channels=4):
    """Measurements of volumes: expected counts, or Poisson counts with a seed."""
    geometry = circular(pixels, pixels, views) if geometry is None else geometry
    model = spectral_model(len(truth), channels, photons)
    lengths = np.moveaxis(forward(truth, geometry, grid), 0, -1).astype(float)
    counts = np.moveaxis(model.expected(lengths), -1, 1)
    if seed is not None:
        counts = np.random.default_rng(seed).poisson(counts)
    shape = (len(model), geometry.panel.rows, geometry.panel.columns)
    exposure = np.ones(counts.shape[:2])
    names = NAMES[: len(truth)]
    return Measurements(counts.astype(np.float32), np.ones(shape, np.float32), exposure, geometry, model, names)


def noisy_images(truth, grid, noise, views=12, pixels=16, seed=1, geometry=None):
    """Line integrals (basis, view, row, column) with white noise, and the geometry."""
    geometry = circular(pixels, pixels, views) if geometry is None else geometry
    exact = forward(truth, geometry, grid)
    return exact + noise * np.random.default_rng(seed).standard_normal(exact.shape, np.float32), geometry
