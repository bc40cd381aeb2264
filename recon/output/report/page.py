"""Page of a report: the topics that runs, dataset and truth allow, and the reasons why others are missing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.display.html import Page, Paragraph, Part, Section
from phantomgen.runtime.versions import program_version
from recon.calibration.refine import SPECTRUM, ChosenSpectrum
from recon.evaluation import verdict
from recon.output.report import (
    energies,
    limits,
    materials,
    progress_and_cost,
    quantities,
    resolution,
    scores,
    segments,
    slices,
    uncertainty,
    views,
)
from recon.output.report.case import Case, LeftOut, Parts, check_same_scan, number
from recon.output.report.finished_run import FinishedRun, open_finished_run
from recon.output.report.progress_and_cost import memory, seconds, size
from recon.runs.read_run import find_dataset
from recon.scatter.chosen_scatter import SCATTER, ChosenScatter
from spectra.basis.basis import pretty
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Topic = Callable[[Case], Parts]
CHAPTERS: dict[str, dict[str, Topic]] = {
    "Scores": {"Scores": scores.parts},
    "Volumes": {
        "Slices": slices.parts,
        "Profiles": slices.profile_parts,
    },
    "Physical quantities": {"CT numbers, contrast agents and electrons": quantities.parts},
    "Materials": {
        "Bias and noise": materials.parts,
        "Scatter of two bases": materials.scatter_parts,
        "Cramér-Rao limits": limits.parts,
        "Segmentation": segments.parts,
    },
    "Resolution and noise": {"Edge response, MTF and noise power": resolution.parts},
    "Uncertainty": {
        "Standard deviations": uncertainty.parts,
        "Detectability of inserts": uncertainty.detectability_parts,
    },
    "Views": {"Views, residuals and sinograms": views.parts},
    "Energies": {"Spectrum and bases": energies.parts},
    "Progress and cost": {"Progress": progress_and_cost.progress_parts, "Cost": progress_and_cost.cost_parts},
}


def run_report(
    folders: Sequence[Path],
    dataset: Path | None = None,
    air: str | None = None,
    on_chapter: Callable[[str], None] = lambda name: None,
) -> Page:
    """Create a page about runs of one scan.

    Parameters
    ----------
    folders : run folders
    dataset : the scan; where it is None it is searched by its name beside the runs and in the current folder
    air : a part of the panel that sees only air, for lack of flats
    on_chapter : called with the name of each chapter when it begins

    Returns
    -------
    the page

    Raises
    ------
    DatasetError
        When a folder is no finished run, or the dataset cannot be read.
    InputError
        When the runs are of different scans, or the dataset is another one.
    """
    with _opened(folders, dataset, air) as (case, scan):
        return _page(case, scan, on_chapter)


def report_figures(folders: Sequence[Path], dataset: Path | None = None, air: str | None = None) -> dict[str, "Figure"]:
    """Draw the figures of a report.

    Parameters
    ----------
    folders, dataset, air : see `run_report`

    Returns
    -------
    figures of matplotlib by their names, in the order of the page, such as ``axial`` and ``edge_response``
    """
    with _opened(folders, dataset, air) as (case, _):
        for topics in CHAPTERS.values():
            for topic in topics.values():
                with suppress(LeftOut):
                    topic(case)
        return case.figures


@contextmanager
def _opened(folders: Sequence[Path], dataset: Path | None, air: str | None) -> Iterator[tuple[Case, str]]:
    """Runs with their scan, and its name; the folder for figures is removed at the end."""
    runs = tuple(map(open_finished_run, folders, names_of(folders)))
    scan = check_same_scan(runs)
    found = dataset or find_dataset(scan, folders)
    with TemporaryDirectory() as folder:
        if found is None:
            yield Case(runs, None, None, Path(folder)), scan
            return
        with open_dataset(found, air) as opened:
            check_fits(opened, runs)
            known = ChosenSpectrum.of_run(opened, folders[0]).dataset if _same_file(folders, SPECTRUM) else opened
            known = ChosenScatter.of_run(known, folders[0]).dataset if _same_file(folders, SCATTER) else known
            yield Case(runs, known, read_truth(found), Path(folder)), scan


def _same_file(folders: Sequence[Path], name: str) -> bool:
    """Whether all runs used one spectral model, or one estimate of scatter; else the page shows the scan as it is."""
    paths = [folder / name for folder in folders]
    return len({path.read_bytes() if path.is_file() else b"" for path in paths}) == 1


def names_of(folders: Sequence[Path]) -> list[str]:
    """Create names of runs: those of their folders, with the parent folders where two have the same name.

    Parameters
    ----------
    folders : run folders

    Returns
    -------
    one name per run

    Raises
    ------
    InputError
        When a folder is given twice.
    """
    paths = [folder.resolve() for folder in folders]
    for depth in range(1, 10):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    twice = next(str(path) for path in paths if paths.count(path) > 1)
    raise InputError(f"the run {twice} is named twice")


def check_fits(dataset: Dataset, runs: Sequence[FinishedRun]) -> None:
    """Refuse a dataset that the runs do not reconstruct.

    Parameters
    ----------
    dataset : the dataset
    runs : runs of the report

    Raises
    ------
    InputError
        When its channels are others than those that a run was scored on.
    """
    for run in runs:
        channels = tuple(run.metrics.get("channels") or dataset.spectra.channels)
        if channels != dataset.spectra.channels:
            raise InputError(
                f"{dataset.path} is not the scan of {run.folder}: it has the channels "
                f"{', '.join(dataset.spectra.channels)}, the run {', '.join(channels)}"
            )


def _page(case: Case, scan: str, on_chapter: Callable[[str], None]) -> Page:
    """Page with all chapters, and the reasons why topics are missing."""
    done, left_out = [], _lacking(case)
    for title, topics in CHAPTERS.items():
        on_chapter(title)
        parts: list[Part] = []
        for name, topic in topics.items():
            try:
                parts += topic(case)
            except LeftOut as reason:
                left_out.append((name, f"{reason}."))
        if parts:
            done.append(Section(title, tuple(parts)))
    first = case.runs[0]
    title = first.name if len(case.runs) == 1 else " · ".join(run.name for run in case.runs)
    return Page(
        title=title,
        subtitle=f"Reconstruction of {scan or 'a scan'} by {', '.join(dict.fromkeys(r.method for r in case.runs))}",
        facts=_facts(case),
        sections=(*_verdicts(case), *done),
        footer=f"Written by recon report {program_version()} on {date.today().isoformat()}.",
        left_out=tuple(left_out),
    )


def _verdicts(case: Case) -> tuple[Section, ...]:
    """Section with the verdict of every run."""
    parts = []
    for run in case.runs:
        who = f"{run.name}: " if len(case.runs) > 1 else ""
        parts += [Paragraph(f"{who}{line}") for line in verdict.lines(run.metrics)]
    return (Section("Verdict", tuple(parts)),) if parts else ()


def _lacking(case: Case) -> list[tuple[str, str]]:
    """Bases that a run did not fit, and scores and figures that failed in it, each with the reason."""
    found = []
    for run in case.runs:
        bases = run.metrics.get("bases_left_out") or ()
        if bases:
            what = f"{case.who(run)}{', '.join(map(pretty, bases))}"
            found.append((what, "not fitted, though the dataset has it; scored as a volume of zeros."))
        found += [(f"{case.who(run)}{what}", f"{why}.") for what, why in (run.metrics.get("failed") or {}).items()]
    return found


def _facts(case: Case) -> tuple[tuple[str, str], ...]:
    """Main numbers: PSNR of the first run, its size, time and memory."""
    run = case.runs[0]
    who = f", {run.name}" if len(case.runs) > 1 else ""
    facts = [
        (f"{number(s.get('psnr'), '.1f')} dB", f"PSNR, {pretty(name)}{who}")
        for name, s in run.metrics.get("basis", {}).items()
    ]
    facts.append((size(run).split(" Gauss")[0], f"{'Gaussians' if 'gaussians' in run.metrics else 'volume'}{who}"))
    facts.append((f"{number(seconds(run), '.0f')} s", f"time{who}"))
    facts.append((f"{number(memory(run), '.0f')} MiB", f"peak memory{who}"))
    return tuple(facts)
