"""What is recorded of a scan: hashes of its arrays, and sums from which rounding can be told from another scan.

Processors round differently, by about 1e-7 of a mean, so that a Poisson count changes now and then, mostly by one.
Seldom a draw is rejected on one processor only, and the rest of that image has other noise. So arrays are compared by
their hashes first. Where these differ, nearly all images must have the same total as before but for such counts, and
the rest a total that differs by noise.
"""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.file import DETECTOR
from phantomgen.dataset.layout import array_at
from phantomgen.dataset.reader import open_dataset

IDENTICAL, ROUNDED, DIFFERENT, UNKNOWN = "identical", "same within rounding", "different", "not stored"
_ARRAYS = {
    "counts": f"{DETECTOR}/data",
    "flats": "/entry/instrument/flat/data",
    "truth_basis": "/truth/basis/data",
    "truth_fractions": "/truth/fractions",
}
# Change of the total of an image with the same noise: part of the total, and counts.
_ROUNDING, _COUNTS = 5e-6, 20.0
# Part of the images that must have the same noise, and standard deviations for the others.
_SAME_NOISE, _DEVIATIONS = 0.8, 6.0
# Relative change of sums over the truth.
_TRUTH = 1e-5


def record(path: Path) -> dict[str, Any]:
    """Record a scan.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    `arrays`, with dtype, shape and SHA-256 of dtype, shape and bytes of each; `totals` of the counts of each view and
    channel; `truth`, the sum and the sum of squares of each basis volume
    """
    with open_dataset(path) as dataset:
        arrays = {name: _digest(array_at(dataset.file, place)) for name, place in _ARRAYS.items()}
        views = range(dataset.counts.shape[0])
        totals = [dataset.load([view])[0].sum(axis=(1, 2), dtype=np.int64).tolist() for view in views]
        volumes = [np.asarray(volume, np.float64) for volume in array_at(dataset.file, _ARRAYS["truth_basis"])]
        truth = {
            name: [float(volume.sum()), float(np.square(volume).sum())]
            for name, volume in zip(dataset.spectra.basis.names, volumes, strict=True)
        }
    return {"arrays": arrays, "totals": totals, "truth": truth}


def compare(found: Mapping[str, Any], stored: Mapping[str, Any] | None) -> tuple[str, str]:
    """Compare a recorded scan with the stored one.

    Parameters
    ----------
    found : of `record`, with the `scene` hash of its case
    stored : what was stored; None for nothing

    Returns
    -------
    ``identical``, ``same within rounding``, ``different`` or ``not stored``; and why, empty for the first and last
    """
    if stored is None:
        return UNKNOWN, ""
    if found["scene"] != stored["scene"]:
        return DIFFERENT, "the definition of the scene changed"
    if found["arrays"] == stored["arrays"]:
        return IDENTICAL, ""
    for name, array in found["arrays"].items():
        if any(array[key] != stored["arrays"][name][key] for key in ("dtype", "shape")):
            return DIFFERENT, f"{name} have another type or shape"
    now, before = (np.array([scan["truth"][name] for name in stored["truth"]]) for scan in (found, stored))
    if not np.allclose(now, before, rtol=_TRUTH, atol=0):
        return DIFFERENT, f"sums over the truth changed by up to {np.abs(now / before - 1).max():.1e} of their value"
    now, before = (np.array(scan["totals"], np.float64) for scan in (found, stored))
    change = np.abs(now - before)
    same = change <= _ROUNDING * before + _COUNTS
    far = change > _DEVIATIONS * np.sqrt(2 * before) + _COUNTS
    if far.any() or same.mean() < _SAME_NOISE:
        return DIFFERENT, f"{1 - same.mean():.0%} of the images have other counts than rounding explains"
    others = [name for name, array in found["arrays"].items() if array != stored["arrays"][name]]
    return ROUNDED, f"{', '.join(others)} differ by what processors round"


def _digest(array: h5py.Dataset) -> dict[str, Any]:
    """Type, shape, and SHA-256 of both and of the values, read piece by piece."""
    found = sha256(f"{array.dtype.str} {array.shape}".encode())
    for part in array:
        found.update(np.ascontiguousarray(part).tobytes())
    return {"dtype": array.dtype.str, "shape": list(array.shape), "sha256": found.hexdigest()}
