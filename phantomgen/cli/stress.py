"""``phantomgen stress``: hard cases against closed forms."""

import json
import sys
from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option


@click.command(
    epilog="\b\nExamples:\n  phantomgen stress\n  phantomgen stress --case grazing --case shells\n"
    "  phantomgen stress -o stress-report"
)
@click.option("--list", "listed", is_flag=True, help="List the cases; compute nothing.")
@click.option("--case", "names", metavar="NAME", multiple=True, help="Compute this case only; repeatable.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder for a table, a figure and a JSON file.")
@click.option("--overwrite", is_flag=True, help="Replace a report that exists.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def stress(listed: bool, names: tuple[str, ...], out: Path | None, overwrite: bool, quiet: bool, as_json: bool) -> None:
    """Compute hard cases, each with a closed form, and say how far results are from it.

    Rays that graze, that pass through corners and edges, walls of 1e-12 mm, objects far away, metal that leaves
    nothing, one photon per pixel: error against difficulty, and a verdict. Exits with 3 when a case failed.
    """
    from phantomgen.runtime.outputs import check_output_folder
    from phantomgen.stress.cases import chosen_cases

    cases = chosen_cases(names)
    if listed:
        click.echo("\n".join(f"{case.name:12}  {case.what}" for case in cases))
        return
    from tqdm.auto import tqdm

    from phantomgen.stress.report import FILES, table, write_report

    if out is not None:
        check_output_folder(out, overwrite, "phantomgen stress", lambda folder: (folder / FILES[0]).is_file())

    bar = tqdm(cases, desc="stress", unit="case", disable=True if quiet or as_json else None)
    outcomes = [case.run() for case in bar]
    if out is not None:
        out.mkdir(exist_ok=True)
        write_report(outcomes, out)
    click.echo(json.dumps([outcome.to_dict() for outcome in outcomes]) if as_json else table(outcomes))
    sys.exit(0 if all(outcome.passed for outcome in outcomes) else 3)
