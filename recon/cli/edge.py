"""``recon edge``: K edges that the counts of a dataset show."""

import sys
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import ProgressBar


@click.command(epilog="\b\nExamples:\n  recon edge kedge.h5\n  recon edge scan.h5 --edge 33,50 -o found")
@click.argument("dataset", type=click.Path(dir_okay=False))
@click.option("-o", "--out", type=click.Path(), help="Files to write, without suffix [default: <dataset>-edge].")
@click.option(
    "--edge", metavar="auto|keV[,keV]", default="auto", show_default=True, help="Energies to try besides all others."
)
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw the profile.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(printing=Printing)
def edge(
    dataset: str,
    out: str | None,
    edge: str,
    air: str | None,
    figures: bool,
    overwrite: bool,
    threads: int | None,
    printing: Printing,
) -> None:
    """Find the energies of K edges in DATASET.

    Tries edges at all energies on rays that two bases do not explain, without the edges that the dataset states, and
    writes the profile likelihood as JSON and as a figure.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.kedge.choose_basis import find_edges
    from recon.kedge.report import EdgeFiles, parse_edges
    from spectra.threads import set_threads

    source = Path(dataset)
    files = EdgeFiles(Path(f"{source.stem}-edge" if out is None else out), overwrite)
    set_threads(threads)
    bar = ProgressBar(printing.silent or not sys.stderr.isatty())
    with open_dataset(source, air) as opened:
        bar.stage("search")
        choice = find_edges(opened, parse_edges(edge) or ())
        bar.stage("write")
        record = files.write(choice, opened, figures)
    click.echo(to_json(record) if printing.as_json else "\n".join([*choice.sentences, *map(str, files.written)]))
