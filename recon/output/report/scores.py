"""Tables of the scores of all runs: against the truth, and on views that no fit has used."""

from dataclasses import replace
from typing import Any

from phantomgen.display.html import Part, Table
from phantomgen.display.html.content import csv_of
from recon.output.report.case import Case, LeftOut, Parts, number
from spectra.basis.basis import pretty

_BASIS = ("psnr", "psnr_scaled", "psnr_zero", "ssim", "bias", "rmse")
_ELSEWHERE = ("psnr_elsewhere", "bias_elsewhere", "rmse_elsewhere")
_CHANNEL = ("psnr", "psnr_noise", "chi_square_all", "chi_square_away", "away")


def parts(case: Case) -> Parts:
    """Create the tables of scores.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the runs have no scores.
    """
    found: list[Part] = [*_against_truth(case), *_on_test_views(case)]
    if not found:
        raise LeftOut("the runs have no scores: their dataset has neither truth nor test views")
    return tuple(found)


def _against_truth(case: Case) -> list[Table]:
    """One row per run and basis."""
    scored = [(run, name, s) for run in case.runs for name, s in run.metrics.get("basis", {}).items()]
    if not scored:
        return []
    header = ("run", "basis", "PSNR [dB]", "after best scale", "zero volume", "SSIM", "bias [1/mm]", "RMSE [1/mm]")
    rows = [(run.name, pretty(name), *_basis_cells(s)) for run, name, s in scored]
    keys = _BASIS
    marked = any(_ELSEWHERE[0] in s for _, _, s in scored)
    if marked:
        keys = (*_BASIS, *_ELSEWHERE)
        header = (*header, "PSNR elsewhere [dB]", "RMSE elsewhere [1/mm]")
        rows = [(*row, *_elsewhere_cells(s)) for row, (_, _, s) in zip(rows, scored, strict=True)]
    table = csv_of(("run", "basis", *keys), [(run.name, name, *(s.get(k) for k in keys)) for run, name, s in scored])
    caption = (
        "Against the truth. PSNR is 10 log10(max(truth)² / MSE) over the whole volume; a result near that of a volume "
        "of zeros has no value. SSIM is the mean over axial slices."
    )
    if marked:
        caption += (
            " Elsewhere leaves out the voxels whose bases the counts do not determine, which the verdict names, and of "
            "an object that the panel cuts off those that not all views see; the peak of that PSNR is the largest true "
            "value of the others."
        )
    return [_without_run(Table(header, tuple(rows), caption, "scores", table), case)]


def _on_test_views(case: Case) -> list[Table]:
    """One row per run and channel."""
    scored = [(run, name, s) for run in case.runs for name, s in (run.metrics.get("channels") or {}).items()]
    if not scored:
        return []
    header = ("run", "channel", "PSNR [dB]", "of noise alone", "chi-square", "away from edges", "part of the rays")
    rows = [(run.name, name, *_channel_cells(s)) for run, name, s in scored]
    table = csv_of(
        ("run", "channel", *_CHANNEL), [(run.name, name, *(s.get(k) for k in _CHANNEL)) for run, name, s in scored]
    )
    caption = (
        "On test views, which no fit has used. PSNR of log projections, and that of the true model; "
        "chi-square is 1 where model and noise agree."
    )
    return [_without_run(Table(header, tuple(rows), caption, "test_views", table), case)]


def _without_run(table: Table, case: Case) -> Table:
    """Table without its first column where there is one run only; its CSV keeps the column."""
    if len(case.runs) > 1:
        return table
    return replace(table, header=table.header[1:], rows=tuple(row[1:] for row in table.rows))


def _basis_cells(scores: dict[str, Any]) -> tuple[str, ...]:
    """Cells of the scores of a basis."""
    cells = [number(scores.get(key), ".2f") for key in _BASIS[:3]]
    return (*cells, number(scores.get("ssim"), ".3f"), *(number(scores.get(key), ".1e") for key in _BASIS[4:]))


def _elsewhere_cells(scores: dict[str, Any]) -> tuple[str, ...]:
    """Cells of the scores without unreliable voxels."""
    return number(scores.get("psnr_elsewhere"), ".2f"), number(scores.get("rmse_elsewhere"), ".1e")


def _channel_cells(scores: dict[str, Any]) -> tuple[str, ...]:
    """Cells of the scores of a channel."""
    part = scores.get("away")
    cells = [number(scores.get(key), ".2f") for key in _CHANNEL[:2]]
    cells += [number(scores.get(key), ".3f") for key in _CHANNEL[2:4]]
    return (*cells, number(None if part is None else 100 * part, ".0f") + (" %" if part is not None else ""))
