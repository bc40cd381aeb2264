"""Files of an edge search: JSON, and a figure of the profile likelihoods."""

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset
from phantomgen.display.figures.style import BASIS_LINES, GRAY, figure_file, write_csv
from phantomgen.runtime.outputs import check_name, check_output
from phantomgen.runtime.plain_json import write_json
from recon.kedge.choose_basis import BasisChoice
from recon.kedge.profile_likelihood import EdgeProfile
from spectra.errors import InputError


def parse_edges(text: str | None) -> tuple[float, ...] | None:
    """Read the value of ``--edge``.

    Parameters
    ----------
    text : ``auto``, or energies with commas between [keV]; None without the option

    Returns
    -------
    energies [keV], none for ``auto``; None without the option

    Raises
    ------
    InputError
        When the text is none of these.
    """
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
    """Summarise the choice of a basis with its profiles.

    Parameters
    ----------
    choice : the choice

    Returns
    -------
    its record; by edge the energies that were tried [keV], and the deviance of all rays above the least
    """
    profiles = {
        name: {"energy_keV": p.energy.tolist(), "deviance": (p.peak - p.saved).tolist()} for name, p in choice.profiles
    }
    return {**choice.record(), "profiles": profiles}


def draw_choice(choice: BasisChoice, dataset: Dataset, path: Path) -> list[Path]:
    """Draw the profiles of the edges that were found.

    Parameters
    ----------
    choice : the choice
    dataset : an open dataset
    path : path of the PNG

    Returns
    -------
    paths that were written, none without edges
    """
    if not choice.profiles:
        return []
    spectra = dataset.spectra
    return [edge_profiles(choice.profiles, sorted({*spectra.lower, *spectra.upper}), path)]


def edge_profiles(profiles: Sequence[tuple[str, EdgeProfile]], thresholds: Sequence[float], path: Path) -> Path:
    """Draw the deviance per ray above its least value over the energy of the edge, and the surroundings of the minimum.

    In the right panel, lines are parabolas of the stated width, and points are computed values summed over rays.

    Parameters
    ----------
    profiles : name and profile of each edge
    thresholds : energies where a channel begins or ends [keV]
    path : path of the PNG; the curves are written beside it as CSV

    Returns
    -------
    path of the PNG
    """
    with figure_file(path, (7.0, 3.0)) as figure:
        whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
        highest = 0.0  # without the few energies at which the fit of a ray did not converge
        for (name, profile), (colour, style) in zip(profiles, BASIS_LINES * len(profiles), strict=False):
            above = profile.peak - profile.saved
            whole.plot(
                profile.energy, above / max(profile.rays, 1), color=colour, linestyle=style, label=_label(profile)
            )
            highest = max(highest, float(np.quantile(above, 0.9)) / max(profile.rays, 1))
            reach = _reach(profile)
            near = np.abs(profile.energy - profile.best) <= reach
            close.plot(profile.energy[near] - profile.best, above[near], "o", color=colour, markersize=3)
            beside = np.linspace(-reach, reach, 201)
            width = np.where(beside < 0, profile.best - profile.low, profile.high - profile.best)
            close.plot(beside, (beside / width) ** 2, color=colour, linestyle=style, linewidth=0.8)
            close.axvspan(profile.low - profile.best, profile.high - profile.best, color=colour, alpha=0.15)
            write_csv(path.with_name(f"{path.stem}_{name}.csv"), {"energy_keV": profile.energy, "deviance": above})
        for threshold in thresholds:
            whole.axvline(threshold, color=GRAY, linewidth=0.6, zorder=0)
        whole.set(xlabel="energy of the edge [keV]", ylabel="deviance per ray above the least")
        whole.set_ylim(0, 1.2 * highest or None)
        whole.legend()
        close.axhline(1, color=GRAY, linewidth=0.6)
        close.set(xlabel="distance from the likeliest energy [keV]", ylabel="deviance above the least", ylim=(0, 5))
    return path


def _label(profile: EdgeProfile) -> str:
    return f"{profile.best:.2f} keV ± {profile.sigma:.2g}"


def _reach(profile: EdgeProfile) -> float:
    """Half the range of the right panel [keV]: 2.2 times the width, or the points beside the best one."""
    beside = np.sort(np.abs(profile.energy - profile.best))[: min(3, len(profile.energy))]
    return max(2.2 * profile.sigma, float(beside[-1]))


class EdgeFiles:
    """Names of the files of a search; files that exist are refused at once.

    Parameters
    ----------
    stem : path of the files without suffix
    overwrite : whether to replace files that exist
    """

    def __init__(self, stem: Path, overwrite: bool) -> None:
        check_name(stem)
        self.json, self.figure = (stem.with_name(stem.name + suffix) for suffix in (".json", ".png"))
        self.written: Sequence[Path] = ()
        for path in (self.json, self.figure):
            check_output(path, overwrite)

    def write(self, choice: BasisChoice, dataset: Dataset, figures: bool) -> dict[str, Any]:
        """Write the JSON file, and the figure if it is wanted.

        Parameters
        ----------
        choice : the choice of a basis
        dataset : an open dataset
        figures : whether to draw

        Returns
        -------
        content of the JSON file
        """
        record = {"dataset": dataset.path.name, **choice_record(choice)}
        write_json(self.json, record)
        self.written = [self.json, *(draw_choice(choice, dataset, self.figure) if figures else [])]
        return record
