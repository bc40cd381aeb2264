"""Making of a suite: scans that are missing, and the manifest ``suite.json``, which is written after each."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phantomgen.degradation.run import degrade_file
from phantomgen.runtime.outputs import check_output_folder
from phantomgen.runtime.plain_json import write_json
from phantomgen.runtime.versions import environment
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from phantomgen.suite.definition import Case, Suite
from phantomgen.suite.record import DIFFERENT, compare, record
from spectra.errors import InputError

MANIFEST = "suite.json"
SCHEMA = "spectral-ct-suite"


@dataclass(frozen=True)
class Made:
    """A suite that was made.

    Parameters
    ----------
    folder : where it is
    manifest : content of ``suite.json``
    """

    folder: Path
    manifest: dict[str, Any]

    @property
    def different(self) -> list[str]:
        """Sentences about cases that are not the stored ones."""
        return [
            f"{case['name']} is not the scan that the suite states: {case['why']}"
            for case in self.manifest["cases"]
            if case["agreement"] == DIFFERENT
        ]


def make_suite(
    suite: Suite, folder: Path, *, overwrite: bool = False, resume: bool = False, tell: Callable[[str], None] = print
) -> Made:
    """Make the scans of a suite that a folder lacks, and compare all with the stored ones.

    Parameters
    ----------
    suite : which one
    folder : to write in
    overwrite : replace a folder that exists
    resume : go on in a folder that exists
    tell : gets one line per case

    Returns
    -------
    what was made

    Raises
    ------
    InputError
        When the folder exists and neither is given, is no suite, or is another one.
    """
    check_output_folder(folder, overwrite or resume, "phantomgen suite", _is_suite, "make what is missing")
    entries = {} if overwrite else _known(suite, folder)
    folder.mkdir(exist_ok=True)
    manifest: dict[str, Any] = {
        "schema": SCHEMA,
        "suite": suite.name,
        "sha256": suite.sha256,
        "tier": suite.tier,
        "seconds": suite.seconds,
        "environment": environment(),
        "cases": list(entries.values()),
    }
    write_json(folder / MANIFEST, manifest)
    for case in suite.cases:
        path = folder / f"{case.name}.h5"
        there = case.name in entries and path.is_file()
        entry = entries[case.name] | record(path) if there else _made(case, path)
        entries[case.name] = entry
        entry["agreement"], entry["why"] = compare(entry, suite.expected.get(case.name))
        manifest["cases"] = [entries[one.name] for one in suite.cases if one.name in entries]
        write_json(folder / MANIFEST, manifest)
        tell(f"{case.name:<16} {_shape_text(entry)}, {entry['seconds']:.1f} s: {entry['agreement']}")
    return Made(folder, manifest)


def expected_of(manifest: dict[str, Any]) -> dict[str, Any]:
    """Return what is to be stored of a suite that was made, to compare others with.

    Parameters
    ----------
    manifest : content of ``suite.json``

    Returns
    -------
    records by name of the case
    """
    return {
        case["name"]: {key: case[key] for key in ("scene", "arrays", "totals", "truth", "stated")}
        for case in manifest["cases"]
    }


def _made(case: Case, path: Path) -> dict[str, Any]:
    """Simulate, degrade and record one case."""
    begun = time.perf_counter()
    scan = load_scene(case.scene)
    if case.degradation is None:
        simulate(scan, path, overwrite=True)
    else:
        whole = path.with_name(f"{path.stem}-whole.h5")
        try:
            simulate(scan, whole, overwrite=True)
            degrade_file(whole, path, case.degradation, overwrite=True)
        finally:
            whole.unlink(missing_ok=True)
    found = record(path)
    return {
        "name": case.name,
        "what": case.what,
        "file": path.name,
        "basis": list(found["truth"]),
        "seconds": round(time.perf_counter() - begun, 2),
        "scene": case.sha256,
        **found,
    }


def _known(suite: Suite, folder: Path) -> dict[str, dict[str, Any]]:
    """Entries of a manifest that exists, by name of the case."""
    if not (folder / MANIFEST).is_file():
        return {}
    manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    if [manifest.get(key) for key in ("suite", "tier", "sha256")] != [suite.name, suite.tier, suite.sha256]:
        raise InputError(
            f"{folder} holds the suite {manifest.get('suite')}, tier {manifest.get('tier')}, "
            f"{manifest.get('sha256', '')[:12]}: choose another folder by --out, or add --overwrite"
        )
    return {case["name"]: case for case in manifest["cases"]}


def _is_suite(folder: Path) -> bool:
    """Whether a folder was written by this command."""
    return (folder / MANIFEST).is_file()


def _shape_text(entry: dict[str, Any]) -> str:
    """Views, channels and pixels of a case."""
    views, channels, rows, columns = entry["arrays"]["counts"]["shapes"][0]
    return f"{views} views x {channels} channels x {rows} x {columns}"
