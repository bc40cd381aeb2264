"""Files of a segmentation: volumes in HDF5, coloured Gaussians, and the table as JSON."""

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.truth import write_grid
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.hdf5_output import hdf5_output
from phantomgen.runtime.output_lock import acquire
from phantomgen.runtime.outputs import check_name, check_output_folder
from phantomgen.runtime.plain_json import write_json
from recon.gaussians.model import Gaussians
from recon.segmentation.result import Segmentation
from spectra.errors import InputError

VOLUMES, TABLE, POINTS = "segment.h5", "materials.json", "gaussians.ply"
_DC = 0.28209479177387814  # 1 / sqrt(4 pi), the spherical harmonic of degree 0, by which viewers multiply colours
_PACKING: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


class SegmentFolder:
    """A folder that gets its name when it is complete; use it in a ``with`` statement.

    Parameters
    ----------
    path : name of the folder
    overwrite : replace one that exists

    Raises
    ------
    InputError
        When the folder exists and `overwrite` is not given, was not written by a segmentation, or cannot be made.
    """

    def __init__(self, path: Path, overwrite: bool) -> None:
        check_name(path)
        self.path = path
        self.part = path.absolute().with_name(path.absolute().name + ".part")
        check_output_folder(path, overwrite, "recon segment", lambda folder: (folder / VOLUMES).is_file())

    def __enter__(self) -> Path:
        with one_sentence(self.part):
            self._lock = acquire(self.path)
            shutil.rmtree(self.part, ignore_errors=True)
            self.part.mkdir()
        return self.part

    def __exit__(self, kind: type | None, *exception: object) -> None:
        self._lock.unlink(missing_ok=True)
        if kind is None:
            shutil.rmtree(self.path, ignore_errors=True)
            self.part.replace(self.path)
        else:
            shutil.rmtree(self.part, ignore_errors=True)


def write_segmentation(path: Path, segmentation: Segmentation) -> None:
    """Write ``/labels``, ``/materials`` [1/mm], ``/rgb`` and ``/readouts`` as NeXus plots with axes in mm.

    Parameters
    ----------
    path : file to write
    segmentation : material maps
    """
    s, grid = segmentation, segmentation.subject.grid
    names = np.array([c.name for c in s.clusters], dtype=object)
    with hdf5_output(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "labels", "creator": "recon"})
        labels = _volume(file, "labels", s.labels.astype(np.uint16), grid, ())
        labels.attrs["meaning"] = "0 air, then the materials in order"
        _volume(file, "materials", s.materials, grid, ("material",), "1/mm")
        put(file["materials"], "material", names)  # type: ignore[arg-type]
        rgb = np.rint(255 * s.rgb()).astype(np.uint8)
        data = _volume(file, "rgb", rgb, grid, (), after=(".",))
        data.attrs["interpretation"] = "rgba-image"
        group = new_group(file, "colours", "NXcollection")
        put(group, "material", names)
        put(group, "rgb", s.colours)
        _write_readouts(new_group(file, "readouts", "NXcollection"), segmentation)
        write_grid(new_group(file, "grid", "NXcollection"), grid)


def _write_readouts(group: h5py.Group, segmentation: Segmentation) -> None:
    """Write volumes of physical numbers; atomic numbers are NaN in air."""
    s, values, grid = segmentation.readouts, segmentation.subject.volumes, segmentation.subject.grid
    plain = s.without_contrast(values)
    for energy in segmentation.options.energies:
        _volume(group, f"monoenergetic_{energy:g}_keV", s.hounsfield(values, energy), grid, (), "HU")
        _volume(group, f"without_contrast_{energy:g}_keV", s.hounsfield(plain, energy), grid, (), "HU")
    number, density = s.electrons(values)
    _volume(group, "atomic_number", number, grid, ())
    _volume(group, "electron_density", density, grid, (), "of water")
    for element in s.agents:
        _volume(group, f"concentration_{element}", s.concentration(values, element), grid, (), "mg/ml")


