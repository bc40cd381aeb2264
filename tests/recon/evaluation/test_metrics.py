import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from recon.data.projection_edges import edge_mask
from recon.evaluation.metrics import (
    HeldOutView,
    cross_talk,
    psnr,
    pure_voxels,
    score_basis_volumes,
    score_materials,
    score_projections,
    score_volume,
)
from spectra.errors import InputError


def blob(shape=(5, 16, 20), seed=0):
    return ndimage.gaussian_filter(np.random.default_rng(seed).random(shape), 1.0) * 0.02


@given(offset=st.floats(1e-6, 1e-2))
def test_a_constant_offset_gives_the_psnr_of_its_closed_form(offset):
    truth = np.zeros((2, 12, 12))
    truth[:, 3:9, 3:9] = 0.02
    scores = score_volume(truth + offset, truth)
    assert scores["psnr"] == pytest.approx(20 * np.log10(0.02 / offset))
    assert scores["bias"] == pytest.approx(offset)
    assert scores["rmse"] == pytest.approx(offset)
    assert scores["psnr_zero"] == pytest.approx(10 * np.log10(4))  # a quarter of the voxels holds the peak


def test_an_identical_volume_is_perfect():
    truth = blob()
    scores = score_volume(truth.astype(np.float32), truth.astype(np.float32))
    assert scores["psnr"] is None
    assert scores["psnr_scaled"] is None
    assert scores["rmse"] == 0
    assert scores["scale"] == pytest.approx(1)
    assert scores["ssim"] == pytest.approx(1)


def test_a_wrong_scale_is_found_and_undone():
    truth = blob()
    scores = score_volume(4.0 * truth, truth)
    assert scores["scale"] == pytest.approx(0.25)
    assert scores["psnr"] == pytest.approx(scores["psnr_zero"] - 20 * np.log10(3))
    assert scores["psnr_scaled"] is None or scores["psnr_scaled"] > 250


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_no_other_scalar_scores_better(seed):
    rng = np.random.default_rng(seed)
    truth, volume = rng.random((1, 4, 4)), rng.normal(size=(1, 4, 4))
    scores = score_volume(volume, truth)
    for factor in (0.9, 1.1):
        assert score_volume(factor * scores["scale"] * volume, truth)["psnr"] <= scores["psnr_scaled"] + 1e-9


def test_a_volume_of_zeros_scores_as_said():
    truth = blob()
    scores = score_volume(np.zeros_like(truth), truth)
    assert scores["psnr"] == scores["psnr_zero"] == scores["psnr_scaled"]
    assert scores["scale"] == 0


def test_a_truth_of_zeros_has_errors_but_no_ratios():
    scores = score_volume(np.full((3, 12, 12), 1e-3), np.zeros((3, 12, 12)))
    assert [scores[k] for k in ("psnr", "psnr_scaled", "psnr_zero", "scale", "ssim")] == [None] * 5
    assert [scores["rmse"], scores["bias"]] == pytest.approx([1e-3, 1e-3])


def test_ssim_looks_at_slices_with_truth_only_and_needs_room_for_its_window():
    truth = np.zeros((4, 16, 16))
    truth[1] = blob((1, 16, 16))[0]
    noise = np.random.default_rng(0).normal(scale=1e-3, size=truth.shape)
    noise[1] = 0
    assert score_volume(truth + noise, truth)["ssim"] == pytest.approx(1)
    assert score_volume(truth[:, :8, :8], truth[:, :8, :8])["ssim"] is None


def test_ssim_follows_its_formula_on_one_window():
    rng = np.random.default_rng(3)
    volume, truth = rng.random((2, 1, 11, 11))
    window = np.zeros((11, 11))
    window[5, 5] = 1
    window = ndimage.gaussian_filter(window, 1.5, truncate=3.5, mode="constant")
    means = [(window * v[0]).sum() for v in (volume, truth)]
    centred = [v[0] - m for v, m in zip((volume, truth), means, strict=True)]
    covariance = [(window * a * b).sum() for a, b in ((centred[0],) * 2, (centred[1],) * 2, centred)]
    c1, c2 = (0.01 * truth.max()) ** 2, (0.03 * truth.max()) ** 2
    expected = (2 * means[0] * means[1] + c1) / (means[0] ** 2 + means[1] ** 2 + c1)
    expected *= (2 * covariance[2] + c2) / (covariance[0] + covariance[1] + c2)
    assert score_volume(volume, truth)["ssim"] == pytest.approx(expected)


