"""Truth of a dataset in ``/truth``: basis volumes, material fractions and materials."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from jaxtyping import Float, Float32, Integer, UInt16

from phantomgen.dataset.checks.door import group_at, has, value_at
from phantomgen.dataset.checks.fields import TRUTH, form_problems, value_problems
from phantomgen.dataset.compression import Compression, filters
from phantomgen.dataset.file import damaged_file, open_file
from phantomgen.dataset.layout import (
    FRACTION_SCALE,
    new_frames,
    new_group,
    pack_image,
    put,
    put_note,
    text_of,
    write_image_at,
)
from phantomgen.exporters.volumes import Volumes, basis_volumes
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import DatasetError
from spectra.materials.material import Material
from spectra.threads import run_parallel

# Fractions that are in memory at once; more voxels are computed slab by slab.
_SLAB_VALUES = 1 << 25


@dataclass(frozen=True, eq=False)
class CoefficientFit:
    """Fit of the coefficients of compositions: non-negative, with the least relative error of mu(E).

    Parameters
    ----------
    window : energies that it covers [keV]
    weights : what each energy weighs, in words
    errors : weighted rms relative error of mu(E) per material; 0 for explicit coefficients
    """

    window: tuple[float, float]
    weights: str
    errors: Float[np.ndarray, " material"]


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth on a voxel grid.

    Parameters
    ----------
    grid : the voxels
    basis_names : names of the basis functions
    volumes : basis coefficients, averaged over each voxel [1/mm]
    material_names : names of the materials, background left out
    coefficients : of the materials in the basis [1/mm]
    fractions : part of each voxel that each material fills, 65535 = all
    scene : the scene as YAML
    fit : of the coefficients; None where a file does not say
    phases : truth of each phase of a scan that has some, when it is written; `read_phases` reads them
    """

    grid: Grid
    basis_names: tuple[str, ...]
    volumes: Float32[np.ndarray, "basis z y x"]
    material_names: tuple[str, ...]
    coefficients: Float[np.ndarray, "material basis"]
    fractions: UInt16[np.ndarray, "material z y x"]
    scene: str = ""
    fit: CoefficientFit | None = None
    phases: tuple["Truth", ...] = ()

    @classmethod
    def of(
        cls,
        grid: Grid,
        basis_names: tuple[str, ...],
        material_names: tuple[str, ...],
        coefficients: Float[np.ndarray, "material basis"],
        fractions: Float32[np.ndarray, "material z y x"],
        scene: str,
        fit: CoefficientFit | None = None,
    ) -> "Truth":
        """Create the truth from fractions between 0 and 1.

        Parameters
        ----------
        grid : the voxels
        basis_names : names of the basis functions
        material_names : names of the materials, background left out
        coefficients : of the materials in the basis [1/mm]
        fractions : part of each voxel that each material fills, 0 to 1
        scene : the scene as YAML
        fit : of the coefficients

        Returns
        -------
        the truth
        """
        volumes = np.zeros((len(basis_names), *grid.shape), np.float32)
        for row, fraction in zip(coefficients, fractions, strict=True):
            for basis in np.flatnonzero(row):
                volumes[basis] += np.float32(row[basis]) * fraction
        scaled = np.empty(fractions.shape, np.uint16)
        for part, fraction in zip(scaled, fractions, strict=True):
            part[...] = np.rint(np.clip(fraction, 0.0, 1.0) * FRACTION_SCALE)
        return cls(grid, basis_names, volumes, material_names, coefficients, scaled, scene, fit)

    def __repr__(self) -> str:
        return f"Truth({', '.join(self.basis_names)}: {' x '.join(map(str, self.grid.shape))} voxels)"

    @property
    def label_type(self) -> type:
        """Numbers that labels are stored as."""
        return _label_type(self.material_names)

    def slabs(self) -> Iterator[tuple[int, "Truth"]]:
        """Yield parts of the truth with their first slice: here, all at once.

        Yields
        ------
        index of the first slice, and the truth of the slab
        """
        yield 0, self

    @property
    def labels(self) -> Integer[np.ndarray, "z y x"]:
        """Label of the material that fills most of each voxel: 0 the background, i + 1 material i."""
        total = self.fractions.sum(axis=0, dtype=np.int32)
        largest = np.maximum(FRACTION_SCALE - total, 0)
        labels = np.zeros(self.grid.shape, self.label_type)
        for i, fraction in enumerate(self.fractions):
            more = fraction > largest
            labels[more] = i + 1
            largest[more] = fraction[more]
        return labels


