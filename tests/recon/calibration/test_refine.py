"""Errors of a stated spectrum: perturbed sensitivities, likelihood of rays, and refinement of tiny scans."""

import numpy as np
import pytest
from scipy.stats import chi2

from phantomgen.dataset.reader import open_dataset
from recon.calibration.perturbation import Perturbation
from recon.calibration.ray_likelihood import RayLikelihood
from recon.calibration.refine import PRIORS, refined
from recon.calibration.scoring import maximise
from recon.calibration.spectrum_file import read_spectrum, sensitivities_of, with_sensitivities
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.transmission import Transmission
from tests.support.tiny_scans import make

AL = Material("Al", None, "Al")
TRUE = np.array([-2.0, 0.25, 1.0, -1.0, 1.0])
PRIOR = np.array([PRIORS["voltage"], PRIORS["filter"], *[PRIORS["thresholds"]] * 3])
OTHER = ["source.kvp=138", "source.filters.0.thickness=2.75", "detector.thresholds=[20,46,62.3,81]"]


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """A scan of the stated scene, and one whose source and detector differ."""
    folder = tmp_path_factory.mktemp("refine")
    more = [part for change in (*OTHER, "geometry.views=12") for part in ("--set", change)]
    stated = make(folder / "stated.h5", "--set", "geometry.views=12", rows=64, columns=64)
    return stated, make(folder / "true.h5", *more, rows=64, columns=64)


@pytest.fixture(scope="module")
def perturbation(scans):
    with open_dataset(scans[0]) as dataset:
        return Perturbation.of(dataset, AL)


def test_perturbed_sensitivities_are_those_of_the_other_scanner(scans, perturbation):
    """The spectrum of the simulator itself is the reference, for counts behind 0 to 20 mm of aluminium."""
    found = perturbation.spectra(TRUE)
    with open_dataset(scans[1]) as dataset:
        other = dataset.spectra
        stated = perturbation.stated
        for thickness in (0.0, 5.0, 20.0):
            logs = [
                np.log(s.weights @ np.exp(-thickness * AL.attenuation(s.energy)) / s.weights.sum(axis=1))
                for s in (found, other, stated)
            ]
            assert (np.abs(logs[0] - logs[1]) < 0.05 * np.abs(logs[2] - logs[1]) + 1e-3).all()


def test_no_error_leaves_the_stated_model(perturbation):
    found = perturbation.spectra(np.zeros(5))
    np.testing.assert_allclose(found.weights, perturbation.stated.weights, rtol=1e-10, atol=1e-12)


def test_thresholds_move_counts_between_channels_and_lose_none(perturbation):
    moved = perturbation.spectra(np.array([0, 0, 0.7, -0.4, 1.3]))
    np.testing.assert_allclose(moved.response.sum(axis=0), perturbation.stated.response.sum(axis=0), rtol=1e-12)


def rays(perturbation, count, seed):
    """Line integrals within the body of kedge-small, and open-beam counts of blocks of 16 pixels."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform([0.02, 0.3, 0.0], [0.5, 2.0, 0.4], (count, 3))
    spectra = perturbation.spectra(np.zeros(5))
    share = spectra.weights.sum(axis=1) / spectra.weights.sum()
    return lengths, np.broadcast_to(16 * 1e5 * share, (count, 4)).copy()


def counts_of(perturbation, errors, lengths, air, rng):
    """Poisson counts of a scanner with errors."""
    spectra = perturbation.spectra(errors)
    transmission = Transmission.from_spectrum(spectra.weights, spectra.basis_values, spectra.channels)
    return rng.poisson(air * np.exp(-transmission.log_projection(lengths))).astype(float)


@pytest.mark.slow
def test_uncertainties_cover_errors_drawn_from_the_prior(perturbation):
    """Over errors from the prior and new noise, (found - true)^T C^-1 (found - true) is chi-square distributed."""
    lengths, air = rays(perturbation, 300, 1)
    rng, distances = np.random.default_rng(2), []
    for _ in range(30):
        true = rng.normal(0, PRIOR) * 0.8  # rarely beyond the room of the grid
        counts = counts_of(perturbation, true, lengths, air, rng)
        found = maximise(RayLikelihood(perturbation, counts, air).likelihood, np.zeros(5), PRIOR)
        away = found.values - true
        distances.append(away @ np.linalg.solve(found.covariance, away))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 5 * len(distances)) / len(distances)
    assert 0.64 * low < np.mean(distances) < high  # 0.64 where a prior alone determines an error


def test_rays_with_as_many_channels_as_functions_tell_nothing(perturbation):
    lengths, air = rays(perturbation, 50, 3)
    spectra = perturbation.spectra(np.zeros(5))
    counts = counts_of(perturbation, np.zeros(5), lengths, air, np.random.default_rng(0))
    whole = RayLikelihood(perturbation, counts, air).likelihood(np.zeros(5)).information
    # Without its highest channel there are three channels for three functions.
    three = Perturbation(
        type(spectra)(**{**vars(perturbation.stated), "response": perturbation.stated.response[:3],
                         "channels": perturbation.stated.channels[:3], "lower": perturbation.stated.lower[:3],
                         "upper": perturbation.stated.upper[:3]}),
        perturbation.tube, perturbation.voltage, AL,
    )  # fmt: skip
    none = RayLikelihood(three, counts[:, :3], air[:, :3]).likelihood(np.zeros(4)).information
    assert (np.diag(none) < 1e-4 * np.diag(whole)[:4]).all()


def test_a_wrong_spectrum_is_found_and_corrected(scans):
    with open_dataset(scans[0]) as stated, open_dataset(scans[1]) as scan:
        wrong = with_sensitivities(scan, sensitivities_of(stated.spectra))
        found = refined(wrong, air=True, voltage=140.0)
        assert found.before > 3 * found.found.deviance
        assert (np.abs(found.found.values - TRUE) < 3.5 * found.found.uncertainty + 0.05 * np.abs(TRUE)).all()
        energy = [d.spectra.effective_energy for d in (found.dataset, wrong, scan)]
        assert (np.abs(energy[0] - energy[2]) < 0.5 * np.abs(energy[1] - energy[2]) + 0.1).all()


def test_a_right_spectrum_stays(scans, tmp_path):
    with open_dataset(scans[0]) as dataset:
        found = refined(dataset)
        assert (np.abs(found.found.values) < 3 * found.found.uncertainty).all()
        assert any("hardly tell" in sentence for sentence in found.sentences)
        found.write(tmp_path / "spectrum.yaml")
        again = with_sensitivities(dataset, read_spectrum(tmp_path / "spectrum.yaml"))
        np.testing.assert_allclose(again.spectra.weights, found.dataset.spectra.weights, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_scans_that_cannot_be_refined_get_a_sentence(scans, tmp_path):
    three = make(tmp_path / "three.h5", "--set", "detector.thresholds=[20,45,63.3]", "--set", "geometry.views=8")
    with open_dataset(three) as dataset, pytest.raises(InputError, match="3 channels and 3 basis functions"):
        refined(dataset)
    with open_dataset(scans[0]) as dataset, pytest.raises(InputError, match="no prior of 'resolution'"):
        refined(dataset, {"resolution": 1.0})
    few = make(tmp_path / "few.h5", "--set", "geometry.views=4", rows=16, columns=16)
    with open_dataset(few) as dataset, pytest.raises(InputError, match=r"and 300 are needed"):
        refined(dataset)
