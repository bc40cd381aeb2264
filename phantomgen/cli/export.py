"""The command ``phantomgen export``: truth and scans in formats of other programs."""

import json
from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options, views_bar

# As in `phantomgen.exporters.scans.folder`, which takes time to import.
PROGRAMS = [
    "astra",
    "tomosipo",
    "tigre",
    "cil",
    "rtk",
    "leap",
    "r2",
    "naf",
    "nxtomo",
    "dxchange",
    "dicom-ct-pd",
    "ctsimu",
    "tiff",
]

flat_panel_option = click.option(
    "--flat-panel", is_flag=True, help="Resample line integrals of a curved panel to a flat one."
)


@dataclass(frozen=True)
class _Scan:
    """The scan for another program."""

    program: str | None
    what: str | None
    channels: tuple[str, ...]
    air: str | None
    flat_panel: bool


@dataclass(frozen=True)
class _Output:
    """What is written."""

    out: Path
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  phantomgen export kedge.h5 -o truth.vti\n"
    "  phantomgen export kedge.h5 --to rtk -o kedge-rtk"
)
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True,
    help="File of the truth: .vti, .nii or .nii.gz; with --to, a folder.",
)  # fmt: skip
@click.option("--labels", is_flag=True, help="What fills most of each voxel, in place of basis volumes.")
@click.option("--to", "program", type=click.Choice(PROGRAMS), help="Write the scan for this program.")
@click.option(
    "--what", type=click.Choice(["line-integrals", "counts"]),
    help="What to write of the scan [default: what the program takes].",
)  # fmt: skip
@click.option("--channel", "channels", multiple=True, metavar="NAME", help="Write this channel only; may be repeated.")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@flat_panel_option
@click.option("--overwrite", is_flag=True, help="Replace a file or a folder that exists.")
@progress_options
@json_option
@debug_option
@grouped(scan=_Scan, output=_Output, printing=Printing)
def export(
    dataset: Path,
    output: _Output,
    labels: bool,
    scan: _Scan,
    printing: Printing,
) -> None:
    """Write the truth or the scan of DATASET for other programs.

    Without --to: the true basis volumes, for ParaView, 3D Slicer and others; x, y and z are those of the scan, in mm;
    values are in 1/mm. With --to: training views and their geometry as a folder that the program reads, with a script
    load.py that loads it there. Line integrals of basis functions: `recon decompose`.
    """
    if scan.program is None and (scan.what or scan.channels or scan.air or scan.flat_panel):
        raise click.UsageError("--what, --channel, --air and --flat-panel need --to")
    if scan.program is not None and labels:
        raise click.UsageError("--labels is about the truth and does not go with --to")
    found = _export_truth(dataset, output.out, labels, output.overwrite) if scan.program is None else {}
    if scan.program is not None:
        found = _export_scan(dataset, output, scan, scan.program, printing.silent)
    text = found.pop("text")
    click.echo(json.dumps(found) if printing.as_json else text)


def _export_truth(dataset: Path, out: Path, labels: bool, overwrite: bool) -> dict:
    from phantomgen.dataset.truth import true_volumes
    from phantomgen.exporters.volumes import write_volumes, writer_of
    from phantomgen.runtime.outputs import check_output

    writer_of(out)
    check_output(out, overwrite)
    volumes = true_volumes(dataset, labels)
    write_volumes(out, volumes)
    shape = " x ".join(map(str, volumes.grid.shape))
    found = {"file": str(out), "volumes": list(volumes.values), "shape": list(volumes.grid.shape)}
    return {**found, "text": f"Wrote {out}: {', '.join(volumes.values)}, {shape} voxels"}


def _export_scan(dataset: Path, output: _Output, scan: _Scan, program: str, silent: bool) -> dict:
    from phantomgen.dataset.adapters.to_projections import to_projections
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.exporters.scans.folder import check_folder, kind_for, views_written, write_folder

    out, kind = output.out, kind_for(program, scan.what)
    check_folder(out, output.overwrite)
    with open_dataset(dataset, scan.air) as opened:
        projections = to_projections(opened, kind, scan.channels)
        with views_bar(silent, views_written(program, projections)) as on_view:
            watched = projections.watched(on_view)
            write_folder(out, program, watched.on_flat_panel() if scan.flat_panel else watched)
    names = projections.names
    found = {"folder": str(out), "to": program, "what": kind, "names": list(names)}
    return {**found, "text": f"Wrote {out} for {program}: {kind} of {', '.join(names)}; python {out / 'load.py'}"}
