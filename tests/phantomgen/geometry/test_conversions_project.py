"""The same object by our projector and by those of other programs, where they are installed and need no GPU.

An object of three blobs, none in the middle, none like another: a mirrored, shifted or turned panel moves its centroid
by pixels. Run with `pip install itk-rtk astra-toolbox diffdrr gecatsim`; without them the tests are skipped.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.poses import largest_difference

from phantomgen.geometry import orbits
from phantomgen.geometry.conversions.astra import to_astra
from phantomgen.geometry.conversions.diffdrr import to_diffdrr
from phantomgen.geometry.conversions.leap import to_leap, to_leap_volume
from phantomgen.geometry.conversions.rtk import from_rtk_object, to_rtk, to_rtk_object
from phantomgen.geometry.curved_panel import module_frames
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.importers.rtk_geometry import read_rtk_geometry
from phantomgen.ops.project import project

pytestmark = pytest.mark.filterwarnings("ignore")
PANEL = Panel(100, 110, (1.1, 1.3))
GRID = Grid((40, 44, 48), (1.5, 1.25, 1.0), (-22.0, -31.0, -19.0))
BLOBS = (((8.0, -12.0, 15.0), 3.5, 1.0), ((-3.0, 4.0, -5.0), 3.5, 0.7), ((16.0, 2.0, 2.0), 2.5, 1.5))  # x, y, z; sigma
CIRCLE = Geometry.circular(500.0, 800.0, np.array([0.5236, 2.0, 4.4]), PANEL)
MOUNTED = mounted(CIRCLE, Mount((12.5, -7.25), (0.035, -0.052, 0.026)))
TURNS = np.array([rotation_matrix(turn) for turn in ((0.1, -0.05, 0.2), (0.0, 0.2, 1.0), (-0.3, 0.1, 0.0))])
POSES = {
    "circle": CIRCLE,
    "panel shifted and tilted": MOUNTED,
    "free poses": MOUNTED.moved(TURNS, np.array([[1.5, -2.0, 10.0], [-4.0, 1.0, 3.0], [0.0, 6.0, -5.0]])),
    "helix": orbits.helical(500.0, 800.0, np.array([-0.4, 0.3, 0.8]), 60.0, PANEL),
}
BENT = replace(PANEL, curvature=Curvature(640.0, PANEL.columns))
CURVED = {name: replace(POSES[name], panel=BENT) for name in ("circle", "panel shifted and tilted", "helix")}
FINE = Panel(110, 120, (0.7, 0.8))  # pixels narrower than voxels, where our projector is Joseph's
PARALLEL = mounted(orbits.parallel(150.0, np.array([0.3, 1.9]), FINE), Mount((5.0, -3.0), (0.0, 0.0, 0.1)))


def blobs(grid: Grid = GRID) -> np.ndarray:
    """The object, (z, y, x) [1/mm]."""
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    squares = [((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / s**2 for (a, b, c), s, _ in BLOBS]
    return sum(w * np.exp(-0.5 * q) for q, (_, _, w) in zip(squares, BLOBS, strict=True)).astype(np.float32)


def ours(geometry: Geometry) -> np.ndarray:
    """By our voxel projector, (view, row, column)."""
    frames = module_frames(geometry)
    return project(blobs()[None], GRID, frames, geometry.panel.rows, geometry.panel.columns)[0]


def centroids(images: np.ndarray) -> np.ndarray:
    """Row and column of the centroid of each image [pixel]."""
    total = images.sum(axis=(1, 2), dtype=np.float64)
    rows = (images.sum(axis=2) * np.arange(images.shape[1])).sum(axis=1) / total
    columns = (images.sum(axis=1) * np.arange(images.shape[2])).sum(axis=1) / total
    return np.stack([rows, columns], axis=1)


def compare(found: np.ndarray, wanted: np.ndarray, values: float) -> tuple[float, float]:
    """Largest distance of centroids [pixel] and largest difference of values, of the maximum."""
    apart = float(np.abs(centroids(found) - centroids(wanted)).max())
    error = float(np.abs(found - wanted).max() / wanted.max())
    print(f"centroid {apart:.2e} pixel, values {error:.2e} of the maximum")  # noqa: T201 - shown by pytest -s
    assert apart < 0.01
    assert error < values
    return apart, error


def need_rtk():
    itk = pytest.importorskip("itk", exc_type=ImportError)
    if not hasattr(itk, "RTK"):
        pytest.skip("itk has no RTK module")
    return itk


def by_rtk(itk, geometry: Geometry, poses) -> np.ndarray:
    """By RTK's filter after Joseph 1982, (view, row, column) with our rows."""
    kind, panel = itk.Image[itk.F, 3], geometry.panel
    volume = itk.image_from_array(np.ascontiguousarray(blobs().transpose(2, 0, 1)))
    volume.SetSpacing([GRID.spacing[i] for i in (1, 0, 2)])
    volume.SetOrigin([GRID.origin[i] for i in (1, 0, 2)])
    stack = itk.image_from_array(np.zeros((len(geometry), panel.rows, panel.columns), np.float32))
    stack.SetSpacing([panel.column_pitch, panel.row_pitch, 1.0])
    stack.SetOrigin([-(panel.columns - 1) / 2 * panel.column_pitch, -(panel.rows - 1) / 2 * panel.row_pitch, 0.0])
    projector = itk.RTK.JosephForwardProjectionImageFilter[kind, kind].New(Geometry=poses)
    projector.SetInput(0, stack)
    projector.SetInput(1, volume)
    projector.Update()
    return itk.array_from_image(projector.GetOutput())[:, ::-1]


