"""Faint objects: their centroid on the panel against many rays, what decided, and that others pay nothing for it."""

import numpy as np
import pytest
import trimesh

from phantomgen.ops.expected_counts import Spectrum, expected_counts_by_grid
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.planning.faint_objects import FaintObjects
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import Choice

SCENE = """
version: 1
name: faint
source: {{type: monochromatic, energy: 60, photons: 1e5}}
detector: {{type: photon_counting, thresholds: [20]}}
geometry: {{type: parallel, views: 1, distance: 100}}
panel: {{rows: 32, columns: 32, pitch: 1}}
volume: {{voxels: 8, size: 32}}
basis: [{{type: photoelectric}}, {{type: compton}}]
materials:
  dense: {{coefficients: {{photoelectric: 0, compton: 0.02}}}}
  faint: {{coefficients: {{photoelectric: 0, compton: {mu}}}}}
objects:
{objects}
"""
BALL = "  - {{type: sphere, material: faint, radius: {radius}, center: [0, {y}, {z}]}}"
LAYER = "  - {type: box, material: dense, size: [10, 60, 60]}\n"


def scan_of(objects, mu=5e-4, folder="."):
    return load_scene(SceneFile(f"{folder}/faint.yaml", SCENE.format(objects=objects, mu=mu)))


def centroid(image):
    """Column and row."""
    return np.array([(image.sum(axis=axis) * np.arange(32)).sum() for axis in (0, 1)]) / image.sum()


def centroids(scan, tolerance=1e-3):
    """Of the faint object as planned and by many rays, with the plan."""
    plan = make_plan(scan, tolerance)
    transmission, solids = plan.exposure.transmission, scan.scene.solids
    frame, pixels = scan.geometry.ray_frames()[0], np.argwhere(np.ones((32, 32), bool))
    spectrum = Spectrum(transmission.columns, transmission.weights, transmission.starts)
    counts = expected_counts_by_grid(frame, pixels, solids, spectrum, n=64, lattice=True)[:, 0].reshape(32, 32)
    found = expected_view(plan.scan, transmission, 0, plan.settings)[0]
    return (*(centroid(np.log(image[0, 0] / image)) for image in (found, counts)), plan)


def pixel_choice(plan) -> Choice:
    return next(c for c in plan.choices if c.part in {"pixels", "silhouettes"})


@pytest.mark.parametrize(("y", "z"), [(0.13, 0.31), (0.25, 0.25), (0.4, 0.1), (0.37, -0.22)])
@pytest.mark.parametrize("radius", [1.5, 3.0])
def test_the_centroid_of_a_faint_ball_is_right_to_a_hundredth_of_a_pixel(radius, y, z):
    found, exact, plan = centroids(scan_of(BALL.format(radius=radius, y=y, z=z)))
    assert np.hypot(*(found - exact)) < 0.01  # without the bound: 0.01 to 0.07
    assert "object 0 (faint), of signal" in plan.text
    assert plan.error <= 1e-3


def test_an_object_is_faint_by_what_it_changes_not_by_what_it_absorbs():
    scan = scan_of(LAYER + BALL.format(radius=2.0, y=0.13, z=0.31), mu=0.0206)
    found, exact, plan = centroids(scan)
    assert np.hypot(*(found - exact)) < 0.01
    assert "object 1 (faint)" in pixel_choice(plan).decided


def test_a_faint_mesh_is_right_too(tmp_path):
    trimesh.creation.icosphere(2, 3.0).export(tmp_path / "ball.stl")
    scan = scan_of(
        "  - {type: mesh, material: faint, file: ball.stl, unit: mm, center: [0, 0.4, 0.1]}", folder=tmp_path
    )
    found, exact, _ = centroids(scan)
    assert np.hypot(*(found - exact)) < 0.01


def test_the_bound_follows_the_tolerance_and_leaves_strong_objects_alone():
    ball = BALL.format(radius=3.0, y=0.4, z=0.1)
    plan = make_plan(scan_of(ball), 0.1)
    assert plan.settings.sub_rays == 1
    assert pixel_choice(plan).decided == ""
    strong = scan_of(ball, mu=0.05)
    assert pixel_choice(make_plan(strong, 1e-3)).decided == ""
    transmission = make_plan(strong, 1e-3).exposure.transmission
    assert FaintObjects.of(strong, transmission, 1e-3).objects == ()


def test_one_ray_per_pixel_is_told_which_object_it_makes_wrong():
    scan = scan_of(LAYER + BALL.format(radius=1.5, y=0.4, z=0.1), mu=0.0206)
    faint = FaintObjects.of(scan, make_plan(scan).exposure.transmission, 1e-3)
    assert [thing.number for thing in faint.objects] == [1]
    assert "object 1 (faint)" in (faint.missed(Settings(sub_rays=1)) or "")
    assert faint.missed(Settings()) is None
