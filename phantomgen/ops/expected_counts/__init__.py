"""Expected counts of one view, averaged over the area of each pixel.

A pixel averages *intensities*, not line integrals. Where nothing happens inside a pixel, one ray and the curvature over
its neighbours give the average; where a silhouette passes, the pixel is split along it. `expected_counts_by_grid` is
the same average over a plain n x n grid of rays.

Accuracy, as the largest error of a log-projection against 256 x 256 rays per pixel: 3e-5 where silhouettes cross, rms
4e-6 (four nested cylinders, 0.8 mm pixels). Split exactly are the silhouettes of single shapes. Where surfaces of two
shapes intersect, edges of a mesh pass, or panel or source cut a shape, counts have a kink: there, the pixel is halved
into rectangles until their estimated errors come to less than `INTERSECTION_TOLERANCE`; true ones are about half as
large, see `benchmarks/simulator/intersection_pixels.py`.
"""

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.expected_counts.inputs import (
    INTERSECTION_TOLERANCE,
    RAYS_PER_VOXEL,
    RULES,
    ExpectedCounts,
    Sampling,
    Spectrum,
)
from phantomgen.ops.expected_counts.pixel_classes import CLASSES, CROSSED, EMPTY, INTERSECTED, NEAR, SMOOTH, VOXELS
from phantomgen.ops.solids import Solids

__all__ = [
    "CLASSES",
    "CROSSED",
    "EMPTY",
    "INTERSECTED",
    "INTERSECTION_TOLERANCE",
    "NEAR",
    "RAYS_PER_VOXEL",
    "RULES",
    "SMOOTH",
    "VOXELS",
    "ExpectedCounts",
    "Sampling",
    "Spectrum",
    "expected_counts",
    "expected_counts_by_grid",
]

_DEFAULT = Sampling()


def expected_counts(
    frame: Float[np.ndarray, "4 3"],
    rows: int,
    columns: int,
    solids: Solids,
    spectrum: Spectrum,
    background: int = -1,
    sampling: Sampling = _DEFAULT,
) -> ExpectedCounts:
    """Compute the expected counts of all pixels of one view, each averaged over the pixel's area.

    Parameters
    ----------
    frame : source, vector from there to the centre of pixel (0, 0), column step, row step (x, y, z) [mm]
    rows, columns : size of the panel
    solids : the objects, lowest priority first
    spectrum : energies of the beam
    background : material outside all shapes, -1 for none
    sampling : rules for the average over a pixel

    Returns
    -------
    the counts, the class of each pixel, and how many rays each class took

    Raises
    ------
    InputError
        When arguments do not fit each other.
    """
    # numba only where it computes
    from phantomgen.ops.expected_counts.cpu import expected_counts_of_view  # noqa: PLC0415
    from phantomgen.ops.expected_counts.view import prepare_view  # noqa: PLC0415

    arguments = prepare_view(frame, (rows, columns), solids, spectrum, background, sampling)
    expected_counts_of_view(*arguments)
    return arguments.out


def expected_counts_by_grid(
    frame: Float[np.ndarray, "4 3"],
    pixels: Int64[np.ndarray, "pixel 2"],
    solids: Solids,
    spectrum: Spectrum,
    background: int = -1,
    n: int = 256,
    aperture: tuple[float, float] = (1.0, 1.0),
    lattice: bool = False,
) -> Float[np.ndarray, "pixel channel"]:
    """Compute the expected counts of some pixels, each the mean over n^2 rays.

    Rays go through a grid of midpoints or, with `lattice`, through as many points of a lattice, no two of them in a row
    or column: beside edges along rows the grid errs by up to 1 / (2 n) of a pixel, the lattice by 1 / (2 n^2).

    Parameters
    ----------
    frame : as in `expected_counts` [mm]
    pixels : row and column of each pixel
    solids, spectrum, background : as in `expected_counts`
    n : rays along each edge of a pixel
    aperture : width and height of the sensitive part of a pixel [pixel]
    lattice : whether rays go through the points of a lattice

    Returns
    -------
    counts, (pixel, channel)
    """
    from phantomgen.ops.expected_counts.cpu import expected_counts_of_pixels  # noqa: PLC0415
    from phantomgen.ops.expected_counts.rectangles import RayList  # noqa: PLC0415
    from phantomgen.ops.expected_counts.view import prepare_grid  # noqa: PLC0415
    from phantomgen.ops.silhouette.quadrature import lattice_step  # noqa: PLC0415

    pixels = np.ascontiguousarray(pixels, dtype=np.int64)
    rows, columns = (pixels.max(axis=0, initial=0) + 1).tolist()
    if spectrum.profile is not None:
        spectrum = spectrum._replace(profile=spectrum.profile[:, :rows, :columns])
    view, scratch = prepare_grid(frame, (rows, columns), solids, spectrum, background)
    index = np.arange(n * n)
    if lattice:
        where = [(index + 0.5) / n**2, (index * lattice_step(n * n) % n**2 + 0.5) / n**2]
    else:
        where = [(index % n + 0.5) / n, (index // n + 0.5) / n]
    across, down = aperture
    nodes = np.stack([across * (where[0] - 0.5), down * (where[1] - 0.5), np.full(n * n, 1 / n**2)], axis=1)
    out = np.empty((spectrum.channels, rows, columns))
    expected_counts_of_pixels(view, RayList.of(1, nodes), pixels, scratch, out)
    return out[:, pixels[:, 0], pixels[:, 1]].T
