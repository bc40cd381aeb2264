"""Common parts of all commands of this project: errors as sentences, exit codes, options."""

import errno
import json
import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import wraps
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from spectra.errors import Error, MachineWarning, concise, shortened

if TYPE_CHECKING:
    from phantomgen.stress.case import Case, Outcome

# What a file system refuses: names that are too long, folders that cannot be written, full disks.
_OF_FILES = {
    errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.EROFS, errno.ELOOP, errno.EISDIR, errno.ENOTDIR, errno.ENOSPC,
    errno.EDQUOT, errno.EFBIG, errno.EIO,
}  # fmt: skip


# Packages of this project, which log by the names of their modules.
PACKAGES = ("phantomgen", "recon", "spectra")
_NOTHING_LEFT = "nothing was left half-written"


class Commands(click.Group):
    """Group of commands that reports intended errors as one sentence with an exit code."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command.

        Parameters
        ----------
        ctx : context of click

        Returns
        -------
        result of the command
        """
        try:
            with _warnings_as_sentences(), _terminable():
                return super().invoke(ctx)
        except Error as error:
            if ctx.meta.get("debug"):
                raise
            click.echo(f"Error: {concise(str(error))}", err=True)
            ctx.exit(1)
        except click.ClickException as error:
            error.__dict__["message"] = concise(error.message)  # annotated as final
            raise
        except OSError as error:
            if error.errno not in _OF_FILES or ctx.meta.get("debug"):
                raise
            name = shortened(error.filename or "a file")
            click.echo(f"Error: {name} cannot be opened or written: {os.strerror(error.errno)}", err=True)
            ctx.exit(1)
        except KeyboardInterrupt as interrupt:
            ended = isinstance(interrupt, Terminated)
            how = "Ended by SIGTERM" if ended else "Interrupted"
            click.echo(f"{how}; {str(interrupt) or _NOTHING_LEFT}.", err=True)
            ctx.exit(143 if ended else 130)


class Terminated(KeyboardInterrupt):
    """SIGTERM, which a batch system sends before it kills a process; handled as Ctrl-C."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Turn SIGTERM into an exception, so that what is half-written is removed; a fit has a handler of its own."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return

    def end(*_: object) -> None:
        raise Terminated

    signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def _warnings_as_sentences() -> Iterator[None]:
    """Show what is wrong with the machine without the line of code that found it."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if issubclass(category, MachineWarning):
            click.echo(f"Warning: {message}", err=True)
        else:
            usual(message, category, *rest, **options)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


