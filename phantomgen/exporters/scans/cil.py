"""Folder for CIL: a scan about the z axis as its NeXus file, any other cone beam as vectors and arrays.

CIL's own writer cannot write views with poses of their own, and its reader takes only files that say they are by that
writer; so does the one that is written here.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import Frames, fill, write_npy
from phantomgen.exporters.scans.astra import turns_about_z
from phantomgen.geometry.conversions.cil import CilCircle, to_cil_circle, to_cil_flex
from spectra.errors import GeometryError

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
(nz, ny, nx), (dz, dy, dx), (z, y, x) = (scan["grid"][key] for key in ("shape", "spacing", "center"))
grid = ImageGeometry(nx, ny, nz, dx, dy, dz, x, y, z)
if scan["flex"]:
    with np.load("vectors.npz") as stored:
        poses = AcquisitionGeometry.create_Cone3D_Flex(*(list(vectors) for vectors in stored.values()))
    poses.set_panel((scan["columns"], scan["rows"]), (scan["column_pitch"], scan["row_pitch"]), origin="top-left")
    data = AcquisitionData(np.load(f"{scan['files'][name]}.npy").transpose(1, 0, 2), geometry=poses)  # vertical first
    solver = SIRT(grid.allocate(0), ProjectionOperator(grid, poses), data)
    solver.run(200)
    volume = solver.solution
else:
    data = NEXUSDataReader(file_name="projections.nxs").read()
    data = data.get_slice(channel=scan["names"].index(name)) if len(scan["names"]) > 1 else data
    data.reorder("tigre")
    volume = (FBP if data.geometry.geom_type == "parallel" else FDK)(data, grid).run()
np.save(f"{scan['files'][name]}_volume.npy", volume.as_array())  # (z, y, x)
"""
IMPORTS = """from cil.framework import AcquisitionData, AcquisitionGeometry, ImageGeometry
from cil.io import NEXUSDataReader
from cil.optimisation.algorithms import SIRT
from cil.plugins.astra import ProjectionOperator
from cil.recon import FBP, FDK"""
_ENTRY = "entry1/tomo_entry"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``projections.nxs``, or ``vectors.npz`` and the projections.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know
    """
    geometry, panel = projections.geometry, projections.geometry.panel
    known = {"row_pitch": panel.row_pitch, "column_pitch": panel.column_pitch}
    if turns_about_z(geometry) and min(panel.rows, len(geometry)) > 1:
        _write_nexus(folder / "projections.nxs", projections, to_cil_circle(geometry))
        return {"flex": False, **known}
    if geometry.is_parallel:
        to_cil_circle(geometry)
        raise GeometryError("CIL's files of parallel beams need at least two views and two rows of pixels")
    flex = to_cil_flex(geometry)
    vectors = {name: value for name, value in vars(flex).items() if name != "panel"}
    np.savez(folder / "vectors.npz", **vectors)
    write_npy(folder, projections)
    return {"flex": True, **known}


def _write_nexus(path: Path, projections: Projections, circle: CilCircle) -> None:
    """All channels in the form of CIL's NEXUSDataWriter."""
    panel, names = circle.panel, projections.names
    shape, labels = [len(projections), panel.rows, panel.columns], ["angle", "vertical", "horizontal"]
    if len(names) > 1:
        shape, labels = [len(names), *shape], ["channel", *labels]
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {"creator": np.bytes_("NEXUSDataWriter.py"), "NeXus_version": "4.3.0", "file_name": path.name}
        )
        file.create_group(_ENTRY).attrs["NX_class"] = "NXentry"
        data = file.create_dataset(f"{_ENTRY}/data/data", shape, np.float32)
        fill(projections, [Frames(data, before=(number,) if len(names) > 1 else ()) for number in range(len(names))])
        data.attrs.update({f"dim{i}": label for i, label in enumerate(labels)})
        data.attrs.update(
            {
                "data_type": "AcquisitionData",
                "geometry": "cone" if circle.ray_direction is None else "parallel",
                "dimension": "3D",
                "num_channels": len(names),
                "num_pixels_h": panel.columns,
                "num_pixels_v": panel.rows,
                "pixel_size_h": panel.column_pitch,
                "pixel_size_v": panel.row_pitch,
                "panel_origin": "top-left",
            }
        )
        beam = ("ray/direction", circle.ray_direction)
        if circle.source_position is not None:
            beam = ("source/position", circle.source_position)
        for name, value in (
            beam,
            ("detector/position", circle.detector_position),
            ("detector/direction_x", circle.detector_direction_x),
            ("detector/direction_y", circle.detector_direction_y),
            ("rotation_axis/position", np.zeros(3)),
            ("rotation_axis/direction", np.array([0.0, 0.0, 1.0])),
            ("angles", circle.angles),
        ):
            file[f"{_ENTRY}/config/{name}"] = np.asarray(value, dtype=np.float32)
        file[f"{_ENTRY}/config/angles"].attrs.update({"angle_unit": "degree", "initial_angle": 0})
