"""Compute hard cases, and write what they found."""

from collections.abc import Sequence
from pathlib import Path

from tqdm.auto import tqdm

from phantomgen.runtime.outputs import check_output_folder
from phantomgen.stress.case import Case, Outcome
from phantomgen.stress.report import FILES, write_report


def run_cases(
    cases: Sequence[Case],
    out: Path | None = None,
    *,
    overwrite: bool = False,
    command: str = "phantomgen stress",
    progress: bool = False,
) -> tuple[Outcome, ...]:
    """Compute cases, and write table and figure where a folder is named; of finished cases also when interrupted.

    Parameters
    ----------
    cases : to compute
    out : folder of the report; None for none
    overwrite : replace a report that exists
    command : whose report may be replaced
    progress : show a bar on stderr

    Returns
    -------
    their outcomes

    Raises
    ------
    InputError
        When the folder exists, and is not to be replaced or is no report.
    """
    if out is not None:
        check_output_folder(out, overwrite, command, lambda folder: (folder / FILES[0]).is_file())
    bar = tqdm(cases, desc="stress", unit="case", disable=None if progress else True)
    outcomes = []
    try:
        for case in bar:
            bar.set_postfix_str(case.name)
            outcomes.append(case.run())
    finally:
        if out is not None and outcomes:
            out.mkdir(exist_ok=True)
            write_report(outcomes, out)
    return tuple(outcomes)
