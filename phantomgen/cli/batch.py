"""``phantomgen batch``: many scans from one file."""

import json
import sys
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option


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
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def batch(
    manifest: str,
    count: int | None,
    out: str | None,
    workers: int | None,
    cluster: str | None,
    shard: str | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
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
        progress=not quiet,
    )
    click.echo(json.dumps(summary.to_dict()) if as_json else summary.text)
    sys.exit(3 if summary.failed else 0)
