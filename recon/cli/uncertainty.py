"""The command ``recon uncertainty``: standard deviations of a run, from reconstructions with other noise."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phantomgen.cli.common import debug_option, json_option
from recon.cli.common import ProgressBar
from recon.cli.run_argument import RunFolder

if TYPE_CHECKING:
    from recon.uncertainty.summary import Summary

_RUN = RunFolder()
_FILE = click.Path(dir_okay=False, path_type=Path)


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
@click.option("--dataset", type=_FILE, help="The scan [default: by its name, beside the run or here].")
@click.option("--air", metavar="ROWS,COLUMNS", help="A part of the panel that sees only air, for lack of flats.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the noise.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("-q", "--quiet", is_flag=True, help="No progress.")
@json_option
@debug_option
def uncertainty(
    run: Path,
    replicates: int,
    dataset: Path | None,
    air: str | None,
    seed: int,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Compute the standard deviation that noise causes in every voxel of RUN.

    Draws counts anew around those that the result expects, reconstructs them with the settings of the run, and takes
    the spread between these replicates (parametric bootstrap). Writes uncertainty.h5 and replicates/ into RUN. Call it
    again to continue after an interruption, or with a larger -n for more replicates: finished ones are kept.
    """
    from phantomgen.dataset.reader import open_dataset
    from phantomgen.runtime.plain_json import to_json
    from recon.runs.read_run import check_run_folder, dataset_name, find_dataset
    from recon.uncertainty.estimate import DEVIATIONS, estimate
    from recon.uncertainty.summary import summary
    from spectra.errors import DatasetError
    from spectra.threads import set_threads

    check_run_folder(run)
    name = dataset_name(run)
    path = dataset or find_dataset(name, [run])
    if path is None:
        raise DatasetError(f"the dataset {name or 'of the run'} is neither beside {run} nor here: name it by --dataset")
    set_threads(threads)
    bar = ProgressBar(quiet or as_json)
    with open_dataset(path, air) as opened:
        found = estimate(run, opened, replicates, seed, bar, lambda k: bar.note(f"replicate {k + 1} of {replicates}"))
    bar.stage("fit")  # ends the bar
    told = summary(run, found)
    target = run / DEVIATIONS
    if as_json:
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
