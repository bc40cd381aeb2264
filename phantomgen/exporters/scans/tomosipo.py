"""Folder for tomosipo: vectors (z, y, x), and projections (row, view, column) per channel."""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import write_npy
from phantomgen.geometry.conversions.tomosipo import to_tomosipo

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
create = ts.parallel_vec if scan["parallel"] else ts.cone_vec
with np.load("vectors.npz") as stored:
    poses = create(shape=(scan["rows"], scan["columns"]), **stored)
grid = scan["grid"]
size = np.multiply(grid["shape"], grid["spacing"])
middle = np.array(grid["origin"]) + (size - grid["spacing"]) / 2
A = ts.operator(ts.volume(shape=grid["shape"], pos=middle, size=size), poses)
data = torch.from_numpy(np.load(f"{scan['files'][name]}.npy")).cuda()  # (row, view, column)
np.save(f"{scan['files'][name]}_volume.npy", ts_algorithms.sirt(A, data, 200).cpu())  # (z, y, x); `fdk` for a circle
"""
IMPORTS = "import tomosipo as ts\nimport torch\nimport ts_algorithms"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``vectors.npz`` and the projections.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know
    """
    vectors = to_tomosipo(projections.geometry)
    del vectors["shape"]
    np.savez(folder / "vectors.npz", **vectors)
    write_npy(folder, projections, axes=(1, 0, 2))
    return {"parallel": projections.geometry.is_parallel}
