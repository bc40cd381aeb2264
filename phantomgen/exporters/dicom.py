"""CT numbers as a DICOM series of axial slices, which 3D Slicer, ITK-SNAP and viewers of hospitals open.

DICOM counts to the left and to the back (LPS). Our x, y and z are right, anterior and superior (RAS+), so rows and
columns are written in the opposite order: the patient's right is on the left of the picture, anterior is at the top.
Values are whole HU, as those of scanners: they differ by up to 0.5 HU from what they were.

References
----------
.. [1] DICOM PS3.3, A.3 CT Image IOD and C.7.6.2 Image Plane Module
"""

import shutil
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.outputs import check_output_folder
from spectra.errors import InputError, NotInstalledError

_LEAST, _MOST = -32768, 32767
_CT_IMAGE_STORAGE = "1.2.840.10008.5.1.4.1.1.2"
_NAME = "slice_{:05d}.dcm"


def check_series(folder: Path, overwrite: bool) -> None:
    """Refuse to write a series, before anything is computed.

    Parameters
    ----------
    folder : folder of the series
    overwrite : whether an existing one may be replaced

    Raises
    ------
    InputError
        When the folder exists, or something else than slices is in it.
    NotInstalledError
        When SimpleITK is not there.
    """
    _itk()
    check_output_folder(folder, overwrite, "recon volume", _is_series)


def write_series(folder: Path, grid: Grid, values: Shaped[np.ndarray, "z y x"], about: str) -> None:
    """Write a DICOM CT series; an existing one is replaced when the new one is complete.

    Parameters
    ----------
    folder : folder of the series, a file per slice
    grid : the voxels
    values : CT numbers [HU]
    about : description of the series

    Raises
    ------
    InputError
        When a value is not finite.
    NotInstalledError
        When SimpleITK is not there.
    StorageError
        When the file system refuses; then no folder is left.
    """
    itk = _itk()
    if not np.isfinite(values).all():
        raise InputError(f"{folder}: a DICOM series cannot hold values that are not finite, of which there are some")
    image = itk.GetImageFromArray(np.clip(np.rint(values[:, ::-1, ::-1]), _LEAST, _MOST).astype(np.int16))
    z, y, x = grid.spacing
    image.SetSpacing((x, y, z))
    image.SetOrigin((-float(grid.axis("x")[-1]), -float(grid.axis("y")[-1]), grid.origin[0]))
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    try:
        with one_sentence(folder):
            part.mkdir()
            _write_slices(itk, image, part, about)
            if folder.is_dir():
                shutil.rmtree(folder)
            part.replace(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write_slices(itk: Any, image: Any, folder: Path, about: str) -> None:
    """Write a file per slice, from the feet to the head."""
    writer = itk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    root, now = _new_uid(), datetime.now()
    shared = {
        "0008|0016": _CT_IMAGE_STORAGE,
        "0008|0008": "DERIVED\\PRIMARY\\AXIAL",
        "0008|0060": "CT",
        "0008|0070": "spectral-ct",
        "0008|0020": now.strftime("%Y%m%d"),
        "0008|0021": now.strftime("%Y%m%d"),
        "0008|0030": now.strftime("%H%M%S"),
        "0008|0031": now.strftime("%H%M%S"),
        "0008|103e": about[:64],
        "0010|0010": "Simulated^Phantom",
        "0010|0020": "SIMULATION",
        "0018|5100": "HFS",
        "0020|000d": f"{root}.1",
        "0020|000e": f"{root}.2",
        "0020|0011": "1",
        "0020|0052": f"{root}.3",
        "0020|0037": "1\\0\\0\\0\\1\\0",
        "0018|0050": _decimal(image.GetSpacing()[2]),
        "0028|1050": "40",
        "0028|1051": "400",
        "0028|1052": "0",
        "0028|1053": "1",
        "0028|1054": "HU",
    }
    for z in range(image.GetDepth()):
        piece = image[:, :, z : z + 1]
        own = {
            "0008|0018": f"{root}.4.{z + 1}",
            "0020|0013": str(z + 1),
            "0020|0032": "\\".join(map(_decimal, piece.GetOrigin())),
            "0020|1041": _decimal(piece.GetOrigin()[2]),
        }
        for tag, value in (shared | own).items():
            piece.SetMetaData(tag, value)
        writer.SetFileName(str(folder / _NAME.format(z + 1)))
        writer.Execute(piece)


def _decimal(value: float) -> str:
    """A number in the 16 characters of a DICOM decimal string."""
    return f"{value:.9g}"


def _new_uid() -> str:
    """A new unique identifier below the root of UUIDs, which needs no registration (PS3.5, B.2)."""
    from uuid import uuid4  # noqa: PLC0415

    return f"2.25.{uuid4().int >> 16}"


def _is_series(folder: Path) -> bool:
    """True for a folder with slices only."""
    names = [path.name for path in folder.iterdir()]
    return bool(names) and all(name.startswith("slice_") and name.endswith(".dcm") for name in names)


def _itk() -> Any:
    """SimpleITK."""
    try:
        import SimpleITK  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("writing a DICOM series needs SimpleITK: pip install 'spectral-ct[images]'") from None
    return SimpleITK
