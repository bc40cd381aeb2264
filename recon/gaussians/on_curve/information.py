"""The mean information of rays about the bases, where fewer channels than bases measure them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from recon.data.array_store import read_part
from recon.data.measurements import Measurements
from recon.gaussians.fisher import ray_information
from recon.ops.decompose import decompose
from spectra.materials.material_curve import MaterialCurve

# no unit; part of the diagonal that is added to it, as the rows of one channel's matrix are multiples of each other
LEAST = 1e-3


def mean_information(
    measured: Measurements, curve: MaterialCurve, dispersion: float
) -> Float[np.ndarray, "basis basis"]:
    """Compute the mean Fisher matrix of line integrals, each as if the ray had passed the curve's first material only.

    Parameters
    ----------
    measured : some views, at any binning
    curve : of the materials of the object
    dispersion : relative model error [no unit]

    Returns
    -------
    Fisher matrix of a ray, mean over all rays, with a little more on its diagonal
    """
    direction = np.array(curve.coefficients[0]) / curve.attenuations[0]
    columns, bases = measured.transmission.columns, len(direction)
    one = replace(measured.transmission, columns=np.vstack([direction @ columns[:bases], columns[bases:]]))
    profile = measured.profile
    known = None if profile is None else np.ascontiguousarray(profile.reshape(len(profile), -1).T)
    found = np.zeros((bases, bases))
    for view in range(len(measured)):
        shape = measured.counts.shape[1:]
        counts = read_part(measured.counts, view).reshape(shape[0], -1).T
        gains = (measured.exposure[view, :, None, None] * measured.gains).reshape(shape[0], -1).T
        lengths = decompose(counts, gains, one, dispersion, known=known)[0][:, 0]
        images = (direction[:, None] * np.maximum(lengths, 0)).reshape(1, bases, *shape[1:])
        found += ray_information(measured[[view]], images, dispersion).mean(axis=(0, 1, 2)) / len(measured)
    return found + LEAST * np.diag(np.diag(found))
