"""The command line ``recon``: a run folder that is complete or not there, one sentence for what is wrong, same bits."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from safetensors.numpy import load_file
from support.edited_datasets import edited_dataset
from support.tiny_scans import make, one_sentence

from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main as recon
from recon.gaussians.recipe import RECIPES
from recon.runs.read_run import read_run
from spectra.threads import set_threads

VOXELS, PIXELS, VIEWS = 16, 32, 9
FLATS = 50  # frames, as in the preset
BASES = ("photoelectric", "compton", "kedge_63.3")
DATA = "entry/instrument/detector/data"
FAST = ("--sweeps", "1", "--no-figures", "--quiet")
VOXELWISE = ("--method", "sirt", *FAST)  # where any method will do
SCORES = {"psnr", "psnr_scaled", "psnr_zero", "scale", "ssim", "bias", "rmse"}
CHANNEL_SCORES = {"psnr", "psnr_noise", "chi_square_all", "chi_square_away", "away", "rays_away", "counts_away"}
FIGURES = {
    f"{name}.{kind}" for name in ("profiles", "convergence", "residuals", "spectrum") for kind in ("png", "csv")
} | {"axial.png", "coronal.png"}


def fit(*arguments):
    return CliRunner().invoke(recon, ["fit", *map(str, arguments)])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def metrics_of(folder: Path) -> dict:
    return json.loads((folder / "metrics.json").read_text())


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "tiny.h5", "--views", str(VIEWS), "--test-views", "2")


@pytest.fixture(scope="module")
def without_edge(tmp_path_factory):
    objects = "objects=[{type: sphere, material: bone, radius: 30}]"
    options = ("--views", "4", "--test-views", "0", "--set", objects, "--set", "detector.thresholds=[20, 60]")
    return make(tmp_path_factory.mktemp("data") / "two.h5", *options)


@pytest.fixture(scope="module")
def complete(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("complete") / "run"
    result = fit(dataset, "-o", folder, "--sweeps", "1")
    assert result.exit_code == 0, result.output
    return folder, result


@pytest.fixture
def blank_figures(monkeypatch):
    """Files of figures that nothing is drawn into, as drawing takes longer than a fit."""
    monkeypatch.setattr("phantomgen.display.figures.style._settle", lambda figure: None)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, path, **options: path.touch())


@pytest.fixture
def copy(dataset, tmp_path):
    return Path(shutil.copy(dataset, tmp_path / "copy.h5"))


def edited(path: Path, edit) -> Path:
    with edited_dataset(path) as file:
        edit(file)
    return path


def test_a_run_folder_is_complete(complete):
    folder, _ = complete
    assert names(folder) == {
        "model.safetensors",
        "volumes.h5",
        "metrics.json",
        "log.jsonl",
        "recipe.yaml",
        "scan.json",
        "figures",
    }
    assert names(folder / "figures") == FIGURES
    assert names(folder.parent) == {"run"}


@pytest.mark.slow
def test_the_model_without_planes_holds_physical_gaussians(dataset, tmp_path):
    run = tmp_path / "run"
    assert fit(dataset, "-o", run, "--kernel", "gaussian", *FAST).exit_code == 0
    model = load_file(run / "model.safetensors")
    assert {name: values.shape[1] for name, values in model.items()} == {
        "centres": 3, "log_scales": 3, "quaternions": 4, "coefficients": 3,
    }  # fmt: skip
    assert {len(values) for values in model.values()} == {metrics_of(run)["gaussians"]}
    assert (model["coefficients"] >= 0).all()
    assert all(np.isfinite(values).all() for values in model.values())


def test_planes_divide_the_gaussians_of_the_default(complete):
    run, result = complete
    model = load_file(run / "model.safetensors")
    assert {name: values.shape[1:] for name, values in model.items()} == {
        "centres": (3,), "log_scales": (3,), "quaternions": (4,), "offsets": (), "coefficients": (2, 3),
    }  # fmt: skip
    assert all(np.isfinite(values).all() for values in model.values())
    assert "% of those of voxels" in result.output
    metrics = metrics_of(run)
    assert metrics["numbers"] < metrics["gaussians"] * 17
    assert read_run(run).volumes.min() >= 0


def test_a_run_with_planes_is_exported_and_segmented(complete, tmp_path):
    run, _ = complete
    for command in (["export", run, "-o", tmp_path / "a.ply"], ["export", run, "-o", tmp_path / "a.vti"]):
        assert CliRunner().invoke(recon, [str(word) for word in command]).exit_code == 0
    assert (tmp_path / "a.ply").stat().st_size > 0
    assert CliRunner().invoke(recon, ["segment", str(run)]).exit_code == 0


def test_more_detail_places_more_gaussians(dataset, tmp_path, complete):
    assert fit(dataset, "-o", tmp_path / "run", "--detail", "1.6", *FAST).exit_code == 0
    assert metrics_of(tmp_path / "run")["gaussians"] > 1.5 * metrics_of(complete[0])["gaussians"]


def test_a_stated_number_of_gaussians_is_placed(dataset, tmp_path):
    assert fit(dataset, "-o", tmp_path / "run", "--gaussians", "150", *FAST).exit_code == 0
    assert metrics_of(tmp_path / "run")["gaussians"] == pytest.approx(150, abs=5)


def test_number_and_distance_of_gaussians_exclude_each_other(dataset, tmp_path):
    result = fit(dataset, "-o", tmp_path / "run", "--gaussians", "150", "--detail", "2", *FAST)
    assert result.exit_code == 2
    assert "--detail cannot be used with --gaussians" in result.output


def test_a_residual_is_a_part_of_the_model_and_of_its_volumes(dataset, tmp_path, monkeypatch):
    choice = "recon.gaussians.unseen_rays.UnseenRays.with_or_without"
    monkeypatch.setattr(choice, lambda rays, residual, gaussians, worth: (residual, ("a residual is kept",)))
    run = tmp_path / "run"
    result = fit(dataset, "-o", run, "--residual", *FAST)
    assert result.exit_code == 0, result.output
    assert "a residual is kept" in metrics_of(run)["notes"]
    assert "Warning: a residual" not in result.output
    stored = read_run(run)
    assert "residual" in stored.gaussians.tensors()
    assert stored.volumes == pytest.approx(stored.gaussians.volume(stored.grid), abs=1e-6)
    for command in (["volume", run, "-o", tmp_path / "a.h5"], ["segment", run], ["report", run]):
        assert CliRunner().invoke(recon, [str(word) for word in command]).exit_code == 0
    result = CliRunner().invoke(recon, ["export", str(run), "-o", str(tmp_path / "a.ply")])
    assert "the residual in voxels is left out" in result.output


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--method", "one-step"], "--residual cannot be used with --method one-step"),
        (["--phases", "4"], "--residual cannot be used with --phases"),
        (["--recipe", "paper"], "--residual cannot be used with --recipe paper"),
    ],
)
def test_a_residual_is_one_of_gaussians(dataset, tmp_path, options, said):
    result = fit(dataset, "-o", tmp_path / "run", "--residual", *options)
    assert result.exit_code == 2
    assert said in result.output


def test_volumes_state_shape_axes_and_units(complete):
    with h5py.File(complete[0] / "volumes.h5") as file:
        for group in ("basis", "one-step"):
            data = file[group]["data"]
            assert (data.shape, data.dtype, data.attrs["units"]) == ((3, VOXELS, VOXELS, VOXELS), "float32", "1/mm")
            assert list(file[group].attrs["axes"]) == ["basis_name", "z", "y", "x"]
            assert tuple(file[group]["basis_name"].asstr()[()]) == BASES
            for axis in "zyx":
                assert file[group][axis][0] == pytest.approx(-60)
                assert file[group][axis].attrs["units"] == "mm"
        assert file["grid/spacing"][()].tolist() == [8.0, 8.0, 8.0]


def test_metrics_have_the_documented_keys(complete):
    metrics = metrics_of(complete[0])
    assert set(metrics["basis"]) == set(BASES)
    assert all(set(scores) == SCORES for scores in metrics["basis"].values())
    assert set(metrics["materials"]) == {"soft_tissue", "bone", "contrast_high", "contrast_low"}
    assert set(metrics["channels"]) == {"bin0", "bin1", "bin2", "bin3"}
    assert all(set(scores) == CHANNEL_SCORES for scores in metrics["channels"].values())
    assert (metrics["dataset"], metrics["seed"]) == ("tiny.h5", 0)
    assert set(metrics["seconds"]) == {
        "check", "basis", "read", "one-step", "initialize", "approximate", "fit", "judge", "mark", "score", "write",
        "figures",
    }  # fmt: skip
    documented = (Path(__file__).parents[2] / "docs" / "reference" / "file_format.md").read_text(encoding="utf-8")
    sections = (metrics, metrics["seconds"], metrics["basis"]["compton"], metrics["channels"]["bin0"])
    material = metrics["materials"]["bone"]
    keys = {key for section in sections for key in section} | {"voxels", *material["compton"]}
    assert [key for key in keys if f"`{key}`" not in documented] == []


def test_the_log_has_a_line_per_step_and_scores_along_the_way(complete):
    log = [json.loads(line) for line in (complete[0] / "log.jsonl").read_text().splitlines()]
    assert [entry["step"] for entry in log] == list(range(1, VIEWS // RECIPES["fast"].views_per_step + 1))
    channels = {f"chi_square_bin{c}" for c in range(4)}
    assert set(log[-1]) == {"step", "seconds", "deviance", *channels, *(f"psnr_{name}" for name in BASES)}
    assert log[-1]["psnr_compton"] == pytest.approx(metrics_of(complete[0])["basis"]["compton"]["psnr"], abs=1e-3)


def test_a_run_prints_its_scores_and_figures_and_speaks_of_progress_on_stderr(complete):
    folder, result = complete
    lines = result.stdout.splitlines()
    assert lines[0].split()[:3] == ["basis", "PSNR", "SSIM"]
    assert [line.split()[0] for line in lines[1:4]] == list(BASES)
    assert [line for line in lines if line.endswith(".png")] == sorted(str(p) for p in folder.glob("figures/*.png"))
    assert lines[-1].startswith(f"Wrote {folder}")
    assert "one-step ..." in result.stderr.splitlines()


def test_json_is_one_object_and_nothing_else(dataset, tmp_path):
    result = fit(dataset, "-o", tmp_path / "run", "--json", *VOXELWISE)
    printed = json.loads(result.stdout)
    assert result.stderr == ""
    assert printed == {"run": str(tmp_path / "run"), **metrics_of(tmp_path / "run")}


def test_the_run_is_named_after_the_dataset(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fit(dataset, *VOXELWISE).exit_code == 0
    assert names(tmp_path) == {"tiny-run"}
    assert names(tmp_path / "tiny-run" / "figures") == set()


def test_a_run_that_exists_is_refused_until_told_to_replace_it(dataset, tmp_path):
    run = tmp_path / "run"
    assert fit(dataset, "-o", run, *VOXELWISE).exit_code == 0
    (run / "notes.txt").write_text("mine")
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    assert "exists: choose another name by --out, or add --overwrite" in one_sentence(fit(dataset, "-o", run, *FAST))
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before
    assert fit(dataset, "-o", run, "--overwrite", "--seed", "3", *FAST).exit_code == 0
    assert metrics_of(run)["seed"] == 3
    assert names(tmp_path) == {"run"}
    assert "notes.txt" not in names(run)


def test_a_run_that_fails_leaves_the_old_one(copy, tmp_path):
    run = tmp_path / "run"
    assert fit(copy, "-o", run, *VOXELWISE).exit_code == 0
    before = {path: path.read_bytes() for path in run.iterdir() if path.is_file()}
    edited(copy, _set(DATA, (0, 0, 0, 0), -1))
    for options in (VOXELWISE, FAST):
        one_sentence(fit(copy, "-o", run, "--overwrite", *options))
    assert {path: path.read_bytes() for path in run.iterdir() if path.is_file()} == before
    assert names(tmp_path) == {"run", "copy.h5"}


@pytest.mark.parametrize("kind", ["folder", "file", "link", "dangling link"])
def test_what_recon_did_not_write_is_never_replaced(kind, dataset, tmp_path):
    target, mine = tmp_path / "mine", tmp_path / "elsewhere"
    if kind == "folder":
        target.mkdir()
        (target / "photo.jpg").write_text("dear")
    elif kind == "file":
        target.write_text("dear")
    else:
        if kind == "link":
            assert fit(dataset, "-o", mine, *VOXELWISE).exit_code == 0
        target.symlink_to(mine, target_is_directory=True)
    before = sorted(path.name for path in tmp_path.rglob("*"))
    assert "not a folder that recon wrote" in one_sentence(fit(dataset, "-o", target, "--overwrite", *FAST))
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


def test_a_folder_in_the_place_of_the_half_written_run_is_left_alone(dataset, tmp_path):
    (tmp_path / "run.part").mkdir()
    (tmp_path / "run.part" / "photo.jpg").write_text("dear")
    assert "in the way" in one_sentence(fit(dataset, "-o", tmp_path / "run", *FAST))
    assert names(tmp_path / "run.part") == {"photo.jpg"}


def test_the_rest_of_a_run_that_was_killed_is_cleared(dataset, tmp_path):
    (tmp_path / "run.part" / "figures").mkdir(parents=True)
    assert fit(dataset, "-o", tmp_path / "run", *VOXELWISE).exit_code == 0
    assert names(tmp_path) == {"run"}


def _with_nan(view):
    def edit(file):
        counts = file[DATA][()].astype(np.float32)
        counts[view, 1, 2, 3] = np.nan
        del file[DATA]
        file[DATA] = counts

    return edit


def _set(name, place, value):
    def edit(file):
        file[name][place] = value

    return edit


def _of_version(version):
    return lambda file: file.attrs.__setitem__("schema_version", version)


def _without(name):
    return lambda file: file.__delitem__(name)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (_with_nan(0), "view 0 of {path} holds a value that is not a number"),
        (_with_nan(VIEWS + 1), "view 10 of {path} holds a value that is not a number"),
        (_set(DATA, (4, 2, 0, 0), -7), "view 4 of {path} holds negative counts, down to -7"),
        (_set(DATA, (VIEWS, 0, 0, 0), -1), "view 9 of {path} holds negative counts"),
        (_set("entry/instrument/flat/data", (3, 0, 0, 0), -1), "flat 3 of {path} holds negative counts"),
        (_of_version("2.0"), "{path} has schema version 2.0, this program knows 1.1: update it"),
        (_without("entry/instrument/flat"), "{path} has no flat field"),
        (_without("entry/spectra"), "{path} lacks /entry/spectra/energy"),
        (lambda file: file.attrs.__delitem__("schema"), "{path} is not a spectral-ct dataset"),
    ],
)
def test_a_bad_dataset_is_one_sentence_before_any_work(edit, words, copy, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.gaussians.reconstruct.decompose_views", lambda *_: pytest.fail("the work had begun"))
    assert words.format(path=copy) in one_sentence(fit(edited(copy, edit), "-o", tmp_path / "run", *FAST))
    assert names(tmp_path) == {"copy.h5"}


def test_files_that_are_no_datasets_are_one_sentence(dataset, tmp_path):
    whole = dataset.read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.h5").write_text("no dataset")
    (tmp_path / "empty.h5").write_bytes(b"")
    before = names(tmp_path)
    for name, words in {"none": "there is no dataset", "cut": "cut off", "text": "HDF5", "empty": "HDF5"}.items():
        assert words in one_sentence(fit(tmp_path / f"{name}.h5", "-o", tmp_path / "run", *FAST))
    assert names(tmp_path) == before


def test_a_region_of_air_takes_the_place_of_flats(copy, complete, tmp_path):
    edited(copy, _without("entry/instrument/flat"))
    assert "--air rows,columns" in one_sentence(fit(copy, "-o", tmp_path / "run", *FAST))
    assert "beyond the panel" in one_sentence(fit(copy, "-o", tmp_path / "run", "--air", "0:2,0:64", *FAST))
    assert "r0:r1,c0:c1" in one_sentence(fit(copy, "-o", tmp_path / "run", "--air", "top", *FAST))
    assert fit(copy, "-o", tmp_path / "run", "--air", f"0:2,0:{PIXELS}", *FAST).exit_code == 0
    with_air, with_flats = metrics_of(tmp_path / "run"), metrics_of(complete[0])
    mean_psnr = [np.mean([m["basis"][name]["psnr"] for name in BASES]) for m in (with_air, with_flats)]
    assert mean_psnr[0] > mean_psnr[1] - 0.5


def test_a_region_of_air_tells_the_open_beam_as_flats_do(dataset, copy):
    edited(copy, _without("entry/instrument/flat"))
    with open_dataset(dataset) as flats, open_dataset(copy, air=f"0:2,0:{PIXELS}") as air:
        counts, ratio = flats.flat.mean(axis=(1, 2)), air.flat / flats.flat
    of_region = 1 / np.sqrt(counts * 2 * PIXELS * VIEWS)
    assert (np.abs(ratio.mean(axis=(1, 2)) - 1) < 4 * of_region).all()
    assert (ratio.std(axis=(1, 2)) < 1.2 / np.sqrt(counts * FLATS)).all()


@pytest.mark.slow
def test_without_an_edge_in_the_scene_file_and_fit_have_two_bases(without_edge, tmp_path):
    with h5py.File(without_edge) as file:
        assert list(file["entry/spectra/basis_name"].asstr()[()]) == ["photoelectric", "compton"]
        assert file["truth/basis/data"].shape[0] == 2
    assert fit(without_edge, "-o", tmp_path / "run", *FAST).exit_code == 0
    metrics = metrics_of(tmp_path / "run")
    assert list(metrics["basis"]) == ["photoelectric", "compton"]
    assert metrics["channels"] == {}
    assert load_file(tmp_path / "run" / "model.safetensors")["coefficients"].shape[1] == 2


def test_more_bases_than_the_dataset_has_are_refused(without_edge, tmp_path):
    sentence = one_sentence(fit(without_edge, "-o", tmp_path / "run", "--bases", "3", *FAST))
    assert "has the bases photoelectric, compton: 3 were asked for" in sentence
    assert names(tmp_path) == set()


@pytest.mark.parametrize(("method", "bases"), [("gaussian", "photoelectric,kedge_63.3"), ("sirt", "2")])
@pytest.mark.slow
def test_fewer_bases_than_the_dataset_has_are_fitted_and_named(dataset, tmp_path, bases, method):
    options = ("--bases", bases, "--method", method, *FAST)
    result = fit(dataset, "-o", tmp_path / "run", *options)
    assert result.exit_code == 0, result.output
    missing = "kedge_63.3" if bases == "2" else "compton"
    assert f"Of the bases that the scan states, {missing} is not fitted" in result.stdout
    metrics = metrics_of(tmp_path / "run")
    assert metrics["bases_left_out"] == [missing]
    assert read_run(tmp_path / "run").basis_names == tuple(name for name in BASES if name != missing)
    assert {name for name, s in metrics["basis"].items() if s["psnr"] == s["psnr_zero"]} == {missing}
    page = CliRunner().invoke(recon, ["report", str(tmp_path / "run"), "--dataset", str(dataset), "--json"])
    assert page.exit_code == 0, page.output
    assert any("not fitted" in why for why in json.loads(page.stdout)["left_out"].values())


def test_bases_that_were_fitted_stand_beside_their_truth(dataset, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "recon.figures.run_figures.basis_slices", lambda *args, **options: drawn.append((args, options))
    )
    options = ("--bases", "2", "--method", "sirt", "--sweeps", "1", "-q")
    assert fit(dataset, "-o", tmp_path / "run", *options).exit_code == 0
    with h5py.File(dataset) as file:
        true = file["truth/basis/data"][:2]
    (_, shown, names, *_), options = drawn[0]
    assert names == BASES[:2]
    np.testing.assert_array_equal(shown, true)
    assert options["left_out"] == ("kedge_63.3",)


@pytest.mark.parametrize(
    ("bases", "words"),
    [
        ("compton,kedge_I", "no basis 'kedge_I': choose from photoelectric, compton, kedge_63.3"),
        ("compton,compton", "each basis is named once"),
        ("compton,,", "--bases takes auto, a number from 2, or names"),
        ("1", "--bases takes auto, a number from 2, or names"),
    ],
)
@pytest.mark.parametrize("method", ["gaussian", "fdk"])
def test_bases_that_cannot_be_are_refused(dataset, tmp_path, bases, words, method):
    assert words in one_sentence(fit(dataset, "-o", tmp_path / "run", "--bases", bases, "--method", method, "-q"))


def test_a_k_edge_that_is_looked_for_has_no_name(dataset, tmp_path):
    options = ("--bases", "compton,kedge_63.3", "--edge", "auto", *FAST)
    assert "give their number" in one_sentence(fit(dataset, "-o", tmp_path / "run", *options))


def failing(*_, **__):
    raise RuntimeError("this one")


@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("method", ["gaussian", "sirt"])
def test_a_figure_that_fails_is_a_warning(dataset, tmp_path, monkeypatch, method):
    monkeypatch.setattr("recon.figures.run_figures.profiles", failing)
    options = ("--sweeps", "1", "--method", method)
    result = fit(dataset, "-o", tmp_path / "run", "-q", *options)
    assert result.exit_code == 0, result.output
    warned = "Warning: drawing profiles.png failed (RuntimeError: this one); the model and its volumes are written.\n"
    assert result.stderr == warned
    assert {"axial.png", "residuals.png"} <= names(tmp_path / "run" / "figures")
    assert metrics_of(tmp_path / "run")["failed"] == {"drawing profiles.png": "RuntimeError: this one"}
    if method == "sirt":
        assert "Traceback" in fit(dataset, "-o", tmp_path / "again", "--debug", *options).stderr


@pytest.mark.parametrize(
    ("score", "method"),
    [
        ("score_truth", "gaussian"),
        ("read_truth", "sirt"),
        ("score_truth", "sirt"),
        ("score_test_views", "sirt"),
        ("psnr_of_bases", "sirt"),
    ],
)
@pytest.mark.slow
def test_a_score_that_fails_leaves_a_run_that_can_be_read(dataset, tmp_path, monkeypatch, score, method):
    with monkeypatch.context() as patch:
        patch.setattr(f"recon.runs.{'run' if score == 'read_truth' else 'outcomes.volume_outcome'}.{score}", failing)
        options = ("--sweeps", "1", "--no-figures", "--method", method)
        result = fit(dataset, "-o", tmp_path / "run", "-q", *options)
    assert result.exit_code == 1
    assert names(tmp_path) == {"run"}
    assert result.stderr.startswith("Warning: ")
    assert result.stderr.count("\n") == 1
    assert "(RuntimeError: this one); the model and its volumes are written" in result.stderr
    assert read_run(tmp_path / "run").basis_names == BASES
    if score != "read_truth":
        return
    page = CliRunner().invoke(recon, ["report", str(tmp_path / "run"), "--dataset", str(dataset), "--json"])
    assert page.exit_code == 0, page.output
    assert "RuntimeError: this one." in json.loads(page.stdout)["left_out"].values()


@pytest.mark.parametrize(
    ("thresholds", "words"),
    [
        ("[20]", "1 channel cannot tell 2 bases apart"),
        ("[20, 60, 69]", "cannot tell photoelectric, compton apart: they see too few different energies"),
    ],
)
def test_a_single_energy_cannot_tell_two_bases_apart(thresholds, words, tmp_path):
    source = "source={type: monochromatic, energy: 70, photons: 1000}"
    path = make(tmp_path / "mono.h5", "--views", "4", "--set", source, "--set", f"detector.thresholds={thresholds}")
    assert words in one_sentence(fit(path, "-o", tmp_path / "run", "--bases", "2", *FAST))
    assert names(tmp_path) == {"mono.h5"}


@pytest.mark.usefixtures("blank_figures")
def test_deleting_the_truth_changes_nothing_but_the_score(copy, complete, tmp_path):
    edited(copy, _without("truth"))
    result = fit(copy, "-o", tmp_path / "without", "--sweeps", "1")
    assert result.exit_code == 0, result.output
    known, blind = metrics_of(complete[0]), metrics_of(tmp_path / "without")
    assert set(known) - set(blind) == {"basis", "one-step", "materials", "cross_talk"}
    assert (known["channels"], known["gaussians"]) == (blind["channels"], blind["gaussians"])
    assert names(tmp_path / "without" / "figures") == FIGURES
    one, other = ((folder / "model.safetensors").read_bytes() for folder in (complete[0], tmp_path / "without"))
    assert one == other


@pytest.mark.slow
def test_threads_and_repetition_do_not_change_a_bit_and_the_seed_does(dataset, complete, tmp_path):
    def model(folder, *options):
        assert fit(dataset, "-o", tmp_path / folder, *options, *FAST).exit_code == 0
        return (tmp_path / folder / "model.safetensors").read_bytes()

    one, two = (model(threads, "--threads", threads) for threads in ("1", "2"))
    assert one == two == (complete[0] / "model.safetensors").read_bytes()
    assert model("other", "--seed", "1") != one


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "Missing argument"),
        (("x.h5", "--sweeps", "0"), "not in the range"),
        (("x.h5", "--sweeps", "nan"), "not a finite number"),
        (("x.h5", "--sweeps", "inf"), "not a finite number"),
        (("x.h5", "--threads", "0"), "not in the range"),
        (("x.h5", "--seed", "-1"), "not in the range"),
    ],
)
def test_wrong_usage_ends_with_2(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = fit(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert names(tmp_path) == set()


def test_debug_shows_the_traceback(tmp_path):
    result = fit(tmp_path / "none.h5", "-o", tmp_path / "run", "--debug")
    assert result.exit_code == 1
    assert type(result.exception).__name__ == "DatasetError"


@pytest.mark.parametrize("command", [["fit"], ["volume"], ["render"], []])
def test_every_help_ends_with_examples(command):
    result = CliRunner().invoke(recon, [*command, "--help"])
    assert result.exit_code == 0
    lines = [line.strip() for line in result.stdout.rstrip().splitlines()]
    examples = lines[lines.index("Examples:") + 1 :]
    assert len(examples) >= 2
    assert all(line.startswith("recon ") for line in examples)


@pytest.mark.parametrize("program", ["recon", "phantomgen"])
@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_import_nothing_heavy(program, option):
    code = (
        f"import sys; from {program}.cli.main import main; main([{option!r}], standalone_mode=False);"
        "print(sorted({'torch', 'numba', 'h5py', 'scipy', 'numpy', 'matplotlib'} & set(sys.modules)), file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stderr.strip() == "[]"
