"""What a helix cannot see enough of: against the half turn that a point on the axis is seen for, in closed form."""

import numpy as np
import pytest

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from phantomgen.simulation.checks.half_turns import helix_axis, lacks_directions

SCENE = """
version: 1
name: helix
source: {{type: monochromatic, energy: 60, photons: 1e5}}
detector: {{type: photon_counting, thresholds: [20]}}
geometry: {{type: helical, sod: 400, sdd: 800, views: {views}, pitch: {pitch}, turns: {turns}, test_views: {tests}}}
panel: {{rows: 40, columns: {columns}, pitch: 2}}
volume: {{voxels: 8, size: 400}}
materials: {{water: {{composition: water}}}}
objects:
  - {{type: cylinder, material: water, radius: 20, length: 120}}
  - {{type: sphere, material: water, radius: 5, center: [5, 0, 50]}}
"""


def warnings(pitch=30, turns=6, columns=80, tests=0, views=300):
    text = SCENE.format(pitch=pitch, turns=turns, columns=columns, tests=tests, views=views)
    return coverage_warnings(load_scene(SceneFile("helix.yaml", text)))


@pytest.mark.parametrize("tests", [0, 20])
def test_a_helix_that_sees_every_point_for_half_a_turn_says_nothing(tests):
    assert warnings(tests=tests) == []


def test_a_short_helix_says_so_in_one_sentence():
    """The source ends at z = 45 and a point near the axis is seen from 20 mm below on: half a turn, 15 mm, up to 50."""
    (sentence,) = warnings(turns=3)
    assert "of object 1 (water) from less than half a turn, and less of 1 more: that cannot" in sentence
    share = float(sentence.split("sees ")[1].split("%")[0])
    assert 25 < share < 50  # of the ball around z = 50, less what four steps between views allow


def test_a_steep_helix_says_so():
    (sentence,) = warnings(pitch=120, turns=3)
    assert "less than half a turn" in sentence


def test_what_leaves_a_helix_sideways_is_still_told():
    assert any("sideways" in sentence for sentence in warnings(columns=30))


@pytest.mark.parametrize("pitch", [70.0, 79.0, 86.0, 90.0])
def test_half_a_turn_of_the_axis_is_panel_height_over_magnification(pitch):
    """A point on the axis is seen while the source is within 20 mm (half of 80 mm over 2) of its height."""
    angle = np.linspace(-6 * np.pi, 6 * np.pi, 1200)
    sources = np.stack([400 * np.cos(angle), 400 * np.sin(angle), pitch * angle / (2 * np.pi)], axis=1)
    points = np.array([[0.0, 0, 1.3]])
    seen = np.abs(sources[:, 2:] - points[:, 2]) < 20
    lacks = lacks_directions(sources, np.array([0.0, 0, 1]), points, seen)
    assert lacks.tolist() == [pitch > 80]


def test_a_circle_has_no_helix_axis():
    scan = load_scene("kedge-small", ["geometry.views=8"])
    assert helix_axis(scan.geometry) is None
