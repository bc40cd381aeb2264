"""Verdict on a finished run, in sentences for a user, from what the run knows and never from the truth.

Each sentence has a key that stays the same, for programs. A run passes if no sentence reports a failed check.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import pi, sqrt
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.data.coverage import SIDES, Coverage
from recon.voxel.unreliable import Unreliable
from recon.voxel.unreliable import sentence as which_unreliable

# standard deviations by which chi-square must exceed its expectation; chosen by hand, so that noise fails no run
CERTAIN = 5.0
STARVED = 0.01  # of the rays through the object; more with hardly any counts fail the check; chosen by hand
UNSEEN = 0.05  # of the directions that interfaces can face; more that no view sees fail the check; chosen by hand
# no unit; rays of a voxel's width over voxels in a slice of the object; fewer fail the check; chosen by hand
SPARSE = 0.5
# no unit, over the mean density of the denser voxels; voxels with more belong to the object; chosen by hand
OBJECT_DENSITY = 0.1


@dataclass(frozen=True)
class Remark:
    """A sentence of the verdict.

    Parameters
    ----------
    key : ``misfit``, ``unchecked``, ``misfit_marked``, ``truncated``, ``outside_grid``, ``starved``, ``limited_angle``,
        ``unreliable``, ``few_views``, ``note`` or ``bases_left_out``
    sentence : the sentence for a user
    failed : whether a check failed; otherwise the sentence is a note
    """

    key: str
    sentence: str
    failed: bool = True


Verdict = tuple[Remark, ...]

UNCHECKED = Remark(
    "unchecked",
    "No test views were scored, so that nothing tells whether the model explains rays beside those that it was fitted "
    "to; a scan with some says more.",
    failed=False,
)


@dataclass(frozen=True, eq=False)
class FitOutcome:
    """Result of a fit, with what the verdict depends on.

    Parameters
    ----------
    channels : scores on test views, see `recon.evaluation.metrics.score_projections`; empty where none were scored
    dispersion : relative model error that the recipe concedes [no unit]
    volumes : the result on the requested grid [1/mm]
    views : number of views that were fitted
    fitted, stated : names of the bases of the result, and of the dataset
    coverage : coverage of the object by the scan; None where it was not computed
    unreliable : voxels whose bases the counts do not determine; None where there are none
    notes : sentences of the fit
    fitted_channels : the same scores on some fitted views, which tell where there are no others
    """

    channels: Mapping[str, Mapping[str, Any]]
    dispersion: float
    volumes: Float[np.ndarray, "basis z y x"]
    views: int
    fitted: Sequence[str]
    stated: Sequence[str]
    coverage: Coverage | None = None
    unreliable: Unreliable | None = None
    notes: Sequence[str] = ()
    fitted_channels: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def verdict_of(outcome: FitOutcome) -> Verdict:
    """Check the result of a fit.

    Parameters
    ----------
    outcome : the result

    Returns
    -------
    all remarks, failed checks and notes
    """
    channels, dispersion, coverage = outcome.channels, outcome.dispersion, outcome.coverage
    views, scores = ("test views", channels) if channels else ("views that it was fitted to", outcome.fitted_channels)
    found = [misfit(scores, dispersion, views), None if channels else UNCHECKED]
    if outcome.unreliable is not None:
        marked = outcome.unreliable.record()
        told = Remark("unreliable", which_unreliable(marked), failed=False)
        found += [misfit_marked(scores, marked, dispersion, views), told]
    found += [few_views(outcome.volumes, outcome.views), bases_left_out(outcome.fitted, outcome.stated)]
    if coverage is not None:
        found = [truncated(coverage), outside_grid(coverage), starved(coverage), limited_angle(coverage), *found]
    notes = (Remark("note", note) for note in outcome.notes)
    return tuple(remark for remark in (*found, *notes) if remark is not None)


def misfit(channels: Mapping[str, Mapping[str, Any]], dispersion: float, views: str = "test views") -> Remark | None:
    """Check whether noise and the conceded model error explain views away from edges.

    There, chi-square has the mean 1 + dispersion^2 Y for counts Y whose variance is Y + (dispersion Y)^2, and for n
    rays a standard deviation of sqrt(2 / n) times that.

    Parameters
    ----------
    channels : scores on these views
    dispersion : relative model error that the recipe concedes [no unit]
    views : what the views are called

    Returns
    -------
    a remark where they do not
    """
    far = _unexplained(channels, "away", dispersion)
    if not far:
        return None
    named = ", ".join(f"{value:.3g} in {name}" for name, value in far)
    return Remark(
        "misfit",
        f"The model does not explain the {views}: away from edges chi-square is {named}, where noise leaves 1; "
        "do not trust the volumes before the cause is found (truncation, scatter, motion, "
        "pixels that saturate, or a wrong spectrum).",
    )


def misfit_marked(
    channels: Mapping[str, Mapping[str, Any]], marked: Mapping[str, Any], dispersion: float, views: str = "test views"
) -> Remark | None:
    """Check whether noise and the conceded model error explain the rays through marked voxels.

    The limit is that of `misfit`. These rays lie at edges, which `misfit` leaves out, as no model resolves the rims of
    objects exactly; but what metal leaves unexplained causes errors beside it.

    Parameters
    ----------
    channels : scores on these views
    marked : summary of the marked voxels, `Unreliable.record`
    dispersion : relative model error that the recipe concedes [no unit]
    views : what the views are called

    Returns
    -------
    a remark where they do not
    """
    far = _unexplained(channels, "marked", dispersion)
    if not far:
        return None
    name, worst = max(far, key=lambda pair: pair[1])
    which = " or ".join(word for key, word in (("metal", "metal"), ("starved", "few photons")) if marked[key])
    return Remark(
        "misfit_marked",
        f"The model does not explain the {views} through the {marked['voxels']} voxels of {which}: chi-square of "
        f"these rays is up to {worst:.3g} ({name}), where noise leaves 1; what is missing there becomes "
        "streaks and wrong bases beside them: do not trust values near them, and take smaller pixels and voxels to "
        "come closer.",
    )


def _unexplained(channels: Mapping[str, Mapping[str, Any]], rays: str, dispersion: float) -> list[tuple[str, float]]:
    """Channels with their chi-square where it exceeds what noise and the conceded model error explain."""
    far = []
    for name, scores in channels.items():
        found, number, counts = (scores.get(f"{key}_{rays}") for key in ("chi_square", "rays", "counts"))
        if found is None or not number or counts is None:
            continue
        if found > (1 + dispersion**2 * counts) * (1 + CERTAIN * sqrt(2 / number)):
            far.append((name, found))
    return far


def truncated(coverage: Coverage) -> Remark | None:
    """Check whether the panel covers the object.

    Parameters
    ----------
    coverage : coverage of the object by the scan

    Returns
    -------
    a remark where it does not
    """
    if not coverage.truncated:
        return None
    sides = [name for name, part in zip(SIDES, coverage.sides, strict=True) if part]
    part = max(coverage.lateral, coverage.axial)
    return Remark(
        "truncated",
        f"The object leaves the panel ({', '.join(sides)}) in {100 * part:.0f} % of the views: what lies beyond is "
        "known only roughly, by a margin that is fitted and cut off; trust what all views see, which scores "
        "against a truth have as 'elsewhere', and take a wider panel or a larger distance where more is needed.",
    )


def outside_grid(coverage: Coverage) -> Remark | None:
    """Check whether the grid holds the object.

    Parameters
    ----------
    coverage : coverage of the object by the scan

    Returns
    -------
    a remark where it does not
    """
    if not coverage.outside:
        return None
    z, y, x = ((n * s) for n, s in zip(coverage.grid.shape, coverage.grid.spacing, strict=True))
    return Remark(
        "outside_grid",
        f"The object is larger than the grid: {100 * coverage.outside:.1f} % of the rays through it miss the grid; "
        f"a grid of {z:.0f} x {y:.0f} x {x:.0f} mm (z, y, x) would hold it.",
    )


def starved(coverage: Coverage) -> Remark | None:
    """Check whether enough photons pass the object.

    Parameters
    ----------
    coverage : coverage of the object by the scan

    Returns
    -------
    a remark where more than `STARVED` of the rays have hardly any counts
    """
    if coverage.starved <= STARVED:
        return None
    return Remark(
        "starved",
        f"Hardly any photon arrives on {100 * coverage.starved:.1f} % of the rays through the object: what lies there "
        "is guessed from other directions; more exposure or a harder spectrum would help.",
    )


def limited_angle(coverage: Coverage) -> Remark | None:
    """Check whether views from enough sides see the object.

    Parameters
    ----------
    coverage : coverage of the object by the scan

    Returns
    -------
    a remark where interfaces may face more than `UNSEEN` of all directions unseen
    """
    if coverage.unseen <= UNSEEN:
        return None
    return Remark(
        "limited_angle",
        f"No view looks along interfaces that face {100 * coverage.unseen:.0f} % of all directions: these are blurred "
        "or missing in the volumes, however well the test views are explained; views from other sides are needed.",
    )


def few_views(volumes: Float[np.ndarray, "basis z y x"], views: int) -> Remark | None:
    """Check whether views are enough for the voxels of the object.

    A slice of an object with a diameter of D voxels has pi D^2 / 4 voxels, and each view crosses it by D rays of the
    width of a voxel. Piecewise constant and non-negative values make up for some of the missing rays, not for most.

    Parameters
    ----------
    volumes : the result [1/mm]
    views : number of views that were fitted

    Returns
    -------
    a remark where a slice has fewer rays per voxel than `SPARSE`
    """
    density = volumes.sum(axis=0)
    if not (density > 0).any():
        return None
    filled = density > OBJECT_DENSITY * density[density > density.mean()].mean()
    voxels = np.count_nonzero(filled, axis=(1, 2)).max()
    diameter = 2 * sqrt(voxels / pi)
    if views * diameter >= SPARSE * voxels:
        return None
    return Remark(
        "few_views",
        f"{views} views are few for a grid this fine: a slice of the object has {voxels} voxels and is crossed by "
        f"{views * diameter:.0f} rays of their width; larger voxels or at least {SPARSE * voxels / diameter:.0f} views "
        "would suffice.",
    )


def bases_left_out(fitted: Sequence[str], stated: Sequence[str]) -> Remark | None:
    """Check whether the result has all bases of the dataset.

    Parameters
    ----------
    fitted, stated : names of the bases of the result, and of the dataset

    Returns
    -------
    a note where some are missing
    """
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
    """Convert a verdict for ``metrics.json``.

    Parameters
    ----------
    verdict : the remarks

    Returns
    -------
    the remarks as plain dictionaries
    """
    return [asdict(remark) for remark in verdict]


def failed(metrics: Mapping[str, Any]) -> bool:
    """Tell whether a check of a run has failed.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    whether any check has failed
    """
    return any(remark["failed"] for remark in metrics.get("verdict", ()))


def lines(metrics: Mapping[str, Any]) -> list[str]:
    """Format the verdict for a summary.

    Parameters
    ----------
    metrics : content of ``metrics.json``

    Returns
    -------
    one line per remark, and a last line where no check failed, which says whether the fit was checked; none for a run
    without a verdict
    """
    if "verdict" not in metrics:
        return []
    remarks = metrics["verdict"]
    shown = [f"{'Warning' if remark['failed'] else 'Note'}: {remark['sentence']}" for remark in remarks]
    if failed(metrics):
        return shown
    if any(remark["key"] == UNCHECKED.key for remark in remarks):
        return [*shown, "Verdict: no check failed; rays beside those of the fit were not checked."]
    return [*shown, "Verdict: no check of the scan and the fit failed."]
