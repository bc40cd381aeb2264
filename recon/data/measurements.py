"""What the reconstructor sees: counts, open beam, geometry and the spectral model of some of the views."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.poses import Geometry
from recon.data.array_store import IN_MEMORY, ArrayStore, release, taken
from recon.data.partial_volume import doubtful_shares, even_shares, excess_of_blocks, excess_of_pixels
from recon.data.readout_noise import with_floor, without_floor
from spectra.detector.dead_time import DeadTime
from spectra.errors import InputError
from spectra.threads import run_parallel
from spectra.transmission import Transmission

HARDENING = 1.5  # a hardened beam is attenuated less per line integral than the open beam, so boxes get this much room


@dataclass(frozen=True, eq=False)
class Measurements:
    """Counts and what is known about how they came about.

    Parameters
    ----------
    counts : measured counts minus dark, corrected for dead time, float32; sums of energies in units whose open-beam
        variance is their mean; `recon.data.readout_noise` has what noise without beam adds
    gains : open-beam counts of each pixel over those that `transmission` expects, float32; 0 where a pixel or a
        channel is blind or masked, and then counts are 0 as well
    exposure : tube output of each view and channel relative to the flat frames; 0 where a view was not taken
    geometry : poses of the views
    transmission : columns are the basis functions, and after them the parts of `profile`
    basis_names : names of the basis functions
    profile : what a bowtie filter and the heel effect add to the rays of each pixel; None where there are none
    shares : of the deviance of each count that a fit minds; None where it minds all of all, see `weighted`
    apart : blocks of pixels of the whole panel that no fit minds, see `recon.gaussians.unseen_rays`; None where there
        are none
    """

    counts: Float[np.ndarray, "view channel row column"]
    gains: Float[np.ndarray, "channel row column"]
    exposure: Float[np.ndarray, "view channel"]
    geometry: Geometry
    transmission: Transmission
    basis_names: tuple[str, ...]
    profile: Float[np.ndarray, "part row column"] | None = None
    shares: Float[np.ndarray, "view channel row column"] | None = None
    apart: Bool[np.ndarray, "view block_row block_column"] | None = None

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, views: slice | list[int] | np.ndarray) -> "Measurements":
        """Some of the views."""
        counts = taken(self.counts, views)
        shares = None if self.shares is None else taken(self.shares, views)
        apart, exposure = None if self.apart is None else self.apart[views], self.exposure[views]
        geometry = self.geometry[views]
        return replace(self, counts=counts, exposure=exposure, geometry=geometry, shares=shares, apart=apart)

    def summed(self, factor: int) -> "Measurements":
        """The same scan with `factor` x `factor` pixels as one, whose counts are the sums of theirs, as noisy as such.

        Shares are of pixels, and are left out.
        """
        if factor == 1:
            return self
        geometry = self.geometry.binned(factor)  # refuses panels that do not divide
        counts, gains = (_sum_blocks(images, factor) for images in (self.counts, self.gains))
        profile = None if self.profile is None else _sum_blocks(self.profile, factor) / factor**2
        coarse = replace(self, counts=counts, gains=gains, geometry=geometry, profile=profile, shares=None)
        if profile is None:
            return coarse
        open_beam = _sum_blocks(self.gains * self.open_beam, factor)
        return replace(coarse, gains=_ratio(open_beam, coarse.open_beam).astype(np.float32))

    def binned(self, factor: int) -> "Measurements":
        """The same as `summed`, but with line integrals that are the means of those of the pixels.

        The excess of a mean over a geometric mean is taken off (`recon.data.partial_volume`).
        """
        if factor == 1:
            return self
        coarse, air = self.summed(factor), self.gains * self.open_beam

        def correct(view: int) -> None:
            image, beam = np.asarray(self.counts[view]), air * self.exposure[view, :, None, None]
            coarse.counts[view] *= np.exp(-excess_of_blocks(image, beam, factor))

        _in_parallel(correct, self.counts)
        return coarse

    def without_partial_volume(self, store: ArrayStore = IN_MEMORY) -> "Measurements":
        """Counts as if each pixel were one ray, whose line integrals are the pixel's means; they live in `store`."""
        counts, air = store.empty("corrected", self.counts.shape), self.gains * self.open_beam

        def correct(view: int) -> None:
            image, beam = np.asarray(self.counts[view]), air * self.exposure[view, :, None, None]
            counts[view] = image * np.exp(-excess_of_pixels(image, beam))

        _in_parallel(correct, self.counts)
        release(counts)
        return replace(self, counts=counts)

    def weighted(self, dispersion: float, store: ArrayStore = IN_MEMORY) -> "Measurements":
        """The same counts, with shares that live in `store`.

        Rays close to each other get the same say, and counts less where their correction for partial volume is in
        doubt (`recon.data.partial_volume`); `dispersion` is the relative model error besides.
        """
        shares, air = store.empty("shares", self.counts.shape), self.gains * self.open_beam

        def fill(view: int) -> None:
            image, beam = np.asarray(self.counts[view]), air * self.exposure[view, :, None, None]
            shares[view] = even_shares(image, beam) * doubtful_shares(image, beam, dispersion)
            if self.apart is not None:
                shares[view, :, touched(self.apart[view], *image.shape[1:])] = 0

        _in_parallel(fill, self.counts)
        release(shares)
        return replace(self, shares=shares)

    @property
    def open_beam(self) -> Float[np.ndarray, "channel row column"]:
        """Counts that `transmission` expects in each pixel without an object."""
        if self.profile is None:
            air = self.transmission.open_beam[:, None, None]
            return np.broadcast_to(air, (len(air), *self.counts.shape[2:]))
        rows, columns = self.profile.shape[1:]
        nothing = np.zeros((rows, columns, len(self.basis_names)))
        return np.moveaxis(self.transmission.expected(self.with_profile(nothing)), -1, 0)

    @property
    def unseen(self) -> Bool[np.ndarray, "row column"]:
        """Pixels in which too few channels measure to tell the bases apart."""
        channels = (self.gains > 0).sum(axis=0)
        return channels < min(len(self.basis_names), int(channels.max(initial=0)))

    def with_profile(
        self, lengths: Float[np.ndarray, "... row column basis"]
    ) -> Float[np.ndarray, "... row column basis_and_part"]:
        """Line integrals of the bases as `transmission` takes them."""
        if self.profile is None:
            return lengths
        fixed = np.moveaxis(self.profile, 0, -1).astype(lengths.dtype)
        return np.concatenate([lengths, np.broadcast_to(fixed, (*lengths.shape[:-1], len(self.profile)))], axis=-1)

    def completed(self, some: Int[np.ndarray, " few"] | None = None) -> "Measurements":
        """Views, or some of them, that lack a channel get it from those before and after, by interpolated logarithms.

        Tube voltages that are switched from view to view leave every ray with half of the channels. What this makes up
        is good enough to start a fit from; the fit itself keeps to what was measured. A channel that no view has stays
        unmeasured.
        """
        chosen = self if some is None else self[some]
        if (self.exposure > 0).all():
            return chosen
        counts, exposure = np.array(chosen.counts), np.array(chosen.exposure)
        views = np.arange(len(self)) if some is None else some
        for c in np.flatnonzero((self.exposure > 0).any(axis=0)):
            taken = np.flatnonzero(self.exposure[:, c] > 0)
            for place in np.flatnonzero(exposure[:, c] == 0):
                view = views[place]
                after = np.searchsorted(taken, view)
                a, b = taken[max(after - 1, 0)], taken[min(after, len(taken) - 1)]
                part = (view - a) / (b - a) if b > a else 0.0
                logs = [np.log(np.maximum(self.counts[v, c], 0.5) / self.exposure[v, c]) for v in (a, b)]
                counts[place, c] = np.exp((1 - part) * logs[0] + part * logs[1])
                exposure[place, c] = 1.0
        return replace(chosen, counts=counts, exposure=exposure)

    def shifted(self, added: Float[np.ndarray, " channel"], transmission: Transmission) -> "Measurements":
        """Counts with so many more at exposure and gain 1, and the transmission that expects them."""
        more = added[:, None, None] * self.gains * self.exposure[:, :, None, None]
        return replace(self, counts=(self.counts + more).astype(np.float32), transmission=transmission)

    def compressed(self, tolerance: float) -> tuple["Measurements", float]:
        """The same scan with few energy nodes, and the worst error of the log counts that this causes.

        The box of line integrals in which the error holds is read off the data: no line integral of a basis can exceed
        what the least attenuated channel allows.
        """
        bare, floor = without_floor(self.transmission)
        if floor.any():
            few, error = self.shifted(-floor, bare).compressed(tolerance)
            return replace(self, transmission=with_floor(few.transmission, floor)), error
        gains = (self.gains * self.open_beam)[:, ::4, ::4] * self.exposure[:, :, None, None]
        open_beam = np.maximum(gains, 0.5)
        projections = np.log(open_beam / np.maximum(taken(self.counts, np.s_[:, :, ::4, ::4]), 0.5))
        largest = np.maximum(np.quantile(projections, 0.999, axis=(0, 2, 3)), 0.1)
        bases = len(self.basis_names)
        extremes = np.zeros((1, 0)) if self.profile is None else _extremes(self.profile)
        beams = np.hstack([np.zeros((len(extremes), bases)), extremes])
        slopes = self.transmission.log_projection_and_slopes(beams)[1][:, :, :bases].min(axis=0)
        slopes[~self.gains.any(axis=(1, 2))] = 0.0  # a blind channel allows anything
        with np.errstate(divide="ignore"):
            high = HARDENING * (largest[:, None] / slopes).min(axis=0)
        high = np.where(np.isfinite(high), high, 1.0)
        lowest, highest = np.append(-0.05 * high, extremes.min(axis=0)), np.append(high, extremes.max(axis=0))
        few, error = self.transmission.compress(lowest, highest, tolerance)
        return replace(self, transmission=few), error


