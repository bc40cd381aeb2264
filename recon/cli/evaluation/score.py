"""The command ``recon score``: parse, call, print."""

from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import ProgressBar, exit_where_failed, memory_text, seconds_text
from recon.cli.run_argument import check_run_name


@dataclass(frozen=True)
class _Stated:
    """What a file does not say about its volume."""

    quantities: tuple[str, ...]
    units: str | None
    axes: str | None
    voxel_mm: str | None
    origin_mm: str | None
    same_grid: bool
    coordinates: str


@dataclass(frozen=True)
class _Output:
    """The folder that is written."""

    out: Path | None
    figures: bool
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n"
    "  recon score fdk.npy --truth kedge.h5 --as mono:60 --units 1/mm --axes zyx --same-grid\n"
    "  recon score ct.nii.gz --truth kedge.h5 --as hu:60 -o ct-score"
)
@click.argument("volume", nargs=-1, required=True)
@click.option("--truth", type=click.Path(dir_okay=False, path_type=Path), required=True, help="Dataset with the truth.")
@click.option(
    "--as",
    "quantities",
    metavar="WHAT[,...]",
    multiple=True,
    help="What the volume holds: basis:NAME, mono:KEV, channel:NAME, hu:KEV, density:NAME or fraction:NAME [default: "
    "what the file says].",
)
@click.option("--units", metavar="UNIT", help="Unit of the values, such as 1/mm, 1/cm, HU, mg/ml or %.")
@click.option(
    "--axes",
    metavar="LETTERS",
    help="Axis of the scan along each axis of the array: zyx, xyz, czyx with several parts first; z-yx where rows go "
    "against y.",
)
@click.option("--voxel-mm", metavar="SIZE", help="Size of a voxel, or z,y,x.")
@click.option("--origin-mm", metavar="Z,Y,X|center", help="Centre of the first voxel, or center around the isocentre.")
@click.option("--same-grid", is_flag=True, help="The voxels are those of the dataset.")
@click.option(
    "--coordinates",
    type=click.Choice(["header", "scan"]),
    default="header",
    show_default=True,
    help="Of images: as the format says, to the left and back or to the right and front, or those of the scan.",
)
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [default: <volume>-score].")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw figures.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(stated=_Stated, output=_Output, printing=Printing)
def score(
    volume: tuple[str, ...],
    truth: Path,
    stated: _Stated,
    output: _Output,
    threads: int | None,
    printing: Printing,
) -> None:
    """Score a VOLUME of any program against the truth of a dataset.

    VOLUME is .npy, .npz:NAME, .h5:/path, .nii, .mha, .nrrd, .tif, .vti, a folder with a DICOM series or TIFF slices,
    or a run; several volumes hold a part each. What a file does not say is stated by options; nothing is guessed.
    Voxels of another size are averaged exactly. Writes metrics.json, volumes.h5 and figures, as runs do.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from phantomgen.volume_files.read import split_name
    from recon.evaluation import verdict
    from recon.evaluation.stated_volume import Statement
    from recon.runs.outcomes.score_volume import score_volume
    from recon.runs.write_run import RunFolder, score_table
    from spectra.threads import set_threads

    if output.out is not None:
        check_run_name(output.out)
    place = {
        "axes": stated.axes,
        "voxel-mm": stated.voxel_mm,
        "origin-mm": stated.origin_mm,
        "same-grid": stated.same_grid,
    }
    options = {"as": stated.quantities, "units": stated.units, "coordinates": stated.coordinates, **place}
    set_threads(threads)
    bar = ProgressBar(printing.silent)
    with open_dataset(truth) as dataset:
        statement = Statement.of(options, dataset.grid)
        path, inside = split_name(volume[0])
        stem = path.resolve().name.split(".")[0] + (f"-{inside.strip('/').replace('/', '-')}" if inside else "")
        folder = RunFolder(output.out or Path(f"{stem}-score"), output.overwrite)
        metrics = score_volume(volume, dataset, statement, folder, output.figures, bar.stage, bar.warn)
    if printing.as_json:
        click.echo(to_json({"score": str(folder.path), **metrics}))
        exit_where_failed(metrics, strict=False)
        return
    click.echo("\n".join([score_table(metrics), "", *verdict.lines(metrics)]).rstrip())
    for remark in metrics["remarks"]:
        click.echo(f"Warning: {remark}.", err=True)
    click.echo(f"{seconds_text(metrics)}{memory_text(metrics)}")
    for name in sorted(found.name for found in (folder.path / "figures").glob("*.png")):
        click.echo(str(folder.path / "figures" / name))
    onward = f"recon report {folder.path}" if "verdict" in metrics else "look at the figures"
    click.echo(f"Wrote {folder.path}; next: {onward}, or read {folder.path / 'metrics.json'}")
    exit_where_failed(metrics, strict=False)
