"""What a tolerance costs: the cheapest settings that meet it, the error of each part, and what a scan will take.

A tolerance bounds the error of log projections, `-log(counts / open beam)`, wherever a ray goes. Each part of the
computation gets a share of it and is measured against a much finer computation of the same part. Samples have
seeds of their own, and no choice depends on how fast a machine is: the same scene and tolerance are computed alike
everywhere, whatever the seed of the noise.
"""

import logging
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.field_of_view import sampled_lengths
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.energy_grids import fine_cuts
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.planning.faint_objects import FaintObjects
from phantomgen.simulation.planning.focal_spot import choose_spot
from phantomgen.simulation.planning.pixels import Choice, Trial, choose_pixels
from phantomgen.simulation.planning.tessellation import choose_tessellation
from spectra.errors import InputError

_log = logging.getLogger(__name__)

TOLERANCE = 1e-3
_LEAST, _MOST = 1e-9, 1.0
# Shares of the tolerance; the average over pixels gets what is left, so that they sum to 1, as errors may add up.
ENERGY, _TESSELLATION, _SPOT = 0.25, 0.25, 0.4
# Share of bins in that of energies.
BINS = 0.3
# How much finer energy nodes are sought where their share is missed, and whether they may be of no single energy: those
# that may are fewer, the others all but exact.
_ATTEMPTS = ((1.0, True), (3.0, True), (10.0, True), (10.0, False))
# So many nodes of a channel are its bins: wherever fewer were found, they are some dozens at most.
_ALL_BINS = 200
# Nodes per channel of most plans.
_USUAL = 10


@dataclass(frozen=True, eq=False)
class Plan:
    """How a scan is computed, and how wrong that is.

    Parameters
    ----------
    tolerance : of log projections
    scan : what is simulated, with as fine triangles as its smooth surfaces need
    settings : the cheapest ones that meet it, part by part
    exposure : energies with the nodes that were chosen
    choices : what was chosen for each part, and the error that was measured
    """

    tolerance: float
    scan: Scan
    settings: Settings
    exposure: Exposure
    choices: tuple[Choice, ...]

    @property
    def error(self) -> float:
        """Errors of all parts together: they may add up, but a pixel is of one kind only."""
        others = sum(choice.error for choice in self.choices if not choice.of_pixels)
        return others + max((choice.error for choice in self.choices if choice.of_pixels), default=0.0)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Energy nodes per channel."""
        return tuple(b - a for a, b in pairwise(self.exposure.transmission.starts.tolist()))

    @property
    def missed(self) -> tuple[Choice, ...]:
        """Parts that cannot meet their share, where the whole misses the tolerance."""
        return () if self.error <= self.tolerance else tuple(c for c in self.choices if not c.met)

    def check(self) -> None:
        """Refuse a tolerance that is missed.

        Raises
        ------
        InputError
            With the parts that miss it, and what they reach.
        """
        if self.missed:
            reached = float(f"{1.05 * self.error:.1e}")
            raise InputError(f"--tol {self.tolerance:g} cannot be met: {self._reached}; {reached:g} can")

    @property
    def warnings(self) -> list[str]:
        """A sentence where the tolerance is missed."""
        return [f"the tolerance {self.tolerance:g} is missed: {self._reached}"] if self.missed else []

    @property
    def _reached(self) -> str:
        """What the parts reach that miss their share."""
        return ", ".join(f"{c.part} reach {c.error:.1e} with {c.setting}" for c in self.missed)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "tolerance": self.tolerance,
            "error": self.error,
            "settings": self.settings.to_dict(),
            "nodes": list(self.nodes),
            "parts": [choice.to_dict() for choice in self.choices],
        }

    @property
    def text(self) -> str:
        """For people: one line per part."""
        width = max(len(c.part) for c in self.choices)
        lines = [
            f"{c.part:<{width}}  {c.error:.1e}  {c.setting}"
            + (f"; its share is {c.share:.1e}" if c in self.missed else "")
            + (f", for {c.decided}" if c.decided else "")
            for c in self.choices
        ]
        verdict = "meets" if self.error <= self.tolerance else "MISSES"
        return "\n".join([*lines, f"{'together':<{width}}  {self.error:.1e}  {verdict} {self.tolerance:.0e}"])


def make_plan(scan: Scan, tolerance: float = TOLERANCE) -> Plan:
    """Choose how finely a scan is computed.

    Parameters
    ----------
    scan : what is simulated
    tolerance : worst error of log projections that is wanted

    Raises
    ------
    InputError
        When the tolerance is no sensible number.
    """
    check_tolerance(tolerance)
    exposure, energies = _energies(scan, ENERGY * tolerance)
    if slow := _slow(exposure, tolerance):
        _log.warning(slow)
    choices, left, settings = [energies], 1 - ENERGY, Settings()
    if scan.file is not None:
        scan, tessellation = choose_tessellation(scan, exposure.transmission, _TESSELLATION * tolerance)
        choices, left = [*choices, tessellation], left - _TESSELLATION
    if (spot := scan.effects.focal_spot) is not None:
        settings, points = choose_spot(scan, spot, exposure.transmission, settings, _SPOT * tolerance)
        choices, left = [*choices, points], left - _SPOT
    faint = FaintObjects.of(scan, exposure.transmission, tolerance)
    settings, found = choose_pixels(scan, exposure.transmission, settings, left * tolerance, faint.missed)
    return Plan(tolerance, scan, settings, exposure, (*choices, *found))


def _energies(scan: Scan, share: float) -> tuple[Exposure, Choice]:
    """Few energy nodes whose worst error of log counts, together with that of their bins, stays within `share`."""
    lengths, trials, found = sampled_lengths(scan), [], []
    cuts, bins = fine_cuts(scan, lengths, BINS * share)
    for finer, refine in _ATTEMPTS:
        exposure, error = Exposure.of(scan, lengths, (share - min(bins, BINS * share)) / finer, refine, cuts)
        nodes = [b - a for a, b in pairwise(exposure.transmission.starts.tolist())]
        trials.append(Trial(f"{' + '.join(map(str, nodes))} nodes", bins + error, sum(nodes)))
        found.append(exposure)
        if bins + error <= share:
            break
    best = min(range(len(trials)), key=lambda i: (trials[i].error > share, trials[i].error))
    return found[best], Choice("energies", trials[best].setting, trials[best].error, share, tuple(trials))


def _slow(exposure: Exposure, tolerance: float) -> str | None:
    """A sentence where a channel keeps all of its bins."""
    counts = np.diff(exposure.groups.starts)
    if counts.max() <= _ALL_BINS:
        return None
    times = counts.sum() / (_USUAL * len(counts))
    return (
        f"no fewer energy nodes than all {counts.max()} bins of a channel were found for the tolerance {tolerance:g}: "
        f"views will take some {times:.0f} times longer than usual; a larger --tol takes less"
    )


def check_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is no number between 1e-9 and 1."""
    if not _LEAST <= tolerance <= _MOST:
        raise InputError(f"--tol must lie in {_LEAST:g} .. {_MOST:g}, an error of log projections, got {tolerance:g}")
