"""Factorised Gaussians: one density and fractions of the bases that add up to 1 (eq. 1 and 2).

All parameters are free; what they mean follows from R2-Gaussian's activations: softplus for densities, a sigmoid
between bounds for standard deviations, and a softmax that puts fractions on the simplex.
"""

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians

LEAST_FRACTION = 1e-4
LEAST_DENSITY = 1e-6  # of a start, in `Units.density`


@dataclass(frozen=True)
class Units:
    """What R2-Gaussian's normalised scene means here.

    Parameters
    ----------
    length : half the grid's longest edge [mm]
    density : the density that counts as 1 [1/mm]
    narrowest, widest : bounds of standard deviations [mm]
    """

    length: float
    density: float
    narrowest: float
    widest: float

    @classmethod
    def of(cls, grid: Grid, density: float, narrowest: float, widest: float) -> "Units":
        """Units of a grid; bounds come as parts of its longest edge."""
        edge = max(n * spacing for n, spacing in zip(grid.shape, grid.spacing, strict=True))
        return cls(edge / 2, density, narrowest * edge, widest * edge)

    @property
    def line_integral(self) -> float:
        """The line integral that counts as 1 [no unit]."""
        return self.length * self.density


@dataclass
class FactorisedGaussians:
    """Free parameters; every one has a row per Gaussian.

    Parameters
    ----------
    centres : (x, y, z) [mm]
    densities : inverse softplus of the density over `Units.density`
    scales : inverse of the bounded sigmoid of the standard deviations
    quaternions : orientation (w, x, y, z)
    fractions : logits of the material fractions
    """

    centres: Float[Tensor, "gaussian 3"]
    densities: Float[Tensor, "gaussian 1"]
    scales: Float[Tensor, "gaussian 3"]
    quaternions: Float[Tensor, "gaussian 4"]
    fractions: Float[Tensor, "gaussian basis"]

    def __len__(self) -> int:
        return len(self.centres)

    @classmethod
    def of(
        cls,
        centres: Float[np.ndarray, "gaussian 3"],
        density: Float[np.ndarray, " gaussian"],
        sigma: Float[np.ndarray, "gaussian 3"],
        fractions: Float[np.ndarray, "gaussian basis"],
        units: Units,
    ) -> "FactorisedGaussians":
        """Upright Gaussians of given densities [1/mm], standard deviations [mm] and fractions."""
        upright = torch.zeros(len(centres), 4)
        upright[:, 0] = 1
        relative = torch.from_numpy(np.maximum(density / units.density, LEAST_DENSITY))
        return cls(
            torch.from_numpy(centres).float(),
            inverse_softplus(relative[:, None]).float(),
            inverse_bounded(torch.from_numpy(sigma), units).float(),
            upright,
            torch.from_numpy(np.log(np.maximum(fractions, LEAST_FRACTION))).float(),
        )

    def tensors(self) -> dict[str, Tensor]:
        """Parameters by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def density(self) -> Float[Tensor, "gaussian 1"]:
        """Density rho over `Units.density`."""
        return torch.nn.functional.softplus(self.densities)

    def sigma(self, units: Units) -> Float[Tensor, "gaussian 3"]:
        """Standard deviations [mm]."""
        return units.narrowest + (units.widest - units.narrowest) * torch.sigmoid(self.scales)

    def log_scales(self, units: Units) -> Float[Tensor, "gaussian 3"]:
        """Logarithm of the standard deviations [log mm]."""
        return torch.log(self.sigma(units))

    def material_fractions(self) -> Float[Tensor, "gaussian basis"]:
        """Fractions f >= 0 that add up to 1."""
        return torch.softmax(self.fractions, dim=1)

    def coefficients(self, units: Units) -> Float[Tensor, "gaussian basis"]:
        """Coefficients b = rho f, in the basis that the fit uses [1/mm]."""
        return units.density * self.density() * self.material_fractions()

    @torch.no_grad()
    def gaussians(self, units: Units, to_raw: Float[Tensor, "basis raw"], names: tuple[str, ...]) -> Gaussians:
        """The project's Gaussians: coefficients in a raw basis, b_raw = b to_raw; they may be negative there."""
        raw = self.coefficients(units) @ to_raw.float()
        return Gaussians(self.centres.clone(), self.log_scales(units), self.quaternions.clone(), raw, names)


def inverse_softplus(value: Tensor) -> Tensor:
    """The x with log(1 + exp(x)) = value > 0."""
    return value + torch.log(-torch.expm1(-value))


def inverse_bounded(sigma: Tensor, units: Units) -> Tensor:
    """Free parameters of standard deviations [mm]; those at a bound are moved off it by a millionth of the range."""
    return torch.logit((sigma - units.narrowest) / (units.widest - units.narrowest), eps=1e-6)
