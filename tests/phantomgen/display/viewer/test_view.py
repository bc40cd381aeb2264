"""What a look shows, in numbers, and that pictures and pages hold it. Somebody should look at them, too."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skimage.io import imread

from phantomgen.dataset.truth import Truth
from phantomgen.display.viewer.content import (
    Content,
    limits,
    materials,
    object_limits,
    planes,
    round_scale,
    source_path,
    usual_top,
)
from phantomgen.display.viewer.load import load
from phantomgen.display.viewer.options import point_of, size_of
from phantomgen.display.viewer.output import show
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

GRID = Grid((4, 5, 6), (2.0, 1.0, 0.5), (-3.0, -2.0, -1.25))
CIRCLE = Geometry.circular(500, 800, np.deg2rad([0, 90, 180, 270, 45]), Panel(4, 6, 2.0))


def boxes() -> Truth:
    """A box of gel that holds a smaller box of bone, and a sheet thinner than a voxel beside them."""
    filled = np.zeros((4, 12, 12, 12), np.float32)
    filled[0, 2:10, 2:10, 2:8] = 1
    filled[0, 4:7, 4:7, 4:6] = 0
    filled[1, 4:7, 4:7, 4:6] = 1
    filled[2, 2:10, 2:10, 10] = 0.25
    coefficients = np.array([[0.01, 0.02], [0.04, 0.03], [0.1, 0.0], [1.0, 1.0]])
    names = ("gel", "bone", "foil", "nowhere")
    return Truth.of(Grid.cube(12, 24.0), ("photoelectric", "kedge_Gd"), names, coefficients, filled, "")


def shown_boxes() -> Content:
    truth = boxes()
    return Content("boxes", CIRCLE, truth.grid, truth, (0.0, 0.0, 0.0))


def test_planes_are_the_layers_of_voxels_that_hold_the_point():
    volume = np.arange(120.0).reshape(GRID.shape)
    x, y, z = planes(volume, GRID, (0.6, -1.4, 4.0))
    assert (x.axis, y.axis, z.axis) == ("x", "y", "z")
    assert (x.position, y.position, z.position) == (0.75, -1.0, 3.0)
    assert np.array_equal(x.values, volume[:, :, 4])
    assert np.array_equal(y.values, volume[:, 1, :])
    assert np.array_equal(z.values, volume[3])
    assert limits(GRID) == ((-1.5, -2.5, -4.0), (1.5, 2.5, 4.0))
    assert (z.low, z.high) == ((-1.5, -2.5, 3.0), (1.5, 2.5, 3.0))
    assert z.thinned(3).values.shape == (3, 3)
    assert z.thinned(3).values.tolist() == volume[3][[0, 2, 4]][:, [1, 3, 5]].tolist()
    assert np.array_equal(z.thinned(99).values, z.values)


def test_a_plane_outside_the_volume_is_refused():
    with pytest.raises(InputError, match=r"the plane y = 3 mm lies outside the volume, from -2.5 to 2.5 mm"):
        Content("toy", CIRCLE, GRID, None, (0.0, 3.0, 0.0))


def test_a_mesh_of_a_plane_has_its_values_and_edges():
    from phantomgen.display.viewer.drawing import plane_mesh

    volume = np.arange(120.0).reshape(GRID.shape)
    for plane in planes(volume, GRID, (0.0, 0.0, 0.0)):
        mesh = plane_mesh(plane)
        assert mesh.n_cells == plane.values.size
        assert np.reshape(mesh.bounds, (3, 2)).T.ravel().tolist() == pytest.approx([*plane.low, *plane.high])
        for cell in (0, 7, mesh.n_cells - 1):
            x, y, z = mesh.get_cell(cell).center
            index = tuple(
                int(np.abs(GRID.axis(name) - value).argmin()) for name, value in (("z", z), ("y", y), ("x", x))
            )
            assert mesh.cell_data["coefficient"][cell] == volume[index]


def test_materials_know_where_they_are_and_what_lies_within():
    gel, bone, foil = materials(boxes())
    assert (gel.name, bone.name, foil.name) == ("gel", "bone", "foil")
    assert (gel.level, foil.level) == (0.5, pytest.approx(0.125, abs=1e-5))
    assert bone.inner is None
    assert foil.inner is None
    assert gel.inner.sum() == 18
    assert gel.grid.shape == (10, 10, 8)
    assert limits(bone.grid) == ((-6.0, -6.0, -6.0), (2.0, 4.0, 4.0))
    assert object_limits(boxes()) == ((-8.0, -8.0, -8.0), (10.0, 8.0, 8.0))


def test_surfaces_are_closed_boxes_and_leave_inner_ones_out():
    from phantomgen.display.viewer.drawing import surface

    gel, bone, _ = materials(boxes())
    assert surface(bone).bounds == pytest.approx((-5.0, 1.0, -5.0, 3.0, -5.0, 3.0), abs=1.01)
    assert surface(bone).is_manifold
    assert surface(gel).is_manifold
    assert surface(replace(gel, inner=None)).n_cells > surface(gel).n_cells
    assert surface(gel, 200).n_cells <= 200


def test_a_shell_thinner_than_a_voxel_is_shown():
    from phantomgen.display.viewer.drawing import surface

    filled = np.zeros((2, 9, 9, 9), np.float32)
    filled[0, 2:7, 2:7, 2:7], filled[1, 2:7, 2:7, 2:7] = 0.25, 0.75
    filled[0, 3:6, 3:6, 3:6], filled[1, 3:6, 3:6, 3:6] = 0, 1
    filled[1, 2], filled[0, 2, 2:7, 2:7] = 0, 1
    for thickest in (1.0, 0.25):
        filled[0] = np.minimum(filled[0], thickest)
        truth = Truth.of(Grid.cube(9, 9.0), ("compton",), ("shell", "filling"), np.ones((2, 1)), filled, "")
        shell, filling = materials(truth)
        assert (shell.inner is None, filling.inner is None) == (False, True)
        assert surface(shell).n_cells > 0


def test_larger_voxels_keep_surfaces_where_they_are_and_closed():
    from phantomgen.display.viewer.drawing import surface

    gel, bone, _ = materials(boxes())
    assert gel.coarsened(10) is gel
    for material in (bone, replace(gel, inner=None)):
        coarse = material.coarsened(3)
        assert max(coarse.grid.shape) <= 6
        assert coarse.fraction.sum() * coarse.grid.voxel_volume == pytest.approx(
            material.fraction.sum() * material.grid.voxel_volume
        )
        assert surface(coarse).is_manifold
        assert surface(coarse).center == pytest.approx(surface(material).center, abs=1.0)


def test_an_empty_volume_has_no_bounds():
    truth = replace(boxes(), fractions=np.zeros_like(boxes().fractions))
    assert materials(truth) == []
    assert object_limits(truth) is None


def test_the_path_of_a_circular_scan_is_an_arc_closed_where_views_go_round():
    full = source_path(CIRCLE)
    assert np.linalg.norm(full, axis=1) == pytest.approx(np.full(len(full), 500.0))
    assert full[0] == pytest.approx(full[-1])
    half = source_path(Geometry.circular(500, 800, np.deg2rad(np.arange(0, 181, 10)), Panel(4, 6, 2.0)))
    assert half[0] == pytest.approx([500, 0, 0], abs=1e-9)
    assert half[-1] == pytest.approx([-500, 0, 0], abs=1e-9)
    assert half[:, 1].min() == pytest.approx(0.0, abs=1e-9)
    one = CIRCLE[[0]]
    assert source_path(one).tolist() == [[500.0, 0.0, 0.0]]


def test_the_path_of_a_free_scan_runs_through_its_sources_in_order():
    free = replace(CIRCLE, kind="free", angles=np.full(5, np.nan))
    assert np.array_equal(source_path(free), CIRCLE.source)


@pytest.mark.parametrize(
    ("top", "end", "ticks"), [(0.0173, 0.0175, 8), (0.032, 0.032, 5), (1.0, 1.0, 5), (9.9, 10.0, 5), (0.0, 1.0, 3)]
)
def test_a_colour_bar_ends_at_a_round_number(top, end, ticks):
    assert round_scale(top) == (pytest.approx(end), ticks)


def test_a_little_metal_does_not_darken_the_rest():
    volume = np.zeros((10, 10, 10), np.float32)
    volume[:5] = 0.02
    assert usual_top(volume) == pytest.approx(0.02)
    volume[0, 0, :3] = 0.7
    assert usual_top(volume) == pytest.approx(0.02)
    volume[0, 0, :3] = 0.03
    assert usual_top(volume) == pytest.approx(0.03)
    assert usual_top(0 * volume) == 0.0


def test_points_and_sizes_are_read_or_refused():
    assert point_of("0,-12.5,3") == (0.0, -12.5, 3.0)
    assert size_of("800x600") == (800, 600)
    with pytest.raises(InputError, match="a point is written x,y,z in mm"):
        point_of("1,2")
    with pytest.raises(InputError, match="a size is written WIDTHxHEIGHT"):
        size_of("800")
    with pytest.raises(InputError, match="200 to 8000 pixels"):
        size_of("8x6")


def pixels(path: Path) -> np.ndarray:
    return imread(path)[..., :3]


@pytest.mark.usefixtures("renders")
def test_a_picture_of_kedge_small_has_its_size_and_is_not_blank(tmp_path):
    show(load("kedge-small", None, voxels=32), tmp_path / "k.png", None, (800, 500))
    picture = pixels(tmp_path / "k.png")
    assert picture.shape == (500, 800, 3)
    assert (picture[0, 0] == 255).all()
    top = np.split(picture[:240, :798], 3, axis=1)
    bottom = np.split(picture[260:], 2, axis=1)
    assert all(part.std() > 10 for part in [*top, *bottom])
    assert not np.array_equal(top[0], top[1])
    assert [path.name for path in tmp_path.iterdir()] == ["k.png"]


@pytest.mark.usefixtures("renders")
def test_a_picture_without_truth_shows_the_scan(tmp_path):
    show(replace(shown_boxes(), truth=None), tmp_path / "scan.png", None, (300, 200))
    assert pixels(tmp_path / "scan.png").shape == (200, 300, 3)
    assert pixels(tmp_path / "scan.png").std() > 5


@pytest.mark.usefixtures("renders")
def test_a_page_holds_everything_and_loads_nothing(tmp_path):
    show(shown_boxes(), None, tmp_path / "boxes.html", (300, 200))
    text = (tmp_path / "boxes.html").read_text(encoding="utf-8")
    assert 1e6 < len(text) < 3e6
    assert re.findall(r"""<(?:script|img|iframe|link|source|object|embed)\b[^>]*\b(?:src|href|data)\s*=""", text) == []
    assert re.findall(r"""@import|\bimport\s*\(\s*["']|url\(\s*["']?(?!data:)[a-z/]""", text) == []
    for words in ("<title>boxes</title>", "K-edge Gd", "photoelectric", "1/mm", "foil", "circular scan, 5 views"):
        assert words in text
    assert text.count("OfflineLocalView.load(") == 1


@pytest.mark.usefixtures("renders")
@pytest.mark.parametrize("bases", [1, 2, 4])
def test_any_number_of_bases_has_its_panels(bases):
    from phantomgen.display.viewer.drawing import draw

    truth = boxes()
    names = tuple(f"kedge_{i}" for i in range(bases))
    volumes = np.resize(truth.volumes, (bases, *truth.volumes.shape[1:]))
    coefficients = np.resize(truth.coefficients, (len(truth.coefficients), bases))
    truth = replace(truth, basis_names=names, volumes=volumes, coefficients=coefficients)
    plotter, panes = draw(replace(shown_boxes(), truth=truth), (400, 300))
    assert [pane.words.title for pane in panes[:bases]] == [f"K-edge {i} keV" for i in range(bases)]
    assert len({id(pane.renderer) for pane in panes}) == bases + 2
    assert len({id(pane.camera) for pane in panes[: bases + 1]}) == 1
    assert panes[-2].words.legend == [("gel", "#56B4E9"), ("bone", "#E69F00"), ("foil", "#D55E00")]
    plotter.close()


@pytest.mark.usefixtures("renders")
def test_many_materials_stay_apart_and_in_their_panel():
    from phantomgen.display.viewer.drawing import colour_of, draw, usual_size

    assert [usual_size(columns) for columns in (3, 4, 7)] == [(1600, 1000), (1600, 1000), (2800, 1000)]
    first = materials(boxes())[0]
    colours = [colour_of(replace(first, index=i)) for i in range(20)]
    assert len(set(colours)) == 20
    plotter, panes = draw(shown_boxes(), (400, 300))
    pane = panes[-2]
    pane.clear()
    pane.words.legend = [(f"material {i}", colour) for i, colour in enumerate(colours)]
    pane.finish()
    texts = [actor for actor in pane.renderer.actors.values() if hasattr(actor, "position") and hasattr(actor, "input")]
    assert len(texts) == 40
    assert max(actor.position[1] for actor in texts) < 0.9
    plotter.close()


def test_what_is_shown_is_known_without_pyvista():
    code = (
        "import sys, phantomgen.display.viewer.load, phantomgen.display.viewer.output;"
        "sys.exit(bool({'pyvista', 'vtkmodules'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
