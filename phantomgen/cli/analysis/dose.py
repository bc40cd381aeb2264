"""``phantomgen dose``: air kerma, CTDI and a dose map of a scan."""

import json
from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import Printing, SceneChoice, debug_option, grouped, json_option, progress_options
from phantomgen.cli.preset_option import preset_option


@dataclass(frozen=True)
class _Outputs:
    """What is written."""

    out: Path | None
    plot: Path | None
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  phantomgen dose clinical-helix --plot dose.png\n"
    "  phantomgen dose my.yaml -o dose.nii.gz --photons 20000000 --voxels 128"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@preset_option
@click.option(
    "-o", "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write the map [mGy] as .vti, .nii or .nii.gz."
)
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Write middle slices as a picture.")
@click.option(
    "--photons", type=click.IntRange(min=1000), default=4_000_000, show_default=True, help="Photons to follow."
)
@click.option(
    "--voxels",
    type=click.IntRange(min=1, max=256),
    default=64,
    show_default=True,
    help="Voxels of the map along the longest edge of the volume.",
)
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the photons.")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(scene=SceneChoice, outputs=_Outputs, printing=Printing)
def dose(
    scene: SceneChoice,
    outputs: _Outputs,
    photons: int,
    voxels: int,
    seed: int,
    threads: int | None,
    printing: Printing,
) -> None:
    """Compute the dose of the scan of a scene file or a preset by Monte Carlo.

    Prints air kerma at the isocentre, CTDIvol in the cylinders of 16 and 32 cm of PMMA, and the mean dose of each
    material. Photons are followed through all orders of scattering; electrons stay where they are, and air, table and
    collimators beyond the volume of the scene do not scatter. The volume must hold the objects whole: what lies beyond
    it takes and scatters nothing.
    """
    if (scene.scene is None) == (scene.preset is None):
        raise click.UsageError("name either a scene file or a preset: phantomgen dose clinical-helix")
    from phantomgen.display.figures.style import check_picture
    from phantomgen.exporters.volumes import writer_of
    from phantomgen.runtime.outputs import check_output
    from phantomgen.scene.file.find_scene import find_scene
    from phantomgen.scene.file.scene_file import SceneFile
    from spectra.threads import set_threads

    if outputs.plot is not None:
        check_picture(outputs.plot)
        check_output(outputs.plot, outputs.overwrite, "--plot")
    if outputs.out is not None:
        writer_of(outputs.out)
        check_output(outputs.out, outputs.overwrite)
    file = (
        SceneFile.preset(scene.preset, scene.settings)
        if scene.preset
        else find_scene(scene.scene or "", scene.settings)
    )
    set_threads(threads)
    from phantomgen.dose.report import DoseReport
    from phantomgen.scene.scan import load_scene

    map_needed = outputs.out is not None or outputs.plot is not None
    report = DoseReport.of(load_scene(file), photons, voxels, seed, map_needed, progress=not printing.silent)
    if report.map is not None and outputs.out is not None:
        from phantomgen.exporters.volumes import Volumes, write_volumes

        volumes = {"dose": 1e3 * report.map.dose, "standard_error": 1e3 * report.map.error}
        write_volumes(outputs.out, Volumes(report.map.grid, volumes, f"dose of {report.name} [mGy]"))
    if report.map is not None and outputs.plot is not None:
        from phantomgen.display.figures.dose import write_figure

        write_figure(report.map, report.name, outputs.plot)
    click.echo(json.dumps(report.to_dict()) if printing.as_json else report.text)
