"""The command ``recon uncertainty``: standard deviations of a run, from reconstructions with other noise."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from recon.cli.common import ProgressBar
from recon.cli.run_argument import RepeatedRun, RunFolder, repeated_run_options, scan_of_run

if TYPE_CHECKING:
    from recon.uncertainty.summary import Summary

_RUN = RunFolder()


@click.command(
    epilog="\b\nExamples:\n  recon uncertainty kedge-run\n  recon uncertainty kedge-run -n 20\n"
    "  recon volume kedge-run --as hu --deviation -o sd_hu70.nii.gz"
)
@click.argument("run", type=_RUN)
@click.option(
    "-n",
    "--replicates",
    type=click.IntRange(min=2),
    default=8,
    show_default=True,
    help="Number of reconstructions with other noise; each takes as long as the run itself.",
)
@repeated_run_options
def uncertainty(
    run: Path,
    replicates: int,
    again: RepeatedRun,
) -> None:
    """Compute the standard deviation that noise causes in every voxel of RUN.

    Draws counts anew around those that the result expects, reconstructs them with the settings of the run, and takes
    the spread between these replicates (parametric bootstrap). Writes uncertainty.h5 and replicates/ into RUN. Call it
    again to continue after an interruption, or with a larger -n for more replicates: finished ones are kept.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.uncertainty.estimate import DEVIATIONS, estimate
    from recon.uncertainty.summary import summary
    from spectra.threads import set_threads

    path = scan_of_run(run, again.dataset)
    set_threads(again.threads)
    bar = ProgressBar(again.silent)
    with open_dataset(path, again.air) as opened:
        found = estimate(
            run, opened, replicates, again.seed, bar, lambda k: bar.note(f"replicate {k + 1} of {replicates}")
        )
    bar.stage("fit")  # ends the bar
    told = summary(run, found)
    target = run / DEVIATIONS
    if again.as_json:
        content: dict[str, Any] = {row.name: row._asdict() for row in told.rows}
        click.echo(to_json({"uncertainty": str(target), "replicates": len(found.replicates), "volumes": content}))
        return
    click.echo(_table(told))
    click.echo(
        f"{len(found.replicates)} replicates: a standard deviation of one voxel alone is known to "
        f"{100 * found.replicates.certainty:.0f} %; more by -n"
    )
    click.echo(f"Wrote {target}; next: recon volume {run} --as hu --deviation, or recon report {run}")


def _table(told: "Summary") -> str:
    """Standard deviations as text."""
    wide = max(len(row.name) for row in told.rows) + 2
    lines = [f"{'standard deviation':<{max(wide, 20)}}{'median':>12}{'95 %':>12}{'of largest':>12}   unit"]
    for row in told.rows:
        part = f"{100 * row.median / row.largest:.2g} %" if row.largest > 0 else "-"
        lines.append(f"{row.name:<{max(wide, 20)}}{row.median:>12.2g}{row.high:>12.2g}{part:>12}   {row.unit}")
    return "\n".join(lines)
