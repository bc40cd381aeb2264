"""Reading a dataset: measured counts, geometry and spectra, lazily; never the truth.

Errors are sentences, also for files that are cut off, of a newer schema, or without a flat field. `Truth` has a module
of its own, so that a reconstructor which imports this one cannot see it by accident.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsInt

import h5py
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped

from phantomgen.dataset.beam_profile import read_profile
from phantomgen.dataset.checks.counts import check_counts
from phantomgen.dataset.checks.digest import missing_chunks
from phantomgen.dataset.checks.door import array_at, find_array, frame_at, group_at, has, value_at
from phantomgen.dataset.checks.fields import ENTRY, form_problems, value_problems
from phantomgen.dataset.file import COUNTERS, CUMULATIVE, DARK, DETECTOR, DISJOINT, FLAT, damaged_file, open_file
from phantomgen.dataset.geometry import read_geometry
from phantomgen.dataset.layout import text_of
from phantomgen.dataset.pixel_mask import read_mask
from phantomgen.dataset.spectral_model import Spectra, in_basis
from phantomgen.dataset.time.view_times import ViewTimes, read_view_times
from phantomgen.effects.smooth_signal import SmoothSignal
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.thumbnails import thumbnails
from spectra.basis.basis import Basis
from spectra.detector.counters import between_thresholds, either_neighbour
from spectra.detector.dead_time import DeadTime
from spectra.detector.pile_up import PulseResponse
from spectra.errors import DatasetError, InputError

if TYPE_CHECKING:
    from xarray import DataArray

    from phantomgen.dataset.adapters.to_torch import ViewSet

Region = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Open dataset; close it, or use it in a ``with`` statement.

    Where the counters of a file count all photons above their thresholds, everything but `counts` is that of the
    channels between thresholds, whose counts are differences of neighbouring counters and independent of each other.

    Parameters
    ----------
    path, file : the file
    air : rows and columns of the panel that see nothing but air, used in place of flats
    on_close : called after the file is closed, such as to remove a temporary one
    scatter : estimate of the scattered signal of every view, see `with_scatter`; None where it is not known
    as_stored : whether counts above thresholds are returned as they are in the file
    """

    path: Path
    file: h5py.File = field(repr=False)
    air: Region | None = None
    on_close: Callable[[], object] | None = field(default=None, repr=False)
    scatter: SmoothSignal | None = field(default=None, repr=False)
    as_stored: bool = False

    def __enter__(self) -> "Dataset":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.file.close()
        if self.on_close is not None:
            self.on_close()

    def __repr__(self) -> str:
        if not self.file:
            return f"Dataset({self.path.name}: closed)"
        views, channels, rows, columns = self.counts.shape
        edges = self.spectra.edges
        shape = f"{views} views x {channels} channels x {rows} x {columns}"
        return f"Dataset({self.name}: {shape}, {edges[0]:g}..{edges[-1]:g} keV)"

    def with_basis(self, basis: Basis) -> "Dataset":
        """Return the same open file with other basis functions than the stored ones.

        Parameters
        ----------
        basis : raw basis functions

        Returns
        -------
        the dataset
        """
        return self._with(spectra=in_basis(self.spectra, basis))

    def with_spectra(self, spectra: Spectra) -> "Dataset":
        """Return the same open file with another spectral model than the stored one.

        Parameters
        ----------
        spectra : of the same channels

        Returns
        -------
        the dataset
        """
        return self._with(spectra=spectra)

    def with_scatter(self, scatter: SmoothSignal) -> "Dataset":
        """Return the same open file with an estimate of the scattered signal, which a reconstruction takes away.

        Parameters
        ----------
        scatter : of every view

        Returns
        -------
        the dataset
        """
        return self._with(scatter=scatter)

    def with_training_views(self, chosen: int | Int[np.ndarray, " view"]) -> "Dataset":
        """Return the same open file with some of the training views.

        Parameters
        ----------
        chosen : number of training views, evenly spread; or their places among all of them

        Returns
        -------
        the dataset

        Raises
        ------
        InputError
            When there are not so many.
        """
        train = self.splits["train"]
        places = np.arange(chosen) * len(train) // chosen if isinstance(chosen, int) and chosen > 0 else chosen
        if not isinstance(places, np.ndarray) or not 1 <= len(places) <= len(train):
            raise InputError(f"{self.path} has {len(train)} training views: {chosen} cannot be used")
        return self._with(splits=self.splits | {"train": train[places]})

    def without_channel(self, name: str) -> "Dataset":
        """Return the same open file with all pixels of one channel masked.

        Parameters
        ----------
        name : name of the channel

        Returns
        -------
        the dataset

        Raises
        ------
        InputError
            When there is no such channel.
        """
        channels = self.spectra.channels
        if name not in channels:
            raise InputError(f"{self.path} has no channel {name!r} to leave out: it has {', '.join(channels)}")
        return self._with(mask=self.mask | (np.array(channels) == name)[:, None, None])

    def with_grid(self, grid: Grid) -> "Dataset":
        """Return the same open file with another volume to reconstruct.

        Parameters
        ----------
        grid : voxels of the volume

        Returns
        -------
        the dataset
        """
        return self._with(grid=grid)

    def _with(self, **changed: Any) -> "Dataset":
        """Return the same open file with values in place of the stored ones."""
        other = replace(self)
        vars(other).update(vars(self) | changed)
        return other

    @property
    def name(self) -> str:
        """Title of the scan."""
        return str(self._value("/entry/title"))

    @property
    def counts(self) -> h5py.Dataset:
        """Measured counts, (view, channel, row, column), still in the file; `load` checks what it reads."""
        return array_at(self.file, f"{DETECTOR}/data")

    @cached_property
    def mask(self) -> Bool[np.ndarray, "channel row column"]:
        """Pixels that do not measure: where a low bit of ``pixel_mask`` is set, as NeXus defines it."""
        with damaged_file(self.path):
            mask = read_mask(self.file, self.spectra.channels, self.counts.shape[2:])
        return either_neighbour(mask) if self.subtracts else mask

    @property
    def signed(self) -> bool:
        """True when signals may be negative: those that are not counts, and differences of counters that fail."""
        return self.subtracts or self.spectra.units != "counts"

    @cached_property
    def subtracts(self) -> bool:
        """True when the file has counts above thresholds, and differences of these are returned."""
        return not self.as_stored and self._cumulative()

    def _cumulative(self) -> bool:
        """Whether the file has counts above thresholds."""
        stated = text_of(self._value(COUNTERS)) if has(self.file, COUNTERS) else DISJOINT
        if stated not in (CUMULATIVE, DISJOINT):
            raise DatasetError(f"{self.path}: {COUNTERS} must be {CUMULATIVE!r} or {DISJOINT!r}, found {stated!r}")
        return stated == CUMULATIVE

    def load(self, views: Iterable[SupportsInt] | None = None) -> Shaped[np.ndarray, "v c row column"]:
        """Read counts of some views into memory.

        Parameters
        ----------
        views : numbers of the views, in a list, an array or a tensor; all where left out

        Returns
        -------
        counts, (view, channel, row, column)

        Raises
        ------
        DatasetError
            When a count is negative or not a number, or the file is damaged.
        """
        chosen = range(self.counts.shape[0]) if views is None else [int(v) for v in views]
        loaded = np.empty((len(chosen), *self.counts.shape[1:]), self.counts.dtype)
        for i, view in enumerate(chosen):
            loaded[i] = self._image(self.counts, view)
            check_counts(loaded[i], f"view {view} of {self.path}", self.signed)
        return loaded

    def line_integrals(self, view: int) -> Float32[np.ndarray, "channel row column"]:
        """Compute log projections of one view, -log(counts / open beam), darks subtracted and dead time corrected.

        Counts below half a count are set to half a count.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        log projections without unit, (channel, row, column); NaN where a pixel or a channel of this view does not
        measure

        Raises
        ------
        InputError
            When there is no such view.
        """
        if not -len(self.exposure) <= view < len(self.exposure):
            raise InputError(f"{self.path} has views 0 to {len(self.exposure) - 1}, there is no view {view}")
        view = view % len(self.exposure)
        signal, air = (self.spectra.events(counts) for counts in (self.load([view])[0] - self.dark, self.flat))
        air = air * self.exposure[view][:, None, None]
        least = 0.5 * self.spectra.quantum[:, None, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(air / np.maximum(signal, least))
        return np.where(self.mask | (air <= 0), np.nan, logs).astype(np.float32)

    def to_xarray(self, views: Sequence[int] | None = None) -> "DataArray":
        """Read counts of some views as an `xarray.DataArray` with named axes and coordinates.

        Parameters
        ----------
        views : numbers of the views, in a list, an array or a tensor; all where left out

        Returns
        -------
        the counts
        """
        from phantomgen.dataset.adapters.to_xarray import to_xarray  # noqa: PLC0415 - an extra

        return to_xarray(self, views)

    def torch(self, split: str = "train") -> "ViewSet":
        """Return the views of a split as a `torch.utils.data.Dataset`.

        Parameters
        ----------
        split : ``train``, ``test``, ``val`` or ``all``

        Returns
        -------
        the view set
        """
        from phantomgen.dataset.adapters.to_torch import ViewSet  # noqa: PLC0415 - torch takes seconds

        return ViewSet.of(self, split)

    def _repr_html_(self) -> str:
        """Return the display of a notebook: a summary of the dataset, and its first view in every channel."""
        logs = self.line_integrals(0)
        return thumbnails(repr(self), list(zip(self.spectra.channels, logs, strict=True)))

    @cached_property
    def geometry(self) -> Geometry:
        """Poses of all views, as the scan was meant to have them."""
        panel = Panel(
            *self.counts.shape[2:],
            pitch=(float(self._value(f"{DETECTOR}/y_pixel_size")), float(self._value(f"{DETECTOR}/x_pixel_size"))),
        )
        angles = 0.0 - np.deg2rad(self._value("/entry/sample/rotation_angle"))
        with damaged_file(self.path):
            return read_geometry(group_at(self.file, "/entry/geometry"), panel, angles)

    @cached_property
    def spectra(self) -> Spectra:
        """Energy grid, source, response and basis."""
        table = {name: self._value(f"/entry/spectra/{name}") for name in _SPECTRA}
        if has(self.file, _COMPOSITION):
            table["basis_composition"] = self._value(_COMPOSITION)
        channels = tuple(text_of(name) for name in self._value("/entry/data/channel"))
        limits = [f"{DETECTOR}/{name}_channel" for name in channels]
        stored = Spectra(
            energy=table["energy"],
            edges=table["energy_edges"],
            source=table["source"],
            response=table["response"],
            basis=Basis.from_table(table),
            basis_values=table["basis"],
            channels=channels,
            lower=np.array([float(self._value(f"{group}/threshold_energy")) for group in limits]),
            upper=np.array([float(self._value(f"{group}/upper_energy")) for group in limits]),
            units=text_of(self.counts.attrs.get("units", "counts")),
            variance=self._value("/entry/spectra/variance") if has(self.file, "entry/spectra/variance") else None,
            profile=read_profile(self.file),
            dead_time=self._dead_time(),
            pulses=self._pulses(),
            cumulative=self._cumulative(),
        )
        try:
            stored.check()
        except InputError as error:
            raise DatasetError(f"{self.path}: {error}") from None
        return stored.between_thresholds() if self.subtracts else stored

    @property
    def tube(self) -> tuple[str | None, float | None]:
        """Material of the anode and voltage [kV] that the file states; None for what it does not."""
        fields = ("target_material", "voltage")
        there = [has(self.file, f"/entry/instrument/source/{name}") for name in fields]
        anode, voltage = (
            self._value(f"/entry/instrument/source/{n}") if t else None for n, t in zip(fields, there, strict=True)
        )
        return None if anode is None else text_of(anode), None if voltage is None else float(voltage)

    def _dead_time(self) -> DeadTime | None:
        """Dead time of the pixels, where the file has one."""
        if not has(self.file, f"{DETECTOR}/dead_time"):
            return None
        tau, exposure = (float(self._value(f"{DETECTOR}/{name}")) for name in ("dead_time", "count_time"))
        return DeadTime(tau, exposure, str(self._value(f"{DETECTOR}/dead_time_model")))  # type: ignore[arg-type]

    def _pulses(self) -> PulseResponse | None:
        """Heights of pulses, where they pile up."""
        paths = [f"{DETECTOR}/{name}" for name in ("pulse_edges", "pulse_response")]
        return PulseResponse(*map(self._value, paths)) if any(has(self.file, path) for path in paths) else None

    @cached_property
    def grid(self) -> Grid:
        """Voxels of the volume to reconstruct."""
        shape, spacing, origin = (
            self._value(f"/entry/reconstruction_grid/{n}") for n in ("shape", "spacing", "origin")
        )
        return Grid(tuple(map(int, shape)), tuple(map(float, spacing)), tuple(map(float, origin)))  # type: ignore[arg-type]

    @cached_property
    def splits(self) -> dict[str, Int[np.ndarray, " _view"]]:
        """Indices of the views in ``train``, ``test`` and ``val`` of the default scheme."""
        group = group_at(self.file, "/entry/splits")
        scheme = text_of(group.attrs.get("default", next(iter(group), "")))
        parts = {name: self._value(f"/entry/splits/{scheme}/{name}") for name in ("train", "test", "val")}
        for name, views in parts.items():
            if len(views) and not (views.min() >= 0 and views.max() < self.counts.shape[0]):
                raise DatasetError(
                    f"{self.path}: split {scheme}/{name} names a view outside 0..{self.counts.shape[0] - 1}"
                )
        return {name: views.astype(np.int64) for name, views in parts.items()}

    @cached_property
    def view_times(self) -> ViewTimes | None:
        """Times and phases of the views; None where the file has none."""
        return read_view_times(self.file)

    @cached_property
    def exposure(self) -> Float[np.ndarray, "view channel"]:
        """Tube output per view and channel, relative to the flats; 0 where a view was not taken in a channel."""
        scale = np.asarray(self._value("/entry/exposure/scale"), dtype=np.float64)
        views, channels = self.counts.shape[:2]
        return np.broadcast_to(scale.reshape(views, -1), (views, channels))

    @cached_property
    def dark(self) -> Float[np.ndarray, "channel row column"]:
        """Mean counts without beam."""
        frames = find_array(self.file, DARK)
        if frames is None or frames.shape[0] == 0:
            return np.zeros(self.counts.shape[1:])
        return self._mean(frames, "dark")

    @cached_property
    def dark_variance(self) -> Float[np.ndarray, " channel"]:
        """Variance of a pixel between dark frames, mean over the pixels that measure; 0 for less than two frames."""
        frames = find_array(self.file, DARK)
        if frames is None or frames.shape[0] < 2:
            return np.zeros(self.counts.shape[1])
        squares = sum(np.square(self._image(frames, frame) - self.dark) for frame in range(frames.shape[0]))
        return np.mean(squares / (frames.shape[0] - 1), axis=(1, 2), where=~self.mask)

    @cached_property
    def flat(self) -> Float[np.ndarray, "channel row column"]:
        """Mean open-beam counts at exposure 1, dark counts subtracted.

        Raises
        ------
        DatasetError
            When the file has no flats and no region of air was named.
        """
        if self.air is not None:
            return self._air_level(self.air)
        return self._mean(array_at(self.file, FLAT), "flat") - self.dark

    def _air_level(self, air: Region) -> Float[np.ndarray, "channel row column"]:
        """One open-beam level per channel from a region of air in all views."""
        if self.spectra.profile is not None:
            parts = ", ".join(self.spectra.profile.names)
            raise InputError(
                f"{self.path}: the open beam differs over the panel ({parts}), so that a region of air cannot stand in "
                "for flats: leave --air out"
            )
        total = np.zeros(self.counts.shape[1])
        measuring = np.zeros(self.mask.shape, bool)
        measuring[:, air[0], air[1]] = ~self.mask[:, air[0], air[1]]
        if not measuring.any(axis=(1, 2)).all():
            raise InputError(f"{self.path}: no pixel of the region of air measures: name another by --air")
        for view in range(len(self.exposure)):
            counts = self._image(self.counts, view)
            check_counts(counts, f"view {view} of {self.path}", self.signed)
            total += np.mean(counts - self.dark, axis=(1, 2), where=measuring)
        level = total / self.exposure.sum(axis=0)
        return np.broadcast_to(level[:, None, None], self.counts.shape[1:]).copy()

    def _mean(self, frames: h5py.Dataset, what: str) -> Float[np.ndarray, "channel row column"]:
        """Mean of all frames."""
        total = np.zeros(frames.shape[1:])
        for frame in range(frames.shape[0]):
            counts = self._image(frames, frame)
            check_counts(counts, f"{what} {frame} of {self.path}", self.signed)
            total += counts
        return total / frames.shape[0]

    def _image(self, frames: h5py.Dataset, frame: int) -> Shaped[np.ndarray, "channel row column"]:
        """All channels of one frame."""
        images = frame_at(frames, frame)
        return between_thresholds(images) if self.subtracts else images

    def _value(self, name: str) -> Any:
        """Content of a small dataset; text as ``str``."""
        return value_at(self.file, name)


_COMPOSITION = "/entry/spectra/basis_composition"  # of bases of materials only
_SPECTRA = (
    "energy",
    "energy_edges",
    "source",
    "response",
    "basis",
    "basis_name",
    "basis_kind",
    "edge_energy",
    "edge_width",
    "element",
    "reference_energy",
)


def open_dataset(path: Path | str, air: Region | str | None = None, *, as_stored: bool = False) -> Dataset:
    """Open a dataset for reading.

    Parameters
    ----------
    path : of the file
    air : ``"r0:r1,c0:c1"`` or two slices: a part of the panel that sees only air, in place of missing flats
    as_stored : return counts above thresholds as they are in the file, see `Dataset`

    Returns
    -------
    the dataset

    Raises
    ------
    DatasetError
        When the file is missing, damaged, of another kind or a newer schema, inconsistent, or without flats.
    """
    path = Path(path)
    file = open_file(path)
    try:
        dataset = Dataset(path, file, parse_region(air) if isinstance(air, str) else air, as_stored=as_stored)
        _check_consistent(dataset)
    except BaseException:
        file.close()
        raise
    return dataset


def parse_region(text: str) -> Region:
    """Parse ``"r0:r1,c0:c1"`` to two slices of rows and columns.

    Parameters
    ----------
    text : the region

    Returns
    -------
    slices of rows and columns

    Raises
    ------
    InputError
        When the text is not of this form.
    """
    try:
        (r0, r1), (c0, c1) = ((int(n) for n in part.split(":")) for part in text.split(","))
    except ValueError:
        raise InputError(f"a region of air is written r0:r1,c0:c1, such as 0:16,0:256, got {text!r}") from None
    if not (0 <= r0 < r1 and 0 <= c0 < c1):
        raise InputError(f"a region of air needs rows and columns that ascend from at least 0, got {text!r}")
    return slice(r0, r1), slice(c0, c1)


def _check_consistent(dataset: Dataset) -> None:
    """Refuse arrays that do not belong together, before any long work."""
    for problem in chain(form_problems(dataset.file, ENTRY), value_problems(dataset.file, ENTRY)):
        raise DatasetError(problem)
    shape = dataset.counts.shape
    if 0 in shape:
        raise DatasetError(f"{dataset.path}: counts have shape {shape}, which is empty")
    for name in (f"{DETECTOR}/data", FLAT):
        _check_whole(dataset, name)
    _, spectra = dataset.geometry, dataset.spectra
    if spectra.profile is not None:
        spectra.profile.check(dataset.path, shape[2:], len(spectra.energy))
    exposed = dataset.exposure > 0
    if not (dataset.exposure >= 0).all() or not exposed.any(axis=1).all() or not exposed.any(axis=0).all():
        raise DatasetError(f"{dataset.path}: the exposure scale of a view is not positive")
    if dataset.subtracts:
        _check_counters(dataset)
    _ = dataset.mask  # is checked as it is read
    _check_open_beam(dataset)


def _check_counters(dataset: Dataset) -> None:
    """Refuse counters that cannot be subtracted from each other."""
    if dataset.spectra.units != "counts" or not (np.diff(dataset.spectra.lower) > 0).all():
        raise DatasetError(f"{dataset.path}: {CUMULATIVE} counters need counts, and thresholds that ascend")
    if (dataset.exposure != dataset.exposure[:, :1]).any():
        raise DatasetError(f"{dataset.path}: {CUMULATIVE} counters need the same exposure scale in all channels")


def _check_whole(dataset: Dataset, name: str) -> None:
    """Refuse frames with parts that are not in the file, which HDF5 would read as zeros."""
    frames = find_array(dataset.file, name)
    missing = 0 if frames is None else missing_chunks(frames)
    if missing:
        raise DatasetError(
            f"{dataset.path} is damaged: {name} lacks {missing} of its chunks, which would read as zeros"
        )


def _check_open_beam(dataset: Dataset) -> None:
    """Refuse a file without flats, unless a region of air on the panel was named."""
    rows, columns = dataset.counts.shape[2:]
    if dataset.air is not None:
        if dataset.air[0].stop > rows or dataset.air[1].stop > columns:
            raise InputError(f"the region of air reaches beyond the panel of {rows} x {columns} pixels")
        return
    flats = find_array(dataset.file, FLAT)
    if flats is None or flats.shape[0] == 0:
        raise DatasetError(
            f"{dataset.path} has no flat field in {FLAT}: name a part of the panel that sees only air by "
            "--air rows,columns, such as --air 0:16,0:256"
        )
