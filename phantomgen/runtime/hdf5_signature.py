"""Signature of HDF5 files, tested without a library that opens such files."""

from pathlib import Path

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # HDF5 File Format Specification 3.0, section II.A, at the beginning of the file


def is_hdf5(path: Path) -> bool:
    """Return whether a file begins with the signature of HDF5.

    Parameters
    ----------
    path : the file

    Returns
    -------
    False also where there is no such file or it cannot be read
    """
    try:
        with path.open("rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False
