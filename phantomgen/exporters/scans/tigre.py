"""Folder for TIGRE: fields of its geometry, and projections (view, row, column) whose rows go up."""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import write_npy
from phantomgen.geometry.conversions.tigre import to_tigre, to_tigre_volume

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
geometry = tigre.geometry(mode=scan["mode"], default=False)
with np.load("geometry.npz") as stored:
    fields = dict(stored)
angles = fields.pop("angles")
for field, value in fields.items():
    setattr(geometry, field, value)
data = np.load(f"{scan['files'][name]}.npy")  # (view, row, column), rows go up
method = algorithms.fbp if scan["mode"] == "parallel" else algorithms.fdk
volume = method(data, geometry, angles)
np.save(f"{scan['files'][name]}_volume.npy", volume)  # (z, y, x); another orbit than a circle needs algorithms.sirt
"""
IMPORTS = "import tigre\nfrom tigre import algorithms"


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
    found = to_tigre(projections.geometry)
    volume = {name: np.array(value) for name, value in to_tigre_volume(projections.grid).items()}
    size = np.array(found.nDetector), np.array(found.dDetector)
    upright = not found.angles[:, 1:].any()
    fields = volume | {
        "nDetector": size[0],
        "dDetector": size[1],
        "sDetector": size[0] * size[1],
        "DSO": found.DSO,
        "DSD": found.DSD,
        "offDetector": found.offDetector,
        "rotDetector": found.rotDetector,
        "COR": found.COR,
        "angles": found.angles[:, 0] if upright else found.angles,
    }
    np.savez(folder / "geometry.npz", **fields)  # type: ignore[arg-type]
    write_npy(folder, projections, rows_up=True)
    return {"mode": found.mode}
