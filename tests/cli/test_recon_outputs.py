"""``recon volume``, ``recon render``, and runs of ``recon fit`` that end early, on a toy run."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from support.gaussian_scenes import small_model
from support.tiny_scans import make

import recon as recon_package
from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.config import read_geometry_file
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.read import read_volume
from recon.cli.main import main as recon
from recon.evaluation.scoring import held_out_views
from recon.gaussians.reconstruct import reconstruct
from recon.output.volume_file import chosen_grid
from recon.runs.run_folder import MODEL, open_run, write_scan
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import GeometryError, InputError
from spectra.threads import set_threads
from spectra.transmission import Transmission

GRID = Grid((5, 6, 7), (2.0, 1.5, 1.0), (-4.0, -3.75, -3.0))
ORBITS = {
    "circular": "type: circular, sod: 60, sdd: 100, views: 5, start: 10, test_views: 2",
    "short": "type: circular, sod: 60, sdd: 100, views: 5, arc: short",
    "helical": "type: helical, sod: 60, sdd: 100, views: 6, pitch: 8, turns: 2, test_views: 1",
    "laminography": "type: laminography, sod: 60, sdd: 100, tilt: 20, angles: [0, 90, 180]",
    "parallel": "type: parallel, distance: 50, views: 4",
}


def command(*arguments):
    return CliRunner().invoke(recon, [*map(str, arguments)])


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder of fifty Gaussians that nothing was fitted to."""
    folder = tmp_path_factory.mktemp("toy") / "run"
    folder.mkdir()
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3)))
    model = replace(small_model(1), basis_names=basis.names)
    model.save(folder / MODEL)
    energy = np.linspace(30, 100, 8)
    transmission = Transmission.from_spectrum(np.eye(2).repeat(4, axis=1) * 1e3, basis.evaluate(energy))
    write_scan(folder, GRID, basis, transmission, ("low", "high"))
    return folder


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--views", "6", "--test-views", "1", rows=16, columns=24)


def test_a_run_folder_gives_back_what_was_written(run):
    fitted = open_run(run)
    assert fitted.grid == GRID
    assert fitted.basis.names == fitted.gaussians.basis_names == ("photoelectric", "compton", "kedge_63.3")
    assert fitted.transmission.channel_names == ("low", "high")