@pytest.mark.parametrize("name", POSES)
def test_rtk_projects_as_we_do(name):
    itk, geometry = need_rtk(), POSES[name]
    compare(by_rtk(itk, geometry, to_rtk_object(geometry)), ours(geometry), 5e-5)


@pytest.mark.parametrize("name", CURVED)
def test_rtk_projects_on_a_curved_panel_as_we_do(name, tmp_path):
    from phantomgen.exporters.scans.rtk import geometry_xml

    itk, geometry = need_rtk(), CURVED[name]
    compare(by_rtk(itk, geometry, to_rtk_object(geometry)), ours(geometry), 5e-5)
    (tmp_path / "ours.xml").write_text(geometry_xml(to_rtk(geometry)))
    read = itk.RTK.read_geometry(str(tmp_path / "ours.xml"))
    found = from_rtk_object(read, PANEL)
    assert found.panel == BENT
    assert largest_difference(found, geometry) < 1e-9


def test_rtk_projects_a_parallel_beam_as_we_do():
    itk = need_rtk()
    compare(by_rtk(itk, PARALLEL, to_rtk_object(PARALLEL)), ours(PARALLEL), 5e-5)


@pytest.mark.parametrize("name", [*POSES, "parallel"])
def test_rtk_reads_our_file_and_we_read_its_file(name, tmp_path):
    from phantomgen.exporters.scans.rtk import geometry_xml

    itk, geometry = need_rtk(), (POSES | {"parallel": PARALLEL})[name]
    (tmp_path / "ours.xml").write_text(geometry_xml(to_rtk(geometry)))
    read = itk.RTK.read_geometry(str(tmp_path / "ours.xml"))
    assert largest_difference(from_rtk_object(read, geometry.panel), geometry) < 1e-9
    itk.RTK.write_geometry(to_rtk_object(geometry), str(tmp_path / "theirs.xml"))
    assert largest_difference(read_rtk_geometry(tmp_path / "theirs.xml", geometry.panel), geometry) < 1e-9


CUBES = Grid((57, 53, 53), (1.0, 1.0, 1.0), (-24.0, -30.0, -20.0))


@pytest.mark.parametrize("name", POSES)
def test_leap_projects_as_we_do(name):
    """There is no package of LEAP: build it with `cpu_CMakeLists.txt` and put `leapctype.py` into the path."""
    leapctype, geometry = pytest.importorskip("leapctype"), POSES[name]
    leap, poses, grid = leapctype.tomographicModels(), to_leap(geometry), CUBES
    leap.set_gpu(-1)
    vectors = [np.ascontiguousarray(value, dtype=np.float32) for value in poses[5:]]
    assert leap.set_modularbeam(*poses[:5], *vectors)
    assert leap.set_volume(*to_leap_volume(grid))
    found = leap.allocate_projections()
    leap.project(found, blobs(grid))
    panel = geometry.panel
    wanted = project(blobs(grid)[None], grid, geometry.ray_frames(), panel.rows, panel.columns)[0]
    compare(found, wanted, 5e-3)


FLAT = Grid((1, 110, 96), (1.0, 0.5, 0.5), (0.0, -31.0, -19.0))  # square pixels, as ASTRA needs them here
ROW = Panel(1, 200, 0.45)


