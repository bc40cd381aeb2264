"""Volumes of TIFF: a file with several pages, or a folder with a file per slice.

Voxel sizes are those of ImageJ or OME metadata, where a file has them. No TIFF says which axis of the scan is which.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.volume_files.volume import Triple, Volume, check_size, checked
from spectra.errors import InputError

SUFFIXES = (".tif", ".tiff")
_MM = {"mm": 1.0, "millimeter": 1.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "\\u00B5m": 1e-3, "micron": 1e-3, "nm": 1e-6}


def slices_of(folder: Path) -> list[Path]:
    """List the TIFF files of a folder, by the numbers in their names.

    Parameters
    ----------
    folder : the folder

    Returns
    -------
    files in the order of slices; empty where there are none
    """
    found = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    return sorted(found, key=lambda path: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", path.name)])


def read_tiff(path: Path) -> Volume:
    """Read a TIFF file with several pages, or a folder of slices.

    Parameters
    ----------
    path : file or folder

    Returns
    -------
    the voxels: pages, rows and columns are the axes of the array

    Raises
    ------
    InputError
        When it cannot be read, or slices differ in size.
    """
    import tifffile  # noqa: PLC0415 - only where there is such a file

    files = slices_of(path) if path.is_dir() else [path]
    parts, spacing = [], None
    for one in files:
        try:
            with tifffile.TiffFile(one) as file:
                if not file.series:
                    raise InputError(f"{one}: the file cannot be read as TIFF: it has no image")
                series = file.series[0]
                shape = series.shape if len(files) == 1 else (len(files), *series.shape)
                check_size(path, shape, series.dtype)
                parts.append(series.asarray())
                spacing = _spacing(file) if len(files) == 1 else None
        except InputError:
            raise
        except Exception as error:  # tifffile raises many kinds for damaged files
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
            raise InputError(f"{one}: the file cannot be read as TIFF: {reason}") from None
        if parts[-1].shape != parts[0].shape:
            raise InputError(f"{one}: the slice has shape {parts[-1].shape}, the first one {parts[0].shape}")
    return Volume(checked(path, parts[0] if len(files) == 1 else np.stack(parts)), spacing)


def _spacing(file: Any) -> Triple | None:
    """Distance between columns, rows and pages [mm], where ImageJ or OME metadata state all three."""
    if file.is_ome and file.ome_metadata:
        found = []
        for axis in "XYZ":
            size = re.search(rf'PhysicalSize{axis}="([^"]+)"', file.ome_metadata)
            unit = re.search(rf'PhysicalSize{axis}Unit="([^"]+)"', file.ome_metadata)
            factor = _MM.get(unit.group(1) if unit else "µm")  # the default of OME
            if size is None or factor is None:
                return None
            found.append(float(size.group(1)) * factor)
        return found[0], found[1], found[2]
    told = file.imagej_metadata or {}
    factor, tags = _MM.get(str(told.get("unit"))), file.pages[0].tags
    if factor is None or "spacing" not in told or not {"XResolution", "YResolution"} <= {tag.name for tag in tags}:
        return None
    per_unit = [tags[name].value for name in ("XResolution", "YResolution")]
    if not all(number and step for number, step in per_unit):
        return None
    x, y = (factor * step / number for number, step in per_unit)
    return x, y, factor * float(told["spacing"])
