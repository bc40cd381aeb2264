"""Files of a finished comparison, and the check of requirements."""

from collections.abc import Sequence
from typing import Any

from phantomgen.runtime.plain_json import write_json
from recon.comparison.campaign import Campaign
from recon.comparison.contenders.contender import GAUSSIAN, Contender
from recon.comparison.contenders.other_program import OtherProgram
from recon.comparison.scoring.lpips import missing
from recon.comparison.studies import Study
from recon.comparison.tables.figure import error_against_time
from recon.comparison.tables.table import mean_psnr, report, write_csv
from spectra.errors import InputError

Result = dict[str, Any]


def parse_budgets(text: str) -> tuple[float, ...]:
    """Read times from the text of an option.

    Parameters
    ----------
    text : such as ``60s,240s`` or ``1m``

    Returns
    -------
    times in ascending order [s]

    Raises
    ------
    InputError
        When a part is not a positive time.
    """
    found = set()
    for part in text.split(","):
        digits, factor = part.strip().removesuffix("s"), 1.0
        if part.strip().endswith("m"):
            digits, factor = part.strip()[:-1], 60.0
        try:
            seconds = factor * float(digits)
        except ValueError:
            seconds = 0.0
        if not 0 < seconds < float("inf"):
            raise InputError(f"--budget takes times above 0 such as 60s,240s, got {part.strip()!r}")
        found.add(seconds)
    return tuple(sorted(found))


def write_outcome(campaign: Campaign, results: Sequence[Result], protocol: str, study: Study | None) -> str:
    """Write all files of a comparison.

    Parameters
    ----------
    campaign : folder and settings
    results : of `recon.comparison.campaign.Campaign.results`
    protocol : whose scores the tables show, see `recon.comparison.scoring.protocols`
    study : whose table comes first; None for no study

    Returns
    -------
    the page in Markdown
    """
    folder, settings = campaign.folder, campaign.settings
    threads = "all threads" if settings.threads is None else f"{settings.threads} thread(s)"
    unit = "processor time" if settings.clock == "cpu" else "wall time"
    page = report(results, protocol, f"{settings.dataset}: methods at equal {unit}, {threads}")
    if study is not None:
        page = f"{study.page(results, protocol)}\n\n{page}"
    if (absent := missing()) is not None:
        page += f"\n{absent}.\n"
    (folder / "compare.md").write_text(page, encoding="utf-8")
    write_json(folder / "compare.json", {"settings": vars(settings), "protocol": protocol, "results": list(results)})
    write_csv(folder / "compare.csv", results)
    error_against_time(results, folder / "figures" / "error-against-time.png", settings.clock)
    return page


def requirements(
    results: Sequence[Result], required: Sequence[Contender | OtherProgram], budget: float, protocol: str
) -> list[str]:
    """List the contenders that the fit of Gaussians does not exceed at a budget.

    The fit exceeds a contender when its mean PSNR of the basis volumes is larger; without a truth, that of the test
    views.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    required : contenders that the fit must exceed
    budget : [s]
    protocol : whose scores count

    Returns
    -------
    a sentence for each contender that it does not exceed
    """
    ours = _psnr_at(results, GAUSSIAN, budget, protocol)
    failed = []
    for who in map(str, required):
        theirs = _psnr_at(results, who, budget, protocol)
        if ours is None or theirs is None:
            lacking = GAUSSIAN if ours is None else who
            failed.append(f"{GAUSSIAN} cannot be compared with {who} at {budget:g} s: {lacking} has no score.")
        elif not ours > theirs:
            failed.append(f"{GAUSSIAN} is not above {who} at {budget:g} s: {ours:.2f} dB and {theirs:.2f} dB.")
    return failed


def _psnr_at(results: Sequence[Result], who: str, budget: float, protocol: str) -> float | None:
    """Mean PSNR of basis volumes, or of test views; None where there is neither."""
    own = next((r for r in results if r["contender"] == who and r["budget"] in (budget, None)), {})
    bases = mean_psnr(own, "basis", protocol)
    return bases if bases is not None else mean_psnr(own, "views", protocol)
