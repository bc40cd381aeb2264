"""``phantomgen materials``, ``spectrum`` and ``optimize-thresholds``: energies without a scan."""

import json
from pathlib import Path

import click

from phantomgen.cli.common import FiniteRange, debug_option, json_option
from phantomgen.cli.preset_option import preset_option


@click.command(
    epilog="\b\nExamples:\n  phantomgen materials liver --plot liver.png\n"
    "  phantomgen materials iodine_10 --scene contrast-vials"
)
@click.argument("name", required=False)
@click.option("--density", type=FiniteRange(min=0, min_open=True), help="Density of a formula [g/cm^3].")
@click.option("--scene", metavar="FILE", help="Take NAME from the materials of a scene file or preset.")
@click.option("--plot", type=click.Path(dir_okay=False), help="Write mu(E), its fit and the error as a picture.")
@json_option
@debug_option
def materials(name: str | None, density: float | None, scene: str | None, plot: str | None, as_json: bool) -> None:
    """List the materials known by name, or describe NAME, which may be a formula.

    Shows density, elements, attenuation, and how well photoelectric, Compton and K-edge functions describe it.
    """
    from phantomgen.analysis.materials import MaterialFit, catalogue, catalogue_text, find_material

    if name is None:
        groups = catalogue()
        click.echo(json.dumps(groups) if as_json else catalogue_text(groups))
        return
    fit = MaterialFit.of(find_material(name, density, scene))
    if plot:
        from phantomgen.display.figures.material import write_figure

        write_figure(fit, plot)
    click.echo(json.dumps(fit.to_dict()) if as_json else fit.text)


@click.command(
    epilog="\b\nExamples:\n  phantomgen spectrum kedge --plot kedge-spectrum.png\n"
    "  phantomgen spectrum my.yaml --behind '30 cm water + 1 cm bone'"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@preset_option
@click.option("--behind", metavar="LAYERS", help="Object that noise is stated behind [default: 20 cm water].")
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@click.option("--plot", type=click.Path(dir_okay=False), help="Write source, channels and basis as a picture.")
@click.option("--export", type=click.Path(dir_okay=False), help="Write the source as a table that a scene can name.")
@json_option
@debug_option
def spectrum(
    scene: str | None,
    preset: str | None,
    behind: str | None,
    settings: tuple[str, ...],
    plot: str | None,
    export: str | None,
    as_json: bool,
) -> None:
    """Describe the energies of a scene, which is a YAML file or a preset.

    Shows beam quality, counts per channel, how well the channels tell the basis functions apart, and the least noise
    (Cramer-Rao) that any method can reach with one ray.
    """
    if (scene is None) == (preset is None):
        raise click.UsageError("name either a scene file or a preset: phantomgen spectrum kedge")
    from phantomgen.display.figures.style import check_picture
    from phantomgen.scene.file.find_scene import find_scene
    from phantomgen.scene.file.scene_file import SceneFile

    if plot:
        check_picture(Path(plot))
    file = SceneFile.preset(preset, settings) if preset else find_scene(scene or "", settings)
    from phantomgen.analysis.single_ray import BEHIND
    from phantomgen.analysis.spectrum import SpectrumReport
    from phantomgen.scene.scan import load_scene

    report = SpectrumReport.of(load_scene(file), BEHIND if behind is None else behind)
    if plot:
        from phantomgen.display.figures.scan_energies import write_figure

        write_figure(report.scan, plot)
    if export:
        from phantomgen.scene.input_files.spectrum_table import write_source

        write_source(report.scan.source, Path(export), report.scan.name)
    click.echo(json.dumps(report.to_dict()) if as_json else report.text)


@click.command(
    "optimize-thresholds",
    epilog="\b\nExamples:\n  phantomgen optimize-thresholds kedge --basis kedge_63.3 --plot thresholds.png\n"
    "  phantomgen optimize-thresholds my.yaml --basis kedge_I --channels 4 --behind '30 cm water'",
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@preset_option
@click.option("--basis", metavar="NAME", required=True, help="Basis function to be seen best, such as kedge_I.")
@click.option("--channels", type=click.IntRange(min=1), help="Number of channels [default: that of the scene].")
@click.option("--behind", metavar="LAYERS", help="Object that noise is stated behind [default: 20 cm water].")
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@click.option("--plot", type=click.Path(dir_okay=False), help="Write the noise against each threshold as a picture.")
@json_option
@debug_option
def optimize_thresholds(
    scene: str | None,
    preset: str | None,
    basis: str,
    channels: int | None,
    behind: str | None,
    settings: tuple[str, ...],
    plot: str | None,
    as_json: bool,
) -> None:
    """Find the thresholds that show one basis function of a scene with the least noise.

    Minimises the Cramer-Rao bound of its line integral for one ray behind an object and a trace of every K-edge
    function (0.1 each). The lowest threshold stays: below it is the noise of the electronics, which is not modelled.
    """
    if (scene is None) == (preset is None):
        raise click.UsageError(
            "name either a scene file or a preset: phantomgen optimize-thresholds kedge --basis kedge_63.3"
        )
    from phantomgen.display.figures.style import check_picture
    from phantomgen.scene.file.find_scene import find_scene
    from phantomgen.scene.file.scene_file import SceneFile

    if plot:
        check_picture(Path(plot))
    file = SceneFile.preset(preset, settings) if preset else find_scene(scene or "", settings)
    from phantomgen.analysis.single_ray import BEHIND
    from phantomgen.analysis.thresholds import choose_thresholds

    choice = choose_thresholds(file, basis, channels, BEHIND if behind is None else behind)
    if plot:
        from phantomgen.display.figures.thresholds import write_figure

        write_figure(choice, plot)
    click.echo(json.dumps(choice.to_dict()) if as_json else choice.text)
