"""The command ``recon compare``: parse, call, print."""

import json
from dataclasses import dataclass
from pathlib import Path

import click

from phantomgen.cli.common import Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import stderr_printer
from recon.cli.run_argument import check_run_name

CHECK_FAILED = 3  # exit code of a finished comparison in which a requirement is not met
_METHODS = "fdk,cgls,pdhg-tv,one-step,gaussian"
_ONE_CHANNEL = "fdk-water,nmar,polyner,gaussian-poly,one-step+curve,gaussian+curve"  # of a scan with one channel


@dataclass(frozen=True)
class _Rules:
    """Who takes part, for how long, and how results are scored."""

    methods: str | None
    study: str | None
    budget: str
    protocol: str
    clock: str


@dataclass(frozen=True)
class _Programs:
    """Volumes and commands of other programs, and what must not be worse."""

    finished: tuple[str, ...]
    commands: tuple[str, ...]
    require: tuple[str, ...]


@dataclass(frozen=True)
class _Output:
    """The folder that is written."""

    out: Path | None
    resume: bool
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  recon compare kedge.h5 --budget 60s,240s\n"
    "  recon compare kedge-small.h5 --methods fdk,sart+image,gaussian+2,gaussian --budget 20s --clock cpu --threads 1\n"
    "  recon compare kedge.h5 --with 'tigre=fdk.npy as=mono:60 units=1/mm axes=zyx same-grid'\n"
    "  recon compare kedge.h5 --run 'mine as=mono:60 units=1/mm axes=zyx same-grid: python mine.py {dataset} {out}'"
)
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--methods",
    metavar="NAME,...",
    help=f"Methods to compare; see docs/howto/compare.md [default: {_METHODS}; of one channel {_ONE_CHANNEL}].",
)
@click.option("--study", metavar="NAME", help="A table of the paper in place of --methods; see docs/howto/compare.md.")
@click.option("--budget", metavar="SECONDS,...", default="60s", show_default=True, help="Time of each method.")
@click.option("--protocol", default="honest", show_default=True, help="Definition of the scores: honest, paper or r2.")
@click.option(
    "--clock",
    type=click.Choice(["wall", "cpu"]),
    default="wall",
    show_default=True,
    help="Time that counts: that of the wall clock or of the processor.",
)
@click.option(
    "--with",
    "finished",
    metavar="'NAME=PATH ...'",
    multiple=True,
    help="A finished volume, and what it holds as options of recon score without dashes; repeatable.",
)
@click.option(
    "--run",
    "commands",
    metavar="'NAME ...: COMMAND'",
    multiple=True,
    help="A command of your own with {dataset} and {out}, in the same budgets; repeatable.",
)
@click.option("--require", metavar="NAME", multiple=True, help="Exit with 3 unless gaussian is above it; repeatable.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Folder to write [default: <dataset>-compare].")
@click.option("--resume", is_flag=True, help="Run what is missing in a folder that exists.")
@click.option("--overwrite", is_flag=True, help="Replace a folder that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads of each method [default: all].")
@progress_options
@json_option
@debug_option
@grouped(rules=_Rules, programs=_Programs, output=_Output, printing=Printing)
def compare(
    dataset: Path,
    rules: _Rules,
    programs: _Programs,
    output: _Output,
    threads: int | None,
    printing: Printing,
) -> None:
    """Run methods on DATASET at equal time budgets, and score them.

    Every method runs in a process of its own, on the same training views and with the same projector. Its result at the
    end of a budget is scored; the time of scoring does not count. Volumes and commands of other programs stand in the
    same tables by --with and --run. Writes compare.json, compare.csv, compare.md and a figure of error against time.
    """
    from recon.comparison.campaign import Campaign
    from recon.comparison.contenders.contender import contenders
    from recon.comparison.contenders.other_program import check_names, command_program, finished_volume
    from recon.comparison.outcome import parse_budgets, requirements, write_outcome
    from recon.comparison.scoring.protocols import protocol_named
    from recon.comparison.scoring.stated import check_programs
    from recon.comparison.studies import study_named

    if rules.methods is not None and rules.study is not None:
        raise click.UsageError("Give either --methods or --study.")
    if output.out is not None:
        check_run_name(output.out)
    protocol_named(rules.protocol)
    chosen = None if rules.study is None else study_named(rules.study, dataset)
    words = _usual_methods(dataset) if rules.methods is None else rules.methods
    ours = contenders(words.split(",")) if chosen is None else chosen.contenders
    others = (*map(finished_volume, programs.finished), *map(command_program, programs.commands))
    check_names(others)
    who = (*ours, *others)
    budgets = parse_budgets(rules.budget)
    named = {other.name: other for other in others}
    required = tuple(named.get(name) or contenders([name])[0] for name in programs.require)
    folder = output.out or Path(f"{dataset.stem}-{rules.study or 'compare'}")
    if others:
        check_programs(others, dataset)
    stated = tuple(dict.fromkeys(other.statement["as"] for other in others if "as" in other.statement))
    campaign = Campaign(dataset, folder, rules.clock, threads, output.resume, output.overwrite, stated)
    campaign.run(who, budgets, stderr_printer(printing.silent))
    results = campaign.results(who, budgets)
    text = write_outcome(campaign, results, rules.protocol, chosen)
    failed = requirements(results, required, budgets[-1], rules.protocol)
    if printing.as_json:
        click.echo(
            json.dumps({"compare": str(folder), "protocol": rules.protocol, "failed": failed, "results": results})
        )
    else:
        click.echo(text)
        for sentence in failed:
            click.echo(sentence, err=True)
        click.echo(f"Wrote {folder}; next: look at {folder / 'figures' / 'error-against-time.png'}")
    if failed:
        raise click.exceptions.Exit(CHECK_FAILED)


def _usual_methods(path: Path) -> str:
    """Methods that are compared where none are named."""
    from phantomgen.dataset.reader import open_dataset

    with open_dataset(path) as dataset:
        return _ONE_CHANNEL if len(dataset.spectra.channels) == 1 else _METHODS
