"""Volumes of a run on any grid: basis volumes or quantities, in HDF5 slab by slab, or in formats of other programs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from phantomgen.dataset.checks.door import DAMAGE
from phantomgen.dataset.layout import new_group, put, text_of
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import write_grid
from phantomgen.exporters import dicom
from phantomgen.exporters.volumes import FORMATS, Volumes, basis_volumes, suffix_of, write_volumes, writer_of
from phantomgen.geometry.voxel_grid import Grid, parse_triple
from phantomgen.runtime.disk import complete_file
from phantomgen.runtime.hdf5_output import hdf5_output
from phantomgen.runtime.outputs import check_name, check_output
from recon.readouts.quantity import Quantity, in_pieces
from recon.runs.read_run import StoredModel
from recon.uncertainty.estimate import stored_replicates
from recon.voxel.model import Voxels
from spectra.errors import InputError

HDF5 = (".h5", ".hdf5")
SUFFIXES = (*HDF5, *FORMATS)
MOST_VOXELS = 1e11  # of a volume: 400 GB for each basis
SLAB_VALUES = 1 << 24  # values; voxels times bases that are in memory at once, 64 MiB in float32


def chosen_grid(
    scan: Grid, counts: str | None, voxel: float | None, size: str | None, center: str | None, like: Path | None
) -> Grid:
    """Create the grid that options ask for.

    Parameters
    ----------
    scan : grid of the scan, which is used where no option is given
    counts : ``"128"`` or ``"64,128,128"``: voxels along (z, y, x)
    voxel : edge of a voxel [mm]; that of the scan where it is None
    size : ``"160"`` or ``"80,160,160"``: size along (z, y, x) [mm], in place of `counts`
    center : ``"0,0,10"``: centre (z, y, x) [mm]
    like : a dataset whose grid is used

    Returns
    -------
    grid

    Raises
    ------
    InputError
        When options contradict each other, or are no numbers.
    """
    own = (counts, voxel, size, center)
    if like is not None:
        if any(value is not None for value in own):
            raise InputError("--like takes the grid of a dataset: leave --grid, --voxel, --size and --center out")
        with open_dataset(like, air=(slice(0, 1), slice(0, 1))) as dataset:
            return dataset.grid
    if all(value is None for value in own):
        return scan
    if counts is not None and size is not None:
        raise InputError("--grid counts voxels and --size measures them in mm: leave one of them out")
    if voxel is not None and not np.isfinite(voxel):
        raise InputError(f"--voxel must be a finite size in mm, got {voxel:g}")
    spacing = np.full(3, voxel) if voxel is not None else np.array(scan.spacing)
    if counts is not None:
        shape = np.array(parse_triple("--grid", counts))
        if (shape % 1 != 0).any():
            raise InputError(f"--grid needs whole numbers of voxels, got {counts!r}")
    else:
        extent = np.array(scan.shape) * scan.spacing if size is None else np.array(parse_triple("--size", size))
        if (np.array(extent) <= 0).any():
            raise InputError(f"--size needs positive sizes in mm, got {size!r}")
        shape = np.maximum(np.ceil(extent / spacing - 1e-6), 1)
    middle = np.zeros(3) if center is None else np.array(parse_triple("--center", center, several=True))
    if (shape < 1).any():
        raise InputError(f"a volume needs positive sizes, got {counts or size!r}")
    if np.prod(shape) > MOST_VOXELS:
        raise InputError(
            f"a volume of {' x '.join(f'{n:g}' for n in shape)} voxels is more than the {MOST_VOXELS:g} that are "
            "written: choose larger voxels by --voxel, or a smaller part by --size"
        )
    first = middle - (shape - 1) / 2 * spacing
    whole = tuple(int(n) for n in shape)
    return Grid(whole, tuple(spacing.tolist()), tuple(first.tolist()))  # type: ignore[arg-type]


def is_result(path: Path) -> bool:
    """Return whether a file was written by `recon`, or is a damaged HDF5 file, which may have been.

    Parameters
    ----------
    path : an HDF5 file by its first bytes

    Returns
    -------
    False for HDF5 files of other programs, and for datasets
    """
    try:
        with h5py.File(path, "r") as file:
            return text_of(file.attrs.get("creator", "")) == "recon"
    except DAMAGE:
        return True


RESULT = ("an HDF5 file that recon wrote", is_result)  # what may be replaced by one


class Target(NamedTuple):
    """Output of a volume.

    Parameters
    ----------
    path : file, or folder of a DICOM series where the name has no suffix
    writer : ``hdf5``, ``dicom``, or ``other`` for the formats of `phantomgen.exporters.volumes`
    """

    path: Path
    writer: str


def checked_target(path: Path, overwrite: bool, ct_numbers: bool) -> Target:
    """Check an output before anything is computed.

    Parameters
    ----------
    path : file, or folder of a DICOM series where the name has no suffix
    overwrite : whether it may be replaced
    ct_numbers : whether CT numbers are to be written

    Returns
    -------
    the output

    Raises
    ------
    InputError
        When it exists, or its format is unknown or cannot hold the quantity.
    NotInstalledError
        When the format needs a package that is not there.
    """
    check_name(path)
    if not path.suffix:
        if not ct_numbers:
            raise InputError(
                f"the output {path} has no suffix, which means a DICOM CT series, and that holds CT numbers: add --as "
                f"hu or --as vnc, or end the name in one of {', '.join(SUFFIXES)}"
            )
        dicom.check_series(path, overwrite)
        return Target(path, "dicom")
    suffix = suffix_of(path, dict.fromkeys(SUFFIXES, ""))
    if suffix not in HDF5:
        writer_of(path)
    check_output(path, overwrite, kind=RESULT if suffix in HDF5 else None)
    return Target(path, "hdf5" if suffix in HDF5 else "other")


def write_volume(
    target: Target, stored: StoredModel, grid: Grid, chosen: Quantity | None, on_slice: Callable[[int, int], None]
) -> None:
    """Write basis volumes, or a quantity, on any grid.

    HDF5 files have ``/basis/data`` (basis, z, y, x), laid out as in ``volumes.h5``, and are written slab by slab.

    Parameters
    ----------
    target : output, as `checked_target` gives it
    stored : result of a run
    grid : grid of the volumes
    chosen : quantity that is written in place of the bases; None for the bases
    on_slice : called with the number of slices that are done, and of all slices

    Raises
    ------
    StorageError
        When the disk is full; then no file is left.
    """
    if target.writer == "hdf5":
        _write_hdf5(target.path, stored, grid, chosen, on_slice)
        return
    names = stored.basis.names if chosen is None else chosen.maps
    whole = np.empty((len(names), *grid.shape), np.float32)
    for first, values in _slabs(stored, grid, chosen, on_slice):
        whole[:, first : first + values.shape[1]] = values
    if target.writer == "dicom":
        dicom.write_series(target.path, grid, whole[0], str(chosen and chosen.about))
    elif chosen is None:
        write_volumes(target.path, basis_volumes(grid, names, whole))
    else:
        maps = dict(zip(chosen.maps, whole, strict=True))
        write_volumes(target.path, Volumes(grid, maps, f"{chosen.about} [{chosen.unit}]"))


def deviation_of(run: Path, stored: StoredModel, chosen: Quantity) -> tuple[StoredModel, Quantity]:
    """Compute the standard deviation of a quantity from the replicates of a run.

    Parameters
    ----------
    run : run folder
    stored : its result
    chosen : quantity

    Returns
    -------
    the standard deviation as a volume and a quantity that `write_volume` takes

    Raises
    ------
    DatasetError
        When the run has no replicates.
    """
    found = stored_replicates(run).quantity(chosen).deviation.astype(np.float32).reshape(-1, *stored.grid.shape)
    names, about = tuple(f"{name}_deviation" for name in chosen.maps), f"standard deviation of {chosen.about}"
    parts = names if chosen.parts else ()
    values = (lambda values: values) if chosen.parts else (lambda values: values[0])
    quantity = Quantity(names[0], chosen.unit, about, values, chosen.caution, parts)
    return replace(stored, model=Voxels(found, stored.grid, names)), quantity


def _write_hdf5(
    path: Path, stored: StoredModel, grid: Grid, chosen: Quantity | None, on_slice: Callable[[int, int], None]
) -> None:
    """Write an HDF5 file slab by slab."""
    names, unit = (stored.basis.names, "1/mm") if chosen is None else (chosen.maps, chosen.unit)
    _, rows, columns = grid.shape
    with whole_file(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "basis", "creator": "recon"})
        group = new_group(file, "basis", "NXdata", signal="data", axes=("basis_name", "z", "y", "x"))
        shape, chunks = (len(names), *grid.shape), (1, 1, rows, columns)
        packing = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
        data = group.create_dataset("data", shape, np.float32, chunks=chunks, **packing)
        data.attrs["units"] = unit
        if chosen is not None:
            data.attrs["long_name"] = chosen.about
            if chosen.caution:
                data.attrs["caution"] = chosen.caution
        put(group, "basis_name", np.array(names, dtype=object))
        for axis in "zyx":
            put(group, axis, grid.axis(axis), "mm")
        write_grid(new_group(file, "grid", "NXcollection"), grid)
        for first, values in _slabs(stored, grid, chosen, on_slice):
            data[:, first : first + values.shape[1]] = values


def _slabs(
    stored: StoredModel, grid: Grid, chosen: Quantity | None, on_slice: Callable[[int, int], None]
) -> Iterator[tuple[int, np.ndarray]]:
    """First slice and values (volume, z, y, x) of some slices after others."""
    depth, rows, columns = grid.shape
    slab = max(1, SLAB_VALUES // (rows * columns * len(stored.basis)))
    for first in range(0, depth, slab):
        count = min(slab, depth - first)
        values = stored.model.volume(grid.slices(first, count))
        yield first, values if chosen is None else in_pieces(chosen, values).reshape(-1, *values.shape[1:])
        on_slice(first + count, depth)


@contextmanager
def whole_file(path: Path) -> Iterator[h5py.File]:
    """Create an HDF5 file that gets its name when it is complete; a context manager.

    Parameters
    ----------
    path : name of the file

    Yields
    ------
    the open file

    Raises
    ------
    StorageError
        When the file cannot be written; then no file is left.
    """
    with complete_file(path, ".h5") as beside, hdf5_output(beside) as file:
        yield file
