"""The scans of a suite: what its ``suite.json`` says, and whether the files are still those."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phantomgen.dataset.adapters.to_hashes import array_hashes
from spectra.errors import InputError

MANIFEST, SCHEMA = "suite.json", "spectral-ct-suite"
_DIFFERENT = "different"


@dataclass(frozen=True)
class Scan:
    """One scan of a suite.

    Parameters
    ----------
    name, what : its name, and what it is in words
    path : the dataset
    basis : names of its basis functions
    agreement : with the stored scan, in words
    scene : digest of its scene
    arrays : SHA-256 of its arrays by name
    """

    name: str
    what: str
    path: Path
    basis: tuple[str, ...]
    agreement: str
    scene: str
    arrays: dict[str, str]

    def identity(self) -> dict[str, Any]:
        """Return what a table of results says about the scan.

        Returns
        -------
        its words, agreement and digests
        """
        return {"what": self.what, "agreement": self.agreement, "scene": self.scene, "arrays": self.arrays}


@dataclass(frozen=True)
class Scans:
    """The scans of a suite.

    Parameters
    ----------
    suite, tier : which one
    sha256 : digest of its scenes
    seconds : time that each method gets on each case where nothing else is asked for [s]
    each : the scans
    """

    suite: str
    tier: str
    sha256: str
    seconds: float
    each: tuple[Scan, ...]


def read_scans(folder: Path) -> Scans:
    """Read the scans of a folder, and check that each is what the suite says.

    Parameters
    ----------
    folder : that `phantomgen suite` wrote

    Returns
    -------
    the scans

    Raises
    ------
    InputError
        When the folder is no suite, a scan is missing or not the stored one, or a file changed since it was made.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError(f"{folder} has no {MANIFEST}: `phantomgen suite v1 -o {folder}` makes a suite")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        if manifest["schema"] != SCHEMA:
            raise ValueError
        scans = tuple(_scan(folder, case) for case in manifest["cases"])
        found = Scans(manifest["suite"], manifest["tier"], manifest["sha256"], float(manifest["seconds"]), scans)
        reasons = {case["name"]: case["why"] for case in manifest["cases"]}
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path} is no list of a suite's scans: make it anew by phantomgen suite") from None
    if not scans:
        raise InputError(f"{folder} has no scan yet: `phantomgen suite` with --resume makes what is missing")
    for scan in scans:
        if scan.agreement == _DIFFERENT:
            raise InputError(f"{scan.path} is not the scan of the suite {found.suite}: {reasons[scan.name]}")
        if not scan.path.is_file():
            raise InputError(f"{scan.path} is missing: `phantomgen suite` with --resume makes it")
        changed = [name for name, array in array_hashes(scan.path).items() if array["sha256"] != scan.arrays.get(name)]
        if changed:
            raise InputError(f"{scan.path} changed since it was made: {', '.join(changed)} have other hashes")
    return found


def _scan(folder: Path, case: dict[str, Any]) -> Scan:
    """One entry of the list."""
    arrays = {name: array["sha256"] for name, array in case["arrays"].items()}
    basis = tuple(case["basis"])
    return Scan(case["name"], case["what"], folder / case["file"], basis, case["agreement"], case["scene"], arrays)
