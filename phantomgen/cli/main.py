"""The command ``phantomgen``: parse, call, print.

Results go to stdout, progress and warnings to stderr. Exit codes: 0 done, 1 an error in one sentence, 2 wrong usage,
3 finished but a check failed, 130 interrupted.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import Commands, debug_option, json_option, version_option
from phantomgen.cli.export import export
from phantomgen.cli.report import report


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExamples:\n  phantomgen make kedge\n  phantomgen presets show kedge > my.yaml",
)
@version_option("phantomgen")
def main() -> None:
    """Make spectral-CT scans of phantoms whose truth is known.

    A scene (shapes, materials, source, detector, orbit) becomes one HDF5 file: photon counts per view, channel and
    pixel, all that a reconstructor may know, and the truth to judge it against.
    """


main.add_command(export)
main.add_command(report)


@main.command(
    epilog="\b\nExamples:\n  phantomgen make kedge --views 150 --seed 1\n"
    "  phantomgen make my.yaml --set objects.1.radius=12 -o thick.h5 --resume"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@click.option("--preset", metavar="NAME", help="A scene that comes with the program; see `phantomgen presets`.")
@click.option("-o", "--out", type=click.Path(dir_okay=False), help="Output [default: <name of the scene>.h5].")
@click.option("--views", type=click.IntRange(min=1), help="Number of training views.")
@click.option("--test-views", type=click.IntRange(min=0), help="Number of test views.")
@click.option("--voxels", type=click.IntRange(min=1), help="Voxels along each edge of the volume.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the noise, and of a scene's random values.")
@click.option("--tol", type=float, help="Worst error of log projections that is wanted [default: 1e-3].")
@click.option("--noise/--no-noise", default=None, help="Poisson counts, or their means.")
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@click.option(
    "--keep",
    type=click.Choice(["expected", "paths"]),
    multiple=True,
    help="Store as well: noise-free counts; projections, for --paths.",
)
@click.option(
    "--paths",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Dataset made with --keep paths: other spectra, doses, channels and seeds of its scene, without tracing.",
)
@click.option("--verify", is_flag=True, help="Check all edge pixels of three views against brute force (minutes).")
@click.option("--compression", default="gzip", metavar="gzip|bitshuffle|none", help="Of large arrays [default: gzip].")
@click.option("--resume", is_flag=True, help="Go on where an interrupted run stopped.")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def make(
    scene: str | None,
    preset: str | None,
    out: str | None,
    views: int | None,
    test_views: int | None,
    voxels: int | None,
    seed: int | None,
    tol: float | None,
    noise: bool | None,
    settings: tuple[str, ...],
    keep: tuple[str, ...],
    paths: str | None,
    verify: bool,
    compression: str,
    resume: bool,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Simulate the scan of a scene, which is a YAML file or a preset.

    Prints what the scan took, and how far its expected counts are from a finer computation.
    """
    if (scene is None) == (preset is None) and (paths is None or scene is not None):
        raise click.UsageError("name either a scene file or a preset: phantomgen make kedge")
    options = {
        "geometry.views": views,
        "geometry.test_views": test_views,
        "volume.voxels": voxels,
        "seed": seed,
        "noise": None if noise is None else str(noise).lower(),
    }
    overrides = [*(f"{path}={value}" for path, value in options.items() if value is not None), *settings]
    options = {
        "tolerance": tol,
        "overwrite": overwrite,
        "resume": resume,
        "compression": compression,
        "keep_expected": "expected" in keep,
        "keep_paths": "paths" in keep,
        "paths": paths,
        "verify": verify,
    }
    summary = _make(scene, preset, overrides, out, options, threads, quiet or as_json)
    for warning in summary.warnings:
        click.echo(f"Warning: {warning}", err=True)
    click.echo(json.dumps(summary.to_dict()) if as_json else summary.text)


