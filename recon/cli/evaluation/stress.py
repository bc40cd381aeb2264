"""``recon stress``: hard cases of reconstruction."""

from pathlib import Path

import click

from phantomgen.cli.common import case_options, debug_option, json_option, list_cases, print_cases


@click.command(
    epilog="\b\nExamples:\n  recon stress\n  recon stress --case needles --case faint\n"
    "  recon stress kedge-small.h5 -o stress-report\n  recon stress kedge-small.h5 --case views --case dose"
)
@click.argument("scan", type=click.Path(dir_okay=False, path_type=Path), required=False)
@case_options
@json_option
@debug_option
def stress(
    scan: Path | None,
    listed: bool,
    names: tuple[str, ...],
    out: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Compute hard cases of projections, decomposition and, with SCAN, of the fit, and say how far results are off.

    Needles, discs, Gaussians around the source, one photon per pixel, near K edges, faint contrast: each against a
    closed form, another solver, or the Cramer-Rao bound. With SCAN, a dataset that has its truth, the scan is made
    worse step by step (fewer views, an arc, dose, truncation, dead pixels, wrong statements), and the default fit is
    compared with SIRT; this takes minutes. Exits with 3 when a case failed.
    """
    from phantomgen.stress.case import chosen_cases
    from phantomgen.stress.run import run_cases
    from recon.stress.cases import CASES
    from recon.stress.scans import cases_of

    cases = chosen_cases(CASES if scan is None else (*CASES, *cases_of(scan)), names)
    if listed:
        list_cases(cases)
        return
    print_cases(
        run_cases(cases, out, overwrite=overwrite, command="recon stress", progress=not (quiet or as_json)), as_json
    )