@pytest.mark.wrong_types
def test_what_cannot_be_compared_is_refused():
    with pytest.raises(InputError, match="cannot be compared"):
        score_volume(np.zeros((2, 3, 4)), np.zeros((2, 3, 5)))
    with pytest.raises(InputError, match="1 voxels that are not finite"):
        score_volume(np.array([[[np.nan, 0.0]]]), np.zeros((1, 1, 2)))


def test_every_basis_is_scored_and_the_scores_are_json():
    truth = np.stack([blob(), np.zeros((5, 16, 20))])
    scores = score_basis_volumes(truth, truth, ("compton", "kedge_Gd"))
    assert set(scores) == {"compton", "kedge_Gd"}
    json.dumps(scores, allow_nan=False)


def two_materials():
    fractions = np.zeros((2, 12, 12, 24))
    fractions[0, :, :, :12], fractions[1, :, :, 12:] = 1, 1
    coefficients = np.array([[0.01, 0.02], [0.03, 0.01]])
    return fractions, coefficients, np.einsum("am,azyx->mzyx", coefficients, fractions)


def test_bias_noise_and_cross_talk_are_recovered():
    fractions, coefficients, truth = two_materials()
    mixing = np.array([[1.02, -0.05], [0.1, 0.97]])
    noise = np.random.default_rng(5).normal(scale=1e-4, size=truth.shape)
    volumes = np.einsum("mn,nzyx->mzyx", mixing, truth) + noise
    full = np.rint(65535 * fractions).astype(np.uint16)
    result = score_materials(volumes, full, coefficients, ("a", "b"), ("p", "c"), full=65535)
    cell = result["materials"]["a"]["p"]
    assert result["materials"]["a"]["voxels"] == 8 * 8 * 8
    assert cell["bias"] == pytest.approx(mixing[0] @ coefficients[0] - 0.01, abs=2e-5)
    assert cell["sd"] == pytest.approx(1e-4, rel=0.15)
    talk = [[result["cross_talk"][m][n] for n in ("p", "c")] for m in ("p", "c")]
    np.testing.assert_allclose(talk, mixing, atol=2e-3)
    json.dumps(result, allow_nan=False)


def test_cross_talk_needs_as_many_different_materials_as_bases():
    fractions, coefficients, truth = two_materials()
    one = score_materials(truth, fractions[:1], coefficients[:1], ("a",), ("p", "c"))
    assert one["cross_talk"] is None
    assert cross_talk(coefficients * 0, coefficients * 0, ("p", "c")) is None
    thin = score_materials(truth[:, :3], fractions[:, :3], coefficients, ("a", "b"), ("p", "c"))
    assert thin["materials"]["a"]["voxels"] == 0
    assert thin["materials"]["a"]["p"] == {"true": 0.01, "mean": None, "bias": None, "sd": None}
    assert thin["cross_talk"] is None


def test_pure_voxels_stay_two_voxels_inside():
    fraction = np.zeros((11, 11, 11))
    fraction[1:10, 1:10, 1:10] = 1
    fraction[5, 5, 9] = 0.99
    expected = np.zeros((11, 11, 11), bool)
    expected[3:8, 3:8, 3:8] = True
    expected[3:8, 3:8, 7] = False
    np.testing.assert_array_equal(pure_voxels(fraction), expected)


def views_of_the_true_model(count=6, level=400.0, model=1.0):
    rng = np.random.default_rng(11)
    open_beam = np.full((2, 32, 32), level)
    expected = open_beam * np.exp(-np.linspace(0, 2, 32)) * np.array([1.0, 0.5])[:, None, None]
    away = np.arange(32)[:, None] * np.ones(32) < 8
    for _ in range(count):
        yield HeldOutView(rng.poisson(expected), model * expected, open_beam, away)


