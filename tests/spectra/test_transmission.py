import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from spectra.differentiable import transmit
from spectra.errors import InputError
from spectra.ops.transmit import expected_ray, reference
from spectra.transmission import Transmission


def random_transmission(rng, columns, sizes):
    starts = np.concatenate([[0], np.cumsum(sizes)])
    return Transmission(rng.uniform(0.05, 1, (columns, starts[-1])), rng.uniform(0.1, 5, starts[-1]), starts)


sizes_of_channels = st.lists(st.integers(0, 20), min_size=1, max_size=5).filter(sum)


@settings(deadline=None)
@given(seed=st.integers(0, 2**31), columns=st.integers(1, 6), sizes=sizes_of_channels)
def test_every_entry_point_gives_the_formula(seed, columns, sizes):
    rng = np.random.default_rng(seed)
    model = random_transmission(rng, columns, sizes)
    lengths = rng.uniform(-1, 20, (7, columns))
    leaf = torch.tensor(lengths, requires_grad=True)
    truth = reference.transmit(leaf, *(torch.tensor(a) for a in (model.columns, model.weights)), model.starts.tolist())
    counts, jacobian = model.expected_and_jacobian(lengths)
    np.testing.assert_allclose(counts, truth.detach(), rtol=1e-12)
    np.testing.assert_allclose(model.expected(lengths), truth.detach(), rtol=1e-12)
    out = np.empty(len(model))
    expected_ray(lengths[0], model.columns, model.weights, model.starts, out)
    np.testing.assert_allclose(out, truth.detach()[0], rtol=1e-12)
    cotangent = torch.tensor(rng.normal(size=truth.shape))
    (gradient,) = torch.autograd.grad(truth, leaf, cotangent)
    np.testing.assert_allclose(np.einsum("rc,rcm->rm", cotangent, jacobian), gradient, rtol=1e-9, atol=1e-12)


def test_transmit_passes_gradcheck_and_keeps_shape_and_dtype():
    rng = np.random.default_rng(1)
    model = random_transmission(rng, 3, [4, 9, 1])
    lengths = torch.tensor(rng.uniform(0, 3, (2, 5, 3)), requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: transmit(x, model), lengths)
    single = transmit(lengths.detach().float(), model)
    assert single.shape == (2, 5, 3)
    assert single.dtype == torch.float32


def test_the_result_does_not_depend_on_threads():
    from spectra.threads import set_threads

    rng = np.random.default_rng(2)
    model, lengths = random_transmission(rng, 3, [5, 5]), rng.uniform(0, 3, (40000, 3))
    try:
        results = []
        for count in (1, 3):
            set_threads(count)
            results.append(model.expected_and_jacobian(lengths))
    finally:
        set_threads(None)
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_one_energy_is_beer_lambert():
    model = Transmission(np.array([[0.3], [0.7]]), np.array([1000.0]), np.array([0, 1]))
    lengths = np.array([[2.0, 5.0], [0.0, 0.0], [1e4, 1e4]])
    np.testing.assert_allclose(model.log_projection(lengths)[:, 0], lengths @ [0.3, 0.7], rtol=1e-12)
    np.testing.assert_allclose(model.expected(lengths)[:, 0], [1000 * np.exp(-4.1), 1000, 0], rtol=1e-12)


def test_no_material_is_exactly_zero_and_starvation_stays_finite(transmission_on):
    model = transmission_on(128)
    np.testing.assert_array_equal(model.log_projection(np.zeros(3)), 0)
    np.testing.assert_allclose(model.expected(np.zeros(3)), model.open_beam, rtol=1e-12)
    for length in (1e2, 1e5, 1e300):
        projection, slopes = model.log_projection_and_slopes(np.full(3, length))
        assert np.isfinite(projection).all()
        assert np.isfinite(slopes).all()
        assert (slopes > 0).any()
        np.testing.assert_allclose(model.fisher(np.full(3, length), dispersion=0.02), 0, atol=1e-30)
    np.testing.assert_array_equal(model.expected(np.full(3, 1e5)), 0)


def test_a_channel_without_photons_is_blind_and_harmless():
    weights = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    model = Transmission.from_spectrum(weights, np.array([[0.1, 0.2, 0.3]]))
    assert model.starts.tolist() == [0, 2, 2]
    lengths = np.array([[0.0], [3.0]])
    np.testing.assert_array_equal(model.expected(lengths)[:, 1], 0)
    np.testing.assert_array_equal(model.log_projection(lengths)[:, 1], 0)
    np.testing.assert_array_equal(model.jacobian(lengths)[:, 1], 0)
    assert np.isfinite(model.fisher(lengths)).all()


@pytest.mark.parametrize("dispersion", [0.0, 0.03])
def test_fisher_information_is_that_of_the_definition(transmission_on, dispersion):
    model = transmission_on(64)
    lengths = np.random.default_rng(3).uniform(0, 1, (4, 2, 3)) * [0.5, 3, 0.5]
    counts, jacobian = model.expected_and_jacobian(lengths)
    variance = counts + (dispersion * counts) ** 2
    expected = np.einsum("...cm,...c,...cn->...mn", jacobian, 1 / variance, jacobian)
    np.testing.assert_allclose(model.fisher(lengths, dispersion), expected, rtol=1e-9)