class FiniteRange(click.FloatRange):
    """Type of an option that is a number within limits, neither NaN nor infinite."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert the text of an option.

        Parameters
        ----------
        value : the text
        param, ctx : of click

        Returns
        -------
        the number
        """
        number = super().convert(value, param, ctx)
        if number is not None and not isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Limits for the help text, where there are any."""
        return "" if self.min is None and self.max is None else super()._describe_range()


@dataclass(frozen=True)
class Printing:
    """How a command prints.

    Parameters
    ----------
    quiet : no progress
    as_json : one JSON object in place of text
    """

    quiet: bool
    as_json: bool

    @property
    def silent(self) -> bool:
        """Whether no progress is shown."""
        return self.quiet or self.as_json


@dataclass(frozen=True)
class SceneChoice:
    """The scene of a command.

    Parameters
    ----------
    scene : file or preset, as the argument
    preset : as the option
    settings : overrides, ``PATH=VALUE``
    """

    scene: str | None
    preset: str | None
    settings: tuple[str, ...]


def grouped(**groups: type) -> Callable[[Callable], Callable]:
    """Hand options that belong together over as one object.

    Parameters
    ----------
    **groups : dataclass of each parameter of the command that takes several options, which are its fields

    Returns
    -------
    decorator of a command, nearest to it
    """

    def decorate(command: Callable) -> Callable:
        @wraps(command)
        def run(**options: Any) -> Any:
            for name, group in groups.items():
                options[name] = group(**{field.name: options.pop(field.name) for field in fields(group)})
            return command(**options)

        return run

    return decorate


def debug_option(command: Callable) -> Callable:
    """Add the option ``--debug`` to a command.

    Parameters
    ----------
    command : the command

    Returns
    -------
    the command
    """

    def remember(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        ctx.find_root().meta["debug"] = value

    help_text = "Show the traceback of an error."
    return click.option("--debug", is_flag=True, expose_value=False, callback=remember, help=help_text)(command)


def progress_options(command: Callable) -> Callable:
    """Add the options ``--quiet`` and ``--verbose`` to a command.

    Parameters
    ----------
    command : gets ``quiet``

    Returns
    -------
    the command
    """
    command = click.option(
        "-v",
        "--verbose",
        is_flag=True,
        expose_value=False,
        callback=_log_to_stderr,
        help="Log versions, and time and memory of each stage, on stderr.",
    )(command)
    return click.option("-q", "--quiet", is_flag=True, help="No progress bar.")(command)


class _OnStderr(logging.Handler):
    """Writes what is logged to stderr, wherever that is at the moment."""

    def emit(self, record: logging.LogRecord) -> None:
        click.echo(self.format(record), err=True)


def _log_to_stderr(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    """Write what the packages log to stderr while a command runs; a callback of click."""
    if not value:
        return
    from phantomgen.runtime.stopwatch import peak_memory_mib
    from phantomgen.runtime.versions import environment

    handler = _OnStderr()
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%H:%M:%S"))
    loggers = [logging.getLogger(name) for name in PACKAGES]
    began = time.perf_counter()
    for logger in loggers:
        logger.setLevel(logging.INFO)
        logger.addHandler(handler)

    def end() -> None:
        peak = peak_memory_mib()
        memory = "" if peak is None else f", peak memory {peak:.0f} MiB"
        loggers[0].info("%s: %.1f s in all%s", ctx.command_path, time.perf_counter() - began, memory)
        for logger in loggers:
            logger.removeHandler(handler)
            logger.setLevel(logging.NOTSET)

    ctx.call_on_close(end)
    loggers[0].info("%s with %s", ctx.command_path, ", ".join(f"{k} {v}" for k, v in environment().items()))


@contextmanager
def views_bar(silent: bool, total: int | None = None) -> Iterator[Callable[[], object]]:
    """Show a progress bar of views, where a person reads it and after two seconds.

    Parameters
    ----------
    silent : whether to show none
    total : number of views; None where it is not known

    Yields
    ------
    function to call after each view
    """
    from tqdm import tqdm

    shown = not silent and sys.stderr.isatty()
    with tqdm(total=total, desc="views", unit="", leave=False, disable=not shown, delay=2.0) as bar:
        yield bar.update


def json_option(command: Callable) -> Callable:
    """Add the option ``--json`` to a command.

    Parameters
    ----------
    command : the command

    Returns
    -------
    the command
    """
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(command)


def case_options(command: Callable) -> Callable:
    """Add the options of a command that computes hard cases.

    Parameters
    ----------
    command : gets ``listed``, ``names``, ``out``, ``overwrite`` and ``quiet``

    Returns
    -------
    the command with the options
    """
    options = (
        click.option("--list", "listed", is_flag=True, help="List the cases; compute nothing."),
        click.option("--case", "names", metavar="NAME", multiple=True, help="Compute this case only; repeatable."),
        click.option(
            "-o", "--out", type=click.Path(path_type=Path), help="Folder for a table, a figure and a JSON file."
        ),
        click.option("--overwrite", is_flag=True, help="Replace a report that exists."),
        progress_options,
    )
    for option in reversed(options):
        command = option(command)
    return command


def list_cases(cases: Sequence["Case"]) -> None:
    """Print names of hard cases, and what is hard.

    Parameters
    ----------
    cases : the cases
    """
    click.echo("\n".join(f"{case.name:12}  {case.what}" for case in cases))


def print_cases(outcomes: Sequence["Outcome"], as_json: bool) -> None:
    """Print the table of hard cases, and exit with 3 where one failed.

    Parameters
    ----------
    outcomes : of the cases
    as_json : print JSON in place of the table
    """
    from phantomgen.stress.report import table

    click.echo(json.dumps([outcome.to_dict() for outcome in outcomes]) if as_json else table(outcomes))
    sys.exit(0 if all(outcome.passed for outcome in outcomes) else 3)


def version_option(program: str) -> Callable[[Callable], Callable]:
    """Add the option ``--version`` to a command.

    Parameters
    ----------
    program : name of the program

    Returns
    -------
    decorator of a command
    """

    def show(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value:
            from phantomgen.runtime.versions import program_version

            click.echo(f"{program} {program_version()}")
            ctx.exit()

    help_text = "Print the version."
    return click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=show, help=help_text)


def print_stages(shown: bool) -> Callable[[str], None]:
    """Return a function that prints the name of a stage to stderr.

    Parameters
    ----------
    shown : whether anything is printed

    Returns
    -------
    function of the name
    """
    return lambda name: click.echo(f"{name} ...", err=True) if shown else None
