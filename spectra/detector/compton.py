"""Compton scattering in a sensor: the energy that the electron keeps, and the photon that goes on.

Photons scatter at electrons at rest (Klein & Nishina), less often forward where these are bound (incoherent scattering
function). The electron's energy is a charge cloud where the photon scattered. The scattered photon leaves the sensor, a
slab without sides, or interacts once more, far enough for another pixel.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expn

from spectra.detector.semiconductor import depths
from spectra.elements.attenuation import Composition, scattering_functions
from spectra.elements.constants import ELECTRON_REST_ENERGY, PLANCK_LIGHT

# Gauss nodes over the angle, and over the depth of the sensor.
_ANGLES, _DEPTHS = 64, 16

PerAngle = Float[np.ndarray, "energy angle"]


class Scattering(NamedTuple):
    """Angles into which photons scatter.

    Parameters
    ----------
    cosine : of the angle between the photon before and after
    energy : of the photon after it [keV]
    weight : probability of the angle; the sum over angles is 1
    """

    cosine: Float[np.ndarray, " angle"]
    energy: PerAngle
    weight: PerAngle


def scattering(composition: Composition, energy: Float[np.ndarray, " energy"]) -> Scattering:
    """Compute the distribution of the angle.

    Parameters
    ----------
    composition : of the sensor
    energy : of the photons [keV]

    Returns
    -------
    angles with their probabilities
    """
    cosine, weight = np.polynomial.legendre.leggauss(_ANGLES)
    ratio = 1 / (1 + energy[:, None] / ELECTRON_REST_ENERGY * (1 - cosine))
    transfer = energy[:, None] / PLANCK_LIGHT * np.sqrt((1 - cosine) / 2)
    bound = scattering_functions(composition, transfer.ravel())[0].reshape(transfer.shape)
    density = weight * bound * ratio**2 * (ratio + 1 / ratio - 1 + cosine**2)
    return Scattering(cosine, energy[:, None] * ratio, density / density.sum(axis=1, keepdims=True))


def interacts_again(
    mu: Float[np.ndarray, " energy"], mu_after: PerAngle, thickness: float, cosine: Float[np.ndarray, " angle"]
) -> PerAngle:
    """Compute the probability that a scattered photon interacts once more.

    Parameters
    ----------
    mu : attenuation of the photons [1/mm], which determines how deep they scatter
    mu_after : attenuation of the scattered photons [1/mm]
    thickness : of the sensor [mm]
    cosine : of the angle of scattering

    Returns
    -------
    probability for each energy and angle
    """
    node, weight = np.polynomial.legendre.leggauss(_DEPTHS)
    depth = depths(mu[:, None, None], thickness, (1 + node) / 2)
    room = np.where(cosine[:, None] > 0, thickness - depth, depth) / np.abs(cosine[:, None])
    return -np.expm1(-mu_after[..., None] * room) @ weight / 2


def interacts_anywhere(mu: PerAngle, thickness: float) -> PerAngle:
    """Compute the probability that a photon interacts before it leaves the sensor, from any depth in any direction.

    Parameters
    ----------
    mu : attenuation of the photons [1/mm]
    thickness : of the sensor [mm]

    Returns
    -------
    probability, in the shape of `mu`

    Notes
    -----
    With E_n the exponential integrals, from depth z the part E_2(mu z) / 2 of isotropic photons leaves through one
    surface; the mean over all depths, of both surfaces, is (1 - 2 E_3(mu t)) / (2 mu t).
    """
    paths = mu * thickness
    return 1 - (1 - 2 * expn(3, paths)) / (2 * paths)
