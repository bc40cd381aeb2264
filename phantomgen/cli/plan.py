"""``phantomgen plan``: how a scan would be computed, and what that takes."""

import json
import sys

import click

from phantomgen.cli.common import FiniteRange, debug_option, json_option, print_stages
from phantomgen.cli.preset_option import preset_option


@click.command(
    epilog="\b\nExamples:\n  phantomgen plan kedge --tol 1e-4\n"
    "  phantomgen plan my.yaml --set geometry.views=720 --json"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@preset_option
@click.option("--tol", type=FiniteRange(), default=1e-3, show_default=True, help="Worst error of log projections.")
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@json_option
@debug_option
def plan(
    scene: str | None, preset: str | None, tol: float, settings: tuple[str, ...], threads: int | None, as_json: bool
) -> None:
    """Say how `make` would compute the scan of a scene file or a preset, and what that takes.

    For each part of the computation the cheapest setting is chosen that meets its share of the tolerance; errors are
    measured against much finer computations on a sample of views. Time, memory and file size follow from a few frames.
    Exits with 3 when the tolerance cannot be met.
    """
    if (scene is None) == (preset is None):
        raise click.UsageError("name either a scene file or a preset: phantomgen plan kedge")
    from phantomgen.scene.file.find_scene import find_scene
    from phantomgen.scene.file.scene_file import SceneFile
    from phantomgen.simulation.planning.plan import check_tolerance
    from spectra.threads import set_threads

    check_tolerance(tol)
    file = SceneFile.preset(preset, settings) if preset else find_scene(scene or "", settings)
    set_threads(threads)
    from phantomgen.scene.scan import load_scene
    from phantomgen.simulation.planning.report import PlanReport

    report = PlanReport.of(load_scene(file), tol, print_stages(sys.stderr.isatty() and not as_json))
    click.echo(json.dumps(report.to_dict()) if as_json else report.text)
    sys.exit(3 if report.plan.missed else 0)
