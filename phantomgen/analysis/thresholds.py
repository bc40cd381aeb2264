"""Thresholds for which the channels of a scan measure one basis function with the least noise.

A detector with a threshold at every candidate gives the counts between any two of them, because what a pulse is counted
as depends on the thresholds only: channels of fewer thresholds are sums of its channels. So the response is asked for
once, whatever the detector, and every choice after that costs a few sums.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb, floor
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from phantomgen.analysis.single_ray import BEHIND, SingleRayBound, layers_of
from phantomgen.scene.file.scene_file import SceneFile, closest
from phantomgen.scene.scan import Scan, load_scene
from spectra.basis.basis import pretty
from spectra.cramer_rao import least_deviations
from spectra.errors import InputError

STEP = 0.5  # keV between candidates; the K edges of the basis are candidates, too
# Line integral of every K-edge function that the ray passes besides the object: 10 % absorption at its reference.
TRACE = 0.1
# Sets of thresholds that are all tried, at most: a bound of time.
_MOST_TRIALS = 20_000
# So many starts found what 200 random ones found, in seven searches with 3 to 8 channels; one start did in five.
_STARTS = 50
_Cuts = Int[np.ndarray, "choice channel"]


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidate thresholds, and the counts between neighbours.

    Parameters
    ----------
    thresholds : ascending, the first one is kept [keV]
    counts : expected counts between neighbouring thresholds, the last one open
    slopes : - derivatives of these counts by the line integrals
    target : index of the basis function that is to be seen best
    """

    thresholds: Float[np.ndarray, " candidate"]
    counts: Float[np.ndarray, " candidate"]
    slopes: Float[np.ndarray, "candidate basis"]
    target: int

    def bounds(self, chosen: _Cuts) -> Float[np.ndarray, " choice"]:
        """Compute the least standard deviation of the target's line integral for choices of candidates.

        Parameters
        ----------
        chosen : ascending indices, (choice, channel)

        Returns
        -------
        standard deviation of each choice
        """
        above = np.cumsum(np.column_stack([self.counts, self.slopes])[::-1], axis=0)[::-1]
        above = np.vstack([above, np.zeros(above.shape[1])])
        ends = np.column_stack([chosen, np.full(len(chosen), len(self.thresholds))])
        between = above[ends[:, :-1]] - above[ends[:, 1:]]
        counts, slopes = between[..., 0], between[..., 1:]
        weight = np.where(counts > 0, 1.0 / np.where(counts > 0, counts, 1.0), 0.0)
        return least_deviations(np.einsum("kc,kcm,kcn->kmn", weight, slopes, slopes, optimize=True))[:, self.target]

    def best(self, starts: _Cuts) -> Int[np.ndarray, " channel"]:
        """Find the best thresholds that single moves reach from `starts`; the first one of equals.

        Parameters
        ----------
        starts : ascending indices, (choice, channel)

        Returns
        -------
        indices of the thresholds
        """
        ends = [self._improved(start) for start in starts]
        return ends[int(np.argmin(self.bounds(np.array(ends))))]

    def on_a_coarse_grid(self, channels: int, edges: Sequence[float]) -> _Cuts:
        """Find the best choices of thresholds on a coarse grid, which contains the K edges.

        Parameters
        ----------
        channels : number of channels
        edges : K edges [keV]

        Returns
        -------
        ascending indices, (choice, channel)
        """
        kept = np.flatnonzero(np.isin(self.thresholds[1:], edges)) + 1
        choices = combinations(_coarse(len(self.thresholds), channels - 1, kept), channels - 1)
        rows = np.array([(0, *choice) for choice in choices], dtype=np.int64)
        return rows[np.argsort(self.bounds(rows), kind="stable")[:_STARTS]]

    def _improved(self, chosen: Int[np.ndarray, " channel"]) -> Int[np.ndarray, " channel"]:
        """One threshold after the other at its best place, until none moves any more."""
        better = chosen
        for i in range(1, len(chosen)):
            places = self.moved(better, i)
            better = places[np.argmin(self.bounds(places))]
        return chosen if (better == chosen).all() else self._improved(better)

    def moved(self, chosen: Int[np.ndarray, " channel"], which: int) -> _Cuts:
        """Return all choices that differ in one threshold, which stays between its neighbours.

        The unchanged choice comes first.

        Parameters
        ----------
        chosen : ascending indices
        which : number of the threshold

        Returns
        -------
        ascending indices, (choice, channel)
        """
        ends = [*chosen, len(self.thresholds)]
        places = np.arange(ends[which - 1] + 1, ends[which + 1])
        choices = np.tile(chosen, (len(places) + 1, 1))
        choices[1:, which] = places
        return choices


