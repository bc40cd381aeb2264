"""From the words of a scene to poses and back out of its file: orbits, mounted panels, jitter, tables of poses."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from support.edited_datasets import edited_dataset

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_poses import read_sample_poses, read_true_geometry
from phantomgen.dataset.validate import validate
from phantomgen.effects.pose_jitter import Jitter, jittered
from phantomgen.geometry.fan_angles import anode_angles, fan_angles, obliquity
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, SceneError

DOCS = Path(__file__).parents[3] / "docs" / "reference" / "geometry.md"
SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 3, test_views: 2}
panel: {rows: 6, columns: 7, pitch: 4}
volume: {voxels: 6, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5, center: [1, 2, 0]}
flats: 2
"""
ORBITS = {
    "short": "{type: circular, sod: 100, sdd: 200, views: 4, arc: short, start: 20}",
    "limited": "{type: circular, sod: 100, sdd: 200, views: 4, test_views: 1, arc: 90}",
    "sparse": "{type: circular, sod: 100, sdd: 200, angles: [0, 10, 100], test_views: 2}",
    "helical": "{type: helical, sod: 100, sdd: 200, views: 8, test_views: 1, pitch: 6, turns: 2}",
    "laminography": "{type: laminography, sod: 100, sdd: 200, views: 3, tilt: 30}",
    "parallel": "{type: parallel, distance: 40, views: 3, test_views: 1}",
    "tilted parallel": "{type: parallel, distance: 40, views: 3, tilt: 10, arc: 360}",
}
ORBIT = "geometry={type: circular, sod: 100, sdd: 200, views: %s}"


