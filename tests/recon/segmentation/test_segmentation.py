"""Material maps on toy volumes whose materials are known: labels, physical numbers, colours, scores."""

import sys
from functools import cache
from types import ModuleType

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians
from recon.readouts.mechanisms import Mechanisms
from recon.readouts.readouts import WATER, Readouts, check_energies
from recon.readouts.spectrum import detected_spectrum
from recon.segmentation.clustering import find_modes, is_tail, nearest_mode
from recon.segmentation.colours import colours_of, kind_of, names_of
from recon.segmentation.features import features_of
from recon.segmentation.labelling import label_edges, ordered, rims
from recon.segmentation.rendering import parse_views, picture, slices_rgb, views_around, voxel_lengths
from recon.segmentation.result import Options
from recon.segmentation.scoring.image_similarity import image_similarity
from recon.segmentation.scoring.scores import confusion, dice, match
from recon.segmentation.segment import segment_subject
from recon.segmentation.subject import Subject
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import electrons_per_gram
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.transmission import Transmission

ENERGY, WEIGHTS = np.linspace(25.0, 120.0, 39), np.ones(39)
PE, COMPTON = BasisFunction("photoelectric"), BasisFunction("compton")
KEDGE = Basis((PE, COMPTON, BasisFunction("step", edge_energy=63.3)))
DUAL = Basis((PE, COMPTON))
AGENTS = Basis((PE, COMPTON, BasisFunction("element", element="I"), BasisFunction("element", element="Gd")))
STEPS = Basis((PE, COMPTON, BasisFunction("step", element="Gd")))
BONE_WATER = Basis(
    (BasisFunction("material", composition="Water, Liquid"), BasisFunction("material", composition="cortical bone"))
)
TISSUE, BONE, LOW, HIGH = (0.0015, 0.0188, 0), (0.0173, 0.032, 0), (0.0041, 0.0179, 0.0125), (0.0067, 0.018, 0.025)
GRID = Grid.cube(28, 56.0)


@cache
def readouts_of(basis):
    return Readouts.of(basis, ENERGY, WEIGHTS)


def solution(element, amount):
    """A contrast agent in water [mg/ml]."""
    water = 1.0 - amount / 1000 / 10
    total = water + amount / 1000
    shares = {"H": 0.1119 * water / total, "O": 0.8881 * water / total, element: amount / 1000 / total}
    return Material("vial", total, shares)


def boxes(materials, noise=0.0, seed=0):
    """Volumes of boxes of materials in the first one, and their labels."""
    labels = np.zeros(GRID.shape, int)
    labels[1:-1, 1:-1, 1:-1] = 1
    for i in range(1, len(materials)):
        row, column = divmod(i - 1, 2)
        labels[5:-5, 5 + 11 * row : 12 + 11 * row, 5 + 11 * column : 12 + 11 * column] = i + 1
    table = np.array([np.zeros(len(materials[0])), *materials])
    volumes = np.moveaxis(table[labels], -1, 0)
    return volumes + np.random.default_rng(seed).normal(scale=noise, size=volumes.shape), labels


def subject_of(volumes, basis, gaussians=None):
    return Subject(volumes.astype(np.float32), GRID, basis, ENERGY, WEIGHTS, gaussians)


def lattice(labels, materials, basis):
    """Gaussians on every second voxel edge, which sum to the materials in their inside."""
    step, width = 1.0, 0.7
    axis = np.arange(-27.0, 27.5, step)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    index = tuple(np.clip(((points[:, a] + 27) / 2 + 0.5).astype(int), 0, 27) for a in (2, 1, 0))
    own = labels[index]
    points, own = points[own > 0], own[own > 0]
    values = np.array(materials)[own - 1] / (np.sqrt(2 * np.pi) * width / step) ** 3
    turn = torch.zeros(len(own), 4)
    turn[:, 0] = 1
    parts = torch.from_numpy(points).float(), torch.full((len(own), 3), float(np.log(width))), turn
    return Gaussians(*parts, torch.from_numpy(values).float(), basis.names)


