"""``recon fit``: reconstruct a dataset."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phantomgen.cli.common import FiniteRange, Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import (
    ProgressBar,
    exit_where_failed,
    finite_number,
    gaussians_text,
    memory_text,
    parse_priors,
    refuse_options,
    seconds_text,
)
from recon.cli.run_argument import check_run_name
from recon.runs.methods import METHODS, ON_CURVE

if TYPE_CHECKING:
    from phantomgen.dataset.reader import Dataset
    from recon.gaussians.recipe import Recipe
    from recon.phases.run import Division
    from recon.published_methods.paper.recipe import PaperRecipe
    from recon.runs.interfaces import RunMethod


@dataclass(frozen=True)
class _Data:
    """What the counts are corrected by, and whose spectrum is believed."""

    air: str | None
    spectrum: Path | None
    refine: str | None
    prior: dict[str, float]
    scatter: str | None


@dataclass(frozen=True)
class _RecipeOptions:
    """What steers a fit."""

    recipe: str
    kernel: str
    detail: float | None
    gaussians: int | None
    residual: bool
    sweeps: float | None
    steps: int | None
    without: tuple[str, ...]
    held_out: int
    seed: int


@dataclass(frozen=True)
class _Approach:
    """Basis functions, and the method of reconstruction."""

    bases: str
    edge: str | None
    method: str | None
    pipeline: str
    phases: str | None


@dataclass(frozen=True)
class _Resources:
    """Memory, device and threads."""

    memory: float | None
    device: str
    dry_run: bool
    threads: int | None


@dataclass(frozen=True)
class _Output:
    """The run folder, and when a run counts as failed."""

    out: str | None
    figures: bool
    strict: bool
    resume: bool
    overwrite: bool


def _chosen(recipe: _RecipeOptions, special: dict[str, Any]) -> "Recipe | PaperRecipe":
    """Return the recipe that options ask for; refuse those in `special` beside the recipe of the paper."""
    from recon.published_methods.paper.recipe import PAPER_STEPS, PaperRecipe
    from recon.runs.run_gaussians import chosen_recipe

    if recipe.recipe == "paper":
        refuse_options("--recipe paper, whose length is --steps", special | {"sweeps": recipe.sweeps})
        return PaperRecipe(steps=recipe.steps or PAPER_STEPS, without=recipe.without, seed=recipe.seed)
    refuse_options(
        f"--recipe {recipe.recipe}, whose length is --sweeps", {"steps": recipe.steps, "without": recipe.without}
    )
    kernel = "interface" if recipe.kernel == "auto" else recipe.kernel
    refuse_options("--gaussians", {"detail": recipe.gaussians and recipe.detail})
    return chosen_recipe(
        recipe.recipe,
        recipe.sweeps,
        recipe.seed,
        recipe.held_out,
        kernel,
        recipe.detail or 1.0,
        recipe.gaussians or 0,
        recipe.residual,
    )


def _check_curve(method: str, recipe: _RecipeOptions, approach: _Approach) -> None:
    """Refuse a method and options that take no curve of materials."""
    from spectra.errors import InputError

    if method not in ("gaussian", *ON_CURVE):
        known = ", ".join(["gaussian", *ON_CURVE])
        raise InputError(f"--method {method} takes no curve of materials: take {known}, or other --bases")
    plain = "gaussian" if recipe.kernel == "gaussian" else None
    refuse_options("--bases curve", {"phases": approach.phases, "residual": recipe.residual, "kernel": plain})


def _divided(dataset: "Dataset", phases: str | None) -> "Division | None":
    """The division of the views into phases; None where no phases are fitted."""
    if phases is None:
        return None
    from recon.phases.run import divide

    return divide(dataset, phases)


def _fit_phases(
    dataset: "Dataset", folder: Path, division: "Division", recipe: "Recipe", figures: bool, bar: ProgressBar
) -> dict[str, Any]:
    """Fit the phases of a scan, and return their scores."""
    from recon.phases.run import fit_phases_of_run
    from recon.phases.settings import PhaseSettings

    settings = PhaseSettings()
    scores = fit_phases_of_run(dataset, folder, division, recipe, settings, figures, bar.phase_step, bar.stage)
    bar.stage("fit")
    return scores


@click.command(epilog="\b\nExamples:\n  recon fit kedge.h5\n  recon fit scan.h5 --edge auto --air 0:16,0:256")
@click.argument("dataset", type=click.Path(dir_okay=False))
@click.option("-o", "--out", type=click.Path(), help="Run folder to write [default: <dataset>-run].")
@click.option(
    "--bases",
    default="auto",
    show_default=True,
    metavar="auto|NUMBER|NAME[,NAME]|curve[:MATERIAL,...]",
    help="Basis functions to fit: those that the counts warrant, the first ones of the file, or those named; or, for "
    "one channel, a curve of materials [default: adipose, water, cortical bone, Ti, Fe].",
)
@click.option(
    "--edge",
    metavar="auto|keV[,keV]",
    help="Search for K edges at all energies, these included [default: take those of the file].",
)
@click.option(
    "--sweeps",
    type=FiniteRange(min=0, min_open=True),
    callback=finite_number,
    help="Number of times that every training view is used.",
)
@click.option(
    "--recipe",
    type=click.Choice(["fast", "best", "paper"]),
    default="fast",
    show_default=True,
    help="This project's fit, short or long, or the method of SpectralCTGaussians.",
)
@click.option(
    "--kernel",
    type=click.Choice(["auto", "interface", "gaussian"]),
    default="auto",
    show_default=True,
    help="Gaussians that planes divide at interfaces, or plain ones; auto: planes.",
)
@click.option(
    "--detail",
    type=FiniteRange(min=0.25, max=4),
    callback=finite_number,
    help="Factor by which Gaussians are closer to each other; 2 gives three to eight times as many [default: 1].",
)
@click.option(
    "--gaussians",
    type=click.IntRange(min=1),
    metavar="NUMBER",
    help="Number of Gaussians, about [default: as many as the surfaces need].",
)
@click.option(
    "--residual",
    is_flag=True,
    help="Keep what Gaussians cannot follow in voxels, if rays that took no part confirm it.",
)
@click.option("--steps", type=click.IntRange(min=1), help="Steps of --recipe paper; schedules scale [default: 30000].")
@click.option("--without", metavar="NAME", multiple=True, help="Leave out a component of --recipe paper; repeatable.")
@click.option(
    "--method",
    type=click.Choice(["gaussian", *METHODS]),
    help="Gaussians, or a classical or learned method for comparison; `--sweeps` are then its iterations "
    "[default: gaussian].",
)
@click.option(
    "--pipeline",
    type=click.Choice(["two-step", "image"]),
    default="two-step",
    show_default=True,
    help="Of voxel methods: decompose rays before the reconstruction, or voxels after it.",
)
@click.option(
    "--phases",
    metavar="auto|NUMBER[:CYCLE]",
    help="Fit phases of a scan whose object moves or changes as well: those that the file states, so many equal parts "
    "of the time, or parts of a cycle, such as 8:breath.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all that is random.")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option(
    "--spectrum",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Channel sensitivities of `recon calibrate`, in place of those of the dataset.",
)
@click.option(
    "--refine",
    type=click.Choice(["spectrum", "spectrum+air"]),
    help="Correct small errors of voltage, filter and thresholds by counts; +air: also by ratios of open-beam counts.",
)
@click.option(
    "--prior",
    metavar="NAME=NUMBER",
    multiple=True,
    callback=parse_priors,
    help="Standard deviation of these errors [default: voltage=2 (kV), filter=0.25 (mm Al), thresholds=1 (keV)]; "
    "repeatable.",
)
@click.option(
    "--scatter",
    metavar="MODEL",
    help="Subtract scatter: compton (of the object, computed in turns with large voxels), compton:FACTOR, "
    "compton:fit (one factor), compton:fit-channels, or kernel:RATIO,WIDTH (mm) of the counts, with fit or "
    "fit-channels in place of the ratio.",
)
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw figures.")
@click.option(
    "--held-out", type=click.IntRange(min=0), default=0, help="Number of training views that only tell when to stop."
)
@click.option("--memory", type=FiniteRange(min=0, min_open=True), metavar="GIB", help="Largest memory to take.")
@click.option(
    "--device",
    type=click.Choice(["cpu", "cuda"]),
    default="cpu",
    show_default=True,
    help="Where Gaussians and the voxels of their start are computed.",
)
@click.option("--dry-run", is_flag=True, help="Estimate Gaussians, time and memory; write nothing.")
@click.option("--strict", is_flag=True, help="Exit code 3 where a check of the verdict failed.")
@click.option("--resume", is_flag=True, help="Go on with a run that was interrupted, if there is one.")
@click.option("--overwrite", is_flag=True, help="Replace a run folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(data=_Data, recipe=_RecipeOptions, approach=_Approach, resources=_Resources, output=_Output, printing=Printing)
def fit(
    dataset: str,
    output: _Output,
    approach: _Approach,
    recipe: _RecipeOptions,
    data: _Data,
    resources: _Resources,
    printing: Printing,
) -> None:
    """Fit Gaussians to DATASET, or reconstruct it by another method, and score the result.

    Writes a run folder: model.safetensors, volumes.h5, metrics.json, log.jsonl and figures. `--bases auto` uses
    those basis functions of the dataset that its counts warrant; the truth is read only after the fit, for the score.
    Ctrl-C ends the fit after the current step and keeps the model; --resume continues, also after a crash.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.calibration.refine import SPECTRUM, ChosenSpectrum
    from recon.data.devices import device_named
    from recon.evaluation import verdict
    from recon.gaussians.processes import joined
    from recon.kedge.basis_names import OnCurve, parse_bases, with_named
    from recon.kedge.report import parse_edges
    from recon.published_methods.paper.recipe import PaperRecipe
    from recon.runs.expected_cost import expected_cost
    from recon.runs.methods import method_named
    from recon.runs.run import run
    from recon.runs.run_folder import VOLUMES
    from recon.runs.run_gaussians import GaussianRun, on_curve
    from recon.runs.run_views import ViewRun
    from recon.runs.run_voxels import VoxelRun
    from recon.runs.write_run import RunFolder, score_table
    from recon.scatter.chosen_scatter import SCATTER, ChosenScatter, parse_scatter
    from recon.voxel.method import ViewMethod
    from spectra.threads import set_threads

    refuse_options("a spectrum that is not refined: add --refine", {"prior": not data.refine and bool(data.prior)})
    if output.out is not None:
        check_run_name(Path(output.out))
    source, edges = Path(dataset), parse_edges(approach.edge)
    asked, scattered = parse_bases(approach.bases), parse_scatter(data.scatter)
    method = approach.method or "gaussian"
    if isinstance(asked, OnCurve):
        _check_curve(method, recipe, approach)
    special = {
        "resume": output.resume,
        "dry-run": resources.dry_run,
        "memory": resources.memory,
        "held-out": recipe.held_out,
        "edge": approach.edge,
        "phases": approach.phases,
    }
    special |= {
        "kernel": None if recipe.kernel == "auto" else recipe.kernel,
        "detail": recipe.detail,
        "gaussians": recipe.gaussians,
        "residual": recipe.residual,
    }
    refuse_options("--phases", {"residual": approach.phases is not None and recipe.residual})
    special |= {"device": None if resources.device == "cpu" else device_named(resources.device).type}
    if method != "gaussian":
        refuse_options(
            f"--method {method}",
            special | {"steps": recipe.steps, "without": recipe.without, "recipe": recipe.recipe != "fast"},
        )
    how = _chosen(recipe, special)
    set_threads(resources.threads)
    if resources.dry_run and not isinstance(how, PaperRecipe):
        with open_dataset(source, data.air) as stored:
            named, count = with_named(ChosenSpectrum.of(stored, data.spectrum).dataset, asked)
            costed = on_curve(how, asked, named)
            found = expected_cost(named, costed, count, resources.memory, resources.device)
        click.echo(json.dumps(found.to_dict()) if printing.as_json else str(found))
        return
    with joined() as processes, open_dataset(source, data.air) as stored:
        division = _divided(stored, approach.phases)
        bar = ProgressBar(printing.silent or not processes.first)
        energies = ChosenSpectrum.of(stored, data.spectrum, data.refine, data.prior)
        energies.note(bar.note)
        corrected = ChosenScatter.of(energies.dataset, scattered, asked, bar.stage, bar.iterated)
        corrected.note(bar.note)
        opened = corrected.dataset
        way: RunMethod = GaussianRun(how, asked, edges, resources.memory, processes, resources.device)
        if not processes.first:
            if method == "gaussian":
                run(opened, None, way, output.figures, bar)
            return
        folder = RunFolder(
            Path(f"{source.stem}-run" if output.out is None else output.out), output.overwrite, output.resume
        )
        if method != "gaussian":
            chosen = method_named(method, None if recipe.sweeps is None else max(round(recipe.sweeps), 1), recipe.seed)
            way = (ViewRun if isinstance(chosen, ViewMethod) else VoxelRun)(chosen, approach.pipeline, asked)  # type: ignore[arg-type]
        with folder as part:
            energies.write(part / SPECTRUM)
            corrected.write(part / SCATTER)
            metrics = run(opened, part, way, output.figures, bar)
            if division is not None and not isinstance(how, PaperRecipe):
                metrics |= {"phases": _fit_phases(opened, part, division, how, output.figures, bar)}
    if printing.as_json:
        click.echo(to_json({"run": str(folder.path), **metrics}))
        exit_where_failed(metrics, output.strict)
        return
    click.echo("\n".join([score_table(metrics), "", *verdict.lines(metrics)]))
    if division is not None:
        from recon.phases.run import phase_table

        click.echo("\n" + phase_table(metrics["phases"]))
    if isinstance(how, PaperRecipe):
        click.echo(how.description)
    has_volumes = (folder.path / VOLUMES).is_file()
    in_what = "in voxels" if has_volumes else "without a volume"
    what = gaussians_text(metrics) if method == "gaussian" else f"{method} {in_what}"
    click.echo(f"{what}, {seconds_text(metrics)}{memory_text(metrics)}")
    for name in sorted(p.name for p in (folder.path / "figures").iterdir() if p.suffix in {".png", ".gif"}):
        click.echo(str(folder.path / "figures" / name))
    ways = f"recon view {folder.path}, or recon report {folder.path}" if has_volumes else "look at the figures"
    click.echo(f"Wrote {folder.path}; next: {ways}")
    exit_where_failed(metrics, output.strict)
