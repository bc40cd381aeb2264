"""``phantomgen import``: phantoms of other programs as scene files."""

from pathlib import Path

import click

from phantomgen.cli.common import debug_option


@click.group("import", epilog="\b\nExamples:\n  phantomgen import forbild HeadPhantom.pha -o head.yaml")
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
    from phantomgen.importers.forbild import forbild_scene
    from phantomgen.runtime.outputs import check_output

    path = Path(out)
    check_output(path, overwrite)
    path.write_text(forbild_scene(file), encoding="utf-8")
    click.echo(f"{path}\nnext     phantomgen view {path}")
