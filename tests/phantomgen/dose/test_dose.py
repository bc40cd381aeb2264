"""Dose of scans: what CTDI and maps scale with, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose
from support.tiny_scans import one_sentence

from phantomgen.cli.main import main as phantomgen
from phantomgen.degradation.run import degrade_file
from phantomgen.degradation.settings import Degradation
from phantomgen.display.dataset_report.page import dataset_report
from phantomgen.dose.beam import ScanBeam
from phantomgen.dose.ctdi import HEAD, beam_width, ctdi_of, one_turn
from phantomgen.dose.dose_map import dose_map, resampled
from phantomgen.dose.run import JOULE
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.scan import load_scene
from phantomgen.volume_files.read import read_volume
from spectra.errors import InputError
from spectra.threads import set_threads

SCENE = Path(__file__).parent / "water.yaml"
PHOTONS = 60_000


def scan_of(*settings):
    from phantomgen.scene.file.find_scene import find_scene

    return load_scene(find_scene(str(SCENE), settings))


def dose(*words):
    return CliRunner().invoke(phantomgen, ["dose", *map(str, words)])


def test_the_number_of_photons_and_the_views_scale_ctdi():
    one = ctdi_of(scan_of(), HEAD, PHOTONS, 0)
    more = ctdi_of(scan_of("source.photons=4e5", "geometry.views=12"), HEAD, PHOTONS, 0)
    assert more.weighted == pytest.approx(2 * 1.2 * one.weighted, rel=0.05)
    assert one.volume == one.weighted == pytest.approx(one.centre / 3 + 2 * one.periphery / 3)
    assert one.width == pytest.approx(64 * 500 / 800)


def test_the_energy_that_a_cylinder_takes_is_within_that_of_the_beam():
    found = dose_map(scan_of(), PHOTONS, 20, 0)
    beam = ScanBeam.of(scan_of())
    sent = beam.photons * beam.mean_energy * JOULE
    assert found.energy == pytest.approx(found.absorbed * sent, rel=0.01)
    assert 0.05 < found.absorbed < 0.9
    assert found.materials["water"][0] == pytest.approx(found.dose[found.dose > 0].mean(), rel=0.15)


def test_the_dose_of_a_small_object_is_kerma_of_the_open_beam():
    """In a ball of water that weakens little, dose over air kerma is the ratio of the coefficients at each energy."""
    scan = scan_of(
        "source={type: lines, photons: 2.0e5, lines: {60: 1}}",
        "detector.thresholds=[20]",
        "objects.0.radius=2",
        "objects.0.length=4",
        "volume.size=4.4",
    )
    found = dose_map(scan, 400_000, 11, 1)
    pitch, distance = 2.0, 800.0 / 500.0
    fluence = 10 * 2e5 / pitch**2 * distance**2  # photons per mm^2 at the isocentre, 10 views
    kerma = fluence * 60 * 0.03190 * 100 * JOULE / 1e-3  # mu_en / rho of water at 60 keV (NIST)
    assert found.materials["water"][0] == pytest.approx(kerma, rel=0.06)


def test_maps_do_not_depend_on_the_number_of_threads():
    try:
        maps = []
        for threads in (1, 3):
            set_threads(threads)
            maps.append(dose_map(scan_of(), 4000, 8, 3).dose)
    finally:
        set_threads(None)
    assert np.array_equal(*maps)


def test_the_stated_error_is_that_between_seeds():
    maps = [dose_map(scan_of(), 20_000, 6, seed) for seed in range(12)]
    spread = np.std([found.dose for found in maps], axis=0, ddof=1)
    stated = np.sqrt(np.mean([found.error**2 for found in maps], axis=0))
    used = spread > 0
    assert np.median(stated[used] / spread[used]) == pytest.approx(1, abs=0.15)


def test_a_helix_counts_one_turn_and_its_pitch():
    helix = scan_of("geometry={type: helical, sod: 500, sdd: 800, views: 40, pitch: 30, turns: 4}")
    turn, travel = one_turn(helix.geometry)
    assert travel == pytest.approx(30)
    assert len(turn) in (10, 11)
    found = ctdi_of(helix, HEAD, PHOTONS, 0)
    assert found.pitch == pytest.approx(30 / beam_width(helix.geometry))
    circle = ctdi_of(scan_of(), HEAD, PHOTONS, 0)
    assert found.weighted == pytest.approx(circle.weighted * len(turn) / 10, rel=0.05)
    x, y, z = helix.geometry.source.T  # the other sense of rotation, from 0.5 rad on
    around = 0.5 - np.arctan2(y, x)
    mirrored = replace(helix.geometry, source=np.stack([500 * np.cos(around), 500 * np.sin(around), z], axis=1))
    assert len(one_turn(mirrored)[0]) == len(turn)
    assert one_turn(mirrored)[1] == pytest.approx(30)
    with pytest.raises(InputError, match="one turn at least"):
        one_turn(helix.geometry[np.arange(4)])


def test_a_stated_current_scales_views():
    even, uneven = ScanBeam.of(scan_of()), ScanBeam.of(scan_of(f"source.modulation={{factors: {[3] + [1] * 9}}}"))
    assert uneven.photons == pytest.approx(1.2 * even.photons)
    assert_allclose(uneven.views, np.array([3] + [1] * 9) / 12)
    followed = ScanBeam.of(scan_of("source.modulation={strength: 0.5}"))
    assert followed.photons == pytest.approx(even.photons)


def test_a_bowtie_spares_the_periphery():
    plain = dose_map(scan_of("objects.0.radius=60"), PHOTONS, 20, 0).dose
    bowtie = "source.bowtie={composition: Al, angles: [0, 3, 6, 9], thickness: [0.5, 4, 20, 60]}"
    shaped = dose_map(scan_of("objects.0.radius=60", bowtie), PHOTONS, 20, 0).dose
    edge, middle = (slice(8, 12), slice(9, 11), slice(1, 4)), (slice(8, 12), slice(9, 11), slice(9, 11))
    assert shaped[edge].mean() / shaped[middle].mean() < 0.8 * plain[edge].mean() / plain[middle].mean()


@pytest.mark.parametrize(
    ("shape", "voxels", "expected"), [((10, 20, 40), 40, (10, 20, 40)), ((1, 64, 64), 32, (1, 32, 32))]
)
def test_maps_cover_the_volume(shape, voxels, expected):
    grid = Grid(shape, (2.0, 2.0, 2.0), (1.0, -3.0, 5.0))
    found = resampled(grid, voxels)
    assert found.shape == expected
    assert_allclose(np.array(found.shape) * found.spacing, np.array(shape) * 2.0)
    assert_allclose(np.array(found.origin) - np.array(found.spacing) / 2, np.array(grid.origin) - 1.0)


def test_the_command_prints_numbers_and_writes_a_map_and_a_picture(tmp_path):
    outputs = ("-o", tmp_path / "dose.vti", "--plot", tmp_path / "dose.png")
    words = (SCENE, "--photons", 20_000, "--voxels", 8, "-q", *outputs)
    result = dose(*words, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [each["diameter_mm"] for each in found["ctdi"]] == [160, 320]
    assert found["ctdi"][0]["volume_Gy"] > found["ctdi"][1]["volume_Gy"] > 0
    assert found["missing"] == []
    stored = read_volume(f"{tmp_path / 'dose.vti'}:dose")
    assert stored.values.max() == pytest.approx(1e3 * found["dose"]["largest_Gy"], rel=1e-5)
    assert (tmp_path / "dose.png").stat().st_size > 5000
    assert "exists" in one_sentence(dose(*words))
    text = dose(SCENE, "--photons", 2000, "--voxels", 4, "-q").stdout
    assert "CTDIvol" in text
    assert "water" in text


def test_what_has_no_composition_has_ctdi_but_no_map():
    result = dose("kedge-small", "--photons", 2000, "-q")
    assert result.exit_code == 0
    assert "CTDIvol" in result.stdout
    assert "missing      dose needs the composition and density of material 'soft_tissue'" in result.stdout


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--plot", "x.png", "--set", "materials.water={coefficients: {compton: 0.02}}"), "given by coefficients"),
        (("--set", "effects.motion={type: random_walk, shift: [1, 1, 1]}"), "leave motion out"),
        (
            (
                "--set",
                "source={type: multi_source, sources: {a: {type: tube, kvp: 80, photons: 1.0e5}, "
                "b: {type: tube, kvp: 120, photons: 1.0e5}}}",
            ),
            "scans of one source",
        ),
        (("-o", "dose.txt"), "the suffix says the format"),
        (("--set", "geometry={type: laminography, sod: 500, sdd: 800, tilt: 30, views: 9}", "--json"), ""),
    ],
)
def test_what_cannot_be_computed_is_one_sentence(words, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = dose(SCENE, "--photons", 2000, "--voxels", 4, "-q", *words)
    if sentence:
        assert sentence in one_sentence(result)
        assert list(tmp_path.iterdir()) == []
    else:
        assert json.loads(result.stdout)["missing"] == [
            "CTDI is defined for circular, helical, parallel orbits around z, not for laminography ones"
        ]


def test_the_page_about_a_dataset_has_its_dose_until_the_dose_is_changed(tmp_path, monkeypatch):
    monkeypatch.setattr("phantomgen.display.dataset_report.dose.PHOTONS", 5000)
    made = CliRunner().invoke(phantomgen, ["make", str(SCENE), "-o", str(tmp_path / "water.h5"), "-q"])
    assert made.exit_code == 0, made.output
    page = dataset_report(tmp_path / "water.h5")
    (parts,) = (section.parts for section in page.sections if section.title == "Dose")
    table, picture = parts
    assert [row[0] for row in table.rows][-1] == "mean dose of water"
    assert "Dose in three planes" in picture.caption
    degrade_file(tmp_path / "water.h5", tmp_path / "low.h5", Degradation(dose=0.5))
    left = dict(dataset_report(tmp_path / "low.h5").left_out)
    assert left["Dose"] == "the scene states the dose before the step degrade."


def test_a_scene_whose_files_are_elsewhere_leaves_the_dose_out(tmp_path):
    text = SCENE.read_text(encoding="utf-8") + "  - {type: voxels, file: map.npy, labels: {1: water}, spacing: 2}\n"
    (tmp_path / "scene.yaml").write_text(text, encoding="utf-8")
    np.save(tmp_path / "map.npy", np.ones((2, 2, 2), np.uint8))
    made = CliRunner().invoke(phantomgen, ["make", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "a.h5"), "-q"])
    assert made.exit_code in (0, 3), made.output
    (tmp_path / "map.npy").unlink()
    assert "map.npy" in dict(dataset_report(tmp_path / "a.h5").left_out)["Dose"]
