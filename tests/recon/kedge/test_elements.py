"""Elements found by their curves, and weak edges by neighbouring rays: counts are drawn from known functions."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from phantomgen.dataset.spectral_model import Spectra
from recon.kedge.edge_likelihood import EdgeLikelihood
from recon.kedge.elements import elements_within, plain_alternatives, scan_elements, settle_elements
from recon.kedge.expected_noise import null_distribution
from recon.kedge.judgement import LEAST_SCORE, judge, judge_by_neighbours
from recon.kedge.rays import Rays
from recon.kedge.search import likeliest_edge, refine_together
from recon.kedge.spatial_correlation import between_channels, correlation_score
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import edge_energy

PLAIN = (BasisFunction("photoelectric"), BasisFunction("compton"))
TISSUE = (BasisFunction("material", composition="muscle"), BasisFunction("material", composition="cortical bone"))
STEP = BasisFunction("step", edge_energy=63.0)
THRESHOLDS = (20, 33.2, 50, 63, 80, 120)


def element(symbol):
    return BasisFunction("element", element=symbol)


def spectra(thresholds=THRESHOLDS, photons=1e6):
    edges = np.unique([*np.arange(20.0, 120.5, 1.0), *thresholds])
    energy = (edges[:-1] + edges[1:]) / 2
    source = np.exp(-(((energy - 60) / 30) ** 2)) * np.diff(edges)
    response = np.array([(energy > a) & (energy < b) for a, b in pairwise(thresholds)], float)
    names, limits = tuple(f"bin{c}" for c in range(len(response))), np.array(thresholds, float)
    return Spectra(
        energy, edges, photons * source / source.sum(), response, Basis(PLAIN), Basis(PLAIN).evaluate(energy), names,
        limits[:-1], limits[1:],
    )  # fmt: skip


def likelihood(plain, further, seed=0, side=14, thresholds=THRESHOLDS, dispersion=0.0, photons=1e6):
    """Rays of one square view through random tissue and further functions: the largest line integral of each."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid([0], range(side), range(side), indexing="ij")).reshape(3, -1)
    ones = np.ones((side**2, len(thresholds) - 1))
    empty = EdgeLikelihood(
        Rays(ones, ones, None, places), spectra(thresholds, photons), np.zeros(ones.shape[1]), dispersion
    )
    lengths = rng.uniform(0.5, 1.0, (side**2, 2)) * ([0.2, 2.0] if plain == PLAIN else [2.0, 0.4])
    more = rng.uniform(0.5, 1.0, (side**2, len(further))) * list(further.values())
    transmission = empty.transmission((*plain, *further))
    counts = rng.poisson(transmission.expected(np.hstack([lengths, more]))).astype(float)
    return empty.with_rays(Rays(counts, ones, None, places))


@pytest.mark.parametrize(("symbol", "content"), [("I", 0.3), ("Gd", 0.3), ("Lu", 0.6)])
def test_the_element_is_named_where_compositions_are_real(symbol, content):
    model = likelihood(TISSUE, {element(symbol): content})
    found = likeliest_edge(model, plain_alternatives(PLAIN), [], STEP, ())
    assert found.function == element(symbol)
    assert found.judgement.warranted
    assert found.profile.best == edge_energy(symbol)
    assert found.profile.low < found.profile.best < found.profile.high
    assert [f.name for f in found.plain] == ["Water, Liquid", "cortical bone"]


@pytest.mark.parametrize("energy", [50.4, 63.3])
def test_a_step_stays_a_step(energy):
    model = likelihood(PLAIN, {BasisFunction("step", edge_energy=energy): 0.5})
    found = likeliest_edge(model, plain_alternatives(PLAIN), [], STEP, ())
    assert (found.function.kind, found.plain) == ("step", PLAIN)
    assert found.profile.best == pytest.approx(energy, abs=0.5)


