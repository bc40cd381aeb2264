"""``recon decompose``: line integrals of basis functions for other programs."""

import json
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option
from phantomgen.cli.export import PROGRAMS


@click.command(
    epilog="\b\nExamples:\n  recon decompose kedge.h5 --to rtk -o kedge-rtk\n"
    "  recon decompose scan.h5 --to astra --bases 2 -o scan-astra"
)
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="Folder to write.")
@click.option("--to", "program", type=click.Choice(PROGRAMS), required=True, help="Write them for this program.")
@click.option("--bases", type=click.IntRange(min=1), help="Number of basis functions, the first ones [default: all].")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@json_option
@debug_option
def decompose(
    dataset: Path,
    out: Path,
    program: str,
    bases: int | None,
    air: str | None,
    overwrite: bool,
    threads: int | None,
    as_json: bool,
) -> None:
    """Decompose the counts of DATASET into line integrals of its basis functions, and write them for other programs.

    Each pixel of each view is decomposed for itself, by maximum likelihood. The folders are those of
    `phantomgen export --to`, with basis functions in place of channels.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.exporters.scans.folder import check_folder, kind_for, write_folder
    from recon.data.decomposed_projections import decomposed_projections
    from spectra.threads import set_threads

    kind_for(program, "line-integrals")
    check_folder(out, overwrite)
    set_threads(threads)
    with open_dataset(dataset, air) as opened:
        projections = decomposed_projections(opened, bases)
        write_folder(out, program, projections)
    names = list(projections.names)
    found = {"folder": str(out), "to": program, "what": "line-integrals", "names": names}
    text = f"Wrote {out} for {program}: line integrals of {', '.join(names)}; python {out / 'load.py'}"
    click.echo(json.dumps(found) if as_json else text)
