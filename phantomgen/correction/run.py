"""From a raw dataset to a corrected one: the same counts, with masks, tube output and flats that fit them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped, UInt32

from phantomgen.correction.bad_pixels import find_bad_pixels
from phantomgen.correction.pixel_gains import LEAST, PixelGains, pixel_gains
from phantomgen.correction.sums import ScanSums
from phantomgen.correction.tube_output import TubeOutput, tube_output
from phantomgen.dataset.checks.counts import check_counts
from phantomgen.dataset.checks.door import array_at, find_array
from phantomgen.dataset.file import DARK, FLAT
from phantomgen.dataset.pixel_mask import mask_of
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.writing.corrected_copy import CorrectedCopy, check_copy
from spectra.errors import DatasetError, InputError

STEPS = ("defects", "drift", "rings")
_BAR_AFTER = 2.0  # s
Frames = Shaped[np.ndarray, "frame channel row column"]


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is corrected.

    Parameters
    ----------
    steps : of `STEPS`
    flats, darks : frames that replace those of the scan
    """

    steps: tuple[str, ...] = STEPS
    flats: Frames | None = None
    darks: Frames | None = None

    def __post_init__(self) -> None:
        for step in self.steps:
            if step not in STEPS:
                raise InputError(f"a correction is one of {', '.join(STEPS)}, got {step!r}")


@dataclass(frozen=True, eq=False)
class Corrected:
    """What was corrected.

    Parameters
    ----------
    path : the new dataset
    done : what was done or left alone, one phrase each
    output : tube output of the views; None where it was not asked for
    gains : gains of the pixels of each channel; empty where they were not asked for
    masks : bits of the pixels of each channel
    """

    path: Path
    done: tuple[str, ...]
    output: TubeOutput | None
    gains: tuple[PixelGains, ...]
    masks: tuple[UInt32[np.ndarray, "row column"], ...]

    def record(self) -> dict[str, Any]:
        """Return the numbers by name.

        Returns
        -------
        numbers of bad pixels, changes of the tube output and spreads of gains
        """
        output = self.output
        drift = None
        if output is not None and output.is_known:
            drift = {
                "rms": float(np.std(output.factors)),
                "uncertainty": float(np.sqrt(np.mean(output.uncertainty**2))),
                "air_blocks": int(output.blocks.sum()),
            }
        return {
            "bad_pixels": [int(np.count_nonzero(mask)) for mask in self.masks],
            "tube_output": drift,
            "gain_spread": [gains.spread for gains in self.gains],
            "gain_noise": [gains.noise if np.isfinite(gains.noise) else None for gains in self.gains],
            "done": list(self.done),
        }


def correct_file(
    path: Path | str,
    out: Path | str,
    wanted: Wanted | None = None,
    *,
    overwrite: bool = False,
    progress: bool = False,
) -> Corrected:
    """Write a corrected copy of a dataset. The output is complete or absent; no truth is read.

    Parameters
    ----------
    path : the dataset
    out : name of the new one
    wanted : what is corrected; all where left out
    overwrite : replace a file that exists
    progress : show a bar on stderr where it takes more than two seconds

    Returns
    -------
    what was corrected

    Raises
    ------
    InputError
        When the frames do not fit the scan, no pixel is left, or the output cannot be written.
    """
    path, out, wanted = Path(path), Path(out), wanted or Wanted()
    check_copy(path, out, overwrite)
    with open_dataset(path, air=(slice(0, 1), slice(0, 1)), as_stored=True) as dataset:
        _check_frames(dataset, wanted)
    with CorrectedCopy(path, out, overwrite) as copy, _bar(path, wanted, progress) as on_view:
        done = _replace_frames(copy, Dataset(path, copy.file, as_stored=True), wanted)
        dataset = Dataset(path, copy.file, as_stored=True)
        masks = tuple(_bits(dataset, name) for name in dataset.spectra.channels)
        if "defects" in wanted.steps:
            masks = tuple(
                old | find_bad_pixels(one)
                for old, one in zip(masks, ScanSums(dataset, on_view).statistics(), strict=True)
            )
            done += _about_masks(dataset, masks)
        measures = np.stack([mask & 0xFFFF == 0 for mask in masks])
        _check_left(dataset, measures)
        output, gains = None, ()
        if {"drift", "rings"} & set(wanted.steps):
            output, gains = _from_views(ScanSums(dataset, on_view), measures, wanted)
            done += _about_views(dataset, output, gains, wanted)
        _write(copy, dataset, Corrected(out, tuple(done), output, gains, masks), wanted)
        copy.write_history("phantomgen correct", done, {"steps": list(wanted.steps)})
        copy.finish(dataset.spectra)
    return Corrected(out, tuple(done), output, gains, masks)


@contextmanager
def _bar(path: Path, wanted: Wanted, progress: bool) -> Iterator[Callable[[], object]]:
    """Give a function that is called after each view that is read, and moves a progress bar."""
    if not progress:
        yield lambda: None
        return
    from tqdm import tqdm  # noqa: PLC0415

    with open_dataset(path, air=(slice(0, 1), slice(0, 1)), as_stored=True) as dataset:
        views = dataset.counts.shape[0]
    passes = ("defects" in wanted.steps) + bool({"drift", "rings"} & set(wanted.steps))
    with tqdm(total=passes * views, desc="views", unit="", leave=False, disable=None, delay=_BAR_AFTER) as bar:
        yield bar.update


