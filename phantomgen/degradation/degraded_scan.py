"""One dataset with settings applied: what is stated in the new file, and its images one by one."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped, UInt32

from phantomgen.dataset.beam_profile import StoredProfile
from phantomgen.dataset.checks.counts import check_counts
from phantomgen.dataset.checks.door import array_at, find_array, frame_at, group_at, has, value_at
from phantomgen.dataset.file import DARK, FLAT
from phantomgen.dataset.geometry import read_geometry
from phantomgen.dataset.layout import text_of
from phantomgen.dataset.pixel_mask import mask_of
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.degradation.dose import counts_at_dose, dose_seed, signal_at_dose
from phantomgen.degradation.misstatements import with_voltage
from phantomgen.degradation.panel import (
    binned_mask,
    binned_mean,
    binned_sum,
    check_bin,
    columns_left,
)
from phantomgen.degradation.settings import Degradation
from phantomgen.degradation.views import Splits, evenly_spread, renumbered, within_arc
from phantomgen.effects.defects import DEAD, HOT, Defects, stuck
from phantomgen.effects.random_streams import Stream, generator
from phantomgen.geometry.panel_changes import moved_panel, smaller_panel
from phantomgen.geometry.poses import Geometry
from spectra.detector.counters import above_thresholds, between_thresholds
from spectra.errors import InputError

Images = Shaped[np.ndarray, "channel row column"]
_LARGEST = np.iinfo(np.int32).max
_SOURCE = "/entry/instrument/source"
_HOT = 2.0  # reading of a hot pixel, in open beams; the default of scenes


@dataclass(frozen=True, eq=False)
class DegradedScan:
    """A dataset made worse; parts are computed when they are asked for, images one frame at a time.

    Parameters
    ----------
    dataset : open dataset
    settings : what is made worse
    step : number of this step in the history of the file
    """

    dataset: Dataset
    settings: Degradation
    step: int = 2

    def check(self) -> None:
        """Refuse settings that do not go with the dataset, before anything is written.

        Raises
        ------
        InputError
            When they do not.
        """
        wish, dataset = self.settings, self.dataset
        check_bin(dataset.counts.shape[2], self.columns.stop - self.columns.start, wish.bin)
        columns = self.geometry.panel.columns
        if not 0 <= wish.dead_columns <= columns:
            raise InputError(f"the number of dead columns must lie in 0 .. {columns}, got {wish.dead_columns}")
        if not 0 <= wish.saturate < float("inf"):
            raise InputError(f"pixels saturate at a reading above 0, in open beams, got {wish.saturate:g}")
        if (wish.dose < 1 or wish.drift) and dataset.spectra.dead_time is not None:
            raise InputError(
                f"{dataset.path} lost counts to dead time, of which fewer are lost at a lower dose: "
                "simulate it with fewer photons instead, as thinning would be wrong"
            )
        if wish.complement and not self.has_counts:
            raise InputError(f"{dataset.path} does not hold counts of photons, so that no complement of them exists")
        if wish.noise and (self.has_counts or self.is_signal):
            raise InputError(
                f"{dataset.path} has noise already, or no counts: noise is drawn for scans made by --no-noise"
            )
        _ = self.kept, self.geometry, self.stated, self.masks, self.hot_levels

    @property
    def is_signal(self) -> bool:
        """True where the detector integrates energy."""
        return self.dataset.signed

    @property
    def has_counts(self) -> bool:
        """True where values are counts of single photons, with their noise."""
        return self.dataset.counts.dtype.kind in "iu"

    @cached_property
    def is_noise_free(self) -> bool:
        """True where values are means: float counts, or signals whose flats are all the same."""
        flats = find_array(self.dataset.file, FLAT)
        if self.has_counts or not self.is_signal:
            return not self.has_counts
        return flats is not None and flats.shape[0] > 1 and bool((flats[0] == flats[1]).all())

    @cached_property
    def columns(self) -> slice:
        """Columns that are left, before binning."""
        return columns_left(self.dataset.counts.shape[3], self.settings.truncate)

    @cached_property
    def kept(self) -> tuple[Int64[np.ndarray, " left"], Splits]:
        """Numbers of the views that are left, and the splits in terms of their places."""
        wish, dataset = self.settings, self.dataset
        if wish.views is None and wish.arc is None:
            return np.arange(dataset.counts.shape[0]), dataset.splits
        train = dataset.splits["train"]
        if wish.arc is not None:
            train = within_arc(train, dataset.geometry.angles, wish.arc, dataset.geometry.kind == "helical")
        if wish.views is not None:
            train = evenly_spread(train, wish.views)
        return renumbered(dataset.splits, train)

    @cached_property
    def true_geometry(self) -> Geometry:
        """Poses that were used, of the views and pixels that are left."""
        nominal, file = self.dataset.geometry, self.dataset.file
        if has(file, "truth/geometry"):
            nominal = read_geometry(group_at(file, "truth/geometry"), nominal.panel, nominal.angles)
        return smaller_panel(nominal[self.kept[0]], self.columns, self.settings.bin)

    @cached_property
    def geometry(self) -> Geometry:
        """Poses that the file states."""
        nominal = smaller_panel(self.dataset.geometry[self.kept[0]], self.columns, self.settings.bin)
        wish = self.settings
        return moved_panel(nominal, wish.shift, wish.tilt) if wish.shift or wish.tilt else nominal

    @property
    def has_true_geometry(self) -> bool:
        """True where poses that were used are not those that are stated, and the file has a truth."""
        file, wish = self.dataset.file, self.settings
        return has(file, "truth") and (has(file, "truth/geometry") or bool(wish.shift or wish.tilt))

    @cached_property
    def exposure(self) -> np.ndarray:
        """Tube output of each view that is left, relative to the flats."""
        scale = np.asarray(value_at(self.dataset.file, "/entry/exposure/scale"), np.float64)[self.kept[0]]
        return scale if self.settings.flats == "thin" else scale * self.settings.written_dose

    @cached_property
    def source_fields(self) -> dict[str, tuple[object, str | None]]:
        """Collect what the file states about the source, (value, unit) by name."""
        found = {}
        for name, item in group_at(self.dataset.file, _SOURCE).items():
            value, units = item[()], item.attrs.get("units")
            if name == "voltage" and self.settings.kv_error:
                value = float(value) + self.settings.kv_error
            if name == "charge":
                value = float(value) * self.settings.written_dose
            found[name] = (
                text_of(value) if isinstance(value, bytes) else value,
                None if units is None else text_of(units),
            )
        return found

    @cached_property
    def stated(self) -> tuple[Spectra, float]:
        """Spectral model of the file, and the part of the stated photons that lie above its energies."""
        spectra, wish, left_out = self.dataset.spectra, self.settings, 0.0
        if wish.kv_error:
            spectra, left_out = with_voltage(spectra, self.voltage, wish.kv_error, self._anode)
        dose = wish.written_dose if wish.flats == "thin" else 1.0
        profile, dead_time = spectra.profile, spectra.dead_time
        if profile is not None:
            lengths = binned_mean(profile.lengths[..., self.columns], wish.bin)
            profile = StoredProfile(profile.names, lengths, profile.attenuation)
        if dead_time is not None:  # n pixels, each of a load of its own, are one that is dead for a n-th of the time
            dead_time = replace(dead_time, tau_ns=dead_time.tau_ns / wish.bin**2)
        source = spectra.source * (dose * wish.bin**2)
        return replace(spectra, source=source, profile=profile, dead_time=dead_time), left_out

    @cached_property
    def voltage(self) -> float:
        """Voltage of the tube [kV]."""
        found = find_array(self.dataset.file, f"{_SOURCE}/voltage")
        if found is None:
            raise InputError(
                f"{self.dataset.path} states no tube voltage in {_SOURCE}, of which an error could be made"
            )
        return float(found[()])

    @property
    def _anode(self) -> str:
        """Material of the target."""
        found = find_array(self.dataset.file, f"{_SOURCE}/target_material")
        return "tungsten" if found is None else text_of(found[()])

    @cached_property
    def new_defects(self) -> UInt32[np.ndarray, "row column"]:
        """Bits of the pixels that are made dead or hot."""
        panel, wish = self.geometry.panel, self.settings
        chosen = generator(dose_seed(wish.seed, wish.dead_columns, self.step), Stream.DEFECTS, 1, 0)
        columns = tuple(chosen.permutation(panel.columns)[: wish.dead_columns].tolist())
        defects = Defects(dead=wish.dead, hot=wish.hot, columns=columns)
        return defects.mask(dose_seed(wish.seed, wish.dead, self.step), panel.rows, panel.columns)

    @cached_property
    def new_dead(self) -> UInt32[np.ndarray, "row column"]:
        """Bits of the pixels that are made dead, which are marked; hot ones are not."""
        return np.where(self.new_defects & np.uint32(HOT), np.uint32(0), self.new_defects)

    @cached_property
    def hot_levels(self) -> Float[np.ndarray, " channel"]:
        """Reading of hot pixels in each channel: twice the open beam of a pixel of the new panel."""
        return _HOT * self.open_beam if self.settings.hot else np.zeros(len(self.dataset.spectra.channels))

    @cached_property
    def open_beam(self) -> Float[np.ndarray, " channel"]:
        """Median reading of the flats in a pixel of the new panel, of each channel."""
        return np.median(self.dataset.flat, axis=(1, 2)) * self.settings.bin**2

    @cached_property
    def masks(self) -> tuple[UInt32[np.ndarray, "row column"] | None, ...]:
        """Bits of the pixels of each channel; None where a channel has no mask."""
        found = tuple(self._mask(name) for name in self.dataset.spectra.channels)
        if not self.dataset.spectra.cumulative or all(mask is None for mask in found):
            return found
        # Where one counter does not measure, none is changed to the dose.
        joined = np.bitwise_or.reduce([mask for mask in found if mask is not None])
        return (joined,) * len(found)

    def _mask(self, channel: str) -> UInt32[np.ndarray, "row column"] | None:
        """Old and new faults of one channel."""
        stored = mask_of(self.dataset.file, channel)
        if stored is None:
            return self.new_dead if self.new_dead.any() else None
        old = stored[()].astype(np.uint32)[:, self.columns]
        return binned_mask(old, self.settings.bin) | self.new_dead

    def frames(self, kind: str) -> Int64[np.ndarray, " frame"]:
        """Return the numbers of the frames of the new file, as they are counted in the old one.

        Parameters
        ----------
        kind : ``data``, ``flat`` or ``dark``

        Returns
        -------
        numbers
        """
        if kind == "data":
            return self.kept[0]
        found = find_array(self.dataset.file, FLAT if kind == "flat" else DARK)
        return np.arange(0 if found is None else found.shape[0])

    def images(self, kind: str, frame: int) -> list[Shaped[np.ndarray, "row column"]]:
        """Compute one frame of the new file.

        Parameters
        ----------
        kind : ``data``, ``flat`` or ``dark``
        frame : its number in the old file

        Returns
        -------
        values of each channel, of the type that is stored
        """
        dataset = self.dataset
        frames = {"data": lambda: dataset.counts}.get(
            kind, lambda: array_at(dataset.file, FLAT if kind == "flat" else DARK)
        )()
        images = frame_at(frames, frame)
        check_counts(images, f"{frames.name}[{frame}] of {dataset.path}", dataset.signed)
        changed = kind == "data" or (kind == "flat" and self.settings.flats == "thin")
        stream = Stream.DOSE if kind == "data" else Stream.FLAT_DOSE
        at_dose = self._all_at_dose(images, stream, frame) if changed else list(images)
        on_panel = [self._on_panel(image, channel) for channel, image in enumerate(at_dose)]
        if kind != "data" or not self.settings.saturate:
            return on_panel
        limits = np.floor(self.settings.saturate * self.open_beam)
        return [np.minimum(image, limit).astype(image.dtype) for image, limit in zip(on_panel, limits, strict=True)]

    def expected(self, frame: int) -> list[Float[np.ndarray, "row column"]]:
        """Compute the counts without noise of one view.

        Parameters
        ----------
        frame : number of the view in the old file

        Returns
        -------
        means of each channel, float32
        """
        images = frame_at(array_at(self.dataset.file, "/truth/expected"), frame).astype(np.float64)
        dose = self.settings.written_dose * self._output(Stream.DOSE, frame)
        scaled = dose * images + (1 - dose) * self.dataset.dark
        return [self._on_panel(image, channel).astype(np.float32) for channel, image in enumerate(scaled)]

    def _output(self, stream: Stream, frame: int) -> float:
        """Part of the tube output that drift leaves in a frame."""
        if stream != Stream.DOSE or not self.settings.drift:
            return 1.0
        return 1 - self.settings.drift * frame / max(self.dataset.counts.shape[0] - 1, 1)

    def _all_at_dose(self, images: np.ndarray, stream: Stream, frame: int) -> list[np.ndarray]:
        """The images of all channels at the dose asked for, before they are cut and binned."""
        if self.settings.dose == 1 and not self.settings.noise and self._output(stream, frame) == 1:
            return list(images)
        if not self.dataset.spectra.cumulative:
            return [self._at_dose(image, self.dataset.dark[c], stream, frame, c) for c, image in enumerate(images)]
        apart, dark = between_thresholds(images), np.maximum(between_thresholds(self.dataset.dark), 0.0)
        apart = np.where(self._any_masked, 0, np.maximum(apart, 0))
        changed = [self._at_dose(image, dark[c], stream, frame, c) for c, image in enumerate(apart)]
        return list(np.where(self._any_masked, images, above_thresholds(np.stack(changed))))

    @cached_property
    def _any_masked(self) -> Bool[np.ndarray, "row column"]:
        """Pixels with a channel that does not measure."""
        return np.asarray(self.dataset.mask.any(axis=0))

    def _at_dose(self, image: np.ndarray, dark: np.ndarray, stream: Stream, frame: int, channel: int) -> np.ndarray:
        """One image of independent counts, or signals, at the dose asked for."""
        wish = self.settings
        random = generator(dose_seed(wish.seed, wish.dose, self.step), stream, frame, channel)
        dose = wish.dose * self._output(stream, frame)
        if self.has_counts:
            changed = counts_at_dose(image, dark, dose, wish.complement, random)
            return np.where(self.dataset.mask[channel], image, changed)
        if self.is_noise_free:
            means = dose * (image.astype(np.float64) - dark) + dark
            return random.poisson(np.maximum(means, 0.0)) if wish.noise else means
        quantum, variance = float(self.dataset.spectra.quantum[channel]), float(self.dataset.dark_variance[channel])
        changed = signal_at_dose(image.astype(np.float64), dark, dose, quantum, variance, random)
        return np.where(self.dataset.mask[channel], image, changed)

    def _on_panel(self, image: np.ndarray, channel: int) -> np.ndarray:
        """An image of the smaller panel, with new dead and hot pixels, of the type that is stored."""
        wide = image.astype(np.int64 if image.dtype.kind in "iu" else np.float64)
        summed = binned_sum(wide[:, self.columns], self.settings.bin)
        if self.new_defects.any():
            summed = stuck(summed, self.new_defects & np.uint32(DEAD | HOT), float(self.hot_levels[channel]))
        if self.writes_counts and summed.max(initial=0) > _LARGEST:
            raise InputError(f"{self.dataset.path}: the sum of binned counts exceeds {_LARGEST}: bin fewer pixels")
        return summed.astype(np.int32 if self.writes_counts else np.float32)

    @property
    def writes_counts(self) -> bool:
        """True where the new file holds integer counts."""
        return self.has_counts or self.settings.noise


def history(scan: DegradedScan) -> list[str]:
    """Say what was done to a scan.

    Parameters
    ----------
    scan : the scan

    Returns
    -------
    one phrase for each thing that was done
    """
    found = [phrase(scan) for phrase in _PHRASES]
    return [text for text in found if text] or ["nothing changed"]


def _dose_phrase(scan: DegradedScan) -> str:
    """Describe what was done to the dose."""
    wish = scan.settings
    if wish.dose == 1 and not wish.noise:
        return ""
    if scan.has_counts:
        how = "binomial thinning of counts" + (", the complement" if wish.complement else "")
    elif scan.is_noise_free:
        how = "Poisson counts of scaled means" if wish.noise else "scaled means, without noise"
    else:
        frames = len(scan.frames("dark"))
        how = "scaled signals with added noise, that of the electronics " + (
            f"from {frames} darks" if frames > 1 else "taken as 0 for lack of two darks"
        )
    flats = "flats thinned as well" if wish.flats == "thin" else "flats as measured, exposure scaled"
    return f"dose {wish.written_dose:g}: {how}; {flats}"


def _drift_phrase(scan: DegradedScan) -> str:
    """Describe how the tube output drifts."""
    drift = scan.settings.drift
    return f"tube output: falls by {drift:g} of it from the first to the last view, not stated" if drift else ""


def _views_phrase(scan: DegradedScan) -> str:
    """Which views are left."""
    wish, old, new = scan.settings, scan.dataset.splits, scan.kept[1]
    if wish.views is None and wish.arc is None:
        return ""
    arc = "" if wish.arc is None else f" from {wish.arc[0]:g} to {wish.arc[1]:g} degrees"
    others = ", ".join(f"{len(new[name])} {name}" for name in new if name != "train" and len(new[name]))
    return f"views: {len(new['train'])} of {len(old['train'])} training views{arc}" + (
        f"; {others} kept" if others else ""
    )


def _panel_phrase(scan: DegradedScan) -> str:
    """Describe what was done to the panel."""
    wish, phrases = scan.settings, []
    if scan.columns.start:
        phrases.append(f"{scan.columns.start} of {scan.dataset.counts.shape[3]} columns cut off on each side")
    if wish.bin > 1:
        phrases.append(f"{wish.bin} x {wish.bin} pixels summed")
    if scan.new_dead.any():
        columns = f", {wish.dead_columns} columns among them" if wish.dead_columns else ""
        phrases.append(f"{np.count_nonzero(scan.new_dead)} pixels made dead and marked{columns}")
    if wish.hot:
        hot = np.count_nonzero(scan.new_defects & HOT)
        phrases.append(f"{hot} pixels read twice the open beam and are not marked")
    if wish.saturate:
        phrases.append(f"readings of the views end at {wish.saturate:g} times the open beam")
    return f"panel: {', '.join(phrases)}" if phrases else ""


def _statement_phrase(scan: DegradedScan) -> str:
    """Describe what the file misstates."""
    wish, phrases = scan.settings, []
    if wish.shift:
        moved = wish.shift * scan.geometry.panel.column_pitch
        phrases.append(f"stated panel {wish.shift:+g} pixel ({moved:+g} mm) along its columns from the true one")
    if wish.tilt:
        phrases.append(f"stated panel turned by {wish.tilt:+g} degrees in its plane from the true one")
    if wish.kv_error:
        left_out = scan.stated[1]
        phrases.append(
            f"stated spectrum of {scan.voltage + wish.kv_error:g} kV, true one of {scan.voltage:g} kV"
            + (
                f" (photons above {scan.dataset.spectra.edges[-1]:g} keV left out, {left_out:.1e} of all)"
                if left_out
                else ""
            )
        )
    return "; ".join(phrases)


_PHRASES: tuple[Callable[[DegradedScan], str], ...] = (
    _dose_phrase,
    _drift_phrase,
    _views_phrase,
    _panel_phrase,
    _statement_phrase,
)
