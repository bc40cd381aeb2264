"""NIfTI, which nibabel, ITK-SNAP, 3D Slicer and FSL open.

NIfTI calls its axes right, anterior and superior (RAS+). Our x, y and z are written as these, so that nibabel shows the
coordinates of the scan. ITK and DICOM count to the left and to the back (LPS): they show x and y of the same points
with the opposite sign. `phantomgen.volume_files.read` reads files as these are written.

References
----------
.. [1] Cox et al. 2004, A (sort of) new image data format standard: NIfTI-1, https://nifti.nimh.nih.gov/nifti-1
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from phantomgen.exporters.volumes import Volumes
from spectra.errors import NotInstalledError

_SCANNER = 1  # NIfTI's code of coordinates of the scanner


def writer() -> Callable[[Path, Volumes], None]:
    """Return the function that writes the format.

    Returns
    -------
    function of path and volumes

    Raises
    ------
    NotInstalledError
        When nibabel is not there.
    """
    try:
        import nibabel  # noqa: F401, PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("writing NIfTI needs nibabel: pip install 'spectral-ct[io]'") from None
    return write_nifti


def write_nifti(path: Path, volumes: Volumes) -> None:
    """Write an array (x, y, z), or (x, y, z, volume) of several volumes, in mm, with a comment on each volume.

    Parameters
    ----------
    path : the file
    volumes : the volumes
    """
    import nibabel  # noqa: PLC0415
    from nibabel.nifti1 import Nifti1Extension  # noqa: PLC0415

    arrays = [values.T for values in volumes.values.values()]
    image = nibabel.Nifti1Image(arrays[0] if len(arrays) == 1 else np.stack(arrays, axis=-1), volumes.grid.affine)
    image.header.set_xyzt_units("mm")
    image.set_sform(volumes.grid.affine, code=_SCANNER)
    image.set_qform(volumes.grid.affine, code=_SCANNER)
    image.header["descrip"] = volumes.about.encode("ascii", "replace")[:79]
    image.header.extensions.append(Nifti1Extension("comment", volumes.about.encode()))
    nibabel.save(image, path)