def dice_of(labels, found, count):
    table = confusion(labels, found.labels, count, len(found.clusters))
    matched = match(table)
    return np.array([dice(table)[i + 1, c + 1] if c >= 0 else 0.0 for i, c in enumerate(matched)])


@pytest.mark.parametrize("noise", [0.0, 1e-4, 6e-4])
def test_voxels_of_four_materials_are_all_found(noise):
    volumes, labels = boxes((TISSUE, BONE, LOW, HIGH), noise)
    found = segment_subject(subject_of(volumes, KEDGE), Options())
    assert [c.name for c in found.clusters] == ["soft tissue", "bone-like", "K-edge 63.3 keV 1", "K-edge 63.3 keV 2"]
    assert dice_of(labels, found, 4).min() > 0.99
    np.testing.assert_allclose([c.coefficients for c in found.clusters], [TISSUE, BONE, LOW, HIGH], atol=noise + 1e-6)


def test_a_model_of_two_bases_is_segmented_without_k_edges():
    volumes, labels = boxes((TISSUE[:2], BONE[:2]))
    found = segment_subject(subject_of(volumes, DUAL), Options())
    assert [c.name for c in found.clusters] == ["soft tissue", "bone-like"]
    assert dice_of(labels, found, 2).min() == 1.0


def test_several_k_edge_columns_are_told_apart():
    amounts = (("I", 4), ("I", 12), ("Gd", 8))
    rows = [m.coefficients_in(AGENTS, ENERGY, WEIGHTS) for m in (WATER, *(solution(*a) for a in amounts))]
    found = segment_subject(subject_of(boxes(rows)[0], AGENTS), Options())
    assert [c.name for c in found.clusters] == ["soft tissue", "K-edge I 1", "K-edge I 2", "K-edge Gd"]
    measured = [[c.concentrations["I"], c.concentrations["Gd"]] for c in found.clusters]
    np.testing.assert_allclose(measured, [[0, 0], [4, 0], [12, 0], [0, 8]], atol=0.02)


@pytest.mark.parametrize("features", ["local", "own"])
def test_gaussians_are_labelled_by_their_materials(features):
    materials = (TISSUE, BONE, LOW, HIGH)
    _, labels = boxes(materials)
    model = lattice(labels, materials, KEDGE)
    found = segment_subject(subject_of(model.volume(GRID), KEDGE, model), Options(features=features))
    own = found.gaussian_labels
    assert own is not None
    index = tuple(np.clip(((model.centres.numpy()[:, a] + 27) / 2 + 0.5).astype(int), 0, 27) for a in (2, 1, 0))
    inside = (minimum_filter(labels, 3) == maximum_filter(labels, 3))[index]
    np.testing.assert_array_equal(own[inside], labels[index][inside] - 1)
    assert dice_of(labels, found, 4).min() > 0.9
    total = model.coefficients.numpy().sum(axis=1)
    np.testing.assert_allclose(found.gaussian_densities.sum(axis=1), total, rtol=1e-6)
    np.testing.assert_allclose(found.materials.sum(axis=0), model.volume(GRID).sum(axis=0), atol=1e-5)


def test_beside_a_pin_of_metal_whose_blur_replaces_tissue_there_is_no_air():
    materials = (TISSUE, (0.6, 0.09, 0))
    labels = boxes((TISSUE,))[1]
    labels[4:24, 12:16, 12:16] = 2
    blurred = maximum_filter(labels, 5) - labels == 1
    model = lattice(np.where(blurred, 0, labels), materials, KEDGE)
    metal = model.coefficients[:, 0] > 0.01
    model.log_scales[metal] += np.log(2.5)
    model.coefficients[metal] /= 2.5**3
    volume = model.volume(GRID)
    denser = minimum_filter(volume.sum(axis=0), 3) > sum(TISSUE)
    assert np.count_nonzero(blurred & denser) > 100
    found = segment_subject(subject_of(volume, KEDGE, model), Options())
    assert [c.name for c in found.clusters] == ["soft tissue", "metal"]
    assert (found.labels[denser] > 0).all()


