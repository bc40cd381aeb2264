"""The commands ``recon export`` and ``recon decompose``: results and line integrals for other programs."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options, views_bar
from phantomgen.cli.export import PROGRAMS, flat_panel_option
from recon.cli.run_argument import RunFolder


@click.command(
    epilog="\b\nExamples:\n  recon export kedge-run -o kedge.vti\n  recon export kedge-run -o kedge.ply --overwrite"
)
@click.argument("run", type=RunFolder())
@click.option(
    "-o",
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    required=True,
    help="File: .vti, .nii or .nii.gz for volumes, .ply for Gaussians.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
@json_option
@debug_option
def export(run: Path, out: Path, overwrite: bool, as_json: bool) -> None:
    """Write the basis volumes of RUN, or its Gaussians, for ParaView, 3D Slicer, SuperSplat and others.

    x, y and z are those of the scan, in mm; coefficients are in 1/mm. Other grids: `recon volume`.
    """
    from phantomgen.exporters.volumes import FORMATS, suffix_of, writer_of
    from phantomgen.runtime.outputs import check_output
    from recon.output.ply import check_ply

    splats = suffix_of(out, {**FORMATS, ".ply": "ply"}) == ".ply"
    _ = check_ply() if splats else writer_of(out)
    check_output(out, overwrite)
    found = _export_gaussians(run, out) if splats else _export_volumes(run, out)
    click.echo(json.dumps({"file": str(out), **found}) if as_json else f"Wrote {out}: {_said(found)}")


@dataclass(frozen=True)
class _Output:
    """The folder that is written."""

    out: Path
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  recon decompose kedge.h5 --to rtk -o kedge-rtk\n"
    "  recon decompose scan.h5 --to astra --bases 2 -o scan-astra"
)
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="Folder to write.")
@click.option("--to", "program", type=click.Choice(PROGRAMS), required=True, help="Write them for this program.")
@click.option("--bases", type=click.IntRange(min=1), help="Number of basis functions, the first ones [default: all].")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@flat_panel_option
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(output=_Output, printing=Printing)
def decompose(
    dataset: Path,
    output: _Output,
    program: str,
    bases: int | None,
    air: str | None,
    flat_panel: bool,
    threads: int | None,
    printing: Printing,
) -> None:
    """Decompose the counts of DATASET into line integrals of its basis functions, and write them for other programs.

    Each pixel of each view is decomposed for itself, by maximum likelihood. The folders are those of
    `phantomgen export --to`, with basis functions in place of channels.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.exporters.scans.folder import check_folder, kind_for, views_written, write_folder
    from recon.data.decomposed_projections import decomposed_projections
    from spectra.threads import set_threads

    kind_for(program, "line-integrals")
    check_folder(output.out, output.overwrite)
    set_threads(threads)
    with open_dataset(dataset, air) as opened:
        projections = decomposed_projections(opened, bases)
        with views_bar(printing.silent, views_written(program, projections)) as on_view:
            watched = projections.watched(on_view)
            write_folder(output.out, program, watched.on_flat_panel() if flat_panel else watched)
    names = list(projections.names)
    found = {"folder": str(output.out), "to": program, "what": "line-integrals", "names": names}
    text = f"Wrote {output.out} for {program}: line integrals of {', '.join(names)}; python {output.out / 'load.py'}"
    click.echo(json.dumps(found) if printing.as_json else text)


def _export_volumes(run: Path, out: Path) -> dict[str, Any]:
    from phantomgen.exporters.volumes import basis_volumes, write_volumes
    from recon.runs.read_run import read_run

    stored = read_run(run)
    write_volumes(out, basis_volumes(stored.grid, stored.basis_names, stored.volumes))
    return {"volumes": list(stored.basis_names), "shape": list(stored.grid.shape)}


def _export_gaussians(run: Path, out: Path) -> dict[str, Any]:
    from recon.gaussians.residual.model import GaussiansWithResidual
    from recon.output.ply import write_ply
    from recon.runs.read_run import read_run
    from spectra.errors import InputError

    gaussians = read_run(run).gaussians
    if gaussians is None:
        raise InputError(f"{run} is a run in voxels without Gaussians: export its volumes as .vti, .nii or .nii.gz")
    plain = gaussians.plain()
    write_ply(out, plain)
    found = {"gaussians": len(plain), "bases": list(plain.basis_names)}
    without = {"planes": gaussians.SIGNED, "residual": isinstance(gaussians, GaussiansWithResidual)}
    return found | {name: "left out" for name, there in without.items() if there}


def _said(found: dict[str, Any]) -> str:
    if "gaussians" in found:
        planes = "; the format has no planes that divide Gaussians: each side is one, and the edges are blurred"
        residual = "; the residual in voxels is left out"
        said = f"{found['gaussians']} Gaussians with {', '.join(found['bases'])}"
        return said + (planes if "planes" in found else "") + (residual if "residual" in found else "")
    return f"{', '.join(found['volumes'])}, {' x '.join(map(str, found['shape']))} voxels"
