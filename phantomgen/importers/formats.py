"""Formats of scans that can be read, by name."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from phantomgen.dataset.writing.writer import check_dataset_name
from phantomgen.importers.scans.finish import Imported, Wanted, write_raw_scan
from phantomgen.importers.scans.raw_scan import RawScan
from phantomgen.importers.scans.stated import Stated
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError

# Name on the command line: module that reads it.
FORMATS = {
    "tiff": "tiff_folder",
    "nxtomo": "nxtomo",
    "dxchange": "dxchange",
    "nikon": "nikon",
    "fips": "fips",
    "bruker": "bruker",
    "ctsimu": "ctsimu",
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


def import_scan(
    name: str,
    paths: Sequence[Path],
    out: Path,
    *,
    title: str | None = None,
    overwrite: bool = False,
    on_view: Callable[[], object] = lambda: None,
    **options: Any,
) -> Imported:
    """Write the dataset of a scan of another program or of a scanner.

    Parameters
    ----------
    name : of the format, one of `FORMATS`
    paths : of the scan; several are channels, where the format has one file per channel
    out : name of the dataset
    title : of the scan; that of the file where left out
    overwrite : replace a file that exists
    on_view : called after each view
    **options : fields of `Stated`, facts that no file states, and of `Wanted`, what is to be written

    Returns
    -------
    what was written

    Raises
    ------
    InputError
        When it cannot be read, or lacks something that nobody states.
    """
    kinds = {kind: {field.name for field in fields(kind)} for kind in (Stated, Wanted)}
    unknown = set(options) - kinds[Stated] - kinds[Wanted]
    if name not in FORMATS or unknown:
        what = f"option {min(unknown)}" if name in FORMATS else f"format {name}"
        known = FORMATS if name not in FORMATS else sorted(kinds[Stated] | kinds[Wanted])
        raise InputError(f"there is no {what}: choose from {', '.join(known)}")
    check_dataset_name(out)
    if out.is_file() and any(path.exists() and path.samefile(out) for path in paths):
        raise InputError(f"the output {out} is the scan itself: choose another name by --out")
    check_output(out, overwrite)
    stated = Stated(**{key: value for key, value in options.items() if key in kinds[Stated]})
    wanted = Wanted(**{key: value for key, value in options.items() if key in kinds[Wanted]})
    raw = read_scan(name, paths, stated)
    return write_raw_scan(replace(raw, title=title or raw.title), out, wanted, overwrite, on_view)
