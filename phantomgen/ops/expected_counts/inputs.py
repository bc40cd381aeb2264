"""Inputs and results of expected counts: energies of the beam, rules for pixels, and their checks."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64, UInt8

from spectra.errors import InputError

# Gauss nodes across and along a silhouette, for pixels of growing contrast; accuracy:
# `phantomgen.ops.expected_counts`.
RULES = ((2, 2), (3, 2), (4, 3), (6, 4), (9, 6))
# Most rays along each edge of a pixel: bounds the memory for the nodes of a pixel, see `make_room`.
MOST_SUB_RAYS = 16
# Error of log counts, no unit, that is left in pixels where surfaces intersect; true errors are about half as large
# (`benchmarks/simulator/intersection_pixels.py`).
INTERSECTION_TOLERANCE = 3e-4
# Where a voxel map projects to: rays per voxel along each side of a pixel, and most rays along it; errors and times in
# `benchmarks/simulator/voxel_views.py`.
RAYS_PER_VOXEL, MOST_RAYS = 4.0, 64
# Width of the band inside a tangent where one ray per pixel is too inexact [pixel]; so far from the end of a square
# root, its average over a pixel by second differences errs by 4e-6 of its value.
REACH = 5.0


class Spectrum(NamedTuple):
    """Energies of the beam, channel by channel.

    Parameters
    ----------
    attenuation : linear attenuation of each material at each spectral node [1/mm]
    weights : photons times response at each node
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``
    profile : path lengths of the rays to each pixel, objects aside, in the last materials of `attenuation`, the same
        for all rays to a pixel, as of a bowtie filter [mm]; None without one
    """

    attenuation: Float[np.ndarray, "material node"]
    weights: Float[np.ndarray, " node"]
    starts: Int64[np.ndarray, " boundary"]
    profile: Float[np.ndarray, "part row column"] | None = None

    @property
    def materials(self) -> int:
        """Number of materials."""
        return len(self.attenuation)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.starts) - 1

    def checked(self, rows: int, columns: int) -> "Spectrum":
        """Check the arrays, and convert them to the types of the kernels.

        Parameters
        ----------
        rows, columns : size of the panel

        Returns
        -------
        the spectrum

        Raises
        ------
        InputError
            When the arrays do not fit each other, or the profile does not fit the panel.
        """
        attenuation, weights = (np.ascontiguousarray(a, dtype=np.float64) for a in (self.attenuation, self.weights))
        starts, profile = np.ascontiguousarray(self.starts, dtype=np.int64), self.profile
        if attenuation.ndim != 2 or weights.shape != attenuation.shape[1:] or not 0 <= starts[-1] <= len(weights):
            raise InputError(
                f"attenuation {attenuation.shape}, weights {weights.shape} and channel starts {starts.tolist()} "
                "do not match"
            )
        if profile is not None:
            profile = np.ascontiguousarray(profile, dtype=np.float64)
            if profile.shape[1:] != (rows, columns) or not 0 < len(profile) < len(attenuation):
                raise InputError(
                    f"a profile of shape {profile.shape} does not fit {rows} x {columns} pixels and "
                    f"{len(attenuation)} materials"
                )
        return Spectrum(attenuation, weights, starts, profile)

    def open_beam(self, rows: int, columns: int) -> Float[np.ndarray, "channel rows columns"]:
        """Return the counts of a ray to each pixel that meets no object.

        Parameters
        ----------
        rows, columns : size of the panel

        Returns
        -------
        counts; with a profile, memory that the kernel writes
        """
        air = np.array([self.weights[a:b].sum() for a, b in pairwise(self.starts)])
        alike = np.broadcast_to(air[:, None, None], (len(air), rows, columns))
        return alike if self.profile is None else alike.copy()


class Sampling(NamedTuple):
    """Rules for the average over a pixel.

    Parameters
    ----------
    rules : Gauss nodes across and along a silhouette, per smooth part of a pixel, for growing contrast
    reach : width of the band inside a tangent where one ray per pixel is too inexact [pixel]
    sub_rays : if given, a plain grid of so many rays along each edge of a pixel, 1 to 16, in place of Gauss nodes along
        silhouettes; 1 means the ray through the centre of every pixel and nothing else
    intersection_tolerance : estimated error of log counts that is left where surfaces intersect, in the worst channel
    rays_per_voxel : where a voxel map projects to, rays along each edge of a pixel for each voxel that fits there; a
        pixel has at least as many along an edge, and at most `MOST_RAYS`
    aperture : width and height of the sensitive part of a pixel, which the average is taken over [pixel]
    """

    rules: tuple[tuple[int, int], ...] = RULES
    reach: float = REACH
    sub_rays: int | None = None
    intersection_tolerance: float = INTERSECTION_TOLERANCE
    rays_per_voxel: float = RAYS_PER_VOXEL
    aperture: tuple[float, float] = (1.0, 1.0)

    def check(self) -> None:
        """Refuse numbers of rays and tolerances that no rule can have.

        Raises
        ------
        InputError
            When there are.
        """
        if self.sub_rays is not None and not 1 <= self.sub_rays <= MOST_SUB_RAYS:
            raise InputError(f"sub-rays along the edge of a pixel must be 1 to {MOST_SUB_RAYS}, got {self.sub_rays}")
        if not self.intersection_tolerance > 0:
            raise InputError(
                f"the tolerance of pixels where surfaces intersect must be positive, "
                f"got {self.intersection_tolerance:g}"
            )


class ExpectedCounts(NamedTuple):
    """Expected counts of a view.

    Parameters
    ----------
    counts : averages over the pixels
    classes : class of each pixel (`phantomgen.ops.expected_counts.pixel_classes`)
    rays : number of rays that the pixels of each class took
    """

    counts: Float[np.ndarray, "channel row column"]
    classes: UInt8[np.ndarray, "row column"]
    rays: Int64[np.ndarray, " class"]
