"""The command ``phantomgen report``: one page about a dataset."""

import json
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options


@click.command(
    epilog="\b\nExamples:\n  phantomgen report kedge.h5\n  phantomgen report scan.h5 --air 0:16,0:256 -o scan-page.html"
)
@click.argument("file", metavar="DATASET", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Page to write [default: <dataset>-report.html].")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--overwrite", is_flag=True, help="Replace a page that exists.")
@progress_options
@json_option
@debug_option
@grouped(printing=Printing)
def report(file: Path, out: Path | None, air: str | None, overwrite: bool, printing: Printing) -> None:
    """Write one page about DATASET: scene, geometry, energies, views, errors, provenance.

    The page holds everything: pictures, and their numbers as tables to save.
    """
    from phantomgen.display.dataset_report.page import dataset_report
    from phantomgen.display.html import check_page, write_page

    target = out or Path(f"{file.stem}-report.html")
    check_page(target, overwrite)
    page = dataset_report(file, air, progress=not printing.silent)
    size = write_page(page, target)
    sections = [section.title for section in page.sections]
    found = {"report": str(target), "bytes": size, "sections": sections, "left_out": dict(page.left_out)}
    if printing.as_json:
        click.echo(json.dumps(found))
        return
    for name, why in page.left_out:
        click.echo(f"Left out: {name}: {why}", err=True)
    click.echo(f"Wrote {target}: {len(sections)} sections, {size / 1e6:.1f} MB; open it in a browser")
