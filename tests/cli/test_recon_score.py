"""``recon score``: volumes of other programs beside the truth, in every format, and sentences for what is not known."""

import json

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from support.agent_scan import agent_scan
from support.edited_datasets import edited_dataset
from support.tiny_scans import make, one_sentence

import recon as package
from phantomgen.dataset.truth import read_truth
from phantomgen.exporters.volumes import Volumes, write_volumes
from phantomgen.geometry.voxel_grid import Grid
from recon.cli.main import main as recon
from spectra.errors import DatasetError, InputError

NAMES = ("photoelectric", "compton", "kedge_I")
ON_GRID = ("--axes", "zyx", "--same-grid", "--units", "1/mm")


def score(*arguments):
    return CliRunner().invoke(recon, ["score", *map(str, arguments)])


def scores(*arguments):
    result = score(*arguments, "--json", "--no-figures")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return agent_scan(tmp_path_factory.mktemp("scan"))


@pytest.fixture(scope="module")
def truth(scan):
    return read_truth(scan)


@pytest.fixture(scope="module")
def noisy(truth):
    """The K-edge volume with noise, and its score by formulas written here."""
    true = truth.volumes[2].astype(np.float64)
    volume = true + np.random.default_rng(0).normal(0, 0.0001, true.shape)
    rmse = np.sqrt(np.mean((volume - true) ** 2))
    return volume, {"rmse": rmse, "bias": (volume - true).mean(), "psnr": 20 * np.log10(true.max() / rmse)}


def same(found, expected, rel=1e-5):
    assert {key: found[key] for key in expected} == pytest.approx(expected, rel=rel)


def test_an_array_is_scored_as_formulas_say(scan, noisy, tmp_path):
    np.save(tmp_path / "v.npy", noisy[0])
    found = scores(tmp_path / "v.npy", "--truth", scan, "--as", "basis:kedge_I", *ON_GRID, "-o", tmp_path / "out")
    same(found["basis"]["kedge_I"], noisy[1])
    assert list(found["basis"]) == ["kedge_I"]
    assert found["remarks"] == []
    assert found["materials"]["iodine_10"]["kedge_I"]["true"] > 0.001
    assert found["method"]["as"] == ["basis:kedge_I"]
    assert json.loads((tmp_path / "out" / "metrics.json").read_text()).keys() | {"score"} == found.keys()


@pytest.mark.parametrize("kind", ["npz", "h5", "vti", "nii.gz", "mha", "nrrd", "tif"])
def test_every_format_has_the_score_of_the_array_and_a_mirrored_one_is_worse(scan, truth, noisy, tmp_path, kind):
    stated = ["--truth", scan, "--as", "basis:kedge_I", "--units", "1/mm"]
    psnr = []
    for name, volume in (("as-is", noisy[0]), ("mirrored", noisy[0][:, :, ::-1])):
        path, values = tmp_path / f"{name}.{kind}", volume.astype(np.float32)
        options = []
        if kind in ("vti", "nii.gz"):
            pytest.importorskip("nibabel")
            write_volumes(path, Volumes(truth.grid, {"kedge_I": values}, "no unit"))
        elif kind in ("mha", "nrrd"):
            itk = pytest.importorskip("SimpleITK")
            image = itk.GetImageFromArray(values[:, ::-1, ::-1])  # rows and columns to the left and back
            image.SetSpacing(truth.grid.spacing[::-1])
            last = [
                o + (n - 1) * s for o, n, s in zip(truth.grid.origin, values.shape, truth.grid.spacing, strict=True)
            ]
            image.SetOrigin((-last[2], -last[1], truth.grid.origin[0]))
            itk.WriteImage(image, str(path))
        elif kind == "tif":
            pytest.importorskip("tifffile").imwrite(path, values)
            options = ["--axes", "zyx", "--same-grid"]
        elif kind == "npz":
            np.savez(path, values.T)
            options = ["--axes", "xyz", "--voxel-mm", 4, "--origin-mm", "center"]
        else:
            import h5py

            with h5py.File(path, "w") as file:
                file["a/v"] = values
                file["a/grid/spacing"], file["a/grid/origin"] = truth.grid.spacing, truth.grid.origin
            path, options = f"{path}:/a/v", ["--axes", "zyx"]
        found = scores(path, *stated, *options, "-o", tmp_path / f"{name}-out")
        psnr.append(found["basis"]["kedge_I"]["psnr"])
        if name == "as-is":
            same(found["basis"]["kedge_I"], noisy[1])
            assert found["remarks"] == []
    assert psnr[1] < psnr[0] - 3
    assert "mirrored along x, the mean square error would be 9" in found["remarks"][0]  # 9. %