class PhaseFractions(NamedTuple):
    """Truth of a phase.

    Parameters
    ----------
    weight : part of the training views that belong to the phase
    fractions_on : function that returns the part of each voxel of a grid that each material fills, as a mean over time
    """

    weight: float
    fractions_on: Callable[[Grid], Float32[np.ndarray, "material z y x"]]


@dataclass(frozen=True, eq=False)
class StreamedTruth:
    """Truth that is computed slab by slab, so that volumes of any size require the same memory.

    Parameters
    ----------
    grid, basis_names, material_names, coefficients : see `Truth`
    fractions_on : function that returns the part of each voxel of a grid that each material fills
    scene, fit : see `Truth`
    phases : of a scan that has some; `fractions_on` is their mean, and not called then
    """

    grid: Grid
    basis_names: tuple[str, ...]
    material_names: tuple[str, ...]
    coefficients: Float[np.ndarray, "material basis"]
    fractions_on: Callable[[Grid], Float32[np.ndarray, "material z y x"]]
    scene: str = ""
    fit: CoefficientFit | None = None
    phases: tuple[PhaseFractions, ...] = ()

    def part(self, grid: Grid) -> Truth:
        """Compute the truth of a part of the grid.

        Parameters
        ----------
        grid : voxels of the part

        Returns
        -------
        the truth
        """
        if not self.phases:
            return self._of(grid, self.fractions_on(grid))
        total = np.zeros((len(self.material_names), *grid.shape), np.float32)
        found = []
        for phase in self.phases:
            filled = phase.fractions_on(grid)
            total += np.float32(phase.weight) * filled
            found.append(self._of(grid, filled))
        return replace(self._of(grid, total), phases=tuple(found))

    def _of(self, grid: Grid, filled: Float32[np.ndarray, "material z y x"]) -> Truth:
        """The truth of fractions."""
        return Truth.of(grid, self.basis_names, self.material_names, self.coefficients, filled, self.scene, self.fit)

    def slabs(self) -> Iterator[tuple[int, Truth]]:
        """Yield slabs with their first slice; their number depends on the grid only, not on the machine.

        Yields
        ------
        index of the first slice, and the truth of the slab
        """
        depth = self.grid.shape[0]
        for first in range(0, depth, self.slab):
            yield first, self.part(self.grid.slices(first, min(self.slab, depth - first)))

    @property
    def slab(self) -> int:
        """Slices of a slab."""
        _, rows, columns = self.grid.shape
        return max(1, _SLAB_VALUES // (rows * columns * max(1, len(self.material_names)) * (1 + len(self.phases))))

    @property
    def label_type(self) -> type:
        """Numbers that labels are stored as."""
        return _label_type(self.material_names)


def write_truth(
    file: h5py.File,
    truth: Truth | StreamedTruth,
    materials: tuple[Material, ...],
    compression: Compression = "gzip",
) -> None:
    """Write ``/truth``.

    Parameters
    ----------
    file : open dataset
    truth : the truth, whole or in slabs
    materials : the materials
    compression : of the volumes
    """
    group = truth_group(file)
    volumes = _new_volumes(group, truth, compression)
    phases = _new_phases(group, truth, compression)
    for first, slab in truth.slabs():
        _write_slab(volumes, first, slab, compression)
        _write_phases(phases, first, slab, compression)
        del slab  # before the next one is made
    table = new_group(group, "materials", "NXcollection")
    put(table, "name", np.array([m.name for m in materials], dtype=object))
    put(table, "density", np.array([m.density if m.density else np.nan for m in materials]), "g/cm^3")
    put(table, "composition", np.array([_composition(m) for m in materials], dtype=object))
    put(table, "coefficients", truth.coefficients, "1/mm")
    put(table, "kind", np.array(["explicit" if m.composition is None else "fitted" for m in materials], dtype=object))
    if truth.fit is not None:
        put(table, "fit_error", truth.fit.errors, "1")
        put(table, "fit_window", np.array(truth.fit.window), "keV")
        put(table, "fit_weights", truth.fit.weights)
    grid = new_group(group, "grid", "NXcollection")
    write_grid(grid, truth.grid)
    put(grid, "affine", truth.grid.affine, "mm")
    put_note(group, "scene", truth.scene, "application/yaml")


def write_grid(group: h5py.Group, grid: Grid) -> None:
    """Write a grid, triples in array order (z, y, x).

    Parameters
    ----------
    group : group that gets it
    grid : the voxels
    """
    put(group, "shape", np.array(grid.shape, dtype=np.int32))
    put(group, "spacing", np.array(grid.spacing), "mm")
    put(group, "origin", np.array(grid.origin), "mm")


def truth_group(file: h5py.File) -> h5py.Group:
    """Return ``/truth`` of a file that is being written; create it where it is missing.

    Parameters
    ----------
    file : open dataset

    Returns
    -------
    the group
    """
    return group_at(file, "truth") if has(file, "truth") else new_group(file, "truth", "NXentry", default="basis")


def read_truth(path: Path | str) -> Truth | None:
    """Read the truth of a dataset.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    the truth; None where the file has none
    """
    path = Path(path)
    with open_file(path, "truth") as file, damaged_file(path):
        if not has(file, "truth"):
            return None
        for problem in chain(form_problems(file, TRUTH), value_problems(file, TRUTH)):
            raise DatasetError(problem)
        group = group_at(file, "truth")
        shape, spacing, origin = (value_at(group, f"grid/{name}") for name in ("shape", "spacing", "origin"))
        return Truth(
            grid=Grid(tuple(map(int, shape)), tuple(map(float, spacing)), tuple(map(float, origin))),  # type: ignore[arg-type]
            basis_names=tuple(value_at(group, "basis/basis")),
            volumes=value_at(group, "basis/data"),
            material_names=tuple(value_at(group, "materials/name")),
            coefficients=value_at(group, "materials/coefficients"),
            fractions=value_at(group, "fractions"),
            scene=text_of(value_at(group, "scene/data")) if has(group, "scene") else "",
            fit=read_fit(group_at(group, "materials")),
        )


def read_fit(materials: h5py.Group) -> CoefficientFit | None:
    """Read how coefficients were fitted.

    Parameters
    ----------
    materials : group of the materials

    Returns
    -------
    the fit; None where the file does not say
    """
    if not has(materials, "fit_error"):
        return None
    low, high = value_at(materials, "fit_window")
    weights = text_of(value_at(materials, "fit_weights"))
    return CoefficientFit((float(low), float(high)), weights, value_at(materials, "fit_error"))


def _new_volumes(
    group: h5py.Group, truth: Truth | StreamedTruth, compression: Compression
) -> tuple[h5py.Dataset, h5py.Dataset, h5py.Dataset]:
    """Create empty basis volumes, which are the default plot, fractions and labels."""
    data = new_group(group, "basis", "NXdata", signal="data", axes=("basis", "z", "y", "x"))
    data.attrs["default_slice"] = [truth.basis_names[0], str(truth.grid.shape[0] // 2), ".", "."]
    shape = truth.grid.shape
    basis = new_frames(data, "data", (len(truth.basis_names), *shape), np.float32, "1/mm", compression)
    put(data, "basis", np.array(truth.basis_names, dtype=object))
    for axis in "zyx":
        put(data, axis, truth.grid.axis(axis), "mm")
    fractions = new_frames(group, "fractions", (len(truth.material_names), *shape), np.uint16, None, compression)
    fractions.attrs["scale"] = 1 / FRACTION_SCALE
    chunks = (1, *shape[1:])
    labels = group.create_dataset("labels", shape, truth.label_type, chunks=chunks, **filters(compression))
    return basis, fractions, labels


def _write_slab(
    volumes: tuple[h5py.Dataset, h5py.Dataset, h5py.Dataset], first: int, slab: Truth, compression: Compression
) -> None:
    """Write some slices of all volumes, packed in parallel."""
    *parts, labels = volumes
    for dataset, values in zip(parts, (slab.volumes, slab.fractions), strict=True):
        _write_slices(dataset, (), first, values, compression)
    numbers = slab.labels
    labels[first : first + len(numbers)] = numbers


def _new_phases(
    group: h5py.Group, truth: Truth | StreamedTruth, compression: Compression
) -> tuple[h5py.Dataset, h5py.Dataset] | None:
    """Create empty basis volumes and fractions of all phases; None where there are none."""
    if not truth.phases:
        return None
    count, shape = len(truth.phases), truth.grid.shape
    data = new_group(group, "phases", "NXdata", signal="data", axes=("phase", "basis", "z", "y", "x"))
    basis = new_frames(data, "data", (count, len(truth.basis_names), *shape), np.float32, "1/mm", compression)
    fractions = new_frames(data, "fractions", (count, len(truth.material_names), *shape), np.uint16, None, compression)
    fractions.attrs["scale"] = 1 / FRACTION_SCALE
    put(data, "phase", np.arange(count, dtype=np.int32))
    put(data, "basis", np.array(truth.basis_names, dtype=object))
    for axis in "zyx":
        put(data, axis, truth.grid.axis(axis), "mm")
    return basis, fractions


def _write_phases(
    arrays: tuple[h5py.Dataset, h5py.Dataset] | None, first: int, slab: Truth, compression: Compression
) -> None:
    """Write some slices of the volumes of all phases."""
    for phase, truth in enumerate(slab.phases):
        assert arrays is not None
        for dataset, values in zip(arrays, (truth.volumes, truth.fractions), strict=True):
            _write_slices(dataset, (phase,), first, values, compression)


def _write_slices(
    dataset: h5py.Dataset, outer: tuple[int, ...], first: int, values: np.ndarray, compression: Compression
) -> None:
    """Write slices (part, z, row, column) behind outer indices, packed in parallel."""
    places = list(np.ndindex(values.shape[:2]))
    packed = run_parallel(lambda place: pack_image(values[place], compression), places)
    for (part, z), image in zip(places, packed, strict=True):
        write_image_at(dataset, (*outer, part, first + z), image)


def _label_type(materials: tuple[str, ...]) -> type:
    """The smallest numbers that name all materials and the background."""
    return np.uint8 if len(materials) < 255 else np.uint16


def _composition(material: Material) -> str:
    """Composition as text, empty for explicit coefficients."""
    if isinstance(material.composition, str) or material.composition is None:
        return material.composition or ""
    return json.dumps(dict(material.composition))


def true_volumes(path: Path, labels: bool = False) -> Volumes:
    """Read the basis volumes of a dataset's truth, or the label of the material that fills most of each voxel.

    Parameters
    ----------
    path : of the dataset
    labels : 0 for the background, i + 1 for material i, in place of the bases

    Returns
    -------
    the volumes

    Raises
    ------
    DatasetError
        When the dataset holds no truth, or is damaged.
    """
    truth = read_truth(path)
    if truth is None:
        raise DatasetError(f"{path} holds no truth to export")
    if labels:
        names = ", ".join(f"{i} {name}" for i, name in enumerate(truth.material_names, 1))
        return Volumes(truth.grid, {"labels": truth.labels}, f"materials: 0 background, {names}")
    return basis_volumes(truth.grid, truth.basis_names, truth.volumes)
