"""The command ``phantomgen export``: the truth of a dataset in formats of other programs."""

import json
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option


@click.command(
    epilog="\b\nExamples:\n  phantomgen export kedge.h5 -o truth.vti\n"
    "  phantomgen export kedge.h5 --labels -o labels.nii.gz"
)
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "-o", "--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="File: .vti, .nii or .nii.gz."
)
@click.option("--labels", is_flag=True, help="What fills most of each voxel, in place of basis volumes.")
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
@json_option
@debug_option
def export(dataset: Path, out: Path, labels: bool, overwrite: bool, as_json: bool) -> None:
    """Write the true basis volumes of DATASET for ParaView, 3D Slicer and others.

    x, y and z are those of the scan, in mm; values are in 1/mm.
    """
    from phantomgen.dataset.truth import true_volumes
    from phantomgen.exporters.volumes import write_volumes, writer_of
    from phantomgen.runtime.outputs import check_output

    writer_of(out)
    check_output(out, overwrite)
    volumes = true_volumes(dataset, labels)
    write_volumes(out, volumes)
    found = {"file": str(out), "volumes": list(volumes.values), "shape": list(volumes.grid.shape)}
    shape = " x ".join(map(str, volumes.grid.shape))
    click.echo(json.dumps(found) if as_json else f"Wrote {out}: {', '.join(volumes.values)}, {shape} voxels")
