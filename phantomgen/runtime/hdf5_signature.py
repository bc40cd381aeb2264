"""How a file begins that is HDF5, told without a library that opens such files."""

from pathlib import Path

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # HDF5 File Format Specification 3.0, section II.A, at the beginning of the file


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 does; False for what is no file, or cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False
