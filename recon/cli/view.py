"""The command ``recon view``: a run in a window, a picture or a page."""

from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, grouped
from recon.cli.run_argument import RunFolder

_FILE = click.Path(dir_okay=False, path_type=Path)


@dataclass(frozen=True)
class _Outputs:
    """Pictures and pages that are written in place of a window."""

    screenshot: Path | None
    html: Path | None
    slices: Path | None
    size: str | None
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  recon view kedge-run\n"
    "  recon view kedge-run --truth kedge.h5 --screenshot run.png --html run.html\n"
    "  recon view kedge-run --slices run.html"
)
@click.argument("run", type=RunFolder())
@click.option(
    "--truth",
    type=_FILE,
    metavar="DATASET",
    help="Dataset with the truth to compare with [default: that of the run, if it is beside the run].",
)
@click.option("--basis", metavar="NAME", help="Basis of the slices [default: all; in a window the first].")
@click.option(
    "--level", "levels", metavar="BASIS=VALUE", multiple=True, help="A surface at a value in 1/mm, not of materials."
)
@click.option("--at", metavar="X,Y,Z", help="Point that the slices pass through, in mm [default: the centre].")
@click.option("--screenshot", type=_FILE, help="Write a PNG; needs no display.")
@click.option("--html", type=_FILE, help="Write one page to turn in a browser; needs no display.")
@click.option(
    "--slices", type=_FILE, help="Write one page with flat slices, windows, energies and profiles; needs no display."
)
@click.option("--size", metavar="WIDTHxHEIGHT", help="Pixels [default: 1600x1000, wider for many bases].")
@click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
@debug_option
@grouped(outputs=_Outputs)
def view(
    run: Path,
    truth: Path | None,
    basis: str | None,
    levels: tuple[str, ...],
    at: str | None,
    outputs: _Outputs,
) -> None:
    """Look at a RUN: slices of truth, result and difference, surfaces, and Gaussians.

    --slices writes a page for any browser that needs no network: axial, coronal and sagittal slices with a cross hair.

    All panels turn together. In a window the keys Left and Right change the basis, x, y and z move a plane up, and
    X, Y and Z down, and the panel under the pointer tells the values there.
    """
    from phantomgen.display.viewer.options import point_of, size_of
    from phantomgen.display.viewer.output import check_outputs
    from recon.output.viewer.load import load_run
    from recon.output.viewer.output import chosen_bases, show
    from recon.output.viewer.pointer import PointerValues
    from recon.output.viewer.surfaces import checked_levels, parse_levels
    from recon.runs.read_run import check_run_folder

    check_run_folder(run)
    if outputs.slices is not None:
        from phantomgen.display.html import check_page
        from recon.output.slice_page.load import load_slices, write_slices

        check_page(outputs.slices, outputs.overwrite)
        write_slices(load_slices(run, truth), outputs.slices)
        click.echo(outputs.slices)
        if outputs.screenshot is None and outputs.html is None:
            return
    check_outputs(outputs.screenshot, outputs.html, outputs.overwrite)
    pixels, chosen = size_of(outputs.size) if outputs.size else None, parse_levels(levels)
    content = load_run(run, truth, point_of(at) if at else None)
    bases = chosen_bases(content, basis)
    checked_levels(content, chosen or {})
    if content.truth is None:
        click.echo("Note: the truth of the scan was not found, so only the result is shown; see --truth.", err=True)
    in_window = outputs.screenshot is None and outputs.html is None
    pointed = PointerValues.of(run, content) if in_window else None
    show(content, bases, chosen, outputs.screenshot, outputs.html, pixels, pointed)
    for path in filter(None, (outputs.screenshot, outputs.html)):
        click.echo(path)
