"""Poses in a dataset: nominal ones in ``/entry/geometry``, true ones in ``/truth`` where they differ."""

from dataclasses import replace

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.dataset.checks.door import has, value_at
from phantomgen.dataset.layout import FRAME, new_group, put, text_of
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.poses import Geometry

_VECTORS = ("panel_center", "column_step", "row_step")
KINDS = ("circular", "helical", "laminography", "parallel", "free")


def write_geometry(parent: h5py.Group, geometry: Geometry) -> None:
    """Write poses as vectors; a parallel beam has the direction of its rays in place of a source.

    Parameters
    ----------
    parent : group that gets them
    geometry : the poses
    """
    group = new_group(parent, "geometry", "NXcollection", frame=FRAME)
    put(group, "kind", geometry.kind)
    if geometry.ray_direction is None:
        put(group, "source", geometry.source, "mm")
    else:
        put(group, "ray_direction", geometry.ray_direction, "1")
    for name in _VECTORS:
        put(group, name, getattr(geometry, name), "mm")
    if geometry.panel.curvature is not None:
        put(group, "curvature_radius", geometry.panel.curvature.radius, "mm")
        put(group, "modules", geometry.panel.modules)


def read_geometry(group: h5py.Group, panel: Panel, angles: Float[np.ndarray, " view"]) -> Geometry:
    """Read the poses of all views.

    Parameters
    ----------
    group : that `write_geometry` wrote
    panel : the pixel grid, whose curvature the group states
    angles : rotation angle of each view [rad], NaN where a view has none

    Returns
    -------
    the poses
    """
    vectors = {name: value_at(group, name) for name in _VECTORS}
    kind = text_of(value_at(group, "kind"))
    if has(group, "curvature_radius"):
        radius, modules = float(value_at(group, "curvature_radius")), int(value_at(group, "modules"))
        panel = replace(panel, curvature=Curvature(radius, modules))
    if kind == "parallel":
        return Geometry.parallel(value_at(group, "ray_direction"), **vectors, panel=panel, angles=angles)
    return Geometry(source=value_at(group, "source"), **vectors, panel=panel, angles=angles, kind=kind)
