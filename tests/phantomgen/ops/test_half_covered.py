"""Opaque objects whose edges pass exactly through centres of pixels: counts are parts of areas, and errors are told."""

import numpy as np
import pytest
import trimesh

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.reference_rays import RayGrid, log_errors, worst_error
from phantomgen.simulation.checks.verification import quick_check
from phantomgen.simulation.forward_model.expected_counts import expected_view, open_beam
from phantomgen.simulation.planning.make_plan import make_plan

PARALLEL = "{type: parallel, views: 1, distance: 100}"
CONE = "{type: circular, sod: 500, sdd: 800, views: 1}"
MIDDLE = 8
SCENE = """
version: 1
name: half
source: {{type: monochromatic, energy: 60, photons: 1e5}}
detector: {{type: photon_counting, thresholds: [20]}}
geometry: {geometry}
panel: {{rows: 17, columns: 17, pitch: 2{panel}}}
volume: {{voxels: 8, size: 100}}
materials: {{osmium: {{composition: Os}}}} # of which 20 mm leave 1e-70
objects:
  - {{{shape}}}
"""
UPPER = "material: osmium, type: box, center: [0, 0, 50], size: [100, 100, 100]"
CORNER = "material: osmium, type: box, center: [0, 50, 50], size: [100, 100, 100]"
CUT = "material: osmium, type: difference, base: {type: box, size: [100, 100, 100]}, "
CUT += "cut: [{type: box, center: [0, 0, -50], size: [150, 150, 100]}]"
CLIPPED = "material: osmium, type: box, size: [100, 100, 100], clip: [{normal: [0, 0, -1], offset: 0}]"
RIM = "material: osmium, type: cylinder, center: [0, 0, 50], radius: 40, length: 100"
MESH = "material: osmium, type: mesh, file: box.stl, unit: mm"
VOXELS = "type: voxels, fractions: {osmium: box.npy}, spacing: 2, center: [0, 0, 5]"


def seen(scene):
    """Part of the open beam that is left in each pixel, and the error that is told."""
    plan = make_plan(scene, 1e-3)
    transmission = plan.exposure.transmission
    counts = expected_view(plan.scan, transmission, 0, plan.settings) / open_beam(plan.scan, transmission)
    return counts[0], plan, quick_check(plan.scan, transmission, plan.settings)


def scene_of(shape, geometry=CONE, panel="", folder=""):
    return load_scene(SceneFile(f"{folder}/half.yaml", SCENE.format(geometry=geometry, shape=shape, panel=panel)))


@pytest.mark.parametrize("geometry", [PARALLEL, CONE])
@pytest.mark.parametrize("shape", [UPPER, CORNER, CUT, CLIPPED, RIM, MESH, VOXELS])
def test_an_edge_through_the_centres_of_pixels_leaves_the_open_part_of_their_area(shape, geometry, tmp_path):
    box = trimesh.creation.box((100, 100, 100))
    box.apply_translation((0, 0, 50))
    box.export(tmp_path / "box.stl")
    np.save(tmp_path / "box.npy", np.ones((5, 20, 20)))
    scan = scene_of(shape, geometry, folder=tmp_path)
    left, plan, check = seen(scan)
    _, _, across, down = np.sign(scan.geometry.ray_frames()[0])
    rows, columns = (np.clip(np.arange(-3, 4) * step + 0.5, 0, 1) for step in (down[2], across[1]))
    covered = np.outer(rows, columns if shape == CORNER else np.ones(7))
    middle = slice(MIDDLE - 3, MIDDLE + 4)
    np.testing.assert_allclose(left[middle, middle], 1 - covered, atol=5e-4)
    assert not plan.missed
    assert check.edge_worst < 2e-3  # the tolerance, and the reference's own error in some pixel half as bright


def test_one_ray_per_pixel_is_told_to_be_wrong_there():
    _, plan, check = seen(scene_of(UPPER, panel=", sub_rays: 1"))
    assert [choice.part for choice in plan.missed] == ["pixels"]
    assert plan.error > 20
    assert check.edge_worst > 20


def test_a_dark_pixel_is_an_error_and_two_dark_ones_are_none():
    wrong = log_errors(np.array([0.0, 0.5, 1e-13, 0.0]), np.array([0.5, 0.0, 0.0, 1e-20]))
    np.testing.assert_allclose(wrong, [np.log(2e-12), -np.log(2e-12), 0, 0], atol=1e-12)
    level = np.array([2.0, 0.0])
    assert worst_error(np.zeros(2), np.array([1.0, 0.0]), level) == pytest.approx(-np.log(2e-12))
    assert worst_error(np.zeros(0), np.zeros(0), np.zeros(0)) == 0


def test_rays_that_all_miss_an_open_strip_do_not_condemn_it():
    asked = []

    def counts_of(pixels, rays):
        asked.append(rays)
        return np.zeros((1, 1))

    strip = np.full((1, 1, 1), 1e-4)
    grid = RayGrid(np.array([[0, 0]]), counts_of)
    assert grid.worst(strip, np.array([True]), np.ones(1), 1e-3) == 0
    assert max(asked) == 2048
    assert grid.worst(100 * strip, np.array([True]), np.ones(1), 1e-3) > 20