@pytest.mark.parametrize("beam", ["cone", "parallel"])
def test_astra_projects_one_slice_as_we_do(beam):
    """Its projectors of volumes need CUDA: these are its fan beam and parallel beam of vectors, in the plane z = 0."""
    astra = pytest.importorskip("astra")
    angles = np.array([0.3, 2.2, 4.0])
    scan = Geometry.circular(500.0, 800.0, angles, ROW) if beam == "cone" else orbits.parallel(150.0, angles, ROW)
    geometry = mounted(scan, Mount((9.0, 0.0), (0.0, 0.1 * (beam == "cone"), 0.0)))
    found = to_astra(geometry)
    kind = {"cone_vec": ("fanflat_vec", "line_fanflat"), "parallel3d_vec": ("parallel_vec", "linear")}[found.kind]
    poses = astra.create_proj_geom(kind[0], found.columns, found.vectors[:, [0, 1, 3, 4, 6, 7]])
    (_, ny, nx), (_, dy, dx), (_, y, x) = FLAT.shape, FLAT.spacing, FLAT.origin
    edges = x - dx / 2, x + (nx - 0.5) * dx, y - dy / 2, y + (ny - 0.5) * dy
    volume = blobs(FLAT)
    projector = astra.create_projector(kind[1], poses, astra.create_vol_geom(ny, nx, *edges))
    _, images = astra.create_sino(volume[0, ::-1], projector)
    thick = np.repeat(volume, 5, axis=0)[None]  # the rays stay in the middle slice
    slices = Grid((5, ny, nx), FLAT.spacing, (-2.0, y, x))
    wanted = project(thick, slices, geometry.ray_frames(), 1, ROW.columns)[0]
    compare(images[:, None], wanted, 4e-3)


@pytest.mark.parametrize("name", POSES)
def test_diffdrr_projects_as_we_do(name):
    drr = pytest.importorskip("diffdrr.drr", exc_type=ImportError)
    import torch
    from diffdrr.pose import RigidTransform
    from torchio import ScalarImage, Subject

    geometry = POSES[name]
    cameras = to_diffdrr(geometry)
    tensor = torch.from_numpy(np.ascontiguousarray(blobs().transpose(2, 1, 0)))[None]
    image = ScalarImage(tensor=tensor, affine=GRID.affine)
    subject = Subject(volume=image, density=image, mask=None, reorient=torch.eye(4), fiducials=None)
    first = cameras.calibration[0]
    camera = drr.DRR(
        subject, float(first[2, 2]), cameras.height, float(first[0, 0]), cameras.width, float(first[1, 1]),
        renderer="trilinear",
    )  # fmt: skip
    pose, calibration = (RigidTransform(torch.tensor(m, dtype=torch.float32)) for m in cameras[:2])
    with torch.no_grad():
        found = camera(pose, calibration=calibration, n_points=400)[:, 0].numpy()
    compare(found, ours(geometry), 1e-2)


# Centred, as images of gecatsim are here; fine, as its voxels are boxes where ours are interpolated: with voxels of
# 1.5 x 1 x 1 mm values differ by 9 % of the maximum, sums by 2e-4.
SQUARE = Grid((108, 112, 112), (0.6, 0.5, 0.5), (-32.1, -27.75, -27.75))


@pytest.mark.parametrize("name", ["circle", "panel shifted", "helix"])
def test_gecatsim_projects_as_we_do(name):
    """Its panel is fixed to the source, which is at +y at angle 0; columns run against ours, rows go up."""
    module = pytest.importorskip("gecatsim.pyfiles.C_DD3Proj_mm", exc_type=ImportError)
    geometry = (POSES | {"panel shifted": mounted(CIRCLE, Mount((12.5, -7.25)))})[name]
    panel, height = geometry.panel, geometry.source[:, 2]
    angles = np.arctan2(geometry.source[:, 1], geometry.source[:, 0]) - np.pi / 2
    turn = rotation_matrix((0.0, 0.0, -float(angles[0])))
    source, center, column = (turn @ v[0] for v in (geometry.source, geometry.panel_center, geometry.column_step))
    columns = center + (np.arange(panel.columns)[::-1, None] - (panel.columns - 1) / 2) * column
    rows = center[2] - height[0] + (np.arange(panel.rows) - (panel.rows - 1) / 2) * panel.row_pitch
    volume = np.ascontiguousarray(blobs(SQUARE).transpose(1, 2, 0)[::-1])  # (row = -y, column = x, plane = z)
    (nz, ny, nx), (dz, dx, _) = SQUARE.shape, SQUARE.spacing

    def single(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values, dtype=np.float32)

    found = module.DD3Proj_mm(
        *(float(v) for v in (source[0], source[1], 0.0)), panel.columns, panel.rows,
        single(columns[:, 0]), single(columns[:, 1]), single(rows), 0.0, 0.0, 0.0, single(angles), single(height),
        len(geometry), nx, ny, nz, volume, dx, dz, np.ones((2 * ny, nx), np.uint8),
    )  # fmt: skip
    wanted = project(blobs(SQUARE)[None], SQUARE, geometry.ray_frames(), panel.rows, panel.columns)[0]
    compare(found.transpose(0, 2, 1)[:, ::-1, ::-1], wanted, 2e-3)
