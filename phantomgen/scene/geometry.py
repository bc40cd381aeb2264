"""The geometry of a scene file: nominal poses, and true ones where views jitter or the sample moves."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from phantomgen.effects.pose_jitter import Jitter, jittered
from phantomgen.effects.sample_motion import Drift, Motion, RandomWalk, Sinusoid, seen_from_sample
from phantomgen.geometry.config import mount_of, nominal_views, panel_of
from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.geometry.panel_mount import mounted
from phantomgen.geometry.pose_table import read_poses
from phantomgen.geometry.poses import Geometry
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import SceneFile
from spectra.errors import GeometryError


class SceneGeometry(NamedTuple):
    """Poses of training views, then of test views.

    Parameters
    ----------
    true : simulated poses, in the frame of the sample
    nominal : poses given to a reconstructor; None where they equal the true ones
    sample : pose of the sample in each view, as matrices from its rest to there [mm]; None where it does not move
    times : of the views, from 0 to 1
    splits : indices of the views in ``train``, ``test`` and ``val``
    """

    true: Geometry
    nominal: Geometry | None
    sample: Float[np.ndarray, "view 4 4"] | None
    times: Float[np.ndarray, " view"]
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
    model, orbit, table = file.model, file.model.geometry, None
    if isinstance(orbit, schema.PosesModel):
        with file.at("geometry", "file"):
            table = read_poses(Path(file.name).parent / orbit.file, panel_of(model.panel))
    with file.at("geometry"):
        nominal, times, train = nominal_views(orbit, model.panel, table)
    views = np.arange(len(nominal))
    splits = {"train": views[:train], "test": views[train:], "val": views[:0]}
    with file.at("panel"):
        nominal = mounted(nominal, mount_of(model.panel))
        flat_modules(nominal)  # refuses a panel that is wrapped past the source
    true, poses = nominal, None
    if model.geometry.jitter is not None:
        with file.at("geometry", "jitter"):
            true = jittered(nominal, _jitter(model.geometry.jitter), model.seed)
    if model.effects.motion is not None:
        poses = motion_of(model.effects.motion).poses(times, train, model.seed)
        true = seen_from_sample(true, poses)
    return SceneGeometry(true, None if true is nominal else nominal, poses, times, splits)


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
