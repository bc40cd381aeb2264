"""Volumes from files: arrays with their place in space.

Axes of arrays are (z, y, x). Our x, y and z are right, anterior and superior (RAS+), as in the NIfTI files that are
exported. SimpleITK, which reads NIfTI, MetaImage, NRRD and DICOM, counts to the left and to the back: x and y change
their signs.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError, NotInstalledError

Triple = tuple[float, float, float]
IMAGES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr")
_FROM_ITK = np.diag([-1.0, -1.0, 1.0])
_KINDS = f".npy, {', '.join(IMAGES)}, a dataset such as file.h5:/path, or a folder with a DICOM series"


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxel volume read from a file.

    Parameters
    ----------
    values : (z, y, x), or (part, z, y, x)
    spacing : distance between voxels along x, y and z of the array [mm], None where the file does not say
    directions : unit vectors along these as columns
    origin : centre of the first voxel (x, y, z) [mm], None where the file does not say
    """

    values: np.ndarray
    spacing: Triple | None = None
    directions: Float[np.ndarray, "3 3"] | None = None
    origin: Triple | None = None


def read_volume(name: str, folder: Path) -> Volume:
    """Read a volume.

    Parameters
    ----------
    name : name of the file
    folder : folder where relative names start

    Returns
    -------
    voxels and their place

    Raises
    ------
    InputError
        When the file is missing or cannot be read.
    """
    inside = re.fullmatch(r"(.+\.(?:h5|hdf5|nxs)):(/.+)", name, re.IGNORECASE)
    path = folder / (inside.group(1) if inside else name)
    kind = "".join(path.suffixes[-2:]) if path.suffix.lower() == ".gz" else path.suffix
    if path.is_dir():
        return _read_image(path)
    if kind.lower() not in (".npy", ".h5", ".hdf5", ".nxs", *IMAGES):
        raise InputError(f"{path}: a volume must be one of {_KINDS}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    if kind.lower() == ".npy":
        return Volume(_checked(path, _load_npy(path)))
    if kind.lower() in IMAGES:
        return _read_image(path)
    if not inside:
        raise InputError(f"{path}: which of its datasets? Write {path.name}:/path")
    return _read_hdf5(path, inside.group(2))


def _load_npy(path: Path) -> np.ndarray:
    try:
        return np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"{path}: the file cannot be read as an array of numbers: {error}") from None


def _read_hdf5(path: Path, name: str) -> Volume:
    """A dataset of an HDF5 file; beside one of our own stands its grid."""
    import h5py  # noqa: PLC0415 - only where there is such a file

    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read as HDF5: {error}") from None
    with file:
        found = file.get(name)
        if not isinstance(found, h5py.Dataset):
            raise InputError(f"{path}: there is no dataset {name}")
        values, grid = _checked(path, found[()]), file.get(f"{name.rpartition('/')[0]}/grid")
        if not isinstance(grid, h5py.Group) or not {"spacing", "origin"} <= set(grid):
            return Volume(values)
        spacing, origin = (_triple(np.array(grid[key])[::-1]) for key in ("spacing", "origin"))
        return Volume(values, spacing, np.eye(3), origin)


def _read_image(path: Path) -> Volume:
    """A NIfTI, MetaImage or NRRD file, or a folder with one DICOM series."""
    try:
        import SimpleITK  # noqa: PLC0415
    except ImportError:
        raise NotInstalledError(f"{path}: reading this needs SimpleITK: pip install 'spectral-ct[images]'") from None
    try:
        image = SimpleITK.ReadImage(_series(SimpleITK, path) if path.is_dir() else str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].removeprefix("sitk::ERROR: ")
        raise InputError(f"{path}: the file cannot be read as an image: {reason}") from None
    values = SimpleITK.GetArrayFromImage(image)
    if image.GetNumberOfComponentsPerPixel() > 1:
        values = np.moveaxis(values, -1, 0)
    dimension = image.GetDimension()
    directions = _FROM_ITK @ np.array(image.GetDirection()).reshape(dimension, dimension)[:3, :3]
    origin = _FROM_ITK @ np.array(image.GetOrigin())[:3]
    return Volume(_checked(path, values), _triple(image.GetSpacing()), directions, _triple(origin))


def _series(itk: Any, folder: Path) -> tuple[str, ...]:
    """Files of the one DICOM series in a folder, from one end to the other."""
    found = itk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    if len(found) != 1:
        raise InputError(f"{folder}: a folder must hold one DICOM series, this one holds {len(found)}")
    return itk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), found[0])


def _checked(path: Path, values: np.ndarray) -> np.ndarray:
    """The array, where it can be a volume."""
    if values.ndim not in {3, 4} or 0 in values.shape:
        raise InputError(f"{path}: a volume must be (z, y, x) or (part, z, y, x), got shape {values.shape}")
    if values.dtype.kind not in "uifb":
        raise InputError(f"{path}: a volume must hold numbers, got {values.dtype}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(f"{path}: values must be finite, {(~np.isfinite(values)).sum()} are not")
    return values


def _triple(values: Any) -> Triple:
    x, y, z = (float(value) for value in list(values)[:3])
    return x, y, z
