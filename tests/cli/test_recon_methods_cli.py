"""``recon fit --method``: voxels by classical methods, in the same run folder as Gaussians."""

import json
from contextlib import contextmanager

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make as tiny

from recon.cli.main import main as recon
from recon.gaussians.processes import Processes
from spectra.threads import set_threads

FAST = ("--no-figures", "--quiet")


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


def make(path, *settings):
    return tiny(path, *(x for s in settings for x in ("--set", s)))


@pytest.fixture(scope="module")
def circle(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "circle.h5", "geometry.views=24", "geometry.test_views=2")


@pytest.fixture(scope="module")
def helix(tmp_path_factory):
    orbit = "geometry={type: helical, sod: 500, sdd: 800, views: 24, pitch: 30, turns: 2, test_views: 2}"
    return make(tmp_path_factory.mktemp("data") / "helix.h5", orbit)


def fit(*arguments):
    return CliRunner().invoke(recon, ["fit", *map(str, arguments)])


@pytest.mark.parametrize("pipeline", ["two-step", "image"])
@pytest.mark.parametrize("method", ["fdk", "sirt", "sart", "cgls"])
def test_every_method_writes_a_run_folder(circle, tmp_path, method, pipeline):
    sweeps = () if method == "fdk" else ("--sweeps", "3")
    result = fit(circle, "-o", tmp_path / "run", "--method", method, "--pipeline", pipeline, *sweeps, *FAST, "--json")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert json.loads(result.stdout) == {"run": str(tmp_path / "run"), **metrics}
    assert metrics["method"]["method"] == method
    assert metrics["method"]["pipeline"] == pipeline
    assert all(scores["psnr"] > scores["psnr_zero"] + 2 for scores in metrics["basis"].values())
    with h5py.File(tmp_path / "run" / "volumes.h5") as file:
        assert file["basis"]["data"].shape == (3, 16, 16, 16)
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [entry["iteration"] for entry in log] == list(range(1, 2 if method == "fdk" else 4))
    assert log[-1]["psnr_compton"] == pytest.approx(metrics["basis"]["compton"]["psnr"])


@pytest.mark.parametrize("method", ["gaussian-mono", "ellipsoid", "neural", "sax-nerf"])
def test_learned_methods_write_a_run_folder_too(circle, tmp_path, method):
    options = ("--method", method, "--sweeps", "5", "--seed", "3", "--threads", "1", *FAST)
    result = fit(circle, "-o", tmp_path / "run", *options)
    assert result.exit_code == 0, result.output
    assert f"{method} in voxels" in result.stdout
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (metrics["method"]["iterations"], metrics["method"]["seed"]) == (5, 3)
    with h5py.File(tmp_path / "run" / "volumes.h5") as file:
        assert file["basis"]["data"].shape == (3, 16, 16, 16)
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert log[-1]["iteration"] == 5
    assert log[-1]["psnr_compton"] == pytest.approx(metrics["basis"]["compton"]["psnr"])


def test_a_method_without_a_volume_scores_views_and_shows_dashes(circle, tmp_path):
    options = ("--method", "x-gaussian", "--sweeps", "5", "--quiet")
    result = fit(circle, "-o", tmp_path / "run", *options)
    assert result.exit_code == 0, result.output
    assert "x-gaussian without a volume" in result.stdout
    row = next(line for line in result.stdout.splitlines() if line.startswith("compton"))
    assert row.split()[1:3] == ["-", "-"]
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["basis"]["compton"]["psnr"] is None
    assert all(scores["psnr"] > 5 for scores in metrics["channels"].values())
    with h5py.File(tmp_path / "run" / "views.h5") as file:
        assert file["views"]["data"].shape == (2, 4, 32, 32)
    assert (tmp_path / "run" / "figures" / "residuals.png").is_file()
    assert not (tmp_path / "run" / "volumes.h5").exists()
    again = fit(circle, "-o", tmp_path / "run", "--overwrite", "--no-figures", *options)
    assert again.exit_code == 0, again.output


def test_of_several_processes_the_first_one_runs_a_voxel_method(circle, tmp_path, monkeypatch):
    @contextmanager
    def second():
        yield Processes(1, 2)

    monkeypatch.setattr("recon.gaussians.processes.joined", second)
    result = fit(circle, "-o", tmp_path / "run", "--method", "fdk", *FAST)
    assert (result.exit_code, result.output) == (0, "")
    assert list(tmp_path.iterdir()) == []


def test_decomposition_by_rays_is_better_than_by_voxels(circle, tmp_path):
    """The linear fit suffers from beam hardening, mostly in the photoelectric basis."""
    scores = {}
    for pipeline in ("two-step", "image"):
        result = fit(circle, "-o", tmp_path / pipeline, "--method", "sart", "--pipeline", pipeline, *FAST, "--json")
        scores[pipeline] = json.loads(result.stdout)["basis"]["photoelectric"]["psnr"]
    assert scores["two-step"] > scores["image"] + 1


def test_the_same_run_gives_the_same_bits_and_may_be_overwritten(circle, tmp_path):
    volumes = []
    for _ in range(2):
        options = ("--method", "sart", "--sweeps", "1", "--overwrite", *FAST)
        assert fit(circle, "-o", tmp_path / "run", *options).exit_code == 0
        with h5py.File(tmp_path / "run" / "volumes.h5") as file:
            volumes.append(file["basis"]["data"][()])
    np.testing.assert_array_equal(*volumes)


def test_gaussians_start_from_one_step_voxels_on_any_orbit(helix, tmp_path):
    result = fit(helix, "-o", tmp_path / "run", "--sweeps", "1", *FAST)
    assert result.exit_code == 0, result.output
    assert "one-step" in result.stdout
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["start"] == "one-step"
    assert set(metrics["one-step"]) == set(metrics["basis"])
    with h5py.File(tmp_path / "run" / "volumes.h5") as file:
        assert file["one-step"]["data"].shape == file["basis"]["data"].shape


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--method", "fdk"), "filtered back-projection needs at least two evenly spaced views"),
        (
            ("--method", "fdk", "--sweeps", "3"),
            "the method fdk has no number of iterations to choose: leave --sweeps out",
        ),
        (("--method", "x-gaussian", "--bases", "2"), "has no basis volumes: leave --bases 2 out"),
        (("--method", "x-gaussian", "--pipeline", "image"), "has no volume: leave --pipeline image out"),
    ],
)
def test_what_cannot_be_is_one_sentence(helix, tmp_path, arguments, words):
    result = fit(helix, "-o", tmp_path / "run", *arguments, *FAST)
    assert (result.exit_code, result.stdout) == (1, "")
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
