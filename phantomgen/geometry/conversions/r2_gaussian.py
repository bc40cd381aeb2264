"""The dictionary ``scanner`` of data folders that R2-Gaussian reads, and the angles of their views.

The reader ignores the panel's offsets and tilts, and knows no helix: scans with them are refused.

References
----------
.. [1] https://github.com/Ruyi-Zha/r2_gaussian, r2_gaussian/dataset/dataset_readers.py.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.central_circle import CentralCircle, central_circle, central_circle_of
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError


def to_r2_gaussian(
    geometry: Geometry, grid: Grid, program: str = "R2-Gaussian's folder"
) -> tuple[dict[str, Any], Float[np.ndarray, " view"]]:
    """Convert poses and a grid to what ``meta_data.json`` says.

    Parameters
    ----------
    geometry : poses
    grid : voxels
    program : whose format it is, for the message

    Returns
    -------
    ``scanner``, lengths in mm, pairs (v, u), triples (x, y, z); angles of the views [rad]

    Raises
    ------
    GeometryError
        When the scan is not circular with a centred upright panel.
    """
    circle = central_circle_of(geometry, program)
    panel, behind = geometry.panel, circle.sdd - circle.sod
    # Distances of a parallel beam mean nothing but their difference, from the axis to the panel.
    dso, dsd = (behind, 2 * behind) if geometry.is_parallel else (circle.sod, circle.sdd)
    volume = [
        (n, n * spacing, origin + (n - 1) / 2 * spacing)
        for n, spacing, origin in zip(grid.shape[::-1], grid.spacing[::-1], grid.origin[::-1], strict=True)
    ]
    count, size, center = (list(values) for values in zip(*volume, strict=True))
    scanner = {
        "mode": "parallel" if geometry.is_parallel else "cone",
        "DSD": dsd,
        "DSO": dso,
        "nDetector": [panel.rows, panel.columns],
        "sDetector": [panel.rows * panel.row_pitch, panel.columns * panel.column_pitch],
        "nVoxel": count,
        "sVoxel": size,
        "offOrigin": center,
        "offDetector": [0.0, 0.0],
        "accuracy": 0.5,
        "totalAngle": float(np.rad2deg(np.ptp(np.unwrap(circle.angles)))) if len(geometry) else 0.0,
        "startAngle": float(np.rad2deg(circle.angles[0])) if len(geometry) else 0.0,
        "noise": False,
        "filter": None,
    }
    return scanner, circle.angles


def from_r2_gaussian(scanner: dict[str, Any], angles: Float[np.ndarray, " view"]) -> tuple[Geometry, Grid]:
    """Convert what ``meta_data.json`` says to poses and a grid.

    Parameters
    ----------
    scanner : of the file
    angles : of the views [rad]

    Returns
    -------
    the poses and the grid

    Raises
    ------
    GeometryError
        When a key is missing or has another form, or the panel has an offset, which the method's reader ignores.
    """
    shape, size = pair_of(scanner, "nDetector"), pair_of(scanner, "sDetector")
    if any(np.ravel(scanner.get("offDetector", 0.0))):
        raise GeometryError(
            f"scanner.offDetector is {scanner['offDetector']}: R2-Gaussian's reader ignores it, it must be 0"
        )
    count, extent, center = (triple_of(scanner, name) for name in ("nVoxel", "sVoxel", "offOrigin"))
    panel = Panel(int(shape[0]), int(shape[1]), (size[0] / shape[0], size[1] / shape[1]))
    dso, dsd = (float(number_of(scanner, name)) for name in ("DSO", "DSD"))
    parallel = scanner.get("mode", "cone") == "parallel"
    circle = CentralCircle(np.asarray(angles, dtype=np.float64), 0.0 if parallel else dso, dsd - dso * parallel)
    return central_circle(circle, panel, parallel), grid_of(count, np.divide(extent, count).tolist(), center)


def grid_of(count: list[float], spacing: list[float], center: list[float]) -> Grid:
    """Create a grid from triples (x, y, z).

    Parameters
    ----------
    count : number of voxels
    spacing : their size [mm]
    center : of the volume [mm]

    Returns
    -------
    the grid
    """
    first = [c - (n - 1) / 2 * s for n, s, c in zip(count, spacing, center, strict=True)]
    nx, ny, nz = (int(n) for n in count)
    return Grid((nz, ny, nx), tuple(spacing[::-1]), tuple(first[::-1]))  # type: ignore[arg-type]


def number_of(scanner: dict[str, Any], name: str) -> float:
    """Return a number of a dictionary of another program.

    Parameters
    ----------
    scanner : the dictionary
    name : of the key

    Returns
    -------
    the number

    Raises
    ------
    GeometryError
        When it is missing or no number.
    """
    return _numbers(scanner, name, 1)[0]


def pair_of(scanner: dict[str, Any], name: str) -> list[float]:
    """Return two numbers of a dictionary of another program.

    Parameters
    ----------
    scanner : the dictionary
    name : of the key

    Returns
    -------
    the numbers
    """
    return _numbers(scanner, name, 2)


def triple_of(scanner: dict[str, Any], name: str) -> list[float]:
    """Return three numbers of a dictionary of another program.

    Parameters
    ----------
    scanner : the dictionary
    name : of the key

    Returns
    -------
    the numbers
    """
    return _numbers(scanner, name, 3)


def _numbers(scanner: dict[str, Any], name: str, count: int) -> list[float]:
    if name not in scanner:
        raise GeometryError(f"the key {name} is missing; the format needs it")
    try:
        values = [float(value) for value in np.ravel(scanner[name])]
    except (TypeError, ValueError):
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise GeometryError(f"{name} must be {count} number{'s' * (count > 1)}, got {scanner[name]!r}")
    return values
