"""Volumes from files: arrays with their place in space, of every format that can be read.

Axes of arrays are (z, y, x). Our x, y and z are right, anterior and superior (RAS+), as in the NIfTI files that are
exported.
"""

import re
from pathlib import Path

from phantomgen.volume_files import images, tiff
from phantomgen.volume_files.volume import Volume
from spectra.errors import InputError

HDF5 = (".h5", ".hdf5", ".nxs")
SUFFIXES = (".npy", ".npz", *HDF5, *images.SUFFIXES, *tiff.SUFFIXES, ".vti")
_KINDS = (
    f".npy, {', '.join((*images.SUFFIXES, *tiff.SUFFIXES, '.vti', '.npz'))}, a dataset such as file.h5:/path, "
    "or a folder with a DICOM series or TIFF slices"
)


def read_volume(name: str, folder: Path = Path()) -> Volume:
    """Read a volume.

    Parameters
    ----------
    name : name of the file; after a colon the dataset of an HDF5 file, or the array of an NPZ or VTI file
    folder : folder where relative names start

    Returns
    -------
    voxels and their place

    Raises
    ------
    InputError
        When the file is missing or cannot be read.
    NotInstalledError
        When its format needs a package that is not there.
    """
    path, inside = split_name(name, folder)
    if path.is_dir():
        return tiff.read_tiff(path) if tiff.slices_of(path) else images.read_image(path)
    kind = suffix_of(path)
    if kind not in SUFFIXES:
        raise InputError(f"{path}: a volume must be one of {_KINDS}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    if kind in images.SUFFIXES:
        return images.read_image(path)
    if kind in tiff.SUFFIXES:
        return tiff.read_tiff(path)
    return _read(path, kind, inside)


def _read(path: Path, kind: str, inside: str | None) -> Volume:
    """Read a format whose library takes a while to import, or whose files hold several arrays."""
    from phantomgen.volume_files import arrays, vti  # noqa: PLC0415

    if kind == ".npy":
        return arrays.read_npy(path)
    if kind == ".npz":
        return arrays.read_npz(path, inside)
    if kind == ".vti":
        return vti.read_vti(path, inside)
    return arrays.read_hdf5(path, inside)


def split_name(name: str, folder: Path = Path()) -> tuple[Path, str | None]:
    """Split the name of a volume into its file and what is inside the file.

    Parameters
    ----------
    name : such as ``file.h5:/path``
    folder : folder where relative names start

    Returns
    -------
    the file, and the name of the array; None where there is none
    """
    inside = re.fullmatch(r"(.+\.(?:h5|hdf5|nxs)):(/.+)|(.+\.(?:npz|vti)):(.+)", name, re.IGNORECASE)
    if not inside:
        return folder / name, None
    return folder / (inside.group(1) or inside.group(3)), inside.group(2) or inside.group(4)


def suffix_of(path: Path) -> str:
    """Return the suffix of a file in lower case, with what stands before ``.gz``.

    Parameters
    ----------
    path : the file

    Returns
    -------
    such as ``.nii.gz``
    """
    return ("".join(path.suffixes[-2:]) if path.suffix.lower() == ".gz" else path.suffix).lower()