@pytest.mark.parametrize("slab", [1, 2, 1000])
def test_volumes_do_not_depend_on_the_size_of_slabs(slab, run, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.output.volume_file.SLAB_VALUES", slab * 6 * 7 * 3)
    result = command("volume", run, "-o", tmp_path / "v.h5", "--quiet")
    assert result.exit_code == 0, result.output
    with h5py.File(tmp_path / "v.h5") as file:
        np.testing.assert_array_equal(file["basis/data"], open_run(run).gaussians.volume(GRID))
        assert list(file["basis"].attrs["axes"]) == ["basis_name", "z", "y", "x"]
        assert file["basis/z"][0] == -4.0
        assert tuple(file["basis/basis_name"].asstr()) == ("photoelectric", "compton", "kedge_63.3")


def test_attenuation_at_an_energy_is_the_sum_over_bases(run, tmp_path):
    result = command("volume", run, "-o", tmp_path / "v.h5", "--energy", "65", "--json")
    assert json.loads(result.stdout)["shape"] == [5, 6, 7]
    fitted = open_run(run)
    values = fitted.basis.evaluate(np.array([65.0]))[:, 0]
    with h5py.File(tmp_path / "v.h5") as file:
        assert list(file["basis/basis_name"].asstr()) == ["attenuation_65_keV"]
        expected = np.einsum("m,mzyx->zyx", values, fitted.gaussians.volume(GRID))
        np.testing.assert_allclose(file["basis/data"][0], expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("slab", [1, 1000])
@pytest.mark.parametrize("suffix", [".h5", ".vti"])
def test_fractions_have_a_map_for_each_material(slab, suffix, run, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.output.volume_file.SLAB_VALUES", slab * 6 * 7 * 3)
    target = tmp_path / f"fractions{suffix}"
    named = ("--material", "water", "--material", "hydroxyapatite:2.9")
    result = command("volume", run, "-o", target, "--as", "fractions", *named, "-q")
    assert result.exit_code == 0, result.output
    expected = recon_package.readout(run, "fractions", materials=("water", "hydroxyapatite:2.9"))
    assert expected.values.shape == (2, *GRID.shape)
    assert (expected.values >= 0).all()
    volume = read_volume(str(target))
    assert volume.names == ("water", "hydroxyapatite")
    np.testing.assert_array_equal(volume.values, expected.values)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--as", "fractions"), "--as fractions needs the materials: add --material for each"),
        (("--as", "hu", "--material", "water"), "--material is for --as fractions, not for hu"),
        (("--material", "water"), "--material is for volume fractions: add --as fractions"),
        (("--as", "fractions", "--material", "unobtainium"), "unobtainium"),
        (("--as", "fractions", "--material", "C5H8O2"), "needs a density in g/cm^3"),
        (("--as", "fractions", "--material", "water", "--material", "H2O:0.5"), "name fewer materials"),
    ],
)
def test_fractions_that_make_no_sense_are_one_sentence(options, words, run, tmp_path):
    result = command("volume", run, "-o", tmp_path / "v.h5", *options)
    assert (result.exit_code, result.stdout) == (1, "")
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_grids_are_asked_for_by_voxels_or_by_size(dataset):
    assert chosen_grid(GRID, None, None, None, None, None) == GRID
    assert chosen_grid(GRID, "8", 2.0, None, None, None) == Grid.cube(8, 16.0)
    assert chosen_grid(GRID, None, 2.0, "16", None, None) == Grid.cube(8, 16.0)
    moved = chosen_grid(GRID, "2,4,8", 1.0, None, "10,0,-1", None)
    assert (moved.shape, moved.origin) == ((2, 4, 8), (9.5, -1.5, -4.5))
    assert chosen_grid(GRID, None, None, None, None, dataset).shape == (16, 16, 16)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--grid", "a"), "--grid needs one number, or three"),
        (("--grid", "2.5"), "--grid needs whole numbers of voxels"),
        (("--grid", "0"), "needs positive sizes"),
        (("--grid", "8", "--size", "16"), "leave one of them out"),
        (("--center", "1"), "--center needs three numbers"),
        (("--like", "scan.h5", "--voxel", "1"), "leave --grid, --voxel, --size and --center out"),
        (("--like", "scan.h5"), "there is no dataset scan.h5"),
    ],
)
def test_grids_that_make_no_sense_are_one_sentence(options, words, run, tmp_path):
    result = command("volume", run, "-o", tmp_path / "v.h5", *options)
    assert (result.exit_code, result.stdout) == (1, "")
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["volume", "render"])
def test_outputs_need_a_run_and_are_not_overwritten_by_accident(name, run, dataset, tmp_path):
    options = ("--like", dataset, "-o", tmp_path / "out.h5", "-q")
    result = command(name, tmp_path, *options)
    assert (result.exit_code, "is not a run folder" in result.stderr) == (1, True)
    (tmp_path / "out.h5").write_text("mine")
    assert "add --overwrite" in command(name, run, *options).stderr
    assert (tmp_path / "out.h5").read_text() == "mine"


