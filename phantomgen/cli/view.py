"""``phantomgen view``: a scene or dataset in three dimensions."""

from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, grouped
from phantomgen.cli.preset_option import preset_option


@dataclass(frozen=True)
class _Outputs:
    """Pictures and pages that are written in place of a window."""

    screenshot: str | None
    html: str | None
    geometry: str | None
    size: str | None
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  phantomgen view kedge.h5\n  phantomgen view kedge --screenshot kedge.png --html kedge.html"
)
@click.argument("source", metavar="SCENE|PRESET|DATASET", required=False)
@preset_option
@click.option("--screenshot", type=click.Path(dir_okay=False), help="Write a PNG; needs no display.")
@click.option("--html", type=click.Path(dir_okay=False), help="Write one page to turn in a browser; needs no display.")
@click.option("--geometry", type=click.Path(dir_okay=False), help="Draw the orbit in plan: PNG, PDF or SVG.")
@click.option("--at", metavar="X,Y,Z", help="Where the slices cut, in mm [default: the centre].")
@click.option("--voxels", type=click.IntRange(min=1), help="Voxels along the longest edge of the volume of a scene.")
@click.option("--size", metavar="WIDTHxHEIGHT", help="Pixels [default: 1600x1000, wider for many bases].")
@click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
@debug_option
@grouped(outputs=_Outputs)
def view(
    source: str | None,
    preset: str | None,
    outputs: _Outputs,
    at: str | None,
    voxels: int | None,
) -> None:
    """Look at a scene, a preset or a dataset.

    Shows slices of the true basis volumes, surfaces of the materials, and source and panel, in a window that turns
    with the mouse, in a picture, or in a page. --geometry draws the orbit in plan.
    """
    if (source is None) == (preset is None):
        raise click.UsageError("name a scene file, a preset or a dataset: phantomgen view kedge")
    from phantomgen.display.viewer.load import load
    from phantomgen.display.viewer.options import point_of, size_of
    from phantomgen.display.viewer.output import check_outputs, show

    picture, page, orbit = (
        Path(name) if name else None for name in (outputs.screenshot, outputs.html, outputs.geometry)
    )
    if orbit is not None:
        from phantomgen.display.viewer.orbit import draw_orbit

        draw_orbit(source, preset, orbit, outputs.overwrite)
        click.echo(orbit)
        if picture is None and page is None:
            return
    check_outputs(picture, page, outputs.overwrite)
    pixels = size_of(outputs.size) if outputs.size else None
    content = load(source, preset, point_of(at) if at else None, voxels)
    if content.truth is None:
        click.echo(f"Note: {source} holds no truth, so only the scan is shown.", err=True)
    show(content, picture, page, pixels)
    for path in filter(None, (picture, page)):
        click.echo(path)
