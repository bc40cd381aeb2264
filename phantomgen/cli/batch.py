"""``phantomgen batch``, many scans from one file, and ``phantomgen suite``, a fixed set of scans for results."""

import json
import sys
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options


@click.command(
    epilog="\b\nExamples:\n  phantomgen batch training.yaml -n 1000 --workers 2 -o training\n"
    "  phantomgen batch training.yaml --cluster tcp://10.0.0.1:8786 --shard 1/4"
)
@click.argument("manifest", type=click.Path(dir_okay=False))
@click.option("-n", "--count", type=click.IntRange(min=1), help="Number of items [default: that of the manifest].")
@click.option(
    "-o", "--out", type=click.Path(file_okay=False), help="Folder of the items [default: that of MANIFEST's name]."
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes of this machine [default: one per processor].")
@click.option("--cluster", metavar="ADDRESS", help="Dask scheduler whose workers are used in place of processes.")
@click.option("--shard", metavar="I/N", help="Make every N-th item only, beginning with the I-th.")
@click.option("--overwrite", is_flag=True, help="Make all items anew.")
@progress_options
@json_option
@debug_option
@grouped(printing=Printing)
def batch(
    manifest: str,
    count: int | None,
    out: str | None,
    workers: int | None,
    cluster: str | None,
    shard: str | None,
    overwrite: bool,
    printing: Printing,
) -> None:
    """Make many scans from MANIFEST, a YAML file that names a scene, what overrides it, and a seed.

    Item i is the scene of that seed + i. Each becomes a dataset and a line of manifest.jsonl; what is there already is
    left as it is, and what fails does not stop the rest. Exits with 3 when an item failed.
    """
    from phantomgen.batch.manifest import Batch
    from phantomgen.batch.records import Shard
    from phantomgen.batch.run import run_batch

    part = Shard.parse(shard) if shard else None
    summary = run_batch(
        Batch.read(manifest),
        Path(manifest).stem if out is None else out,
        count=count,
        workers=workers,
        executor=cluster,
        shard=part,
        overwrite=overwrite,
        progress=not printing.quiet,
    )
    click.echo(json.dumps(summary.to_dict()) if printing.as_json else summary.text)
    sys.exit(3 if summary.failed else 0)


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
@progress_options
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
