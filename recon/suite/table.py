"""Results on a suite as a page in Markdown and as CSV."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.comparison.tables.table import ABSENT, markdown_table, number
from recon.suite.results import Results, Row
from spectra.basis.basis import pretty

_DIGITS = 12  # of hashes on the page; the files have all


def method_name(row: Row) -> str:
    """Format method and budget of a row.

    Parameters
    ----------
    row : of results

    Returns
    -------
    such as ``one-step, 30 s``
    """
    return row["method"] if row["budget"] is None else f"{row['method']}, {row['budget']:g} s"


def page(results: Results) -> str:
    """Write the page with all tables.

    Parameters
    ----------
    results : of one submission or of several

    Returns
    -------
    Markdown: suite and hashes, mean PSNR of each case, who has computed what, and a table per case
    """
    parts = [
        f"# Suite {results['suite']}, tier {results['tier']}, {results['sha256'][:_DIGITS]}",
        f"SHA-256 of the scenes: `{results['sha256']}`. PSNR in dB over the largest true value, RMSE in 1e-3/mm (of "
        "densities in mg/ml), of whole volumes; a dash stands where a volume or a number is missing.",
        f"## Mean PSNR of the basis volumes\n\n{summary_table(results)}",
        *_cases(results),
        "## Computed by\n\n" + "\n".join(_submission(one) for one in results["submissions"]),
    ]
    return "\n\n".join(parts) + "\n"


def summary_table(results: Results) -> str:
    """Write the table of mean PSNR: a line per method, a column per case.

    Parameters
    ----------
    results : of one submission or of several

    Returns
    -------
    the table; the mean of all cases stands only where none is missing
    """
    cases = case_names(results)
    levels = mean_levels(results)
    lines = []
    for name, own in levels.items():
        values = [own.get(case) for case in cases]
        mean = None if None in values else float(np.mean(values))  # type: ignore[arg-type] - none is None
        lines.append([name, *(number(value, ".2f") for value in values), number(mean, ".2f")])
    return markdown_table(["method", *cases, "mean"], lines)


def mean_levels(results: Results) -> dict[str, dict[str, float | None]]:
    """Return the mean PSNR of the basis volumes by method and case.

    Parameters
    ----------
    results : of one submission or of several

    Returns
    -------
    PSNR [dB]; None where a basis volume is missing
    """
    found: dict[str, dict[str, float | None]] = {}
    for row in results["rows"]:
        found.setdefault(method_name(row), {})[row["case"]] = row["mean_psnr"]
    return found


def case_names(results: Results) -> list[str]:
    """List the cases in the order of the suite.

    Parameters
    ----------
    results : of one submission or of several

    Returns
    -------
    names
    """
    return list(dict.fromkeys(name for one in results["submissions"] for name in one["scans"]))


def write_csv(path: Path, results: Results) -> None:
    """Write one line per case, method and volume.

    Parameters
    ----------
    path : CSV file
    results : of one submission or of several
    """
    head = ("suite", "tier", "sha256")
    columns = ("case", "counts_sha256", "submission", "program", "method", "budget", "seconds", "memory_mib")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow((*head, *columns, "volume", "psnr", "rmse", "ssim", "error"))
        for row in results["rows"]:
            by = results["submissions"][row["submission"]]
            counts = by["scans"][row["case"]]["arrays"]["counts"]
            start = [*(results[key] for key in head), row["case"], counts, by["label"], by["program"], row["method"]]
            start += [row[key] for key in ("budget", "seconds", "memory_mib")]
            for volume in row["psnr"] or [""]:
                scores = [row[key].get(volume) for key in ("psnr", "rmse", "ssim")]
                writer.writerow(["" if one is None else one for one in (*start, volume, *scores, row.get("error"))])


def _cases(results: Results) -> list[str]:
    """A section per case."""
    sections = []
    for case in case_names(results):
        rows = [row for row in results["rows"] if row["case"] == case]
        if not rows:
            continue
        scans = [one["scans"][case] for one in results["submissions"] if case in one["scans"]]
        counts = list(dict.fromkeys(scan["arrays"]["counts"][:_DIGITS] for scan in scans))
        agreement = ", ".join(dict.fromkeys(scan["agreement"] for scan in scans))
        text = [
            f"## {case}",
            f"{scans[0]['what']}. Counts `{'`, `'.join(counts)}`, compared with the stored ones: {agreement}.",
            _case_table(rows),
        ]
        errors = list(dict.fromkeys(f"- {method_name(row)}: {row['error']}." for row in rows if "error" in row))
        sections.append("\n\n".join([*text, *(["\n".join(errors)] if errors else [])]))
    return sections


def _case_table(rows: Sequence[Row]) -> str:
    """Table of one case: seconds, memory, PSNR and RMSE of each volume."""
    names = list(dict.fromkeys(name for row in rows for name in row["psnr"]))
    header = ["method", "seconds", "memory [MiB]", *(f"{pretty(n)} {what}" for n in names for what in ("PSNR", "RMSE"))]
    lines = []
    for row in rows:
        scores = [
            number(None if (value := row[key].get(name)) is None else factor * value, ".2f")
            for name in names
            for key, factor in (("psnr", 1.0), ("rmse", 1e3))
        ]
        lines.append([method_name(row), number(row["seconds"], ".1f"), number(row["memory_mib"], ".0f"), *scores])
    return markdown_table(header, lines)


def _submission(one: dict[str, Any]) -> str:
    """Program, time and versions of a submission."""
    threads = "all threads" if one["threads"] is None else f"{one['threads']} thread(s)"
    unit = "processor time" if one["clock"] == "cpu" else "wall time"
    versions = ", ".join(f"{name} {version}" for name, version in one["environment"].items()) or ABSENT
    return f"- {one['label']}: scored by {one['program']}; {unit}, {threads}; {versions}."
