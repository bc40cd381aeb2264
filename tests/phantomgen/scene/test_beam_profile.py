"""Bowtie filters and the heel effect: closed forms, brute force, files, and line integrals that do not notice them."""

import numpy as np
import pytest
from support.edited_datasets import edited_dataset

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.geometry.fan_angles import anode_angles, fan_angles, obliquity
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    EMPTY,
    NEAR,
    SMOOTH,
    VOXELS,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Cylinder, Sphere, solids_of
from phantomgen.simulation.run import simulate
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import read_measurements
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import linear_attenuation, natural_density
from spectra.errors import DatasetError, InputError, SceneError

BOWTIE = "{composition: Al, angles: [0, 4, 8, 12], thickness: [1, 3, 9, 20]}"
ONE_ENERGY = "{type: monochromatic, energy: 60, photons: 1.0e5, bowtie: %s}"
TUBE = "{type: tube, kvp: 120, photons: 1.0e6, filters: [{composition: Al, thickness: 2.5}], bowtie: %s, heel: %s}"
SCENE = """\
version: 1
name: toy
source: {source}
detector: {{type: photon_counting, thresholds: [20, 50]}}
geometry: {{type: circular, sod: 300, sdd: 500, views: 2}}
panel: {{rows: 24, columns: 32, pitch: 6}}
volume: {{voxels: 8, size: 50}}
materials:
  water: {{composition: H2O, density: 1.0}}
  bone: {{composition: cortical bone}}
objects:
  - {{type: sphere, material: water, radius: 22}}
  - {{type: cylinder, material: bone, radius: 5, length: 30}}
noise: false
"""
PANEL = Panel(24, 32, 6)


def scan_of(source, *overrides):
    return load_scene(SceneFile("toy.yaml", SCENE.format(source=source), overrides))


def made(tmp_path, source, *overrides, tolerance=None):
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.h5"
    return path, simulate(scan_of(source, *overrides), path, tolerance=tolerance)


def bowtie_lengths():
    """Length in the bowtie on the ray to each pixel [mm], from coordinates of pixels."""
    x, z = (np.arange(32) - 15.5) * 6, (11.5 - np.arange(24)[:, None]) * 6
    in_plane = np.interp(np.abs(np.degrees(np.arctan(x / 500))), [0, 4, 8, 12], [1, 3, 9, 20])
    return in_plane * np.sqrt(500**2 + x**2 + z**2) / np.sqrt(500**2 + x**2)


def test_one_energy_behind_a_bowtie_obeys_beer_and_lambert_in_every_pixel(tmp_path):
    mu = linear_attenuation("Al", natural_density("Al"), np.array([60.0]))[0]
    wanted = 1e5 * np.exp(-mu * (bowtie_lengths() - 1))
    sensor = -np.expm1(-1.6 * linear_attenuation("CdTe", 5.85, np.array([60.0]))[0])
    path, _ = made(tmp_path, ONE_ENERGY % BOWTIE)
    plain, _ = made(tmp_path, (ONE_ENERGY % BOWTIE).partition(", bowtie")[0] + "}")
    with open_dataset(path) as with_bowtie, open_dataset(plain) as without:
        assert with_bowtie.flat[1] == pytest.approx(wanted * sensor, rel=1e-6)
        # behind an object, too: at one energy the bowtie is a factor
        assert with_bowtie.load()[:, 1] == pytest.approx(without.load()[:, 1] * (wanted / 1e5), rel=2e-5)
        assert with_bowtie.spectra.source.sum() == pytest.approx(1e5)


def test_photons_are_those_at_the_panels_centre_behind_the_bowtie():
    for source in (ONE_ENERGY % BOWTIE, TUBE % (BOWTIE, "true")):
        scan = scan_of(source)
        assert scan.source.photons == pytest.approx(1e5 if "mono" in source else 1e6)
        assert (scan.profile.lengths[0] > 0).all()
    thin, thick = (scan_of(TUBE % (BOWTIE.replace("[1,", f"[{t},"), "false")).source for t in (0, 2))
    mean = [source.photons_in(np.array([20.0, 120.0]))[1][0] for source in (thin, thick)]
    assert mean[1] > mean[0] + 1  # the spectrum at the centre is that behind the bowtie's middle


def test_a_bowtie_may_lean_to_one_side():
    lopsided = "{composition: Al, angles: [-12, 0, 12], thickness: [4, 0, 0]}"
    lengths = scan_of(ONE_ENERGY % lopsided).profile.lengths[0]
    assert lengths[:, 16:] == pytest.approx(0)
    assert lengths[12, 0] > lengths[12, 8] > lengths[12, 14] > 0