def _make(
    scene: str | None,
    preset: str | None,
    overrides: list[str],
    out: str | None,
    options: dict[str, Any],
    threads: int | None,
    quiet: bool,
) -> Any:
    """Read the scene, then simulate; the output is checked before anything slow is imported.

    `options` are those of `phantomgen.simulation.run.simulate`.
    """
    from phantomgen.simulation.warm_up import compiling_ahead

    start = time.perf_counter()
    shown = sys.stderr.isatty() and not quiet
    with compiling_ahead(lambda text: click.echo(text, err=True) if shown else None) as wait_for_kernels:
        from phantomgen.dataset.compression import check_compression
        from phantomgen.dataset.writing.frame_journal import check_journal
        from phantomgen.dataset.writing.writer import check_dataset_name, check_output
        from phantomgen.scene.file.find_scene import find_scene
        from phantomgen.scene.file.scene_file import SceneFile
        from spectra.threads import set_threads

        if options["paths"] and not (scene or preset):
            from phantomgen.simulation.projection_cache.cache import kept_scene

            file = kept_scene(options["paths"], overrides)
        else:
            file = SceneFile.preset(preset, overrides) if preset else find_scene(scene or "", overrides)
        path = Path(out or f"{file.model.name}.h5")
        check_dataset_name(path)
        check_output(path, options["overwrite"])
        check_journal(path, options["resume"], options["overwrite"])
        check_compression(options["compression"])
        set_threads(threads)
        from phantomgen.scene.scan import load_scene
        from phantomgen.simulation.planning.make_plan import check_tolerance
        from phantomgen.simulation.run import simulate

        if options["tolerance"] is not None:
            check_tolerance(options["tolerance"])
        scan = load_scene(file)
        wait_for_kernels()
        ready = time.perf_counter() - start
        summary = simulate(scan, path, progress=not quiet, on_stage=_stages(shown), **options)
    return replace(summary, seconds={"scene": ready, **summary.seconds})


def _stages(shown: bool) -> Callable[[str], None]:
    """What says on stderr which stage has begun, where somebody can see it."""
    return lambda name: click.echo(f"{name} ...", err=True) if shown else None


