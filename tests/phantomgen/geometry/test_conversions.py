"""Geometry in the terms of other programs: known poses, the way back, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.poses import (
    circles,
    free_poses,
    largest_difference,
    mounted_circles,
    parallel_poses,
    pixel_of,
    skewed_poses,
)

from phantomgen.geometry import orbits
from phantomgen.geometry.conversions import astra, cil, diffdrr, leap, naf, r2_gaussian, rtk, tigre, tomosipo
from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import GeometryError

GOLDEN = json.loads((Path(__file__).parents[2] / "golden/geometry_of_programs.json").read_text())
POSES = tuple(GOLDEN["poses"])
NEAR = 1e-9  # mm
GRID = Grid((6, 5, 4), (2.0, 1.5, 1.0), (-7.0, 3.0, 11.0))
CIRCLE = Geometry.circular(500.0, 800.0, np.array([0.2, 1.4]), Panel(8, 8, 1.0))


def pose(name):
    """A pose of the table."""
    given = GOLDEN["poses"][name]
    vectors = [given[f"{v}_mm"] for v in ("source", "panel_center", "column_step", "row_step")]
    return astra.from_astra("cone_vec", given["rows"], given["columns"], np.array([np.ravel(vectors)]))


@pytest.mark.parametrize("name", POSES)
def test_the_probe_is_seen_where_the_table_says(name):
    row, column = pixel_of(pose(name), GOLDEN["P0_mm"])
    assert (row, column) == pytest.approx([GOLDEN["poses"][name][f"P0_{axis}"] for axis in ("row", "column")], abs=1e-6)


@pytest.mark.parametrize("name", POSES)
def test_rtk_has_the_numbers_of_rtk(name):
    long = {"SID": "SourceToIsocenterDistance", "SDD": "SourceToDetectorDistance"}
    found = vars(rtk.to_rtk(pose(name)))
    for key, value in GOLDEN["rtk"][name].items():
        assert found[long.get(key, key)][0] == pytest.approx(value, abs=2e-6), key


def test_rtk_has_the_matrix_of_rtk():
    matrix = rtk.rtk_matrices(rtk.to_rtk(pose("T2")))[0]
    np.testing.assert_allclose(matrix, GOLDEN["rtk"]["T2_matrix"], atol=1e-5)
    x, y, z = np.array(GOLDEN["P0_mm"])[[1, 2, 0]]
    u, v, w = matrix @ [x, y, z, 1]
    assert (u / w, v / w) == pytest.approx(GOLDEN["rtk"]["T2_P0_mm_on_panel"], abs=1e-6)


@pytest.mark.parametrize("name", POSES)
def test_tigre_has_the_parameters_that_its_source_says(name):
    found, wanted = tigre.to_tigre(pose(name)), GOLDEN["tigre"][name]
    assert found.angles[0] == pytest.approx(wanted["angles"], abs=1e-7)
    assert (found.DSO[0], found.DSD[0]) == pytest.approx((wanted["DSO"], wanted["DSD"]), abs=1e-6)
    assert found.offDetector[0] == pytest.approx(wanted["offDetector_VU"], abs=1e-6)
    assert found.rotDetector[0] == pytest.approx(wanted["rotDetector"], abs=1e-7)
    assert found.dDetector == pytest.approx(wanted["dDetector_VU"], abs=1e-6)


@pytest.mark.parametrize("name", ["T1", "T2"])
def test_cil_has_the_pose_of_cil(name):
    found, wanted = cil.to_cil_circle(pose(name)), GOLDEN["cil"][name]
    assert found.source_position == pytest.approx(wanted["source"], abs=1e-6)
    assert found.detector_position == pytest.approx(wanted["detector"], abs=1e-6)
    assert found.detector_direction_x == pytest.approx(wanted["direction_x"], abs=2e-6)
    assert found.detector_direction_y == pytest.approx(wanted["direction_y"], abs=2e-6)
    assert found.angles[0] == pytest.approx(wanted["angle_deg"], abs=1e-6)


def test_tomosipo_has_the_vectors_of_tomosipo():
    found = tomosipo.to_tomosipo(pose("T2"))
    for name in ("src_pos", "det_pos", "det_v", "det_u"):
        assert found[name][0] == pytest.approx(GOLDEN["tomosipo"][f"{name}_zyx"], abs=1e-9)


def test_leap_and_astra_have_our_vectors():
    free = pose("T3")
    found = leap.to_leap(free)
    assert found.sourcePositions is free.source
    np.testing.assert_allclose(found.rowVectors * found.pixelHeight, free.row_step, atol=1e-12)
    np.testing.assert_allclose(found.colVectors * found.pixelWidth, free.column_step, atol=1e-12)
    assert (found.numRows, found.numCols) == (100, 120)
    assert astra.to_astra(free).vectors[0] == pytest.approx(
        [*free.source[0], *free.panel_center[0], *free.column_step[0], *free.row_step[0]]
    )


def test_r2_gaussian_sees_the_probe_where_we_do():
    grid = Grid.cube(64, 128.0)
    scanner, angles = r2_gaussian.to_r2_gaussian(
        Geometry.circular(500.0, 800.0, np.deg2rad([30.0]), Panel(100, 120, 1.0)), grid
    )
    wanted = GOLDEN["r2_gaussian"]
    scale = 2 / max(scanner["sVoxel"])
    assert scale == wanted["scene_scale"]
    assert angles[0] == pytest.approx(wanted["angle_rad"])
    fov = [2 * np.arctan(side / 2 / scanner["DSD"]) for side in scanner["sDetector"]]
    assert fov == pytest.approx([wanted["FovY"], wanted["FovX"]], abs=1e-9)
    seen = np.linalg.inv(np.array(wanted["c2w"])) @ [*np.multiply(GOLDEN["P0_mm"], scale), 1]
    column, row = (
        (seen[i] / seen[2] / np.tan(angle / 2) + 1) * side / 2 - 0.5
        for i, angle, side in ((0, fov[1], 120), (1, fov[0], 100))
    )
    assert (column, row) == pytest.approx(wanted["P0_col_row"], abs=1e-4)


THERE_AND_BACK = {
    "astra": lambda g: astra.from_astra(*astra.to_astra(g)),
    "tomosipo": lambda g: tomosipo.from_tomosipo(**tomosipo.to_tomosipo(g)),
    "tigre": lambda g: tigre.from_tigre(tigre.to_tigre(g)),
    "rtk": lambda g: rtk.from_rtk(rtk.to_rtk(g), g.panel),
    "leap": lambda g: leap.from_leap(leap.to_leap(g)),
    "cil": lambda g: cil.from_cil_flex(cil.to_cil_flex(g)),
    "cil circle": lambda g: cil.from_cil_circle(cil.to_cil_circle(g)),
    "diffdrr": lambda g: diffdrr.from_diffdrr(diffdrr.to_diffdrr(g)),
    "r2": lambda g: r2_gaussian.from_r2_gaussian(*r2_gaussian.to_r2_gaussian(g, GRID))[0],
    "naf": lambda g: naf.from_naf(*naf.to_naf(g, GRID))[0],
}


@pytest.mark.parametrize("program", ["astra", "tomosipo"])
@given(geometry=skewed_poses())
@settings(max_examples=30)
def test_any_pose_comes_back(program, geometry):
    assert largest_difference(THERE_AND_BACK[program](geometry), geometry) < NEAR


@pytest.mark.parametrize("program", ["tigre", "rtk", "cil", "leap", "diffdrr"])
@given(geometry=free_poses())
@settings(max_examples=60)
def test_any_pose_of_a_panel_with_right_angles_comes_back(program, geometry):
    assume(program != "leap" or geometry.row_step[:, 2].min() < 0.99 * geometry.panel.row_pitch)
    assert largest_difference(THERE_AND_BACK[program](geometry), geometry) < NEAR


@given(geometry=mounted_circles())
@settings(max_examples=40)
def test_a_circle_with_any_panel_comes_back_from_cil(geometry):
    assert largest_difference(THERE_AND_BACK["cil circle"](geometry), geometry) < NEAR


@pytest.mark.parametrize("program", ["r2", "naf"])
@given(geometry=circles(square=True))
@settings(max_examples=30)
def test_a_circle_with_an_ideal_panel_comes_back(program, geometry):
    assert largest_difference(THERE_AND_BACK[program](geometry), geometry) < NEAR


@pytest.mark.parametrize("program", ["astra", "tomosipo"])
@given(geometry=parallel_poses(slant=True))
@settings(max_examples=30)
def test_any_parallel_beam_comes_back(program, geometry):
    assert largest_difference(THERE_AND_BACK[program](geometry), geometry) < NEAR


@given(geometry=free_poses(), bend=st.floats(0.7, 20))
@settings(max_examples=60)
def test_any_pose_of_a_curved_panel_comes_back_from_rtk(geometry, bend):
    panel = geometry.panel
    curvature = Curvature(bend * panel.columns * panel.column_pitch, panel.columns)
    curved = replace(geometry, panel=replace(panel, curvature=curvature))
    try:
        wanted = flat_modules(curved)
    except GeometryError:  # wrapped past the source
        assume(False)
    found = rtk.from_rtk(rtk.to_rtk(curved), panel)
    assert largest_difference(found, curved) < NEAR
    assert largest_difference(flat_modules(found), wanted) < NEAR


@given(geometry=parallel_poses())
@settings(max_examples=40)
def test_a_parallel_beam_across_the_panel_comes_back_from_rtk(geometry):
    assert largest_difference(THERE_AND_BACK["rtk"](geometry), geometry) < NEAR


@given(angles=st.lists(st.floats(-6, 6), min_size=1, max_size=4), shift=st.floats(-40, 40), turn=st.floats(-0.5, 0.5))
@settings(max_examples=40)
def test_a_parallel_beam_across_the_axis_comes_back_from_tigre(angles, shift, turn):
    scan = orbits.parallel(300.0, np.array(angles), Panel(8, 9, (0.7, 0.5)))
    tilted = mounted(scan, Mount(tilt=(0.0, 0.0, turn)))
    along = np.stack([-np.sin(angles), np.cos(angles), np.zeros(len(angles))], axis=1)
    moved = tilted.moved(np.tile(np.eye(3), (len(angles), 1, 1)), shift * along)
    assert largest_difference(THERE_AND_BACK["tigre"](moved), moved) < NEAR


@pytest.mark.parametrize("program", ["cil circle", "r2", "tigre", "rtk"])
def test_a_parallel_scan_comes_back(program):
    scan = orbits.parallel(300.0, np.array([0.0, 0.7, 2.9]), Panel(4, 6, (1.0, 0.5)))
    assert largest_difference(THERE_AND_BACK[program](scan), scan) < NEAR


@pytest.mark.parametrize("program", ["tigre", "rtk", "diffdrr", "cil"])
def test_sources_on_the_axis_come_back(program):
    """Euler angles are not unique here."""
    upright = Geometry.circular(500.0, 800.0, np.array([0.0]), Panel(8, 8, 1.0))
    geometry = upright.moved(rotation_matrix((0.3, np.pi / 2, 0.2))[None], np.zeros((1, 3)))
    assert abs(geometry.source[0, 2]) == pytest.approx(500.0)
    assert largest_difference(THERE_AND_BACK[program](geometry), geometry) < NEAR


@given(
    st.tuples(*[st.integers(1, 9)] * 3), st.tuples(*[st.floats(0.01, 50)] * 3), st.tuples(*[st.floats(-300, 300)] * 3)
)
def test_the_grid_comes_back_from_r2_gaussian_and_naf(shape, spacing, origin):
    grid = Grid(shape, spacing, origin)
    for out, back in (
        (r2_gaussian.to_r2_gaussian, r2_gaussian.from_r2_gaussian),
        (naf.to_naf, naf.from_naf),
    ):
        found = back(*out(CIRCLE, grid))[1]
        assert found.shape == shape
        assert found.spacing == pytest.approx(spacing)
        assert found.origin == pytest.approx(origin, abs=1e-9)


def test_volumes_of_programs_lie_where_the_grid_does():
    ny, nx, nz, x0, x1, y0, y1, z0, z1 = astra.to_astra_volume(GRID)
    assert (nz, ny, nx) == GRID.shape
    assert (x0, x1, y0, y1, z0, z1) == (10.5, 14.5, 2.25, 9.75, -8.0, 4.0)
    assert tigre.to_tigre_volume(GRID) == {
        "nVoxel": (6, 5, 4), "dVoxel": (2.0, 1.5, 1.0), "sVoxel": (12.0, 7.5, 4.0), "offOrigin": (-2.0, 6.0, 12.5),
    }  # fmt: skip
    cubes = Grid((6, 5, 4), (1.5, 1.5, 1.5), (-7.0, 3.0, 11.0))
    assert leap.to_leap_volume(cubes) == (4, 5, 6, 1.5, 1.5, 13.25, 6.0, -3.25)
    with pytest.raises(GeometryError, match=r"needs cubes as voxels, these have 1 x 1.5 x 2 mm \(x, y, z\)"):
        leap.to_leap_volume(GRID)


def test_the_parameters_of_tigre_follow_its_own_steps():
    """The order of operations of computeDeltas_Siddon, one pixel at a time."""
    for geometry in (pose("T2"), pose("T3")):
        found = tigre.to_tigre(geometry)
        (alpha, theta, psi), rot = found.angles[0], found.rotDetector[0]
        rows, columns = found.nDetector
        for row, column in ((0, 0), (99, 0), (17, 101)):
            up, across = (rows - 1 - row) - (rows - 1) / 2, column - (columns - 1) / 2
            point = np.array([0.0, across * found.dDetector[1], up * found.dDetector[0]])
            point = rotation_matrix((rot[0], rot[1], rot[2])) @ point
            point += [-(found.DSD[0] - found.DSO[0]), found.offDetector[0, 1], found.offDetector[0, 0]]
            turn = rotation_matrix((0, 0, alpha)) @ rotation_matrix((0, theta, 0)) @ rotation_matrix((0, 0, psi))
            source, first, u, v = geometry.ray_frames()[0]
            np.testing.assert_allclose(turn @ point, source + first + column * u + row * v, atol=1e-9)
            np.testing.assert_allclose(turn @ [found.DSO[0], 0, 0], source, atol=1e-9)


def refused(function, *arguments):
    with pytest.raises(GeometryError) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


HELIX = orbits.helical(500.0, 800.0, np.array([0.0, 1.0, 2.0]), 40.0, Panel(8, 8, 1.0))
SHIFTED = mounted(CIRCLE, Mount((5.0, 0.0)))
TILTED = mounted(CIRCLE, Mount(tilt=(0.0, 0.0, 0.1)))
PARALLEL = orbits.parallel(300.0, np.array([0.0, 0.7]), Panel(8, 8, 1.0))
SLANTED = mounted(PARALLEL, Mount(tilt=(0.0, 0.2, 0.0)))


@pytest.mark.parametrize("out", [r2_gaussian.to_r2_gaussian, naf.to_naf])
def test_folders_of_circles_refuse_everything_else(out):
    said = "can only describe circular scans with a centred upright panel: view "
    left = f"{said}2 is not one, its source leaves the circle in the plane z = 0 by 12.73 mm (helical geometry)"
    assert left in refused(out, HELIX, GRID)
    assert f"{said}0 is not one, its panel is shifted by 5 mm (circular geometry)" in refused(out, SHIFTED, GRID)
    assert f"{said}0 is not one, its panel is tilted or turned" in refused(out, TILTED, GRID)


def test_naf_refuses_what_its_readers_read_in_two_ways():
    wide = Geometry.circular(500.0, 800.0, np.array([0.0]), Panel(8, 9, 1.0))
    assert "needs a square panel, as its readers differ" in refused(naf.to_naf, wide, GRID)
    assert "this one has 8 x 9 pixels of 1 x 1 mm" in refused(naf.to_naf, wide, GRID)
    assert "this beam is parallel" in refused(naf.to_naf, PARALLEL, GRID)
    values, angles = naf.to_naf(CIRCLE, GRID)
    assert "nDetector is [8.0, 9.0]" in refused(naf.from_naf, {**values, "nDetector": [8, 9]}, angles)


def test_a_dictionary_that_lacks_a_key_is_one_sentence():
    scanner, angles = r2_gaussian.to_r2_gaussian(CIRCLE, GRID)
    lacking = {key: value for key, value in scanner.items() if key != "DSD"}
    assert "the key DSD is missing" in refused(r2_gaussian.from_r2_gaussian, lacking, angles)
    wrong = {**scanner, "nVoxel": [4, 5]}
    assert refused(r2_gaussian.from_r2_gaussian, wrong, angles) == "nVoxel must be 3 numbers, got [4, 5]"
    shifted = {**scanner, "offDetector": [0.0, 3.0]}
    assert "offDetector is [0.0, 3.0]: R2-Gaussian's reader ignores" in refused(
        r2_gaussian.from_r2_gaussian, shifted, angles
    )


@pytest.mark.parametrize(
    ("out", "name"),
    [(leap.to_leap, "LEAP's modular beam"), (cil.to_cil_flex, "CIL's Cone3D_Flex"), (diffdrr.to_diffdrr, "DiffDRR")],
)
def test_programs_without_parallel_rays_refuse_them(out, name):
    assert refused(out, PARALLEL) == f"{name} has no parallel beam with free poses: its rays leave a source point"


@pytest.mark.parametrize("out", [tigre.to_tigre, rtk.to_rtk, cil.to_cil_flex, leap.to_leap, diffdrr.to_diffdrr])
def test_skewed_pixels_are_refused(out):
    skewed = Geometry(
        CIRCLE.source, CIRCLE.panel_center, CIRCLE.column_step, np.array([[0.6, 0, -0.8]] * 2), CIRCLE.panel
    )
    assert "needs columns and rows at right angles: those of view" in refused(out, skewed)


@pytest.mark.parametrize("out", [tigre.to_tigre, rtk.to_rtk])
def test_a_parallel_beam_at_a_slant_is_refused(out):
    assert "parallel beam meets the panel at right angles" in refused(out, SLANTED)


def test_parallel_beams_that_tigre_slants_or_does_not_lean_are_refused():
    raised = mounted(PARALLEL, Mount((3.0, 2.0)))
    assert "slants where its panel is shifted along z, as that of view 0 is by 2 mm" in refused(tigre.to_tigre, raised)
    leaning = orbits.parallel(300.0, np.array([0.0, 0.7]), Panel(8, 8, 1.0), 0.3)
    assert "leans 17.1887 degrees out of the plane" in refused(tigre.to_tigre, leaning)
    found = tigre.to_tigre(PARALLEL)
    found.angles[0, 1] = 0.1
    assert "TIGRE ignores theta and psi of a parallel beam" in refused(tigre.from_tigre, found)


def test_an_offset_slants_a_parallel_beam_of_tigre():
    found = tigre.to_tigre(PARALLEL)
    found.offDetector[:, 1] = 60.0
    slanted = tigre.from_tigre(found)
    angle = np.arccos(np.einsum("vi,vi->v", slanted.ray_direction, PARALLEL.ray_direction))
    assert angle == pytest.approx(np.arctan(60.0 / 600.0))


def test_columns_that_are_mirrored_are_refused_by_rtk():
    mirrored = Geometry(CIRCLE.source, CIRCLE.panel_center, -CIRCLE.column_step, CIRCLE.row_step, CIRCLE.panel)
    assert "those of view 0 are mirrored" in refused(rtk.to_rtk, mirrored)
    assert largest_difference(THERE_AND_BACK["tigre"](mirrored), mirrored) < NEAR


def test_leap_refuses_panels_whose_rows_go_up():
    upwards = Geometry(CIRCLE.source, CIRCLE.panel_center, -CIRCLE.column_step, -CIRCLE.row_step, CIRCLE.panel)
    assert "LEAP drops the shift of panels whose rows go up" in refused(leap.to_leap, upwards)


def test_cil_refuses_a_helix_as_a_circle():
    assert "the beam of view 2 is not that of view 0 (helical geometry)" in refused(cil.to_cil_circle, HELIX)


def test_vectors_with_another_pitch_in_each_view_are_refused():
    vectors = astra.to_astra(CIRCLE).vectors.copy()
    vectors[1, 6:9] *= 2
    assert "the column step is 1 mm long in one view and 2 mm in another" in refused(
        astra.from_astra, "cone_vec", 8, 8, vectors
    )
    assert "must be cone_vec or parallel3d_vec, got 'cone'" in refused(astra.from_astra, "cone", 8, 8, vectors)
    coarse = Geometry(CIRCLE.source, CIRCLE.panel_center, CIRCLE.column_step, 2 * CIRCLE.row_step, CIRCLE.panel)
    assert "row_step of view 0 is 2 mm long, and the pitch of the panel is 1 mm" in refused(leap.to_leap, coarse)


@pytest.mark.wrong_types
def test_astra_needs_twelve_numbers_per_view():
    vectors = astra.to_astra(CIRCLE).vectors[:, :9]
    assert "twelve numbers per view, got shape (2, 9)" in refused(astra.from_astra, "cone_vec", 8, 8, vectors)


def test_views_of_rtk_are_all_parallel_or_none():
    mixed = rtk.to_rtk(CIRCLE)
    mixed.SourceToDetectorDistance[1] = 0
    assert "view 1 of RTK's geometry has a parallel beam and others have not" in refused(
        rtk.from_rtk, mixed, CIRCLE.panel
    )
