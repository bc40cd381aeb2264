"""From a raw scan to a dataset, view by view: values become counts or signals, pixels are summed, faults are marked."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped

from phantomgen.dataset.checks.counts import check_counts
from phantomgen.dataset.layout import pack_image, write_image
from phantomgen.dataset.reader import Region
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.writing.writer import DatasetWriter, Splits, check_dataset_name
from phantomgen.degradation.panel import binned_mask, binned_sum, check_bin
from phantomgen.effects.defects import DEAD
from phantomgen.geometry.panel_changes import smaller_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.importers.scans.beam import spectra_of
from phantomgen.importers.scans.raw_scan import Frames, RawScan
from phantomgen.importers.scans.volume import seen_grid
from spectra.errors import InputError

_LARGEST = np.iinfo(np.int32).max
# -log of less than this part of the photons is no attenuation but noise or a fault.
_LOWEST_INTEGRAL = -5.0


@dataclass(frozen=True)
class Wanted:
    """What is to be written of a scan.

    Parameters
    ----------
    basis : names of basis functions; see `phantomgen.importers.scans.beam.spectra_of`
    bin : pixels along each side that are summed
    every : every so many-th training view is taken
    test_views : training views, evenly spread, that become test views
    voxels, size : of the volume to reconstruct, along x and y [mm]; see `phantomgen.importers.scans.volume`
    air : rows and columns of the panel, in pixels of the file, that see air in every view
    cumulative : whether a channel counts all photons above its threshold
    """

    basis: tuple[str, ...] = ()
    bin: int = 1
    every: int = 1
    test_views: int = 0
    voxels: int | None = None
    size: float | None = None
    air: Region | None = None
    cumulative: bool = False


@dataclass(frozen=True)
class Imported:
    """What was written.

    Parameters
    ----------
    path : the dataset
    shape : views, channels, rows, columns
    channels : names of the channels
    grid : voxels to reconstruct
    notes : sentences on what was taken to be so
    """

    path: Path
    shape: tuple[int, int, int, int]
    channels: tuple[str, ...]
    grid: Grid
    notes: tuple[str, ...]


def write_raw_scan(
    raw: RawScan, out: Path, wanted: Wanted, overwrite: bool = False, on_view: Callable[[], object] = lambda: None
) -> Imported:
    """Write the dataset of a scan. It is complete or absent.

    Parameters
    ----------
    raw : the scan
    out : name of the dataset
    wanted : what is to be written
    overwrite : replace a file that exists
    on_view : called after each view

    Returns
    -------
    what was written

    Raises
    ------
    InputError
        When facts are missing or do not fit the data.
    """
    check_dataset_name(out)
    scan = _Finished(raw, wanted)
    scan.check()
    spectra, geometry, views = scan.spectra, scan.geometry, scan.views
    shape = (len(views), len(raw.channels), geometry.panel.rows, geometry.panel.columns)
    with DatasetWriter(out, overwrite) as writer:
        writer.write_scan(raw.title, geometry, spectra, scan.grid, scan.splits, "imported", scan.exposure)
        writer.write_instrument(geometry, spectra, _source_fields(raw))
        mask = scan.mask
        writer.write_mask(spectra.channels, mask if mask.any() else None)
        writer.write_step("import", 1, 0, scan.notes, json.dumps(_settings(raw, wanted), default=str))
        frames = {"flat": scan.flats, "dark": scan.darks}
        flats, darks = (0 if stack is None else len(stack) for stack in frames.values())
        arrays = writer.new_counts(shape, flats, darks, scan.is_integer, spectra.units)
        for kind, stack in frames.items():
            for number, image in enumerate([] if stack is None else stack):
                _store(writer, arrays[kind], number, image)
        for place, view in enumerate(views):
            _store(writer, arrays["data"], place, scan.image(int(view)))
            on_view()
        writer.finish(spectra)
    return Imported(out, shape, raw.channels, scan.grid, (*scan.notes, *scan.clipped_notes))


def _store(writer: DatasetWriter, array: Any, frame: int, image: Shaped[np.ndarray, "channel row column"]) -> None:
    """Write one frame of all channels."""
    for channel, one in enumerate(image):
        write_image(array, frame, channel, pack_image(np.ascontiguousarray(one, array.dtype), writer.compression))


class _Finished:
    """A raw scan in the units of a dataset; images one by one."""

    def __init__(self, raw: RawScan, wanted: Wanted) -> None:
        self.raw, self.wanted = raw, wanted
        self._clipped = 0

    def check(self) -> None:
        """Refuse what does not fit, before anything is written."""
        raw, wanted, panel = self.raw, self.wanted, self.raw.geometry.panel
        self._raw_image(0)  # sizes that a file states are believed when an image has them
        check_bin(panel.rows, panel.columns, wanted.bin)
        if not 1 <= wanted.every <= self._train:
            raise InputError(f"--every {wanted.every} leaves no view: {raw.path} has {self._train}")
        if not 0 <= wanted.test_views < len(self._training):
            raise InputError(
                f"--test-views {wanted.test_views} of {len(self._training)} views leave none to reconstruct from"
            )
        if wanted.air is not None and (wanted.air[0].stop > panel.rows or wanted.air[1].stop > panel.columns):
            raise InputError(f"--air reaches beyond the panel of {panel.rows} x {panel.columns} pixels")
        for name, frames in (("flats", raw.flats), ("darks", raw.darks)):
            want = (len(raw.channels), panel.rows, panel.columns)
            if frames is not None and frames.shape[1:] != want:
                raise InputError(f"{raw.path}: {name} have shape {frames.shape[1:]}, the views {want}")
        raw.stated.require(raw.path, self._needed)
        _ = self.spectra, self.flats, self.grid
        if self.mask.all():
            raise InputError(f"{raw.path}: no pixel reads more in the open beam than without beam")

    @property
    def _needed(self) -> list[str]:
        """Facts that these values need."""
        needed = [] if self.raw.values == "counts" and not self._is_signal else ["photons"]
        if self.raw.flats is None and self.raw.values == "readings" and self.wanted.air is None:
            needed.append("white")
        return needed

    @property
    def _is_signal(self) -> bool:
        return self.raw.stated.scintillator is not None

    @cached_property
    def _train(self) -> int:
        return len(self.raw.geometry) if self.raw.train is None else self.raw.train

    @cached_property
    def _training(self) -> Int64[np.ndarray, " view"]:
        return np.arange(0, self._train, self.wanted.every)

    @cached_property
    def views(self) -> Int64[np.ndarray, " view"]:
        """Numbers of the views that are written."""
        return np.concatenate([self._training, np.arange(self._train, len(self.raw.geometry))])

    @cached_property
    def splits(self) -> Splits:
        """Places of the views for training and for tests."""
        count, tests = len(self._training), self.wanted.test_views
        picked = ((np.arange(tests) + 0.5) * count / max(tests, 1)).astype(int)
        own = np.arange(count, len(self.views))
        return {
            "train": np.delete(np.arange(count), picked),
            "test": np.concatenate([picked, own]),
            "val": np.empty(0, np.int64),
        }

    @cached_property
    def geometry(self) -> Geometry:
        """Poses of the views and pixels that are written."""
        whole = self.raw.geometry[self.views]
        return smaller_panel(whole, slice(0, whole.panel.columns), self.wanted.bin)

    @cached_property
    def grid(self) -> Grid:
        """Voxels to reconstruct."""
        wish = self.wanted
        if self.raw.grid is not None and wish.voxels is None and wish.size is None:
            return self.raw.grid
        return seen_grid(self.geometry, wish.voxels, wish.size)

    @cached_property
    def spectra(self) -> Spectra:
        """The spectral model, with as many photons as the open beam shows in the pixels that are written."""
        spectra = spectra_of(self.raw.stated, self.raw.channels, self.wanted.basis)
        summed = self.wanted.bin**2
        if self._scales:
            return replace(spectra, source=spectra.source * summed)
        level = self._open_beam
        if level is None:
            return spectra
        return replace(spectra, source=spectra.source * (level.sum() * summed / spectra.weights.sum()))

    @cached_property
    def _stated_level(self) -> Float[np.ndarray, " channel"]:
        """Counts or signal of a pixel of the file that the stated photons make in each channel."""
        return spectra_of(self.raw.stated, self.raw.channels, self.wanted.basis).weights.sum(axis=1)

    @property
    def _scales(self) -> bool:
        """True where values are scaled to the stated number of photons."""
        return self.raw.values != "counts" or self._is_signal

    @cached_property
    def _separated(self) -> tuple[Frames | None, Frames | None]:
        """Flats and darks by channel, of counters that count all photons above each threshold."""
        return self._apart(self.raw.flats), self._apart(self.raw.darks)

    def _apart(self, frames: Any) -> Any:
        """Counts between thresholds; channels are the third axis from the end."""
        if frames is None or not self.wanted.cumulative:
            return frames
        above = np.moveaxis(frames, -3, 0).astype(np.float64)
        return np.moveaxis(np.concatenate([above[:-1] - above[1:], above[-1:]]), 0, -3)

    @cached_property
    def _dark(self) -> Shaped[np.ndarray, "channel row column"] | float:
        """Mean reading without beam."""
        darks = self._separated[1]
        return 0.0 if darks is None or not len(darks) else darks.mean(axis=0)

    @cached_property
    def _open_pixels(self) -> Float[np.ndarray, "channel row column"] | None:
        """Reading of each pixel in the open beam above its dark level; None where it is not known."""
        raw, flats, panel = self.raw, self._separated[0], self.raw.geometry.panel
        shape = len(raw.channels), panel.rows, panel.columns
        if flats is not None and len(flats):
            return flats.mean(axis=0) - self._dark
        if raw.stated.white is not None:
            return np.broadcast_to(raw.stated.white, shape) - self._dark
        if self.wanted.air is not None:
            level = self._air_levels.mean(axis=0)
            return np.broadcast_to(level[:, None, None], shape)
        return None

    @cached_property
    def _open_beam(self) -> Float[np.ndarray, " channel"] | None:
        """Mean of `_open_pixels` over pixels that work."""
        found = self._open_pixels
        if found is None:
            return None
        return np.array([one[one > 0].mean() if (one > 0).any() else 0.0 for one in found])

    @cached_property
    def _air_levels(self) -> Float[np.ndarray, "view channel"]:
        """Mean reading above the dark level in the region of air, in each view."""
        rows, columns = self.wanted.air or (slice(None), slice(None))

        def level(view: int) -> Float[np.ndarray, " channel"]:
            return (self._apart(self._raw_image(view)) - self._dark)[:, rows, columns].mean(axis=(1, 2))

        return np.stack([level(int(view)) for view in self.views])

    @cached_property
    def _factor(self) -> Float[np.ndarray, "channel 1 1"]:
        """Return the factor of a reading."""
        level = self._open_beam
        if not self._scales or self.raw.values == "line-integrals" or level is None:
            return np.ones((len(self.raw.channels), 1, 1))
        return (self._stated_level / np.maximum(level, np.finfo(float).tiny))[:, None, None]

    @cached_property
    def exposure(self) -> Float[np.ndarray, "view channel"] | None:
        """Tube output of the views, from the file, and from the region of air."""
        given = None if self.raw.exposure is None else self.raw.exposure[self.views]
        if self.wanted.air is None or self.raw.values == "line-integrals":
            return given
        open_beam = self._open_pixels
        assert open_beam is not None  # as there is a region of air
        rows, columns = self.wanted.air
        level = open_beam[:, rows, columns].mean(axis=(1, 2))
        return self._air_levels / level

    @cached_property
    def mask(self) -> Shaped[np.ndarray, "row column"]:
        """Bits of pixels that read no more in the open beam than without beam, of the panel that is written."""
        open_beam, panel = self._open_pixels, self.raw.geometry.panel
        if open_beam is None or self.raw.values == "line-integrals":
            return np.zeros((panel.rows // self.wanted.bin, panel.columns // self.wanted.bin), np.uint32)
        return binned_mask(np.where(self._blind(open_beam), np.uint32(DEAD), np.uint32(0)), self.wanted.bin)

    def _blind(self, open_beam: Float[np.ndarray, "channel row column"]) -> Bool[np.ndarray, "row column"]:
        return np.logical_not((np.isfinite(open_beam) & (open_beam > 0)).all(axis=0))

    @cached_property
    def is_integer(self) -> bool:
        """True where integer counts are written."""
        kinds = [
            self._raw_image(0).dtype.kind,
            *(f.dtype.kind for f in (self.raw.flats, self.raw.darks) if f is not None),
        ]
        return (
            not self._scales and set(kinds) <= {"i", "u"} and self.raw.stated.white is None and self.wanted.air is None
        )

    @cached_property
    def flats(self) -> Frames | None:
        """Open-beam frames as they are written."""
        flats, wish = self._separated[0], self.wanted
        if self.raw.values == "line-integrals":
            panel = self.geometry.panel
            level = self._stated_level * wish.bin**2
            return np.broadcast_to(level[None, :, None, None], (1, len(level), panel.rows, panel.columns))
        if flats is not None and len(flats):
            return self._written(flats, "flats")
        found = self._open_pixels
        return None if found is None else self._written((found + self._dark)[None], "the open beam")

    @cached_property
    def darks(self) -> Frames | None:
        """Frames without beam as they are written."""
        darks = self._separated[1]
        return None if darks is None or self.raw.values == "line-integrals" else self._written(darks, "darks")

    def image(self, view: int) -> Shaped[np.ndarray, "channel row column"]:
        """Counts or signals of a view, as they are written."""
        values = self._apart(self._raw_image(view))
        where = f"view {view} of {self.raw.path}"
        if self.raw.values == "line-integrals":
            check_counts(values, where, signed=True)
            if values.size and values.min() < _LOWEST_INTEGRAL:
                raise InputError(f"{where} holds line integrals down to {values.min():.3g}: are these counts?")
            values = self._stated_level[:, None, None] * np.exp(-values.astype(np.float64))
            return binned_sum(values, self.wanted.bin)
        return self._written(values, where)

    def _raw_image(self, view: int) -> Shaped[np.ndarray, "channel row column"]:
        """Values of the file, of the shape that it must have."""
        image, panel = self.raw.image(view), self.raw.geometry.panel
        want = len(self.raw.channels), panel.rows, panel.columns
        if image.shape != want:
            raise InputError(f"view {view} of {self.raw.path} has shape {image.shape}, expected {want}")
        return image

    def _written(self, values: Any, where: str) -> Any:
        """Values times their factor, with pixels summed; counts are not negative."""
        check_counts(values, where, signed=True)
        if not self._is_signal and values.size and values.min() < 0:
            self._clipped += int(np.count_nonzero(values < 0))
            values = np.maximum(values, 0)
        wide = values.astype(np.int64) if self.is_integer else values * self._factor
        summed = binned_sum(wide, self.wanted.bin)
        if self.is_integer and summed.max(initial=0) > _LARGEST:
            raise InputError(f"{where}: a count exceeds {_LARGEST}")
        return summed

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """State what was done, and what was assumed."""
        raw, blind, found = self.raw, int(np.count_nonzero(self.mask)), list(self.raw.notes)
        stated = raw.stated
        if raw.values == "line-integrals":
            found.append(
                f"line integrals became mean counts of {stated.photons:g} photons per pixel, without noise of their own"
            )
        elif self._scales:
            found.append(f"readings were scaled so that the open beam is that of {stated.photons:g} photons per pixel")
        elif self.flats is None:
            found.append("there is no open beam: recon fit needs --air rows,columns")
        if len(raw.channels) == 1:
            name = self.spectra.basis.names[0]
            found.append(f"one channel: the volume is the amount of {name}, hardening of the beam by {name} corrected")
        return (*found, f"{blind} pixels without signal in the open beam are masked") if blind else tuple(found)

    @property
    def clipped_notes(self) -> tuple[str, ...]:
        """State what was cut while images were written."""
        return (f"{self._clipped} negative counts were set to 0",) if self._clipped else ()


def _settings(raw: RawScan, wanted: Wanted) -> dict[str, Any]:
    """All that steered the import."""
    air = wanted.air and [[part.start, part.stop] for part in wanted.air]
    return {"file": raw.path.name, "values": raw.values, **vars(raw.stated), **vars(wanted), "air": air}


def _source_fields(raw: RawScan) -> dict[str, tuple[Any, str | None]]:
    """Collect what the file states about the source."""
    stated = raw.stated
    if stated.kvp is None:
        return {"type": ("Synchrotron X-ray Source", None)} if stated.energy is not None else {}
    return {
        "type": ("Fixed Tube X-ray", None),
        "voltage": (stated.kvp, "kV"),
        "target_material": (stated.anode, None),
    }
