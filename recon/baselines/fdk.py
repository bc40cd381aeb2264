"""Filtered back-projection of cone-beam data (Feldkamp, Davis, Kress 1984, doi:10.1364/JOSAA.1.000612)."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry import Geometry
from phantomgen.grid import Grid
from recon.array_store import taken
from recon.ops.backproject import backproject
from recon.orbit_check import check_full_circle

VIEWS_AT_ONCE = 16


def fdk(
    line_integrals: Float[np.ndarray, "view basis row column"], geometry: Geometry, grid: Grid, hann: float = 1.0
) -> Float[np.ndarray, "basis z y x"]:
    """Volumes [1/mm] of line integrals [no unit] on a full circular orbit of evenly spaced views.

    Parameters
    ----------
    line_integrals : one image per view and basis
    geometry : circular orbit about the z axis
    grid : the volume to reconstruct
    hann : where the Hann window that tames the ramp filter reaches zero, in Nyquist frequencies; ``inf`` for none

    Raises
    ------
    GeometryError
        When the geometry is not a full circular orbit of at least two views.
    """
    check_full_circle(geometry)
    sod = np.linalg.norm(geometry.source[:, :2], axis=1)
    height = np.einsum("vi,vi->v", geometry.panel_center - geometry.source, geometry.normals())
    sdd = np.abs(height)
    pitch = geometry.panel.column_pitch * sod[0] / sdd[0]  # at the isocentre
    volume = np.zeros((line_integrals.shape[1], *grid.shape), np.float32)
    for first in range(0, len(geometry), VIEWS_AT_ONCE):
        some = slice(first, first + VIEWS_AT_ONCE)
        filtered = _ramp(taken(line_integrals, some) * _cosines(geometry[some])[:, None], pitch, hann)
        volume = backproject(filtered, geometry[some], grid, (sod / sdd)[some], volume)
    return volume * np.float32(2 * np.pi / len(geometry))


def _cosines(geometry: Geometry) -> Float[np.ndarray, "view row column"]:
    """Cosine of the angle between each ray and the panel's normal."""
    rows, columns = geometry.panel.rows, geometry.panel.columns
    out = np.empty((len(geometry), rows, columns), np.float32)
    for i, (frame, normal) in enumerate(zip(geometry.ray_frames(), geometry.normals(), strict=True)):
        x, y = np.arange(columns)[None, :, None], np.arange(rows)[:, None, None]
        rays = frame[1] + x * frame[2] + y * frame[3]
        out[i] = np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)
    return out


def _ramp(
    images: Float[np.ndarray, "view basis row column"], pitch: float, hann: float
) -> Float[np.ndarray, "view basis row column"]:
    """Half the band-limited ramp filter along rows, sampled in space (Kak & Slaney 1988, eq. 3.61), zero-padded."""
    columns = images.shape[-1]
    size = 1 << (2 * columns - 1).bit_length()
    steps = np.minimum(np.arange(size), size - np.arange(size))
    kernel = np.zeros(size)
    kernel[0] = 1 / (8 * pitch)
    odd = steps % 2 == 1
    kernel[odd] = -1 / (2 * np.pi**2 * pitch * steps[odd] ** 2)
    frequency = np.arange(size // 2 + 1) / (size / 2)
    window = np.where(frequency < hann, 0.5 + 0.5 * np.cos(np.pi * frequency / hann), 0.0) if np.isfinite(hann) else 1.0
    response = (np.fft.rfft(kernel).real * window).astype(np.float32)
    return np.stack([np.fft.irfft(np.fft.rfft(view, size) * response, size)[..., :columns] for view in images])
