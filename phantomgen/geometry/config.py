"""Nominal views of an orbit and a panel as scene files describe them, and of a file of views alone.

Jitter of poses and motion of the sample are added elsewhere (`phantomgen.scene.geometry`).
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, ValidationError

from phantomgen.geometry import orbits
from phantomgen.geometry.fan_angles import fan_angles
from phantomgen.geometry.panel import Curvature, Panel, module_columns
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.pose_table import read_poses
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.schema import (
    CircularModel,
    HelicalModel,
    LaminographyModel,
    OffsetModel,
    OrbitModel,
    PanelModel,
    ParallelModel,
    PosesModel,
    TiltModel,
)
from phantomgen.runtime.yaml_text import YamlTextError, parse_yaml
from spectra.errors import Error, GeometryError, InputError

Turning = CircularModel | LaminographyModel | ParallelModel


class NominalViews(NamedTuple):
    """Views of an orbit, training views first.

    Parameters
    ----------
    geometry : poses with the panel at its nominal place
    times : of the views, from 0 to 1; test views lie between the training views
    train : number of training views
    """

    geometry: Geometry
    times: Float[np.ndarray, " view"]
    train: int


class _GeometryFile(BaseModel):
    """Keys of a scene file that say where views are; the others are not read."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    geometry: OrbitModel
    panel: PanelModel


def read_geometry_file(path: Path) -> Geometry:
    """Read views from a YAML file with the keys ``geometry`` and ``panel`` of a scene file.

    Parameters
    ----------
    path : YAML file

    Returns
    -------
    nominal poses, training views first

    Raises
    ------
    InputError
        When the file cannot be read, lacks a key, or has one that does not belong there.
    GeometryError
        When the views are impossible.
    """
    try:
        values = parse_yaml(path.read_text(encoding="utf-8")).values
    except OSError as error:
        raise InputError(f"{path} cannot be read as a geometry: {error.strerror}") from None
    except (YamlTextError, UnicodeDecodeError):
        raise InputError(f"{path} cannot be read as a geometry: it is not YAML text") from None
    if not isinstance(values, dict):
        raise InputError(f"{path}: the file must be a mapping with keys, as in scene files")
    try:
        file = _GeometryFile.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{path}: {_sentence(error, values)}") from None
    orbit, panel = file.geometry, panel_of(file.panel)
    try:
        table = read_poses(path.parent / orbit.file, panel) if isinstance(orbit, PosesModel) else None
        return mounted(nominal_views(orbit, file.panel, table).geometry, mount_of(file.panel))
    except Error as error:
        raise type(error)(f"{path}: {error}") from None