def test_the_grid_converges_with_second_order(transmission_on):
    lengths = np.random.default_rng(4).uniform(0, 1, (200, 3)) * [0.3, 3, 0.5]
    truth = transmission_on(4800).log_projection(lengths)
    coarse, fine = (np.abs(transmission_on(n).log_projection(lengths) - truth).max() for n in (128, 512))
    assert coarse < 1e-3
    assert fine < coarse / 8


def test_counts_of_the_shared_scan_are_plausible(transmission_on):
    counts = transmission_on(128).open_beam
    assert 1.8e5 < counts.sum() < 2e5
    assert (counts > 2e4).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.ones((2, 3)), np.ones(2), [0, 2]), "do not fit"),
        ((np.ones((2, 3)), np.ones(3), [0, 2]), "starts must rise"),
        ((np.ones((2, 3)), np.ones(3), [0, 4, 3]), "starts must rise"),
        ((np.ones((2, 3)), np.array([1, -1, 1]), [0, 3]), "must not be negative"),
        ((np.full((2, 3), np.nan), np.ones(3), [0, 3]), "must be finite"),
        ((np.ones((2, 3)), np.ones(3), [0, 3], ("a", "b")), "2 channel names"),
    ],
)
@pytest.mark.wrong_types
def test_arrays_that_do_not_fit_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        Transmission(*arguments)


@pytest.mark.wrong_types
def test_line_integrals_must_have_one_entry_per_column(transmission_on):
    with pytest.raises(InputError, match="do not end in 3 columns"):
        transmission_on(64).expected(np.zeros(2))
    with pytest.raises(InputError, match="at 3 energies but columns at 2"):
        Transmission.from_spectrum(np.ones((1, 3)), np.ones((1, 2)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("value", [-1.0, -0.01, 0.0, 1e-6, 1.0, 10.0, 60.0])
def test_counts_and_gradients_are_finite_from_minus_one_to_sixty(transmission_on, value, dtype):
    """Negative, zero and huge paths; behind 60 no photon is left, and the gradient is 0 instead of 0/0."""
    model = transmission_on(128)
    lengths = torch.full((1, 3), value, dtype=dtype, requires_grad=True)
    counts = transmit(lengths, model)
    counts.sum().backward()
    assert torch.isfinite(counts).all()
    assert torch.isfinite(lengths.grad).all()
    assert (lengths.grad <= 0).all()
    projection, slopes = model.log_projection_and_slopes(np.full(3, value))
    assert np.isfinite(projection).all()
    assert np.isfinite(slopes).all()
    assert (np.sign(projection) == np.sign(value)).all()
    if value == 0:
        assert not np.signbit(projection).any()  # 0.0, not -0.0


def test_a_channel_limited_to_one_energy_is_beer_lambert_on_any_grid(transmission_on):
    model = transmission_on(64)
    one = Transmission(model.columns[:, :1], model.weights[:1], np.array([0, 1]))
    lengths = np.random.default_rng(8).uniform(0, 2, (5, 3))
    np.testing.assert_allclose(one.log_projection(lengths)[:, 0], lengths @ model.columns[:, 0], rtol=1e-12)


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_the_cramer_rao_bound_is_the_inverse_of_the_information(transmission_on, dispersion):
    model = transmission_on(64)
    lengths = np.random.default_rng(6).uniform(0, 1, (4, 3)) * [0.5, 3, 0.5]
    bound = model.cramer_rao(lengths, dispersion)
    np.testing.assert_allclose(bound @ model.fisher(lengths, dispersion), np.tile(np.eye(3), (4, 1, 1)), atol=1e-7)
    assert (np.linalg.eigvalsh(bound) > 0).all()


def test_the_cramer_rao_bound_is_reached_by_maximum_likelihood():
    """One energy, one column: log(N0 / N) of many photons has the variance exp(L) / N0."""
    model = Transmission(np.array([[1.0]]), np.array([1e6]), np.array([0, 1]))
    assert model.cramer_rao(np.array([2.0]))[0, 0] == pytest.approx(np.exp(2) / 1e6, rel=1e-9)
    counts = np.random.default_rng(0).poisson(1e6 * np.exp(-2), 20000)
    assert np.var(-np.log(counts / 1e6)) == pytest.approx(model.cramer_rao(np.array([2.0]))[0, 0], rel=0.04)


def test_the_bound_is_infinite_where_nothing_can_be_known(transmission_on):
    model = transmission_on(64)

    assert np.isinf(model.cramer_rao(np.full(3, 1e4))).all()  # no photon is left
    fewer = Transmission.from_spectrum(np.ones((2, 5)) * [[1], [2]], np.random.default_rng(1).random((3, 5)))
    assert np.isinf(fewer.cramer_rao(np.zeros((2, 3)))).all()  # fewer channels than columns
    blind = Transmission(np.array([[0.0, 0.0], [0.1, 0.4]]), np.ones(2), np.array([0, 1, 2]))
    assert np.isinf(blind.cramer_rao(np.zeros(2))).all()  # a column that nothing attenuates


def test_no_rays_have_empty_results_with_all_axes(transmission_on):
    model, none = transmission_on(64), np.zeros((0, 3))
    for counts, slopes in (model.expected_and_jacobian(none), model.log_projection_and_slopes(none)):
        assert counts.shape == (0, len(model))
        assert slopes.shape == (0, len(model), 3)
