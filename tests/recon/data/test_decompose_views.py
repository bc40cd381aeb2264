"""The first of two steps wastes no photon: per-ray maximum likelihood against the Cramer-Rao bound."""

from itertools import pairwise

import numpy as np
import pytest
from support.gaussian_scenes import NAMES, circular

from recon.data.material_decomposition import decompose_views
from recon.data.measurements import Measurements
from spectra.basis.basis import Basis, BasisFunction
from spectra.transmission import Transmission

WATER_AND_VIAL = [0.35, 2.6, 0.05]  # 100 mm of soft tissue and 5 mm of contrast agent [no unit]
THRESHOLDS = (25.0, 45.0, 63.3, 80.0, 120.0)  # of four channels, one at the K edge [keV]


def four_channels(photons: float) -> Transmission:
    """A filtered tube-like spectrum in channels of an ideal counter, with the physical basis and a K edge."""
    energy = np.arange(25.5, 120, 1.0)
    spectrum = (energy - 20) * (121 - energy) * np.exp(-((35 / energy) ** 3))
    functions = (BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3))
    seen = [(energy >= low) & (energy < high) for low, high in pairwise(THRESHOLDS)]
    weights = photons * np.array(seen) * spectrum / spectrum.sum()
    return Transmission.from_spectrum(weights, Basis(functions).evaluate(energy))


@pytest.mark.parametrize("path", [[0.0, 0.0, 0.0], WATER_AND_VIAL, [0.8, 4.0, 0.3]])
def test_line_integrals_scatter_no_more_than_ten_per_cent_above_the_cramer_rao_bound(path):
    """Ten thousand rays of one path, with gains and an exposure of their own; variances, at 10^7 photons."""
    model, geometry = four_channels(1e7), circular(50, 50, views=4)
    rng = np.random.default_rng(1)
    gains = np.full((4, 50, 50), 0.8, np.float32)
    exposure = np.full((4, 4), 1.25)
    counts = rng.poisson(model.expected(np.array(path)), (4, 50, 50, 4))
    measured = Measurements(np.moveaxis(counts, -1, 1).astype(np.float32), gains, exposure, geometry, model, NAMES)
    found, fisher = decompose_views(measured)
    rays = np.moveaxis(found, 1, -1).reshape(-1, 3)
    bound = model.cramer_rao(np.array(path))
    ratio = rays.var(axis=0) / np.diag(bound)
    assert (ratio < 1.1).all(), ratio
    assert (ratio > 0.9).all(), ratio  # better than the bound would be a mistake of one of the two
    assert (np.abs(rays.mean(axis=0) - path) < 0.1 * np.sqrt(np.diag(bound))).all()
    np.testing.assert_allclose(np.linalg.inv(fisher), bound, rtol=0.02, atol=1e-3 * np.abs(bound).max())
