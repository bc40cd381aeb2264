"""Folder for LEAP: arguments of its modular beam, and projections (view, row, column)."""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import write_npy
from phantomgen.geometry.conversions.leap import to_leap, to_leap_volume

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
poses = np.load("geometry.npz")
leap = tomographicModels()
sizes = len(poses["source"]), scan["rows"], scan["columns"], scan["row_pitch"], scan["column_pitch"]
leap.set_modularbeam(*sizes, *(poses[key] for key in ("source", "center", "row", "column")))
leap.set_volume(*scan["volume"])
data, volume = np.load(f"{scan['files'][name]}.npy"), leap.allocate_volume()  # (view, row, column)
leap.FBP(data, volume)  # other orbits than a circle need leap.SIRT(data, volume, 200)
np.save(f"{scan['files'][name]}_volume.npy", volume)  # (z, y, x)
"""
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
    vectors = [np.ascontiguousarray(value, dtype=np.float32) for value in found[5:]]
    np.savez(folder / "geometry.npz", **dict(zip(("source", "center", "row", "column"), vectors, strict=True)))
    write_npy(folder, projections)
    return {"volume": list(volume), "row_pitch": found.pixelHeight, "column_pitch": found.pixelWidth}
