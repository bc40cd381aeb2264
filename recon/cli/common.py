"""What commands of recon share: progress bar, checks of options, words for the end of a run."""

import traceback
from math import isfinite
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from recon.gaussians.optimize import Progress
    from recon.voxel.method import Iteration


def finite_number(_: click.Context, __: click.Parameter, value: float | None) -> float | None:
    """Refuse NaN and infinity as an option's value."""
    if value is not None and not isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number.")
    return value


def exit_where_failed(metrics: dict[str, Any], strict: bool) -> None:
    """Exit code 1 where scores are missing that the run should have, 3 where a strict user wants no check to fail.

    A missing figure is no failure.
    """
    from recon.evaluation import verdict

    if any(not what.startswith("drawing") for what in metrics.get("failed", ())):
        raise click.exceptions.Exit(1)
    if strict and verdict.failed(metrics):
        raise click.exceptions.Exit(3)


def refuse_options(beside: str, options: dict[str, Any]) -> None:
    """Refuse options that mean nothing beside another one."""
    for name, value in options.items():
        if value is not None and value is not False and value not in (0, ()):
            raise click.UsageError(f"--{name} cannot be used with {beside}.")


def seconds_text(metrics: dict[str, Any]) -> str:
    """Seconds of the whole run and of its stages."""
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in metrics["seconds"].items())
    return f"{sum(metrics['seconds'].values()):.0f} s ({parts})"


def memory_text(metrics: dict[str, Any]) -> str:
    """Peak memory, where it is known."""
    peak = metrics["peak_memory_mib"]
    return "" if peak is None else f", peak memory {peak:.0f} MiB"


def each_text(values: Any) -> str:
    """Values with one decimal, parted by slashes."""
    return "/".join(f"{value:.1f}" for value in values)


class ProgressBar:
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
        self.bar.set_postfix(deviance=f"{progress.deviance:.3f}", chi_square=each_text(progress.chi_square))

    def iterated(self, iteration: "Iteration") -> None:
        """An iteration of a classical method is done."""
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=iteration.total, desc="iterations", disable=True if self.quiet else None)
        self.bar.update(max(iteration.done - self.bar.n, 0))
        if iteration.residual is not None:
            self.bar.set_postfix(residual=f"{iteration.residual:.4g}")
