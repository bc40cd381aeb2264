"""The command ``recon segment``: which material is where in a run."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from phantomgen.cli.common import FiniteRange, Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import stderr_printer
from recon.cli.run_argument import RunFolder, check_run_name

if TYPE_CHECKING:
    from recon.segmentation.result import Segmentation
    from recon.segmentation.scoring.reference import Reference

_POSITIVE = FiniteRange(min=0, min_open=True)


@dataclass(frozen=True)
class _Clusters:
    """How materials are told apart."""

    domain: str | None
    features: str
    bandwidth: float
    energies: tuple[float, ...]
    seed: int


@dataclass(frozen=True)
class _Output:
    """The folder that is written."""

    out: Path | None
    figures: bool
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  recon segment kedge-run\n"
    "  recon segment kedge-run --energy 50 --energy 70 --view 30,20 --truth kedge.h5"
)
@click.argument("run", type=RunFolder())
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [default: RUN/segment].")
@click.option(
    "--domain",
    type=click.Choice(["gaussians", "voxels"]),
    help="What is labelled [default: Gaussians, if there are and no planes divide them].",
)
@click.option(
    "--features",
    type=click.Choice(["local", "own"]),
    default="local",
    show_default=True,
    help="Values at each Gaussian, or its own coefficients as in SpectralCTGaussians.",
)
@click.option(
    "--bandwidth",
    type=_POSITIVE,
    default=3.0,
    show_default=True,
    help="Bandwidth of the mean shift, in units of the noise.",
)
@click.option(
    "--energy",
    "energies",
    type=FiniteRange(),
    multiple=True,
    metavar="KEV",
    help="Energy of images in HU; repeatable [default: 70].",
)
@click.option(
    "--view",
    "views",
    multiple=True,
    metavar="AZIMUTH[,ELEVATION]",
    help="Direction of a rendering, in degrees; repeatable.",
)
@click.option(
    "--truth",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="DATASET",
    help="Dataset with the truth for scores [default: that of the run, if it is beside the run or here].",
)
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw pictures.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the choice of samples.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(clusters=_Clusters, output=_Output, printing=Printing)
def segment(
    run: Path,
    output: _Output,
    clusters: _Clusters,
    views: tuple[str, ...],
    truth: Path | None,
    threads: int | None,
    printing: Printing,
) -> None:
    """Find and identify the materials of a fitted RUN.

    Clusters photoelectric, Compton and K-edge coefficients, and writes labels, densities of materials, RGB, virtual
    monoenergetic and non-contrast images, concentrations, atomic numbers, coloured Gaussians and pictures. The truth is
    read only afterwards, for the scores.
    """
    from phantomgen.dataset.file import open_file
    from recon.segmentation.output.files import (
        POINTS,
        TABLE,
        VOLUMES,
        SegmentFolder,
        write_points,
        write_segmentation,
        write_table,
    )
    from recon.segmentation.output.pictures import DEFAULT_VIEWS, draw_materials, write_views
    from recon.segmentation.output.table import record, table
    from recon.segmentation.rendering import parse_views
    from recon.segmentation.result import ENERGY, Options
    from recon.segmentation.scoring.scores import score
    from recon.segmentation.segment import segment_subject
    from recon.segmentation.subject import open_subject
    from spectra.threads import set_threads

    if output.out is not None:
        check_run_name(output.out)
    note = stderr_printer(printing.silent)
    chosen = parse_views(views) or DEFAULT_VIEWS
    options = Options(
        clusters.domain, clusters.features, clusters.bandwidth, clusters.energies or (ENERGY,), clusters.seed
    )
    if truth is not None:
        open_file(truth).close()
    subject = open_subject(run)
    folder = SegmentFolder(output.out or run / "segment", output.overwrite)
    set_threads(threads)
    note("segment ...")
    found = segment_subject(subject, options)
    reference = _reference(run, truth, found, note)
    if reference is not None:
        note("score ...")
    scores = None if reference is None else score(found, reference)
    note("write ...")
    content = record(found, scores)
    with folder as part:
        write_segmentation(part / VOLUMES, found)
        write_table(part / TABLE, content)
        if found.gaussian_labels is not None:
            write_points(part / POINTS, found)
        if output.figures:
            write_views(part, found, chosen)
            draw_materials(part / "materials.png", found, reference)
    if printing.as_json:
        click.echo(json.dumps({"segment": str(folder.path), **content}))
        return
    click.echo(table(found, scores))
    click.echo(f"Wrote {folder.path}; next: look at the pictures, or open {folder.path / VOLUMES}")


def _reference(run: Path, truth: Path | None, found: "Segmentation", note) -> "Reference | None":
    """The truth that is asked for, or that of a dataset beside the run or here; says why there are no scores."""
    from recon.segmentation.scoring.reference import read_reference
    from spectra.errors import Error

    name = found.subject.dataset
    places = [truth] if truth else [p / name for p in (run.absolute().parent, Path()) if name and (p / name).is_file()]
    if not places:
        note(f"No scores: the dataset {name or 'of the run'} is not at hand; name it by --truth")
        return None
    try:
        reference = read_reference(places[0], found)
    except Error as error:
        if truth:
            raise
        note(f"No scores: {error}")
        return None
    if reference is None:
        note(f"No scores: {places[0]} has no truth")
    return reference