def read_measurements(
    dataset: Dataset, views: Int[np.ndarray, " view"], bases: int | None = None, store: ArrayStore = IN_MEMORY
) -> Measurements:
    """Measurements of some views of a dataset, in the first `bases` of its basis functions (default all).

    The counts live in `store`.

    Raises
    ------
    InputError
        When the dataset has fewer basis functions, its channels cannot tell so many apart, or their coefficients may be
        negative, as those of singular vectors.
    """
    names = dataset.spectra.basis.names
    count = len(names) if bases is None else bases
    if count > len(names):
        raise InputError(f"{dataset.path} has the bases {', '.join(names)}: {count} were asked for")
    whole = dataset.spectra.transmission()
    if len(whole) < count:
        channels = f"{len(whole)} channel{'s' if len(whole) > 1 else ''}"
        hint = f": use --bases {min(len(whole), 3)}" if len(whole) > 1 else ": a scan needs a channel for each"
        raise InputError(f"{channels} cannot tell {count} bases apart{hint}")
    if dataset.spectra.basis.signed:
        raise InputError(
            f"the basis of {dataset.path} ({', '.join(names)}) gives negative coefficients, which no fit here allows: "
            "make the scan with basis functions of type material, or photoelectric and compton"
        )
    quantum = dataset.spectra.quantum
    unit = quantum[:, None, None]
    columns = np.delete(whole.columns, np.s_[count : len(names)], axis=0)
    transmission = replace(in_quanta(whole, quantum), columns=columns)
    _check_independent(transmission, names[:count])
    profile = dataset.spectra.profile
    flat, dead_time = dataset.flat, dataset.spectra.dead_time
    if dead_time is not None:
        _check_load(dataset, dead_time)
        flat = dead_time.corrected(flat)
    measured = Measurements(
        counts=_read_counts(dataset, views, unit, store),
        gains=np.ones(flat.shape, np.float32),
        exposure=dataset.exposure[views],
        geometry=dataset.geometry[views],
        transmission=transmission,
        basis_names=tuple(names[:count]),
        profile=None if profile is None else profile.lengths,
    )
    gains = np.where(dataset.mask, 0, np.maximum(_ratio(flat / unit, measured.open_beam), 0)).astype(np.float32)
    measured = replace(measured, gains=gains)
    variance = dataset.dark_variance / quantum**2
    if variance.any():
        measured = measured.shifted(variance, with_floor(transmission, variance))
    for image in measured.counts:
        image[:] = np.where(gains > 0, np.maximum(image, 0), np.float32(0))
    release(measured.counts)
    return measured


