"""Voxel maps of scene files: labels, volume fractions or Hounsfield units, and the materials that they stand for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np

from phantomgen.ops.voxel_maps import VoxelMap
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import Location, SceneFile
from phantomgen.scene.materials import check_material
from phantomgen.scene.objects.label_tables import TISSUES
from phantomgen.shapes import Voxels, rotation_matrix
from phantomgen.volume_files.read import read_volume
from phantomgen.volume_files.volume import Volume
from spectra.errors import InputError

# Hounsfield units of tissues, the bins of Schneider, Bortfeld & Schlegel 2000 (doi:10.1088/0031-9155/45/2/314, Table 6)
# put together: air is nothing, everything from 120 on is bone.
HOUNSFIELD = {
    "lung": (-950.0, -120.0),
    "adipose": (-120.0, -20.0),
    "soft_tissue": (-20.0, 120.0),
    "bone": (120.0, np.inf),
}
# Fractions may sum to this much more than 1, and be this much below 0, as rounded ones do.
_EXCESS = 1e-3


def voxels_of(file: SceneFile, model: schema.VoxelsModel, where: Location) -> tuple[Voxels, tuple[str, ...]]:
    """Read a voxel map, put it in its place, and return the material name of each of its parts.

    Parameters
    ----------
    file : the scene file
    model : model of the voxel map
    where : its place in the file

    Returns
    -------
    the shape, and names of materials

    Raises
    ------
    SceneError
        Where a file is missing or has the wrong shape, a label or a value has no material, or fractions are impossible.
    """
    ways = [way for way in ("labels", "fractions", "hu") if getattr(model, way) is not None]
    if len(ways) != 1:
        raise file.error(where, f"voxels need one of labels, fractions and hu, got {' and '.join(ways) or 'none'}")
    if (model.file is None) != isinstance(model.fractions, Mapping):
        raise file.error((*where, "file"), "stands for labels, hu, or a list of fractions, and belongs to these only")
    with file.at(*where):
        volume, content, names = _READERS[ways[0]](file, model, where)
        if not content.mixtures[content.cells].any():
            raise InputError("no voxel has a material")
        return _placed(model, volume, content), names


def _labels(file: SceneFile, model: schema.VoxelsModel, where: Location) -> tuple[Volume, VoxelMap, tuple[str, ...]]:
    """One material for each label."""
    volume, table = _single(file, model), _label_table(file, model, where)
    found, counts = np.unique(volume.values, return_counts=True)
    for label, count in zip(found.tolist(), counts.tolist(), strict=True):
        if label != 0 and label not in table:
            hint = f"add '{label}: material', or '{label}: null' where nothing is"
            raise file.error((*where, "labels"), f"label {label} of {count} voxels in {model.file} is missing: {hint}")
    used = [label for label in found.tolist() if table.get(int(label)) is not None]
    names = tuple(str(table[int(label)]) for label in used)
    if isinstance(model.labels, str) and "lung" in names and "lung" not in file.model.materials:
        inflated = "lung: {composition: lung, density: 0.26}"
        raise file.error(
            (*where, "labels"), f"lungs hold air, the known material does not: add '{inflated}' to materials"
        )
    return volume, VoxelMap.of_labels(volume.values, used), names


def _label_table(file: SceneFile, model: schema.VoxelsModel, where: Location) -> Mapping[int, str | None]:
    """Material of each label: those that are stated, or those of a program but for those that are stated otherwise."""
    if isinstance(model.labels, str):
        changes = model.relabel or {}
        for label, name in changes.items():
            if name is not None:
                check_material(file, name, (*where, "relabel", label))
        return {**TISSUES[model.labels], **changes}
    if model.relabel is not None:
        raise file.error((*where, "relabel"), f"changes labels of a program, and needs labels: {' or '.join(TISSUES)}")
    table = model.labels or {}
    for label, name in table.items():
        if name is not None:
            check_material(file, name, (*where, "labels", label))
    return table


def _hounsfield(
    file: SceneFile, model: schema.VoxelsModel, where: Location
) -> tuple[Volume, VoxelMap, tuple[str, ...]]:
    """One material for each interval of Hounsfield units; what lies below all of them is nothing."""
    table: Mapping[str, tuple[float, float]] = HOUNSFIELD if model.hu in ("default", None) else model.hu  # type: ignore[assignment]
    volume, intervals = _single(file, model), sorted((*interval, name) for name, interval in table.items())
    labels = np.zeros(volume.values.shape, dtype=np.int32)
    known = volume.values < intervals[0][0]
    below = -np.inf
    for i, (low, high, name) in enumerate(intervals):
        place = (*where, "hu", name) if isinstance(model.hu, Mapping) else (*where, "hu")
        check_material(file, name, place)
        if not max(low, below) == low < high:
            raise file.error(
                place, f"an interval must end above its beginning and not overlap another, got {low, high}"
            )
        within, below = (volume.values >= low) & (volume.values < high), high
        labels[within] = i + 1
        known |= within
    if not known.all():
        value = volume.values[~known].flat[0]
        raise file.error((*where, "hu"), f"{(~known).sum()} voxels, one of {value:g} HU, lie in no interval")
    used = [int(i) for i in np.unique(labels) if i > 0]
    return volume, VoxelMap.of_labels(labels, used), tuple(intervals[i - 1][2] for i in used)


def _fractions(file: SceneFile, model: schema.VoxelsModel, where: Location) -> tuple[Volume, VoxelMap, tuple[str, ...]]:
    """Volume fractions: a file for each material, or one file with several."""
    volume, names = _stack(file, model, where)
    for name in names:
        check_material(file, name, (*where, "fractions", *([name] if isinstance(model.fractions, Mapping) else [])))
    values = volume.values.astype(np.float64)
    total = values.sum(axis=0)
    for name, part in zip(names, values, strict=True):
        if part.min() < -_EXCESS:
            raise InputError(f"fractions must not be negative, those of {name} are down to {part.min():.4g}")
    if total.max() > 1 + _EXCESS:
        many = (total > 1 + _EXCESS).sum()
        raise InputError(f"fractions must not sum to more than 1, they do in {many} voxels, up to {total.max():.4g}")
    values = values.clip(0) / np.maximum(values.clip(0).sum(axis=0), 1)
    used = [i for i in range(len(names)) if values[i].any()]
    return volume, VoxelMap.of_fractions(values[used]), tuple(names[i] for i in used)


_READERS = {"labels": _labels, "fractions": _fractions, "hu": _hounsfield}


def _single(file: SceneFile, model: schema.VoxelsModel) -> Volume:
    """The one volume of labels or of Hounsfield units."""
    volume = read_volume(str(model.file), Path(file.name).parent)
    if volume.values.ndim != 3:
        raise InputError(f"{model.file} must be (z, y, x), got shape {volume.values.shape}")
    if model.labels is not None and volume.values.dtype.kind == "f":
        whole = np.rint(volume.values)
        if (whole != volume.values).any():
            raise InputError(f"{model.file}: labels must be whole numbers, {(whole != volume.values).sum()} are not")
        volume = replace(volume, values=whole.astype(np.int64))
    return volume


def _stack(file: SceneFile, model: schema.VoxelsModel, where: Location) -> tuple[Volume, Sequence[str]]:
    """All volumes of fractions as one, and the names of their materials."""
    folder = Path(file.name).parent
    if not isinstance(model.fractions, Mapping):
        names, volume = model.fractions or (), read_volume(str(model.file), folder)
        if volume.values.ndim != 4 or len(volume.values) != len(names):
            wanted = f"({len(names)}, z, y, x) for {len(names)} materials"
            raise InputError(f"{model.file} must be {wanted}, got shape {volume.values.shape}")
        return volume, names
    if not model.fractions:
        raise file.error((*where, "fractions"), "is empty")
    volumes = {name: read_volume(path, folder) for name, path in model.fractions.items()}
    first = next(iter(volumes.values()))
    for name, volume in volumes.items():
        shape, wanted = volume.values.shape, first.values.shape
        if volume.values.ndim != 3 or shape != wanted:
            raise InputError(f"{model.fractions[name]} must be (z, y, x) like the others, {wanted}, got shape {shape}")
        if not all(np.allclose(a, b) for a, b in zip(_place(volume), _place(first), strict=True)):
            raise InputError(f"{model.fractions[name]} lies elsewhere than the other fractions")
    return replace(first, values=np.stack([volume.values for volume in volumes.values()])), list(volumes)


def _place(volume: Volume) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return spacing, directions and origin as the file states them."""
    directions = np.eye(3) if volume.directions is None else volume.directions
    return np.array(volume.spacing or 0.0), directions, np.array(volume.origin or 0.0)


def _placed(model: schema.VoxelsModel, volume: Volume, content: VoxelMap) -> Voxels:
    """The box of voxels in space."""
    counts = np.array(content.cells.shape[::-1])
    if model.spacing is None and volume.spacing is None:
        raise InputError("spacing is missing: the file does not say how large its voxels are")
    spacing = np.broadcast_to(np.asarray(model.spacing or volume.spacing, dtype=np.float64), 3)
    directions = np.eye(3) if volume.directions is None else volume.directions
    center = np.zeros(3)
    if model.center is not None:
        center = np.array(model.center)
    elif volume.origin is not None:
        center = np.array(volume.origin) + directions @ (spacing * (counts - 1) / 2)
    x, y, z = (radians(angle) for angle in model.rotation)
    return Voxels(content, rotation_matrix((x, y, z)) @ directions * (spacing * counts / 2), center)
