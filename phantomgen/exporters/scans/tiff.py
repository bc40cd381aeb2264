"""One TIFF of float32 per view and channel, with poses and flats beside them."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name
from phantomgen.geometry.poses import Geometry

KINDS: tuple[Kind, ...] = ("line-integrals", "counts")
SCRIPT = """
scan, name = load()
data = np.stack([tifffile.imread(path) for path in sorted(Path(scan["files"][name]).glob("view_*.tif"))])
poses = np.genfromtxt("poses.csv", delimiter=",", names=True)  # source, panel_center, column_step, row_step [mm]
print(scan["what"], name, data.shape, "from", data.min(), "to", data.max(), "in", len(poses), "views")
"""
IMPORTS = "from pathlib import Path\n\nimport tifffile"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write a folder of files per channel, and ``poses.csv``.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what ``scan.json`` says besides: the radius of a curved panel, and exposures
    """
    write_poses(folder / "poses.csv", projections.geometry)
    write_images(folder, projections)
    curvature, exposure = projections.geometry.panel.curvature, projections.exposure
    curved = {} if curvature is None else {"curvature_radius": curvature.radius}  # mm
    return curved | ({} if exposure is None else {"exposure": exposure.tolist()})


def write_images(folder: Path, projections: Projections) -> None:
    """Write a folder per channel with ``view_0000.tif``, ``flat_0000.tif``, ``dark_0000.tif`` and so on.

    Parameters
    ----------
    folder : that gets them
    projections : what to write
    """
    own = [folder / file_name(name) for name in projections.names]
    for number, place in enumerate(own):
        place.mkdir()
        for what, frames in (("flat", projections.flats), ("dark", projections.darks)):
            for frame, image in enumerate([] if frames is None else frames[:, number]):
                tifffile.imwrite(place / f"{what}_{frame:04d}.tif", image.astype(np.float32))
    for view in range(len(projections)):
        for place, image in zip(own, projections.image(view), strict=True):
            tifffile.imwrite(place / f"view_{view:04d}.tif", image.astype(np.float32))


def write_poses(path: Path, geometry: Geometry) -> None:
    """Write a table of poses that an orbit of type ``poses`` reads.

    Parameters
    ----------
    path : of the .csv
    geometry : poses
    """
    names = ("source", "panel_center", "column_step", "row_step")
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow([f"{name}_{axis}" for name in names for axis in "xyz"])
        for row in np.hstack([getattr(geometry, name) for name in names]):
            table.writerow([repr(float(value)) for value in row])
