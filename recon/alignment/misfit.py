"""How badly a volume can explain the views, when the panel is taken to be somewhere: least where it was.

A wrong place of the panel makes opposite views contradict each other, and no volume explains both. The volume is fitted
by a few iterations of conjugate gradients, so that this holds for any orbit, cone or parallel beam.
"""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel_changes import moved_panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.ops.project import project, project_transpose
from recon.alignment.projections import Projections


def misfit(data: Projections, shift: float = 0.0, turn: float = 0.0, iterations: int = 6) -> float:
    """Compute the part of the views that no volume explains, if the panel was elsewhere.

    Parameters
    ----------
    data : the views
    shift : of the panel along its columns, in columns of `data`
    turn : of the panel in its plane [degree]
    iterations : of conjugate gradients

    Returns
    -------
    weighted sum of squares of what is left, over that of the views
    """
    return _unexplained(data, moved_panel(data.geometry, shift, turn), iterations)


def misfit_of_opposite_turns(data: Projections, shift: float, turn: float, iterations: int = 6) -> float:
    """Compute the same as `misfit` for a sample that turned the other way round.

    Parameters
    ----------
    data, shift, turn, iterations : as in `misfit`

    Returns
    -------
    the misfit
    """
    geometry = moved_panel(data.geometry, shift, turn)
    back = np.stack([rotation_matrix((0.0, 0.0, -2 * angle)) for angle in geometry.angles])
    return _unexplained(data, geometry.moved(back, np.zeros((len(back), 3))), iterations)


def _unexplained(data: Projections, geometry: Geometry, iterations: int) -> float:
    """Weighted CGLS from zero; see `recon.voxel.iterative.cgls`."""
    frames, panel = geometry.ray_frames(), geometry.panel
    root = np.sqrt(data.weights)
    residual = (root * data.values)[None]
    whole = _squares(residual)
    direction = project_transpose(root * residual, data.grid, frames)
    steepness = _squares(direction)
    for _ in range(iterations):
        image = root * project(direction, data.grid, frames, panel.rows, panel.columns)
        length = _squares(image)
        if steepness == 0 or length == 0:
            break
        residual -= np.float32(steepness / length) * image
        gradient = project_transpose(root * residual, data.grid, frames)
        before, steepness = steepness, _squares(gradient)
        direction = gradient + np.float32(steepness / before) * direction
    return _squares(residual) / whole if whole else 0.0


def _squares(array: Float[np.ndarray, "..."]) -> float:
    return float(np.sum(np.square(array, dtype=np.float64)))
