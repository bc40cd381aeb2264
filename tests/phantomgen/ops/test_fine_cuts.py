"""Energy bins that are cut where the exponents of rays change fast."""

import numpy as np
import pytest

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import NO_CUTS, STEP, fine_cuts, fine_transmission
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths


@pytest.fixture(scope="module")
def scan():
    """Much water in front of a channel that begins at low energies."""
    return load_scene("multi-energy", ["geometry.views=6"])


@pytest.fixture(scope="module")
def lengths(scan):
    return sampled_lengths(scan)


@pytest.fixture(scope="module")
def exact(scan, lengths):
    """Log projections of other rays, on even bins a sixteenth as wide."""
    rays = lengths[np.random.default_rng(5).integers(len(lengths), size=200)]
    return rays, fine_transmission(scan, step=STEP / 16).log_projection(rays)


@pytest.mark.parametrize("tolerance", [3e-5, 3e-6])
def test_rays_that_nobody_looked_at_are_as_exact_as_is_said(scan, lengths, exact, tolerance):
    rays, wanted = exact
    cuts, error = fine_cuts(scan, lengths, tolerance)
    assert error <= tolerance
    found = fine_transmission(scan, cuts).log_projection(rays)
    assert abs(found - wanted).max() < 2 * tolerance
    assert abs(fine_transmission(scan).log_projection(rays) - wanted).max() > 4 * tolerance


def test_bins_stay_as_they_are_where_they_are_fine_enough(scan, lengths):
    cuts, error = fine_cuts(scan, lengths, 1e-2)
    assert len(cuts) == len(NO_CUTS)
    assert 0 < error < 1e-3


def test_bins_of_lines_stay_whole(scan, lengths):
    cuts, _ = fine_cuts(scan, lengths, 3e-6)
    assert abs(cuts[:, None] - scan.source.line_energy).min() > 5e-3
