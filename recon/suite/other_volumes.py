"""Volumes of another program on a suite: a folder with one file per scan, or a command that makes them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from phantomgen.volume_files.read import SUFFIXES
from recon.comparison.contenders.other_program import OtherProgram
from recon.suite.scans import Scan
from spectra.errors import InputError

_BASIS = "basis"


def on_scan(program: OtherProgram, scan: Scan) -> OtherProgram | None:
    """Return a program as it is on one scan.

    Parameters
    ----------
    program : its path is a folder with volumes, or it is a command
    scan : of a suite

    Returns
    -------
    the program with the volume of the scan, and ``as=basis`` replaced by the names of the scan's basis functions; None
    where the folder has no volume of it

    Raises
    ------
    InputError
        When the folder has several volumes of the scan.
    """
    if program.path is not None:
        path = _volume(Path(program.path), scan.name)
        if path is None:
            return None
        program = replace(program, path=str(path))
    if program.statement.get("as") != _BASIS:
        return program
    return replace(program, statement={**program.statement, "as": f"{_BASIS}:{','.join(scan.basis)}"})


def check_folders(programs: Sequence[OtherProgram], scans: Sequence[Scan]) -> None:
    """Refuse folders that hold no volume of any scan.

    Parameters
    ----------
    programs : volumes, and commands
    scans : of a suite

    Raises
    ------
    InputError
        When it is so.
    """
    for program in programs:
        if program.path is None:
            continue
        folder = Path(program.path)
        if not folder.is_dir():
            raise InputError(f"--volumes: {folder} of {program} is no folder: give one with a file per case")
        if not any(_volume(folder, scan.name) for scan in scans):
            names = ", ".join(scan.name for scan in scans)
            raise InputError(f"--volumes: {folder} of {program} has no file that is named after a case: {names}")


def _volume(folder: Path, case: str) -> Path | None:
    """File or folder of a case, such as ``k-edge.npy``."""
    places = [folder / case, *(folder / f"{case}{suffix}" for suffix in SUFFIXES)]
    found = [path for path in places if path.exists()]
    if len(found) > 1:
        raise InputError(f"--volumes: {folder} has several volumes of {case}: {', '.join(p.name for p in found)}")
    return found[0] if found else None
