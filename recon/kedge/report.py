"""What an edge search writes: JSON, and a figure."""

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from phantomgen.dataset.reader import Dataset
from phantomgen.runtime.outputs import check_output
from phantomgen.runtime.plain_json import write_json
from recon.kedge.choose_basis import BasisChoice
from recon.kedge.figure import edge_profiles
from spectra.errors import InputError


def parse_edges(text: str | None) -> tuple[float, ...] | None:
    """``auto`` or energies with commas between [keV]; None where nothing is said."""
    if text is None:
        return None
    if text.strip() == "auto":
        return ()
    try:
        edges = tuple(float(part) for part in text.split(","))
    except ValueError:
        edges = ()
    if not edges or not all(isfinite(edge) and edge > 0 for edge in edges):
        raise InputError(f"--edge takes auto, or energies in keV such as 63.3 or 33,50, got {text!r}")
    return edges


def choice_record(choice: BasisChoice) -> dict[str, Any]:
    """The decision with its profiles: energies tried [keV], and the deviance of all rays above the least."""
    profiles = {
        name: {"energy_keV": p.energy.tolist(), "deviance": (p.peak - p.saved).tolist()} for name, p in choice.profiles
    }
    return {**choice.record(), "profiles": profiles}


def draw_choice(choice: BasisChoice, dataset: Dataset, path: Path) -> list[Path]:
    """The profiles of the edges that were found; nothing without any."""
    if not choice.profiles:
        return []
    spectra = dataset.spectra
    return [edge_profiles(choice.profiles, sorted({*spectra.lower, *spectra.upper}), path)]


class EdgeFiles:
    """Names of the files of a search; refused at once where they are taken.

    Parameters
    ----------
    stem : of the names
    overwrite : replace files that exist
    """

    def __init__(self, stem: Path, overwrite: bool) -> None:
        self.json, self.figure = (stem.with_name(stem.name + suffix) for suffix in (".json", ".png"))
        self.written: Sequence[Path] = ()
        for path in (self.json, self.figure):
            check_output(path, overwrite)

    def write(self, choice: BasisChoice, dataset: Dataset, figures: bool) -> dict[str, Any]:
        """Write JSON, and the figure if it is wanted; returns what the JSON holds."""
        record = {"dataset": dataset.path.name, **choice_record(choice)}
        write_json(self.json, record)
        self.written = [self.json, *(draw_choice(choice, dataset, self.figure) if figures else [])]
        return record
