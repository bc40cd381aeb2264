"""The model with interfaces: Gaussians in space, each divided by a plane with other coefficients on either side."""

from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.initial.local_frame import rotations, unit
from recon.gaussians.model import GaussianModel, Gaussians
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.rasterize import rasterize_divided
from recon.ops.interface.sides import side_moments
from recon.ops.interface.voxelize import voxelize_divided
from recon.ops.rasterize.projector import Projector

CUTOFF = 4.0  # standard deviations; where Gaussians end; some forty overlap, and each leaves 3e-4 of its peak outside
PLAIN = 4.0  # standard deviations from the centre; a plane further away does not divide a Gaussian
PARTS_OF_VOXEL = 2  # along every axis, whose means are averaged: the mean over a voxel takes it for a Gaussian
SLAB = 16  # slices whose parts are in memory together
LIGHTEST = 1e-3  # part of a Gaussian's mass; a side with less is left out of `DividedGaussians.plain`


@dataclass(frozen=True, eq=False)
class DividedGaussians(GaussianModel):
    """A sum of Gaussians, each divided by a plane, that describes the attenuation of a volume.

    Parameters
    ----------
    centres : positions p_i, (N, 3) in the order x, y, z [mm]
    log_scales : logarithms of the standard deviations along the principal axes, (N, 3) [log mm]
    quaternions : orientations R_i, (N, 4) in the order w, x, y, z; their length does not matter [no unit]
    offsets : distance of the plane from the centre along the third axis n_i, (N,) [mm]
    coefficients : values at the centre per side of the plane (first against n_i, then along n_i) and basis, (N, 2, M),
        of either sign: only their sums over all Gaussians are attenuation [1/mm]
    basis_names : names of the M basis functions B_m
    width : standard deviation of the transition from one side to the other, the same for all [mm]

    Notes
    -----
    The attenuation is ``mu(x, E) = sum_m B_m(E) sum_i g_i(x) (b_i1m + (b_i2m - b_i1m) Phi(q_i(x) / width))`` with the
    Gaussian g_i of height 1, the normal distribution function Phi and ``q_i = n_i . (x - p_i) - offset_i``. A Gaussian
    whose plane is more than `PLAIN` standard deviations away is a plain one.
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    offsets: Float[Tensor, " gaussian"]
    coefficients: Float[Tensor, "gaussian 2 basis"]
    basis_names: tuple[str, ...]
    width: float

    GEOMETRY: ClassVar = ("centres", "log_scales", "quaternions", "offsets")
    SIGNED: ClassVar = True
    LEAST_CUTOFF: ClassVar = CUTOFF
    SCHEMA: ClassVar = "spectral-ct divided gaussians 1.0"
    UNITS: ClassVar = {
        "centres": "mm", "log_scales": "log mm", "offsets": "mm", "coefficients": "1/mm", "width": "mm",
    }  # fmt: skip

    def __repr__(self) -> str:
        divided, names = int(self.divided.sum()), ", ".join(self.basis_names)
        return f"DividedGaussians({len(self)}, {divided} of them divided by a plane, with {names})"

    @property
    def divided(self) -> Bool[Tensor, " gaussian"]:
        """Which Gaussians have their plane within `PLAIN` standard deviations."""
        return self.offsets.detach().abs() < PLAIN * torch.exp(self.log_scales.detach()[:, 2])

    @property
    def numbers(self) -> int:
        """Count the numbers that describe the model: 10 + M for a plain Gaussian, 11 + 2 M for a divided one."""
        bases, divided = self.coefficients.shape[2], int(self.divided.sum())
        return len(self) * (10 + bases) + divided * (1 + bases)

    def header(self) -> dict[str, Any]:
        """Collect what is no array.

        Returns
        -------
        the width of the transition [mm]
        """
        return {"width": self.width}

    def voxels(self, grid: Grid, cutoff: float = CUTOFF) -> Float[Tensor, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel.

        Parameters
        ----------
        grid : voxels to evaluate
        cutoff : where Gaussians end [standard deviations]

        Returns
        -------
        volumes, (M, Z, Y, X), differentiable in all arrays of the model [1/mm]
        """
        return voxelize_divided(self._arrays(), grid, cutoff)

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute the mean coefficient of each basis in every voxel; means below 0 are set to 0.

        Parameters
        ----------
        grid : voxels to evaluate; any part of a grid gives the same values as the whole

        Returns
        -------
        volumes, (M, Z, Y, X), float32, not negative [1/mm]
        """
        depth = grid.shape[0]
        slabs = [(first, min(SLAB, depth - first)) for first in range(0, depth, SLAB)]
        with torch.no_grad():
            parts = [voxelize_divided(self._arrays(), _parts_of_voxels(grid.slices(*slab)), CUTOFF) for slab in slabs]
        means = [_means_of_parts(part.cpu().numpy(), PARTS_OF_VOXEL) for part in parts]
        return np.maximum(np.concatenate(means, axis=1), 0)

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        """Compute the line integrals of each basis, averaged over every pixel.

        Parameters
        ----------
        geometry : poses of the views, and the panel

        Returns
        -------
        line integrals, (V, M, R, K), differentiable in all arrays of the model [no unit]
        """
        frames = torch.from_numpy(module_frames(geometry))
        panel = (geometry.panel.rows, geometry.panel.columns)
        return rasterize_divided(self._arrays(), frames, panel, Projector(cutoff=CUTOFF))

    def plain(self) -> Gaussians:
        """Describe the model by Gaussians alone, one for each side of a plane, for what knows nothing else.

        Returns
        -------
        Gaussians of the same mass, centre and covariance as the parts on either side; sides without mass, or where all
        coefficients are negative, are left out, and negative coefficients are 0
        """
        with torch.no_grad():
            scales = torch.exp(self.log_scales.double())
            axes = rotations(unit(self.quaternions.double()))[:, :, 2]
            cut = (self.offsets.double() / scales[:, 2]).clamp(-PLAIN, PLAIN)
            found = [self._side(side, cut, scales, axes) for side in (0, 1)]
            centres, log_scales, quaternions, values = (torch.cat(part).float() for part in zip(*found, strict=True))
            return Gaussians(centres, log_scales, quaternions, values, self.basis_names)

    def _side(self, side: int, cut: Tensor, scales: Tensor, axes: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Approximate the parts on one side by Gaussians: centres, log-scales, quaternions and coefficients."""
        mass, mean, spread = side_moments(cut, above=side == 1)
        away = mean * scales[:, 2]
        log_scales = torch.log(torch.stack([scales[:, 0], scales[:, 1], scales[:, 2] * spread], 1))
        values = (self.coefficients[:, side] * (mass / spread)[:, None]).clamp_min(0)
        kept = (mass > LIGHTEST) & (values > 0).any(dim=1)
        centres = self.centres + away[:, None] * axes
        return centres[kept], log_scales[kept], self.quaternions[kept], values[kept]

    def _arrays(self) -> DividedTensors:
        """Collect the arguments of the kernels."""
        thickness = torch.exp(self.log_scales[:, 2])
        planes = torch.stack([self.offsets / thickness, self.width / thickness], dim=1)
        below, above = self.coefficients.unbind(dim=1)
        return DividedTensors(self.centres, self.log_scales, self.quaternions, planes, below, above)


def _means_of_parts(fine: Float[np.ndarray, "basis z1 y1 x1"], n: int) -> Float[np.ndarray, "basis z y x"]:
    """Average n x n x n parts of every voxel."""
    for axis in (1, 2, 3):  # ten times sooner than a mean over three axes of small extent
        before = (slice(None),) * axis
        fine = reduce(np.add, [fine[(*before, slice(part, None, n))] for part in range(n)])
    return fine * np.float32(1 / n**3)


def _parts_of_voxels(grid: Grid) -> Grid:
    """Return the grid of the parts of all voxels."""
    n = PARTS_OF_VOXEL
    shape = tuple(n * k for k in grid.shape)
    spacing = tuple(s / n for s in grid.spacing)
    origin = tuple(o - s * (n - 1) / (2 * n) for o, s in zip(grid.origin, grid.spacing, strict=True))
    return Grid(shape, spacing, origin)  # type: ignore[arg-type]
