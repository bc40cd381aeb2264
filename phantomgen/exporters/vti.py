"""VTK image data, which ParaView, PyVista and 3D Slicer open."""

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
