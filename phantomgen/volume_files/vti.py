"""Volumes of VTK image data, in the coordinates that the file states."""

from pathlib import Path

import numpy as np

from phantomgen.volume_files.volume import Volume, check_size, checked, triple, unit_in
from spectra.errors import InputError


def read_vti(path: Path, name: str | None) -> Volume:
    """Read arrays of points or of cells, whichever the file has; the first voxel of cells is half a voxel further in.

    Parameters
    ----------
    path : the file
    name : of the array; None for all that it has

    Returns
    -------
    voxels and their place, with the names of the arrays

    Raises
    ------
    InputError
        When the file cannot be read, or there is no such array.
    """
    import pyvista  # noqa: PLC0415 - a second

    with pyvista.vtk_verbosity("off"):  # an error is a sentence
        try:
            image = pyvista.read(path)
        except Exception as error:  # many kinds for damaged files
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
            raise InputError(f"{path}: the file cannot be read as VTK image data: {reason}") from None
    if not isinstance(image, pyvista.ImageData) or not (image.point_data or image.cell_data):
        raise InputError(f"{path}: the file cannot be read as VTK image data: it is cut off, or has no array")
    arrays = image.point_data if image.point_data else image.cell_data
    spacing, axes = np.array(image.spacing), np.array(image.direction_matrix)
    first = np.array([image.extent[0], image.extent[2], image.extent[4]], dtype=np.float64)
    counts = np.array(image.dimensions)
    if not image.point_data:
        counts, first = counts - 1, first + 0.5
    known = [key for key in arrays if name in (None, key)]
    if not known:
        raise InputError(f"{path}: there is no array {name}, only {', '.join(arrays)}")
    parts = []
    for key in known:
        values = np.asarray(arrays[key])
        if values.ndim != 1:
            raise InputError(f"{path}: the array {key} must hold one number per voxel, got shape {values.shape}")
        parts.append(values.reshape(counts[::-1]))
    values = parts[0] if len(parts) == 1 else np.stack(parts)
    check_size(path, values.shape, values.dtype)
    about = [str(text) for text in image.field_data["about"]] if "about" in image.field_data else []
    origin = np.array(image.origin) + axes @ (spacing * first)
    return Volume(checked(path, values), triple(spacing), axes, triple(origin), unit_in(" ".join(about)), tuple(known))
