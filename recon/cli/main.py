"""The command ``recon``: parse, call, print."""

import json
import traceback
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phantomgen.cli.common import Commands, debug_option, json_option, version_option
from recon.cli.compare import compare
from recon.cli.export import export
from recon.cli.report import report
from recon.cli.run_argument import check_run_name
from recon.cli.segment import segment
from recon.cli.view import view
from recon.cli.volume_and_render import render, volume
from recon.runs.methods import METHODS

if TYPE_CHECKING:
    from recon.gaussians.optimize import Progress
    from recon.voxel.method import Iteration


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExamples:\n  recon fit kedge.h5\n  recon fit kedge.h5 -o run --bases 2",
)
@version_option("recon")
def main() -> None:
    """Reconstruct basis volumes from spectral-CT scans, and say how good they are."""


main.add_command(volume)
main.add_command(render)
main.add_command(export)
main.add_command(view)
main.add_command(segment)
main.add_command(compare)
main.add_command(report)


def _finite(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    if value is not None and not isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number.")
    return value


@main.command(epilog="\b\nExamples:\n  recon fit kedge.h5\n  recon fit scan.h5 --edge auto --air 0:16,0:256")
@click.argument("dataset", type=click.Path(dir_okay=False))
@click.option("-o", "--out", type=click.Path(), help="Run folder to write [default: <dataset>-run].")
@click.option(
    "--bases",
    default="auto",
    show_default=True,
    metavar="auto|NUMBER|NAME[,NAME]",
    help="Basis functions to fit: those that the counts warrant, the first ones of the file, or those named.",
)
@click.option(
    "--edge", metavar="auto|keV[,keV]", help="Look for K edges, starting anywhere [default: believe the file]."
)
@click.option(
    "--sweeps",
    type=click.FloatRange(min=0, min_open=True),
    callback=_finite,
    help="Times every training view is used.",
)
@click.option(
    "--recipe",
    type=click.Choice(["fast", "best", "paper"]),
    default="fast",
    show_default=True,
    help="This project's fit, short or long, or the method of SpectralCTGaussians.",
)
@click.option("--steps", type=click.IntRange(min=1), help="Steps of --recipe paper; schedules scale [default: 30000].")
@click.option("--without", metavar="NAME", multiple=True, help="Leave out a component of --recipe paper; repeatable.")
@click.option(
    "--method",
    type=click.Choice(["gaussian", *METHODS]),
    default="gaussian",
    show_default=True,
    help="Gaussians, or an opponent, classical or learned; `--sweeps` are then its iterations.",
)
@click.option(
    "--pipeline",
    type=click.Choice(["two-step", "image"]),
    default="two-step",
    show_default=True,
    help="Of classical methods: bases from counts ray by ray before, or linearly voxel by voxel after.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all that is random.")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw figures.")
@click.option("--held-out", type=click.IntRange(min=0), default=0, help="Training views that only say when to stop.")
@click.option("--memory", type=click.FloatRange(min=0, min_open=True), metavar="GIB", help="Largest memory to take.")
@click.option(
    "--device",
    type=click.Choice(["cpu", "cuda"]),
    default="cpu",
    show_default=True,
    help="Where Gaussians are computed.",
)
@click.option("--dry-run", is_flag=True, help="Say what it takes: Gaussians, time, memory; write nothing.")
@click.option("--strict", is_flag=True, help="Exit code 3 where a check of the verdict failed.")
@click.option("--resume", is_flag=True, help="Go on with a run that was interrupted, if there is one.")
@click.option("--overwrite", is_flag=True, help="Replace a run folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def fit(
    dataset: str,
    out: str | None,
    bases: str,
    edge: str | None,
    sweeps: float | None,
    recipe: str,
    steps: int | None,
    without: tuple[str, ...],
    method: str,
    pipeline: str,
    seed: int,
    air: str | None,
    figures: bool,
    held_out: int,
    memory: float | None,
    device: str,
    dry_run: bool,
    strict: bool,
    resume: bool,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Fit Gaussians to DATASET, or reconstruct it classically, and score the result.

    Writes a run folder: model.safetensors, volumes.h5, metrics.json, log.jsonl and figures. `--bases auto` uses
    those basis functions of the dataset that its counts warrant; the truth is read only after the fit, for the score.
    Ctrl-C stops after the step and leaves the model; --resume goes on, also after a crash.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.data.devices import device_named
    from recon.evaluation import verdict
    from recon.gaussians.processes import joined
    from recon.kedge.basis_names import parse_bases, with_named
    from recon.kedge.report import parse_edges
    from recon.published_methods.paper.recipe import PAPER_STEPS, PaperRecipe
    from recon.runs.expected_cost import forecast
    from recon.runs.methods import method_named
    from recon.runs.run_gaussians import chosen_recipe, run
    from recon.runs.run_voxels import run_classical
    from recon.runs.write_run import RunFolder, score_table
    from spectra.threads import set_threads

    if out:
        check_run_name(Path(out))
    special = {"resume": resume, "dry-run": dry_run, "memory": memory, "held-out": held_out, "edge": edge}
    special |= {"device": None if device == "cpu" else device_named(device).type}
    if method != "gaussian":
        _refuse(f"--method {method}", special | {"steps": steps, "without": without, "recipe": recipe != "fast"})
    if recipe == "paper":
        _refuse("--recipe paper, whose length is --steps", special | {"sweeps": sweeps})
        how = PaperRecipe(steps=steps or PAPER_STEPS, without=without, seed=seed)
    else:
        _refuse(f"--recipe {recipe}, whose length is --sweeps", {"steps": steps, "without": without})
        how = chosen_recipe(recipe, sweeps, seed, held_out)
    source, edges, asked = Path(dataset), parse_edges(edge), parse_bases(bases)
    set_threads(threads)
    if dry_run and not isinstance(how, PaperRecipe):
        with open_dataset(source, air) as opened:
            named, count = with_named(opened, asked)
            found = forecast(named, how, count, memory, device)
        click.echo(json.dumps(found.to_dict()) if as_json else str(found))
        return
    with joined() as processes, open_dataset(source, air) as opened:
        bar = _Bar(quiet or as_json or not processes.first)
        options = (asked, how, figures, bar, edges, memory, processes, device)
        if not processes.first:
            run(opened, None, *options)
            return
        folder = RunFolder(Path(out) if out else Path(f"{source.stem}-run"), overwrite, resume)
        if method != "gaussian":
            chosen = method_named(method, None if sweeps is None else max(round(sweeps), 1), seed)
            with folder as part:
                metrics = run_classical(opened, part, chosen, pipeline, asked, figures, bar)
        else:
            with folder as part:
                metrics = run(opened, part, *options)
    if as_json:
        click.echo(to_json({"run": str(folder.path), **metrics}))
        _end(metrics, strict)
        return
    click.echo("\n".join([score_table(metrics), "", *verdict.lines(metrics)]))
    if isinstance(how, PaperRecipe):
        click.echo(how.says)
    result = next(name for name in ("volumes.h5", "views.h5") if (folder.path / name).is_file())
    in_what = "in voxels" if result == "volumes.h5" else "without a volume"
    what = f"{metrics['gaussians']} Gaussians" if method == "gaussian" else f"{method} {in_what}"
    click.echo(f"{what}, {_seconds(metrics)}{_memory(metrics)}")
    for name in sorted(path.name for path in (folder.path / "figures").glob("*.png")):
        click.echo(str(folder.path / "figures" / name))
    ways = "look at the figures" if result == "views.h5" else f"recon view {folder.path}, or recon report {folder.path}"
    click.echo(f"Wrote {folder.path}; next: {ways}")
    _end(metrics, strict)


@main.command(epilog="\b\nExamples:\n  recon edge kedge.h5\n  recon edge scan.h5 --edge 33,50 -o found")
@click.argument("dataset", type=click.Path(dir_okay=False))
@click.option("-o", "--out", type=click.Path(), help="Files to write, without suffix [default: <dataset>-edge].")
@click.option("--edge", metavar="auto|keV[,keV]", default="auto", show_default=True, help="Where to start.")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the profile.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@json_option
@debug_option
def edge(
    dataset: str,
    out: str | None,
    edge: str,
    air: str | None,
    figures: bool,
    overwrite: bool,
    threads: int | None,
    as_json: bool,
) -> None:
    """Find the energies of K edges in DATASET.

    Tries edges at all energies on rays that two bases do not explain, whatever the dataset says about edges, and writes
    the profile likelihood as JSON and as a figure.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.kedge.choose_basis import find_edges
    from recon.kedge.report import EdgeFiles, parse_edges
    from spectra.threads import set_threads

    source = Path(dataset)
    files = EdgeFiles(Path(out or f"{source.stem}-edge"), overwrite)
    set_threads(threads)
    with open_dataset(source, air) as opened:
        choice = find_edges(opened, parse_edges(edge) or ())
        record = files.write(choice, opened, figures)
    click.echo(to_json(record) if as_json else "\n".join([*choice.sentences, *map(str, files.written)]))


def _end(metrics: dict[str, Any], strict: bool) -> None:
    """Exit code 1 where scores are missing that the run should have, 3 where a strict user wants no check to fail.

    A missing figure is no failure.
    """
    from recon.evaluation import verdict

    if any(not what.startswith("drawing") for what in metrics.get("failed", ())):
        raise click.exceptions.Exit(1)
    if strict and verdict.failed(metrics):
        raise click.exceptions.Exit(3)


def _refuse(beside: str, options: dict[str, Any]) -> None:
    """Refuse options that mean nothing beside another one."""
    for name, value in options.items():
        if value is not None and value is not False and value not in (0, ()):
            raise click.UsageError(f"--{name} cannot be used with {beside}.")


def _seconds(metrics: dict[str, Any]) -> str:
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in metrics["seconds"].items())
    return f"{sum(metrics['seconds'].values()):.0f} s ({parts})"


def _memory(metrics: dict[str, Any]) -> str:
    peak = metrics["peak_memory_mib"]
    return "" if peak is None else f", peak memory {peak:.0f} MiB"


def _each(values: Any) -> str:
    return "/".join(f"{value:.1f}" for value in values)


class _Bar:
    """Progress on stderr: a line per stage, a bar for the fit."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.bar: Any = None

    def stage(self, name: str) -> None:
        """A stage begins."""
        if self.bar is not None:
            self.bar.close()
            self.bar = None
        if not self.quiet and name != "fit":
            click.echo(f"{name} ...", err=True)

    def say(self, sentence: str) -> None:
        """Something was decided."""
        if not self.quiet:
            click.echo(sentence, err=True)

    def warn(self, sentence: str, error: Exception) -> None:
        """A score or a figure failed."""
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().meta.get("debug"):
            click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
        click.echo(f"Warning: {sentence}.", err=True)

    def step(self, progress: "Progress") -> None:
        """A step of the fit is done."""
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=progress.steps, desc="fit", unit="step", disable=True if self.quiet else None)
        if progress.step > self.bar.n + 1:
            self.bar.initial = self.bar.n = progress.step - 1  # resumed
        self.bar.update()
        self.bar.set_postfix(deviance=f"{progress.deviance:.3f}", chi_square=_each(progress.chi_square))

    def iterated(self, iteration: "Iteration") -> None:
        """An iteration of a classical method is done."""
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=iteration.total, desc="iterations", disable=True if self.quiet else None)
        self.bar.update(max(iteration.done - self.bar.n, 0))
        if iteration.residual is not None:
            self.bar.set_postfix(residual=f"{iteration.residual:.4g}")


if __name__ == "__main__":
    main()
