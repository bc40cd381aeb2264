"""Random displacements of source and panel, new in every view, as a gantry that is not rigid has them.

Model: in each view the source and the panel's centre are shifted along x, y and z, and the panel is turned about its
centre about its own axes u, v and w, by normal numbers of mean zero, all independent of each other. A reconstructor
knows the nominal geometry only.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from phantomgen.geometry.panel_mount import with_parallel_source
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix
from spectra.errors import InputError


@dataclass(frozen=True)
class Jitter:
    """Standard deviations of random displacements, per axis.

    Parameters
    ----------
    source, panel : of the shifts of the source and of the panel's centre [mm]
    rotation : of the turns of the panel [rad]
    """

    source: float = 0.0
    panel: float = 0.0
    rotation: float = 0.0

    def numbers(self, seed: int, views: int) -> Float[np.ndarray, "view 9"]:
        """Draw standard normal numbers of each view, which do not depend on the number of views.

        Parameters
        ----------
        seed : of the scan
        views : number of views

        Returns
        -------
        numbers, (view, 9)
        """
        drawn = [generator(seed, Stream.JITTER, view, 0).standard_normal(9) for view in range(views)]
        return np.array(drawn).reshape(views, 9)


def jittered(geometry: Geometry, jitter: Jitter, seed: int) -> Geometry:
    """Compute the true geometry of a scan from the nominal one.

    Parameters
    ----------
    geometry : nominal poses
    jitter : standard deviations
    seed : of the scan

    Returns
    -------
    true poses

    Raises
    ------
    InputError
        When the far source of a parallel beam is to be shifted, which would change nothing.
    """
    if geometry.is_parallel and jitter.source:
        raise InputError("jitter of the source has no effect in a parallel beam: leave it out, or jitter the panel")
    drawn = jitter.numbers(seed, len(geometry))
    turns = np.array([rotation_matrix(tuple(row)) for row in jitter.rotation * drawn[:, 6:]]).reshape(-1, 3, 3)
    steps = np.stack([geometry.column_step, geometry.row_step], axis=1)
    pitch = np.linalg.norm(steps, axis=2, keepdims=True)
    axes = np.concatenate([steps / pitch, geometry.normals()[:, None]], axis=1)
    turned = pitch * np.einsum("vkp,vki->vpi", turns[:, :, :2], axes)
    moved = replace(
        geometry,
        source=geometry.source + jitter.source * drawn[:, :3],
        panel_center=geometry.panel_center + jitter.panel * drawn[:, 3:6],
        column_step=turned[:, 0],
        row_step=turned[:, 1],
    )
    return with_parallel_source(moved)
