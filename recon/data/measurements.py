"""Measurements of a fit: counts, open beam, geometry and the spectral model of some of the views.

`read_measurements` prepares them from a dataset. What is done with the pixels lies in the modules that this one
imports, as functions of plain arrays: partial volume, readout noise, missing channels, blocks of pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter

from phantomgen.dataset.reader import Dataset
from phantomgen.effects.smooth_signal import SmoothSignal
from phantomgen.geometry.poses import Geometry
from recon.data.array_store import IN_MEMORY, ArrayStore, read_part, release
from recon.data.incomplete_counts import LargestReadings, interpolate_missing
from recon.data.partial_volume import (
    LEAST_COUNTS,
    correction_weights,
    excess_of_blocks,
    excess_of_pixels,
    neighbourhood_weights,
)
from recon.data.pixel_blocks import sum_blocks, touched
from recon.data.readout_noise import with_floor, without_floor
from spectra.detector.dead_time import DeadTime
from spectra.errors import InputError
from spectra.threads import run_parallel
from spectra.transmission import Transmission

# Box of line integrals within which energy nodes are exact; all chosen by hand, not measured. The error that results is
# measured for every scan.
SAMPLED = np.s_[::4, ::4]  # rows and columns whose counts tell how large the box must be
LARGEST_PROJECTION = 0.999  # quantile of the log projections of a channel that the box must hold
LEAST_PROJECTION = 0.1  # log projection that the box holds in any case
HARDENING = 1.5  # no unit; factor of the box, as a hard beam is attenuated less per line integral than the open beam
NEGATIVE = 0.05  # no unit, over the largest line integral; room of the box for noise below 0
MOST_BINNING = 32  # pixels; largest binning that `matching_bin` considers


@dataclass(frozen=True, eq=False)
class Measurements:
    """Counts of some views with their calibration, geometry and spectral model.

    Parameters
    ----------
    counts : measured counts minus dark, corrected for dead time, float32; signals of energy-integrating detectors are
        in units in which the open-beam variance equals the mean; readout noise see `recon.data.readout_noise`
    gains : open-beam counts of each pixel over those that `transmission` expects, float32; 0 where a pixel or a
        channel is blind or masked, and then counts are 0 as well
    exposure : tube output of each view and channel relative to the flat frames; 0 where it was not measured
    geometry : poses of the views
    transmission : spectral model whose columns are the basis functions, and after them the parts of `profile`
    basis_names : names of the basis functions
    profile : line integrals of bowtie filter and heel effect in each pixel; None where there are none
    statistical_weights : weight of each count in a fit, from 0 to 1, see `weighted`; None where all weights are 1. Of
        pixels that saturate, the count is that of the open beam, and the weight is minus the reading over it: a lower
        bound
    unseen_blocks : blocks of pixels of the whole panel that are left out of a fit, see `recon.gaussians.unseen_rays`;
        None where there are none
    scatter : expected scattered signal that was subtracted from the counts, in their units; None where it is not known
    """

    counts: Float[np.ndarray, "view channel row column"]
    gains: Float[np.ndarray, "channel row column"]
    exposure: Float[np.ndarray, "view channel"]
    geometry: Geometry
    transmission: Transmission
    basis_names: tuple[str, ...]
    profile: Float[np.ndarray, "part row column"] | None = None
    statistical_weights: Float[np.ndarray, "view channel row column"] | None = None
    unseen_blocks: Bool[np.ndarray, "view block_row block_column"] | None = None
    scatter: SmoothSignal | None = None

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, views: slice | list[int] | np.ndarray) -> "Measurements":
        """Take some of the views."""
        return replace(
            self,
            counts=read_part(self.counts, views),
            exposure=self.exposure[views],
            geometry=self.geometry[views],
            statistical_weights=None
            if self.statistical_weights is None
            else read_part(self.statistical_weights, views),
            unseen_blocks=None if self.unseen_blocks is None else self.unseen_blocks[views],
            scatter=None if self.scatter is None else self.scatter[views],
        )

    def summed(self, factor: int) -> "Measurements":
        """Sum `factor` x `factor` pixels to one; the variance of sums of counts is their mean, as before.

        Parameters
        ----------
        factor : pixels along each side of a block

        Returns
        -------
        the binned scan; of `statistical_weights`, which belong to single pixels, lower bounds alone are kept
        """
        if factor == 1:
            return self
        geometry = self.geometry.binned(factor)  # refuses panels that do not divide
        counts, gains = (sum_blocks(images, factor) for images in (self.counts, self.gains))
        profile = None if self.profile is None else sum_blocks(self.profile, factor) / factor**2
        coarse = replace(
            self,
            counts=counts,
            gains=gains,
            geometry=geometry,
            profile=profile,
            statistical_weights=_bounds_of_blocks(self, factor),
        )
        if profile is None:
            return coarse
        open_beam = sum_blocks(self.gains * self.open_beam, factor)
        return replace(coarse, gains=_ratio(open_beam, coarse.open_beam).astype(np.float32))

    def binned(self, factor: int) -> "Measurements":
        """Bin pixels as `summed` does, with line integrals that are the means of those of the pixels.

        The excess of the mean over the geometric mean is removed (`recon.data.partial_volume`).

        Parameters
        ----------
        factor : pixels along each side of a block

        Returns
        -------
        the binned scan, as `summed` gives it
        """
        if factor == 1:
            return self
        coarse, air = self.summed(factor), self.gains * self.open_beam

        def correct(view: int) -> None:
            image, beam = self._readings(view), air * self.exposure[view, :, None, None]
            coarse.counts[view] *= np.exp(-excess_of_blocks(image, beam, factor))

        _in_parallel(correct, self.counts)
        return coarse

    def without_partial_volume(self, store: ArrayStore = IN_MEMORY) -> "Measurements":
        """Correct the counts for partial volume, as if each pixel were one ray with the mean line integrals.

        Parameters
        ----------
        store : storage of the new counts

        Returns
        -------
        the scan with corrected counts, see `recon.data.partial_volume`
        """
        counts, air = store.empty("corrected", self.counts.shape), self.gains * self.open_beam

        def correct(view: int) -> None:
            image, beam = self._readings(view), air * self.exposure[view, :, None, None]
            counts[view] = np.asarray(self.counts[view]) * np.exp(-excess_of_pixels(image, beam))

        _in_parallel(correct, self.counts)
        release(counts)
        return replace(self, counts=counts)

    def weighted(self, dispersion: float, store: ArrayStore = IN_MEMORY) -> "Measurements":
        """Compute the statistical weights of the counts, `statistical_weights`.

        Rays close to each other get equal weights, and counts lower ones where their correction for partial volume is
        uncertain (`recon.data.partial_volume`). Scatter, whose noise is still in the counts, lowers weights by the part
        of the primary signal in the whole signal: the derivative of the likelihood is then that of Poisson counts with
        scatter. Pixels that are left out get the weight 0, and lower bounds keep theirs.

        Parameters
        ----------
        dispersion : relative model error [no unit]
        store : storage of the weights

        Returns
        -------
        the scan with `statistical_weights`
        """
        statistical_weights, air = store.empty("statistical_weights", self.counts.shape), self.gains * self.open_beam

        def fill(view: int) -> None:
            image, beam = self._readings(view), air * self.exposure[view, :, None, None]
            statistical_weights[view] = neighbourhood_weights(image, beam) * correction_weights(image, beam, dispersion)
            if self.scatter is not None:
                statistical_weights[view] *= _primary_part(image, self.scattered(view))
            if self.statistical_weights is not None:
                bounds = self.statistical_weights[view]
                statistical_weights[view] = np.where(bounds < 0, bounds, statistical_weights[view])
            if self.unseen_blocks is not None:  # lower bounds there take no part either
                statistical_weights[view, :, touched(self.unseen_blocks[view], *image.shape[1:])] = 0

        _in_parallel(fill, self.counts)
        release(statistical_weights)
        return replace(self, statistical_weights=statistical_weights)

    @property
    def bounded(self) -> Float[np.ndarray, " channel"]:
        """Part of the counts of each channel that are lower bounds."""
        if self.statistical_weights is None:
            return np.zeros(self.counts.shape[1])
        return np.mean([(weights < 0).mean(axis=(1, 2)) for weights in self.statistical_weights], axis=0)

    def _readings(self, view: int) -> Float[np.ndarray, "channel row column"]:
        """Counts of a view, with readings in place of open-beam counts where pixels saturate."""
        image = np.asarray(self.counts[view])
        if self.statistical_weights is None:
            return image
        bounds = np.asarray(self.statistical_weights[view])
        return np.where(bounds < 0, -bounds * image, image)

    @property
    def whole_weights(self) -> Float[np.ndarray, "view channel row column"]:
        """Statistical weights, 1 for lower bounds, whatever a model expects there."""
        weights = np.asarray(self.statistical_weights)
        return np.where(weights < 0, np.float32(1), weights)

    def scattered(self, view: int) -> Float[np.ndarray, "channel row column"]:
        """Compute the expected scattered signal of a view.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        signal in the units of the counts, gains and exposure included; 0 where scatter is not known
        """
        if self.scatter is None:
            return np.zeros(self.counts.shape[1:], np.float32)
        image = self.scatter.image(view, *self.counts.shape[2:])
        return (image * self.gains * self.exposure[view, :, None, None]).astype(np.float32)

    @property
    def open_beam(self) -> Float[np.ndarray, "channel row column"]:
        """Counts that `transmission` expects in each pixel without an object, at exposure and gain 1."""
        if self.profile is None:
            air = self.transmission.open_beam[:, None, None]
            return np.broadcast_to(air, (len(air), *self.counts.shape[2:]))
        rows, columns = self.profile.shape[1:]
        nothing = np.zeros((rows, columns, len(self.basis_names)))
        return np.moveaxis(self.transmission.expected(self.with_profile(nothing)), -1, 0)

    @property
    def blind_pixels(self) -> Bool[np.ndarray, "row column"]:
        """Pixels in which too few channels measure to separate the bases."""
        channels = (self.gains > 0).sum(axis=0)
        return channels < min(len(self.basis_names), int(channels.max(initial=0)))

    def with_profile(
        self, lengths: Float[np.ndarray, "... row column basis"]
    ) -> Float[np.ndarray, "... row column basis_and_part"]:
        """Append the line integrals of the profile to those of the bases, as `transmission` needs them.

        Parameters
        ----------
        lengths : line integrals of the bases [no unit]

        Returns
        -------
        line integrals of the bases and of the parts of the profile
        """
        if self.profile is None:
            return lengths
        fixed = np.moveaxis(self.profile, 0, -1).astype(lengths.dtype)
        return np.concatenate([lengths, np.broadcast_to(fixed, (*lengths.shape[:-1], len(self.profile)))], axis=-1)

    def completed(self, some: Int[np.ndarray, " few"] | None = None) -> "Measurements":
        """Interpolate channels that views lack between the views before and after.

        A tube voltage that switches from view to view leaves every ray with half of the channels. The interpolated ones
        suffice for the start of a fit; the fit itself uses measured counts alone. A channel that no view has stays
        missing.

        Parameters
        ----------
        some : indices of the views to return, all by default

        Returns
        -------
        the views with all channels
        """
        chosen = self if some is None else self[some]
        if (self.exposure > 0).all():
            return chosen
        views = np.arange(len(self)) if some is None else some
        counts, exposure = interpolate_missing(self.counts, self.exposure, views)
        return replace(chosen, counts=counts, exposure=exposure)

    def shifted(self, added: Float[np.ndarray, " channel"], transmission: Transmission) -> "Measurements":
        """Add a constant to the counts.

        Parameters
        ----------
        added : counts to add in each channel at exposure and gain 1
        transmission : spectral model of the new counts

        Returns
        -------
        the scan with the new counts
        """
        more = added[:, None, None] * self.gains * self.exposure[:, :, None, None]
        return replace(self, counts=(self.counts + more).astype(np.float32), transmission=transmission)

    def compressed(self, tolerance: float) -> tuple["Measurements", float]:
        """Reduce the energy grid of the spectral model to a few nodes.

        The error holds in a box of line integrals, see `_line_integral_box`.

        Parameters
        ----------
        tolerance : largest error of the log counts [no unit]

        Returns
        -------
        the scan with few energy nodes, and the largest error of the log counts that they cause
        """
        bare, floor = without_floor(self.transmission)
        if floor.any():
            few, error = self.shifted(-floor, bare).compressed(tolerance)
            return replace(self, transmission=with_floor(few.transmission, floor)), error
        few, error = self.transmission.compress(*_line_integral_box(self), tolerance)
        return replace(self, transmission=few), error


def read_measurements(
    dataset: Dataset,
    views: Int[np.ndarray, " view"],
    bases: int | None = None,
    store: ArrayStore = IN_MEMORY,
    separable: bool = True,
) -> Measurements:
    """Read some views of a dataset, and prepare their counts and spectral model.

    Dark and dead time are corrected, the scatter of the dataset is subtracted, and the variance of readout noise is
    added to counts and model.

    Parameters
    ----------
    dataset : an open dataset
    views : indices of the views
    bases : number of basis functions, the first ones of the dataset; all by default
    store : storage of the counts
    separable : whether channels must tell the basis functions apart, as they need not where the materials are known

    Returns
    -------
    the measurements

    Raises
    ------
    InputError
        When the dataset has fewer basis functions, its channels cannot separate so many, or their coefficients may be
        negative, as those of singular vectors.
    """
    names = dataset.spectra.basis.names
    count = len(names) if bases is None else bases
    if count > len(names):
        raise InputError(f"{dataset.path} has the bases {', '.join(names)}: {count} were asked for")
    whole = dataset.spectra.transmission()
    if separable and len(whole) < count:
        channels = f"{len(whole)} channel{'s' if len(whole) > 1 else ''}"
        one = "a scan needs a channel for each, or materials that are known, as with --bases curve"
        hint = one if len(whole) == 1 else f"use --bases {min(len(whole), 3)}"
        raise InputError(f"{channels} cannot tell {count} bases apart: {hint}")
    if dataset.spectra.basis.signed:
        raise InputError(
            f"the basis of {dataset.path} ({', '.join(names)}) gives negative coefficients, which no fit here allows: "
            "make the scan with basis functions of type material, or photoelectric and compton"
        )
    quantum = dataset.spectra.quantum
    unit = quantum[:, None, None]
    columns = np.delete(whole.columns, np.s_[count : len(names)], axis=0)
    transmission = replace(in_quanta(whole, quantum), columns=columns)
    if separable:
        _check_independent(transmission, names[:count])
    profile = dataset.spectra.profile
    flat, dead_time = dataset.flat, dataset.spectra.dead_time
    if dead_time is not None:
        _check_load(dataset, dead_time)
        flat = dataset.spectra.events(flat)
    counts, limits = _read_counts(dataset, views, unit, store)
    measured = Measurements(
        counts=counts,
        gains=np.ones(flat.shape, np.float32),
        exposure=dataset.exposure[views],
        geometry=dataset.geometry[views],
        transmission=transmission,
        basis_names=tuple(names[:count]),
        profile=None if profile is None else profile.lengths,
    )
    gains = np.where(dataset.mask, 0, np.maximum(_ratio(flat / unit, measured.open_beam), 0)).astype(np.float32)
    measured = replace(measured, gains=gains)
    if dataset.scatter is not None:
        measured = replace(measured, scatter=dataset.scatter[views].scaled(1 / quantum))
        for view in range(len(measured)):
            measured.counts[view] -= measured.scattered(view)
    measured = _with_lower_bounds(measured, dataset, views, limits, store)
    variance = dataset.dark_variance / quantum**2
    if variance.any():
        measured = measured.shifted(variance, with_floor(transmission, variance))
    for image in measured.counts:
        image[:] = np.where(gains > 0, np.maximum(image, 0), np.float32(0))
    release(measured.counts)
    return measured


def _read_counts(
    dataset: Dataset, views: Int[np.ndarray, " view"], unit: Float[np.ndarray, "channel 1 1"], store: ArrayStore
) -> tuple[Float[np.ndarray, "view channel row column"], Float[np.ndarray, " channel"]]:
    """Counts minus dark, corrected for dead time, one view at a time; and where the readings of each channel end."""
    counts = store.empty("counts", (len(views), *dataset.counts.shape[1:]))
    flat = dataset.flat
    largest = LargestReadings(~np.broadcast_to(dataset.mask, flat.shape))
    for image, view in zip(counts, views, strict=True):
        readings = dataset.load([int(view)])[0]
        largest.add(readings, flat * dataset.exposure[view, :, None, None] + dataset.dark)
        image[:] = dataset.spectra.events(readings - dataset.dark) / unit
    release(counts)
    return counts, largest.limits()


def _with_lower_bounds(
    measured: Measurements,
    dataset: Dataset,
    views: Int[np.ndarray, " view"],
    limits: Float[np.ndarray, " channel"],
    store: ArrayStore,
) -> Measurements:
    """Counts of the open beam where readings end, and the weights that make them lower bounds."""
    if not np.isfinite(limits).any():
        return measured
    weights = store.empty("lower_bounds", measured.counts.shape)
    open_beam = measured.gains * measured.open_beam
    for number, view in enumerate(views):
        ends = dataset.load([int(view)])[0] >= limits[:, None, None]
        air = open_beam * measured.exposure[number, :, None, None]
        reading = np.array(measured.counts[number])
        measured.counts[number] = np.where(ends, np.maximum(reading, air), reading)
        weights[number] = np.where(ends, -_ratio(reading, measured.counts[number]), 1)
    release(weights)
    return replace(measured, statistical_weights=weights)


def _bounds_of_blocks(measured: Measurements, factor: int) -> Float[np.ndarray, "view channel row column"] | None:
    """Weights of 1 of blocks of pixels, or lower bounds where pixels of a block have some; None where none has."""
    weights, found, any_bound = measured.statistical_weights, [], False
    if weights is None:
        return None
    for image, bounds in zip(measured.counts, weights, strict=True):
        least = np.where(bounds < 0, -bounds * image, image)
        part = _ratio(sum_blocks(least, factor), sum_blocks(np.asarray(image), factor))
        bounded = sum_blocks((bounds < 0).astype(np.float32), factor) > 0
        found.append(np.where(bounded, -part, 1).astype(np.float32))
        any_bound |= bool(bounded.any())
    return np.stack(found) if any_bound else None


def in_quanta(transmission: Transmission, quantum: Float[np.ndarray, " channel"]) -> Transmission:
    """Convert a spectral model to units in which the open-beam variance of each channel equals its mean.

    Parameters
    ----------
    transmission : spectral model in the units of the detector
    quantum : open-beam variance over mean of each channel, in units of the detector

    Returns
    -------
    spectral model in the new units
    """
    return replace(transmission, weights=transmission.weights / np.repeat(quantum, np.diff(transmission.starts)))


def _check_load(dataset: Dataset, dead_time: DeadTime) -> None:
    """Refuse counts that dead time makes ambiguous, as more events may give fewer counts."""
    load = dead_time.per_count * dataset.spectra.weights.sum() * dataset.exposure.max(initial=0.0)
    highest = dataset.spectra.highest_load
    if load > highest:
        raise InputError(
            f"{dataset.path} has {load:.3g} events per dead time in the open beam: counts of a {dead_time.model} "
            f"detector can be corrected up to {highest:g} only"
        )


def _check_independent(transmission: Transmission, names: tuple[str, ...] | list[str]) -> None:
    """Refuse bases with linearly dependent attenuation in the channels, as all have at a single energy."""
    slopes = transmission.log_projection_and_slopes(np.zeros(len(transmission.columns)))[1][transmission.open_beam > 0]
    slopes = slopes[:, : len(names)]
    scale = np.abs(slopes).max(axis=0, initial=0.0)
    if not (scale > 0).all() or np.linalg.matrix_rank(slopes / scale, tol=1e-9) < len(names):
        raise InputError(
            f"the channels that count photons cannot tell {', '.join(names)} apart: they see too few different energies"
        )


def matching_bin(geometry: Geometry, size: float) -> int:
    """Find the largest binning whose pixels, as seen at the isocentre, do not exceed a size.

    Parameters
    ----------
    geometry : poses of the views
    size : largest size of a pixel at the isocentre [mm]

    Returns
    -------
    pixels along each side of a block that become one, 1 where no binning fits
    """
    distance = np.linalg.norm(geometry.panel_center - geometry.source, axis=1)
    magnification = float(np.median(distance / np.linalg.norm(geometry.source, axis=1)))
    panel = geometry.panel
    pixel = min(panel.row_pitch, panel.column_pitch) / magnification
    fitting = [f for f in range(1, MOST_BINNING + 1) if panel.rows % f == 0 and panel.columns % f == 0]
    return max(f for f in fitting if f == 1 or f * pixel <= 1.001 * size)  # 1.001 for rounding errors of poses


def _line_integral_box(
    measured: Measurements,
) -> tuple[Float[np.ndarray, " basis_and_part"], Float[np.ndarray, " basis_and_part"]]:
    """Lowest and highest line integrals of bases and profile that the scan can have, from its counts.

    The line integral of a basis cannot exceed what the least attenuated channel allows.
    """
    air = (measured.gains * measured.open_beam)[:, *SAMPLED] * measured.exposure[:, :, None, None]
    counts = read_part(measured.counts, np.s_[:, :, *SAMPLED])
    projections = np.log(np.maximum(air, LEAST_COUNTS) / np.maximum(counts, LEAST_COUNTS))
    largest = np.maximum(np.quantile(projections, LARGEST_PROJECTION, axis=(0, 2, 3)), LEAST_PROJECTION)
    bases = len(measured.basis_names)
    extremes = np.zeros((1, 0)) if measured.profile is None else _extremes(measured.profile)
    beams = np.hstack([np.zeros((len(extremes), bases)), extremes])
    slopes = measured.transmission.log_projection_and_slopes(beams)[1][:, :, :bases].min(axis=0)
    slopes[~measured.gains.any(axis=(1, 2))] = 0.0  # a blind channel does not limit the box
    with np.errstate(divide="ignore"):
        high = HARDENING * (largest[:, None] / slopes).min(axis=0)
    high = np.where(np.isfinite(high), high, 1.0)
    return np.append(-NEGATIVE * high, extremes.min(axis=0)), np.append(high, extremes.max(axis=0))


def _extremes(profile: Float[np.ndarray, "part row column"]) -> Float[np.ndarray, "extreme part"]:
    """Line integrals of the pixels where some part of the profile is thinnest or thickest."""
    lengths = profile.reshape(len(profile), -1).T
    return lengths[[*lengths.argmin(axis=0), *lengths.argmax(axis=0)]]


def _primary_part(primary: np.ndarray, scattered: np.ndarray) -> Float[np.ndarray, "channel row column"]:
    """Part of the primary signal in the whole signal of one view; noise is reduced by a mean over a few pixels."""
    smooth = np.maximum(gaussian_filter(primary, (0, 1, 1)), LEAST_COUNTS)
    return smooth / (smooth + scattered)


def _ratio(images: Float[np.ndarray, "..."], others: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Images over others; 0 where those are not positive."""
    return np.divide(images, others, out=np.zeros_like(images), where=others > 0)


def _in_parallel(task: Callable[[int], None], counts: Float[np.ndarray, "view channel row column"]) -> None:
    """Run a task for every view, and release the counts."""
    for _ in run_parallel(task, range(len(counts))):
        pass
    release(counts)