def test_flattened_gaussians_do_not_change_what_is_found():
    """Coefficients of Gaussians vary by a factor, places do not: local values see places."""
    materials = (TISSUE, BONE, LOW, HIGH)
    _, labels = boxes(materials)
    model = lattice(labels, materials, KEDGE)
    uneven = torch.from_numpy(np.random.default_rng(3).uniform(0.4, 1.6, (len(model), 1))).float()
    mixed = Gaussians(
        model.centres, model.log_scales, model.quaternions, model.coefficients * uneven, model.basis_names
    )
    volumes = model.volume(GRID)
    found = segment_subject(subject_of(volumes, KEDGE, mixed), Options())
    assert len(found.clusters) == 4


def test_half_filled_voxels_between_two_materials_are_none_of_a_third():
    volumes, _ = boxes((TISSUE, HIGH, LOW))
    soft = volumes.copy()
    soft[:, :, :, 5] = (volumes[:, :, :, 4] + volumes[:, :, :, 6]) / 2  # the mean of HIGH and TISSUE is about LOW
    found = segment_subject(subject_of(soft, KEDGE), Options())
    names = [c.name for c in found.clusters]
    assert len(names) == 3
    assert not (found.labels[8:-8, 6:11, 5] == 1 + names.index("K-edge 63.3 keV 1")).any()


def test_ribs_and_wires_without_an_inside_are_materials():
    steel = (0.6, 0.09, 0)
    volumes, labels = boxes((TISSUE,))
    for kind, material, filled in ((2, BONE, (0.6, 1.0, 0.6)), (3, steel, (0.3, 1.0, 0.3))):  # three voxels across
        for row, across in ((4, 0), (12, 1), (20, 2)):
            for i, part in enumerate(filled):
                place = (slice(3, 25), row + i, 6 + 12 * (kind - 2) + across)
                volumes[(slice(None), *place)] = np.outer(
                    part * np.array(material) + (1 - part) * np.array(TISSUE), np.ones(22)
                )
                if part >= 0.5:
                    labels[place] = kind
    found = segment_subject(subject_of(volumes, KEDGE), Options())
    assert [c.name for c in found.clusters] == ["soft tissue", "bone-like", "metal"]
    assert dice_of(labels, found, 3).min() == 1.0
    np.testing.assert_allclose([c.coefficients for c in found.clusters], [TISSUE, BONE, steel], rtol=1e-5)


def test_noise_alone_is_no_thin_material():
    volumes, _ = boxes((TISSUE,), noise=3e-3)
    assert [c.name for c in segment_subject(subject_of(volumes, KEDGE), Options()).clusters] == ["soft tissue"]


def test_solutions_are_told_apart_from_what_differs_little():
    contents = [TISSUE, (0.0015, 0.0178, 0), (0.0017, 0.0188, 0.0007), (0.0173, 0.032, 0)]
    volumes, labels = boxes(contents, noise=5e-5)
    found = segment_subject(subject_of(np.maximum(volumes, 0), KEDGE), Options())
    assert dice_of(labels, found, 4).min() > 0.99


def test_a_lung_is_one_material_though_its_ratio_is_noisier():
    lung = (0.0004, 0.0053)
    volumes, labels = boxes([TISSUE[:2], lung])
    volumes[:, labels == 1] *= np.random.default_rng(0).normal(1, 5e-4, volumes[:, labels == 1].shape)
    volumes[0, labels == 2] *= np.random.default_rng(1).normal(1, 0.15, np.count_nonzero(labels == 2))
    found = segment_subject(subject_of(volumes, DUAL), Options(domain="voxels"))
    assert len(found.clusters) == 2
    assert min(dice_of(labels, found, 2)) > 0.95


