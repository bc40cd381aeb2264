"""Folder for the ASTRA toolbox: vectors, and projections (row, view, column) per channel."""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import write_npy
from phantomgen.geometry.conversions.astra import to_astra, to_astra_volume
from phantomgen.geometry.conversions.cil import to_cil_circle
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
poses = astra.create_proj_geom(scan["kind"], scan["rows"], scan["columns"], np.load("vectors.npy"))
grid = astra.create_vol_geom(*scan["volume"])
data = astra.data3d.create("-sino", poses, np.load(f"{scan['files'][name]}.npy"))  # (row, view, column)
volume = astra.data3d.create("-vol", grid)
config = astra.astra_dict(scan["method"]) | {"ProjectionDataId": data, "ReconstructionDataId": volume}
astra.algorithm.run(astra.algorithm.create(config), scan["iterations"])  # needs CUDA
np.save(f"{scan['files'][name]}_volume.npy", astra.data3d.get(volume))  # (z, y, x)
"""
IMPORTS = "import astra"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``vectors.npy`` and the projections.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know
    """
    found = to_astra(projections.geometry)
    np.save(folder / "vectors.npy", found.vectors)
    write_npy(folder, projections, axes=(1, 0, 2))
    circle = turns_about_z(projections.geometry) and not projections.geometry.is_parallel
    method = ("FDK_CUDA", 1) if circle else ("SIRT3D_CUDA", 200)
    volume = list(to_astra_volume(projections.grid))
    return {"kind": found.kind, "volume": volume, "method": method[0], "iterations": method[1]}


def turns_about_z(geometry: Geometry) -> bool:
    """Return whether all views are one view, turned about the z axis.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    True where they are
    """
    try:
        to_cil_circle(geometry)
    except GeometryError:
        return False
    return True
