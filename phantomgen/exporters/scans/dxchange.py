"""One Data Exchange file per channel, as TomoPy's dxchange reads it: counts, flats, darks and angles."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import Frames, at_equal_output, file_name, fill
from phantomgen.geometry.conversions.central_circle import central_circle_of
from spectra.errors import GeometryError

KINDS: tuple[Kind, ...] = ("counts",)
SCRIPT = """
scan, name = load()
data, flat, dark, theta = dxchange.read_aps_tomoscan_hdf5(f"{scan['files'][name]}.h5")[:4]
data = tomopy.minus_log(tomopy.normalize(data, flat, dark))
volume = tomopy.recon(data, theta, center=(data.shape[2] - 1) / 2, algorithm="gridrec")
np.save(f"{scan['files'][name]}_volume.npy", volume[::-1] / scan["column_pitch"])  # (z, y, x) [1/mm]
"""
IMPORTS = "import dxchange\nimport tomopy"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write one file per channel.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know

    Raises
    ------
    GeometryError
        When the beam is not parallel: the format has no distances.
    """
    if not projections.geometry.is_parallel:
        raise GeometryError(
            f"Data Exchange has no distances and can only describe parallel beams, this scan has a cone beam "
            f"({projections.geometry.kind} geometry): nxtomo says cone beams"
        )
    angles = central_circle_of(projections.geometry, "Data Exchange").angles
    panel = projections.geometry.panel
    shape = len(projections), panel.rows, panel.columns
    with ExitStack() as files:
        data = []
        for number, name in enumerate(projections.names):
            file = files.enter_context(h5py.File(folder / f"{file_name(name)}.h5", "w"))
            file["implements"] = "exchange"
            exchange = file.create_group("exchange")
            data.append(exchange.create_dataset("data", shape, np.float32, chunks=(1, *shape[1:]), compression="gzip"))
            for what, frames in (("data_white", projections.flats), ("data_dark", projections.darks)):
                none = np.zeros((1, *shape[1:]), np.float32)
                exchange[what] = none if frames is None or not len(frames) else frames[:, number].astype(np.float32)
            exchange["theta"] = -np.rad2deg(angles)
            exchange["theta"].attrs["units"] = "degree"
        fill(at_equal_output(projections), [Frames(one) for one in data])
    return {"column_pitch": panel.column_pitch}
