"""``phantomgen make``: the scan of a scene; ``phantomgen warm-up``: the kernels of scans, compiled ahead."""

import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import (
    FiniteRange,
    Printing,
    SceneChoice,
    debug_option,
    grouped,
    json_option,
    print_stages,
    progress_options,
)
from phantomgen.cli.preset_option import preset_option


@dataclass(frozen=True)
class _Shortcuts:
    """Options for values of the scene."""

    views: int | None
    test_views: int | None
    voxels: int | None
    seed: int | None
    noise: bool | None


@dataclass(frozen=True)
class _Reuse:
    """What is stored for other scans of the same objects, and taken from one."""

    keep: tuple[str, ...]
    paths: str | None


@dataclass(frozen=True)
class _Output:
    """The dataset that is written."""

    out: str | None
    compression: str
    resume: bool
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  phantomgen make kedge --views 150 --seed 1\n"
    "  phantomgen make my.yaml --set objects.1.radius=12 -o thick.h5 --resume"
)
@click.argument("scene", metavar="SCENE|PRESET", required=False)
@preset_option
@click.option("-o", "--out", type=click.Path(dir_okay=False), help="Output [default: <name of the scene>.h5].")
@click.option("--views", type=click.IntRange(min=1), help="Number of training views.")
@click.option("--test-views", type=click.IntRange(min=0), help="Number of test views.")
@click.option("--voxels", type=click.IntRange(min=1), help="Voxels along the longest edge of the volume.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the noise, and of a scene's random values.")
@click.option("--tol", type=FiniteRange(), help="Worst error of log projections that is wanted [default: 1e-3].")
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
@progress_options
@json_option
@debug_option
@grouped(scene=SceneChoice, shortcuts=_Shortcuts, reuse=_Reuse, output=_Output, printing=Printing)
def make(
    scene: SceneChoice,
    output: _Output,
    shortcuts: _Shortcuts,
    tol: float | None,
    reuse: _Reuse,
    verify: bool,
    threads: int | None,
    printing: Printing,
) -> None:
    """Simulate the scan of a scene, which is a YAML file or a preset.

    Prints what the scan took, and how far its expected counts are from a finer computation.
    """
    if (scene.scene is None) == (scene.preset is None) and (reuse.paths is None or scene.scene is not None):
        raise click.UsageError("name either a scene file or a preset: phantomgen make kedge")
    options = {
        "geometry.views": shortcuts.views,
        "geometry.test_views": shortcuts.test_views,
        "volume.voxels": shortcuts.voxels,
        "seed": shortcuts.seed,
        "noise": None if shortcuts.noise is None else str(shortcuts.noise).lower(),
    }
    overrides = [*(f"{path}={value}" for path, value in options.items() if value is not None), *scene.settings]
    options = {
        "tolerance": tol,
        "overwrite": output.overwrite,
        "resume": output.resume,
        "compression": output.compression,
        "keep_expected": "expected" in reuse.keep,
        "keep_paths": "paths" in reuse.keep,
        "paths": reuse.paths,
        "verify": verify,
    }
    summary = _make(scene.scene, scene.preset, overrides, output.out, options, threads, printing.silent)
    for warning in summary.warnings:
        click.echo(f"Warning: {warning}", err=True)
    click.echo(json.dumps(summary.to_dict()) if printing.as_json else summary.text)


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

    `options` are those of `phantomgen.simulation.options.SimulationOptions`.
    """
    from phantomgen.simulation.warm_up import compiling_ahead

    start = time.perf_counter()
    shown = sys.stderr.isatty() and not quiet
    with compiling_ahead(lambda text: click.echo(text, err=True) if shown else None) as wait_for_kernels:
        from phantomgen.dataset.compression import check_compression
        from phantomgen.dataset.file import DATASET
        from phantomgen.dataset.writing.frame_journal import check_journal
        from phantomgen.dataset.writing.writer import check_dataset_name
        from phantomgen.runtime.outputs import check_output
        from phantomgen.scene.file.find_scene import find_scene
        from phantomgen.scene.file.scene_file import SceneFile
        from spectra.threads import set_threads

        if options["paths"] and not (scene or preset):
            from phantomgen.simulation.projection_cache.cache import cached_scene

            file = cached_scene(options["paths"], overrides)
        else:
            file = SceneFile.preset(preset, overrides) if preset else find_scene(scene or "", overrides)
        path = Path(f"{file.model.name}.h5" if out is None else out)
        check_dataset_name(path)
        check_output(path, options["overwrite"], kind=DATASET)
        check_journal(path, options["resume"], options["overwrite"])
        check_compression(options["compression"])
        set_threads(threads)
        from phantomgen.scene.scan import load_scene
        from phantomgen.simulation.planning.plan import check_tolerance
        from phantomgen.simulation.run import simulate

        if options["tolerance"] is not None:
            check_tolerance(options["tolerance"])
        scan = load_scene(file)
        wait_for_kernels()
        ready = time.perf_counter() - start
        summary = simulate(scan, path, progress=not quiet, on_stage=print_stages(shown), **options)
    return replace(summary, seconds={"scene": ready, **summary.seconds})


@click.command("warm-up", epilog="\b\nExamples:\n  phantomgen warm-up\n  recon warm-up")
@progress_options
@debug_option
def warm_up(quiet: bool) -> None:
    """Compile the kernels of scans ahead, which a machine does once.

    The first scan on a machine compiles them otherwise. Useful in the build of a container image, and before a lesson.
    `recon warm-up` compiles those of reconstructions as well.
    """
    from tqdm.auto import tqdm

    from phantomgen.warm_up import STEPS

    start = time.perf_counter()
    bar = tqdm(STEPS.items(), desc="compiling", unit="group", disable=True if quiet else None)
    for name, step in bar:
        bar.set_postfix_str(name)
        step()
    click.echo(f"The kernels of phantomgen are compiled: {time.perf_counter() - start:.1f} s.")
