"""Content of a viewer of a run, as numbers."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from phantomgen.dataset.truth import Truth
from phantomgen.display.viewer.content import Triple, limits, round_scale, usual_top
from phantomgen.geometry.voxel_grid import Grid
from recon.evaluation.metrics import psnr
from recon.gaussians.model import GaussianModel
from spectra.errors import InputError

SHOWN_FROM = 0.02  # part of the end of a colour bar; smaller values are taken for empty; our choice
_FEW_VOXELS = 99.5  # percentile; end of the colour bar of a difference, or of a result without truth; our choice


@dataclass(frozen=True, eq=False)
class RunContent:
    """Content that is shown of a run.

    Parameters
    ----------
    name : name of the run
    grid : grid of all volumes
    basis_names : names of the bases of the run and of the truth
    result : coefficients; zeros for a basis that the run lacks [1/mm]
    truth : truth of the scan; None where it is not known
    true : coefficients of the truth, in the order of `basis_names` [1/mm]
    gaussians : model; None where the method has none
    at : positions of the planes x, y and z [mm]
    """

    name: str
    grid: Grid
    basis_names: tuple[str, ...]
    result: Float[np.ndarray, "basis z y x"]
    truth: Truth | None
    true: Float[np.ndarray, "basis z y x"] | None
    gaussians: GaussianModel | None
    at: Triple

    def __post_init__(self) -> None:
        for axis, position, low, high in zip("xyz", self.at, *limits(self.grid), strict=True):
            if not low <= position <= high:
                raise InputError(
                    f"the plane {axis} = {position:g} mm lies outside the volume, from {low:g} to {high:g} mm"
                )

    @classmethod
    def of(
        cls,
        name: str,
        grid: Grid,
        basis_names: tuple[str, ...],
        result: Float[np.ndarray, "basis z y x"],
        truth: Truth | None,
        gaussians: GaussianModel | None,
        at: Triple | None = None,
    ) -> "RunContent":
        """Create the content with the bases of the run and of the truth, and zeros where either lacks one.

        Parameters
        ----------
        name : name of the run
        grid : grid of all volumes
        basis_names : names of the bases of the run
        result : coefficients of the run [1/mm]
        truth : truth of the scan; None where it is not known
        gaussians : model; None where the method has none
        at : positions of the planes x, y and z [mm]; the centre of the grid where it is None

        Returns
        -------
        content
        """
        names, true = basis_names, None
        if truth is not None:
            names = truth.basis_names + tuple(name for name in basis_names if name not in truth.basis_names)
            true = _in_order(names, truth.basis_names, truth.volumes)
        low, high = limits(grid)
        x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
        return cls(name, grid, names, _in_order(names, basis_names, result), truth, true, gaussians, at or (x, y, z))

    def __repr__(self) -> str:
        return f"RunContent({self.name}: {', '.join(self.basis_names)}, {self.truth!r}, {self.gaussians!r})"

    def scale(self, basis: int) -> tuple[float, int]:
        """Compute the colour bar of truth and result.

        Parameters
        ----------
        basis : number of the basis

        Returns
        -------
        end of the colour bar [1/mm], and its number of ticks. It reaches the largest usual value of the truth, or all
        but a few voxels of the result, which may overshoot at edges
        """
        top = 0.0 if self.true is None else usual_top(self.true[basis])
        if top == 0.0:
            values = self.result[basis]
            seen = values[values > SHOWN_FROM * values.max()]
            top = float(np.percentile(seen, _FEW_VOXELS)) if seen.size else 0.0
        return round_scale(top)

    def difference(self, basis: int) -> Float[np.ndarray, "z y x"]:
        """Compute result minus truth.

        Parameters
        ----------
        basis : number of the basis

        Returns
        -------
        differences [1/mm]

        Raises
        ------
        InputError
            When there is no truth.
        """
        if self.true is None:
            raise InputError(f"{self.name} has no truth to compare with")
        return self.result[basis] - self.true[basis]

    @cached_property
    def filled(self) -> Bool[np.ndarray, "z y x"]:
        """True for voxels that are not empty in any basis of the truth or of the result."""
        found = np.zeros(self.grid.shape, bool)
        for basis in range(len(self.basis_names)):
            least = SHOWN_FROM * self.scale(basis)[0]
            found |= np.abs(self.result[basis]) > least
            if self.true is not None:
                found |= self.true[basis] > least
        return found

    def difference_scale(self, basis: int) -> float:
        """Compute the end of the colour bar of a difference.

        Parameters
        ----------
        basis : number of the basis

        Returns
        -------
        end of the colour bar [1/mm], above all but a few differences
        """
        errors = np.abs(self.difference(basis)[self.filled])
        usual = float(np.percentile(errors, _FEW_VOXELS)) if errors.size else 0.0
        return round_scale(usual)[0]

    def errors(self, basis: int) -> str:
        """Describe the size of the differences.

        Parameters
        ----------
        basis : number of the basis

        Returns
        -------
        PSNR and root mean square as text
        """
        square = float(np.mean(self.difference(basis).astype(np.float64) ** 2))
        found = psnr(float(self.true[basis].max()), square) if self.true is not None else None
        said = f"rms {np.sqrt(square):.2g} 1/mm"
        return said if found is None else f"PSNR {found:.1f} dB, {said}"


def _in_order(
    names: tuple[str, ...], own: tuple[str, ...], volumes: Float[np.ndarray, "basis z y x"]
) -> Float[np.ndarray, "shown_basis z y x"]:
    """Volumes by names, zeros for those that are missing."""
    if names == own:
        return volumes
    out = np.zeros((len(names), *volumes.shape[1:]), np.float32)
    for name, volume in zip(own, volumes, strict=True):
        out[names.index(name)] = volume
    return out
