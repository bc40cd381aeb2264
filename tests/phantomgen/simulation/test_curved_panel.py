"""Scans on curved panels: counts against chords in closed form, the file, and what the detector adds."""

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.geometry.panel import Curvature
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.energy_grids import fine_transmission
from phantomgen.simulation.forward_model.expected_counts import expected_view, open_beam
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.run import simulate

MU, RADIUS, CENTER, SOD, SDD = 0.02, 30.0, np.array([20.0, -15.0, 2.0]), 300.0, 600.0
SCENE = f"""
version: 1
name: curved
noise: false
source: {{type: monochromatic, energy: 70, photons: 1e6}}
detector: {{type: photon_counting, thresholds: [20]}}
geometry: {{type: circular, sod: {SOD}, sdd: {SDD}, views: 3, test_views: 1}}
panel: {{rows: 6, columns: 48, pitch: [8, 6], curvature: {{radius: 600, module_columns: 1}}}}
volume: {{voxels: 8, size: 128}}
basis: [{{type: compton}}]
materials: {{ball: {{coefficients: {{compton: {MU}}}}}}}
objects: [{{type: sphere, material: ball, radius: {RADIUS}, center: [{", ".join(map(str, CENTER))}]}}]
"""


def scan_of(*overrides):
    return load_scene(SceneFile("curved.yaml", SCENE), overrides)


def ball_chords(angle, radius, rows=6, columns=48):
    """Chords of the ball for the rays of a view, from the equation of the cylinder."""
    turn = (np.arange(columns) - (columns - 1) / 2) * 6 / radius
    outward, tangent = np.array([np.cos(angle), np.sin(angle), 0]), np.array([-np.sin(angle), np.cos(angle), 0])
    z = ((rows - 1) / 2 - np.arange(rows)) * 8
    source, middle = SOD * outward, (SOD - SDD + radius) * outward
    pixels = middle + radius * (np.sin(turn)[:, None] * tangent - np.cos(turn)[:, None] * outward)
    rays = pixels - source + z[:, None, None] * np.array([0, 0, 1])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = (CENTER - source) @ np.moveaxis(rays, -1, 1)
    return 2 * np.sqrt(np.maximum(RADIUS**2 - ((CENTER - source) ** 2).sum() + along**2, 0))


@pytest.mark.parametrize("radius", [600.0, 350.0, 2000.0])
def test_rays_have_the_chords_of_the_ball(radius):
    scan = scan_of(f"panel.curvature.radius={radius}", "panel.sub_rays=1")
    transmission = fine_transmission(scan)
    for view, angle in enumerate(scan.geometry.angles):
        counts = expected_view(scan, transmission, view, Settings(sub_rays=1))
        lengths = np.log(open_beam(scan, transmission) / counts)[0] / scan.scene.materials[0].attenuation(
            np.array([70.0]), scan.basis
        )
        assert lengths == pytest.approx(ball_chords(angle, radius), abs=1e-9)


@pytest.mark.parametrize("width", [1, 4, 48])
def test_pixels_meet_the_tolerance_whatever_the_modules(width, tmp_path):
    scan = scan_of(f"panel.curvature.module_columns={width}")
    summary = simulate(scan, tmp_path / "scan.h5", verify=True)
    assert summary.error.edge_worst < 1e-3
    assert summary.error.edge_pixels > 20


def test_the_file_has_the_curvature(tmp_path):
    scan = scan_of("panel.curvature.module_columns=8", "panel.offset.columns=1.5", "noise=true")
    simulate(scan, tmp_path / "scan.h5")
    assert validate(tmp_path / "scan.h5") == []
    with open_dataset(tmp_path / "scan.h5") as dataset:
        assert dataset.geometry.panel.curvature == Curvature(600.0, 6)
        assert dataset.geometry == scan.geometry
    with h5py.File(tmp_path / "scan.h5") as file:
        assert file["entry/geometry/curvature_radius"].attrs["units"] == "mm"


def test_a_bowtie_is_that_of_the_fan_angles():
    scan = scan_of("source.bowtie={composition: Al, angles: [0, 20], thickness: [0, 10]}", "objects.0.radius=5")
    turn = np.abs((np.arange(48) - 23.5) * 6 / 600)  # fan angles, as the cylinder is around the source
    up = (2.5 - np.arange(6))[:, None] * 8
    expected = 10 * turn / np.deg2rad(20) * np.hypot(1, up / 600)
    assert scan.profile.lengths[0] == pytest.approx(expected, abs=1e-9)
    transmission = fine_transmission(scan)
    above_the_ball = expected_view(scan, transmission, 0, Settings())[:, 0]
    assert above_the_ball == pytest.approx(open_beam(scan, transmission)[:, 0], rel=1e-12)


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("panel.curvature.module_columns=7", "module_columns is 7, which does not divide the 48 columns"),
        ("panel.curvature.radius=90", "turns by"),
        ("panel.curvature.radius=-1", "greater than 0"),
        ("geometry={type: parallel, distance: 100, views: 3}", "a parallel beam has none"),
    ],
)
def test_impossible_panels_get_a_sentence(override, sentence, tmp_path):
    (tmp_path / "curved.yaml").write_text(SCENE)
    result = CliRunner().invoke(main, ["plan", str(tmp_path / "curved.yaml"), "--set", override])
    assert result.exit_code == 1
    assert sentence in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_plans_of_curved_panels_find_edges():
    plan = make_plan(scan_of("panel.curvature.module_columns=4"), 1e-3)
    assert "silhouettes" in plan.text