def test_pixels_look_in_the_directions_that_their_coordinates_say():
    geometry = Geometry.circular(300, 500, np.array([0.7]), PANEL)
    source, corner, column_step, row_step = geometry.ray_frames()[0]
    rays = corner + np.arange(24)[:, None, None] * row_step + np.arange(32)[None, :, None] * column_step
    axis, side = -source / 300, column_step / 6
    in_plane = rays * [1, 1, 0]
    np.testing.assert_allclose(fan_angles(PANEL, 500), np.arctan2(in_plane @ side, in_plane @ axis), atol=1e-12)
    lengths = np.linalg.norm(rays, axis=2) / np.linalg.norm(in_plane, axis=2)
    np.testing.assert_allclose(obliquity(PANEL, 500), lengths, rtol=1e-12)
    towards = np.arctan2(rays @ [0, 0, 1], rays @ axis)
    np.testing.assert_allclose(anode_angles(PANEL, 500), towards, atol=1e-12)
    assert anode_angles(PANEL, 500)[0].min() > 0  # row 0 is on the anode's side


def test_the_heel_effect_weakens_and_hardens_the_beam_towards_the_anode(tmp_path):
    path, _ = made(tmp_path, TUBE % ("null", "true"))
    with open_dataset(path) as dataset:
        flat = dataset.flat
        middle, top, bottom = (flat[:, rows, 15:17].mean(axis=(1, 2)) for rows in (slice(11, 13), [0], [23]))
        assert dataset.spectra.profile.names == ("heel_1", "heel_2")
    assert top.sum() < 0.85 * middle.sum() < 0.85 * bottom.sum()
    assert top[1] / top[0] > 1.05 * middle[1] / middle[0] > 1.05 * bottom[1] / bottom[0]


# Absorber of the profile last: (material, node) at 33, 54, 72 and 110 keV, in 1/mm
ATTENUATION = np.array([[0.033, 0.023, 0.020, 0.017], [0.198, 0.070, 0.048, 0.033], [0.24, 0.09, 0.058, 0.044]])
SPECTRUM = Spectrum(ATTENUATION, np.array([1e4, 2e4, 3e4, 4e4]), np.array([0, 2, 4]))


@pytest.mark.parametrize("background", [-1, 0])
def test_exposed_pixels_behind_a_profile_agree_with_brute_force(background):
    frame = Geometry.circular(300, 500, np.array([0.3]), PANEL).ray_frames()[0]
    solids = solids_of([(Sphere((0, 0, 0), 22.0), 0), (Cylinder((3, 2, 0), 5.0, 30.0), 1)])
    profile = bowtie_lengths()[None] * 0.5
    spectrum = SPECTRUM._replace(profile=profile)
    found = expected_counts(frame, 24, 32, solids, spectrum, background)
    pixels = np.argwhere(found.classes >= SMOOTH)
    brute = expected_counts_by_grid(frame, pixels, solids, spectrum, background, n=96)
    error = np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / brute)
    assert np.abs(error).max() < 1e-3
    classes = found.classes[pixels[:, 0], pixels[:, 1]]
    assert np.abs(error[classes == SMOOTH]).max() < 3e-5
    assert np.abs(error[classes == NEAR]).max() < 1e-4  # 7e-5 without a profile: brute force itself
    if background < 0:
        empty = found.classes == EMPTY
        parts = SPECTRUM[1] * np.exp(-profile[0, empty][:, None] * ATTENUATION[-1])
        np.testing.assert_allclose(found.counts[:, empty].T, np.add.reduceat(parts, [0, 2], axis=1), rtol=1e-6)
    assert VOXELS not in found.classes


def test_a_profile_of_the_wrong_size_is_refused():
    frame = Geometry.circular(300, 500, np.array([0.3]), PANEL).ray_frames()[0]
    solids = solids_of([(Sphere((0, 0, 0), 22.0), 0)])
    with pytest.raises(InputError, match=r"shape \(1, 3, 32\) does not fit 24 x 32 pixels and 3 materials"):
        expected_counts(frame, 24, 32, solids, SPECTRUM._replace(profile=np.zeros((1, 3, 32))))


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """The same object in a plain beam, and behind a bowtie in one with heel effect."""
    folder = tmp_path_factory.mktemp("scans")
    return [made(folder, TUBE % pair)[0] for pair in (("null", "false"), (BOWTIE, "true"))]


def test_simulated_counts_are_as_exact_as_without(tmp_path):
    _, summary = made(tmp_path, TUBE % (BOWTIE, "true"), tolerance=1e-4)
    assert summary.plan.error < 1e-4
    assert summary.error.ray_worst < 5e-5
    assert summary.error.edge_rms < 2e-4


