"""Pictures and pages of a run hold what they should, where it should be. Somebody should look at them, too."""

import re
import shutil
import subprocess
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import pyvista
import torch
from click.testing import CliRunner
from skimage.io import imread
from support.tiny_scans import one_sentence
from support.toy_run import GRID, NAMES, boxes, content, gaussians, pixel_of

from phantomgen.display.viewer.panes import Pane
from recon.cli.main import main as recon
from recon.gaussians.divided.model import DividedGaussians
from recon.output.viewer.controls import Controls
from recon.output.viewer.drawing import DIFFERENCE, RESULT, TRUTH, draw, draw_slices, layout
from recon.output.viewer.load import load_run
from recon.output.viewer.output import show
from recon.output.viewer.pointer import Pointer, PointerValues
from recon.readouts.readouts import Readouts
from recon.runs.write_run import write_volumes
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import DatasetError, InputError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SIZE = (720, 480)
KINDS = [TRUTH, RESULT, DIFFERENCE]


@pytest.fixture
def drawn(renders):
    """What draws a window and closes it at the end."""
    windows = []

    def make(*arguments, **options):
        plotter, panes = draw(*arguments, size=SIZE, **options)
        windows.append(plotter)
        return plotter, {pane.words.title: pane for pane in panes}

    yield make
    for plotter in windows:
        plotter.close()


def picture_of(plotter):
    return plotter.screenshot(return_img=True).astype(int)


def test_a_slice_has_its_colours_where_the_object_is(drawn):
    plotter, panes = drawn(content(), [2])
    picture, contrast, bone = picture_of(plotter), (6.4, 1.0, 4.0), (-7.5, 1.0, 4.0)
    colours = {
        title: picture[pixel_of(panes[f"K-edge 63.3 keV, {title}"], contrast)]
        for title in ("truth", "result", "result - truth")
    }
    assert colours["truth"] == pytest.approx([253, 231, 37], abs=3)  # the end of viridis
    assert colours["result"] == pytest.approx([33, 144, 140], abs=8)  # its middle
    red, _, blue = colours["result - truth"]
    assert blue > red + 60  # too little
    assert picture[pixel_of(panes["K-edge 63.3 keV, truth"], bone)] == pytest.approx([68, 1, 84], abs=3)
    assert picture[pixel_of(panes["K-edge 63.3 keV, result - truth"], bone)].min() > 240


def test_surfaces_and_gaussians_are_where_they_should_be(drawn):
    plotter, panes = drawn(content(), [0])
    picture = picture_of(plotter)
    red, _, blue = picture[pixel_of(panes["true materials"], (-7.0, 0.0, 0.0))]
    assert red > blue + 60  # bone is orange
    pane = panes["2 of 5 Gaussians"]
    assert pane.words.note == "y > 0 mm, 1 sigma"
    for centre, shown in (((5.0, 6.0, 8.0), True), ((-5.0, 6.0, 0.0), True), ((5.0, -6.0, 0.0), False)):
        assert (picture[pixel_of(pane, centre)].min() < 200) == shown


def test_both_sides_of_divided_gaussians_are_drawn_and_counted(drawn):
    whole = gaussians()
    sides = torch.stack([whole.coefficients, 0.5 * whole.coefficients], dim=1)
    divided = DividedGaussians(
        whole.centres, whole.log_scales, whole.quaternions, torch.zeros(len(whole)), sides, whole.basis_names, width=0.1
    )
    _, panes = drawn(replace(content(), gaussians=divided), [0])
    assert any(title.endswith("of 8 sides of 5 Gaussians") for title in panes)  # one has no coefficients


@pytest.mark.parametrize("bases", [[1], [0, 1, 2]])
@pytest.mark.parametrize(("truth", "model"), [(True, True), (True, False), (False, True)])
def test_every_panel_is_there_and_not_blank(bases, truth, model, drawn):
    plotter, panes = drawn(content(truth, model), bases)
    kinds = ["truth", "result", "result - truth"] if truth else ["result"]
    slices = [title for title in panes if title.rpartition(", ")[2] in kinds]
    assert len(slices) == len(bases) * len(kinds)
    assert len(panes) == len(slices) + (2 if truth else 1) + model
    assert len({id(pane.camera) for pane in panes.values()}) == 1
    picture = picture_of(plotter)
    for pane in panes.values():
        x0, y0, x1, y1 = np.multiply(pane.viewport, [SIZE[0], SIZE[1]] * 2).astype(int)
        assert picture[SIZE[1] - y1 : SIZE[1] - y0, x0:x1].std() > 8


@pytest.mark.parametrize("bases", range(1, 6))
@pytest.mark.parametrize("kinds", [KINDS, [RESULT]])
@pytest.mark.parametrize("others", [1, 2, 3])
def test_panels_have_cells_of_their_own(bases, kinds, others):
    found = layout(kinds, bases, others)
    places = [*found.slices.values(), *found.others]
    assert len(places) == len(set(places)) == len(kinds) * bases + others
    assert all(row < found.shape[0] and column < found.shape[1] for row, column in places)
    taken = [(row, column) for row, columns in found.groups for column in columns]
    assert len(taken) == len(set(taken))
    inner = {(row, column) for row, columns in found.groups for column in columns[1:]}
    assert not inner & set(places)


