"""Scores of the material maps of `recon segment`, where a run has them: overlap and confusion."""

import json
from pathlib import Path
from typing import Any

from phantomgen.display.html import Part, Table
from phantomgen.display.html.content import csv_of
from recon.output.report.case import Case, LeftOut, Parts, number

TABLE = Path("segment", "materials.json")


def parts(case: Case) -> Parts:
    """Create tables of Dice coefficients and confusion of every run that has them.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When no run has scored material maps.
    """
    found: list[Part] = []
    for run in case.runs:
        scores = _scores(run.folder / TABLE)
        if scores:
            found += [_overlap(case.who(run), scores), _confusion(case.who(run), scores)]
    if not found:
        raise LeftOut("no run has scored material maps in its folder segment")
    return tuple(found)


def _scores(path: Path) -> dict[str, Any]:
    """Scores of a segmentation; none where the file is missing or of another kind."""
    try:
        scores = json.loads(path.read_text(encoding="utf-8")).get("scores") or {}
    except (OSError, ValueError, AttributeError):
        return {}
    known = isinstance(scores, dict) and {"rows", "columns", "voxels"} <= set(scores.get("confusion") or {})
    return scores if known and isinstance(scores.get("materials"), dict) else {}


def _overlap(who: str, scores: dict[str, Any]) -> Table:
    """Table of the cluster of each material, with their overlap."""
    header = ("material", "segmented as", "Dice", "voxels")
    rows = [(name, s.get("cluster") or "–", s.get("dice"), s.get("voxels")) for name, s in scores["materials"].items()]
    shown = tuple((name, cluster, number(dice, ".3f"), number(voxels, "d")) for name, cluster, dice, voxels in rows)
    caption = f"{who}Dice coefficient of every material with the segment that is matched to it."
    return Table(header, shown, caption, "dice", csv_of(header, rows))


def _confusion(who: str, scores: dict[str, Any]) -> Table:
    """Table of voxels by their true material and by their segment."""
    table = scores["confusion"]
    header = ("true", *map(str, table["columns"]))
    rows = [(name, *counts) for name, counts in zip(table["rows"], table["voxels"], strict=True)]
    shown = tuple((str(name), *(number(count, ",d") for count in counts)) for name, *counts in rows)
    return Table(
        header, shown, f"{who}Confusion: voxels of each material by segment.", "confusion", csv_of(header, rows)
    )
