"""Tubes along curves: volumes, the curve itself, ends, and what is refused."""

import numpy as np
import pytest

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import sweep
from spectra.errors import InputError, SceneError


def helix(turns: float, count: int) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi * turns, count)
    return np.column_stack([30 * np.cos(angle), 30 * np.sin(angle), 20 * angle / (2 * np.pi)])


@pytest.mark.parametrize("sides", [3, 8, 24])
def test_a_straight_sweep_has_the_volume_of_a_cylinder(sides: int) -> None:
    tube = sweep([[0, 0, -5], [0, 0, 1], [0, 0, 5]], 2.0, sides)
    assert tube.volume == pytest.approx(np.pi * 4 * 10)
    assert tube.bounds[0][2] == pytest.approx(-5)
    assert tube.bounds[1][2] == pytest.approx(5)


def test_a_tapered_sweep_has_nearly_the_volume_of_a_frustum() -> None:
    tube = sweep([[0, 0, 0], [10, 0, 0]], [3.0, 1.0], 32, 16)
    assert tube.volume == pytest.approx(np.pi / 3 * 10 * (9 + 3 + 1), rel=0.02)


def test_a_bent_sweep_has_the_volume_of_its_length() -> None:
    tube = sweep(helix(1.5, 25), 4.0, 24, 6)
    length = 1.5 * np.hypot(2 * np.pi * 30, 20)
    assert tube.volume == pytest.approx(np.pi * 16 * length, rel=0.01)  # Pappus


def test_the_curve_passes_its_points_and_rings_do_not_twist() -> None:
    points = helix(0.75, 7)
    tube = sweep(points, 1.0, 12, 5)
    rings = tube.vertices[:-2].reshape(-1, 12, 3)
    np.testing.assert_allclose(rings.mean(axis=1)[::5], points, atol=1e-12)
    steps = np.linalg.norm(np.diff(rings, axis=0), axis=2)
    assert steps.max() < 1.1 * steps.mean() + 0.5


@pytest.mark.parametrize(
    ("points", "radius", "words"),
    [
        ([[0, 0, 0]], 1.0, "at least two"),
        ([[0, 0, 0], [0, 0, 0]], 1.0, "differ"),
        ([[0, 0, 0], [1, 0, 0]], [1.0, 1.0, 1.0], "one for each of 2 points"),
        ([[0, 0, 0], [1, 0, 0]], 0.0, "radius must be positive"),
        ([[0, 0, 0], [5, 0, 0], [5, 5, 0], [0, 5, 0]], 6.0, "crosses itself: its bends must be wider"),
    ],
)
def test_impossible_sweeps_are_refused(points, radius, words: str) -> None:
    with pytest.raises(InputError, match=words):
        sweep(points, radius)


def test_sweeps_stand_in_scenes() -> None:
    text = SceneFile.preset("kedge-small").text.replace(
        "objects:", "objects:\n  - {type: sweep, material: bone, center: [0, 0, 9], points: [[0, 0, 0], [9, 0, 0]], %s}"
    )
    few = ["geometry.views=1", "geometry.test_views=0"]
    shape, _ = load_scene(SceneFile("my.yaml", text % "radius: [1, 2]", tuple(few))).scene.objects[0]
    assert shape.contains(np.array([[4.5, 0, 9], [4.5, 0, 0]])).tolist() == [True, False]
    with pytest.raises(SceneError, match=r"objects\.0 - sweep radius must be one number, or one for each of 2 points"):
        load_scene(SceneFile("my.yaml", text % "radius: [1, 2, 3]", tuple(few)))
