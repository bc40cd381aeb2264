"""Provenance of a dataset: plan, measured error, and the programs that wrote it."""

import json
from typing import Any

import h5py

from phantomgen.dataset.checks.door import value_at
from phantomgen.dataset.layout import text_of
from phantomgen.dataset.reader import Dataset
from phantomgen.display.html import Code, Paragraph, Part, Table

_ERRORS = {
    "edge_rms": "edge pixels, rms",
    "edge_worst": "edge pixels, worst",
    "ray_rms": "single rays, rms",
    "ray_worst": "single rays, worst",
}


def plan_of(dataset: Dataset) -> dict[str, Any]:
    """Read the plan of the simulation.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    the plan; empty where the file has none
    """
    if "truth/plan/data" not in dataset.file:
        return {}
    return json.loads(text_of(value_at(dataset.file, "truth/plan/data")))


def plan_parts(dataset: Dataset) -> list[Part]:
    """Create the parts about the errors of the plan against their shares, and the measured error.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    parts of the page
    """
    plan = plan_of(dataset)
    if not plan:
        return []
    rows = [(part["part"], part["setting"], f"{part['error']:.1e}", f"{part['share']:.1e}") for part in plan["parts"]]
    rows.append(("together", "", f"{plan['error']:.1e}", f"{plan['tolerance']:.1e}"))
    caption = (
        "How finely each part was computed: the error of log projections that was measured when it was planned, and "
        "its share of the tolerance."
    )
    found: list[Part] = [Table(("part", "setting", "error", "share"), tuple(rows), caption, "plan")]
    measured = plan.get("measured") or {}
    if measured:
        words = (
            f"Log projections as they were made: {measured['edge_pixels']} edge pixels of {measured['views']} views "
            f"against {measured['sub_rays']} x {measured['sub_rays']} sub-rays and finer energies, and "
            f"{measured['rays']} random rays against finer energies."
        )
        errors = tuple((label, f"{measured[key]:.1e}") for key, label in _ERRORS.items())
        found.append(Table(("checked", "error"), errors, words, "measured_error"))
    return found


def provenance_parts(dataset: Dataset) -> list[Part]:
    """Create the parts about the programs that wrote the file, with their seeds and environments.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    parts of the page
    """
    processes = [(name, item) for name, item in dataset.file["entry"].items() if name.startswith("process_")]  # type: ignore[union-attr]
    found: list[Part] = []
    for name, group in processes:
        if isinstance(group, h5py.Group):
            found += _process(name, group)
    return found or [Paragraph("The file does not say what made it.")]


def _process(name: str, group: h5py.Group) -> list[Part]:
    """One program."""
    fields = {key: item for key, item in group.items() if isinstance(item, h5py.Dataset)}
    rows = tuple((key, _text(item)) for key, item in fields.items() if key != "sequence_index")
    parts: list[Part] = [Table(("what", "value"), rows, f"Where it comes from: {name}.", name)]
    if "environment/data" in group:
        parts.append(Code(f"Environment of {name}", text_of(value_at(group, "environment/data"))))
    return parts


def _text(item: h5py.Dataset) -> str:
    """Text of a field; phrases of a list one after the other."""
    return "; ".join(map(text_of, item[()])) if item.shape else text_of(item[()])