def test_voxels_of_another_size_are_averaged_exactly(scan, truth, tmp_path):
    fine = np.repeat(truth.volumes[1].repeat(3, axis=0), 2, axis=2)
    rough = np.random.default_rng(1).normal(0, 0.01, (8, 3, 8, 8, 2))
    rough -= rough.mean(axis=(1, 4), keepdims=True)  # means over the voxels of the truth are not changed
    np.save(tmp_path / "fine.npy", fine + rough.reshape(fine.shape))
    place = ["--axes", "zyx", "--units", "1/mm", "--voxel-mm", f"{4 / 3!r},4,2", "--origin-mm", "center"]
    found = scores(tmp_path / "fine.npy", "--truth", scan, "--as", "basis:compton", *place, "-o", tmp_path / "out")
    assert found["basis"]["compton"]["rmse"] < 1e-8
    assert found["method"]["covered"] == pytest.approx(1)
    half = ["--axes", "zyx", "--units", "1/mm", "--voxel-mm", 2, "--origin-mm", "center"]
    found = scores(tmp_path / "fine.npy", "--truth", scan, "--as", "basis:compton", *half, "-o", tmp_path / "half")
    assert found["method"]["covered"] == pytest.approx(1 * 0.5 * 1)
    assert "covers 50 % of the grid" in found["remarks"][0]


def test_all_that_a_volume_may_hold_scores_perfectly_for_the_truth(scan, truth, tmp_path):
    from phantomgen.dataset.reader import open_dataset

    with open_dataset(scan) as dataset:
        energies = [70.0, float(dataset.spectra.effective_energy[1])]
        rows = dataset.spectra.basis.evaluate(np.array(energies))
    at_70, at_channel = np.einsum("be,bzyx->ezyx", rows, truth.volumes.astype(np.float64))
    water = rows[:, 0] @ truth.coefficients[0]
    volumes = {
        "mono:70": (10 * at_70, "1/cm"),
        "channel:bin1": (at_channel, "1/mm"),
        "hu:70": (1000 * (at_70 / water - 1), "HU"),
        "density:iodine": (10.0 * truth.fractions[1] / 65535, "mg/ml"),
        "fraction:iodine_10": (truth.fractions[1] / 655.35, "%"),
    }
    for what, (values, unit) in volumes.items():
        path, out = tmp_path / f"{what.replace(':', '-')}.npy", tmp_path / what.replace(":", "-")
        np.save(path, values)
        stated = ("--truth", scan, "--as", what, "--axes", "zyx", "--same-grid", "--units", unit, "-o", out)
        found = scores(path, *stated)
        group = what.split(":")[0] if what.startswith(("density", "fraction")) else "attenuation"
        ((_, row),) = found[group].items()
        assert row["rmse"] < 2e-6 * np.abs(values).max(), what
        assert row["psnr"] is None or row["psnr"] > 80
        if what.startswith("hu"):
            assert abs(row["bias_hu"]) < 0.01
    pictured = score(tmp_path / "fraction-iodine_10.npy", *stated, "--overwrite")
    assert "fraction_iodine_10" in pictured.stdout
    assert {p.name for p in (out / "figures").iterdir()} >= {"axial.png", "profiles.png", "spectrum.png"}


