"""Factorised Gaussians: one density, and fractions of the bases that add up to 1 (eq. 1 and 2).

All parameters are unconstrained. R2-Gaussian's activation functions turn them into physical values: softplus for
densities, a sigmoid between bounds for standard deviations. A softmax gives fractions that add up to 1.
"""

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians

LEAST_FRACTION = 1e-4  # no unit; least first fraction, as the logarithm is taken; our choice
LEAST_DENSITY = 1e-6  # in `Units.density`; least first density, as softplus is positive; our choice


@dataclass(frozen=True)
class Units:
    """Scales between mm and 1/mm and the normalised scene of R2-Gaussian.

    Parameters
    ----------
    length : half the longest edge of the grid [mm]
    density : density that is 1 in the normalised scene [1/mm]
    narrowest, widest : bounds of standard deviations [mm]
    """

    length: float
    density: float
    narrowest: float
    widest: float

    @classmethod
    def of(cls, grid: Grid, density: float, narrowest: float, widest: float) -> "Units":
        """Create the units of a grid.

        Parameters
        ----------
        grid : grid of the volume
        density : density that is 1 in the normalised scene [1/mm]
        narrowest, widest : bounds of standard deviations over the longest edge of the grid

        Returns
        -------
        units of the grid
        """
        edge = max(n * spacing for n, spacing in zip(grid.shape, grid.spacing, strict=True))
        return cls(edge / 2, density, narrowest * edge, widest * edge)

    @property
    def line_integral(self) -> float:
        """Line integral that is 1 in the normalised scene [no unit]."""
        return self.length * self.density


@dataclass
class FactorisedGaussians:
    """Unconstrained parameters of Gaussians; each array has one row per Gaussian.

    Parameters
    ----------
    centres : centres (x, y, z) [mm]
    densities : inverse softplus of the density over `Units.density`
    scales : inverse of the bounded sigmoid of the standard deviations
    quaternions : orientation (w, x, y, z)
    fractions : logits of the fractions of the bases
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
        """Create Gaussians whose principal axes are parallel to x, y and z.

        Parameters
        ----------
        centres : centres (x, y, z) [mm]
        density : density at the centre [1/mm]
        sigma : standard deviations along x, y and z [mm]
        fractions : fractions of the bases, which add up to 1
        units : units of the scene

        Returns
        -------
        Gaussians, with densities of at least `LEAST_DENSITY` and fractions of at least `LEAST_FRACTION`
        """
        unrotated = torch.zeros(len(centres), 4)
        unrotated[:, 0] = 1
        relative = torch.from_numpy(np.maximum(density / units.density, LEAST_DENSITY))
        return cls(
            torch.from_numpy(centres).float(),
            inverse_softplus(relative[:, None]).float(),
            inverse_bounded(torch.from_numpy(sigma), units).float(),
            unrotated,
            torch.from_numpy(np.log(np.maximum(fractions, LEAST_FRACTION))).float(),
        )

    def tensors(self) -> dict[str, Tensor]:
        """Return the parameters by name.

        Returns
        -------
        tensors, not copies, in the order of the fields
        """
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def density(self) -> Float[Tensor, "gaussian 1"]:
        """Compute the density rho of each Gaussian.

        Returns
        -------
        density over `Units.density`, differentiable
        """
        return torch.nn.functional.softplus(self.densities)

    def sigma(self, units: Units) -> Float[Tensor, "gaussian 3"]:
        """Compute the standard deviations of each Gaussian.

        Parameters
        ----------
        units : units of the scene

        Returns
        -------
        standard deviations along the principal axes [mm], differentiable
        """
        return units.narrowest + (units.widest - units.narrowest) * torch.sigmoid(self.scales)

    def log_scales(self, units: Units) -> Float[Tensor, "gaussian 3"]:
        """Compute the logarithm of the standard deviations.

        Parameters
        ----------
        units : units of the scene

        Returns
        -------
        logarithm of the standard deviations along the principal axes [log mm], differentiable
        """
        return torch.log(self.sigma(units))

    def material_fractions(self) -> Float[Tensor, "gaussian basis"]:
        """Compute the fractions f of the bases (eq. 2).

        Returns
        -------
        fractions, not negative; they add up to 1 for each Gaussian
        """
        return torch.softmax(self.fractions, dim=1)

    def coefficients(self, units: Units) -> Float[Tensor, "gaussian basis"]:
        """Compute the coefficients b = rho f in the basis of the fit.

        Parameters
        ----------
        units : units of the scene

        Returns
        -------
        coefficients [1/mm], differentiable
        """
        return units.density * self.density() * self.material_fractions()

    @torch.no_grad()
    def gaussians(self, units: Units, to_raw: Float[Tensor, "basis raw"], names: tuple[str, ...]) -> Gaussians:
        """Convert the model to this project's Gaussians, with coefficients in a raw basis.

        Parameters
        ----------
        units : units of the scene
        to_raw : matrix T of b_raw = b T
        names : names of the raw basis functions

        Returns
        -------
        Gaussians without gradients; their raw coefficients may be negative
        """
        raw = self.coefficients(units) @ to_raw.float()
        return Gaussians(self.centres.clone(), self.log_scales(units), self.quaternions.clone(), raw, names)


def inverse_softplus(value: Tensor) -> Tensor:
    """Compute the x for which log(1 + exp(x)) is a value.

    Parameters
    ----------
    value : positive values

    Returns
    -------
    x, of the shape of `value`
    """
    return value + torch.log(-torch.expm1(-value))


def inverse_bounded(sigma: Tensor, units: Units) -> Tensor:
    """Compute the unconstrained parameters of standard deviations.

    Parameters
    ----------
    sigma : standard deviations [mm]
    units : units of the scene, which give the bounds

    Returns
    -------
    parameters; a standard deviation at a bound is moved inside by a millionth of the range
    """
    return torch.logit((sigma - units.narrowest) / (units.widest - units.narrowest), eps=1e-6)
