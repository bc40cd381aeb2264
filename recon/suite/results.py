"""Results on a suite as plain data: what is kept of each run, reading, and merging of several submissions."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from phantomgen.runtime.versions import environment, program_version
from recon.comparison.tables.table import mean_psnr
from recon.suite.scans import Scan, Scans
from spectra.errors import InputError

RESULTS, SCHEMA = "suite-score.json", "spectral-ct-suite-score"
PROTOCOL = "honest"
_SCORES = ("psnr", "rmse", "ssim")

Results = dict[str, Any]
Row = dict[str, Any]


def new_results(scans: Scans, label: str, clock: str, threads: int | None) -> Results:
    """Begin the results of one submission.

    Parameters
    ----------
    scans : of the suite
    label : name of the submission, where a method occurs in several
    clock : ``wall`` or ``cpu``
    threads : number for each method; None for all

    Returns
    -------
    results without rows
    """
    submission = {
        "label": label,
        "program": f"spectral-ct {program_version()}",
        "clock": clock,
        "threads": threads,
        "environment": environment(),
        "scans": {scan.name: scan.identity() for scan in scans.each},
    }
    head = {"schema": SCHEMA, "suite": scans.suite, "tier": scans.tier, "sha256": scans.sha256, "protocol": PROTOCOL}
    return {**head, "submissions": [submission], "rows": []}


def row(scan: Scan, result: dict[str, Any]) -> Row:
    """Keep of a result what a table of the suite has.

    Parameters
    ----------
    scan : that it is of
    result : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    ``case``, ``method``, ``budget`` [s], ``seconds``, ``memory_mib``; ``psnr`` [dB], ``rmse`` (1/mm, g/cm^3 for
    densities) and ``ssim`` of each basis volume, or of what else the volume holds; ``mean_psnr`` of the basis volumes
    and ``views_psnr`` of the test views [dB], None where one is missing; ``error`` where there is no result
    """
    scores = {**result.get("basis", {}).get(PROTOCOL, {}), **result.get("stated", {}).get(PROTOCOL, {})}
    found = {
        "case": scan.name,
        "method": result["contender"],
        "budget": result["budget"],
        "submission": 0,
        "seconds": result.get("seconds"),
        "memory_mib": result.get("peak_memory_mib"),
        **{key: {name: score.get(key) for name, score in scores.items()} for key in _SCORES},
        "mean_psnr": mean_psnr(result, "basis", PROTOCOL),
        "views_psnr": mean_psnr(result, "views", PROTOCOL),
    }
    return found | ({"error": result["error"]} if "error" in result else {})


def missing_row(scan: Scan, method: str) -> Row:
    """Return the row of a program that has no volume of a scan.

    Parameters
    ----------
    scan : of the suite
    method : name of the program

    Returns
    -------
    the row
    """
    return row(scan, {"contender": method, "budget": None, "error": "there is no volume of this case"})


def read_results(path: Path) -> Results:
    """Read results that `recon suite score` wrote.

    Parameters
    ----------
    path : ``suite-score.json``, or the folder that has it

    Returns
    -------
    the results

    Raises
    ------
    InputError
        When there are none.
    """
    file = path / RESULTS if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"there is no {file}: `recon suite score` writes it")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        known = content["schema"] == SCHEMA
    except (ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise InputError(f"{file} holds no results of a suite: give a {RESULTS} of `recon suite score`")
    return content


def merged(each: Sequence[Results]) -> Results:
    """Merge submissions into one; a method that occurs in several gets the label of its submission.

    Parameters
    ----------
    each : results on the same suite

    Returns
    -------
    results of all

    Raises
    ------
    InputError
        When they are of different suites, tiers or scenes.
    """
    first = each[0]
    submissions: list[dict[str, Any]] = []
    rows: list[Row] = []
    for content in each:
        for key, what in (("suite", "suite"), ("tier", "tier"), ("sha256", "hash")):
            if content[key] != first[key]:
                raise InputError(
                    f"only results on the same scans can be merged, got {what} {first[key]!s:.12} and "
                    f"{content[key]!s:.12}"
                )
        rows += [{**one, "submission": one["submission"] + len(submissions)} for one in content["rows"]]
        submissions += content["submissions"]
    of_method: dict[str, set[int]] = {}
    for one in rows:
        of_method.setdefault(one["method"], set()).add(one["submission"])
    labels = _distinct([submission["label"] for submission in submissions])
    named = [
        {**one, "method": f"{one['method']} [{labels[one['submission']]}]"}
        if len(of_method[one["method"]]) > 1
        else one
        for one in rows
    ]
    return {**first, "submissions": submissions, "rows": named}


def _distinct(labels: Sequence[str]) -> list[str]:
    """Labels, with a number where one occurs twice."""
    return [label if labels.count(label) == 1 else f"{label}, {i + 1}" for i, label in enumerate(labels)]
