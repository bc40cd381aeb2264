"""Formats of scans that can be read, by name."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from phantomgen.importers.scans.raw_scan import RawScan
from phantomgen.importers.scans.stated import Stated

# Name on the command line: module that reads it.
FORMATS = {
    "tiff": "tiff_folder",
    "nxtomo": "nxtomo",
    "dxchange": "dxchange",
    "nikon": "nikon",
    "fips": "fips",
    "bruker": "bruker",
    "dicom-ct-pd": "dicom_ct_pd",
    "r2": "r2_folder",
    "naf": "naf_pickle",
}


def read_scan(name: str, paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan of another program or of a scanner.

    Parameters
    ----------
    name : of the format, one of `FORMATS`
    paths : of the scan; several are channels, where the format has one file per channel
    stated : facts that the user states

    Returns
    -------
    the scan; images are read when they are asked for

    Raises
    ------
    InputError
        When it cannot be read, or lacks something that nobody states.
    """
    return import_module(f"phantomgen.importers.readers.{FORMATS[name]}").read(paths, stated)
