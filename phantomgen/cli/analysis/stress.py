"""``phantomgen stress``: hard cases against closed forms."""

from pathlib import Path

import click

from phantomgen.cli.common import case_options, debug_option, json_option, list_cases, print_cases


@click.command(
    epilog="\b\nExamples:\n  phantomgen stress\n  phantomgen stress --case grazing --case shells\n"
    "  phantomgen stress -o stress-report"
)
@case_options
@json_option
@debug_option
def stress(listed: bool, names: tuple[str, ...], out: Path | None, overwrite: bool, quiet: bool, as_json: bool) -> None:
    """Compute hard cases, each with a closed form, and say how far results are from it.

    Rays that graze, that pass through corners and edges, walls of 1e-12 mm, objects far away, metal that leaves
    nothing, one photon per pixel, thresholds on K edges: error against difficulty, and a verdict. Exits with 3 when a
    case failed.
    """
    from phantomgen.stress.case import chosen_cases
    from phantomgen.stress.cases import CASES
    from phantomgen.stress.run import run_cases

    cases = chosen_cases(CASES, names)
    if listed:
        list_cases(cases)
        return
    print_cases(run_cases(cases, out, overwrite=overwrite, progress=not (quiet or as_json)), as_json)
