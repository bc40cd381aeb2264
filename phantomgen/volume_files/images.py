"""Volumes of NIfTI, MetaImage and NRRD files, and of DICOM series, as SimpleITK reads them.

SimpleITK counts to the left and to the back (LPS): x and y change their signs, as our x, y and z are right, anterior
and superior (RAS+).
"""

from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.volume_files.volume import Volume, check_size, checked, triple, unit_in
from spectra.errors import InputError, NotInstalledError

SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr")
FROM_ITK = np.diag([-1.0, -1.0, 1.0])
_EVEN = 0.01  # part of the distance between slices of a series that distances may differ by; positions are rounded text
_POSITION, _RESCALE_TYPE = "0020|0032", "0028|1054"


def read_image(path: Path) -> Volume:
    """Read a NIfTI, MetaImage or NRRD file, or a folder with one DICOM series.

    Parameters
    ----------
    path : file or folder

    Returns
    -------
    voxels and their place

    Raises
    ------
    InputError
        When it cannot be read.
    NotInstalledError
        When SimpleITK is not there.
    """
    try:
        import SimpleITK  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError(f"{path}: reading this needs SimpleITK: pip install 'spectral-ct[images]'") from None
    itk: Any = SimpleITK
    shown = itk.ProcessObject.GetGlobalWarningDisplay()
    itk.ProcessObject.GlobalWarningDisplayOff()  # an error is a sentence
    try:
        image, units = _of_series(itk, path) if path.is_dir() else _of_file(itk, path)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1].removeprefix("sitk::ERROR: ")
        raise InputError(f"{path}: the file cannot be read as an image: {reason}") from None
    finally:
        itk.ProcessObject.SetGlobalWarningDisplay(shown)
    values = itk.GetArrayFromImage(image)
    if image.GetNumberOfComponentsPerPixel() > 1:
        values = np.moveaxis(values, -1, 0)
    dimension = image.GetDimension()
    directions = FROM_ITK @ np.array(image.GetDirection()).reshape(dimension, dimension)[:3, :3]
    origin = FROM_ITK @ np.array(image.GetOrigin())[:3]
    return Volume(checked(path, values), triple(image.GetSpacing()), directions, triple(origin), units)


def _of_file(itk: Any, path: Path) -> tuple[Any, str | None]:
    """Image, and the unit in its description."""
    reader = itk.ImageFileReader()
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    check_size(path, reader.GetSize()[::-1], np.uint8)
    told = reader.GetMetaData("descrip") if reader.HasMetaDataKey("descrip") else ""
    return reader.Execute(), unit_in(told)


def _of_series(itk: Any, folder: Path) -> tuple[Any, str | None]:
    """Image and unit of the one DICOM series in a folder, from one end to the other."""
    found = itk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    if len(found) != 1:
        raise InputError(f"{folder}: a folder must hold one DICOM series, this one holds {len(found)}")
    reader = itk.ImageSeriesReader()
    reader.SetFileNames(itk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), found[0]))
    reader.MetaDataDictionaryArrayUpdateOn()
    image = reader.Execute()
    slices = range(image.GetDepth())
    if all(reader.HasMetaDataKey(z, _POSITION) for z in slices):
        places = [[float(number) for number in reader.GetMetaData(z, _POSITION).split("\\")] for z in slices]
        gaps = np.linalg.norm(np.diff(np.array(places), axis=0), axis=1)
        if len(gaps) and np.ptp(gaps) > _EVEN * gaps.min():
            least, most = f"{gaps.min():.4g}", f"{gaps.max():.4g}"
            raise InputError(
                f"{folder}: slices of the series are {least} to {most} mm apart, where all distances must be equal: "
                "a file may be missing"
            )
    units = reader.GetMetaData(0, _RESCALE_TYPE).strip() if reader.HasMetaDataKey(0, _RESCALE_TYPE) else ""
    return image, units if units and units != "US" else None  # US: unspecified