def _read_counts(
    dataset: Dataset, views: Int[np.ndarray, " view"], unit: Float[np.ndarray, "channel 1 1"], store: ArrayStore
) -> Float[np.ndarray, "view channel row column"]:
    """Counts minus dark, corrected for dead time, one view at a time."""
    counts = store.empty("counts", (len(views), *dataset.counts.shape[1:]))
    dead_time = dataset.spectra.dead_time
    for image, view in zip(counts, views, strict=True):
        seen = dataset.load([int(view)])[0] - dataset.dark
        image[:] = (seen if dead_time is None else dead_time.corrected(seen)) / unit
    release(counts)
    return counts


def in_quanta(transmission: Transmission, quantum: Float[np.ndarray, " channel"]) -> Transmission:
    """Signals in units whose open-beam variance is their mean."""
    return replace(transmission, weights=transmission.weights / np.repeat(quantum, np.diff(transmission.starts)))


def _check_load(dataset: Dataset, dead_time: DeadTime) -> None:
    """Refuse counts that dead time has made ambiguous: more events may mean fewer counts."""
    load = dead_time.per_count * dataset.spectra.weights.sum() * dataset.exposure.max(initial=0.0)
    if load > dead_time.highest_load:
        raise InputError(
            f"{dataset.path} has {load:.3g} events per dead time in the open beam: counts of a {dead_time.model} "
            f"detector can be corrected up to {dead_time.highest_load:g} only"
        )


