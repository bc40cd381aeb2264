"""Directions in which coefficients move where the materials of an object are known, and one channel measures it.

A curve of materials (`spectra.materials.material_curve`) makes one number of the coefficients of all bases. Gaussians
are fitted to voxels whose coefficients lie on it. From there, either side of a Gaussian keeps the mixture of materials
that these voxels have, and its density is fitted, which one channel determines. Across a plane, the sum of Gaussians
goes straight from one material to the other, as a mixture of both does, where voxels pass all materials between them.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.divided.model import DividedGaussians
from recon.gaussians.initial.local_frame import rotations, unit
from spectra.materials.material_curve import MaterialCurve

BESIDE = 1.5  # voxels from a plane, where the material of a side is looked at: past the blur of voxels
LEAST = 0.1  # no unit, over the attenuation of the first material; that of emptier places counts as this


@dataclass(frozen=True, eq=False)
class AlongCurve:
    """Where on a curve of materials the Gaussians are.

    Parameters
    ----------
    curve : of the materials
    attenuations : at the curve's energy, of the volumes that the Gaussians were fitted to [1/mm]
    grid : voxels of `attenuations`
    """

    curve: MaterialCurve
    attenuations: Float[np.ndarray, "z y x"]
    grid: Grid

    @classmethod
    def of_volumes(cls, curve: MaterialCurve, volumes: Float[np.ndarray, "basis z y x"], grid: Grid) -> "AlongCurve":
        """Find the attenuations of volumes whose coefficients lie on a curve.

        Parameters
        ----------
        curve : of the materials
        volumes : on it [1/mm]
        grid : voxels of `volumes`

        Returns
        -------
        places on the curve
        """
        return cls(curve, curve.attenuation_of(volumes), grid)

    def directions(self, model: DividedGaussians) -> Float[Tensor, "gaussian 2 basis"]:
        """Compute the mixture of materials on either side of each Gaussian's plane.

        Parameters
        ----------
        model : the Gaussians, wherever they are now

        Returns
        -------
        coefficients per attenuation at the curve's energy [no unit]
        """
        places = _beside(model, BESIDE * min(self.grid.spacing))
        index = (places[..., ::-1] - np.array(self.grid.origin)) / np.array(self.grid.spacing)
        found = map_coordinates(self.attenuations, index.reshape(-1, 3).T, order=1, mode="nearest")
        middle = np.maximum(found, LEAST * self.curve.attenuations[0]).reshape(index.shape[:-1])
        mixture = np.moveaxis(self.curve.values(middle) / middle, 0, -1)
        return torch.from_numpy(np.ascontiguousarray(mixture, np.float32)).to(model.centres.device)


def _beside(model: DividedGaussians, distance: float) -> Float[np.ndarray, "gaussian 2 3"]:
    """Find a point on either side of each plane (x, y, z) [mm]; the centre for both where no plane divides it."""
    with torch.no_grad():
        axes = rotations(unit(model.quaternions.double()))[:, :, 2]
        from_centre = model.offsets.double()[:, None] + torch.tensor([-distance, distance], device=axes.device)
        from_centre = torch.where(model.divided[:, None], from_centre, 0.0)
        return (model.centres.double()[:, None] + from_centre[..., None] * axes[:, None]).cpu().numpy()


def along(
    curvature: Float[Tensor, "gaussian 2 basis basis"], directions: Float[Tensor, "gaussian 2 basis"]
) -> Float[Tensor, "gaussian 2 basis basis"]:
    """Compute the inverse curvatures of coefficients that move in one direction each.

    Parameters
    ----------
    curvature : H, of the coefficients of each side [mm^2]
    directions : d, of any length

    Returns
    -------
    d d^T / (d^T H d), by which a step of Newton's method moves along d only [1/mm^2]
    """
    size = torch.einsum("gsm,gsmn,gsn->gs", directions, curvature, directions)
    return directions[..., :, None] * directions[..., None, :] / size[..., None, None]
