"""The geometry of a scene file: nominal poses, and true ones where views jitter or the sample moves."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from phantomgen.effects.pose_jitter import Jitter, jittered
from phantomgen.effects.sample_motion import Drift, Motion, RandomWalk, Sinusoid, seen_from_sample
from phantomgen.geometry import orbits
from phantomgen.geometry.fan_angles import fan_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.pose_table import read_poses
from phantomgen.geometry.poses import Geometry
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import SceneFile
from spectra.errors import GeometryError

Turning = schema.CircularModel | schema.LaminographyModel | schema.ParallelModel


class SceneGeometry(NamedTuple):
    """Poses of training views, then of test views.

    Parameters
    ----------
    true : simulated poses, in the frame of the sample
    nominal : poses given to a reconstructor; None where they equal the true ones
    sample : pose of the sample in each view, as matrices from its rest to there [mm]; None where it does not move
    splits : indices of the views in ``train``, ``test`` and ``val``
    """

    true: Geometry
    nominal: Geometry | None
    sample: Float[np.ndarray, "view 4 4"] | None
    splits: Mapping[str, Int[np.ndarray, " _view"]]


def scene_geometry(file: SceneFile) -> SceneGeometry:
    """Create the geometry of a scene.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    true and nominal poses, poses of the sample, and splits of the views

    Raises
    ------
    SceneError
        Where it is impossible.
    """
    model = file.model
    with file.at("geometry"):
        nominal, times, train = _orbit(file)
    views = np.arange(len(nominal))
    splits = {"train": views[:train], "test": views[train:], "val": views[:0]}
    with file.at("panel"):
        nominal = mounted(nominal, mount_of(model))
    true, poses = nominal, None
    if model.geometry.jitter is not None:
        with file.at("geometry", "jitter"):
            true = jittered(nominal, _jitter(model.geometry.jitter), model.seed)
    if model.effects.motion is not None:
        poses = motion_of(model.effects.motion).poses(times, train, model.seed)
        true = seen_from_sample(true, poses)
    return SceneGeometry(true, None if true is nominal else nominal, poses, splits)


def panel_of(scene: schema.SceneModel) -> Panel:
    """Create the pixel grid.

    Parameters
    ----------
    scene : model of the scene file

    Returns
    -------
    rows, columns and pitch
    """
    return Panel(scene.panel.rows, scene.panel.columns, scene.panel.pitch)


def mount_of(scene: schema.SceneModel) -> Mount:
    """Create the shift and the tilt of the panel.

    Parameters
    ----------
    scene : model of the scene file

    Returns
    -------
    offsets [mm] and angles [rad]
    """
    offset, tilt = scene.panel.offset or schema.OffsetModel(), scene.panel.tilt or schema.TiltModel()
    turns = np.deg2rad([tilt.columns, tilt.rows, tilt.in_plane]).tolist()
    return Mount((offset.columns, offset.rows), (turns[0], turns[1], turns[2]))


def panel_distance(scene: schema.SceneModel, what: str) -> float:
    """Return the distance from source to panel.

    Parameters
    ----------
    scene : model of the scene file
    what : what requires the distance, for the message

    Returns
    -------
    distance [mm]

    Raises
    ------
    GeometryError
        For orbits that have none.
    """
    if isinstance(scene.geometry, schema.ParallelModel | schema.PosesModel):
        raise GeometryError(f"{what} needs an orbit with a distance from source to panel, got {scene.geometry.type}")
    return scene.geometry.sdd


def motion_of(model: schema.MotionModel) -> Motion:
    """Create the motion of the sample.

    Parameters
    ----------
    model : its model in the scene file

    Returns
    -------
    the motion
    """
    a, b, c = np.deg2rad(model.rotation).tolist()
    if isinstance(model, schema.SinusoidModel):
        return Sinusoid(model.shift, (a, b, c), model.periods, float(np.deg2rad(model.phase)))
    return (Drift if isinstance(model, schema.DriftModel) else RandomWalk)(model.shift, (a, b, c))


def _jitter(model: schema.JitterModel) -> Jitter:
    return Jitter(model.source, model.panel, float(np.deg2rad(model.rotation)))


def _orbit(file: SceneFile) -> tuple[Geometry, Float[np.ndarray, " view"], int]:
    """Poses, times from 0 to 1, and the number of training views, which come first."""
    orbit, panel = file.model.geometry, panel_of(file.model)
    if isinstance(orbit, schema.PosesModel):
        return _from_table(file, orbit, panel)
    if isinstance(orbit, schema.HelicalModel):
        return _helical(orbit, panel)
    angles, times, train = _angles(file.model, orbit)
    if isinstance(orbit, schema.CircularModel):
        return Geometry.circular(orbit.sod, orbit.sdd, angles, panel), times, train
    tilt = float(np.deg2rad(orbit.tilt))
    if isinstance(orbit, schema.LaminographyModel):
        return orbits.laminography(orbit.sod, orbit.sdd, angles, tilt, panel), times, train
    return orbits.parallel(orbit.distance, angles, panel, tilt), times, train


def _angles(
    scene: schema.SceneModel, orbit: Turning
) -> tuple[Float[np.ndarray, " view"], Float[np.ndarray, " view"], int]:
    """Angles [rad], times and number of training views of orbits that turn about the axis."""
    if (orbit.views is None) == (orbit.angles is None):
        raise GeometryError("an orbit needs either views, the number of them, or angles, a list in degrees")
    if orbit.views is not None:
        whole = 180.0 if isinstance(orbit, schema.ParallelModel) else 360.0
        arc = _short_arc(scene, orbit) if orbit.arc == "short" else orbit.arc or whole
        angles = orbits.spread_angles(orbit.views, orbit.test_views, arc, orbit.start or 0.0)
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


def _short_arc(scene: schema.SceneModel, orbit: Any) -> float:
    """Half a turn and the fan of the panel, outer edges of pixels included [degree]."""
    panel, mount = panel_of(scene), mount_of(scene)
    edges = Panel(panel.rows + 1, panel.columns + 1, panel.pitch)
    return orbits.short_arc(float(np.abs(fan_angles(edges, orbit.sdd, mount)).max()))


def _helical(orbit: schema.HelicalModel, panel: Panel) -> tuple[Geometry, Float[np.ndarray, " view"], int]:
    """A helix whose middle is at z = 0."""
    if (orbit.turns is None) == (orbit.range is None):
        raise GeometryError("a helical orbit needs either turns, the number of them, or range, its rise in mm")
    if orbit.turns is None and orbit.pitch == 0:
        raise GeometryError("a helical orbit of pitch 0 covers no range: give turns")
    turns = orbit.turns if orbit.turns is not None else float(orbit.range or 0.0) / abs(orbit.pitch)
    angles = orbits.spread_angles(orbit.views, orbit.test_views, 360.0 * turns, orbit.start)
    first = -orbit.pitch * (turns / 2 + orbit.start / 360)
    geometry = orbits.helical(orbit.sod, orbit.sdd, angles, orbit.pitch, panel, first)
    return geometry, _times(orbit.views, orbit.test_views), orbit.views


def _from_table(
    file: SceneFile, orbit: schema.PosesModel, panel: Panel
) -> tuple[Geometry, Float[np.ndarray, " view"], int]:
    """Rows of a table, those for tests last."""
    with file.at("geometry", "file"):
        table = read_poses(Path(file.name).parent / orbit.file, panel)
    rows, tests = len(table), orbit.test_views
    if tests >= rows:
        raise GeometryError(
            f"of {rows} poses in {orbit.file}, {tests} cannot be test views: some must be left to train"
        )
    picked = ((np.arange(tests) + 0.5) * rows / max(tests, 1)).astype(int)
    order = np.append(np.delete(np.arange(rows), picked), picked)
    return table[order], order / rows, rows - tests
