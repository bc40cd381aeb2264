"""The formula in numpy."""

import numpy as np
from jaxtyping import Float

from phantomgen.ops.compton.inputs import NARROW, Energies, Points
from spectra.elements.constants import ELECTRON_REST_ENERGY


def scattered_to(
    pixel: Float[np.ndarray, " 3"],
    area: Float[np.ndarray, " 3"],
    source: Float[np.ndarray, " 3"],
    points: Points,
    lengths: Float[np.ndarray, "point material"],
    energies: Energies,
) -> Float[np.ndarray, " group"]:
    """Compute the signal that all points scatter to a pixel.

    Parameters
    ----------
    pixel, area, source, points, lengths, energies : as in `phantomgen.ops.compton.scattered_to`

    Returns
    -------
    signal of each group
    """
    table = energies.step * np.arange(len(energies.attenuation))
    inward, outward = points.place - source, pixel - points.place
    near, far = np.linalg.norm(inward, axis=1), np.linalg.norm(outward, axis=1)
    cosine = ((inward * outward).sum(axis=1) / (near * far))[:, None]
    energy = (energies.edges[:-1] + energies.edges[1:]) / 2
    k = 1 / (1 + energy / ELECTRON_REST_ENERGY * (1 - cosine))
    half = np.maximum(k * np.diff(energies.edges), NARROW) / 2
    nearest = energies.attenuation[np.rint(k * energy / energies.step).astype(int)]
    sent = points.photons * k**2 * (k + 1 / k - 1 + cosine**2) * np.exp(-np.einsum("pm,pbm->pb", lengths, nearest))
    sent *= (points.strength * np.abs(outward @ area) / (near**2 * far**3))[:, None]
    ends = k * energy - half, k * energy + half
    low, high = (np.stack([np.interp(end, table, column) for column in energies.measured.T]) for end in ends)
    return (sent * (high - low) / (2 * half)).sum(axis=(1, 2))
