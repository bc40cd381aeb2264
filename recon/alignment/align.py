"""From a scan to the poses that its projections ask for: coarse to fine, with uncertainties."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.writing.corrected_copy import CorrectedCopy
from phantomgen.geometry.poses import Geometry
from recon.alignment.estimate import Estimate, gauss_newton, misfit
from recon.alignment.levels import Level, factors
from recon.alignment.log_projections import SummedCounts
from recon.alignment.panel_errors import COLUMNS, ERRORS, NAMES, Change, changed, checked_names
from spectra.errors import InputError

SEARCHED = 0.15  # of the columns, to both sides: shifts along the columns that are tried first; chosen by hand
FEWEST_VIEWS = 8  # views below which no alignment is tried; chosen by hand

_LEFT_ALONE = "shift along the rows, distances, rotations of the panel out of its plane: not estimated, left as stated"

OnLevel = Callable[[int, int], object]  # number of the level, and of all levels


@dataclass(frozen=True, eq=False)
class Alignment:
    """Corrected poses of a scan.

    Parameters
    ----------
    change : correction that was applied: columns [pixel], turn [degree]; 0 where nothing was
    uncertainty : standard uncertainty of each number; NaN where it was not estimated
    geometry : corrected poses of all views
    stated : poses that the scan states
    sentences : what was left alone and why
    misfit : mean weighted squared difference between data and reprojections, before and after
    block : pixels along each side of the smallest blocks
    """

    change: Change
    uncertainty: Float[np.ndarray, " error"]
    geometry: Geometry
    stated: Geometry
    sentences: tuple[str, ...]
    misfit: tuple[float, float]
    block: int

    def lines(self) -> list[str]:
        """Format a table of the correction.

        Returns
        -------
        lines
        """
        lines = [f"{'correction of the panel':<36}{'value':>10}{'uncertainty':>13}"]
        for error, value, spread in zip(ERRORS, self.change, self.uncertainty, strict=True):
            about, spread_text = f"{error.about} [{error.unit}]", "-" if np.isnan(spread) else f"{spread:.2g}"
            lines.append(f"{about:<36}{value:>+10.4f}{spread_text:>13}")
        before, after = self.misfit
        lines.append(f"mean squared misfit of reprojections: {before:.3g} before, {after:.3g} after")
        return lines

    def record(self) -> dict[str, Any]:
        """Return the numbers by name.

        Returns
        -------
        values, uncertainties and units of each error, and the rest
        """
        numbers = {
            error.name: {
                "value": float(value),
                "uncertainty": None if np.isnan(spread) else float(spread),
                "unit": error.unit,
            }
            for error, value, spread in zip(ERRORS, self.change, self.uncertainty, strict=True)
        }
        return {
            "correction": numbers,
            "misfit": {"before": self.misfit[0], "after": self.misfit[1]},
            "pixels_per_block": self.block,
            "remarks": list(self.sentences),
        }

    def write(self, scan: Dataset, out: Path | str, *, overwrite: bool = False) -> Path:
        """Write a copy of the scan that states the corrected poses; its counts stay as they are.

        Parameters
        ----------
        scan : the scan, open
        out : name of the copy
        overwrite : replace a file that exists

        Returns
        -------
        the copy

        Raises
        ------
        InputError
            When the copy cannot be written.
        """
        with CorrectedCopy(scan.path, out, overwrite) as copy:
            copy.replace_geometry(self.stated, self.geometry)
            copy.write_history("recon align", self._phrases(), self.record())
            copy.finish(scan.spectra)
        return Path(out)

    def _phrases(self) -> list[str]:
        """List what was done, one phrase each."""
        done = [
            f"{error.about}: {value:+.4g} +- {spread:.2g} {error.unit}"
            for error, value, spread in zip(ERRORS, self.change, self.uncertainty, strict=True)
            if value != 0 and not np.isnan(spread)
        ]
        return [*done, *self.sentences]


def align(
    scan: Dataset,
    free: tuple[str, ...] = NAMES,
    *,
    block: int | None = None,
    on_level: OnLevel = lambda number, count: None,
) -> Alignment:
    """Estimate errors of the stated pose of the panel from the training views; no truth is read.

    Coarse shifts along the columns are tried first; Gauss-Newton steps follow at finer and finer resolution
    (`recon.alignment.estimate`). All else of the poses is left as it is stated.

    Parameters
    ----------
    scan : open dataset
    free : what is estimated, of ``columns`` and ``tilt``
    block : pixels along each side of the smallest blocks; so many that 40 blocks at most lie along a row where left out
    on_level : called before each level, with its number and the number of levels

    Returns
    -------
    the corrected poses, and how well they are known

    Raises
    ------
    InputError
        When the scan has too few views, or the data do not determine the panel.
    """
    places = checked_names(free)
    views = scan.splits["train"]
    if len(views) < FEWEST_VIEWS:
        raise InputError(f"{scan.path} has {len(views)} training views: an alignment needs at least {FEWEST_VIEWS}")
    counts = SummedCounts.of(scan, views)
    levels = factors(counts.geometry.panel.columns, counts.geometry.panel.rows, block)
    found, level = _through_levels(counts, levels, places, on_level)
    change, uncertainty = _with_uncertainty(found)
    kept, sentences = _worth_applying(change, uncertainty, places, scan)
    before = misfit(level, np.zeros(len(ERRORS)))
    return Alignment(
        kept,
        uncertainty,
        changed(scan.geometry, kept),
        scan.geometry,
        (*sentences, _LEFT_ALONE),
        (before, misfit(level, kept)),
        levels[-1],
    )


def _through_levels(
    counts: SummedCounts, levels: list[int], free: tuple[int, ...], on_level: OnLevel
) -> tuple[list[Estimate], Level]:
    """Estimates of all levels, and the last level."""
    change, found, level = np.zeros(len(ERRORS)), [], Level.of(counts, levels[0])
    for number, factor in enumerate(levels):
        on_level(number, len(levels))
        level = Level.of(counts, factor)
        if number == 0 and COLUMNS in free:
            change[COLUMNS] = _searched(level)
        found.append(gauss_newton(level, change, free))
        change = found[-1].change
    return found, level


def _with_uncertainty(found: list[Estimate]) -> tuple[Change, Change]:
    """Numbers and their standard uncertainties, NaN where they were not estimated.

    The difference of the last two levels stands for what the size of blocks and voxels does.
    """
    last, free = found[-1], list(found[-1].free)
    step = last.change[free] - found[-2].change[free] if len(found) > 1 else np.zeros(len(free))
    uncertainty = np.full(len(ERRORS), np.nan)
    uncertainty[free] = np.sqrt(last.uncertainty**2 + step**2)
    return last.change, uncertainty


def _worth_applying(
    change: Change, uncertainty: Change, places: tuple[int, ...], scan: Dataset
) -> tuple[Change, list[str]]:
    """Numbers that are known well enough, 0 for the others, and a sentence about each of those."""
    kept, sentences = np.zeros(len(ERRORS)), []
    for place in places:
        error, spread = ERRORS[place], uncertainty[place]
        if spread <= error.largest:
            kept[place] = change[place]
        elif place == COLUMNS:
            raise InputError(
                f"{scan.path}: the views tell the shift along the columns within {spread:.2g} pixel only: they see too "
                "little of the object, or too few rays twice"
            )
        else:
            sentences.append(f"{error.about}: left alone, as these views tell it within {spread:.2g} {error.unit} only")
    return kept, sentences


def _searched(level: Level) -> float:
    """Shift along the columns with the least misfit, in steps of a block."""
    most = int(SEARCHED * level.blocks.geometry.panel.columns)
    tried = [float(level.factor * n) for n in sorted(range(-most, most + 1), key=abs)]
    return min(tried, key=lambda columns: misfit(level, np.array([columns, 0.0])))
