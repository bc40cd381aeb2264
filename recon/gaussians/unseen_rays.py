"""Rays that are used neither by the start nor by the fit, and that decide which model is kept.

A fit may end further from the object than the volumes that it started from, and rays that both were fitted to cannot
show it. So blocks of pixels of some views are set apart, one ray of 64 in all, before anything is reconstructed: their
statistical weights are 0 (`recon.data.measurements.Measurements.unseen_blocks`). Afterwards every model predicts them,
with the same correction for partial volume and the same model error as in the fit.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import evenly_spread_views, view_groups
from recon.gaussians.likelihood import deviances
from recon.gaussians.model import GaussianModel
from recon.gaussians.residual.model import GaussiansWithResidual
from recon.gaussians.settings import UnseenRaysSettings
from recon.voxel.model import Voxels

DEFAULT = UnseenRaysSettings()


def with_unseen_rays(
    measured: Measurements, voxel: float, seed: int, settings: UnseenRaysSettings = DEFAULT
) -> Measurements:
    """Set some rays apart.

    Parameters
    ----------
    measured : training views, unbinned
    voxel : edge of a voxel of the reconstruction grid [mm]
    seed : seed of the positions of the blocks
    settings : how many rays, in how many views, in blocks of which size

    Returns
    -------
    the same scan with blocks of pixels marked in `Measurements.unseen_blocks`
    """
    panel, block = measured.geometry.panel, matching_bin(measured.geometry, settings.block * voxel)
    apart = np.zeros((len(measured), panel.rows // block, panel.columns // block), bool)
    views = evenly_spread_views(view_groups(measured.exposure), settings.views)
    each = round(settings.part * apart.size / len(views))
    rng = np.random.default_rng(seed)
    for view in views:
        apart[view].flat[rng.choice(apart[view].size, min(max(each, 1), apart[view].size - 1), replace=False)] = True
    return replace(measured, unseen_blocks=apart)


@dataclass(frozen=True, eq=False)
class UnseenRays:
    """The rays that were set apart, in pixels of the size of voxels: voxels cannot predict finer ones.

    Parameters
    ----------
    data : views with such rays; all other rays have the statistical weight 0
    dispersion : eta, relative model error [no unit]
    certain : difference of two models that counts [standard errors over views]
    part : these rays over all rays of the scan [no unit]
    """

    data: Measurements
    dispersion: float
    certain: float = DEFAULT.certain
    part: float = DEFAULT.part

    @classmethod
    def of(
        cls, measured: Measurements, voxel: float, dispersion: float, settings: UnseenRaysSettings = DEFAULT
    ) -> "UnseenRays":
        """Select the rays that `with_unseen_rays` set apart.

        Parameters
        ----------
        measured : training views, unbinned, with rays set apart
        voxel : edge of a voxel of the reconstruction grid [mm]
        dispersion : eta, relative model error [no unit]
        settings : when a difference counts

        Returns
        -------
        these rays
        """
        assert measured.unseen_blocks is not None
        views = np.flatnonzero(measured.unseen_blocks.any(axis=(1, 2)))
        some = replace(measured[views], unseen_blocks=~measured.unseen_blocks[views])
        some = some.binned(matching_bin(some.geometry, voxel))
        return cls(some.weighted(dispersion), dispersion, settings.certain, float(measured.unseen_blocks.mean()))

    def better_of(
        self, initial: GaussianModel, fitted: GaussianModel, start: Voxels
    ) -> tuple[GaussianModel, tuple[str, ...]]:
        """Choose the fitted model, or the one before the fit where that is more likely.

        Parameters
        ----------
        initial : the model before the fit
        fitted : the model after the fit
        start : the volumes that both were fitted to

        Returns
        -------
        one of the two models; sentences for the user
        """
        before, after, voxels = (deviances(model, self.data, self.dispersion) for model in (initial, fitted, start))
        notes = []
        if worse := certainly_larger(after, before, self.certain):
            notes.append(
                "the fit made Gaussians less likely on rays that took no part (deviance "
                f"{after.sum() / before.sum():.3g} times that before the fit): those from before the fit are kept"
            )
        kept = before if worse else after
        if certainly_larger(kept, voxels, self.certain):
            notes.append(
                "the Gaussians are less likely on rays that took no part than the voxels they started from (deviance "
                f"{kept.sum() / voxels.sum():.3g} times theirs): rather use those voxels, which are in volumes.h5, or "
                "fit on smaller voxels"
            )
        return initial if worse else fitted, tuple(notes)

    def with_or_without(
        self, residual: GaussiansWithResidual, gaussians: GaussianModel, worth: float
    ) -> tuple[GaussianModel, tuple[str, ...]]:
        """Choose Gaussians with a residual in voxels where that is certainly more likely and worth its numbers.

        Parameters
        ----------
        residual : the Gaussians with a residual
        gaussians : without it
        worth : least fall of the deviance of all rays, as estimated from these, per number that the residual takes

        Returns
        -------
        one of the two models; a sentence for the user
        """
        without, together = (deviances(model, self.data, self.dispersion) for model in (gaussians, residual))
        ratio = f"{together.sum() / without.sum():.3g} times"
        fall, numbers = (without.sum() - together.sum()) / self.part, residual.numbers - gaussians.numbers
        if fall < worth * numbers or not certainly_larger(without, together, self.certain):
            return gaussians, (
                f"a residual in voxels is left out: the deviance of rays that took no part is {ratio} that without it",
            )
        part = len(residual.places) / math.prod(residual.grid.shape)
        return residual, (
            f"a residual is kept in {part:.1%} of the voxels: the deviance of rays that took no part is {ratio} that "
            "without it",
        )


def certainly_larger(
    one: Float[np.ndarray, " view"], other: Float[np.ndarray, " view"], certain: float = DEFAULT.certain
) -> bool:
    """Tell whether deviances exceed others by more than chance explains.

    Parameters
    ----------
    one : deviances of the views by one model, (V,)
    other : those by another model, (V,)
    certain : difference that counts [standard errors over views]

    Returns
    -------
    True where the mean difference is larger, or the mean difference over the sum of both, which no single view
    dominates; also where one is not finite; False for a single view, whose standard error is not known
    """
    if not np.isfinite(one).all():
        return bool(np.isfinite(other).all())
    if len(one) < 2 or not one.sum() > other.sum():
        return False
    difference = one - other
    relative = difference / np.maximum(one + other, np.finfo(float).tiny)
    return any(d.mean() > certain * d.std(ddof=1) / np.sqrt(len(d)) for d in (difference, relative))
