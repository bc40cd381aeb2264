"""Volumes of a fitted model in HDF5, slab by slab: neither memory nor values depend on the size of the grid."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import write_grid
from phantomgen.geometry.voxel_grid import Grid, parse_triple
from phantomgen.runtime.disk import complete_file
from recon.runs.run_folder import Run
from spectra.errors import InputError

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
    spacing = np.full(3, voxel) if voxel is not None else np.array(scan.spacing)
    if counts is not None:
        shape = np.array(parse_triple("--grid", counts))
        if (shape % 1 != 0).any():
            raise InputError(f"--grid needs whole numbers of voxels, got {counts!r}")
    else:
        extent = np.array(scan.shape) * scan.spacing if size is None else np.array(parse_triple("--size", size))
        shape = np.maximum(np.ceil(extent / spacing - 1e-6), 1)
    middle = np.zeros(3) if center is None else np.array(parse_triple("--center", center, several=True))
    if (shape < 1).any():
        raise InputError(f"a volume needs positive sizes, got {counts or size!r}")
    first = middle - (shape - 1) / 2 * spacing
    whole = tuple(int(n) for n in shape)
    return Grid(whole, tuple(spacing.tolist()), tuple(first.tolist()))  # type: ignore[arg-type]


def write_volume(path: Path, run: Run, grid: Grid, energy: float | None, on_slice: Callable[[int, int], None]) -> None:
    """Write ``/basis/data`` (basis, z, y, x) [1/mm], laid out as in ``volumes.h5``.

    Parameters
    ----------
    path : file to write
    run : a finished fit
    grid : grid of the volumes
    energy : energy [keV] of the attenuation that is written in place of the bases; None for the bases
    on_slice : called with the number of slices that are done, and of all slices

    Raises
    ------
    StorageError
        When the disk is full; then no file is left.
    """
    model = run.gaussians
    names, mix = model.basis_names, np.eye(len(model.basis_names), dtype=np.float32)
    if energy is not None:
        names = (f"attenuation_{energy:g}_keV",)
        mix = run.basis.evaluate(np.array([energy]))[: len(mix)].T.astype(np.float32)
    depth, rows, columns = grid.shape
    slab = max(1, SLAB_VALUES // (rows * columns * len(model.basis_names)))
    with whole_file(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "basis", "creator": "recon"})
        group = new_group(file, "basis", "NXdata", signal="data", axes=("basis_name", "z", "y", "x"))
        shape, chunks = (len(names), *grid.shape), (1, 1, rows, columns)
        packing = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
        data = group.create_dataset("data", shape, np.float32, chunks=chunks, **packing)
        data.attrs["units"] = "1/mm"
        put(group, "basis_name", np.array(names, dtype=object))
        for axis in "zyx":
            put(group, axis, grid.axis(axis), "mm")
        write_grid(new_group(file, "grid", "NXcollection"), grid)
        for first in range(0, depth, slab):
            count = min(slab, depth - first)
            values = model.volume(grid.slices(first, count))
            data[:, first : first + count] = values if energy is None else np.tensordot(mix, values, axes=1)
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
    with complete_file(path, ".h5") as beside, h5py.File(beside, "w") as file:
        yield file
