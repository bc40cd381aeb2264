"""Simulated scans: closed forms, noise, determinism, and only what the scene needs."""

import h5py
import numpy as np
import pytest
from support.edited_datasets import edited_dataset

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from phantomgen.simulation.checks.verification import full_check
from phantomgen.simulation.forward_model.energy_grids import (
    compressed_transmission,
    fine_transmission,
    reconstructor_spectra,
)
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.run import simulate
from spectra.elements.attenuation import linear_attenuation, mass_attenuation
from spectra.errors import DatasetError, InputError, SceneError
from spectra.threads import set_threads

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 3, test_views: 2}
panel: {rows: 13, columns: 15, pitch: 2}
volume: {voxels: 10, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
  bone: {coefficients: {photoelectric: 0.02, compton: 0.03}}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 4
"""
ONE_ENERGY = ("source={type: monochromatic, energy: 70, photons: 10000}", "detector.thresholds=[20]")


def toy(*overrides: str) -> Scan:
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def made(tmp_path, *overrides, **options):
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.h5"
    return path, simulate(toy(*overrides), path, **options)


def counts_of(path):
    with open_dataset(path) as dataset:
        return dataset.load()


def test_an_option_that_does_not_exist_is_refused_before_any_work(tmp_path):
    with pytest.raises(TypeError, match="unexpected keyword argument 'tol'"):
        made(tmp_path, tol=1e-3)
    assert list(tmp_path.iterdir()) == []


def test_the_central_ray_obeys_beer_and_lambert(tmp_path):
    path, _ = made(tmp_path, "noise=false", "panel.pitch=0.01")
    mu = linear_attenuation("H2O", 1.0, np.array([60.0]))[0]
    with open_dataset(path) as dataset:
        air, central = dataset.flat[1, 6, 7], dataset.load()[:, 1, 6, 7]
        sensor = linear_attenuation("CdTe", 5.85, np.array([60.0]))[0]
    assert air == pytest.approx(1e4 * -np.expm1(-1.6 * sensor), rel=1e-6)
    assert np.log(air / central) == pytest.approx(10 * mu, rel=1e-5)


def test_pixels_average_intensities_over_their_area(tmp_path):
    path, _ = made(tmp_path, "noise=false", "panel={rows: 3, columns: 3, pitch: 8}")
    mu = linear_attenuation("H2O", 1.0, np.array([60.0]))[0]
    grid = (np.arange(1500) + 0.5) / 1500 * 24 - 12
    y, z = np.meshgrid(grid, grid)
    squared_distance = 100**2 * (y**2 + z**2) / (200**2 + y**2 + z**2)
    chord = 2 * np.sqrt(np.maximum(25 - squared_distance, 0))
    with open_dataset(path) as dataset:
        share = (dataset.load()[0, 1] / dataset.flat[1]).mean()
    assert share == pytest.approx(np.exp(-mu * chord).mean(), rel=2e-5)


def test_noise_is_poisson_around_the_expected_counts(tmp_path):
    path, _ = made(tmp_path, keep_expected=True)
    with open_dataset(path) as dataset:
        counts, mean = dataset.load()[:, 1], dataset.file["truth/expected"][:, 1]
        flats = dataset.file["entry/instrument/flat/data"][:, 1]
        level = dataset.spectra.weights.sum(axis=1)[1]
    chi_square = ((counts - mean) ** 2 / mean).mean()
    assert chi_square == pytest.approx(1.0, abs=5 * np.sqrt(2 / counts.size))
    assert abs(flats.mean() - level) < 5 * np.sqrt(level / flats.size)


def test_threads_and_repetition_do_not_change_the_counts(tmp_path):
    paths = []
    for threads in (1, 2, 2):
        set_threads(threads)
        paths.append(made(tmp_path)[0])
    set_threads(None)
    first, *others = [counts_of(path) for path in paths]
    assert all(np.array_equal(first, other) for other in others)
    assert not np.array_equal(first, counts_of(made(tmp_path, "seed=1")[0]))


def test_the_same_scene_and_date_give_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert made(tmp_path)[0].read_bytes() == made(tmp_path)[0].read_bytes()


def test_a_simulated_dataset_is_valid(tmp_path):
    path, summary = made(tmp_path)
    assert validate(path) == []
    assert summary.size == path.stat().st_size
    assert list(tmp_path.iterdir()) == [path]


def test_one_energy_means_one_energy_everywhere(tmp_path):
    path, summary = made(tmp_path)
    with open_dataset(path) as dataset:
        assert dataset.spectra.energy.tolist() == [60.0]
        assert dataset.spectra.basis.names == ("photoelectric", "compton")
    assert summary.plan.nodes == (0, 1)
    assert len(read_truth(path).volumes) == 2


def test_a_channel_that_counts_nothing_stays_zero(tmp_path):
    path, summary = made(tmp_path)
    counts = counts_of(path)
    assert summary.plan.nodes == (0, 1)
    assert not counts[:, 0].any()
    assert counts[:, 1].min() > 0
    assert np.isfinite(summary.error.edge_worst)


def test_one_photon_per_pixel_one_view_one_voxel(tmp_path):
    tiny = ("source.photons=1", "geometry.views=1", "geometry.test_views=0", "volume.voxels=1", "flats=1", "darks=0")
    path, _ = made(tmp_path, *tiny)
    assert validate(path) == []
    assert counts_of(path).max() < 10
    truth = read_truth(path)
    assert truth.fractions.shape == (1, 1, 1, 1)
    assert truth.fractions[0, 0, 0, 0] / 65535 == pytest.approx(4 / 3 * np.pi * 125 / 20**3, rel=1e-3)


def test_a_source_inside_an_object_sees_only_what_is_in_front(tmp_path):
    path, _ = made(tmp_path, "noise=false", "panel.pitch=0.01", "objects.0.center=[100, 0, 0]", "geometry.views=1")
    mu = linear_attenuation("H2O", 1.0, np.array([60.0]))[0]
    with open_dataset(path) as dataset:
        assert np.log(dataset.flat[1, 6, 7] / dataset.load([0])[0, 1, 6, 7]) == pytest.approx(5 * mu, rel=1e-5)


def test_truth_holds_the_volume_of_every_cylinder():
    from phantomgen.simulation.forward_model.truth import scan_truth

    truth = scan_truth(load_scene("kedge-small", ONE_ENERGY))
    inner = np.pi * 80 * np.array([13.0, 11.0, 9.0]) ** 2
    closed = np.array([np.pi * 50**2 * 100 - inner.sum(), *inner])
    voxel = truth.grid.voxel_volume
    assert truth.fractions.sum(axis=(1, 2, 3)) / 65535 * voxel == pytest.approx(closed, rel=2e-5)
    assert truth.volumes.sum(axis=(1, 2, 3), dtype=float) * voxel == pytest.approx(
        closed @ truth.coefficients, rel=1e-5
    )
    centre_of_bone = truth.volumes[:, 32, 35, 21]
    assert centre_of_bone == pytest.approx([0.0173, 0.0320, 0.0], abs=1e-8)


def test_compositions_are_simulated_exactly_and_fitted_for_the_truth(tmp_path):
    path, _ = made(tmp_path, "source={type: tube, kvp: 100, photons: 10000}", "noise=false", "panel.pitch=0.01")
    scan = toy("source={type: tube, kvp: 100, photons: 10000}")
    energies = np.linspace(50, 100, 4001)
    density = scan.source.density_at(energies)
    eff = scan.detector.absorption(energies)
    passed = np.exp(-10 * linear_attenuation("H2O", 1.0, energies))
    lines = scan.source.line_energy, scan.source.line_photons
    kept = lines[0] > 50
    line_eff = scan.detector.absorption(lines[0][kept]) * lines[1][kept]
    line_pass = np.exp(-10 * linear_attenuation("H2O", 1.0, lines[0][kept]))
    exact = (np.trapezoid(density * eff * passed, energies) + line_eff @ line_pass) / (
        np.trapezoid(density * eff, energies) + line_eff.sum()
    )
    with open_dataset(path) as dataset:
        assert dataset.load([0])[0, 1, 6, 7] / dataset.flat[1, 6, 7] == pytest.approx(exact, rel=1e-4)
        fitted = dataset.spectra.transmission()
    truth = read_truth(path)
    projection = fitted.log_projection(10 * truth.coefficients[0])
    assert projection[1] == pytest.approx(-np.log(exact), rel=5e-3)


def test_the_simulator_is_finer_than_the_reconstructor_and_agrees_with_it():
    scan = load_scene("kedge-small")
    lengths = sampled_lengths(scan)
    fine, (few, error) = fine_transmission(scan), compressed_transmission(scan, lengths, 1e-5)
    coarse = reconstructor_spectra(scan)
    assert len(coarse.energy) * 4 < len(fine.weights)
    assert len(few.weights) < 60
    assert error < 1e-5
    sample = lengths[:: len(lengths) // 500]
    assert np.abs(few.log_projection(sample) - fine.log_projection(sample)).max() < 2e-5
    for cut in (45.0, 63.3, 80.0, 69.525):
        assert np.abs(coarse.edges - cut).min() < 1e-3
    width = np.diff(coarse.edges)[np.searchsorted(coarse.edges, scan.source.line_energy, side="right") - 1]
    assert (width[scan.source.line_energy > 20] < 0.05).all()


def test_counts_are_as_exact_as_promised():
    scan = load_scene("kedge-small", ["panel={rows: 32, columns: 32, pitch: 6.4}"])
    plan = make_plan(scan, 1e-3)
    from phantomgen.simulation.checks import verification as simulate_check

    error = simulate_check._check(scan, plan.exposure.transmission, plan.settings, 30, 2000)
    assert error.edge_pixels == 30
    assert error.edge_rms < 2e-4
    assert error.edge_worst < 1e-3
    assert error.ray_worst < 1e-3
    assert full_check is simulate_check.full_check


def test_what_the_panel_and_the_volume_cut_off_is_said_with_how_much():
    assert coverage_warnings(toy()) == []
    # The panel sees 13 mm to either side of its middle row, which the axis sees at half scale.
    (warning,) = coverage_warnings(toy("objects.0.radius=7", "volume.size=40"))
    assert "object 0 (water) leaves the panel's field of view in 100% of the views" in warning
    share = float(warning.split(": ")[1].split("%")[0])
    assert 0.5 < share < 10
    (warning,) = coverage_warnings(toy("volume.size=9"))
    assert "reaches 0.5 mm beyond the volume" in warning


def test_a_source_inside_an_object_is_allowed_and_said():
    scan = toy("objects.0={type: sphere, material: water, radius: 600}")
    warning = coverage_warnings(scan)[0]
    assert "object 0 (water) contains the source in 100% of the views" in warning
    assert f"{np.linalg.norm(scan.geometry.ray_frames()[0, 0]):.4g} mm from the centre" in warning


def test_an_object_that_nothing_is_left_of_is_said():
    base, cut = "{type: sphere, radius: 3}", "[{type: sphere, radius: 4}]"
    hollow = f"objects.0={{type: difference, material: water, base: {base}, cut: {cut}}}"
    assert coverage_warnings(toy(hollow)) == [
        "object 0 (water) is empty, or too thin to be found: no random point of its bounds lies inside it"
    ]


def test_a_failure_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="expected counts must lie in"):
        made(tmp_path, "source.photons=1e12")
    assert list(tmp_path.iterdir()) == []


def test_the_truth_says_what_is_explicit_and_what_is_fitted_how_well(tmp_path):
    path, summary = made(
        tmp_path,
        "source={type: tube, kvp: 100, photons: 10000}",
        "objects=[{type: sphere, material: water, radius: 5}, {type: sphere, material: bone, radius: 2}]",
    )
    with h5py.File(path) as file:
        table = file["truth/materials"]
        assert table["kind"].asstr()[()].tolist() == ["fitted", "explicit"]
        assert table["fit_window"][()].tolist() == [20.0, 100.0]
        assert table["fit_window"].attrs["units"] == "keV"
        assert "open-beam counts" in table["fit_weights"].asstr()[()]
    truth = read_truth(path)
    scan = load_scene(SceneFile("toy.yaml", truth.scene))
    with open_dataset(path) as dataset:
        spectra = dataset.spectra
    weights, water = spectra.weights.sum(axis=0), scan.scene.materials[0]
    fitted = truth.coefficients[0] @ spectra.basis_values
    residual = np.sqrt(np.average((fitted / water.attenuation(spectra.energy) - 1) ** 2, weights=weights))
    assert truth.fit.errors == pytest.approx([residual, 0.0], rel=0.05)
    assert 1e-4 < residual < 5e-3
    assert summary.warnings == []
    text = describe_text(describe(path))
    assert "materials  bone: explicit coefficients" in text
    assert "fitted over 20..100 keV, simulated exactly" in text
    assert f"water {truth.fit.errors[0]:.2%}" in text


def test_a_file_of_explicit_materials_says_so(tmp_path):
    path, _ = made(tmp_path, "objects.0.material=bone")
    described = describe(path)
    assert described["materials"]["kind"] == {"bone": "explicit"}
    assert described["materials"]["fit_error"] == {}
    assert "fitted" not in describe_text(described)


def test_a_basis_that_cannot_describe_a_material_is_said(tmp_path):
    _, summary = made(
        tmp_path,
        "source={type: tube, kvp: 100, photons: 10000}",
        "materials.water={composition: I}",
        "basis=[{type: photoelectric}, {type: compton}]",
    )
    (warning,) = summary.warnings
    assert "the basis describes material 'water' with an rms relative error of" in warning


def test_several_k_edges_go_all_the_way(tmp_path):
    vial = "{type: sphere, radius: 3, material: %s, center: [%g, 0, 0]}"
    path, summary = made(
        tmp_path,
        "source={type: tube, kvp: 120, photons: 100000}",
        "detector.thresholds=[20, 33.17, 50.24, 70]",
        "materials={iodine: {solution: {solvent: water, solutes: {I: 20}}},"
        " gadolinium: {solution: {solvent: water, solutes: {Gd: 10}}},"
        " both: {mixture: {by: volume, parts: {iodine: 0.5, gadolinium: 0.5}}}}",
        f"objects=[{vial % ('iodine', -6.5)}, {vial % ('both', 0)}, {vial % ('gadolinium', 6.5)}]",
        "noise=false",
        "panel={rows: 13, columns: 17, pitch: 2.4}",
    )
    assert summary.warnings == []
    assert validate(path) == []
    truth = read_truth(path)
    assert truth.basis_names == ("photoelectric", "compton", "kedge_I", "kedge_Gd")
    # An element's coefficient is its own attenuation just above 70 keV: mu/rho x concentration, nothing of the others.
    iodine, gadolinium = (mass_attenuation(e, np.array([70.01]))[0] for e in ("I", "Gd"))
    expected = np.array([[0.020 * iodine, 0], [0.010 * iodine, 0.005 * gadolinium], [0, 0.010 * gadolinium]]) / 10
    order = [truth.material_names.index(name) for name in ("iodine", "both", "gadolinium")]
    assert truth.coefficients[order][:, 2:] == pytest.approx(expected, rel=1e-9, abs=1e-15)
    assert (truth.fit.errors < 3e-3).all()
    scan = load_scene(SceneFile("toy.yaml", truth.scene))
    lengths = sampled_lengths(scan)
    with open_dataset(path) as dataset:
        told = dataset.spectra.transmission().log_projection(lengths @ truth.coefficients)
    assert told == pytest.approx(fine_transmission(scan).log_projection(lengths), rel=4e-3, abs=1e-6)


def test_many_materials_need_few_nodes():
    series = {f"i{c}": f"{{solution: {{solvent: water, solutes: {{I: {c}}}}}}}" for c in (0, 1, 2, 5, 8, 10, 15, 20)}
    vials = [
        f"{{type: sphere, radius: 2, material: {name}, center: [0, 0, {2 * i - 7}]}}" for i, name in enumerate(series)
    ]
    scan = toy(
        "source={type: tube, kvp: 100, photons: 10000}",
        f"materials={{{', '.join(f'{name}: {text}' for name, text in series.items())}}}",
        f"objects=[{', '.join(vials)}]",
    )
    lengths = sampled_lengths(scan)
    fine, (few, error) = fine_transmission(scan), compressed_transmission(scan, lengths, 1e-5)
    assert len(few.weights) < 40 < len(fine.weights)
    assert np.abs(few.log_projection(lengths) - fine.log_projection(lengths)).max() < 2 * error < 4e-5


LOW, HIGH = "{type: monochromatic, energy: 55, photons: 1.0e4}", "{type: monochromatic, energy: 90, photons: 2.0e4}"


def several(kind: str) -> str:
    return f"source={{type: {kind}, sources: {{low: {LOW}, high: {HIGH}}}}}"


def test_channels_of_several_sources_are_those_of_single_ones(tmp_path):
    path, _ = made(tmp_path, several("multi_source"), "detector.thresholds=[20]", "noise=false")
    singles = [made(tmp_path, f"source={one}", "detector.thresholds=[20]", "noise=false")[0] for one in (LOW, HIGH)]
    found = counts_of(path)
    np.testing.assert_allclose(found, np.concatenate([counts_of(p) for p in singles], axis=1), rtol=1e-6)
    with open_dataset(path) as dataset:
        assert dataset.spectra.channels == ("low_bin0", "high_bin0")
        assert (dataset.exposure == 1).all()
    assert validate(path) == []


def test_switched_sources_take_views_in_turn(tmp_path):
    both, _ = made(tmp_path, several("multi_source"), "detector.thresholds=[20]", "noise=false")
    path, _ = made(tmp_path, several("switching"), "detector.thresholds=[20]", "noise=false")
    turns = np.array([[1, 0], [0, 1], [1, 0], [1, 0], [0, 1]])  # three training views, then two test views
    np.testing.assert_array_equal(counts_of(path), counts_of(both) * turns[:, :, None, None])
    with open_dataset(path) as dataset:
        np.testing.assert_array_equal(dataset.exposure, turns)
        np.testing.assert_allclose(dataset.flat[:, 0, 0], dataset.spectra.transmission().open_beam, rtol=1e-6)
    assert validate(path) == []


def test_a_source_that_reaches_no_threshold_is_named():
    with pytest.raises(SceneError, match=r"thresholds.*channel bin1 starts at 60 keV"):
        toy(several("switching"), "detector.thresholds=[20, 60]")


def test_several_sources_are_two_or_more():
    with pytest.raises(SceneError, match=r"source\.sources - needs at least 2, got 1"):
        toy(f"source={{type: switching, sources: {{low: {LOW}}}}}")


@pytest.mark.parametrize("scale", [np.ones(3), np.ones((5, 3)), -np.ones(5), np.zeros((5, 2))])
def test_exposures_that_do_not_fit_are_refused(tmp_path, scale):
    path, _ = made(tmp_path)
    with edited_dataset(path) as file:
        del file["/entry/exposure/scale"]
        file["/entry/exposure/scale"] = scale
    with pytest.raises(DatasetError, match="exposure"):
        open_dataset(path)


@pytest.mark.parametrize("kind", ["multi_source", "switching"])
def test_energies_of_several_sources_are_summed_up_apart(tmp_path, kind):
    single = "detector={type: energy_integrating}"
    path, _ = made(tmp_path, several(kind), single)
    parts = [made(tmp_path, f"source={one}", single, "noise=false")[0] for one in (LOW, HIGH)]
    with open_dataset(path) as dataset:
        assert dataset.spectra.channels == ("low_signal", "high_signal")
        assert dataset.spectra.units == "keV"
        expected = np.concatenate([counts_of(p) for p in parts], axis=1) * dataset.exposure[:, :, None, None]
        quantum = np.array([55.0, 90.0])[:, None, None]
        np.testing.assert_allclose(dataset.spectra.quantum, quantum.ravel(), rtol=1e-6)
        taken = expected > 0
        sigma = np.sqrt(np.maximum(expected * quantum, 1e-30))
    difference = (counts_of(path) - expected)[taken] / sigma[taken]
    assert (counts_of(path)[~taken] == 0).all()
    assert abs(difference.mean()) < 5 / np.sqrt(difference.size)
    assert difference.var() == pytest.approx(1, abs=5 * np.sqrt(2 / difference.size))
    assert validate(path) == []
