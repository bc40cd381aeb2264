"""Parts of the page about the scan: geometry, energies, views."""

from pathlib import Path

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.display.figures.dataset_energies import spectrum
from phantomgen.display.figures.geometry import draw
from phantomgen.display.figures.style import PAGE_WIDTH
from phantomgen.display.figures.views import sinograms, view_images
from phantomgen.display.html import Part, Table, picture
from phantomgen.display.html.content import csv_of

MOST_CHANNELS = 6  # in one picture of a view


def geometry_parts(dataset: Dataset, folder: Path) -> list[Part]:
    """Create the parts about the orbit, with its poses as a table.

    Parameters
    ----------
    dataset : open dataset
    folder : folder for the pictures

    Returns
    -------
    parts of the page
    """
    path = folder / "geometry.svg"
    geometry = dataset.geometry
    draw(geometry, path, dataset.grid, stacked=True)
    header = ["view", "angle_deg", *(f"{name}_{axis}_mm" for name in ("source", "panel_center") for axis in "xyz")]
    poses = np.column_stack([np.rad2deg(geometry.angles), geometry.source, geometry.panel_center])
    rows = [(view, *(f"{value:.6g}" for value in row)) for view, row in enumerate(poses)]
    caption = f"Way of source and panel: {geometry!r}. The table has the poses of all views."
    return [picture(path, caption, csv_of(header, rows))]


def energy_parts(dataset: Dataset, folder: Path) -> list[Part]:
    """Create the parts about spectrum, channels and bases.

    Parameters
    ----------
    dataset : open dataset
    folder : folder for the pictures

    Returns
    -------
    parts of the page
    """
    s, path = dataset.spectra, folder / "spectrum.svg"
    spectrum(s, path, PAGE_WIDTH)
    rows = tuple(
        (name, f"{low:g} – {high:g}", f"{mean:.1f}", f"{counts:,.0f}")
        for name, low, high, mean, counts in zip(
            s.channels, s.lower, s.upper, s.effective_energy, s.weights.sum(axis=1), strict=True
        )
    )
    header = ("channel", "limits [keV]", "mean energy [keV]", f"open beam [{s.units}]")
    return [
        Table(header, rows, "What a pixel at the panel's centre counts in one view without an object.", "channels"),
        picture(path, "Incident photons and what each channel counts of them, above the raw basis functions."),
    ]


def view_parts(dataset: Dataset, folder: Path) -> list[Part]:
    """Create the parts about the first view and the flats per channel, and the sinograms.

    Parameters
    ----------
    dataset : open dataset
    folder : folder for the pictures

    Returns
    -------
    parts of the page
    """
    s = dataset.spectra
    shown = slice(0, MOST_CHANNELS)
    seen = np.where(dataset.mask, np.nan, 1.0)
    images = [
        (s.units, (dataset.load([0])[0] * seen)[shown]),
        ("mean flat", (dataset.flat * seen)[shown]),
        ("−log", dataset.line_integrals(0)[shown]),
    ]
    path, lines = folder / "view.svg", folder / "sinograms.svg"
    view_images(images, s.channels[shown], path)
    sinograms(dataset, lines)
    return [
        picture(path, f"View 0 in each channel: {s.units}, the mean flat field, and log projections."),
        picture(
            lines,
            "Sinograms: log projections of the middle row of pixels in the training views. The table has their mean in "
            "the first channel.",
        ),
    ]