def _check_independent(transmission: Transmission, names: tuple[str, ...] | list[str]) -> None:
    """Refuse bases that look the same in every channel that counts photons, as all do at a single energy."""
    slopes = transmission.log_projection_and_slopes(np.zeros(len(transmission.columns)))[1][transmission.open_beam > 0]
    slopes = slopes[:, : len(names)]
    scale = np.abs(slopes).max(axis=0, initial=0.0)
    if not (scale > 0).all() or np.linalg.matrix_rank(slopes / scale, tol=1e-9) < len(names):
        raise InputError(
            f"the channels that count photons cannot tell {', '.join(names)} apart: they see too few different energies"
        )


def matching_bin(geometry: Geometry, size: float) -> int:
    """Largest binning whose pixels, seen at the isocentre, do not exceed `size` [mm]; 1 where none does."""
    distance = np.linalg.norm(geometry.panel_center - geometry.source, axis=1)
    magnification = float(np.median(distance / np.linalg.norm(geometry.source, axis=1)))
    panel = geometry.panel
    pixel = min(panel.row_pitch, panel.column_pitch) / magnification
    fitting = [f for f in range(1, 33) if panel.rows % f == 0 and panel.columns % f == 0]
    return max(f for f in fitting if f == 1 or f * pixel <= 1.001 * size)


def touched(
    blocks: Bool[np.ndarray, "block_row block_column"], rows: int, columns: int
) -> Bool[np.ndarray, "row column"]:
    """Pixels of a panel of which a part lies in blocks of it; blocks are no smaller than pixels."""
    for axis, size in enumerate((rows, columns)):
        count, pixel = blocks.shape[axis], np.arange(size)
        first, last = pixel * count // size, -(-(pixel + 1) * count // size) - 1
        blocks = blocks.take(first, axis) | blocks.take(last, axis)
    return blocks


def _extremes(profile: Float[np.ndarray, "part row column"]) -> Float[np.ndarray, "extreme part"]:
    """Lengths of the pixels where some part is thinnest or thickest."""
    lengths = profile.reshape(len(profile), -1).T
    return lengths[[*lengths.argmin(axis=0), *lengths.argmax(axis=0)]]


def _ratio(images: Float[np.ndarray, "..."], others: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Images over others; 0 where those are not positive."""
    return np.divide(images, others, out=np.zeros_like(images), where=others > 0)


def _in_parallel(task: Callable[[int], None], counts: Float[np.ndarray, "view channel row column"]) -> None:
    """Do something with the counts of every view."""
    for _ in run_parallel(task, range(len(counts))):
        pass
    release(counts)


def _sum_blocks(images: Float[np.ndarray, "... y x"], factor: int) -> Float[np.ndarray, "... row column"]:
    *front, rows, columns = images.shape
    return images.reshape(*front, rows // factor, factor, columns // factor, factor).sum(axis=(-3, -1))