@main.command(
    epilog="\b\nExamples:\n  phantomgen plan kedge --tol 1e-4\n"
    "  phantomgen plan my.yaml --set geometry.views=720 --json"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@click.option("--preset", metavar="NAME", help="A scene that comes with the program; see `phantomgen presets`.")
@click.option("--tol", type=float, default=1e-3, show_default=True, help="Worst error of log projections.")
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
    from phantomgen.simulation.planning.make_plan import check_tolerance
    from spectra.threads import set_threads

    check_tolerance(tol)
    file = SceneFile.preset(preset, settings) if preset else find_scene(scene or "", settings)
    set_threads(threads)
    from phantomgen.scene.scan import load_scene
    from phantomgen.simulation.planning.report import PlanReport

    report = PlanReport.of(load_scene(file), tol, _stages(sys.stderr.isatty() and not as_json))
    click.echo(json.dumps(report.to_dict()) if as_json else report.text)
    sys.exit(3 if report.plan.missed else 0)


@main.command(
    epilog="\b\nExamples:\n  phantomgen batch training.yaml -n 1000 --workers 2 -o training\n"
    "  phantomgen batch training.yaml --cluster tcp://10.0.0.1:8786 --shard 1/4"
)
@click.argument("manifest", type=click.Path(dir_okay=False))
@click.option("-n", "--count", type=click.IntRange(min=1), help="Number of items [default: that of the manifest].")
@click.option(
    "-o", "--out", type=click.Path(file_okay=False), help="Folder of the items [default: that of MANIFEST's name]."
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes of this machine [default: one per processor].")
@click.option("--cluster", metavar="ADDRESS", help="Dask scheduler whose workers are used in place of processes.")
@click.option("--shard", metavar="I/N", help="Make every N-th item only, beginning with the I-th.")
@click.option("--overwrite", is_flag=True, help="Make all items anew.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def batch(
    manifest: str,
    count: int | None,
    out: str | None,
    workers: int | None,
    cluster: str | None,
    shard: str | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Make many scans from MANIFEST, a YAML file that names a scene, what overrides it, and a seed.

    Item i is the scene of that seed + i. Each becomes a dataset and a line of manifest.jsonl; what is there already is
    left as it is, and what fails does not stop the rest. Exits with 3 when an item failed.
    """
    from phantomgen.batch.manifest import Batch
    from phantomgen.batch.records import Shard
    from phantomgen.batch.run import run_batch

    part = Shard.parse(shard) if shard else None
    summary = run_batch(
        Batch.read(manifest),
        out or Path(manifest).stem,
        count=count,
        workers=workers,
        executor=cluster,
        shard=part,
        overwrite=overwrite,
        progress=not quiet,
    )
    click.echo(json.dumps(summary.to_dict()) if as_json else summary.text)
    sys.exit(3 if summary.failed else 0)


@main.group(
    invoke_without_command=True,
    epilog="\b\nExamples:\n  phantomgen presets\n  phantomgen presets show kedge > my.yaml",
)
@click.pass_context
def presets(ctx: click.Context) -> None:
    """List the scenes that come with the program, or show one."""
    if ctx.invoked_subcommand is not None:
        return
    from phantomgen.scene.file.scene_file import preset_summaries

    for name, summary in preset_summaries().items():
        click.echo(f"{name:<18}{summary}")


@presets.command(
    "show",
    epilog="\b\nExamples:\n  phantomgen presets show kedge > my.yaml\n"
    "  phantomgen presets show random --seed 7 --resolved",
)
@click.argument("name")
@click.option("--resolved", is_flag=True, help="Print what is simulated: random values drawn, defaults filled in.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed that random values are drawn from.")
@click.option("--set", "settings", metavar="PATH=VALUE", multiple=True, help="Override any value of the scene.")
@debug_option
def presets_show(name: str, resolved: bool, seed: int | None, settings: tuple[str, ...]) -> None:
    """Print the YAML of preset NAME, to start a scene of your own; with --resolved also of a scene file."""
    from phantomgen.scene.file.find_scene import find_scene
    from phantomgen.scene.file.scene_file import SceneFile

    if not resolved and (seed is not None or settings):
        raise click.UsageError("--seed and --set need --resolved: the text of a preset is shown as it is")
    overrides = [*([] if seed is None else [f"seed={seed}"]), *settings]
    if resolved:
        click.echo(find_scene(name, overrides).resolved, nl=False)
        return
    click.echo(SceneFile.preset(name).text, nl=False)


@main.group("import", epilog="\b\nExamples:\n  phantomgen import forbild HeadPhantom.pha -o head.yaml")
def import_() -> None:
    """Turn phantoms of other programs into scenes."""


@import_.command(
    "forbild",
    epilog="\b\nExamples:\n  phantomgen import forbild HeadPhantom.pha -o head.yaml\n  phantomgen make head.yaml",
)
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("-o", "--out", required=True, type=click.Path(dir_okay=False), help="The scene to write.")
@click.option("--overwrite", is_flag=True, help="Replace a scene that exists.")
@debug_option
def import_forbild(file: str, out: str, overwrite: bool) -> None:
    """Write a scene from FILE, a phantom in the text format of the FORBILD group.

    Lengths become millimetres; a later object replaces what it overlaps. A scan is put around it, to be edited.
    """
    from phantomgen.dataset.writing.writer import check_output
    from phantomgen.importers.forbild import forbild_scene

    path = Path(out)
    check_output(path, overwrite)
    path.write_text(forbild_scene(file), encoding="utf-8")
    click.echo(f"{path}\nnext     phantomgen view {path}")


@main.command(
    epilog="\b\nExamples:\n  phantomgen materials liver --plot liver.png\n"
    "  phantomgen materials iodine_10 --scene contrast-vials"
)
@click.argument("name", required=False)
@click.option("--density", type=click.FloatRange(min=0, min_open=True), help="Density of a formula [g/cm^3].")
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


@main.command(
    epilog="\b\nExamples:\n  phantomgen spectrum kedge --plot kedge-spectrum.png\n"
    "  phantomgen spectrum my.yaml --behind '30 cm water + 1 cm bone'"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@click.option("--preset", metavar="NAME", help="A scene that comes with the program; see `phantomgen presets`.")
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
    from phantomgen.display.figures.picture import check_picture
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


@main.command(
    "optimize-thresholds",
    epilog="\b\nExamples:\n  phantomgen optimize-thresholds kedge --basis kedge_63.3 --plot thresholds.png\n"
    "  phantomgen optimize-thresholds my.yaml --basis kedge_I --channels 4 --behind '30 cm water'",
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@click.option("--preset", metavar="NAME", help="A scene that comes with the program; see `phantomgen presets`.")
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
    from phantomgen.display.figures.picture import check_picture
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


@main.command(epilog="\b\nExamples:\n  phantomgen info kedge.h5\n  phantomgen info kedge.h5 --json")
@click.argument("file", type=click.Path(dir_okay=False))
@json_option
@debug_option
def info(file: str, as_json: bool) -> None:
    """Say what a dataset holds."""
    from phantomgen.dataset.describe import describe, describe_text

    description = describe(Path(file))
    for warning in description.pop("warnings"):
        click.echo(f"Warning: {warning}", err=True)
    click.echo(json.dumps(description) if as_json else describe_text(description))


@main.command(
    epilog="\b\nExamples:\n  phantomgen view kedge.h5\n  phantomgen view kedge --screenshot kedge.png --html kedge.html"
)
@click.argument("source", metavar="SCENE|PRESET|DATASET", required=False)
@click.option("--preset", metavar="NAME", help="A scene that comes with the program; see `phantomgen presets`.")
@click.option("--screenshot", type=click.Path(dir_okay=False), help="Write a PNG; needs no display.")
@click.option("--html", type=click.Path(dir_okay=False), help="Write one page to turn in a browser; needs no display.")
@click.option("--geometry", type=click.Path(dir_okay=False), help="Draw the orbit in plan: PNG, PDF or SVG.")
@click.option("--at", metavar="X,Y,Z", help="Where the slices cut, in mm [default: the centre].")
@click.option("--voxels", type=click.IntRange(min=1), help="Voxels along each edge of the volume of a scene.")
@click.option("--size", metavar="WIDTHxHEIGHT", help="Pixels [default: 1600x1000, wider for many bases].")
@click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
@debug_option
def view(
    source: str | None,
    preset: str | None,
    screenshot: str | None,
    html: str | None,
    geometry: str | None,
    at: str | None,
    voxels: int | None,
    size: str | None,
    overwrite: bool,
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

    picture, page, orbit = (Path(name) if name else None for name in (screenshot, html, geometry))
    if orbit is not None:
        from phantomgen.display.viewer.orbit import draw_orbit

        draw_orbit(source, preset, orbit, overwrite)
        click.echo(orbit)
        if picture is None and page is None:
            return
    check_outputs(picture, page, overwrite)
    pixels = size_of(size) if size else None
    content = load(source, preset, point_of(at) if at else None, voxels)
    if content.truth is None:
        click.echo(f"Note: {source} holds no truth, so only the scan is shown.", err=True)
    show(content, picture, page, pixels)
    for path in filter(None, (picture, page)):
        click.echo(path)


@main.command(epilog="\b\nExamples:\n  phantomgen validate kedge.h5\n  phantomgen validate scan.h5 --air 0:16,0:256")
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@json_option
@debug_option
def validate(file: str, air: str | None, as_json: bool) -> None:
    """Check a dataset whole: shapes, units, values, splits.

    Exits with 3 when something is wrong.
    """
    from phantomgen.dataset.validate import validate as check

    problems = check(file, air)
    if as_json:
        click.echo(json.dumps({"file": file, "valid": not problems, "problems": problems}))
    else:
        click.echo("\n".join(problems) if problems else f"{file} is valid")
    sys.exit(3 if problems else 0)


@main.command(epilog="\b\nExamples:\n  phantomgen schema\n  phantomgen schema --scene > scene.schema.json")
@click.option("--scene", is_flag=True, help="Print the JSON Schema of scene files, for completion in editors.")
@debug_option
def schema(scene: bool) -> None:
    """Print the layout of a dataset, or the schema of scene files."""
    if scene:
        from phantomgen.scene.schema import json_schema

        click.echo(json.dumps(json_schema(), indent=1))
        return
    from phantomgen.dataset.layout import TABLE

    click.echo(TABLE, nl=False)


if __name__ == "__main__":
    main()