def test_keys_show_what_a_new_window_would(drawn):
    first = content()
    plotter, panes = drawn(first, [0])
    slices = {(kind, 0): pane for kind, pane in zip(KINDS, panes.values(), strict=False)}
    controls = Controls(first, slices, partial(draw_slices, content=first), [0], first.at)
    before = picture_of(plotter)
    for _ in range(5):  # more often than a window has room for colour bars
        controls.turn(1)
    controls.move("x", 3)
    controls.move("z", -99)
    assert controls.bases == [2]
    assert controls.at == (7.0, 0.0, -15.0)
    after = picture_of(plotter)
    assert (before != after).any()
    fresh = picture_of(drawn(replace(first, at=controls.at), [2])[0])
    below = slice(SIZE[1] // 2, None)  # Gaussians and surfaces stay as they are
    np.testing.assert_array_equal(after[: SIZE[1] // 2], fresh[: SIZE[1] // 2])
    np.testing.assert_array_equal(after[below], before[below])


def test_the_panel_under_the_pointer_tells_the_values_there(drawn, monkeypatch):
    first = content()
    plotter, panes = drawn(first, [2])
    slices = {(kind, 0): pane for kind, pane in zip(KINDS, panes.values(), strict=False)}
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("element", element="Yb")))
    readouts = Readouts.of(basis, np.linspace(20.0, 140.0, 121), np.ones(121))
    pointer = Pointer(slices, PointerValues(first, readouts))
    contrast = (6.4, 1.0, 4.0)
    row, column = pixel_of(slices[RESULT, 0], contrast)
    told = []
    monkeypatch.setattr(Pane, "tell", lambda pane, text: told.append(text))
    pointer.move(column, SIZE[1] - 1 - row)
    (text,) = told  # in the other panels nothing changed
    place, *coefficients, number, amount = text.splitlines()
    found = [float(word.split()[1]) for word in place.removesuffix(" mm").split(", ")]
    assert found == pytest.approx(contrast, abs=2)
    assert coefficients == ["photoelectric 0.0060 1/mm", "Compton 0.0200 1/mm", "K-edge 63.3 keV 0.0120 1/mm"]
    values = first.result[:, 9, 8, 11]
    assert number == f"{readouts.hounsfield(values, 70.0):.0f} HU at 70 keV"
    pointer.again()  # after a key has drawn the panels anew
    assert told[1:] == [text]
    pointer.move(SIZE[0] - 1, 0)
    assert told[2:] == [""]
    assert amount == f"Yb {readouts.concentration(values, 'Yb'):.2f} mg/ml"
    picture_of(plotter)


@pytest.mark.parametrize(("kind", "edge"), [(TRUTH, 0.024), (RESULT, 0.012), (DIFFERENCE, -0.012)])
def test_the_pointer_tells_what_its_panel_shows(kind, edge):
    lines = PointerValues(content(), None).text(kind, (6.4, 1.0, 4.0)).splitlines()
    assert lines[0] == "x 6.4, y 1.0, z 4.0 mm"
    assert lines[3] == f"K-edge 63.3 keV {edge:.4f} 1/mm"
    assert len(lines) == 4


def test_text_of_the_pointer_takes_the_place_of_what_was_there(drawn):
    plotter, panes = drawn(content(), [2])
    pane, empty = next(iter(panes.values())), picture_of(plotter)
    pane.tell("one line\nand another")
    plotter.render()
    assert (picture_of(plotter) != empty).any()
    pane.tell("")
    plotter.render()
    np.testing.assert_array_equal(picture_of(plotter), empty)


@pytest.mark.usefixtures("renders")
def test_a_window_listens_to_its_keys(monkeypatch):
    pressed = []
    monkeypatch.setattr(Controls, "turn", lambda _, step: pressed.append(step))
    monkeypatch.setattr(Controls, "move", lambda _, axis, step: pressed.append((axis, step)))
    with pyvista.vtk_verbosity("off"):
        plotter, _ = draw(content(), [0], size=SIZE, off_screen=False)
    for key in ("Right", "Left", "x", "Y", "z"):
        plotter.iren.interactor.SetKeySym(key)
        plotter.iren.interactor.InvokeEvent("KeyPressEvent")
    plotter.close()
    assert pressed == [1, -1, ("x", 1), ("y", -1), ("z", 1)]


@pytest.fixture(scope="module")
def page(renders, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "run.html"
    show(content(), [0, 1, 2], None, None, path, SIZE)
    return path


def test_a_page_loads_nothing_and_says_everything(page):
    text = page.read_text(encoding="utf-8")
    assert 1e6 < len(text) < 3e6
    assert re.findall(r"""<(?:script|img|iframe|link|source|object|embed)\b[^>]*\b(?:src|href|data)\s*=""", text) == []
    for words in ("<title>toy</title>", "K-edge 63.3 keV, result - truth", "2 of 5 Gaussians", "1/mm", "contrast"):
        assert words in text


def test_a_browser_draws_the_page_without_an_error(page, tmp_path):
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"none of {', '.join(BROWSERS)} is installed")
    options = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--hide-scrollbars", "--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}"]
    options += [f"--window-size={SIZE[0]},{SIZE[1]}", "--virtual-time-budget=4000"]
    picture = tmp_path / "page.png"
    command = [browser, *options, f"--screenshot={picture}", page.as_uri()]
    result = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False, timeout=300)
    said = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert [line for line in said if re.search("error|uncaught|fail", line, re.IGNORECASE)] == [], result.stderr
    shown = imread(picture)[..., :3].astype(int)
    height, width = shown.shape[0] // 3, shown.shape[1] // 4
    panels = shown[: 3 * height, : 4 * width].reshape(3, height, 4, width, 3).swapaxes(1, 2)
    middle = panels[:, :, height // 4 : 3 * height // 4, width // 6 : 2 * width // 3]  # no words, no colour bars
    assert (middle.reshape(12, -1).std(axis=1) > 5).all()
    yellow = (middle[0, 2] > [230, 210, 0]).all(axis=-1) & (middle[0, 2][..., 2] < 80)
    assert np.argwhere(yellow)[:, 1].mean() > middle.shape[3] / 2  # contrast is on the right


@pytest.fixture
def run(tmp_path):
    """A run folder with Gaussians."""
    folder = tmp_path / "run"
    folder.mkdir()
    gaussians().save(folder / "model.safetensors")
    write_volumes(folder / "volumes.h5", content().result, NAMES, GRID, {})
    (folder / "metrics.json").write_text('{"dataset": "scan.h5"}')
    return folder


def command(*arguments):
    return CliRunner().invoke(recon, ["view", *map(str, arguments)])


@pytest.fixture
def known_truth(monkeypatch):
    monkeypatch.setattr("recon.output.viewer.load.read_truth", lambda _: boxes())


def test_the_truth_beside_the_run_is_found(run, known_truth, tmp_path):
    assert load_run(run).truth is None
    (tmp_path / "scan.h5").touch()
    assert load_run(run).truth is not None
    assert load_run(run, at=(1, 2, 3)).at == (1, 2, 3)


def test_a_truth_that_does_not_fit_is_not_taken_unasked(run, tmp_path, monkeypatch):
    (tmp_path / "scan.h5").touch()
    shifted = replace(GRID, origin=(0.0, 0.0, 0.0))
    monkeypatch.setattr("recon.output.viewer.load.read_truth", lambda _: boxes(shifted))
    assert load_run(run).truth is None
    assert load_run(run, tmp_path / "scan.h5").grid == shifted
    monkeypatch.setattr("recon.output.viewer.load.read_truth", lambda _: replace(boxes(), basis_names=("a", "b", "c")))
    assert load_run(run).truth is None
    with pytest.raises(InputError, match=r"has the bases a, b, c, and none of the run's: photoelectric"):
        load_run(run, tmp_path / "scan.h5")
    monkeypatch.setattr("recon.output.viewer.load.read_truth", lambda _: None)
    with pytest.raises(DatasetError, match=r"scan.h5 holds no truth to compare with"):
        load_run(run, tmp_path / "scan.h5")


@pytest.mark.usefixtures("renders")
def test_the_command_writes_a_picture(run, tmp_path):
    picture = tmp_path / "run.png"
    result = command(run, "--screenshot", picture, "--size", "400x300", "--basis", "compton")
    assert (result.exit_code, result.stdout) == (0, f"{picture}\n"), result.output
    assert result.stderr.startswith("Note: the truth of the scan was not found")
    assert imread(picture).shape[:2] == (300, 400)
    assert "add --overwrite" in one_sentence(command(run, "--screenshot", picture))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "there is no display to open a window on: write a picture by --screenshot"),
        (("--screenshot", "v.jpg"), "--screenshot writes a .png file"),
        (("--html", "v.pdf"), "--html writes a .html file"),
        (("--html", "{}/v.html", "--basis", "iodine"), "has no basis 'iodine', only photoelectric"),
        (("--html", "{}/v.html", "--level", "compton"), "a level is written BASIS=VALUE"),
        (("--html", "{}/v.html", "--level", "iodine=1"), "has no basis 'iodine', only photoelectric"),
        (("--html", "{}/v.html", "--at", "0,0,99"), "the plane z = 99 mm lies outside the volume"),
        (("--html", "{}/v.html", "--truth", "{}/none.h5"), "there is no dataset"),
    ],
)
def test_what_cannot_be_shown_is_one_sentence(options, words, run, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert words in one_sentence(command(run, *(option.format(tmp_path) for option in options)))
    assert not Path(tmp_path / "v.html").exists()


def test_a_folder_that_is_no_run_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    assert "there is no run folder" in one_sentence(command(tmp_path / "nothing"))
    result = command(tmp_path)
    assert "is not a run folder: it has neither volumes.h5 nor model.safetensors" in one_sentence(result)
