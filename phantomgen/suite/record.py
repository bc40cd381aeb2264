"""What is recorded of a scan: hashes of its arrays, and sums from which rounding can be told from another scan.

Processors round differently. Means then differ by about 1e-7, so that a Poisson count changes now and then; where a
draw is rejected on one processor only, the rest of that image has other noise. Scans that were made before energy nodes
were independent of rounding have means that differ by up to 2e-4. So arrays are compared by their hashes first. Where
these differ, the total of each channel must be as before within `_MEANS`, and that of each image within noise.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.adapters.to_hashes import array_hashes, contents
from phantomgen.dataset.reader import open_dataset

IDENTICAL, ROUNDED, DIFFERENT, UNKNOWN = "identical", "same within rounding", "different", "not stored"
_FLATS = "flats"
_STATED = (_FLATS, "stated_spectra", "stated_poses", "stated_views")
# Change of the total of an image with the same noise: part of the total, and counts.
_ROUNDING, _COUNTS = 5e-6, 20.0
# Relative change of means, a third of the tolerance of scans; and standard deviations of noise beyond it.
_MEANS, _DEVIATIONS = 3e-4, 6.0
# Relative change of sums over the truth, and over what the file states.
_SUMS = 1e-5


def record(path: Path) -> dict[str, Any]:
    """Record a scan.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    `arrays` of `phantomgen.dataset.adapters.to_hashes.array_hashes`; `totals` of the counts of each view and channel;
    `truth`, two sums over each basis volume; `stated`, the same of each array of flats, spectra, poses and views
    """
    with open_dataset(path) as dataset:
        arrays = contents(dataset)
        views = range(dataset.counts.shape[0])
        totals = [dataset.load([view])[0].sum(axis=(1, 2), dtype=np.int64).tolist() for view in views]
        names = dataset.spectra.basis.names
        truth = {name: _sums(volume) for name, volume in zip(names, arrays["truth_basis"][0], strict=True)}
        stated = {name: [_sums(array[()]) for array in arrays[name]] for name in _STATED}
    return {"arrays": array_hashes(path), "totals": totals, "truth": truth, "stated": stated}


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
    if why := _changed_shape(found, stored) or _changed_counts(found, stored) or _changed_sums(found, stored):
        return DIFFERENT, why
    others = [name for name, array in found["arrays"].items() if array != stored["arrays"][name]]
    part = _part_with_other_noise(found["totals"], stored["totals"])
    noise = f"; {part:.0%} of the images have other noise" if part else ""
    return ROUNDED, f"{', '.join(others)} differ by what processors round{noise}"


def _changed_shape(found: Mapping[str, Any], stored: Mapping[str, Any]) -> str:
    """Which array has another shape, as a sentence; empty where none has."""
    for name, array in found["arrays"].items():
        if array["shapes"] != stored["arrays"][name]["shapes"]:
            return f"{name} have another shape"
    return ""


def _changed_counts(found: Mapping[str, Any], stored: Mapping[str, Any]) -> str:
    """Say by how much counts changed beyond rounding and noise; empty where they did not."""
    now, before = (np.array(entry["totals"], np.float64) for entry in (found, stored))
    change, flats = now - before, zip(found["stated"][_FLATS], stored["stated"][_FLATS], strict=True)
    pairs = [(change.sum(axis=0), before.sum(axis=0)), *((np.subtract(f, s), np.array(s)) for f, s in flats)]
    noise = [_COUNTS + _DEVIATIONS * np.sqrt(2 * np.abs(total)) for _, total in pairs]
    beyond = [np.abs(part) - _MEANS * np.abs(total) - n for (part, total), n in zip(pairs, noise, strict=True)]
    if any((part > 0).any() for part in beyond):
        largest = max(float((np.abs(part) / np.maximum(np.abs(total), 1)).max()) for part, total in pairs)
        return f"counts changed by up to {largest:.1e} of their value in a channel, more than rounding explains"
    mean = before * change.sum(axis=0) / np.maximum(before.sum(axis=0), 1)
    if (np.abs(change - mean) > _DEVIATIONS * np.sqrt(2 * before) + _COUNTS).any():
        return "counts of single images changed by more than rounding and noise explain"
    return ""


def _changed_sums(found: Mapping[str, Any], stored: Mapping[str, Any]) -> str:
    """Why sums show another truth, or other statements; empty where they do not."""
    pairs = {"the truth": [(found["truth"].get(name, (0, 0)), sums) for name, sums in stored["truth"].items()]}
    pairs["stated spectra, poses and views"] = [
        pair
        for name, sums in stored["stated"].items()
        if name != _FLATS
        for pair in zip(found["stated"][name], sums, strict=True)
    ]
    for where, each in pairs.items():
        if (change := _largest_change(each)) > _SUMS:
            return f"sums over {where} changed by up to {change:.1e} of their value"
    return ""


def _part_with_other_noise(found: Sequence[Sequence[int]], stored: Sequence[Sequence[int]]) -> float:
    """Part of the images whose totals differ by more than single counts."""
    now, before = np.array(found, np.float64), np.array(stored, np.float64)
    return float(np.mean(np.abs(now - before) > _ROUNDING * before + _COUNTS))


def _sums(values: np.ndarray) -> list[float]:
    """Sum of magnitudes, and a sum with weights from 1 to 2, which signs and the sequence of values change."""
    flat = np.ravel(values).astype(np.float64)
    return [float(np.abs(flat).sum()), float(flat @ np.linspace(1, 2, flat.size))]


def _largest_change(pairs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> float:
    """Largest difference of sums, as part of the stored sum of magnitudes."""
    now, before = np.array(pairs, np.float64).transpose(1, 0, 2)
    whole = before[:, :1]
    return float(np.max(np.abs(now - before) / np.where(whole == 0, 1.0, whole)))
