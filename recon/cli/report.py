"""The command ``recon report``: one page about one run, or about several side by side."""

import json
import time
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option, progress_options
from recon.cli.common import stderr_printer
from recon.cli.run_argument import RunFolder

_RUN = RunFolder()
_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command(epilog="\b\nExamples:\n  recon report kedge-run\n  recon report kedge-run voxel-run -o both.html")
@click.argument("runs", metavar="RUN...", type=_RUN, nargs=-1, required=True)
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), help="Page to write [default: report.html in the first RUN]."
)
@click.option("--dataset", type=_FILE, help="The scan [default: by its name, beside the runs or here].")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--overwrite", is_flag=True, help="Replace a page that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
def report(
    runs: tuple[Path, ...],
    out: Path | None,
    dataset: Path | None,
    air: str | None,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Write one page with the figures and scores of finished RUNs of one scan.

    The page holds everything: pictures, and their numbers as tables to save. Sections that need the dataset or its
    truth are left out without them, and the page says so.
    """
    from phantomgen.display.html import check_page, write_page
    from recon.output.report.page import run_report
    from spectra.threads import set_threads

    target = out or runs[0] / "report.html"
    check_page(target, overwrite)
    set_threads(threads)
    began = time.perf_counter()
    tell = stderr_printer(quiet or as_json)
    page = run_report(runs, dataset, air, lambda name: tell(f"{name} ..."))
    size = write_page(page, target)
    found = {
        "report": str(target),
        "bytes": size,
        "seconds": time.perf_counter() - began,
        "sections": [section.title for section in page.sections],
        "left_out": dict(page.left_out),
    }
    if as_json:
        click.echo(json.dumps(found))
        return
    for name, why in page.left_out:
        click.echo(f"Left out: {name}: {why}", err=True)
    click.echo(f"Wrote {target}: {len(page.sections)} sections, {size / 1e6:.1f} MB; open it in a browser")
