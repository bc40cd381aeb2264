"""What every command line of this project shares: errors as sentences, exit codes, common options."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import click

from spectra.errors import Error, MachineWarning


class Commands(click.Group):
    """Turns errors raised on purpose into one sentence and an exit code."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            with _warnings_as_sentences():
                return super().invoke(ctx)
        except Error as error:
            if ctx.meta.get("debug"):
                raise
            click.echo(f"Error: {error}", err=True)
            ctx.exit(1)
        except KeyboardInterrupt as interrupt:
            click.echo(f"Interrupted; {str(interrupt) or 'nothing was left half-written'}.", err=True)
            ctx.exit(130)


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


def debug_option(command: Callable) -> Callable:
    """Add ``--debug``."""

    def remember(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        ctx.find_root().meta["debug"] = value

    help_text = "Show the traceback of an error."
    return click.option("--debug", is_flag=True, expose_value=False, callback=remember, help=help_text)(command)


def json_option(command: Callable) -> Callable:
    """Add ``--json``."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(command)


def version_option(program: str) -> Callable[[Callable], Callable]:
    """Add ``--version`` to `program`."""

    def show(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value:
            from phantomgen.runtime.versions import program_version

            click.echo(f"{program} {program_version()}")
            ctx.exit()

    help_text = "Print the version."
    return click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=show, help=help_text)


def print_stages(shown: bool) -> Callable[[str], None]:
    """What says on stderr which stage has begun, where somebody can see it."""
    return lambda name: click.echo(f"{name} ...", err=True) if shown else None