def panel_of(model: PanelModel) -> Panel:
    """Create the pixel grid.

    Parameters
    ----------
    model : panel of a scene file

    Returns
    -------
    rows, columns, pitch and curvature

    Raises
    ------
    InputError
        When columns cannot be divided into modules, or the panel turns too far.
    """
    flat = Panel(model.rows, model.columns, model.pitch)
    if model.curvature is None:
        return flat
    width = model.curvature.module_columns or module_columns(flat, model.curvature.radius)
    if model.columns % width:
        raise InputError(f"curvature.module_columns is {width}, which does not divide the {model.columns} columns")
    return replace(flat, curvature=Curvature(model.curvature.radius, model.columns // width))


def mount_of(model: PanelModel) -> Mount:
    """Create the shift and the tilt of the panel.

    Parameters
    ----------
    model : panel of a scene file

    Returns
    -------
    offsets [mm] and angles [rad]
    """
    offset, tilt = model.offset or OffsetModel(), model.tilt or TiltModel()
    turns = np.deg2rad([tilt.columns, tilt.rows, tilt.in_plane]).tolist()
    return Mount((offset.columns, offset.rows), (turns[0], turns[1], turns[2]))


def nominal_views(orbit: OrbitModel, panel: PanelModel, table: Geometry | None = None) -> NominalViews:
    """Create the views of an orbit.

    Parameters
    ----------
    orbit, panel : as in a scene file
    table : poses of an orbit of type ``poses``, as read from its file

    Returns
    -------
    the views

    Raises
    ------
    GeometryError
        When the keys of the orbit contradict each other, or the views are impossible.
    """
    grid = panel_of(panel)
    if isinstance(orbit, PosesModel):
        return _from_table(orbit, table)
    if isinstance(orbit, HelicalModel):
        return _with_flying_focal_spot(_helical(orbit, grid), orbit)
    angles, times, train = _angles(orbit, panel)
    if isinstance(orbit, CircularModel):
        views = NominalViews(Geometry.circular(orbit.sod, orbit.sdd, angles, grid), times, train)
        return _with_flying_focal_spot(views, orbit)
    tilt = float(np.deg2rad(orbit.tilt))
    if isinstance(orbit, LaminographyModel):
        return NominalViews(orbits.laminography(orbit.sod, orbit.sdd, angles, tilt, grid), times, train)
    return NominalViews(orbits.parallel(orbit.distance, angles, grid, tilt), times, train)


def _angles(orbit: Turning, panel: PanelModel) -> tuple[Float[np.ndarray, " view"], Float[np.ndarray, " view"], int]:
    """Angles [rad], times and number of training views of orbits that turn about the axis."""
    if (orbit.views is None) == (orbit.angles is None):
        raise GeometryError("an orbit needs either views, the number of them, or angles, a list in degrees")
    if orbit.views is not None:
        whole = 180.0 if isinstance(orbit, ParallelModel) else 360.0
        arc = orbit.arc or whole
        if isinstance(orbit, CircularModel) and arc == "short":
            arc = _short_arc(panel, orbit.sdd)
        angles = orbits.spread_angles(orbit.views, orbit.test_views, float(arc), orbit.start or 0.0)
        return angles, _times(orbit.views, orbit.test_views), orbit.views
    if orbit.arc is not None or orbit.start is not None:
        raise GeometryError("angles stand for themselves: leave arc and start out")
    listed = np.array(orbit.angles)
    positions = np.arange(len(listed)) / len(listed)
    angles, times = (np.append(a, orbits.between(a, orbit.test_views)) for a in (listed, positions))
    return np.deg2rad(angles), times, len(listed)


def _times(views: int, test_views: int) -> Float[np.ndarray, " view"]:
    """Return the times of the views, from 0 to 1; test views lie between the training views."""
    return np.concatenate([np.arange(views) / views, (np.arange(test_views) + 0.5) / max(test_views, 1)])


def _short_arc(panel: PanelModel, sdd: float) -> float:
    """Half a turn and the fan of the panel, outer edges of pixels included [degree]."""
    curvature = None if panel.curvature is None else Curvature(panel.curvature.radius, panel.columns + 1)
    edges = Panel(panel.rows + 1, panel.columns + 1, panel.pitch, curvature)
    return orbits.short_arc(float(np.abs(fan_angles(edges, sdd, mount_of(panel))).max()))


def _helical(orbit: HelicalModel, panel: Panel) -> NominalViews:
    """A helix whose middle is at z = 0."""
    if (orbit.turns is None) == (orbit.range is None):
        raise GeometryError("a helical orbit needs either turns, the number of them, or range, its rise in mm")
    if orbit.turns is None and orbit.pitch == 0:
        raise GeometryError("a helical orbit of pitch 0 covers no range: give turns")
    turns = orbit.turns if orbit.turns is not None else float(orbit.range or 0.0) / abs(orbit.pitch)
    angles = orbits.spread_angles(orbit.views, orbit.test_views, 360.0 * turns, orbit.start)
    first = -orbit.pitch * (turns / 2 + orbit.start / 360)
    geometry = orbits.helical(orbit.sod, orbit.sdd, angles, orbit.pitch, panel, first)
    return NominalViews(geometry, _times(orbit.views, orbit.test_views), orbit.views)


def _with_flying_focal_spot(views: NominalViews, orbit: CircularModel | HelicalModel) -> NominalViews:
    """Deflect the focal spot; training views and test views count from 0 each."""
    if orbit.flying_focal_spot is None:
        return views
    deflections = np.array([(spot.columns, spot.z, spot.outward) for spot in orbit.flying_focal_spot])
    numbers = np.append(np.arange(views.train), np.arange(len(views.times) - views.train))
    return views._replace(geometry=orbits.deflected(views.geometry, deflections[numbers % len(deflections)]))


def _from_table(orbit: PosesModel, table: Geometry | None) -> NominalViews:
    """Rows of a table, those for tests last."""
    rows, tests = 0 if table is None else len(table), orbit.test_views
    if table is None or tests >= rows:
        raise GeometryError(
            f"of {rows} poses in {orbit.file}, {tests} cannot be test views: some must be left to train"
        )
    picked = ((np.arange(tests) + 0.5) * rows / max(tests, 1)).astype(int)
    order = np.append(np.delete(np.arange(rows), picked), picked)
    return NominalViews(table[order], order / rows, rows - tests)


def _sentence(error: ValidationError, values: dict) -> str:
    """Return the first error that pydantic found as a sentence; misspelt keys come first, as they explain the rest."""
    found = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    orbit = values.get("geometry")
    kind = orbit.get("type") if isinstance(orbit, dict) else None
    key = ".".join(str(part) for part in found["loc"] if part != kind)
    if found["type"] == "extra_forbidden":
        return f"{key} is an unknown key"
    if found["type"] == "missing":
        return f"{key} is missing"
    return f"{key} - {found['msg'][0].lower()}{found['msg'][1:]}"