def toy(*overrides: str) -> Scan:
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def refusal(*overrides: str) -> str:
    with pytest.raises(SceneError) as caught:
        toy(*overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def degrees(scan: Scan) -> np.ndarray:
    return np.rad2deg(scan.geometry.angles)


@pytest.mark.parametrize("name", ORBITS)
def test_a_file_holds_the_geometry_of_its_scene(name, tmp_path):
    scan = toy(f"geometry={ORBITS[name]}", "panel.offset.columns=2.5", "panel.tilt.in_plane=2")
    simulate(scan, tmp_path / "a.h5")
    with open_dataset(tmp_path / "a.h5") as dataset:
        assert dataset.geometry == scan.geometry
        assert (dataset.geometry.kind, dataset.geometry.is_parallel) == (scan.geometry.kind, scan.geometry.is_parallel)
        np.testing.assert_allclose(dataset.geometry.angles, scan.geometry.angles)
        assert len(dataset.splits["train"]) + len(dataset.splits["test"]) == len(scan.geometry)
        assert ("ray_direction" in dataset.file["entry/geometry"]) == ("parallel" in name)
        assert ("source" in dataset.file["entry/geometry"]) == ("parallel" not in name)
        assert "nxtomo_bin0" in dataset.file
    assert validate(tmp_path / "a.h5") == []
    assert read_true_geometry(tmp_path / "a.h5") is None
    info = describe(tmp_path / "a.h5")
    assert (info["orbit"], info["sod_mm"]) == (scan.geometry.kind, None if "parallel" in name else pytest.approx(100))
    assert "from axis to panel" in describe_text(info) or "SOD 100 mm" in describe_text(info)


def test_arcs_lists_and_helices_have_the_angles_they_say():
    np.testing.assert_allclose(degrees(toy(f"geometry={ORBITS['limited']}")), [0, 22.5, 45, 67.5, 45])
    np.testing.assert_allclose(degrees(toy(f"geometry={ORBITS['sparse']}")), [0, 10, 100, 5, 55])
    fan = 2 * np.rad2deg(np.arctan(14 / 200))
    np.testing.assert_allclose(degrees(toy(f"geometry={ORBITS['short']}")), 20 + np.arange(4) * (180 + fan) / 4)
    helix = toy(f"geometry={ORBITS['helical']}").geometry
    np.testing.assert_allclose(helix.source[:8, 2], -6 + 1.5 * np.arange(8))
    by_range = ORBITS["helical"].replace("turns: 2", "range: 12")
    assert toy(f"geometry={by_range}").geometry == helix


def test_an_offset_panel_widens_the_short_scan():
    fan = 2 * np.rad2deg(np.arctan(24 / 200))
    scan = toy(f"geometry={ORBITS['short']}", "panel.offset.columns=-10")
    np.testing.assert_allclose(degrees(scan), 20 + np.arange(4) * (180 + fan) / 4)


def test_a_resolved_scene_is_the_same_scene():
    for orbit in ORBITS.values():
        scan = toy(f"geometry={orbit}", "panel.tilt.rows=3")
        again = load_scene(SceneFile("again.yaml", scan.text))
        assert again.geometry == scan.geometry
        assert again.text == scan.text


@pytest.mark.parametrize("block", re.findall(r"```yaml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL))
def test_scenes_in_the_documentation_load(block):
    values = yaml.safe_load(SCENE) | yaml.safe_load(block)
    assert len(load_scene(SceneFile("docs.yaml", yaml.safe_dump(values))).geometry) > 3


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([ORBIT % "3, angles: [0, 1]"], "an orbit needs either views, the number of them, or angles"),
        (["geometry={type: circular, sod: 100, sdd: 200}"], "needs either views"),
        (["geometry={type: circular, sod: 100, sdd: 200, angles: [1], arc: 90}"], "leave arc and start out"),
        (["geometry={type: circular, sod: 100, sdd: 200, angles: [1], test_views: 1}"], "at most 0 do"),
        ([ORBIT % "3, arc: 40000"], "less than or equal to 36000"),
        ([ORBIT % "3, arc: shirt"], "valid number"),
        (["geometry={type: circular, sod: 300, sdd: 200, views: 3}"], "0 < sod < sdd"),
        (
            ["geometry={type: helical, sod: 100, sdd: 200, views: 3, pitch: 1}"],
            "either turns, the number of them, or range",
        ),
        (["geometry={type: helical, sod: 100, sdd: 200, views: 3, pitch: 0, range: 2}"], "covers no range"),
        (["geometry={type: laminography, sod: 100, sdd: 200, views: 3, tilt: 90}"], "less than 90"),
        (["geometry={type: spiral}"], "unknown type 'spiral'"),
        (["geometry.flying_focal_spot=3"], "geometry.flying_focal_spot - needs a list, got 3"),
        (["geometry.flying_focal_spot=[]"], "needs at least 1, got 0"),
        (["geometry.flying_focal_spot=[{x: 1}]"], "unknown key"),
        (["geometry.flying_focal_spot=[{outward: -100}]"], "100 mm from its nominal position"),
        (["geometry={type: parallel, distance: 40, views: 3, jitter: {source: 1}}"], "no effect in a parallel beam"),
        (
            ["geometry={type: parallel, distance: 40, views: 3}", "background=water"],
            "put a box of it around the objects",
        ),
        (["panel.tilt.rows=90"], "less than 90"),
        (["geometry={type: poses, file: none.csv}"], "none.csv: there is no such file"),
        (["geometry={type: poses, file: none.txt}"], "must be one of .csv, .npz, .h5, .hdf5"),
        (
            [
                "geometry={type: parallel, distance: 40, views: 3}",
                "source={type: tube, kvp: 90, mas: 1, filters: [{composition: Al, thickness: 2}]}",
            ],
            "mas, needs an orbit with a distance from source to panel, got parallel",
        ),
        (
            [
                "geometry={type: parallel, distance: 40, views: 3}",
                "source.bowtie={composition: Al, angles: [0, 20], thickness: [1, 2]}",
            ],
            "a bowtie filter needs an orbit with a distance",
        ),
    ],
)
def test_impossible_geometries_are_one_sentence(overrides, words):
    assert words in refusal(*overrides)


def test_views_take_the_deflections_of_a_flying_focal_spot_in_turn():
    spots = "geometry.flying_focal_spot=[{columns: 1}, {columns: -1}, {z: 2, outward: 3}]"
    views = ("geometry.views=4", "geometry.test_views=2")
    still, flying = toy(*views).geometry, toy(*views, spots).geometry
    along = still.column_step / still.panel.column_pitch
    outward = still.source / np.linalg.norm(still.source, axis=1, keepdims=True)
    third = 3 * outward + [0, 0, 2]
    moved = [along[0], -along[1], third[2], along[3], along[4], -along[5]]  # the last two are test views
    np.testing.assert_allclose(flying.source - still.source, moved, atol=1e-12)


def test_profiles_follow_the_pixels_of_a_mounted_panel():
    panel, sdd = Panel(5, 7, (2.0, 3.0)), 40.0
    mount = Mount((4.0, -3.0), (0.2, -0.3, 0.4))
    geometry = mounted(Geometry.circular(30, sdd, np.array([0.7]), panel), mount)
    _, first, column, row = geometry.ray_frames()[0]
    rows, columns = np.mgrid[:5, :7]
    pixel = first + columns[..., None] * column + rows[..., None] * row
    axis, side = -np.array([np.cos(0.7), np.sin(0.7), 0]), np.array([-np.sin(0.7), np.cos(0.7), 0])
    across, depth, up = pixel @ side, pixel @ axis, pixel[..., 2]
    np.testing.assert_allclose(fan_angles(panel, sdd, mount), np.arctan2(across, depth), atol=1e-12)
    np.testing.assert_allclose(anode_angles(panel, sdd, mount), np.arctan2(up, depth), atol=1e-12)
    length = np.linalg.norm(pixel, axis=-1)
    np.testing.assert_allclose(obliquity(panel, sdd, mount), length / np.hypot(across, depth), rtol=1e-12)


@pytest.mark.slow
def test_counts_of_an_offset_panel_are_a_part_of_those_of_a_larger_one():
    bowtie = "source.bowtie={composition: Al, angles: [0, 20], thickness: [1, 9]}"
    from phantomgen.simulation.forward_model.discretization import Settings
    from phantomgen.simulation.forward_model.expected_counts import expected_view
    from phantomgen.simulation.forward_model.exposure import Exposure
    from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths

    large = toy(bowtie, "panel.rows=10", "panel.columns=11")
    part = toy(bowtie, "panel.offset={columns: 8, rows: -4}")  # two columns to the right, one row up
    energies = Exposure.of(large, sampled_lengths(large), 1e-5)[0].groups
    whole, seen = (expected_view(scan, energies, 1, Settings()) for scan in (large, part))
    inner = np.s_[:, 1:-1, 1:-1]  # pixels at the rim of a panel lack a neighbour to tell curvature from
    np.testing.assert_allclose(seen[inner], whole[:, 1:7, 4:11][inner], rtol=1e-9)


def test_jitter_is_normal_and_independent():
    geometry = Geometry.circular(100, 200, np.zeros(4000), Panel(4, 4, 1.0))
    true = jittered(geometry, Jitter(0.2, 0.5, 0.01), seed=3)
    turned = np.einsum("vi,i->v", true.column_step, geometry.row_step[0])  # in the plane of the panel
    drawn = np.column_stack(
        [(true.source - geometry.source) / 0.2, (true.panel_center - geometry.panel_center) / 0.5, turned / 0.01]
    )
    count = len(drawn)
    assert np.abs(drawn.mean(axis=0)).max() < 5 / np.sqrt(count)
    assert np.abs(drawn.std(axis=0) - 1).max() < 5 / np.sqrt(2 * count) + 2e-4  # the sine of a turn is a little less
    assert np.abs(np.corrcoef(drawn.T) - np.eye(7)).max() < 5 / np.sqrt(count)
    assert np.abs([np.corrcoef(c[1:], c[:-1])[0, 1] for c in drawn.T]).max() < 5 / np.sqrt(count)


def test_jitter_depends_on_seed_and_view_only():
    few, many = (Jitter().numbers(7, views) for views in (3, 9))
    np.testing.assert_array_equal(few, many[:3])
    assert not np.isclose(many, Jitter().numbers(8, 9)).any()
    geometry = Geometry.circular(100, 200, np.zeros(3), Panel(4, 4, 1.0))
    assert jittered(geometry, Jitter(), 0) == geometry


def test_a_file_tells_the_nominal_geometry_and_keeps_the_true_one(tmp_path):
    jitter = "geometry.jitter={source: 0.5, panel: 0.5, rotation: 1}"
    steady, shaking = toy("noise=false"), toy("noise=false", jitter)
    assert steady.nominal is None
    assert shaking.nominal == steady.geometry
    for name, scan in {"steady": steady, "shaking": shaking}.items():
        simulate(scan, tmp_path / f"{name}.h5")
    with open_dataset(tmp_path / "steady.h5") as a, open_dataset(tmp_path / "shaking.h5") as b:
        assert a.geometry == b.geometry
        assert not np.allclose(a.load(), b.load(), rtol=1e-3)
        assert "truth/geometry" not in a.file
    assert read_true_geometry(tmp_path / "shaking.h5") == shaking.geometry
    assert read_sample_poses(tmp_path / "shaking.h5") is None
    assert validate(tmp_path / "shaking.h5") == []
    with edited_dataset(tmp_path / "shaking.h5") as file:
        file["truth/geometry/row_step"][...] *= 1.1
    assert "/truth/geometry/row_step has length" in validate(tmp_path / "shaking.h5")[0]


def _table(geometry: Geometry) -> dict[str, np.ndarray]:
    return {name: getattr(geometry, name) for name in ("source", "panel_center", "column_step", "row_step")}


def _write_csv(path, table, edit=lambda text: text):
    header = ",".join(f"{name}_{axis}" for name in table for axis in "xyz")
    rows = [",".join(map(repr, map(float, row))) for row in np.hstack(list(table.values()))]
    path.write_text(edit("\n".join([header, *rows]) + "\n"), encoding="utf-8")


@pytest.mark.parametrize("kind", ["csv", "npz", "h5", "dataset.h5"])
def test_poses_come_back_from_a_table(kind, tmp_path):
    scan = toy("geometry.views=5")
    path, table = tmp_path / f"poses.{kind}", _table(scan.geometry)
    if kind == "csv":
        _write_csv(path, table)
    elif kind == "npz":
        np.savez(path, **table)
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file.update(table)
    else:
        simulate(scan, path)
    scene = SceneFile(
        str(tmp_path / "toy.yaml"), SCENE, (f"geometry={{type: poses, file: poses.{kind}, test_views: 2}}",)
    )
    found = load_scene(scene)
    assert found.geometry == scan.geometry[[0, 2, 3, 4, 6, 1, 5]]
    assert [len(found.splits[name]) for name in ("train", "test")] == [5, 2]
    simulate(found, tmp_path / "scan.h5")
    assert validate(tmp_path / "scan.h5") == []
    assert "it knows rotation angles only" in describe_text(describe(tmp_path / "scan.h5"))


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda t: t.replace("source_x", "sorce_x"), ":1: the header lacks the column 'source_x'"),
        (lambda t: t.replace("100.0", "1OO.0", 1), ":2: source_x must be a number [mm], got '1OO.0'"),
        (lambda t: t.replace("100.0,", "", 1), ":2: a row has 12 cells like the header, got 11"),
        (lambda t: t.splitlines()[0], "holds no poses"),
        (lambda t: t.replace("-4.0", "-5.0"), "is 5 mm long, but the pitch is 4 mm"),
        (lambda t: t.replace("100.0", "nan", 1), "source of view 0 is not finite"),
    ],
)
def test_bad_tables_are_one_sentence(edit, words, tmp_path):
    _write_csv(tmp_path / "poses.csv", _table(toy().geometry), edit)
    scene = SceneFile(str(tmp_path / "toy.yaml"), SCENE, ("geometry={type: poses, file: poses.csv}",))
    with pytest.raises(SceneError) as caught:
        load_scene(scene)
    assert words in str(caught.value)
    assert "geometry.file - " in str(caught.value)


def test_arrays_that_do_not_fit_are_refused(tmp_path):
    from phantomgen.geometry.pose_table import read_poses

    table = _table(toy().geometry)
    np.savez(tmp_path / "a.npz", **{**table, "source": table["source"][:2]})
    with pytest.raises(InputError, match="need one row per view"):
        read_poses(tmp_path / "a.npz", Panel(6, 7, 4.0))
    np.savez(tmp_path / "b.npz", **{name: table[name] for name in list(table)[:3]})
    with pytest.raises(InputError, match="lacks the array 'row_step'"):
        read_poses(tmp_path / "b.npz", Panel(6, 7, 4.0))
    (tmp_path / "c.npz").write_text("no archive")
    with pytest.raises(InputError, match="is damaged or no"):
        read_poses(tmp_path / "c.npz", Panel(6, 7, 4.0))
    np.savez(tmp_path / "d.npz", **{**table, "row_step": np.zeros((5, 2))})
    with pytest.raises(InputError, match=r"row_step must hold numbers \(view, 3\)"):
        read_poses(tmp_path / "d.npz", Panel(6, 7, 4.0))
