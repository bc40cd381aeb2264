"""The command ``recon``: parse, call, print."""

import click

from phantomgen.cli.common import Commands, version_option
from recon.cli.align import align
from recon.cli.calibrate import calibrate
from recon.cli.edge import edge
from recon.cli.evaluation.compare import compare
from recon.cli.evaluation.quality import quality
from recon.cli.evaluation.score import score
from recon.cli.evaluation.stress import stress
from recon.cli.evaluation.suite import suite
from recon.cli.export import decompose, export
from recon.cli.fit import fit
from recon.cli.report import report
from recon.cli.segment import segment
from recon.cli.uncertainty import uncertainty
from recon.cli.view import view
from recon.cli.volume_and_render import render, volume
from recon.cli.warm_up import warm_up


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExamples:\n  recon fit kedge.h5\n  recon fit kedge.h5 -o run --bases 2",
)
@version_option("recon")
def main() -> None:
    """Reconstruct basis volumes from spectral-CT scans, and score them."""


COMMANDS = (
    fit,
    edge,
    score,
    compare,
    suite,
    stress,
    report,
    view,
    segment,
    volume,
    uncertainty,
    quality,
    render,
    export,
    decompose,
    warm_up,
    calibrate,
    align,
)
for command in COMMANDS:
    main.add_command(command)
