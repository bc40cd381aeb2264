"""The model with interfaces: Gaussians in space, each divided by a plane with other coefficients on either side."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.interface.rasterize import rasterize_divided
from recon.ops.interface.voxelize import voxelize_divided
from recon.ops.rasterize.projector import Projector

CUTOFF = 4.0  # standard deviations; where Gaussians end on the panel; some forty overlap, and each leaves 3e-4 outside
PLAIN = 4.0  # standard deviations from the centre; a plane further away does not divide a Gaussian


@dataclass(frozen=True, eq=False)
class DividedGaussians:
    """A sum of Gaussians, each divided by a plane, that describes the attenuation of a volume.

    Parameters
    ----------
    centres : positions p_i, (N, 3) in the order x, y, z [mm]
    log_scales : logarithms of the standard deviations along the principal axes, (N, 3) [log mm]
    quaternions : orientations R_i, (N, 4) in the order w, x, y, z; their length does not matter [no unit]
    offsets : distance of the plane from the centre along the third axis n_i, (N,) [mm]
    coefficients : values at the centre per side of the plane (against n_i, along n_i) and basis, (N, 2, M) [1/mm]
    basis_names : names of the M basis functions B_m
    width : standard deviation of the transition from one side to the other, the same for all [mm]

    Notes
    -----
    The attenuation is ``mu(x, E) = sum_m B_m(E) sum_i g_i(x) (b_i1m + (b_i2m - b_i1m) Phi(q_i(x) / width))`` with the
    Gaussian g_i of height 1, the normal distribution function Phi and ``q_i = n_i . (x - p_i) - offset_i``.
    """

    centres: Float[Tensor, "gaussian 3"]
    log_scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    offsets: Float[Tensor, " gaussian"]
    coefficients: Float[Tensor, "gaussian side basis"]
    basis_names: tuple[str, ...]
    width: float

    GEOMETRY: ClassVar = ("centres", "log_scales", "quaternions", "offsets")

    def __len__(self) -> int:
        return len(self.centres)

    def __repr__(self) -> str:
        return f"DividedGaussians({len(self)}, of which {int(self.divided.sum())} divided, with {', '.join(self.basis_names)})"

    @property
    def divided(self) -> Tensor:
        """Which Gaussians have their plane within `PLAIN` standard deviations, (N,)."""
        return self.offsets.detach().abs() < PLAIN * torch.exp(self.log_scales.detach()[:, 2])

    @property
    def numbers(self) -> int:
        """Count the numbers that describe the model: 10 + M for a plain Gaussian, 11 + 2 M for a divided one."""
        bases, divided = self.coefficients.shape[2], int(self.divided.sum())
        return len(self) * (10 + bases) + divided * (1 + bases)

    def _parts(self) -> tuple[Tensor, ...]:
        thickness = torch.exp(self.log_scales[:, 2])
        planes = torch.stack([self.offsets / thickness, self.width / thickness], 1)
        return self.centres, self.log_scales, self.quaternions, planes, self.coefficients[:, 0], self.coefficients[:, 1]

    def voxels(self, grid: Grid, cutoff: float = 4.0) -> Float[Tensor, "basis z y x"]:
        return voxelize_divided(*self._parts(), grid, cutoff).float()

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        with torch.no_grad():
            found = voxelize_divided(*self._parts(), _halved(grid), 4.2).numpy()
        bases, depth, height, width = found.shape
        return found.reshape(bases, depth // 2, 2, height // 2, 2, width // 2, 2).mean(axis=(2, 4, 6))

    def line_integrals(self, geometry: Geometry) -> Float[Tensor, "view basis row column"]:
        frames = torch.from_numpy(geometry.ray_frames())
        panel = (geometry.panel.rows, geometry.panel.columns)
        return rasterize_divided(*self._parts(), frames, panel, Projector(cutoff=CUTOFF)).float()

    def with_values(self, values: Tensor) -> "DividedGaussians":
        held = {name: getattr(self, name).detach() for name in self.GEOMETRY}
        return replace(self, **held, coefficients=values)

    def part(self, which: Int64[Tensor, " some"]) -> "DividedGaussians":
        return replace(self, **{name: value.index_select(0, which) for name, value in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        return {name: getattr(self, name) for name in (*self.GEOMETRY, "coefficients")}

    def detached(self) -> "DividedGaussians":
        return replace(self, **{name: value.detach().clone() for name, value in self.tensors().items()})

    def to(self, device: torch.device | str) -> "DividedGaussians":
        return replace(self, **{name: value.to(device) for name, value in self.tensors().items()})


def _halved(grid: Grid) -> Grid:
    """Halve the edges of a grid's voxels."""
    return Grid(
        tuple(2 * n for n in grid.shape),  # type: ignore[arg-type]
        tuple(s / 2 for s in grid.spacing),  # type: ignore[arg-type]
        tuple(o - s / 4 for o, s in zip(grid.origin, grid.spacing, strict=True)),  # type: ignore[arg-type]
    )
