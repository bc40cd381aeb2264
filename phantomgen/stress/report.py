"""Table and figure of hard cases."""

import json
from collections.abc import Sequence
from pathlib import Path

from phantomgen.display.figures.style import BLUE, RED, figure_file
from phantomgen.runtime.disk import complete_file
from phantomgen.stress.case import Outcome

FILES = ("stress.md", "stress.json", "stress.png")
_COLUMNS = 3


def table(outcomes: Sequence[Outcome]) -> str:
    """Format outcomes as a table in Markdown.

    Parameters
    ----------
    outcomes : of cases

    Returns
    -------
    the table
    """
    lines = ["| case | what | from | to | worst | limit | verdict | error |", "|---|---|---|---|---|---|---|---|"]
    for outcome in outcomes:
        case, points = outcome.case, outcome.points
        ends = f"{points[0].difficulty:g} | {points[-1].difficulty:g}"
        verdict = "passed" if outcome.passed else "FAILED"
        lines.append(
            f"| `{case.name}` | {case.what}: {case.difficulty} | {ends} | {outcome.worst:.1e} | {case.limit:g} "
            f"| {verdict} | {case.error} |"
        )
    return "\n".join(lines)


def write_report(outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write the table as Markdown and JSON, and one figure of error against difficulty.

    Parameters
    ----------
    outcomes : of cases
    folder : existing folder
    """
    records = [outcome.to_dict() for outcome in outcomes]
    for name, text in zip(FILES, (table(outcomes) + "\n", json.dumps(records, indent=1) + "\n"), strict=False):
        with complete_file(folder / name, Path(name).suffix) as beside:
            Path(beside).write_text(text, encoding="utf-8")
    draw(outcomes, folder / FILES[2])


def draw(outcomes: Sequence[Outcome], path: Path) -> None:
    """Draw error against difficulty, one panel per case; a broken line marks the limit.

    Parameters
    ----------
    outcomes : of cases
    path : the picture
    """
    rows = -(-len(outcomes) // _COLUMNS)
    with figure_file(path, (7.0, 1.7 * rows)) as figure:
        panels = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
        for panel in panels[len(outcomes) :]:
            panel.remove()
        for panel, outcome in zip(panels, outcomes, strict=False):
            case = outcome.case
            difficulty = [point.difficulty for point in outcome.points]
            floor = min(case.limit / 10, *(point.error for point in outcome.points if point.error > 0), case.limit)
            errors = [max(point.error, floor / 2) for point in outcome.points]
            ranks = range(len(difficulty))  # from easy to hard, whichever way the numbers go
            panel.semilogy(ranks, errors, "o-", color=BLUE, markersize=3)
            panel.axhline(case.limit, color=RED, linestyle="--", linewidth=0.8)
            shown = sorted({0, len(difficulty) // 2, len(difficulty) - 1})
            panel.set_xticks(shown, [f"{difficulty[i]:.3g}" for i in shown])
            panel.set_title(case.name)
            panel.set_xlabel(case.difficulty)
        for row in range(rows):
            panels[row * _COLUMNS].set_ylabel("error")