def test_wrong_elements_are_put_right_together():
    thresholds = (20, 33.2, 41, 50.3, 63, 80, 120)
    model = likelihood(PLAIN, {element("I"): 0.3, element("Gd"): 0.3}, side=10, thresholds=thresholds)
    settled = settle_elements(model, PLAIN, [element("Ag"), element("Dy")], 10)
    assert {f.element for f in settled} == {"I", "Gd"}
    refined = refine_together(model, PLAIN, settled)
    assert {f.element for f, _ in refined} == {"I", "Gd"}
    assert all(profile.low < profile.best < profile.high for _, profile in refined)


def test_an_element_that_is_not_there_is_not_determined():
    model = likelihood(PLAIN, {}, side=8)
    candidates = elements_within(model.spectra)
    assert "its element is not determined" in scan_elements(model, PLAIN, candidates).undetermined


def test_elements_are_those_whose_edge_is_detected_and_that_do_not_decay():
    symbols = [f.element for f in elements_within(spectra())]
    assert {"I", "Gd", "Au", "Bi", "Th"} < set(symbols)
    assert not {"Ca", "Tc", "Pm", "Po"} & set(symbols)
    assert all(21 < (f.edge_energy or 0) < 119 for f in elements_within(spectra()))


def test_other_plain_functions_are_left_as_they_are():
    assert plain_alternatives(TISSUE) == (TISSUE,)
    assert [len(functions) for functions in plain_alternatives((*PLAIN, STEP))] == [3, 3]


@pytest.mark.parametrize("dispersion", [0.0, 0.02])
def test_of_noise_alone_neighbours_agree_by_one_standard_deviation(monkeypatch, dispersion):
    monkeypatch.setattr("recon.kedge.spatial_correlation.pairs_without_edge", lambda functions: (functions,))
    monkeypatch.setattr("recon.kedge.expected_noise.MISFIT", 0.0)
    models = [likelihood(TISSUE, {}, seed, side=20, dispersion=dispersion) for seed in range(24)]
    scores = [correlation_score(model, TISSUE, STEP) for model in models]
    assert np.std(scores) == pytest.approx(1.0, abs=0.45)
    assert abs(np.mean(scores)) < 0.8
    assert max(scores) < LEAST_SCORE


def test_neighbours_show_a_weak_edge_and_no_better_than_the_bound(monkeypatch):
    monkeypatch.setattr("recon.kedge.expected_noise.MISFIT", 0.0)
    model = likelihood(PLAIN, {STEP: 0.006}, side=48, dispersion=0.01, photons=3e5)
    before = replace(judge(model, PLAIN, STEP), warranted=False)
    after = judge_by_neighbours(model, PLAIN, STEP, before)
    information = model.last_length((*PLAIN, STEP))[1]
    information /= null_distribution(model, PLAIN, STEP, model.deviances(PLAIN)[1]).variance
    visible = 0.0046 * np.sqrt(information.sum())  # root mean square of uniform(0.5, 1) * 0.006
    assert after.warranted
    assert LEAST_SCORE < after.score < visible + 2
    assert "neighbours among 2304 rays agree" in after.reason


def test_what_tissues_are_is_no_edge(monkeypatch):
    """Beside photoelectric effect and Compton scattering alone, real tissues look like an edge on many rays."""
    model, edges = (
        likelihood(TISSUE, {}, side=32, photons=4e6),
        [BasisFunction("step", edge_energy=e) for e in (50, 57)],
    )
    assert max(correlation_score(model, PLAIN, edge) for edge in edges) < LEAST_SCORE
    monkeypatch.setattr("recon.kedge.spatial_correlation.pairs_without_edge", lambda functions: (functions,))
    monkeypatch.setattr("recon.kedge.expected_noise.MISFIT", 0.0)
    assert min(correlation_score(model, PLAIN, edge) for edge in edges) > LEAST_SCORE


@pytest.mark.parametrize(("edge", "shown"), [(31.0, False), (33.17, True), (63.0, True), (80.7, True), (85.0, False)])
def test_channels_lie_below_and_above_an_edge_or_not(edge, shown):
    assert between_channels(spectra(), edge) == shown
