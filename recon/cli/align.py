"""The command ``recon align``: errors of the stated panel, estimated from the projections and corrected."""

import sys
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options


@click.command(
    epilog="\b\nExamples:\n  recon align scan.h5 -o aligned.h5\n"
    "  recon align scan.h5 -o aligned.h5 --free columns\n  recon align scan.h5 --air 0:16,0:256"
)
@click.argument("scan", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Scan to write; none is written where left out.")
@click.option("--free", default="columns,tilt", metavar="NAME[,NAME]", help="What to estimate [default: columns,tilt].")
@click.option(
    "--block",
    type=click.IntRange(min=1),
    help="Pixels along each side of the smallest blocks [default: 40 blocks at most along a row].",
)
@click.option("--air", metavar="ROWS,COLUMNS", help="Part of the panel that sees only air, in place of flats.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@progress_options
@json_option
@debug_option
@grouped(printing=Printing)
def align(
    scan: Path,
    out: Path | None,
    free: str,
    block: int | None,
    air: str | None,
    threads: int | None,
    overwrite: bool,
    printing: Printing,
) -> None:
    """Estimate how far the panel of SCAN lies from where the file states it, and correct it.

    From the projections alone: the shift along the columns (centre of rotation) and the turn of the panel in its plane,
    each with its standard uncertainty. OUT is SCAN with the corrected poses; its counts stay as they are.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.dataset.writing.corrected_copy import check_copy
    from phantomgen.runtime.plain_json import to_json
    from recon.alignment.align import align as estimate
    from spectra.threads import set_threads

    names = tuple(name.strip() for name in free.split(",") if name.strip())
    if out is not None:
        check_copy(scan, out, overwrite)
    set_threads(threads)
    with open_dataset(scan, air) as dataset:
        if printing.silent or not sys.stderr.isatty():
            found = estimate(dataset, names, block=block)
        else:
            from tqdm import tqdm

            with tqdm(desc="levels", unit="", leave=False) as bar:

                def begin(number: int, count: int) -> None:
                    bar.total, bar.n = count, number
                    bar.refresh()

                found = estimate(dataset, names, block=block, on_level=begin)
        if out is not None:
            found.write(dataset, out, overwrite=overwrite)
    if printing.as_json:
        click.echo(to_json({"file": None if out is None else str(out), **found.record()}))
        return
    click.echo("\n".join(found.lines()))
    for sentence in found.sentences:
        click.echo(f"{sentence[0].upper()}{sentence[1:]}.")
    if out is not None:
        click.echo(f"Wrote {out}; next: recon fit {out}")
