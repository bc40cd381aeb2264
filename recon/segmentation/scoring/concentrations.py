"""Concentrations of contrast agents against the truth: slope, intercept, limit of detection, cross-talk."""

from typing import Any, NamedTuple

import numpy as np

from phantomgen.dataset.layout import FRACTION_SCALE
from recon.evaluation.metrics import pure_voxels
from recon.segmentation.result import Segmentation
from recon.segmentation.scoring.reference import Reference

DETECTION = 3.3  # standard deviations of a blank; limit of detection of ICH guideline Q2


class _Point(NamedTuple):
    """Material, its true concentration, and mean and standard deviation of the measured ones [mg/ml]."""

    material: str
    true: float
    measured: float
    deviation: float


def regress(segmentation: Segmentation, reference: Reference) -> dict[str, Any]:
    """Fit measured against true concentrations of each contrast agent.

    Parameters
    ----------
    segmentation : material maps
    reference : truth

    Returns
    -------
    by element ``slope``, ``intercept`` [mg/ml] and ``r_squared`` of measured against true; ``detection_limit`` [mg/ml]
    of one voxel, 3.3 standard deviations of the blanks' voxels over the slope; ``crosstalk`` [mg/ml], the largest
    absolute mean in a material of another agent; ``points``: material, true, measured, standard deviation. Values are
    means over pure voxels of the materials that hold the agent, and of blanks. A voxel is pure where one material fills
    it and all voxels at most two away
    """
    volumes, true = segmentation.subject.volumes, reference.truth
    inside = [pure_voxels(f, FRACTION_SCALE) for f in true.fractions]
    result = {}
    for element in reference.readouts.agents:
        if element not in segmentation.readouts.agents:
            continue
        measured = segmentation.readouts.concentration(volumes, element)
        points, blanks, others = [], [], [0.0]
        for name, material, mask in zip(true.material_names, reference.materials, inside, strict=True):
            holds = {e: c > 1e-6 for e, c in material.concentrations.items()}
            if not mask.any():
                continue
            values = measured[mask].astype(np.float64)
            if any(holds.values()) and not holds[element]:
                others.append(abs(float(values.mean())))
                continue
            points.append(_Point(name, material.concentrations[element], float(values.mean()), float(values.std())))
            if not holds[element]:
                blanks.append(values - values.mean())
        result[element] = _line(points) | {"crosstalk": max(others), "points": points}
        slope, blank = result[element]["slope"], np.concatenate([*blanks, np.empty(0)])
        known = slope and len(blank)
        result[element]["detection_limit"] = float(DETECTION * blank.std() / slope) if known else None
    return result


def _line(points: list[_Point]) -> dict[str, float | None]:
    """Least squares through measured against true concentrations."""
    x, y = np.array([p.true for p in points]), np.array([p.measured for p in points])
    if len(x) < 2 or np.ptp(x) == 0:
        return {"slope": None, "intercept": None, "r_squared": None}
    slope, intercept = np.polyfit(x, y, 1)
    rest, spread = np.square(y - slope * x - intercept).sum(), np.square(y - y.mean()).sum()
    return {"slope": float(slope), "intercept": float(intercept), "r_squared": float(1 - rest / max(spread, 1e-300))}
