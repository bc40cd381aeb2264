"""Rays that take part neither in the start nor in the fit, and what they say of the models.

A fit may end further from the object than the volumes that it started from, and the rays that both followed cannot
tell. So blocks of pixels of some views are set apart, one ray of 64 in all, before anything is reconstructed: their
shares of the deviance are 0 (`recon.data.measurements.Measurements.apart`). Afterwards every model predicts them, with
the same correction for partial volume and the same model error as in the fit.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import kinds_of, spread
from recon.gaussians.likelihood import deviances
from recon.gaussians.model import Gaussians
from recon.gaussians.recipe import Recipe
from recon.voxel.model import Voxels

VIEWS = 8  # at most, evenly spread, that have rays set apart
PART = 1 / 64  # of all rays
BLOCK = 4.0  # voxels across a block, as seen at the isocentre; no binning of the start or the fit goes beyond
CERTAIN = 1.5  # standard errors of a difference, over views, from which on it counts


def with_rays_apart(measured: Measurements, voxel: float, seed: int) -> Measurements:
    """The same scan with some rays set apart.

    Parameters
    ----------
    measured : training views, unbinned
    voxel : edge of a voxel of the reconstruction grid [mm]
    seed : of the places of the blocks
    """
    panel, block = measured.geometry.panel, matching_bin(measured.geometry, BLOCK * voxel)
    apart = np.zeros((len(measured), panel.rows // block, panel.columns // block), bool)
    views = spread(kinds_of(measured.exposure), VIEWS)
    each = round(PART * apart.size / len(views))
    rng = np.random.default_rng(seed)
    for view in views:
        apart[view].flat[rng.choice(apart[view].size, min(max(each, 1), apart[view].size - 1), replace=False)] = True
    return replace(measured, apart=apart)


@dataclass(frozen=True, eq=False)
class UnseenRays:
    """The rays that were set apart, in pixels of the size of voxels, which is all that voxels can predict.

    Parameters
    ----------
    data : views with some; all other rays have no share
    dispersion : relative model error added to the Poisson variance
    """

    data: Measurements
    dispersion: float

    @classmethod
    def of(cls, measured: Measurements, voxel: float, recipe: Recipe) -> "UnseenRays":
        """Those that `with_rays_apart` set apart."""
        assert measured.apart is not None
        views = np.flatnonzero(measured.apart.any(axis=(1, 2)))
        some = replace(measured[views], apart=~measured.apart[views])
        some = some.binned(matching_bin(some.geometry, voxel))
        return cls(some.weighted(recipe.dispersion), recipe.dispersion)

    def better_of(self, begun: Gaussians, fitted: Gaussians, start: Voxels) -> tuple[Gaussians, tuple[str, ...]]:
        """The fitted model, or the one it began with where that is more likely; and what a user should know.

        Parameters
        ----------
        begun, fitted : the model before and after the fit
        start : the volumes that both follow
        """
        before, after, told = (deviances(model, self.data, self.dispersion) for model in (begun, fitted, start))
        notes = []
        if worse := certainly_larger(after, before):
            notes.append(
                "the fit made Gaussians less likely on rays that took no part (deviance "
                f"{after.sum() / before.sum():.3g} times that before the fit): those from before the fit are kept"
            )
        kept = before if worse else after
        if certainly_larger(kept, told):
            notes.append(
                "the Gaussians are less likely on rays that took no part than the voxels they started from (deviance "
                f"{kept.sum() / told.sum():.3g} times theirs): rather use those voxels, which are in volumes.h5, or "
                "fit on smaller voxels"
            )
        return begun if worse else fitted, tuple(notes)


def certainly_larger(one: Float[np.ndarray, " view"], other: Float[np.ndarray, " view"]) -> bool:
    """Whether deviances exceed others by more than chance would let them; not told by one view alone."""
    difference = one - other
    if len(difference) < 2:
        return False
    return bool(float(difference.mean()) > CERTAIN * float(difference.std(ddof=1)) / np.sqrt(len(difference)))
