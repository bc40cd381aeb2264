"""What a user should know of a finished run, in sentences: made of what the run knows, never of the truth.

Each sentence has a key that stays the same, for programs. A run without any of those that fail has found no fault.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import pi, sqrt
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.data.coverage import SIDES, Coverage
from recon.voxel.unreliable import Unreliable
from recon.voxel.unreliable import sentence as which_unreliable

CERTAIN = 5.0  # standard deviations by which chi-square must exceed what it should be
STARVED = 0.01  # of the rays through the object
SPARSE = 0.5  # rays over voxels of a slice of the object
SOMETHING = 0.1  # of the mean of what is well filled; voxels with more hold something


@dataclass(frozen=True)
class Remark:
    """A sentence of the verdict.

    Parameters
    ----------
    key : ``misfit``, ``misfit_marked``, ``truncated``, ``outside_grid``, ``starved``, ``unreliable``, ``few_views``,
        ``note`` or ``bases_left_out``
    sentence : for the user
    failed : whether a check failed; otherwise it is good to know
    """

    key: str
    sentence: str
    failed: bool = True


Verdict = tuple[Remark, ...]


def verdict_of(
    channels: Mapping[str, Mapping[str, Any]],
    dispersion: float,
    coverage: Coverage | None,
    volumes: Float[np.ndarray, "basis z y x"],
    views: int,
    fitted: Sequence[str],
    stated: Sequence[str],
    notes: Sequence[str] = (),
    unreliable: Unreliable | None = None,
) -> Verdict:
    """All remarks on a run.

    Parameters
    ----------
    channels : scores on test views, as `recon.evaluation.metrics.score_projections` gives them
    dispersion : relative model error that the recipe concedes
    coverage : what the scan covers; None where nobody has looked
    volumes : the result on the grid that was asked for [1/mm]
    views : that were fitted
    fitted, stated : names of the bases of the result, and of the dataset
    notes : sentences of the fit
    unreliable : voxels whose bases the counts do not tell
    """
    marked = None if unreliable is None else unreliable.record()
    found = [misfit(channels, dispersion)]
    if marked is not None:
        told = Remark("unreliable", which_unreliable(marked), failed=False)
        found += [misfit_marked(channels, marked, dispersion), told]
    found += [few_views(volumes, views), bases_left_out(fitted, stated)]
    if coverage is not None:
        found = [truncated(coverage), outside_grid(coverage), starved(coverage), *found]
    return tuple(remark for remark in (*found, *(Remark("note", note) for note in notes)) if remark is not None)


def misfit(channels: Mapping[str, Mapping[str, Any]], dispersion: float) -> Remark | None:
    """Test views are explained worse than noise and the model error that the recipe concedes would leave them.

    Off edges chi-square has the mean 1 + dispersion^2 Y of counts Y whose variance is Y + (dispersion Y)^2, and of n
    rays a standard deviation of sqrt(2 / n) times that.
    """
    far = _unexplained(channels, "away", dispersion)
    if not far:
        return None
    named = ", ".join(f"{value:.3g} in {name}" for name, value in far)
    return Remark(
        "misfit",
        f"The model does not explain the test views: away from edges chi-square is {named}, where noise leaves 1; "
        "do not trust the volumes before the cause is found (truncation, scatter, motion, or a wrong spectrum).",
    )


def misfit_marked(
    channels: Mapping[str, Mapping[str, Any]], marked: Mapping[str, Any], dispersion: float
) -> Remark | None:
    """Rays through marked voxels are explained worse than noise and the conceded model error would leave them.

    The limit is that of `misfit`. These rays lie at edges, which `misfit` leaves out, as the rims of ordinary things
    are in no pixel exactly; but metal spoils what is beside it by what it leaves unexplained.
    """
    far = _unexplained(channels, "marked", dispersion)
    if not far:
        return None
    name, worst = max(far, key=lambda pair: pair[1])
    which = " or ".join(word for key, word in (("metal", "metal"), ("starved", "few photons")) if marked[key])
    return Remark(
        "misfit_marked",
        f"The model does not explain the test views through the {marked['voxels']} voxels of {which}: chi-square of "
        f"these rays is up to {worst:.3g} ({name}), where noise leaves 1; what is missing there becomes "
        "streaks and wrong bases beside them: do not trust values near them, and take smaller pixels and voxels to "
        "come closer.",
    )


def _unexplained(channels: Mapping[str, Mapping[str, Any]], rays: str, dispersion: float) -> list[tuple[str, float]]:
    """Channels, and their chi-square, where it exceeds what noise and a conceded model error leave of some rays."""
    far = []
    for name, scores in channels.items():
        found, number, counts = (scores.get(f"{key}_{rays}") for key in ("chi_square", "rays", "counts"))
        if found is None or not number or counts is None:
            continue
        if found > (1 + dispersion**2 * counts) * (1 + CERTAIN * sqrt(2 / number)):
            far.append((name, found))
    return far


def truncated(coverage: Coverage) -> Remark | None:
    """The object leaves the panel."""
    if not (coverage.lateral or coverage.axial):
        return None
    sides = [name for name, part in zip(SIDES, coverage.sides, strict=True) if part]
    part = max(coverage.lateral, coverage.axial)
    return Remark(
        "truncated",
        f"The object leaves the panel ({', '.join(sides)}) in {100 * part:.0f} % of the views: what lies beyond is "
        "known only roughly, by a margin that is fitted and cut off; trust what all views see, and take a wider panel "
        "or a larger distance where more is needed.",
    )


def outside_grid(coverage: Coverage) -> Remark | None:
    """The object is larger than the grid."""
    if not coverage.outside:
        return None
    z, y, x = ((n * s) for n, s in zip(coverage.grid.shape, coverage.grid.spacing, strict=True))
    return Remark(
        "outside_grid",
        f"The object is larger than the grid: {100 * coverage.outside:.1f} % of the rays through it miss the grid; "
        f"a grid of {z:.0f} x {y:.0f} x {x:.0f} mm (z, y, x) would hold it.",
    )


def starved(coverage: Coverage) -> Remark | None:
    """Hardly a photon passed some of the object."""
    if coverage.starved <= STARVED:
        return None
    return Remark(
        "starved",
        f"Hardly any photon arrives on {100 * coverage.starved:.1f} % of the rays through the object: what lies there "
        "is guessed from other directions; more exposure or a harder spectrum would help.",
    )


def few_views(volumes: Float[np.ndarray, "basis z y x"], views: int) -> Remark | None:
    """A slice of the object has many more voxels than rays of a voxel's width that cross it.

    An object of diameter D voxels has pi D^2 / 4 of them, and each view crosses it by D rays. Even pieces and
    non-negative values make up for some of what is missing, not for most of it.
    """
    density = volumes.sum(axis=0)
    if not (density > 0).any():
        return None
    filled = density > SOMETHING * density[density > density.mean()].mean()
    voxels = np.count_nonzero(filled, axis=(1, 2)).max()
    diameter = 2 * sqrt(voxels / pi)
    if views * diameter >= SPARSE * voxels:
        return None
    return Remark(
        "few_views",
        f"{views} views are few for a grid this fine: a slice of the object has {voxels} voxels and is crossed by "
        f"{views * diameter:.0f} rays of their width; larger voxels or at least {SPARSE * voxels / diameter:.0f} views "
        "would do.",
    )


def bases_left_out(fitted: Sequence[str], stated: Sequence[str]) -> Remark | None:
    """The result lacks bases that the dataset states."""
    missing = [name for name in stated if name not in fitted]
    if not missing:
        return None
    return Remark(
        "bases_left_out",
        f"Of the bases that the scan states, {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not fitted: "
        "the result has none of it, whatever the object holds.",
        failed=False,
    )


def record(verdict: Verdict) -> list[dict[str, Any]]:
    """For ``metrics.json``."""
    return [asdict(remark) for remark in verdict]


def failed(metrics: Mapping[str, Any]) -> bool:
    """Whether a check of a run has failed, by its metrics."""
    return any(remark["failed"] for remark in metrics.get("verdict", ()))


def lines(metrics: Mapping[str, Any]) -> list[str]:
    """The verdict as a summary shows it."""
    if "verdict" not in metrics:
        return []
    remarks = metrics["verdict"]
    shown = [f"{'Warning' if remark['failed'] else 'Note'}: {remark['sentence']}" for remark in remarks]
    return shown if failed(metrics) else [*shown, "Verdict: no check of the scan and the fit failed."]