def _check_frames(dataset: Dataset, wanted: Wanted) -> None:
    """Refuse frames that do not fit, or a scan without flats."""
    for name, frames in (("flats", wanted.flats), ("darks", wanted.darks)):
        if frames is None:
            continue
        if frames.ndim != 4 or frames.shape[1:] != dataset.counts.shape[1:] or not len(frames):
            want = " x ".join(map(str, dataset.counts.shape[1:]))
            raise InputError(f"{name} have shape {frames.shape}, expected (frame, {want}) of {dataset.path}")
        check_counts(frames, name, dataset.signed)
    stored = find_array(dataset.file, FLAT)
    if wanted.flats is None and (stored is None or not stored.shape[0]):
        raise DatasetError(f"{dataset.path} has no flat field: name open-beam frames by --flats")


def _replace_frames(copy: CorrectedCopy, dataset: Dataset, wanted: Wanted) -> list[str]:
    """Write flats and darks that were given; returns phrases."""
    done = []
    for name, frames, place in (("flats", wanted.flats, FLAT), ("darks", wanted.darks, DARK)):
        if frames is not None:
            copy.replace_frames(place, frames.astype(dataset.counts.dtype), dataset.spectra.units)
            done.append(f"{name}: {len(frames)} frames that were given")
    return done


def _bits(dataset: Dataset, channel: str) -> UInt32[np.ndarray, "row column"]:
    """Stored mask of a channel."""
    stored = mask_of(dataset.file, channel)
    return np.zeros(dataset.counts.shape[2:], np.uint32) if stored is None else stored[()].astype(np.uint32)


def _check_left(dataset: Dataset, measures: Bool[np.ndarray, "channel row column"]) -> None:
    """Refuse masks that leave nothing of a channel."""
    for name, channel in zip(dataset.spectra.channels, measures, strict=True):
        if not channel.any():
            raise InputError(f"{dataset.path}: no pixel of {name} measures by its flats and views")


def _from_views(
    sums: ScanSums, measures: Bool[np.ndarray, "channel row column"], wanted: Wanted
) -> tuple[TubeOutput, tuple[PixelGains, ...]]:
    """Tube output, and gains of all channels where they are asked for."""
    dataset = sums.dataset
    blocks, of_runs, runs = sums.blocks_and_runs(measures)
    output = tube_output(blocks)
    if "rings" not in wanted.steps:
        return output, ()
    exposure = dataset.exposure * output.factors[:, None] if _applies(output, wanted) else dataset.exposure
    taken = np.stack([exposure[run].sum(axis=0) for run in runs])[:, :, None, None]
    expected = taken * sums.air
    transmissions = np.divide(of_runs, expected, out=np.zeros_like(of_runs), where=expected > 0)
    seen = [transmissions[taken[:, c, 0, 0] > 0, c] for c in range(transmissions.shape[1])]
    return output, tuple(pixel_gains(one, mask) for one, mask in zip(seen, measures, strict=True))


def _applies(output: TubeOutput | None, wanted: Wanted) -> bool:
    """Whether the tube output is to be written."""
    return output is not None and "drift" in wanted.steps and output.is_known and not output.is_steady


def _about_masks(dataset: Dataset, masks: tuple[UInt32[np.ndarray, "row column"], ...]) -> list[str]:
    """Describe the bad pixels."""
    counts = [
        f"{int(np.count_nonzero(mask))} in {name}" for name, mask in zip(dataset.spectra.channels, masks, strict=True)
    ]
    return [f"bad pixels: {', '.join(counts)}, of {masks[0].size}"]


def _about_views(dataset: Dataset, output: TubeOutput, gains: tuple[PixelGains, ...], wanted: Wanted) -> list[str]:
    """Describe tube output and gains."""
    done = []
    if "drift" in wanted.steps:
        noise, changes = float(np.sqrt(np.mean(output.uncertainty**2))), float(np.std(output.factors))
        if not output.is_known:
            done.append("tube output: left as stated, as too little of the panel sees air in all views")
        elif output.is_steady:
            done.append(f"tube output: left as stated, as it is steady within its noise of {noise:.1e}")
        else:
            done.append(
                f"tube output: changes of {changes:.2%} rms from view to view, each known to {noise:.2%} by "
                f"{int(output.blocks.sum())} blocks of air"
            )
    for name, one in zip(dataset.spectra.channels, gains, strict=False):
        if not np.isfinite(one.noise):
            done.append(f"gains of {name}: left alone, as there are too few views or pixels")
        elif one.spread < LEAST:
            done.append(f"gains of {name}: left as in the flats, as they differ by {one.spread:.2%} rms only")
        else:
            done.append(f"gains of {name}: {one.spread:.2%} rms beyond the flats, each known to {one.noise:.2%}")
    return done


def _write(copy: CorrectedCopy, dataset: Dataset, found: Corrected, wanted: Wanted) -> None:
    """Replace masks, tube output and flats."""
    for name, mask in zip(dataset.spectra.channels, found.masks, strict=True):
        if mask.any():
            copy.replace_mask(name, mask)
    if _applies(found.output, wanted) and found.output is not None:
        copy.replace_exposure(dataset.exposure * found.output.factors[:, None])
    if any((one.gain != 1).any() for one in found.gains):
        copy.replace_frames(
            FLAT, _with_gains(dataset, np.stack([one.gain for one in found.gains])), dataset.spectra.units
        )


def _with_gains(dataset: Dataset, gain: Float[np.ndarray, "channel row column"]) -> Frames:
    """Flats times gains, above the darks."""
    stored = array_at(dataset.file, FLAT)
    frames = np.empty(stored.shape, stored.dtype)
    for number in range(len(frames)):
        changed = dataset.dark + (stored[number] - dataset.dark) * gain
        frames[number] = np.rint(changed) if frames.dtype.kind in "iu" else changed
    return frames