def test_a_mode_in_the_tail_of_a_lung_is_no_material(monkeypatch):
    volumes, labels = boxes([TISSUE[:2], (0.0004, 0.0053)])
    places = np.indices(GRID.shape)[:, labels == 2]
    ratio = 1 + np.exp(-([1, 0.4, 0.2] @ (places - places.min(axis=1, keepdims=True))) / 3)
    volumes[0, labels == 2] *= ratio * np.random.default_rng(0).normal(1, 0.01, len(ratio))
    features = features_of(Mechanisms.of(DUAL, ENERGY, WEIGHTS), volumes)
    lung = features[:, labels == 2]
    modes = np.array([features[:, labels == 1].mean(axis=1), np.median(lung, axis=1), np.quantile(lung, 0.9, axis=1)])
    monkeypatch.setattr("recon.segmentation.local_values.find_modes", lambda *_: modes)
    found = segment_subject(subject_of(volumes, DUAL), Options(domain="voxels"))
    assert len(found.clusters) == 2
    assert min(dice_of(labels, found, 2)) == 1.0


def test_one_material_is_one_cluster():
    found = segment_subject(subject_of(boxes((TISSUE,))[0], KEDGE), Options())
    assert [c.name for c in found.clusters] == ["soft tissue"]


@pytest.mark.parametrize(
    ("volumes", "options", "said"),
    [
        (np.zeros((3, *GRID.shape)), {}, "nothing to segment"),
        (boxes((TISSUE,))[0], {"domain": "gaussians"}, "no Gaussians"),
        (boxes((TISSUE,))[0], {"domain": "voxels", "features": "own"}, "of their own"),
    ],
)
def test_what_cannot_be_segmented_is_refused(volumes, options, said):
    with pytest.raises(InputError, match=said):
        segment_subject(subject_of(volumes, KEDGE), Options(**options))


@pytest.mark.parametrize(
    "options", [{"domain": "rays"}, {"features": "none"}, {"bandwidth": 0}, {"energies": (5.0,)}, {"energies": (900,)}]
)
def test_options_that_cannot_be_are_refused(options):
    with pytest.raises(InputError):
        Options(**options)


def mayneord(material):
    """Effective atomic number by Mayneord's power law, exponent 2.94, from elements alone."""
    numbers = {"H": 1, "C": 6, "N": 7, "O": 8, "Na": 11, "P": 15, "Ca": 20, "Al": 13}
    weights = {"H": 1.008, "C": 12.011, "N": 14.007, "O": 15.999, "Na": 22.99, "P": 30.974, "Ca": 40.078, "Al": 26.982}
    electrons = {e: share * numbers[e] / weights[e] for e, share in material.items()}
    total = sum(electrons.values())
    return sum(n / total * numbers[e] ** 2.94 for e, n in electrons.items()) ** (1 / 2.94)


MIXTURES = {
    "water": ({"H": 0.1119, "O": 0.8881}, 1.0),
    "bone": ({"H": 0.034, "C": 0.155, "N": 0.042, "O": 0.435, "P": 0.1, "Ca": 0.234}, 1.92),
    "aluminium": ({"Al": 1.0}, 2.699),
    "acrylic": ({"H": 0.0805, "C": 0.5999, "O": 0.3196}, 1.19),
    "carbon": ({"C": 1.0}, 2.0),
}


@pytest.mark.parametrize(
    ("basis", "name"),
    [(basis, name) for basis in (DUAL, KEDGE) for name in MIXTURES]
    + [
        (BONE_WATER, name) for name in ("water", "bone", "aluminium")
    ],  # what is lighter than water is no mixture of them
    ids=lambda value: value if isinstance(value, str) else value.names[0] + str(len(value)),
)
def test_atomic_numbers_and_electron_densities_are_those_of_the_composition(basis, name):
    shares, density = MIXTURES[name]
    readouts = readouts_of(basis)
    values = Material("m", density, shares).coefficients_in(basis, ENERGY, WEIGHTS)
    number, electrons = readouts.electrons(values)
    true = density * electrons_per_gram(shares) / electrons_per_gram("Water, Liquid")
    assert float(electrons) == pytest.approx(true, rel=0.025)
    assert float(number) == pytest.approx(mayneord(shares), rel=0.05)