def test_a_dataset_with_a_profile_is_valid_and_tells_it(scans):
    assert validate(scans[1]) == []
    with open_dataset(scans[0]) as plain, open_dataset(scans[1]) as dataset:
        assert plain.spectra.profile is None
        profile = dataset.spectra.profile
        assert profile.names == ("bowtie", "heel_1", "heel_2")
        assert profile.lengths[0] == pytest.approx(bowtie_lengths() - 1, abs=1e-9)
        expected = dataset.spectra.weights @ np.exp(-profile.attenuation.T @ profile.lengths.reshape(3, -1))
        assert dataset.flat.reshape(2, -1) == pytest.approx(expected, rel=2e-3)


def test_line_integrals_do_not_notice_bowtie_and_heel(scans):
    found = []
    for path in scans:
        with open_dataset(path) as dataset:
            measured, _ = read_measurements(dataset, np.arange(2)).compressed(1e-5)
            found.append(decompose_views(measured)[0])
    assert np.abs(found[1] - found[0]).max() < 4e-3
    assert found[0].max() > 0.5
    with open_dataset(scans[1]) as dataset:  # without the profile they would
        blind = read_measurements(dataset, np.arange(2))
        assert blind.gains.min() > 0.998
        assert blind.gains.max() < 1.002


def test_other_basis_functions_keep_the_profile(scans):
    with open_dataset(scans[1]) as dataset:
        basis = Basis((*dataset.spectra.basis.functions, BasisFunction("step", edge_energy=61.7)))
        before, after = dataset.spectra, dataset.with_basis(basis).spectra
    assert len(after.energy) == len(before.energy) + 1
    assert after.profile.names == before.profile.names
    np.testing.assert_array_equal(after.profile.lengths, before.profile.lengths)
    lengths = np.random.default_rng(0).random((5, 2 + 3))
    counts = after.transmission().expected(np.insert(lengths, 2, 0.0, axis=1))
    np.testing.assert_allclose(counts, before.transmission().expected(lengths), rtol=1e-4)


def test_coarse_pixels_have_the_open_beam_of_those_that_they_are_made_of(scans):
    with open_dataset(scans[1]) as dataset:
        measured = read_measurements(dataset, np.arange(2))
    coarse = measured.binned(4)
    wanted = (measured.gains * measured.open_beam).reshape(2, 6, 4, 8, 4).sum(axis=(2, 4))
    assert coarse.gains * coarse.open_beam == pytest.approx(wanted, rel=1e-6)
    assert np.abs(decompose_views(coarse)[0]).max() < 2


def test_air_cannot_stand_in_for_flats_where_the_beam_differs(scans):
    with open_dataset(scans[1], "0:2,0:2") as dataset, pytest.raises(InputError, match="bowtie, heel_1, heel_2"):
        read_measurements(dataset, np.arange(2))


def test_a_damaged_profile_is_refused(scans, tmp_path):
    import shutil

    path = tmp_path / "damaged.h5"
    shutil.copy(scans[1], path)
    with edited_dataset(path) as file:
        del file["entry/spectra/profile/mu"]
        file["entry/spectra/profile/mu"] = np.ones((3, 5))
    with pytest.raises(DatasetError, match=r"profile/mu has shape \(3, 5\), expected \(3, \d+\)"):
        open_dataset(path)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            ONE_ENERGY % "{composition: Al, angles: [0, 5], thickness: [1, 2]}",
            "-10.54 .. 10.54 degrees, but .* -5 .. 5",
        ),
        (ONE_ENERGY % "{composition: Al, angles: [1, 12], thickness: [1, 2]}", "but the bowtie is given for 1 .. 12"),
        (ONE_ENERGY % "{composition: Al, angles: [0, 12], thickness: [1]}", "2 angles need as many thicknesses, got 1"),
        (ONE_ENERGY % "{composition: Al, angles: [0, 9, 4], thickness: [1, 2, 3]}", "angles must ascend"),
        (ONE_ENERGY % "{composition: Al, angles: [0, 12], thickness: [1, -2]}", "greater than or equal to 0, got -2"),
        (TUBE.replace("120", "120, angle: 5") % ("null", "true"), r"source.heel - for the heel effect rays must leave"),
    ],
)
def test_impossible_beams_are_one_sentence_with_their_place(source, message):
    with pytest.raises(SceneError, match=message) as caught:
        scan_of(source)
    assert str(caught.value).startswith("toy.yaml:3:")
    assert "\n" not in str(caught.value)
