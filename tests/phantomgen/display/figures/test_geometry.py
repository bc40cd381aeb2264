"""Pictures of geometries: what can be tested of them; somebody should look at them, too."""

import numpy as np
import pytest
from skimage.io import imread

from phantomgen.display.figures.geometry import drawn_sources, field_of_view
from phantomgen.display.viewer.orbit import draw_orbit
from phantomgen.geometry.orbits import helical, laminography, parallel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

ANGLES, PANEL, GRID = np.deg2rad([0.0, 50.0, 100.0]), Panel(20, 30, (2.0, 3.0)), Grid.cube(4, 40.0)


def test_the_field_of_view_touches_the_outermost_rays():
    circle = Geometry.circular(100, 200, ANGLES, PANEL)
    assert field_of_view(circle) == pytest.approx(100 * np.sin(np.arctan(45 / 200)))
    assert field_of_view(mounted(circle, Mount((20.0, 0.0)))) == pytest.approx(100 * np.sin(np.arctan(25 / 200)))
    assert field_of_view(mounted(circle, Mount((50.0, 0.0)))) == 0
    assert field_of_view(parallel(50.0, ANGLES, PANEL)) == pytest.approx(45, rel=1e-5)


def test_a_parallel_beam_is_drawn_from_near_the_object():
    beam = parallel(50.0, ANGLES, PANEL)
    start = drawn_sources(beam, GRID)
    np.testing.assert_allclose(np.linalg.norm(start, axis=1), np.hypot(40, 90))
    np.testing.assert_allclose(np.cross(start, beam.ray_direction), 0, atol=1e-9)


@pytest.mark.parametrize(
    "geometry",
    [
        Geometry.circular(100, 200, ANGLES[:1], PANEL),
        mounted(helical(100, 200, ANGLES, 20.0, PANEL), Mount((9.0, 0.0), (0.1, 0.2, 0.3))),
        laminography(100, 200, ANGLES, 0.5, PANEL),
        parallel(50.0, ANGLES, PANEL),
    ],
    ids=["one view", "helical", "laminography", "parallel"],
)
def test_every_kind_is_drawn(geometry, tmp_path):
    figure = geometry.draw(tmp_path / "a.png", GRID)
    assert imread(tmp_path / "a.png").std() > 10
    assert [axes.get_title() for axes in figure.axes] == [
        "from above", "from the side of view 0", "panel of view 0, from the source",
    ]  # fmt: skip
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "panel, view 0" in labels
    assert "volume" in labels
    assert len(geometry.draw().axes) == 3


def test_scenes_presets_and_datasets_are_drawn_and_bad_outputs_refused(tmp_path):
    draw_orbit(None, "kedge-small", tmp_path / "a.svg")
    assert "from above" in (tmp_path / "a.svg").read_text(encoding="utf-8") or (tmp_path / "a.svg").stat().st_size > 1e4
    with pytest.raises(InputError, match="exists: choose another name by --geometry"):
        draw_orbit(None, "kedge-small", tmp_path / "a.svg")
    with pytest.raises(InputError, match=r"ends in \.png, \.pdf or \.svg"):
        draw_orbit(None, "kedge-small", tmp_path / "a.gif")


def test_the_command_draws_without_a_display(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from phantomgen.cli.main import main

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["view", "--preset", "kedge-small", "--geometry", "orbit.png"])
    assert (result.exit_code, result.stdout) == (0, "orbit.png\n")
    assert imread(tmp_path / "orbit.png").shape[2] == 4
