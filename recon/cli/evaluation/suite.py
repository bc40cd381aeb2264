"""The commands ``recon suite score`` and ``recon suite table``: parse, call, print."""

from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import stderr_printer
from recon.cli.run_argument import check_run_name

_METHODS = "fdk,pdhg-tv,one-step,gaussian"


@click.group(
    epilog="\b\nExamples:\n  recon suite score suite-v1-minutes\n  recon suite table suite-v1-minutes-score their-score"
)
def suite() -> None:
    """Score methods and programs on the scans that phantomgen suite made."""


@dataclass(frozen=True)
class _Programs:
    """Volumes and commands of other programs."""

    volumes: tuple[str, ...]
    commands: tuple[str, ...]


@dataclass(frozen=True)
class _Output:
    """The folder that is written."""

    out: Path | None
    resume: bool
    overwrite: bool


@suite.command(
    epilog="\b\nExamples:\n  recon suite score suite-v1-minutes --methods fdk,one-step --clock cpu --threads 1\n"
    "  recon suite score suite-v1-minutes --volumes 'mine-1.2=volumes as=basis units=1/mm axes=czyx same-grid'\n"
    "  recon suite score suite-v1-minutes \\\n"
    "    --run 'mine-1.2 as=basis units=1/mm axes=czyx same-grid: python mine.py {dataset} {out}'"
)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--methods",
    metavar="NAME,...",
    help=f"Methods of recon compare [default: {_METHODS}; none beside --volumes or --run].",
)
@click.option("--budget", metavar="SECONDS,...", help="Time of each method on each case [default: that of the tier].")
@click.option(
    "--clock",
    type=click.Choice(["wall", "cpu"]),
    default="wall",
    show_default=True,
    help="Time that counts: that of the wall clock or of the processor.",
)
@click.option(
    "--volumes",
    metavar="'NAME=DIR ...'",
    multiple=True,
    help="Folder with one finished volume per case, such as k-edge.npy, and what they hold as options of recon score "
    "without dashes; as=basis stands for all basis functions of the scan; repeatable.",
)
@click.option(
    "--run",
    "commands",
    metavar="'NAME ...: COMMAND'",
    multiple=True,
    help="A command of your own with {dataset} and {out}, in the same time; repeatable.",
)
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [default: <folder>-score].")
@click.option("--resume", is_flag=True, help="Score what is missing in a folder that exists.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads of each method [default: all].")
@progress_options
@json_option
@debug_option
@grouped(programs=_Programs, output=_Output, printing=Printing)
def score(
    folder: Path,
    methods: str | None,
    budget: str | None,
    clock: str,
    programs: _Programs,
    output: _Output,
    threads: int | None,
    printing: Printing,
) -> None:
    """Score methods, and volumes of other programs, on all scans in FOLDER.

    Methods run as in recon compare: each in a process of its own, for the same time on each case. Scans that are not
    those of the suite are refused. Writes suite-score.json, .csv, .md and .png, and the runs in cases/.
    """
    from phantomgen.runtime.plain_json import to_json
    from recon.comparison.contenders.contender import contenders
    from recon.comparison.contenders.other_program import command_program, finished_volume
    from recon.comparison.outcome import parse_budgets
    from recon.suite.run import FIGURE, Wanted, score_suite
    from recon.suite.scans import read_scans
    from recon.suite.table import page

    if output.out is not None:
        check_run_name(output.out)
    others = (
        *(finished_volume(text, "--volumes") for text in programs.volumes),
        *map(command_program, programs.commands),
    )
    words = methods or ("" if others else _METHODS)
    ours = contenders(words.split(",")) if words else ()
    budgets = None if budget is None else parse_budgets(budget)
    scans = read_scans(folder)
    wanted = Wanted(ours, others, budgets or (scans.seconds,), clock, threads)
    place = output.out or folder.resolve().with_name(f"{folder.resolve().name}-score")
    tell = stderr_printer(printing.silent)
    results = score_suite(scans, place, wanted, resume=output.resume, overwrite=output.overwrite, tell=tell)
    if printing.as_json:
        click.echo(to_json({"score": str(place), **results}))
    else:
        click.echo(page(results))
        click.echo(f"Wrote {place}; next: look at {place / FIGURE}")


@suite.command(
    epilog="\b\nExamples:\n  recon suite table suite-v1-minutes-score their-score\n"
    "  recon suite table a.json b.json -o both"
)
@click.argument("results", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [default: none, only print].")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@json_option
@debug_option
def table(results: tuple[Path, ...], out: Path | None, overwrite: bool, as_json: bool) -> None:
    """Merge RESULTS of several submissions into one table.

    RESULTS are folders of recon suite score, or their suite-score.json. They must be of the same suite, tier and hash.
    """
    from phantomgen.runtime.plain_json import to_json
    from recon.suite.results import merged, read_results
    from recon.suite.run import check_merged_folder, write_results
    from recon.suite.table import page

    found = merged([read_results(path) for path in results])
    if out is not None:
        check_merged_folder(out, overwrite)
        out.mkdir(exist_ok=True)
        write_results(found, out)
    if as_json:
        click.echo(to_json(found))
        return
    click.echo(page(found))
    if out is not None:
        click.echo(f"Wrote {out}")
