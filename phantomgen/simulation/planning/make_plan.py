"""What a tolerance costs: the cheapest settings that meet it, the error of each part, and what a scan will take.

A tolerance bounds the error of log projections, `-log(counts / open beam)`, wherever a ray goes. Each part of the
computation gets a share of it and is measured against a much finer computation of the same part. Samples have
seeds of their own, and no choice depends on how fast a machine is: the same scene and tolerance are computed alike
everywhere, whatever the seed of the noise.
"""

import logging
from itertools import pairwise

import numpy as np

from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.energy_grids import fine_cuts
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.planning.faint_objects import FaintObjects
from phantomgen.simulation.planning.focal_spot import choose_spot
from phantomgen.simulation.planning.pixels import choose_pixels
from phantomgen.simulation.planning.plan import (
    _SPOT,
    _TESSELLATION,
    BINS,
    ENERGY,
    TOLERANCE,
    Choice,
    Plan,
    Trial,
    check_tolerance,
)
from phantomgen.simulation.planning.tessellation import choose_tessellation

_log = logging.getLogger(__name__)

# How much finer energy nodes are sought where their share is missed, and whether they may be of no single energy: those
# that may are fewer, the others almost exact.
_ATTEMPTS = ((1.0, True), (3.0, True), (10.0, True), (10.0, False))
# So many nodes of a channel are its bins: wherever fewer were found, they are some dozens at most.
_ALL_BINS = 200
# Nodes per channel of most plans.
_USUAL = 10


def make_plan(scan: Scan, tolerance: float = TOLERANCE) -> Plan:
    """Choose how finely a scan is computed.

    Parameters
    ----------
    scan : what is simulated
    tolerance : worst error of log projections that is wanted

    Returns
    -------
    the plan

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
    settings, found = choose_pixels(scan, exposure.transmission, settings, left * tolerance, faint)
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
