"""The option `--preset`, whose names shells complete."""

from collections.abc import Callable

import click


def preset_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:
    """Complete the name of a preset in a shell.

    Parameters
    ----------
    ctx, param : of click
    incomplete : what is typed already

    Returns
    -------
    names that begin so
    """
    from phantomgen.scene.file.scene_file import preset_names as names

    del ctx, param
    return [name for name in names() if name.startswith(incomplete)]


def preset_option(command: Callable) -> Callable:
    """Add the option ``--preset`` to a command.

    Parameters
    ----------
    command : the command

    Returns
    -------
    the command
    """
    help_text = "A scene that comes with the program; see `phantomgen presets`."
    return click.option("--preset", metavar="NAME", shell_complete=preset_names, help=help_text)(command)