@dataclass(frozen=True, eq=False)
class ThresholdChoice:
    """Best thresholds that were found.

    Parameters
    ----------
    scan : as the scene has it
    candidates : what was searched
    chosen : indices of the best thresholds
    behind : object that the ray passes
    """

    scan: Scan
    candidates: Candidates
    chosen: Int[np.ndarray, " channel"]
    behind: str

    @property
    def basis(self) -> str:
        """Name of the basis function that is to be seen best."""
        return self.scan.basis.names[self.candidates.target]

    @property
    def thresholds(self) -> list[float]:
        """The best thresholds [keV]."""
        return [float(value) for value in self.candidates.thresholds[self.chosen]]

    @cached_property
    def old_bound(self) -> float:
        """Least standard deviation with the thresholds of the scene [no unit]."""
        return float(_point(self.scan, self.behind).bounds[self.candidates.target])

    @cached_property
    def bound(self) -> float:
        """Least standard deviation with the best thresholds [no unit]."""
        return float(self.candidates.bounds(self.chosen[None])[0])

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON; what is unbounded is null.

        Returns
        -------
        the mapping
        """
        old, new = ([bound, None][not np.isfinite(bound)] for bound in (self.old_bound, self.bound))
        return {
            "name": self.scan.name,
            "basis": self.basis,
            "behind": self.behind,
            "trace": {f.name: TRACE for f in self.scan.basis.functions if f.edge_energy is not None},
            "old": {"thresholds_keV": list(self.scan.detector.thresholds), "bound": old},
            "new": {"thresholds_keV": self.thresholds, "bound": new},
        }

    @property
    def text(self) -> str:
        """Thresholds as text."""
        facts = self.to_dict()
        trace = ", ".join(f"{TRACE:g} of {pretty(name)}" for name in facts["trace"])
        lines = [
            f"{facts['name']}: least noise of the {pretty(self.basis)} line integral behind {self.behind or 'nothing'}"
            + (f" and line integrals of {trace}" if trace else ""),
            *(
                f"  {which}  {_number(facts[which]['bound'])}  with thresholds "
                f"{', '.join(f'{t:g}' for t in facts[which]['thresholds_keV'])} keV"
                for which in ("old", "new")
            ),
        ]
        if np.isfinite(self.old_bound) and np.isfinite(self.bound):
            ratio = self.bound / self.old_bound
            lines.append(f"  {ratio:.3f} times the noise, as from {ratio**-2:.3f} times the photons")
        values = ", ".join(f"{t:g}" for t in self.thresholds)
        return "\n".join([*lines, f"use it   --set 'detector.thresholds=[{values}]'"])


def choose_thresholds(
    file: SceneFile, basis: str, channels: int | None = None, behind: str = BEHIND
) -> ThresholdChoice:
    """Find the thresholds that minimise the Cramer-Rao bound of one line integral.

    The lowest threshold of the scene does not change.

    Parameters
    ----------
    file : the scene
    basis : name of the basis function
    channels : number of channels; as many as the scene has where left out
    behind : layers that the ray passes, such as ``20 cm water``

    Returns
    -------
    the thresholds

    Raises
    ------
    InputError
        For unknown functions, and for fewer channels than basis functions, which cannot be separated then.
    """
    scan = load_scene(file)
    target = _target(scan, basis)
    if not (hasattr(file.model.detector, "thresholds") and hasattr(scan.detector, "thresholds")):
        raise InputError(
            f"{file.name} has no thresholds to choose: that needs one source and a photon-counting detector"
        )
    count = len(scan.detector) if channels is None else channels
    values = _candidates(scan)
    if not len(scan.basis) <= count <= len(values):
        raise InputError(
            f"{count} channels cannot tell {len(scan.basis)} basis functions apart: choose {len(scan.basis)} to "
            f"{len(values)} channels"
        )
    fine = load_scene(SceneFile(file.name, file.text, (*file.overrides, f"detector.thresholds={values.tolist()}")))
    point = _point(fine, behind)
    candidates = Candidates(values, point.counts, point.counts[:, None] * point.slopes, target)
    starts = candidates.on_a_coarse_grid(count, scan.basis.breaks)
    if count == len(scan.detector):
        starts = np.vstack([starts, np.searchsorted(values, scan.detector.thresholds)])
    return ThresholdChoice(scan, candidates, candidates.best(starts), behind)


def _target(scan: Scan, name: str) -> int:
    """Index of a basis function."""
    names = scan.basis.names
    if name not in names:
        raise InputError(f"{scan.name} has no basis function {name!r}{closest(name, names)}")
    return names.index(name)


def _candidates(scan: Scan) -> Float[np.ndarray, " candidate"]:
    """The thresholds of the scene, K edges of the basis, and steps above the lowest threshold [keV]."""
    old, top = scan.detector.thresholds, scan.source.maximum
    kept = np.union1d(old, [edge for edge in scan.basis.breaks if old[0] < edge < top])
    steps = np.arange(STEP * (floor(old[0] / STEP) + 1), top, STEP)
    apart = np.abs(steps[:, None] - np.append(kept, top)).min(axis=1) >= STEP / 2
    return np.union1d(kept, steps[apart])


def _point(scan: Scan, behind: str) -> SingleRayBound:
    """The ray that thresholds are judged by: behind layers and a trace of every K-edge material."""
    return SingleRayBound.of(
        scan, layers_of(behind, scan), {f.name: TRACE for f in scan.basis.functions if f.edge_energy}
    )


def _coarse(candidates: int, free: int, kept: Int[np.ndarray, " edge"]) -> Int[np.ndarray, " some"]:
    """Indices of candidates, evenly, as many as leave few choices; those to be kept replace their neighbours."""
    count = free
    while count < candidates - 1 and comb(count + 1, free) <= _MOST_TRIALS:
        count += 1
    even = np.linspace(1, candidates - 1, count).round().astype(np.int64)
    for index in kept:
        even[np.argmin(np.abs(even - index))] = index
    return np.unique(even)


def _number(value: float | None) -> str:
    """A bound for people."""
    return "unbounded" if value is None else f"{value:.4g}"
