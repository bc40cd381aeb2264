"""Images with all that a volume can explain taken away, by weighted least squares on voxels.

The volume is a nuisance of every estimate of the geometry. Taking out of the data, and of their derivatives in the
geometry, what a change of the volume explains as well leaves an estimate that needs no volume (variable projection:
Golub & Pereyra 1973, doi:10.1137/0710036). The inner solver is a fixed number of accelerated gradient steps with the
diagonal majorizer of separable paraboloidal surrogates (Kim, Ramani & Fessler 2015, doi:10.1109/TMI.2014.2350962):
a linear function of the images.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from recon.voxel.projector_pair import ProjectorPair, inverse_or_zero


class Explained(NamedTuple):
    """What volumes explain of images.

    Parameters
    ----------
    volumes : one per image set [1/mm]
    rest : images minus projections of the volumes
    """

    volumes: Float[np.ndarray, "component z y x"]
    rest: Float[np.ndarray, "component view row column"]


def explain(
    images: Float[np.ndarray, "component view row column"],
    pair: ProjectorPair,
    weights: Float[np.ndarray, "view row column"],
    iterations: int,
) -> Explained:
    """Explain images by volumes.

    Parameters
    ----------
    images : sets of images, each explained by a volume of its own
    pair : projector
    weights : of each ray
    iterations : number of steps

    Returns
    -------
    the volumes, and what they leave
    """
    curvature = pair.transpose((weights * pair.lengths)[None])[0]
    scale = inverse_or_zero(curvature)
    volumes = np.zeros((len(images), *pair.grid.shape), np.float32)
    leading, momentum = volumes, 1.0
    for _ in range(iterations):
        rest = images - pair.project(leading)
        stepped = leading + scale * pair.transpose((weights * rest).astype(np.float32))
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        leading = (stepped + np.float32((momentum - 1) / following) * (stepped - volumes)).astype(np.float32)
        volumes, momentum = stepped, following
    return Explained(volumes, images - pair.project(volumes))
