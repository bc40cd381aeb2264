"""Scores of methods and of other programs on all scans of a suite, and the files with the results."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from phantomgen.runtime.outputs import check_output_folder
from phantomgen.runtime.plain_json import write_json
from recon.comparison.campaign import Campaign
from recon.comparison.contenders.contender import Contender
from recon.comparison.contenders.other_program import OtherProgram, check_names
from recon.comparison.scoring.stated import check_programs
from recon.suite.figure import cases_and_methods
from recon.suite.other_volumes import check_folders, on_scan
from recon.suite.results import RESULTS, Results, Row, missing_row, new_results, read_results, row
from recon.suite.scans import Scan, Scans
from recon.suite.table import page, write_csv
from spectra.errors import InputError

_CASES, _PAGE, _CSV, FIGURE = "cases", "suite-score.md", "suite-score.csv", "suite-score.png"

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Wanted:
    """What is to be scored, and how.

    Parameters
    ----------
    methods : of this project
    others : folders of volumes, and commands; ``as=basis`` stands for all basis functions of a scan
    budgets : time of each method on each scan [s]
    clock : ``wall`` or ``cpu``
    threads : number for each method; None for all
    """

    methods: tuple[Contender, ...]
    others: tuple[OtherProgram, ...]
    budgets: tuple[float, ...]
    clock: str = "wall"
    threads: int | None = None


def score_suite(
    scans: Scans, folder: Path, wanted: Wanted, *, resume: bool = False, overwrite: bool = False, tell: Tell = print
) -> Results:
    """Score on all scans what a folder lacks; files with the results are written after each scan.

    Parameters
    ----------
    scans : of the suite
    folder : to write in
    wanted : methods, volumes, time
    resume : go on in a folder that exists
    overwrite : replace a folder that exists
    tell : gets the progress, one sentence at a time

    Returns
    -------
    the results

    Raises
    ------
    InputError
        When the folder exists and neither is given, or is of another suite; when a volume cannot be read.
    """
    check_output_folder(folder, overwrite or resume, "recon suite score", _is_score, "score what is missing")
    check_names(wanted.others)
    check_folders(wanted.others, scans.each)
    for scan in scans.each:
        try:
            check_programs(_programs(scan, wanted.others), scan.path)
        except InputError as error:
            raise InputError(f"{scan.name}: {error}") from None
    if folder.exists() and overwrite:
        shutil.rmtree(folder)
    if folder.exists() and read_results(folder)["sha256"] != scans.sha256:
        raise InputError(f"{folder} holds results on other scans: choose another folder by --out, or add --overwrite")
    results = new_results(scans, folder.name, wanted.clock, wanted.threads)
    (folder / _CASES).mkdir(parents=True, exist_ok=True)
    if not _is_score(folder):
        write_json(folder / RESULTS, results)
    for scan in scans.each:
        tell(f"{scan.name}: {scan.what}")
        results["rows"] += _scored(scan, folder / _CASES / scan.name, wanted, lambda line: tell(f"  {line}"))
        write_results(results, folder)
    return results


def write_results(results: Results, folder: Path) -> str:
    """Write results as JSON, CSV, Markdown and figure.

    Parameters
    ----------
    results : of one submission or of several
    folder : that exists

    Returns
    -------
    the page in Markdown
    """
    text = page(results)
    (folder / _PAGE).write_text(text, encoding="utf-8")
    write_csv(folder / _CSV, results)
    cases_and_methods(results, folder / FIGURE)
    write_json(folder / RESULTS, results)
    return text


def check_merged_folder(folder: Path, overwrite: bool) -> None:
    """Refuse a folder for merged results that exists, or has the runs of a submission.

    Parameters
    ----------
    folder : to write in
    overwrite : whether merged results may be replaced

    Raises
    ------
    InputError
        When it may not be written.
    """
    check_output_folder(
        folder, overwrite, "recon suite table", lambda path: _is_score(path) and not (path / _CASES).exists()
    )


def _scored(scan: Scan, folder: Path, wanted: Wanted, tell: Tell) -> list[Row]:
    """Rows of one scan."""
    programs = _programs(scan, wanted.others)
    stated = tuple(dict.fromkeys(one.statement["as"] for one in programs if "as" in one.statement))
    campaign = Campaign(scan.path, folder, wanted.clock, wanted.threads, True, False, stated)
    who = (*wanted.methods, *programs)
    campaign.run(who, wanted.budgets, tell)
    rows = [row(scan, result) for result in campaign.results(who, wanted.budgets)]
    there = {program.name for program in programs}
    return rows + [missing_row(scan, one.name) for one in wanted.others if one.name not in there]


def _programs(scan: Scan, others: Sequence[OtherProgram]) -> tuple[OtherProgram, ...]:
    """Programs that have a volume of a scan, or make one."""
    return tuple(found for one in others if (found := on_scan(one, scan)) is not None)


def _is_score(folder: Path) -> bool:
    """Whether a folder was written by this command."""
    return (folder / RESULTS).is_file()
