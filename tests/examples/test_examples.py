"""The examples run, and each says the same as its scene file."""

import importlib.util
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.verification import MeasuredError
from phantomgen.simulation.run import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def kedge():
    spec = importlib.util.spec_from_file_location("plot_kedge", EXAMPLES / "plot_kedge.py")
    module = sys.modules["plot_kedge"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["plot_kedge"]


@pytest.fixture(scope="module")
def run(kedge, tmp_path_factory):
    folder = tmp_path_factory.mktemp("example")
    return folder, kedge.main(folder, kedge.QUICK)


def test_the_example_draws_and_scores_what_it_promises(run):
    folder, scores = run
    figures = {"axial.png", "profiles.png", "profiles.csv", "residuals.png", "residuals.csv"}
    assert {path.name for path in folder.iterdir()} == figures | {"scan.h5", "model.safetensors"}
    for basis in scores["basis"].values():
        assert basis["psnr"] > basis["psnr_zero"] + 1


def test_script_and_scene_file_give_the_same_counts_and_truth(kedge, run, tmp_path, monkeypatch):
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    size, path = kedge.QUICK, tmp_path / "twin.h5"
    overrides = [
        f"geometry.views={size.views}",
        f"geometry.test_views={size.test_views}",
        f"panel={{rows: {size.pixels}, columns: {size.pixels}, pitch: {204.8 / size.pixels}}}",
        f"volume.voxels={size.voxels}",
    ]
    simulate(load_scene(EXAMPLES / "kedge.yaml", overrides), path)
    with open_dataset(run[0] / "scan.h5") as script, open_dataset(path) as file:
        assert np.array_equal(script.load(), file.load())
        assert np.array_equal(script.flat, file.flat)
        assert np.array_equal(script.spectra.weights, file.spectra.weights)
        assert (script.geometry, script.grid, script.name) == (file.geometry, file.grid, file.name)
        assert {name: views.tolist() for name, views in script.splits.items()} == {
            name: views.tolist() for name, views in file.splits.items()
        }
    assert np.array_equal(read_truth(run[0] / "scan.h5").volumes, read_truth(path).volumes)


def test_by_default_script_and_scene_file_have_the_same_size(kedge):
    model, size = SceneFile.read(EXAMPLES / "kedge.yaml").model, kedge.Size()
    assert (model.geometry.views, model.geometry.test_views) == (size.views, size.test_views)
    assert (model.panel.rows, model.panel.columns, model.volume.voxels) == (size.pixels, size.pixels, size.voxels)
    assert model.panel.pitch == 204.8 / size.pixels


@pytest.mark.slow
def test_the_training_set_skips_items_that_are_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    monkeypatch.setattr(sys, "argv", ["training_set.py", "2"])
    for _ in range(2):
        runpy.run_path(str(EXAMPLES / "training_set.py"))
    assert [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()] == [
        "training/item0000.h5",
        "training/item0001.h5",
    ]


@pytest.mark.slow
def test_the_dual_energy_scan_has_a_signal_for_each_voltage(tmp_path):
    small = ["panel.rows=16", "panel.columns=16", "panel.pitch=12.8", "geometry.views=2", "geometry.test_views=1"]
    scan = load_scene(EXAMPLES / "dual_energy.yaml", [*small, "volume.voxels=8"])
    assert simulate(scan, tmp_path / "dual.h5").error.ray_worst < 1e-3
    with open_dataset(tmp_path / "dual.h5") as dataset:
        assert dataset.spectra.channels == ("low_signal", "high_signal")
        assert (np.diff(dataset.spectra.effective_energy) > 20).all()


def test_the_flat_panel_has_darks_and_a_mask(tmp_path, monkeypatch):
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    small = ["panel.rows=24", "panel.columns=96", "geometry.views=3", "geometry.test_views=1", "volume.voxels=8"]
    simulate(load_scene(EXAMPLES / "flat_panel.yaml", small), tmp_path / "panel.h5")
    with open_dataset(tmp_path / "panel.h5") as dataset:
        good = ~dataset.mask[0]
        assert not good[:, 90].any()
        assert dataset.dark[0][good].mean() == pytest.approx(5000, abs=5 * 100 / np.sqrt(50 * good.sum()))
        ratio = (dataset.load() - dataset.dark)[:, 0, :, :3][:, good[:, :3]] / dataset.flat[0, :, :3][good[:, :3]]
        assert ratio.mean() == pytest.approx(1, abs=0.05)  # air beside the object, less what is stored


@pytest.mark.parametrize("name", ["plot_first_fit", "plot_iodine", "plot_metal", "plot_torch"])
@pytest.mark.slow
def test_articles_run_from_top_to_bottom(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--quick"])
    found = runpy.run_path(str(EXAMPLES / f"{name}.py"))
    if name == "plot_first_fit":
        assert found["deviances"][-1] < 0.5 * found["deviances"][0]
        assert (tmp_path / "first-fit" / "report.html").is_file()
    elif name == "plot_iodine":
        assert found["slope"] == pytest.approx(1, abs=0.15)
    elif name == "plot_torch":
        assert abs(found["offset_error"]) < 0.01
        assert min(found["scores"]["offset fitted"]) > min(found["scores"]["panel 0.5 pixel off"])
        assert (tmp_path / "torch-example" / "torch.png").is_file()
    else:
        assert abs(found["errors"]["one-step"]) < abs(found["errors"]["image"])
    assert capsys.readouterr().out