def test_rendered_views_of_a_dataset_are_what_the_model_is_scored_by(run, dataset, tmp_path):
    result = command("render", run, "--like", dataset, "-o", tmp_path / "r.h5", "-q", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["shape"] == [7, 4, 16, 24]
    model = open_run(run).gaussians
    with open_dataset(dataset) as opened, h5py.File(tmp_path / "r.h5") as file:
        test = opened.splits["test"][0]
        expected = next(held_out_views(opened, model)).expected
        np.testing.assert_allclose(file["counts/data"][test], expected, rtol=1e-5)
        lengths = model.line_integrals(opened.geometry).numpy()
        np.testing.assert_array_equal(file["line_integrals/data"], lengths)


def test_a_scene_file_says_from_where_to_render(run, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(f"version: 1\ngeometry: {{{ORBITS['helical']}}}\npanel: {{rows: 4, columns: 6, pitch: 2}}\n")
    result = command("render", run, "--scene-geometry", path, "-o", tmp_path / "r.h5", "-q")
    assert result.exit_code == 0, result.output
    fitted = open_run(run)
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["counts/data"].shape == (7, 2, 4, 6)
        lengths = np.moveaxis(file["line_integrals/data"][3], 0, -1)
        np.testing.assert_allclose(
            np.moveaxis(file["counts/data"][3], 0, -1), fitted.transmission.expected(lengths), rtol=1e-5
        )
        assert file["geometry/source"].shape == (7, 3)


@pytest.mark.parametrize("orbit", ORBITS)
@pytest.mark.parametrize("mount", ["", ", sub_rays: 2, offset: {columns: 3}, tilt: {in_plane: 5, rows: 2}"])
def test_geometry_files_give_the_views_of_the_simulator(orbit, mount, tmp_path):
    from phantomgen.scene.file.scene_file import SceneFile
    from phantomgen.scene.geometry import scene_geometry

    scene = yaml.safe_load(SceneFile.preset("kedge-small").text)
    scene |= yaml.safe_load(f"geometry: {{{ORBITS[orbit]}}}\npanel: {{rows: 4, columns: 6, pitch: 2{mount}}}\n")
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    assert read_geometry_file(tmp_path / "scene.yaml") == scene_geometry(SceneFile.read(tmp_path / "scene.yaml")).true


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[", "is not YAML text"),
        ("3", "the file must be a mapping"),
        ("geometry: {type: circular, sod: 3, sdd: 5, views: 3}", "panel is missing"),
        ("geometry: {type: spiral}\npanel: {rows: 2, columns: 2, pitch: 1}", "geometry - .*'spiral'.*'circular'"),
        (
            "geometry: {type: circular, sdo: 3}\npanel: {rows: 2, columns: 2, pitch: 1}",
            "geometry.sdo is an unknown key",
        ),
        ("geometry: {type: circular, views: 3}\npanel: {rows: 2, columns: 2, pitch: 1}", "geometry.sod is missing"),
        ("geometry: {type: circular, sod: 3, sdd: 5}\npanel: {rows: 2, columns: 2, pitch: 1}", "either views"),
        (
            "geometry: {type: circular, sod: 3, sdd: 5, angles: [1], arc: 90}\npanel: {rows: 2, columns: 2, pitch: 1}",
            "leave arc and start out",
        ),
        ("geometry: {type: poses}\npanel: {rows: 2, columns: 2, pitch: 1}", "geometry.file is missing"),
        (
            "geometry: {type: parallel, distance: 3, views: 2}\npanel: {rows: 2.5, columns: 2, pitch: 1}",
            "panel.rows - input should be a valid integer",
        ),
    ],
)
def test_a_wrong_geometry_file_is_one_sentence(text, words, tmp_path):
    (tmp_path / "scene.yaml").write_text(text)
    with pytest.raises((GeometryError, InputError), match=words):
        read_geometry_file(tmp_path / "scene.yaml")


def fit_in_the_background(dataset: Path, run: Path, sweeps: str) -> subprocess.Popen:
    options = ["--sweeps", sweeps, "--no-figures", "--quiet", "--threads", "1", "-o", str(run), "--resume"]
    return subprocess.Popen([sys.executable, "-m", "recon", "fit", str(dataset), *options], stderr=subprocess.PIPE)


def wait_for_steps(folder: Path, steps: int, process: subprocess.Popen) -> None:
    while process.poll() is None:
        if (folder / "log.jsonl").exists() and (folder / "log.jsonl").read_bytes().count(b"\n") >= steps:
            return
        time.sleep(0.02)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.slow
def test_a_run_that_was_stopped_and_killed_ends_with_the_same_bytes(dataset, tmp_path):
    sweeps = "20"
    whole, run, part = tmp_path / "whole", tmp_path / "run", tmp_path / "run.part"
    common = ("--sweeps", sweeps, "--no-figures", "--quiet")
    assert command("fit", dataset, "-o", whole, *common).exit_code == 0
    process = fit_in_the_background(dataset, run, sweeps)
    wait_for_steps(part, 3, process)
    process.send_signal(signal.SIGINT)
    assert b"holds the model after step" in process.communicate()[1]
    assert process.returncode == 130
    assert open_run(run).gaussians.centres.isfinite().all()
    assert command("volume", run, "-o", tmp_path / "v.h5", "-q").exit_code == 0
    done = json.loads((run / "metrics.json").read_text())["interrupted"]["step"]
    process = fit_in_the_background(dataset, run, sweeps)
    wait_for_steps(part, done + 3, process)
    process.kill()
    process.communicate()
    assert "go on by --resume" in command("fit", dataset, "-o", run, *common).stderr
    assert "another seed" in command("fit", dataset, "-o", run, *common, "--resume", "--seed", "1").stderr
    assert command("fit", dataset, "-o", run, *common, "--resume").exit_code == 0
    for name in ("model.safetensors", "volumes.h5"):
        assert (run / name).read_bytes() == (whole / name).read_bytes()
    assert sorted(p.name for p in run.iterdir()) == sorted(p.name for p in whole.iterdir())
    steps = [json.loads(line)["step"] for line in (run / "log.jsonl").read_text().splitlines()]
    assert steps == list(range(1, 121))


def test_the_log_of_a_fit_that_began_anew_is_that_of_its_last_attempt(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "recon.gaussians.optimize._diverges", lambda state, *_: state.more_views == 1 and state.done == 3
    )
    run = tmp_path / "run"
    result = command("fit", dataset, "-o", run, "--sweeps", "4", "--no-figures")
    assert result.exit_code == 0, result.output
    assert result.stderr.count("the fit begins anew with more views per step") == 1
    steps = [json.loads(line)["step"] for line in (run / "log.jsonl").read_text().splitlines()]
    assert steps == list(range(1, len(steps) + 1))
    assert len(steps) < 24  # of six views each alone


def test_an_interrupted_fit_is_not_judged_as_a_whole_one(dataset, tmp_path, monkeypatch):
    def interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return replace(reconstruct(*arguments), notes=("the fit ended worse than its start",))

    monkeypatch.setattr("recon.runs.run_gaussians.reconstruct", interrupted)
    result = command("fit", dataset, "-o", tmp_path / "run", "--sweeps", "2", "--no-figures")
    assert "holds the model after step 1" in result.stderr
    assert "worse than its start" not in result.stderr


def test_a_bound_on_memory_changes_no_byte(dataset, tmp_path, monkeypatch):
    folders = []

    def spied(self, folder):
        self.folder = folder
        folders.append(folder)

    common = ("--sweeps", "2", "--no-figures", "--quiet")
    assert command("fit", dataset, "-o", tmp_path / "free", *common).exit_code == 0
    monkeypatch.setattr("recon.data.array_store.ArrayStore.__init__", spied)
    monkeypatch.setattr("recon.runs.memory_plan.MemoryPlan.peak", property(lambda plan: 1.0 if plan.on_disk else 2.0))
    assert command("fit", dataset, "-o", tmp_path / "bound", *common, "--memory", "1.5").exit_code == 0
    assert len(folders) == 2  # to see which grid is fitted, and for the fit
    for name in ("model.safetensors", "volumes.h5"):
        assert (tmp_path / "free" / name).read_bytes() == (tmp_path / "bound" / name).read_bytes()
    assert sorted(p.name for p in (tmp_path / "bound").iterdir()) == sorted(
        p.name for p in (tmp_path / "free").iterdir()
    )


def test_a_bound_on_memory_that_cannot_be_kept_is_refused(dataset, tmp_path):
    result = command("fit", dataset, "-o", tmp_path / "run", "--memory", "0.1")
    assert (result.exit_code, "needs at least" in result.stderr) == (1, True)
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_writes_nothing_and_counts_what_a_run_counts(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command("fit", dataset, "--dry-run", "--sweeps", "4", "--json")
    found = json.loads(result.stdout)
    assert found["steps"] == 24
    assert found["gaussians"] > 10
    assert found["voxels"] == [16, 16, 16]
    assert found["memory"]["peak_gib"] == pytest.approx(sum(found["memory"]["parts"].values()))
    assert list(tmp_path.iterdir()) == []


def test_held_out_views_are_logged_at_snapshots(dataset, tmp_path):
    options = ("--sweeps", "4", "--no-figures", "--quiet", "--held-out", "2")
    assert command("fit", dataset, "-o", tmp_path / "run", *options).exit_code == 0
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    snapshots = [entry for entry in log if "held_out_chi_square_bin0" in entry]
    assert "psnr_compton" in log[-1]
    assert [entry["step"] for entry in log if "psnr_compton" in entry] == [e["step"] for e in snapshots[::-2][::-1]]
    assert (
        "of 6 training views, 6 cannot be held out"
        in command("fit", dataset, "-o", tmp_path / "none", *options[:-1], "6").stderr
    )