def test_a_thin_wall_is_none_of_what_is_on_its_sides():
    volumes, labels = boxes((TISSUE, BONE))
    bone = np.array(BONE)[:, None, None, None]
    volumes[:, 5:-5, 1:8, 5:12], labels[5:-5, 1:8, 5:12] = 0, 0
    volumes[:, 5:-5, 3:12, 5:12], labels[5:-5, 3:12, 5:12] = bone, 2
    volumes[:, 5:-5, 1:3, 5:12], labels[5:-5, 1:3, 5:12] = np.array(TISSUE)[:, None, None, None], 1
    found = segment_subject(subject_of(volumes, KEDGE), Options())
    assert dice_of(labels, found, 2).min() > 0.99


@pytest.mark.parametrize("energy", [30.0, 70.0, 120.0])
@pytest.mark.parametrize("basis", [DUAL, AGENTS], ids=["two", "agents"])
def test_water_is_zero_hounsfield_at_every_energy(energy, basis):
    readouts = readouts_of(basis)
    assert float(readouts.hounsfield(readouts.water, energy)) == pytest.approx(0, abs=1e-9)
    assert float(readouts.hounsfield(0 * readouts.water, energy)) == -1000


def test_monoenergetic_images_follow_the_exact_curve():
    readouts = readouts_of(DUAL)
    acrylic = Material("acrylic", composition="PMMA")
    values = acrylic.coefficients_in(DUAL, ENERGY, WEIGHTS)
    for energy in (40.0, 70.0, 100.0):
        at = np.array([energy])
        exact = 1000 * (acrylic.attenuation(at)[0] / WATER.attenuation(at)[0] - 1)
        assert float(readouts.hounsfield(values, energy)) == pytest.approx(exact, abs=6)


@pytest.mark.parametrize(("basis", "slack"), [(AGENTS, 1e-3), (STEPS, 0.15)], ids=["element", "step"])
def test_concentration_and_virtual_non_contrast_of_a_solution(basis, slack):
    readouts = readouts_of(basis)
    values = solution("Gd", 10).coefficients_in(basis, ENERGY, WEIGHTS)
    assert float(readouts.concentration(values, "Gd")) == pytest.approx(10, rel=slack)
    plain = readouts.without_contrast(values)
    assert float(readouts.hounsfield(plain, 70.0)) == pytest.approx(0, abs=15)
    assert float(readouts.hounsfield(values, 70.0)) > 300


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.2, 3.0), energy=st.floats(25, 140))
def test_attenuation_is_linear_in_the_coefficients(scale, energy):
    readouts = readouts_of(AGENTS)
    values = np.array([0.002, 0.018, 0.003, 0.001])
    assert readouts.attenuation(scale * values, energy) == pytest.approx(scale * readouts.attenuation(values, energy))
    assert readouts.electrons(scale * values)[0] == pytest.approx(readouts.electrons(values)[0], rel=1e-9)


def test_the_spectrum_is_found_again_from_nodes():
    transmission = Transmission.from_spectrum(WEIGHTS[None], KEDGE.evaluate(ENERGY))
    energy, weights = detected_spectrum(KEDGE, transmission)
    np.testing.assert_allclose(energy, ENERGY, atol=0.026)
    np.testing.assert_array_equal(weights, WEIGHTS)