def _volume(
    parent: h5py.Group, name: str, values: np.ndarray, grid: Grid, first: tuple[str, ...], units: str = "",
    after: tuple[str, ...] = (),
) -> h5py.Dataset:  # fmt: skip
    """Write a plot with axes (..., z, y, x, ...)."""
    group = new_group(parent, name, "NXdata", signal="data", axes=(*first, "z", "y", "x", *after))
    kept = values.astype(np.float32) if values.dtype.kind == "f" else values
    chunks = (*(1 for _ in first), 1, *kept.shape[len(first) + 1 :])
    data = group.create_dataset("data", data=kept, chunks=chunks, **_PACKING)
    if units:
        data.attrs["units"] = units
    for axis in "zyx":
        put(group, axis, grid.axis(axis), "mm")
    return data


def write_points(path: Path, segmentation: Segmentation) -> None:
    """Write Gaussians as ``.ply`` in the layout of 3D Gaussian splatting, in the colours of their materials.

    Parameters
    ----------
    path : file to write
    segmentation : material maps

    Raises
    ------
    InputError
        When the run was segmented in voxels.

    Notes
    -----
    Positions are in mm, scales in logarithms of mm, rotations w, x, y, z; opacity is the logit of the density over its
    99 % quantile. Besides, there are red, green and blue for viewers of point clouds, ``material`` (the number of the
    label), and ``basis_<i>`` [1/mm].
    """
    model, own = segmentation.subject.gaussians, segmentation.gaussian_labels
    if model is None or own is None:
        raise InputError("only Gaussians can be written as points, and this run was segmented in voxels")
    columns = _point_columns(model, segmentation.colours[own], own)
    table = np.zeros(len(own), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    types = {"f": "float", "B": "uchar", "H": "ushort"}
    lines = [f"property {types[values.dtype.char]} {name}" for name, values in columns.items()]
    comments = [f"comment basis_{i} is {name}, in 1/mm" for i, name in enumerate(model.basis_names)]
    comments += [f"comment material {i + 1} is {c.name}" for i, c in enumerate(segmentation.clusters)]
    head = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {len(own)}", *lines, "end_header"]
    with one_sentence(path):
        path.write_bytes(("\n".join(head) + "\n").encode() + table.tobytes())


def _point_columns(model: Gaussians, colours: np.ndarray, own: np.ndarray) -> dict[str, np.ndarray]:
    """Properties of the Gaussians by name, in the order of the file."""
    density = model.coefficients.numpy().sum(axis=1)
    share = np.clip(density / max(float(np.quantile(density, 0.99)), 1e-12), 1e-3, 0.99)
    floats: dict[str, np.ndarray] = dict(zip("xyz", model.centres.numpy().T, strict=True))
    floats |= {name: np.zeros(len(own)) for name in ("nx", "ny", "nz")}
    floats |= {f"f_dc_{i}": (colours[:, i] - 0.5) / _DC for i in range(3)}
    floats["opacity"] = np.log(share / (1 - share))
    floats |= {f"scale_{i}": model.log_scales.numpy()[:, i] for i in range(3)}
    floats |= {f"rot_{i}": model.quaternions.numpy()[:, i] for i in range(4)}
    floats |= {f"basis_{i}": model.coefficients.numpy()[:, i] for i in range(len(model.basis_names))}
    columns = {name: values.astype("<f4") for name, values in floats.items()}
    for i, name in enumerate(("red", "green", "blue")):
        columns[name] = np.rint(255 * colours[:, i]).astype(np.uint8)
    return columns | {"material": (own + 1).astype("<u2")}


def write_table(path: Path, content: dict[str, Any]) -> None:
    """Write the table as indented JSON.

    Parameters
    ----------
    path : file to write
    content : the table, see `recon.segmentation.output.table.record`; NaN is refused
    """
    write_json(path, content)
