"""Voxels whose bases the counts do not determine: metal, and photon starvation. The truth is not used.

No combination of basis functions attenuates as metal does, and K edges are held at 0 in it (`recon.data.volume_edges`).
Where rays are starved of photons, the channels cannot separate the bases; how well they can follows from the Fisher
information of the rays through a voxel. Marked voxels keep their values; scores are given over all voxels, and over the
others alone.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import label

from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, matching_bin
from recon.data.view_subsets import evenly_spread_views, view_groups
from recon.data.volume_edges import over_metal, relative_density
from recon.ops.likelihood import MeasuredCounts, likelihood
from recon.ops.nonnegative_newton import as_matrices
from recon.voxel.iterative.likelihood import forward, transpose
from spectra.cramer_rao import least_deviations

METAL, STARVED = 1, 2  # flags of a voxel
# no unit; standard deviation of a basis over the typical one, from which on a voxel is starved; it marks none in
# kedge-small and some 3200 voxels of the implant in development_implant.yaml, as measured when it was chosen
STARVED_DEVIATION = 5.0
# no unit, over the typical density; denser voxels belong to the object; chosen by hand, not measured
OBJECT_DENSITY = 0.1
# views, evenly spread, whose information is computed, as that of the others is similar; chosen by hand, not measured
MOST_VIEWS = 16
SLAB_VALUES = 1 << 26  # float32 numbers of a slab of voxels in memory at once: 256 MiB


@dataclass(frozen=True, eq=False)
class Unreliable:
    """Marked voxels.

    Parameters
    ----------
    flags : sum of `METAL` and `STARVED` in every marked voxel, 0 elsewhere
    grid : grid of the flags
    object_voxels : number of voxels of the object
    """

    flags: UInt8[np.ndarray, "z y x"]
    grid: Grid
    object_voxels: int

    @property
    def marked(self) -> Bool[np.ndarray, "z y x"]:
        """Mask of the marked voxels."""
        return self.flags > 0

    def record(self) -> dict[str, Any]:
        """Summarise number, place and reason of the marked voxels, for ``metrics.json``.

        Returns
        -------
        the values that `docs/reference/file_format.md` lists under ``unreliable``
        """
        pieces, places = label(self.marked)  # type: ignore[misc]
        largest = pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:])
        axes = [self.grid.axis(name) for name in "zyx"]
        ends = [
            axis[np.flatnonzero(largest.any(axis=other))[[0, -1]]] for axis, other in zip(axes, _OTHERS, strict=True)
        ]
        return {
            "voxels": int(self.marked.sum()),
            "part": float(self.marked.sum() / max(self.object_voxels, 1)),
            "metal": int(((self.flags & METAL) > 0).sum()),
            "starved": int(((self.flags & STARVED) > 0).sum()),
            "places": int(places),
            "largest_mm": {name: [float(v) for v in end] for name, end in zip("zyx", ends, strict=True)},
        }


_OTHERS = ((1, 2), (0, 2), (0, 1))


def unreliable_voxels(
    volumes: Float[np.ndarray, "basis z y x"], measured: Measurements, grid: Grid, dispersion: float
) -> Unreliable | None:
    """Mark the voxels of a result whose bases the counts do not determine.

    Parameters
    ----------
    volumes : the result [1/mm]
    measured : the views that were fitted
    grid : grid of `volumes`
    dispersion : relative model error added to the Poisson variance [no unit]

    Returns
    -------
    the marked voxels; None where there are none
    """
    values = np.maximum(volumes, 0)
    edges = np.array([name.startswith("kedge") for name in measured.basis_names])
    if not values.any():
        return None
    object_voxels = relative_density(values) > OBJECT_DENSITY
    metal = np.zeros(object_voxels.shape, bool) if edges.all() else over_metal(values[~edges]) > 1
    starved = object_voxels & (
        relative_deviations(volumes, object_voxels, measured, grid, dispersion) > STARVED_DEVIATION
    )
    flags = (METAL * metal + STARVED * starved).astype(np.uint8)
    return Unreliable(flags, grid, int(np.count_nonzero(object_voxels))) if flags.any() else None


def relative_deviations(
    volumes: Float[np.ndarray, "basis z y x"],
    object_voxels: Bool[np.ndarray, "z y x"],
    measured: Measurements,
    grid: Grid,
    dispersion: float,
) -> Float[np.ndarray, "z y x"]:
    """Predict the standard deviation of the least certain basis in each voxel, relative to the typical one.

    With a_ri the length of ray r in voxel i and F_r the Fisher matrix of its line integrals, the information of a voxel
    is taken as sum_r a_ri F_r times a length that is the same for all voxels: correlations between bases count, those
    between voxels do not. The typical deviation of a basis is the median over those of `object_voxels` whose bases are
    determined at all.

    Parameters
    ----------
    volumes : the result [1/mm]
    object_voxels : voxels to predict
    measured : the views that were fitted
    grid : grid of `volumes`
    dispersion : relative model error added to the Poisson variance [no unit]

    Returns
    -------
    largest relative standard deviation over the bases [no unit], 0 outside of `object_voxels`
    """
    some = measured[evenly_spread_views(view_groups(measured.exposure), MOST_VIEWS)]
    some = some.binned(matching_bin(some.geometry, min(grid.spacing)))
    lengths = forward(volumes.astype(np.float32), some.geometry, grid)
    counts = MeasuredCounts(some.counts, some.gains, some.exposure, some.profile)
    fisher = likelihood(lengths, counts, some.transmission, dispersion, information=True).curvatures
    assert fisher is not None
    found = np.zeros((len(volumes), *grid.shape), np.float32)
    slab = max(1, SLAB_VALUES // (len(volumes) ** 2 * grid.shape[1] * grid.shape[2]))
    for first in range(0, grid.shape[0], slab):
        part, inside = grid.slices(first, slab), object_voxels[first : first + slab]
        blocks = transpose(fisher, some.geometry, part)[:, inside]
        found[:, first : first + slab][:, inside] = np.moveaxis(least_deviations(as_matrices(blocks)), -1, 0)
    values = found[:, object_voxels]
    known = np.isfinite(values).all(axis=0)
    if not known.any():
        return np.zeros(grid.shape, np.float32)
    return (found / np.median(values[:, known], axis=1)[:, None, None, None]).max(axis=0)


def sentence(found: dict[str, Any]) -> str:
    """Say number, place and reason of the marked voxels in a sentence for a user.

    Parameters
    ----------
    found : what `Unreliable.record` gives

    Returns
    -------
    the sentence
    """
    where = ", ".join("{} {:.1f} to {:.1f}".format(name, *ends) for name, ends in found["largest_mm"].items())
    place = "at" if found["places"] == 1 else f"in {found['places']} places, the largest at"
    why = []
    if found["metal"]:
        why.append("they hold metal or lie beside it, which no mixture of the bases describes")
    if found["starved"]:
        why.append(
            f"hardly any photon came through {found['starved']} of them" if why else "hardly any photon came through"
        )
    count = "1 voxel" if found["voxels"] == 1 else f"{found['voxels']} voxels"
    return (
        f"The counts do not determine the bases in {count} ({100 * found['part']:.2g} % of what the object fills) "
        f"{place} {where} mm: {', and '.join(why)}; do not read values there. "
        "Scores against a truth are given over all voxels, and without these as 'elsewhere'."
    )
