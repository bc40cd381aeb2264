"""Noise power spectrum of a uniform region."""

import numpy as np
from jaxtyping import Real

from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError


def noise_power(
    volume: Real[np.ndarray, "z y x"], grid: Grid, box: tuple[slice, slice, slice]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the noise power spectrum of axial slices, with their mean planes subtracted.

    Parameters
    ----------
    volume : values of all voxels
    grid : grid of the volume
    box : region (z, y, x) of voxels, square in y and x

    Returns
    -------
    radial frequencies [1/mm], and mean power of the slices [value^2 mm^2]

    Raises
    ------
    InputError
        When the volume is not one of the grid, the box is not square or has fewer than 4 voxels along a side, or a
        value in it is not finite.

    References
    ----------
    ICRU Report 87, section 4.4: NPS = dx dy / (nx ny) |DFT(noise)|^2.
    """
    if np.shape(volume) != grid.shape:
        raise InputError(f"the volume must have the shape of the grid, {grid.shape}, got {np.shape(volume)}")
    slices = np.asarray(volume[box], dtype=np.float64)
    if slices.ndim != 3 or min(slices.shape) < 1 or slices.shape[1] != slices.shape[2] or slices.shape[1] < 4:
        raise InputError(f"the box of a noise power spectrum must be square with 4 voxels or more, got {slices.shape}")
    if not np.isfinite(slices).all():
        raise InputError(f"{np.sum(~np.isfinite(slices))} of {slices.size} values in the box are not finite")
    side = slices.shape[1]
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    planes = np.stack([np.ones(side * side), y.ravel(), x.ravel()], axis=1)
    flat = slices.reshape(len(slices), -1).T
    noise = (flat - planes @ np.linalg.lstsq(planes, flat, rcond=None)[0]).T.reshape(slices.shape)
    power = (np.abs(np.fft.fft2(noise)) ** 2).mean(axis=0) * grid.spacing[1] * grid.spacing[2] / side**2
    frequency = np.hypot(np.fft.fftfreq(side, grid.spacing[1])[:, None], np.fft.fftfreq(side, grid.spacing[2])[None])
    edges = np.arange(0.5, side // 2 + 1) / (side * max(grid.spacing[1:]))
    number = np.histogram(frequency, edges)[0]
    total = np.histogram(frequency, edges, weights=power)[0]
    return (edges[1:] + edges[:-1]) / 2, total / np.maximum(number, 1)
