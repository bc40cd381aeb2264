"""What a volume may hold, and its truth: attenuation, Hounsfield units and densities from formulas written anew."""

import h5py
import numpy as np
import pytest
from support.agent_scan import agent_scan
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_materials import TrueMaterial, read_true_materials
from phantomgen.dataset.truth import read_truth
from recon.evaluation.quantities import Quantity, parse_quantities, with_truth
from spectra.elements.attenuation import linear_attenuation
from spectra.errors import InputError


@pytest.fixture(scope="module")
def explicit(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--set", "geometry.views=4", "--set", "geometry.test_views=1")


@pytest.fixture(scope="module")
def agents(tmp_path_factory):
    return agent_scan(tmp_path_factory.mktemp("agents"))


def quantities(path, *texts):
    each = [quantity for text in texts for quantity in parse_quantities(text)]
    with open_dataset(path) as dataset:
        return with_truth(each, read_truth(path), dataset.spectra, read_true_materials(path))


def test_attenuation_is_coefficients_times_basis_functions(explicit):
    found, truth = quantities(explicit, "mono:60,80"), read_truth(explicit)
    klein_nishina = {}
    for energy in (60.0, 70.0, 80.0):
        a = energy / 510.998950
        first = (1 + a) / a**2 * (2 * (1 + a) / (1 + 2 * a) - np.log(1 + 2 * a) / a)
        klein_nishina[energy] = first + np.log(1 + 2 * a) / (2 * a) - (1 + 3 * a) / (1 + 2 * a) ** 2
    for volume, energy in zip(found.truth.volumes, (60.0, 80.0), strict=True):
        step = (energy / 70) ** -3 if energy > 63.3 else 0.0
        rows = [(energy / 70) ** -3, klein_nishina[energy] / klein_nishina[70.0], step]
        np.testing.assert_allclose(volume, np.einsum("b,bzyx->zyx", rows, truth.volumes), rtol=2e-6)
    assert found.truth.basis_names == ("attenuation_60_keV", "attenuation_80_keV")
    assert found.group == "attenuation"


def test_a_channel_means_the_mean_energy_of_what_it_counts(explicit):
    with h5py.File(explicit) as file:
        energy, counts = file["entry/spectra/energy"][()], file["entry/spectra/channel"][()]
    means = counts @ energy / counts.sum(axis=1)
    found = quantities(explicit, "channel:bin1,2")
    assert found.energies == pytest.approx(means[[1, 2]], rel=1e-9)
    np.testing.assert_allclose(
        found.truth.volumes[0], quantities(explicit, f"mono:{float(means[1])!r}").truth.volumes[0], rtol=1e-6
    )


def test_hounsfield_units_take_the_water_of_the_dataset(agents):
    found, truth = quantities(agents, "hu:70"), read_truth(agents)
    water = quantities(agents, "mono:70").truth.coefficients[0, 0]
    assert found.water == (pytest.approx(water),)
    assert water == pytest.approx(linear_attenuation("Water, Liquid", 1.0, np.array([70.0]))[0], rel=0.01)
    hu = 1000 * (found.truth.volumes[0] / water - 1)
    pure = truth.fractions[0] == 65535
    assert pure.any()
    np.testing.assert_allclose(hu[pure], 0.0, atol=0.1)
    np.testing.assert_allclose(found.converted(hu, 0, None, "v"), found.truth.volumes[0], atol=1e-8)


def test_water_that_the_scene_lacks_is_fitted_by_its_basis(explicit):
    (water,) = quantities(explicit, "hu:80").water
    assert water == pytest.approx(linear_attenuation("Water, Liquid", 1.0, np.array([80.0]))[0], rel=0.02)


def test_density_of_an_element_and_of_a_material(agents):
    truth = read_truth(agents)
    parts = truth.fractions / 65535
    for text in ("density:iodine", "density:I"):
        found = quantities(agents, text)
        np.testing.assert_allclose(found.truth.volumes[0], 0.010 * parts[1], rtol=1e-3)  # 10 mg/ml
    materials = read_true_materials(agents)
    assert [m.name for m in materials] == ["water", "iodine_10"]
    found = quantities(agents, "density:water")
    np.testing.assert_allclose(found.truth.volumes[0], materials[0].density * parts[0], rtol=1e-6)
    assert found.unit == "g/cm^3"


@pytest.mark.parametrize(
    ("text", "unit", "factor"),
    [
        ("mono:60", "1/cm", 0.1), ("mono:60", "cm^-1", 0.1), ("mono:60", "cm⁻¹", 0.1), ("mono:60", "/m", 1e-3),
        ("mono:60", "1/mm", 1.0), ("density:water", "mg/ml", 1e-3), ("density:water", "g/cm3", 1.0),
        ("density:water", "g/cc", 1.0), ("density:water", "kg/m^3", 1e-3),
    ],
)  # fmt: skip
def test_units(agents, text, unit, factor):
    values = np.arange(8.0).reshape(2, 2, 2)
    np.testing.assert_allclose(quantities(agents, text).converted(values, 0, unit, "v"), factor * values)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("attenuation", "--as says what the volume holds, basis:NAME, mono:KEV"),
        ("basis:", "--as says what the volume holds"),
        ("mono:fast", "an energy must be a number of keV from 1 to 800, such as mono:60, got 'fast'"),
        ("mono:nan", "an energy must be a number of keV"),
        ("mono:60000", "an energy must be a number of keV"),
        ("basis:calcium", "no basis 'calcium': choose from photoelectric, compton, kedge_63.3"),
        ("channel:9", "no channel '9': choose from bin0, bin1, bin2, bin3, or their number from 0 to 3"),
        ("density:iodine", "soft_tissue of the dataset is given by coefficients, so its iodine is not known"),
        ("density:bone", "bone of the dataset is given by coefficients and has no density"),
        (
            "density:wood",
            "no material 'wood': choose from soft_tissue, bone, contrast_high, contrast_low, or an element",
        ),
        ("fraction:wood", "no material 'wood': choose from soft_tissue, bone, contrast_high, contrast_low"),
        ("mono:60,60", "each quantity is scored once"),
    ],
)
def test_what_the_dataset_lacks_is_one_sentence(explicit, text, words):
    with pytest.raises(InputError, match=words) as caught:
        quantities(explicit, text)
    assert "\n" not in str(caught.value)


def test_quantities_of_several_kinds_and_wrong_units(explicit):
    with pytest.raises(InputError, match="one kind, got attenuation and basis: score them one by one"):
        quantities(explicit, "mono:60", "basis:compton")
    with pytest.raises(InputError, match="the unit 'HU' is not one of mono:60: state --units, one of 1/mm, 1/cm, 1/m"):
        quantities(explicit, "mono:60").converted(np.zeros((1, 1, 1)), 0, "HU", "v")
    with pytest.raises(InputError, match="the unit '1/mm' is not one of hu:60: state --units, one of HU"):
        quantities(explicit, "hu:60").converted(np.zeros((1, 1, 1)), 0, "1/mm", "v")


def test_labels():
    assert [Quantity("mono", "60").label, Quantity("hu", "bin1").label, Quantity("density", "iodine").label] == [
        "attenuation_60_keV",
        "attenuation_bin1",
        "density_iodine",
    ]
    assert [Quantity("channel", item).label for item in ("1", "bin1")] == ["attenuation_channel_1", "attenuation_bin1"]
    assert TrueMaterial("a", None, None).name == "a"
