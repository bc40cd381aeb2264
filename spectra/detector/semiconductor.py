"""What happens to a photon in a pixelated semiconductor: fluorescence that moves energy, and charge that is shared.

Everything is averaged over photons that fall uniformly on the sensor. Counts in all pixels of photons on one pixel are
then counts in one pixel of photons on all, so a pixel's response includes what its neighbours send.

A Gaussian charge cloud at a place (x, y) gives a square pixel around the origin the fraction F(x) F(y), with F a
difference of two normal distribution functions.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expn, ndtr

# Gauss nodes over the depth of the sensor.
_DEPTHS = 16
# Fractions of a cloud that are tabulated; places across a pixel, for the inverse and for sums; reach of a cloud
# [standard deviation], beyond which 1e-9 of a Gaussian lies.
_FRACTIONS, _FINE, _COARSE, _CLOUD_REACH = 2000, 4001, 1000, 6.0
# 2^13 events leave 0.15 % rms in the counts per photon above a threshold, at most 0.5 %.
_EVENTS = 8192

Array = Float[np.ndarray, "..."]


class Events(NamedTuple):
    """Photons whose K fluorescence is absorbed in the sensor, as seen by one pixel.

    Parameters
    ----------
    weights : events per fluorescence photon that each entry stands for
    photon_fraction : fraction of the primary photon's own charge that the pixel collects
    fluorescence_fraction : fraction of the fluorescence photon's charge that the pixel collects
    """

    weights: Float[np.ndarray, " event"]
    photon_fraction: Float[np.ndarray, " event"]
    fluorescence_fraction: Float[np.ndarray, " event"]


def escape(mu: Float[np.ndarray, " energy"], mu_line: float, thickness: float) -> Float[np.ndarray, " energy"]:
    """Compute the probability that K fluorescence leaves the sensor.

    Parameters
    ----------
    mu : attenuation of the photons that excite it [1/mm], which determines how deep they are absorbed
    mu_line : attenuation of the fluorescence [1/mm]
    thickness : of the sensor [mm]

    Returns
    -------
    probability for each energy

    Notes
    -----
    From depth z the part E_2(mu z) / 2 of isotropic photons passes the surface, with E_2 the exponential integral.
    """
    node, weight = np.polynomial.legendre.leggauss(_DEPTHS)
    depth = depths(mu[:, None], thickness, (1 + node) / 2)
    return (expn(2, mu_line * depth) + expn(2, mu_line * (thickness - depth))) @ weight / 4


def collected(place: Array, pitch: float, cloud: float) -> Array:
    """Compute the fraction of a charge cloud that the pixel around 0 collects, along one axis.

    Parameters
    ----------
    place : centre of the cloud [mm]
    pitch : pixel width [mm]
    cloud : standard deviation of the cloud [mm]

    Returns
    -------
    fraction for each place
    """
    if cloud == 0:
        return (np.abs(place) < pitch / 2) * 1.0
    return ndtr((place + pitch / 2) / cloud) - ndtr((place - pitch / 2) / cloud)


def fluorescence_events(mu: float, mu_line: float, thickness: float, pitch: float, cloud: float) -> Events:
    """Compute a lattice of fluorescence events in which one pixel collects charge of the primary photon.

    A pixel may also collect the charge of the fluorescence photon, which is absorbed at another place.

    Parameters
    ----------
    mu, mu_line : attenuation of photon and fluorescence in the sensor [1/mm]
    thickness, pitch : of the sensor and of its square pixels [mm]
    cloud : standard deviation of a charge cloud [mm]

    Returns
    -------
    the events
    """
    share, azimuth, flight, x, y, cosine = lattice(_EVENTS, 6)
    inside, across = fluorescence_paths(mu, mu_line, thickness, share, flight, 2 * cosine - 1)
    azimuth = 2 * np.pi * azimuth
    window = pitch + 2 * _CLOUD_REACH * cloud
    x, y = (x - 0.5) * window, (y - 0.5) * window
    photon_fraction = collected(x, pitch, cloud) * collected(y, pitch, cloud)
    fluorescence_fraction = collected(x + across * np.cos(azimuth), pitch, cloud) * collected(
        y + across * np.sin(azimuth), pitch, cloud
    )
    return Events(inside * (window / pitch) ** 2 / _EVENTS, photon_fraction, fluorescence_fraction)


def fluorescence_paths(
    mu: float, mu_line: float, thickness: float, share: Array, flight: Array, cosine: Array
) -> tuple[Array, Array]:
    """Compute how far fluorescence goes across the sensor before it is absorbed there.

    Parameters
    ----------
    mu, mu_line : attenuation of photon and fluorescence in the sensor [1/mm]
    thickness : of the sensor [mm]
    share : part of the photons that are absorbed less deep, 0 to 1
    flight : part of the fluorescence that is absorbed sooner, 0 to 1
    cosine : of the angle between its direction and that of the photon

    Returns
    -------
    probability that it is absorbed in the sensor, and the distance across [mm]
    """
    depth = depths(mu, thickness, share)
    room = np.where(cosine > 0, thickness - depth, depth)
    inside = -np.expm1(-mu_line * room / np.abs(cosine))
    return inside, -np.log1p(-flight * inside) / mu_line * np.sqrt(1 - cosine**2)


@lru_cache(maxsize=16)
def charge_fractions(pitch: float, cloud: float) -> tuple[Float[np.ndarray, " part"], Float[np.ndarray, " part"]]:
    """Compute the fractions of a charge cloud that pixels collect, and the number of pixels for each, per cloud.

    Parameters
    ----------
    pitch : of square pixels [mm]
    cloud : standard deviation of the cloud [mm]

    Returns
    -------
    fractions and numbers of pixels; their product sums to 1, since no charge is lost (fractions below 1/2000 are left
    out, no threshold is that low)
    """
    if cloud == 0:
        return np.ones(1), np.ones(1)
    reach = pitch / 2 + _CLOUD_REACH * cloud
    fine, coarse = np.linspace(0, reach, _FINE), (np.arange(_COARSE) + 0.5) * (reach / _COARSE)
    edges = np.linspace(0, 1, _FRACTIONS + 1)
    # Where F(x) F(y) exceeds a fraction: for each y, up to which x; F descends.
    wanted, known = edges[:, None] / collected(coarse, pitch, cloud), collected(fine, pitch, cloud)
    reached = np.interp(wanted, known[::-1], fine[::-1], left=reach, right=0.0)
    more = 4 * reached.sum(axis=1) * (reach / _COARSE) / pitch**2
    return ((edges[1:] + edges[:-1]) / 2)[1:], -np.diff(more)[1:]


def depths(mu: Array | float, thickness: float, share: Array) -> Array:
    """Compute the depths above which a share of the photons that a sensor absorbs is absorbed.

    Parameters
    ----------
    mu : attenuation of the photons [1/mm]
    thickness : of the sensor [mm]
    share : part of the absorbed photons, 0 to 1

    Returns
    -------
    depths [mm]
    """
    return np.clip(-np.log1p(share * np.expm1(-mu * thickness)) / mu, 0.0, thickness)


@lru_cache(maxsize=2)
def lattice(count: int, dimensions: int) -> Float[np.ndarray, "dimension point"]:
    """Compute points that fill the unit cube evenly: a scrambled Sobol sequence.

    Parameters
    ----------
    count : number of points, a power of 2
    dimensions : of the cube

    Returns
    -------
    coordinates of the points, 0 to 1
    """
    from scipy.stats import qmc  # noqa: PLC0415 - half a second that few detectors need

    return np.ascontiguousarray(qmc.Sobol(dimensions, scramble=True, rng=0).random(count).T)
