"""Named metric protocols: what each notices, and SSIM against other implementations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from recon.comparison.scoring.protocols import PROTOCOLS, image_ssim, protocol_named, ssim_3d, ssim_of_slices
from recon.evaluation.metrics import score_volume
from spectra.errors import InputError


def smooth(shape, seed=0):
    """Something with structure, between 0 and 1."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=shape), 2)
    return (values - values.min()) / np.ptp(values)


@given(st.floats(0.1, 10))
def test_only_the_honest_protocol_notices_a_wrong_scale_of_projections(scale):
    truth = smooth((24, 30))
    for name, protocol in PROTOCOLS.items():
        image, measured = protocol.view(scale * truth, truth, peak=1.0)
        error = float(np.abs(image - measured).max())
        if name == "honest":
            assert error == pytest.approx(abs(scale - 1), abs=1e-12)
        else:
            assert error < 1e-12


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_view_without_anything_in_it_has_a_scale(name):
    image, measured = PROTOCOLS[name].view(np.zeros((4, 5)), np.zeros((4, 5)), peak=1.0)
    assert not image.any()
    assert not measured.any()


@pytest.mark.parametrize("name", PROTOCOLS)
def test_psnr_of_volumes_is_that_of_the_fits_own_scores(name):
    truth = 0.03 * smooth((13, 14, 15))
    volume = 1.1 * truth + 0.001 * smooth(truth.shape, 1)
    found, own = PROTOCOLS[name].volume(volume, truth), score_volume(volume, truth)
    for key in ("psnr", "psnr_scaled", "psnr_zero"):
        assert found[key] == pytest.approx(own[key], abs=1e-9)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_truth_of_zeros_has_an_error_and_no_scores(name):
    scores = PROTOCOLS[name].volume(np.ones((12, 12, 12)), np.zeros((12, 12, 12)))
    assert scores.pop("rmse") == 1.0
    assert set(scores.values()) == {None}


def test_image_ssim_is_that_of_scikit_image_away_from_the_border():
    truth, image = smooth((60, 60)), smooth((60, 60)) + 0.05 * smooth((60, 60), 1)
    options = {"data_range": 1.0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "full": True}
    exact = structural_similarity(image, truth, **options)[1]
    padded = np.pad(exact[5:-5, 5:-5], 0)
    inner = image_ssim(image, truth)
    assert inner == pytest.approx(padded.mean(), abs=0.02)  # zeros outside change a border of five pixels
    assert image_ssim(truth, truth) == pytest.approx(1.0, abs=1e-12)


def test_ssim_in_three_dimensions_sees_errors_between_slices():
    """Slices in the wrong order: each is as alike as before where slices are alike, the volume is not."""
    truth = np.repeat(smooth((1, 20, 20)), 20, axis=0)
    flicker = truth + 0.2 * (np.arange(20) % 2)[:, None, None]
    assert ssim_3d(flicker, truth) < ssim_3d(truth + 0.2, truth)
    assert ssim_3d(truth, truth) == pytest.approx(1.0)


def test_ssim_in_three_dimensions_needs_room_for_its_window():
    assert ssim_3d(np.ones((10, 20, 20)), np.ones((10, 20, 20))) is None


def test_slices_without_truth_do_not_count_as_r2_gaussian_has_it():
    truth = np.zeros((20, 24, 28))
    truth[5:15, 4:20, 6:22] = smooth((10, 16, 16)) + 0.1
    volume = truth + 0.02 * smooth(truth.shape, 3)
    own = []
    for axis in range(3):
        pairs = zip(np.moveaxis(volume, axis, 0), np.moveaxis(truth, axis, 0), strict=True)
        own.append(np.mean([image_ssim(v, t) for v, t in pairs if t.max() > 0]))
    assert ssim_of_slices(volume, truth) == pytest.approx(np.mean(own), abs=1e-12)
    volume[:5] = 1.0  # of the slices along z without truth; they do count along y and x
    assert ssim_of_slices(volume, truth) < np.mean(own)


def test_a_protocol_that_there_is_not_is_refused():
    with pytest.raises(InputError, match="there is no metric protocol 'best': choose from honest, paper, r2"):
        protocol_named("best")
