import numpy as np
import pytest

from phantomgen.analysis.single_ray import Layer, SingleRayBound, layers_of, scan_photons
from phantomgen.analysis.spectrum import SpectrumReport
from phantomgen.display.figures.scan_energies import scene_edges
from phantomgen.scene.scan import load_scene
from spectra.cramer_rao import least_deviations
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.transmission import Transmission

WATER = Material("water", composition="water")
ONE_ENERGY = ["source={type: monochromatic, energy: 60, photons: 1000}", "detector.thresholds=[20]"]


@pytest.fixture(scope="module")
def kedge():
    return load_scene("kedge-small")


def test_one_energy_follows_beer_and_lambert():
    scan = load_scene("kedge-small", ONE_ENERGY)
    behind = SingleRayBound.of(scan, (Layer(WATER, 200.0),))
    absorbed = scan.detector.absorption(np.array([60.0]))[0]
    mu = WATER.attenuation(np.array([60.0]))[0]
    assert behind.counts == pytest.approx([1000 * absorbed * np.exp(-200 * mu)], rel=1e-12)
    assert np.isinf(behind.bounds).all()


def test_layers_of_the_basis_are_line_integrals(kedge):
    tissue = kedge.scene.materials[0]
    lengths = 80 * np.array([tissue.coefficients.get(name, 0.0) for name in kedge.basis.names])
    energies, photons = scan_photons(kedge)
    weights = kedge.detector.response(energies) * photons
    full = Transmission.from_spectrum(weights, kedge.basis.evaluate(energies.nodes))
    point = SingleRayBound.of(kedge, layers_of("8 cm soft_tissue", kedge))
    np.testing.assert_allclose(point.counts, full.expected(lengths), rtol=1e-10)
    np.testing.assert_allclose(point.bounds, least_deviations(full.fisher(lengths)), rtol=1e-8)


def test_bounds_fall_with_the_root_of_the_photons(kedge):
    more = load_scene("kedge-small", [f"source.photons={4 * kedge.source.photons}"])
    np.testing.assert_allclose(SingleRayBound.of(more).bounds, SingleRayBound.of(kedge).bounds / 2, rtol=1e-9)


def test_bins_are_fine_enough(kedge, monkeypatch):
    layers = layers_of("20 cm water + 5 mm bone", kedge)
    bounds = SingleRayBound.of(kedge, layers).bounds
    monkeypatch.setattr("phantomgen.analysis.single_ray.STEP", 0.05)
    np.testing.assert_allclose(bounds, SingleRayBound.of(kedge, layers).bounds, rtol=2e-4)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("20 cm water", [(200.0, "water")]),
        ("2.5mm Al + 0.1 m water", [(2.5, "Al"), (100.0, "water")]),
        ("1e1 mm Water, Liquid", [(10.0, "Water, Liquid")]),
        ("", []),
    ],
)
def test_layers_are_written_as_people_do(kedge, text, expected):
    assert [(layer.thickness, layer.material.name) for layer in layers_of(text, kedge)] == expected


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("water", "write thickness, unit and material"),
        ("20 water", "write thickness, unit and material"),
        ("20 inch water", "write thickness, unit and material"),
        ("-1 mm water", "not negative, got -1 mm"),
        ("1e999 mm water", "finite"),
        ("1.2.3 mm water", "'1.2.3' is no number"),
        ("1 mm watr", "did you mean 'water'"),
        ("1 mm Gd2O3", "needs a density"),
        ("1 mm water + ", "write thickness"),
    ],
)
def test_layers_that_mean_nothing_are_refused(kedge, text, words):
    with pytest.raises(InputError, match=words):
        layers_of(text, kedge)


def test_noise_in_mg_is_that_of_a_solution():
    # A centimetre of 10 mg/ml iodine is 10 mg/cm^2: its line integral in units of the noise must be the same both ways.
    scan = load_scene("multi-energy")
    report = SpectrumReport.of(scan)
    iodine = report.to_dict()["noise"][-1]
    vial = next(m for m in scan.scene.materials if m.name == "iodine_10")
    energy = np.linspace(40, 120, 50)
    alpha = vial.coefficients_in(scan.basis, energy, np.ones(50))[-1]
    assert iodine["basis"] == "kedge_I"
    assert 10.0 / iodine["behind_mg_per_cm2"] == pytest.approx(10 * alpha / iodine["behind"], rel=1e-6)


def test_edges_in_a_picture_are_those_of_materials_and_basis(kedge):
    assert scene_edges(kedge, 20.0) == {"K edge": 63.3}
    assert scene_edges(load_scene("kedge-small", ["source.kvp=60", "detector.thresholds=[20]"]), 20.0) == {}
    assert scene_edges(load_scene("multi-energy"), 20.0) == pytest.approx({"I": 33.1694}, abs=1e-3)


def test_one_energy_tells_as_much_counted_as_summed_up():
    small = ["source={type: monochromatic, energy: 60, photons: 1000}", "basis=[{type: compton}]"]
    water = ["materials={water: {composition: water}}", "objects=[{type: sphere, material: water, radius: 5}]"]
    counting = "detector={type: photon_counting, composition: CsI, density: 3.6, thickness: 0.6, thresholds: [20]}"
    summing = "detector={type: energy_integrating, composition: CsI, density: 3.6, thickness: 0.6}"
    counted, summed = (SingleRayBound.of(load_scene("kedge-small", [*small, *water, d])) for d in (counting, summing))
    np.testing.assert_allclose(summed.counts, 60 * counted.counts, rtol=1e-9)
    np.testing.assert_allclose(summed.bounds, counted.bounds, rtol=1e-9)


def test_several_sources_are_described_one_by_one():
    tubes = (
        "{low: {type: monochromatic, energy: 50, photons: 100}, high: {type: monochromatic, energy: 90, photons: 300}}"
    )
    scan = load_scene("kedge-small", [f"source={{type: multi_source, sources: {tubes}}}", "detector.thresholds=[20]"])
    text = SpectrumReport.of(scan).text
    assert "low             100 photons up to 50 keV, mean 50.00 keV" in text
    assert "high            300 photons up to 90 keV, mean 90.00 keV" in text
