"""Folder for LEAP: arguments of its modular beam, and projections (view, row, column)."""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import write_npy
from phantomgen.geometry.conversions.central_circle import central_circle_of
from phantomgen.geometry.conversions.leap import to_leap, to_leap_volume
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
with np.load("geometry.npz") as stored:
    poses = dict(stored)
leap = tomographicModels()
sizes = len(poses["source"]), scan["rows"], scan["columns"], scan["row_pitch"], scan["column_pitch"]
leap.set_modularbeam(*sizes, *(poses[key] for key in ("source", "center", "row", "column")))
leap.set_volume(*scan["volume"])
data, volume = np.load(f"{scan['files'][name]}.npy"), leap.allocate_volume()  # (view, row, column)
_ = leap.FBP(data, volume) if scan["circle"] else leap.SIRT(data, volume, 200)  # leap.set_gpu(-1) first without CUDA
np.save(f"{scan['files'][name]}_volume.npy", volume)  # (z, y, x)
"""
_KEYS = ("source", "center", "row", "column")
IMPORTS = "from leapctype import tomographicModels"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``geometry.npz`` and the projections.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know
    """
    found, volume = to_leap(projections.geometry), to_leap_volume(projections.grid)
    circle = _is_central_circle(projections.geometry)  # LEAP filters where rows go up, and such panels must be centred
    rows = -found.rowVectors if circle else found.rowVectors
    vectors = found.sourcePositions, found.moduleCenters, rows, found.colVectors
    single = {key: value.astype(np.float32) for key, value in zip(_KEYS, vectors, strict=True)}
    np.savez(folder / "geometry.npz", **single)  # type: ignore[arg-type]
    write_npy(folder, projections, rows_up=circle)
    known = {"row_pitch": found.pixelHeight, "column_pitch": found.pixelWidth}
    return {"circle": circle, "volume": list(volume), **known}


def _is_central_circle(geometry: Geometry) -> bool:
    try:
        central_circle_of(geometry, "LEAP")
    except GeometryError:
        return False
    return True
