"""The command ``recon quality``: how well an insert is detected in a run."""

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import click

from phantomgen.cli.common import FiniteRange
from recon.cli.common import ProgressBar
from recon.cli.run_argument import RepeatedRun, RunFolder, repeated_run_options, scan_of_run

if TYPE_CHECKING:
    from recon.detectability.image_quality import ImageQuality
    from recon.quality.observers import Detectability


@click.command(
    epilog="\b\nExamples:\n  recon quality kedge-run --insert 30,0,0,8,40\n"
    "  recon quality kedge-run --insert 30,0,0,8,40 --as iodine -n 16\n"
    "  recon quality kedge-run --insert 30,0,0,8,40 --truth"
)
@click.argument("run", type=RunFolder())
@click.option(
    "--insert",
    "place",
    metavar="X,Y,Z,RADIUS[,LENGTH]",
    required=True,
    help="The object that is to be detected: a ball, or with LENGTH a rod along z [mm].",
)
@click.option(
    "--as",
    "what",
    metavar="QUANTITY",
    default="hu",
    show_default=True,
    help="Images that observers see: hu, vmi, vnc, electron-density, zeff, or an element such as iodine.",
)
@click.option("--energy", type=FiniteRange(min=0, min_open=True), metavar="KEV", help="Of hu, vmi, vnc [default: 70].")
@click.option(
    "-n",
    "--pairs",
    type=click.IntRange(min=4),
    default=8,
    show_default=True,
    help="Reconstructions with and without the insert; each takes as long as the run itself.",
)
@click.option("--truth", "true", is_flag=True, help="Draw counts from the truth of the scan, not from the result.")
@repeated_run_options
def quality(
    run: Path,
    place: str,
    what: str,
    energy: float | None,
    pairs: int,
    true: bool,
    again: RepeatedRun,
) -> None:
    """Compute how well an insert is detected in the images of RUN, and how well its counts would allow.

    Draws counts with and without the insert from the result, or from the truth of a simulated scan, reconstructs both
    with other noise each and the settings of the run, and computes contrast, noise power spectrum, task transfer
    function, and d' of two observers of images beside that of the ideal observer of the counts, which no reconstruction
    exceeds. Writes quality/<insert>/ into RUN. Call it again to continue after an interruption, or with a larger -n:
    finished reconstructions are kept, and those with the insert are the replicates of `recon uncertainty`.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.dataset.truth import read_truth
    from phantomgen.runtime.plain_json import to_json
    from recon.detectability.classes import quality_folder, reconstruct_classes
    from recon.detectability.image_quality import measure
    from recon.detectability.insert import Insert
    from recon.detectability.quality_figure import draw_quality
    from recon.readouts.quantity import quantity
    from recon.readouts.readouts import Readouts
    from recon.readouts.spectrum import detected_spectrum
    from recon.uncertainty.estimate import RepeatableRun
    from spectra.errors import DatasetError
    from spectra.threads import set_threads

    insert = Insert.parse(place)
    path = scan_of_run(run, again.dataset)
    set_threads(again.threads)
    bar = ProgressBar(again.silent)
    with open_dataset(path, again.air) as opened:
        repeatable = RepeatableRun.of_run(run, opened)
        stored = repeatable.stored
        spectrum = detected_spectrum(stored.basis, stored.transmission)
        shown = quantity(Readouts.of(stored.basis, *spectrum), what, energy)
        if shown.caution:
            click.echo(f"Warning: {shown.caution}.", err=True)
        truth = read_truth(opened.path) if true else None
        if true and truth is None:
            raise DatasetError(f"{opened.path} has no truth: leave --truth out")
        classes = reconstruct_classes(
            repeatable,
            insert,
            pairs,
            again.seed,
            bar,
            lambda k: bar.note(f"reconstruction {k + 1} of {2 * pairs}"),
            truth,
        )
    bar.stage("measure")
    found = measure(classes, shown)
    target = quality_folder(run, insert) / f"{shown.name}{'_of_truth' if true else ''}.json"
    found.write(target)
    draw_quality(found, target.with_suffix(".png"))
    if again.as_json:
        click.echo(to_json({"quality": str(target), **found.numbers()}))
        return
    click.echo(_table(found))
    click.echo(f"Wrote {target} and {target.with_suffix('.png')}; next: recon report {run}")


def _table(found: "ImageQuality") -> str:
    """Numbers as text."""

    def interval(one: "Detectability") -> str:
        return f"{one.value:.2f} ({one.low:.2f} to {one.high:.2f} with 95 % confidence)"

    of_edge = "not known: the insert is too small" if isnan(found.edge) else f"{found.edge:.3g} mm"
    rows = {
        "contrast": f"{found.contrast:.4g} {found.unit}",
        "noise of a voxel": f"{found.noise:.4g} {found.unit}",
        "contrast to noise": f"{found.contrast_to_noise:.3g}",
        "edge, 90 to 10 %": of_edge,
        "d' without prewhitening": interval(found.without_prewhitening),
        "d' channelised Hotelling": interval(found.hotelling),
        "d' ideal observer of counts": f"{found.ideal:.2f}",
    }
    lines = [f"{key:<29}{value}" for key, value in rows.items()]
    return "\n".join(
        [f"{found.about}, insert at {found.insert} mm, {found.pairs} reconstructions of each class", *lines]
    )