def test_mechanisms_of_photoelectric_and_compton_are_themselves():
    np.testing.assert_allclose(Mechanisms.of(KEDGE, ENERGY, WEIGHTS).matrix, np.eye(2), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_samples_far_apart_are_modes_without_a_warning(count):
    samples = 100.0 * np.arange(count)[:, None] * np.ones(2)
    modes = find_modes(samples, np.ones(2))
    np.testing.assert_allclose(modes[np.argsort(modes[:, 0])], samples)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), clusters=st.integers(1, 5))
def test_modes_lie_at_clusters_that_are_far_apart(seed, clusters):
    rng = np.random.default_rng(seed)
    centres = 20.0 * np.array([[i, (i * i) % 5, -i] for i in range(clusters)])
    samples = np.repeat(centres, 60, axis=0) + rng.normal(scale=0.5, size=(60 * clusters, 3))
    modes = find_modes(samples, np.ones(3))
    nearest = nearest_mode(centres, modes, np.ones(3))
    assert len(modes) == clusters
    assert sorted(nearest) == list(range(clusters))
    np.testing.assert_allclose(modes[nearest], centres, atol=0.6)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), features=st.integers(2, 5), apart=st.floats(6, 50))
def test_what_falls_all_the_way_is_a_tail_and_what_lies_behind_a_valley_is_none(seed, features, apart):
    rng = np.random.default_rng(seed)
    mode, other = np.zeros(features), np.full(features, apart / np.sqrt(features))
    noise = rng.normal(scale=0.2, size=(6000, features))
    assert is_tail(noise + rng.exponential(3.0, 6000)[:, None] * other / apart, mode, other * min(1.0, 8.0 / apart))
    assert not is_tail(noise + np.repeat([mode, other], [5500, 500], axis=0), mode, other)


def test_a_rim_between_two_clusters_is_no_material():
    inner = np.ones((9, 9, 9), np.uint16)
    inner[:, :, 4], inner[:, :, 5:] = 2, 3
    assert rims(inner, 3).tolist() == [False, True, False]


def test_edges_belong_to_what_is_near():
    inner = np.zeros((9, 9, 20), np.uint16)
    inner[..., :5], inner[..., 6:12], inner[..., 17:] = 1, 2, 3
    centres = np.array([[0.0, 1.0], [0.0, 3.0], [0.0, 2.0]])
    parts = np.zeros((2, 9, 9, 20))
    parts[1] = 2.1  # most like the third, which is far from voxel 5
    found = label_edges(inner, parts, np.zeros(inner.shape, bool), centres)
    assert (found[..., 5] == 2).all()
    assert (found[..., 15] == 3).all()
    np.testing.assert_array_equal(found[inner > 0], inner[inner > 0])


def test_clusters_are_ordered_by_kappa_and_then_by_their_edges():
    features = np.array([[3, 0.4, 0, 0.3], [2, 0.4, 0, 0], [1, 0.1, 0, 0], [2, 0.2, 0.5, 0], [2, 0.2, 0.1, 0]])
    assert ordered(features).tolist() == [2, 1, 4, 3, 0]


@pytest.mark.parametrize(
    ("features", "number", "group"),
    [
        ([0.02, 0.1, 0.0], 7.5, "soft tissue"),
        ([0.05, 0.4, 0.01], 13.0, "bone-like"),
        ([0.5, 2.0, 0.0], 26.0, "metal"),
        ([0.03, 0.1, 0.3], 7.5, "K-edge Gd"),
        ([0.05, 0.4, 0.0], np.nan, "bone-like"),
    ],
)
def test_kinds_follow_from_numbers(features, number, group):
    assert kind_of(np.array(features), number, ("kedge_Gd",)).group == group


def test_colours_of_different_clusters_differ():
    kinds = [kind_of(np.array([0.02, 0.1, part]), 7.5, ("kedge_I",)) for part in (0, 0, 0.1, 0.2, 0.3)]
    colours = colours_of(kinds)
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=2)[~np.eye(5, dtype=bool)]
    assert distances.min() > 0.1
    assert names_of(kinds) == ["soft tissue 1", "soft tissue 2", "K-edge I 1", "K-edge I 2", "K-edge I 3"]