def test_poisson_counts_of_the_true_model_score_one_and_reach_the_noise_limit():
    scores = score_projections(views_of_the_true_model(), ("low", "high"))
    for channel in scores.values():
        assert channel["chi_square_all"] == pytest.approx(1, abs=0.06)
        assert channel["chi_square_away"] == pytest.approx(1, abs=0.12)
        assert channel["psnr"] == pytest.approx(channel["psnr_noise"], abs=0.3)
        assert channel["away"] == 0.25
    json.dumps(scores, allow_nan=False)


def test_a_model_that_is_off_by_a_factor_scores_its_closed_form():
    view = HeldOutView(
        counts=np.full((1, 2, 2), 110.0),
        expected=np.full((1, 2, 2), 100.0),
        open_beam=np.full((1, 2, 2), 1000.0),
        away=np.ones((2, 2), bool),
    )
    score = score_projections([view], ("only",))["only"]
    assert score["chi_square_all"] == pytest.approx(1.0)
    assert score["psnr"] == pytest.approx(20 * np.log10(np.log(10) / np.log(1.1)))
    assert score["psnr_noise"] == pytest.approx(20 * np.log10(np.log(10) * 10))


def test_blind_pixels_and_channels_are_left_out_and_zero_expectations_stay_finite():
    open_beam = np.stack([np.full((1, 4), 100.0), np.zeros((1, 4))])
    open_beam[0, 0, 0] = 0
    counts = np.zeros((2, 1, 4), np.int32)
    counts[0, 0] = [7, 0, 3, 10]
    expected = np.zeros((2, 1, 4))
    expected[0, 0] = [0, 0, 0, 10]
    view = HeldOutView.of(counts, expected, open_beam)
    scores = score_projections([view], ("seen", "blind"))
    assert set(scores["blind"].values()) == {None}
    assert scores["seen"]["chi_square_all"] == pytest.approx(9 / 1e-9 / 3)
    json.dumps(scores, allow_nan=False)


def test_no_views_give_no_scores():
    assert set(score_projections([], ("a",))["a"].values()) == {None}
    assert psnr(1.0, None) is None


def cylinder(radius=40.3, contrast=0.01, center=(64, 64.2), height=40):
    """Parallel projection of a cylinder that stands upright, in units of pixels."""
    row, column = np.mgrid[:128, :128]
    chord = 2 * np.sqrt(np.maximum(radius**2 - (column - center[1]) ** 2, 0))
    return contrast * chord * (np.abs(row - center[0]) < height)


def distance_to_silhouette(radius=40.3, center=(64, 64.2), height=40):
    row, column = np.mgrid[:128, :128]
    outside = np.stack([np.abs(row - center[0]) - height + 0.5, np.abs(column - center[1]) - radius])
    return np.where((outside <= 0).all(axis=0), -outside.max(axis=0), np.hypot(*np.maximum(outside, 0)))


@pytest.mark.parametrize("contrast", [1e-4, 0.01, 3.0])
@pytest.mark.parametrize("blur", [0.0, 0.8])
def test_rays_near_the_silhouette_of_a_cylinder_are_masked_and_others_kept(contrast, blur):
    away = edge_mask(ndimage.gaussian_filter(cylinder(contrast=contrast), blur)[None])
    distance = distance_to_silhouette()
    assert not away[distance <= 2].any()
    assert away[distance > 8].all()
    assert away[distance > 4].mean() > 0.95


def test_the_edge_may_show_in_one_basis_only_and_ripples_are_no_edges():
    rng = np.random.default_rng(2)
    ripple = ndimage.gaussian_filter(rng.normal(size=(128, 128)), 2.0)
    ripple *= 0.01 * cylinder().max() / ripple.std()
    flat = np.full((128, 128), 5.0)
    away = edge_mask(np.stack([flat, ndimage.gaussian_filter(cylinder(), 0.8) + ripple]))
    distance = distance_to_silhouette()
    assert away[distance <= 1].mean() < 0.05
    assert away[distance > 8].mean() > 0.97


def test_distance_is_in_pixels_and_empty_views_have_no_edges():
    step = np.zeros((1, 9, 40))
    step[..., 20:] = 1.0
    for distance in (0, 2, 5):
        masked = np.flatnonzero(~edge_mask(step, distance)[4])
        np.testing.assert_array_equal(masked, np.arange(19 - distance, 21 + distance))
    assert edge_mask(np.zeros((2, 6, 7))).all()
    assert edge_mask(np.zeros((1, 1, 1))).all()