@pytest.mark.slow
def test_bases_predict_counts_and_their_folder_is_a_run(scan, truth, tmp_path):
    parts = []
    for name, volume in zip(NAMES, truth.volumes, strict=True):
        np.save(tmp_path / f"{name}.npy", volume)
        parts.append(tmp_path / f"{name}.npy")
    what = [option for name in reversed(NAMES) for option in ("--as", f"basis:{name}")]
    result = score(*parts[::-1], "--truth", scan, *what, *ON_GRID, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert list(metrics["basis"]) == list(NAMES)
    assert all(row["rmse"] == 0 for row in metrics["basis"].values())
    assert set(metrics["channels"]) == {"bin0", "bin1", "bin2"}
    assert (tmp_path / "out" / "figures" / "residuals.png").is_file()
    assert "test views" in result.stdout
    assert CliRunner().invoke(recon, ["report", str(tmp_path / "out")]).exit_code == 0
    again = scores(tmp_path / "out", "--truth", scan, "-o", tmp_path / "again")
    assert again["basis"] == metrics["basis"]
    one = scores(tmp_path / "out", "--truth", scan, "--as", "basis:compton", "-o", tmp_path / "one")
    assert list(one["basis"]) == ["compton"]


def test_a_run_has_the_scores_that_it_gave_itself(tmp_path):
    scan = make(tmp_path / "tiny.h5", "--set", "geometry.views=12", "--set", "geometry.test_views=2")
    fit = CliRunner().invoke(
        recon, ["fit", str(scan), "--method", "fdk", "-o", str(tmp_path / "run"), "-q", "--json", "--no-figures"]
    )
    assert fit.exit_code == 0, (fit.output, fit.exception)
    own = json.loads(fit.stdout)
    found = scores(tmp_path / "run", "--truth", scan, "-o", tmp_path / "out")
    for name, row in found["basis"].items():
        same(own["basis"][name], row, rel=1e-12)
    assert found["materials"] == own["materials"]
    assert found["cross_talk"] == own["cross_talk"]
    for package_name in ("nibabel", "SimpleITK"):
        pytest.importorskip(package_name)
    for kind, stated in (("vti", ()), ("nii.gz", ("--as", "basis:photoelectric,compton,kedge_63.3"))):
        file = tmp_path / f"exported.{kind}"
        assert CliRunner().invoke(recon, ["export", str(tmp_path / "run"), "-o", str(file)]).exit_code == 0
        again = scores(file, "--truth", scan, *stated, "-o", tmp_path / kind)  # units and place are in the file
        for name, row in again["basis"].items():
            same(own["basis"][name], row)


def test_python_scores_as_the_command_does(scan, noisy, tmp_path):
    np.save(tmp_path / "v.npy", noisy[0])
    for volume in (noisy[0], torch.from_numpy(noisy[0]), tmp_path / "v.npy"):
        found = package.score(volume, scan, "basis:kedge_I", units="1/mm", axes="zyx", same_grid=True)
        same(found["basis"]["kedge_I"], noisy[1])
    found = package.score(
        noisy[0].T, scan, "basis:kedge_I", units="1/mm", axes="xyz", voxel_mm=4, origin_mm=(-14, -14, -14),
        out=tmp_path / "out",
    )  # fmt: skip
    same(found["basis"]["kedge_I"], noisy[1])
    assert (tmp_path / "out" / "figures" / "axial.png").is_file()
    with pytest.raises(InputError, match=r"the output .* exists"):
        package.score(noisy[0], scan, "basis:kedge_I", units="1/mm", axes="zyx", same_grid=True, out=tmp_path / "out")
    with pytest.raises(InputError, match=r"the array does not say all that a score needs: state --as \(basis:NAME"):
        package.score(noisy[0], scan)


def test_a_wrong_unit_is_remarked(scan, noisy, tmp_path):
    np.save(tmp_path / "v.npy", 10 * noisy[0])
    result = score(tmp_path / "v.npy", "--truth", scan, "--as", "basis:kedge_I", *ON_GRID, "-o", tmp_path / "out")
    assert "Warning: multiplied by 0.1, the error would be smaller by far: check --units." in result.stderr


ALL = ("--as", "basis:compton", *ON_GRID)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        (
            "v.npy",
            (),
            "state --as (basis:NAME, mono:KEV, channel:NAME, hu:KEV, density:NAME or fraction:NAME), --axes",
        ),
        (
            "v.npy",
            ("--as", "mono:60", "--axes", "zyx", "--same-grid"),
            "does not say all that a score needs: state --units",
        ),
        (
            "v.npy",
            ("--as", "hu:60", "--axes", "zyx"),
            "state --voxel-mm and --origin-mm (or --same-grid where its voxels",
        ),
        ("v.npy", ("--as", "mono:60", *ON_GRID[:3], "--units", "counts"), "the unit 'counts' is not one of mono:60"),
        (
            "v.npy",
            ("--as", "basis:compton,kedge_I", *ON_GRID),
            "must hold one volume per quantity: --as names 2, there are 1",
        ),
        ("v.npy", (*ALL, "--voxel-mm", "1"), "leave --voxel-mm and --origin-mm out"),
        (
            "v.npy",
            (*ALL[:4], "--units", "1/mm", "--voxel-mm", "a", "--origin-mm", "center"),
            "--voxel-mm needs one number",
        ),
        (
            "v.npy",
            (*ALL[:4], "--units", "1/mm", "--voxel-mm", "1", "--origin-mm", "1"),
            "--origin-mm needs three numbers",
        ),
        ("v.npy", (*ALL[:4], "--units", "1/mm", "--voxel-mm", "1", "--origin-mm", "900,0,0"), "lies outside the truth"),
        ("small.npy", ALL, "has 2 x 2 x 2 voxels (z, y, x), the grid of the dataset has 8 x 8 x 8"),
        ("nan.npy", ALL, "values must be finite, 1 are not"),
        ("large.npy", ALL, "values up to 1e+38 1/mm are no basis"),
        ("none.npy", ALL, "there is no such file"),
        ("v.stl", ALL, "a volume must be one of .npy, .nii"),
    ],
)
def test_what_is_not_known_is_one_sentence_and_nothing_is_written(scan, tmp_path, name, options, words):
    values = np.full((8, 8, 8), 0.02)
    np.save(tmp_path / "v.npy", values)
    np.save(tmp_path / "small.npy", values[:2, :2, :2])
    np.save(tmp_path / "large.npy", np.full((8, 8, 8), 1e38))
    np.save(tmp_path / "nan.npy", np.where(np.arange(512).reshape(8, 8, 8) == 3, np.nan, 0.0))
    (tmp_path / "v.stl").write_text("solid")
    before = set(tmp_path.iterdir())
    said = one_sentence(score(tmp_path / name, "--truth", scan, *options, "-o", tmp_path / "out", "-q"))
    assert words in said
    assert set(tmp_path.iterdir()) == before


def test_a_dataset_without_a_truth(scan, noisy, tmp_path):
    import shutil

    shutil.copy(scan, tmp_path / "bare.h5")
    with edited_dataset(tmp_path / "bare.h5") as file:
        del file["truth"]
    with pytest.raises(DatasetError, match="holds no truth to score against"):
        package.score(noisy[0], tmp_path / "bare.h5", "basis:compton", units="1/mm", axes="zyx", same_grid=True)


def test_grids_of_several_files_must_agree(scan, truth, tmp_path):
    for name, grid in (("a", truth.grid), ("b", Grid(truth.grid.shape, (2.0, 2.0, 2.0), truth.grid.origin))):
        write_volumes(tmp_path / f"{name}.vti", Volumes(grid, {name: truth.volumes[1]}, "numbers [1/mm]"))
    files = [tmp_path / "a.vti", tmp_path / "b.vti"]
    said = one_sentence(score(*files, "--truth", scan, "--as", "basis:compton,kedge_I", "-o", tmp_path / "out", "-q"))
    assert "b.vti has other voxels than" in said
