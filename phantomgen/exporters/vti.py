"""VTK image data, which ParaView, PyVista and 3D Slicer open."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

from phantomgen.exporters.volumes import Volumes


def writer() -> Callable[[Path, Volumes], None]:
    """Return the function that writes the format.

    Returns
    -------
    function of path and volumes
    """
    return write_vti


_END = b"</VTKFile>"  # last bytes of a file


def write_vti(path: Path, volumes: Volumes) -> None:
    """Write values at points, which are the centres of voxels, in the coordinates of the scan [mm].

    Parameters
    ----------
    path : the file
    volumes : the volumes
    """
    import pyvista  # noqa: PLC0415 - a second

    grid = volumes.grid
    image = pyvista.ImageData(dimensions=grid.shape[::-1], spacing=grid.spacing[::-1], origin=grid.origin[::-1])
    for name, values in volumes.values.items():
        image.point_data[name] = values.ravel()  # z is slowest here as there
    image.field_data["about"] = [volumes.about]
    image.save(path)
    _check_whole(path)


def _check_whole(path: Path) -> None:
    """Refuse a file that VTK could not finish: on a full disk it says so on stderr only."""
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, len(_END) + 2), os.SEEK_END)
        if _END not in file.read():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
