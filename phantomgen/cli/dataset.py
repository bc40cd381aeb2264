"""``phantomgen info``, ``validate`` and ``schema``: what a dataset holds, and whether it is right."""

import json
import sys
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option


@click.command(epilog="\b\nExamples:\n  phantomgen info kedge.h5\n  phantomgen info kedge.h5 --json")
@click.argument("file", type=click.Path(dir_okay=False))
@json_option
@debug_option
def info(file: str, as_json: bool) -> None:
    """Say what a dataset holds."""
    from phantomgen.dataset.describe import describe, describe_text

    description = describe(Path(file))
    for warning in description.pop("warnings"):
        click.echo(f"Warning: {warning}", err=True)
    click.echo(json.dumps(description) if as_json else describe_text(description))


@click.command(
    epilog="\b\nExamples:\n  phantomgen validate kedge.h5\n  phantomgen validate edited.h5 --air 0:16,0:256 --seal"
)
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--seal", is_flag=True, help="First write new digests into the file, after an edit on purpose.")
@json_option
@debug_option
def validate(file: str, air: str | None, seal: bool, as_json: bool) -> None:
    """Check a dataset whole: digests, checksums, shapes, units, ranges, splits.

    Exits with 3 when something is wrong.
    """
    from phantomgen.dataset.file import seal_file
    from phantomgen.dataset.validate import validate as check

    if seal:
        seal_file(Path(file))
    problems = check(file, air)
    if as_json:
        click.echo(json.dumps({"file": file, "valid": not problems, "problems": problems}))
    else:
        click.echo("\n".join(problems) if problems else f"{file} is valid")
    sys.exit(3 if problems else 0)


@click.command(epilog="\b\nExamples:\n  phantomgen schema\n  phantomgen schema --scene > scene.schema.json")
@click.option("--scene", is_flag=True, help="Print the JSON Schema of scene files, for completion in editors.")
@debug_option
def schema(scene: bool) -> None:
    """Print the layout of a dataset, or the schema of scene files."""
    if scene:
        from phantomgen.scene.schema import json_schema

        click.echo(json.dumps(json_schema(), indent=1))
        return
    from phantomgen.dataset.checks.fields import schema_text

    click.echo(schema_text(), nl=False)
