"""``phantomgen presets``: scenes that come with the program."""

import click

from phantomgen.cli.common import debug_option
from phantomgen.cli.preset_option import preset_names


@click.group(
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
        click.echo(f"{name:<20}{summary}")


@presets.command(
    "show",
    epilog="\b\nExamples:\n  phantomgen presets show kedge > my.yaml\n"
    "  phantomgen presets show random --seed 7 --resolved",
)
@click.argument("name", shell_complete=preset_names)
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
