"""Measured views, those that the model predicts, and residuals in standard deviations of the noise."""

import numpy as np

from phantomgen.display.figures.style import PAGE_WIDTH
from phantomgen.display.figures.views import sinograms, view_images
from phantomgen.display.html import Part, picture
from recon.evaluation.scoring import held_out_views
from recon.figures import run_figures as figures
from recon.output.report.case import Case, Parts
from recon.output.report.finished_run import FinishedRun
from spectra.errors import InputError

MOST_CHANNELS = 6  # channels; largest number in one figure, for the width of a page


def parts(case: Case) -> Parts:
    """Draw one test view of every run, and the sinograms.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When the dataset was not found.
    """
    dataset = case.needs_dataset()
    found: list[Part] = []
    if len(dataset.splits["test"]):
        for i, run in enumerate(case.runs):
            found += _view_of(case, run, i)
    caption = (
        "Sinograms: log projections of the middle row of pixels in the training views, which the fit used. The "
        "table has their mean in the first channel."
    )
    path = case.path("sinograms")
    return (*found, picture(case.drawn(path, sinograms(dataset, path)), caption))


def _view_of(case: Case, run: FinishedRun, number: int) -> list[Part]:
    """Test view of a run: images per channel, and residuals with their histograms."""
    dataset = case.needs_dataset()
    try:
        view = next(held_out_views(dataset, run.model))
    except InputError:  # a model in other bases than those that the dataset states
        return []
    index, s = int(dataset.splits["test"][0]), dataset.spectra
    taken = np.flatnonzero(view.open_beam.any(axis=(1, 2)))[:MOST_CHANNELS]
    channels = [s.channels[c] for c in taken]
    seen = np.where(view.open_beam > 0, 1.0, np.nan)[taken]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = [np.log(view.open_beam[taken] / np.maximum(v[taken], 0.5)) * seen for v in (view.counts, view.expected)]
    suffix = "" if number == 0 else f"_{number}"
    images = [(s.units, view.counts[taken] * seen), ("−log, measured", logs[0]), ("−log, expected", logs[1])]
    shown, residuals = case.path(f"view{suffix}"), case.path(f"residuals{suffix}")
    case.drawn(shown, view_images(images, channels, shown))
    counts, expected = view.counts[taken], view.expected[taken]
    case.drawn(residuals, figures.residuals(counts, expected, channels, residuals, view.away, PAGE_WIDTH))
    return [
        picture(
            shown,
            f"{case.who(run)}Test view {index}: {s.units}, their negative logarithm, and that of the model.",
        ),
        picture(
            residuals,
            f"{case.who(run)}Residuals of this view in standard deviations of the expected noise, and their "
            "distribution beside the unit normal; above it the part of rays beyond 6σ, of all and of those away "
            "from edges.",
        ),
    ]
