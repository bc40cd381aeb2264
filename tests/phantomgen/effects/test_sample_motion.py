"""A sample that moves: its poses, and that it looks like objects that were moved."""

import numpy as np
import pytest

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_poses import read_sample_poses, read_true_geometry
from phantomgen.effects.sample_motion import Drift, RandomWalk, Sinusoid, seen_from_sample
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import rotation_matrix
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.run import simulate
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 4, test_views: 2}
panel: {rows: 11, columns: 12, pitch: 2}
volume: {voxels: 6, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: group, objects: [{type: ellipsoid, material: water, radii: [5, 3, 4], center: [1, 2, 0]}]}
flats: 2
"""
MOTION = "effects.motion={type: %s, shift: [4, -2, 1], rotation: [0, 0, 30]}"


def toy(*overrides: str):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def test_a_drift_reaches_its_shift_at_the_end():
    poses = Drift((4.0, 0.0, -2.0), (0.0, 0.0, 0.4)).poses(np.array([0.0, 0.25, 1.0]), 4, 0)
    np.testing.assert_array_equal(poses[0], np.eye(4))
    np.testing.assert_allclose(poses[1, :3, 3], [1.0, 0.0, -0.5])
    np.testing.assert_allclose(poses[2, :3, :3], rotation_matrix((0.0, 0.0, 0.4)))


def test_a_sinusoid_has_its_periods_and_phase():
    motion = Sinusoid((0.0, 0.0, 3.0), periods=2.0, phase=0.3)
    times = np.linspace(0, 1, 9)
    np.testing.assert_allclose(motion.poses(times, 8, 0)[:, 2, 3], 3 * np.sin(4 * np.pi * times + 0.3))


def test_steps_of_a_random_walk_are_normal_whatever_the_test_views():
    walk, steps = RandomWalk((1.0, 2.0, 0.5)), 4000
    times = np.concatenate([np.arange(steps) / steps, (np.arange(100) + 0.5) / 100])
    shifts = walk.poses(times, steps, 5)[:, :3, 3]
    np.testing.assert_array_equal(shifts[0], 0)
    moves = np.diff(shifts[:steps], axis=0) / [1.0, 2.0, 0.5]
    assert np.abs(moves.mean(axis=0)).max() < 5 / np.sqrt(steps)
    assert np.abs(moves.std(axis=0) - 1).max() < 5 / np.sqrt(2 * steps)
    assert np.abs(np.corrcoef(moves.T) - np.eye(3)).max() < 5 / np.sqrt(steps)
    between = shifts[steps] - shifts[20]  # the first test view stands at 20 steps
    assert np.abs(between).max() <= 1e-12 or np.abs(between).max() < 5 * 2.0
    np.testing.assert_array_equal(shifts, walk.poses(times, steps, 5)[:, :3, 3])
    assert not np.isclose(shifts[1:], walk.poses(times, steps, 6)[1:, :3, 3]).all(axis=1).any()


def test_what_is_seen_from_the_sample_moves_the_other_way():
    geometry = Geometry.circular(100, 200, np.zeros(1), Panel(3, 3, 1.0))
    pose = np.eye(4)[None].copy()
    pose[0, :3, :3], pose[0, :3, 3] = rotation_matrix((0.1, -0.2, 0.3)), [1.0, 2.0, 3.0]
    moved = seen_from_sample(geometry, pose)
    back = pose[0] @ np.append(moved.source[0], 1.0)
    np.testing.assert_allclose(back[:3], geometry.source[0], atol=1e-12)


@pytest.mark.parametrize("kind", ["drift", "sinusoid", "random_walk"])
@pytest.mark.parametrize("orbit", ["circular, sod: 100, sdd: 200", "parallel, distance: 60"])
def test_a_moving_sample_looks_like_moved_objects(kind, orbit):
    motion = MOTION % kind if kind != "random_walk" else MOTION.replace("-2", "2") % kind
    scan = toy(f"geometry={{type: {orbit}, views: 4, test_views: 2}}", motion)
    energies = Exposure.of(scan, sampled_lengths(scan), 1e-5)[0].groups
    for view in (1, 5):
        pose = scan.sample_poses[view]
        angle = np.rad2deg(np.arctan2(pose[1, 0], pose[0, 0]))
        where = [f"objects.0.center={pose[:3, 3].tolist()}", f"objects.0.rotation=[0, 0, {angle}]"]
        still = toy(f"geometry={{type: {orbit}, views: 4, test_views: 2}}", *where)
        assert still.geometry == scan.nominal
        seen, wanted = (expected_view(s, energies, view, Settings()) for s in (scan, still))
        np.testing.assert_allclose(seen, wanted, rtol=1e-12 if "circular" in orbit else 1e-6)


def test_a_file_keeps_poses_and_knows_the_sample_at_rest(tmp_path):
    still, moving = toy(), toy(MOTION % "drift")
    for name, scan in {"still": still, "moving": moving}.items():
        simulate(scan, tmp_path / f"{name}.h5")
    with open_dataset(tmp_path / "still.h5") as a, open_dataset(tmp_path / "moving.h5") as b:
        assert a.geometry == b.geometry
        np.testing.assert_array_equal(a.load([0]), b.load([0]))  # at rest
        assert not np.array_equal(a.load([3]), b.load([3]))
        np.testing.assert_array_equal(a.file["truth/basis/data"], b.file["truth/basis/data"])
    assert read_true_geometry(tmp_path / "moving.h5") == moving.geometry
    np.testing.assert_array_equal(read_sample_poses(tmp_path / "moving.h5"), moving.sample_poses)


def test_a_scene_names_what_is_wrong():
    for text, words in (
        ("{type: dirft}", "unknown type 'dirft'"),
        ("{type: random_walk, shift: [-1, 0, 0]}", r"effects\.motion\.shift\.0"),
        ("{type: drift, shift: [1, 0]}", r"effects\.motion\.shift"),
    ):
        with pytest.raises(SceneError, match=words):
            toy(f"effects.motion={text}")
