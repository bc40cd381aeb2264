"""Parts that commands of recon share: progress bar, checks of options, and text for the end of a run."""

import traceback
from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from recon.gaussians.optimize import Progress
    from recon.phases.fit import PhaseProgress
    from recon.voxel.method import Iteration

# Parameters of a spectral model, as options name them.
PARAMETERS = ("voltage", "filter", "thresholds", "resolution")


def finite_number(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Refuse NaN and infinity as the value of an option; a callback of click.

    Parameters
    ----------
    context, parameter : of click, not used
    value : of the option

    Returns
    -------
    the value
    """
    del context, parameter
    if value is not None and not isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number.")
    return value


def parse_priors(context: click.Context, parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """Read the values of ``--prior``; a callback of click.

    Parameters
    ----------
    context, parameter : of click, not used
    given : texts such as ``voltage=1``

    Returns
    -------
    standard deviations by the name of a spectral parameter
    """
    del context, parameter
    priors = {}
    for text in given:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = 0.0
        if name.strip() not in PARAMETERS:
            raise click.BadParameter(f"{name!r} is none of {', '.join(PARAMETERS)}.")
        if not (isfinite(value) and value > 0):
            raise click.BadParameter(f"{text!r} needs a positive number, as in voltage=1.")
        priors[name.strip()] = value
    return priors


def exit_where_failed(metrics: dict[str, Any], strict: bool) -> None:
    """End with exit code 1 where scores failed, or with 3 where a check of the verdict failed and the user is strict.

    A figure that failed does not count.

    Parameters
    ----------
    metrics : content of ``metrics.json``
    strict : whether checks of the verdict count
    """
    from recon.evaluation import verdict

    if any(not what.startswith("drawing") for what in metrics.get("failed", ())):
        raise click.exceptions.Exit(1)
    if strict and verdict.failed(metrics):
        raise click.exceptions.Exit(3)


def refuse_options(beside: str, options: dict[str, Any]) -> None:
    """Refuse options that have no meaning beside another one.

    Parameters
    ----------
    beside : the other option, for the message
    options : values by name; those that were not given are None, False, 0 or empty
    """
    for name, value in options.items():
        if value is not None and value is not False and value not in (0, ()):
            raise click.UsageError(f"--{name} cannot be used with {beside}.")


def gaussians_text(metrics: dict[str, Any]) -> str:
    """Format the size of a model.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    Gaussians, the numbers that they consist of, and how many voxels would take
    """
    gaussians = f"{metrics['gaussians']} Gaussians"
    if "numbers_over_voxels" not in metrics:
        return gaussians
    part = 100 * metrics["numbers_over_voxels"]
    percent = f"{part:.0f}" if part >= 10 else f"{part:.1f}"
    return f"{gaussians} ({metrics['numbers']} numbers, {percent} % of those of voxels)"


def seconds_text(metrics: dict[str, Any]) -> str:
    """Format the time of a run.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    seconds of the whole run and of its stages
    """
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in metrics["seconds"].items())
    return f"{sum(metrics['seconds'].values()):.0f} s ({parts})"


def memory_text(metrics: dict[str, Any]) -> str:
    """Format the peak memory of a run.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    end of a sentence; empty where the system does not tell
    """
    peak = metrics["peak_memory_mib"]
    return "" if peak is None else f", peak memory {peak:.0f} MiB"


def each_text(values: Any) -> str:
    """Format values with one decimal, separated by slashes.

    Parameters
    ----------
    values : numbers

    Returns
    -------
    such as ``1.0/1.1/0.9``
    """
    return "/".join(f"{value:.1f}" for value in values)


def stderr_printer(quiet: bool) -> Callable[[str], None]:
    """Return a function that writes sentences to stderr.

    Parameters
    ----------
    quiet : whether the function shall do nothing

    Returns
    -------
    the function
    """
    return (lambda sentence: None) if quiet else (lambda sentence: click.echo(sentence, err=True))


class ProgressBar:
    """Progress on stderr: a line per stage and a bar for iterations; a `recon.runs.interfaces.Watcher`.

    Parameters
    ----------
    quiet : whether to show only warnings
    """

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.bar: Any = None

    def stage(self, name: str) -> None:
        """Show that a stage begins.

        Parameters
        ----------
        name : of the stage
        """
        if self.bar is not None:
            self.bar.close()
            self.bar = None
        if not self.quiet and name != "fit":
            click.echo(f"{name} ...", err=True)

    def note(self, sentence: str) -> None:
        """Show a decision.

        Parameters
        ----------
        sentence : for the user
        """
        if not self.quiet:
            click.echo(sentence, err=True)

    def warn(self, sentence: str, error: Exception) -> None:
        """Show that a score or a figure failed, with a traceback after ``--debug``.

        Parameters
        ----------
        sentence : for the user
        error : its cause
        """
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().meta.get("debug"):
            click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
        click.echo(f"Warning: {sentence}.", err=True)

    def phase_step(self, progress: "PhaseProgress") -> None:
        """Show a finished step of the fit of phases.

        Parameters
        ----------
        progress : number of the step, and the deviance of its phase
        """
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=progress.steps, desc="phases", unit="step", disable=self.quiet)
        if progress.deviance is not None:
            self.bar.set_postfix_str(f"deviance {progress.deviance:.3g}", refresh=False)
        self.bar.update()

    def step(self, progress: "Progress") -> None:
        """Show a finished step of the fit.

        Parameters
        ----------
        progress : number of the step, its deviance and chi-square
        """
        from tqdm.auto import tqdm

        if self.bar is not None and self.bar.total != progress.steps:
            self.bar.close()
            self.bar = None
            self.note("the deviance grew: the fit begins anew with more views per step")
        if self.bar is None:
            self.bar = tqdm(total=progress.steps, desc="fit", unit="step", disable=True if self.quiet else None)
        if progress.step > self.bar.n + 1:
            self.bar.initial = self.bar.n = progress.step - 1  # resumed
        self.bar.update()
        self.bar.set_postfix(deviance=f"{progress.deviance:.3f}", chi_square=each_text(progress.chi_square))

    def iterated(self, iteration: "Iteration") -> None:
        """Show a finished iteration of a voxel or view method.

        Parameters
        ----------
        iteration : number of the iteration and its residual
        """
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=iteration.total, desc="iterations", disable=True if self.quiet else None)
        self.bar.total = iteration.total  # grows where passes follow because the deviance still falls
        self.bar.update(max(iteration.done - self.bar.n, 0))
        if iteration.residual is not None:
            self.bar.set_postfix(residual=f"{iteration.residual:.4g}")
