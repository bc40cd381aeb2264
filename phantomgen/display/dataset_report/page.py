"""The whole page about a dataset."""

from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.display.dataset_report.dose import dose_parts
from phantomgen.display.dataset_report.provenance import plan_of, plan_parts, provenance_parts
from phantomgen.display.dataset_report.scan import energy_parts, geometry_parts, view_parts
from phantomgen.display.dataset_report.truth import truth_parts
from phantomgen.display.html import Code, Page, Part, Section
from phantomgen.runtime.versions import program_version
from spectra.errors import Error, InputError

_CHANGES_DOSE = ("degrade",)  # processes after which the scene no longer states the dose of the file


def dataset_report(path: Path, air: str | None = None, progress: bool = False) -> Page:
    """Create the page about a dataset.

    Parameters
    ----------
    path : of the dataset
    air : a part of the panel that sees only air, for lack of flats
    progress : show bars on stderr

    Returns
    -------
    the page

    Raises
    ------
    DatasetError
        When it cannot be read.
    """
    truth = read_truth(path)
    with open_dataset(path, air) as dataset, TemporaryDirectory() as name:
        info, folder = describe(path), Path(name)
        chapters: list[tuple[str, list[Part]]] = []
        if truth is not None:
            chapters.append(("Truth", truth_parts(truth, folder)))
        chapters += [
            ("Geometry and energies", [*energy_parts(dataset, folder), *geometry_parts(dataset, folder)]),
            ("Views", view_parts(dataset, folder)),
        ]
        missing: list[tuple[str, str]] = []
        if truth is not None and truth.scene:
            try:
                chapters.append(("Dose", _dose_parts(path, truth, info, folder, progress)))
            except Error as error:  # a file of the scene that is not here, a geometry without dose
                missing.append(("Dose", f"{error}."))
        plan = plan_of(dataset)
        if plan:
            chapters.append(("Plan and error", plan_parts(dataset)))
        origin = [*provenance_parts(dataset), Code("The file in words", describe_text(info))]
        chapters.append(("Provenance", origin))
        views, channels, rows, columns = info["shape"]
        facts = [
            (str(views), "views, " + ", ".join(f"{n} {name}" for name, n in info["views"].items())),
            (str(channels), "channels"),
            (f"{rows} x {columns}", "pixels"),
            ("{:g} – {:g}".format(*info["range_keV"]), "keV"),
            (f"{info['photons']:.3g}", "photons per pixel and view"),
            (" x ".join(map(str, info["grid"]["shape"])), "voxels"),
        ]
        if plan:
            facts.append((f"{plan['error']:.0e}", "error of log projections, planned"))
        missing += [] if truth is not None else [("Truth", "the dataset has none.")]
        missing += [] if plan else [("Plan and error", "the dataset does not say how it was computed.")]
        return Page(
            title=dataset.name,
            subtitle=f"Dataset {path.name}, {info['bytes'] / 1e6:.1f} MB: {info['orbit']} scan of a spectral phantom",
            facts=tuple(facts),
            sections=tuple(Section(title, tuple(parts)) for title, parts in chapters),
            footer=f"Written by phantomgen report {program_version()} on {date.today().isoformat()}.",
            left_out=tuple(missing),
        )


def _dose_parts(path: Path, truth: Truth, info: dict[str, Any], folder: Path, progress: bool) -> list[Part]:
    """Create the parts about dose of a scan that is still as it was simulated."""
    steps = [step["step"] for step in info["history"]]
    changed = [step for step in steps if step in _CHANGES_DOSE]
    if changed:
        raise InputError(f"the scene states the dose before the step {changed[0]}")
    return dose_parts(path, truth, folder, progress)
