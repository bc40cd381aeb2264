"""Poses in a dataset: the nominal ones in ``/entry/geometry``, true ones in ``/truth`` where these are others."""

from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.dataset.layout import FRAME, array_at, group_at, new_group, put, text_of
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import DatasetError

_VECTORS = ("panel_center", "column_step", "row_step")
KINDS = ("circular", "helical", "laminography", "parallel", "free")


def write_geometry(parent: h5py.Group, geometry: Geometry) -> None:
    """Write poses as vectors; a parallel beam has the direction of its rays in place of a source."""
    group = new_group(parent, "geometry", "NXcollection", frame=FRAME)
    put(group, "kind", geometry.kind)
    if geometry.ray_direction is None:
        put(group, "source", geometry.source, "mm")
    else:
        put(group, "ray_direction", geometry.ray_direction, "1")
    for name in _VECTORS:
        put(group, name, getattr(geometry, name), "mm")


def read_geometry(group: h5py.Group, panel: Panel, angles: Float[np.ndarray, " view"]) -> Geometry:
    """Poses of all views.

    Parameters
    ----------
    group : that `write_geometry` wrote
    panel : the pixel grid
    angles : rotation angle of each view [rad], NaN where a view has none
    """
    vectors = {name: array_at(group, name)[()] for name in _VECTORS}
    kind = text_of(array_at(group, "kind")[()])
    if kind == "parallel":
        return Geometry.parallel(array_at(group, "ray_direction")[()], **vectors, panel=panel, angles=angles)
    return Geometry(source=array_at(group, "source")[()], **vectors, panel=panel, angles=angles, kind=kind)


def distances(geometry: Geometry) -> dict[str, float | None]:
    """Distances in view 0 [mm]: from source to axis and to panel, None in a parallel beam, and from axis to panel.

    Those to the panel are along its normal. In a helical scan the axis is met at the height of the source.
    """
    source, center, normal = geometry.source[0].copy(), geometry.panel_center[0].copy(), geometry.normals()[0]
    if geometry.kind == "helical":
        center[2] -= source[2]
        source[2] = 0.0
    near = {"sod_mm": float(np.linalg.norm(source)), "sdd_mm": float(abs((center - source) @ normal))}
    behind = {"object_to_panel_mm": float(abs(center @ normal))}
    return (dict.fromkeys(near) if geometry.is_parallel else near) | behind


def write_true_geometry(truth: h5py.Group, geometry: Geometry, sample: Float[np.ndarray, "view 4 4"] | None) -> None:
    """Write the poses that were simulated, in the frame of the sample, and where the sample was.

    Parameters
    ----------
    truth : group of the truth
    geometry : true poses
    sample : matrices from the sample at rest to where it was [mm], None where it did not move
    """
    write_geometry(truth, geometry)
    if sample is not None:
        put(new_group(truth, "motion", "NXcollection"), "pose", sample, "mm")


def read_true_geometry(path: Path | str) -> Geometry | None:
    """True poses of a dataset, where they are not those of ``/entry/geometry``; None where they are."""
    from phantomgen.dataset.reader import damaged_file, open_dataset  # noqa: PLC0415 - it reads geometries by this module

    anywhere = (slice(0, 1), slice(0, 1))
    with open_dataset(path, air=anywhere) as dataset, damaged_file(dataset.path):
        if "truth/geometry" not in dataset.file:
            return None
        nominal = dataset.geometry
        true = read_geometry(group_at(dataset.file, "truth/geometry"), nominal.panel, nominal.angles)
        if len(true) != len(nominal):
            raise DatasetError(f"{path}: /truth/geometry has {len(true)} views, /entry/geometry {len(nominal)}")
        return true


def read_sample_poses(path: Path | str) -> Float[np.ndarray, "view 4 4"] | None:
    """Where the sample was in each view, as matrices from its rest to there [mm]; None where it did not move."""
    from phantomgen.dataset.reader import damaged_file, open_file  # noqa: PLC0415

    with open_file(Path(path)) as file, damaged_file(Path(path)):
        return array_at(file, "truth/motion/pose")[()] if "truth/motion/pose" in file else None