def test_matching_finds_a_permutation_and_leaves_the_rest():
    truth = np.repeat([0, 1, 2, 3], 10)
    found = np.repeat([0, 3, 1, 2], 10)
    table = confusion(truth, found, 3, 4)
    assert match(table).tolist() == [2, 0, 1]
    assert dice(table)[1, 3] == 1.0
    assert match(confusion(truth, np.where(found == 1, 0, found), 3, 4)).tolist() == [2, -1, 1]


def test_a_picture_is_black_without_and_saturates_with_much_material():
    lengths = np.array([[[0.0, 50.0, 1.0]], [[0.0, 0.0, 1.0]]])
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    image = picture(lengths, colours)
    np.testing.assert_allclose(image[0, :2], [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(image[0, 2], np.array([0.5, 0, 0.5]) * (1 - np.exp(-2)))


def test_voxels_in_the_inside_are_full():
    materials = np.full((2, 5, 5, 5), 0.4)
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    image = slices_rgb(materials, np.ones(2), colours, np.ones((5, 5, 5), bool))
    np.testing.assert_allclose(image[2, 2, 2], [0.5, 0.5, 0])


@pytest.mark.parametrize("angles", [(0.0, 0.0), (90.0, 0.0), (30.0, 35.0), (0.0, 90.0)])
def test_a_view_from_anywhere_holds_all_of_the_volume(angles):
    volumes, _ = boxes((TISSUE, BONE, LOW, HIGH))
    density = volumes.sum(axis=0)[None]
    geometry = views_around(GRID, [angles], density[0] > 0)
    lengths = voxel_lengths(density, GRID, geometry)[0, 0]
    pixel = geometry.panel.row_pitch * geometry.panel.column_pitch
    assert lengths.sum() * pixel == pytest.approx(density.sum() * GRID.voxel_volume, rel=0.01)


def test_views_are_seen_the_right_way_up_and_round():
    volume = np.zeros((1, *GRID.shape))
    volume[0, 22:, 20:, 10:18] = 1  # up and at positive y
    rows, columns = np.nonzero(voxel_lengths(volume, GRID, views_around(GRID, [(0.0, 0.0)]))[0, 0] > 1)
    panel = views_around(GRID, [(0.0, 0.0)]).panel
    assert rows.mean() < panel.rows / 2  # +z is up
    assert columns.mean() > panel.columns / 2  # from +x, +y is to the right


@pytest.mark.parametrize("text", ["", "a", "1,2,3", "nan", "400", "0,1e9"])
def test_views_that_cannot_be_are_refused(text):
    with pytest.raises(InputError, match="--view"):
        parse_views([text])


def test_views_are_azimuth_and_elevation():
    assert parse_views(["30", "-20,45"]) == ((30.0, 0.0), (-20.0, 45.0))


def test_energies_are_those_of_a_table():
    assert check_energies([40, 70]) == (40, 70)


def test_similarity_of_equal_pictures_and_of_noise():
    rng = np.random.default_rng(0)
    image = rng.random((16, 20, 3))
    same = image_similarity([(image, image)])
    assert same == {"psnr": None, "ssim": pytest.approx(1.0), "lpips": None}
    off = image_similarity([(image + 0.1, image), (image - 0.1, image)])
    assert off["psnr"] == pytest.approx(20.0)
    assert image_similarity([(image[:5], image[:5])])["ssim"] is None


def test_lpips_is_used_where_package_and_weights_are(monkeypatch, tmp_path):
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "alexnet-owt.pth").touch()
    package = ModuleType("lpips")
    package.LPIPS = lambda net, verbose: lambda a, b: (a - b).abs().mean()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lpips", package)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    image = np.full((12, 12, 3), 0.5)
    assert image_similarity([(image, image + 0.25)])["lpips"] == pytest.approx(0.5)  # colours are doubled to -1 .. 1
