"""Writing a folder for another program: its files, ``scan.json`` and ``load.py``, all or nothing."""

import json
import math
import shutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name
from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.outputs import check_output_folder
from spectra.errors import InputError

PROGRAMS = {  # name on the command line: module that writes it
    "astra": "astra",
    "tomosipo": "tomosipo",
    "tigre": "tigre",
    "cil": "cil",
    "rtk": "rtk",
    "leap": "leap",
    "r2": "learned.r2_gaussian",
    "naf": "learned.naf",
    "nxtomo": "nxtomo",
    "dxchange": "dxchange",
    "dicom-ct-pd": "dicom_ct_pd",
    "ctsimu": "ctsimu",
    "tiff": "tiff",
}
WITH_TESTS = ("r2", "naf")  # these know views for tests, and get them
_SCAN, _SCRIPT, _WRITER = "scan.json", "load.py", "phantomgen export"
_HEAD = '''"""Load this folder: python load.py [NAME], where NAME is one of "names" in scan.json."""

import json
import os
import sys

import numpy as np
{imports}


def load():
    """What scan.json says, and the name to load."""
    os.chdir(os.path.dirname(os.path.abspath(__file__)))
    with open("scan.json", encoding="utf-8") as file:
        scan = json.load(file)
    return scan, sys.argv[1] if len(sys.argv) > 1 else scan["names"][0]

'''


def kind_for(program: str, kind: str | None) -> Kind:
    """Return what is written for a program.

    Parameters
    ----------
    program : one of `PROGRAMS`
    kind : that was asked for; None for the usual one

    Returns
    -------
    line integrals or counts

    Raises
    ------
    InputError
        When the program does not take that.
    """
    kinds: tuple[Kind, ...] = _writer(program).KINDS
    if kind is None:
        return kinds[0]
    if kind not in kinds:
        others = ", ".join(name for name in PROGRAMS if kind in _writer(name).KINDS)
        raise InputError(f"a folder for {program} holds {' or '.join(kinds)}, not {kind}; {kind} go to {others}")
    return cast(Kind, kind)


def check_folder(path: Path, overwrite: bool) -> None:
    """Refuse an output folder that exists or was not written by this command.

    Parameters
    ----------
    path : the folder
    overwrite : whether an existing one may be replaced

    Raises
    ------
    InputError
        When it cannot be written.
    """
    check_output_folder(path, overwrite, _WRITER, lambda folder: (folder / _SCAN).is_file())


def views_written(program: str, projections: Projections) -> int:
    """Count the views that are written for a program.

    Parameters
    ----------
    program : one of `PROGRAMS`
    projections : what is written

    Returns
    -------
    those for training; all of them for a program that knows views for tests
    """
    return len(projections) if program in WITH_TESTS else projections.train


def write_folder(path: Path, program: str, projections: Projections) -> None:
    """Write a folder; an existing one is replaced when the new one is complete.

    Parameters
    ----------
    path : the folder
    program : one of `PROGRAMS`
    projections : what to write

    Raises
    ------
    GeometryError
        When the program cannot express the poses; then no folder is left.
    NotInstalledError
        When the format needs a package that is not there.
    StorageError
        When the file system refuses; then no folder is left.
    """
    writer, part = _writer(program), path.with_name(f"{path.name}.part")
    written = projections if program in WITH_TESTS else projections.training()
    shutil.rmtree(part, ignore_errors=True)
    try:
        with one_sentence(path):
            part.mkdir()
            record = _record(program, written) | writer.write(part, written)
            (part / _SCAN).write_text(json.dumps(record, indent=1), encoding="utf-8")
            curved = written.geometry.panel.curvature is not None
            own = getattr(writer, "CURVED_SCRIPT", writer.SCRIPT) if curved else writer.SCRIPT
            (part / _SCRIPT).write_text(_HEAD.format(imports=writer.IMPORTS) + own, encoding="utf-8")
            if path.is_dir():
                shutil.rmtree(path)
            part.replace(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _record(program: str, projections: Projections) -> dict[str, Any]:
    """Collect what ``scan.json`` states of every scan."""
    grid, panel = projections.grid, projections.geometry.panel
    center = [o + (n - 1) / 2 * s for n, s, o in zip(grid.shape, grid.spacing, grid.origin, strict=True)]
    return {
        "written_by": _WRITER,
        "to": program,
        "title": projections.title,
        "what": projections.kind,
        "names": list(projections.names),
        "files": {name: file_name(name) for name in projections.names},
        "energies_keV": [float(e) if math.isfinite(e) else None for e in projections.energies],
        "views": len(projections),
        "training_views": min(projections.train, len(projections)),
        "rows": panel.rows,
        "columns": panel.columns,
        "grid": {
            "shape": list(grid.shape),
            "spacing": list(grid.spacing),
            "origin": list(grid.origin),
            "center": center,
        },
    }


def _writer(program: str) -> ModuleType:
    if program not in PROGRAMS:
        raise InputError(f"there is no folder for {program!r}: choose one of {', '.join(PROGRAMS)}")
    return import_module(f"phantomgen.exporters.scans.{PROGRAMS[program]}")
