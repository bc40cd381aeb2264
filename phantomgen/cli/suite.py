"""``phantomgen suite``: a fixed set of scans that results can be stated on."""

import json
import sys
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option


@click.command(epilog="\b\nExamples:\n  phantomgen suite v1\n  phantomgen suite v1 --tier hour -o suite-hour --resume")
@click.argument("name", metavar="SUITE")
@click.option(
    "-o", "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder [default: suite-<SUITE>-<tier>]."
)
@click.option(
    "--tier",
    type=click.Choice(["minutes", "hour", "night"]),
    default="minutes",
    show_default=True,
    help="Size of the scans: 48^3, 96^3 or 128^3 voxels.",
)
@click.option("--resume", is_flag=True, help="Make what a folder lacks.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("-q", "--quiet", is_flag=True, help="No progress.")
@json_option
@debug_option
def suite(
    name: str,
    out: Path | None,
    tier: str,
    resume: bool,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Make the scans of SUITE: one dataset per case, and suite.json with versions and hashes.

    The hashes of scenes, counts and truth are compared with the stored ones. Exits with 3 where a scan is another one
    than rounding explains. `recon suite score` scores methods on it.
    """
    from phantomgen.suite.definition import read_suite
    from phantomgen.suite.run import make_suite
    from spectra.threads import set_threads

    set_threads(threads)
    chosen = read_suite(name, tier)
    folder = out or Path(f"suite-{name}-{tier}")
    shown = not (quiet or as_json)
    made = make_suite(
        chosen,
        folder,
        overwrite=overwrite,
        resume=resume,
        tell=lambda line: click.echo(line, err=True) if shown else None,
    )
    if as_json:
        click.echo(json.dumps(made.manifest))
    else:
        click.echo(f"Wrote {folder}: suite {name}, tier {tier}, {chosen.sha256[:12]}; next: recon suite score {folder}")
    for sentence in made.different:
        click.echo(f"Warning: {sentence}", err=True)
    sys.exit(3 if made.different else 0)
