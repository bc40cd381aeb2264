"""``recon uncertainty``: standard deviations against those of scans with other noise, and what a user can do wrong."""

import json
import shutil

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import recon as package
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from recon.cli.main import main as recon
from recon.output.report.case import Case
from recon.output.report.finished_run import open_finished_run
from recon.output.report.uncertainty import parts
from recon.runs.read_run import read_run, read_volumes
from tests.support.tiny_scans import make, one_sentence

SCANS = 8  # with 7 degrees of freedom in each of 500 voxels, which are correlated
FEW = ("--set", "geometry.views=16", "--set", "geometry.test_views=2")


def call(*arguments):
    return CliRunner().invoke(recon, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("uncertainty")
    make(place / "scan.h5", *FEW)
    result = call("fit", place / "scan.h5", "-o", place / "run", "--method", "fdk", "--no-figures", "-q")
    assert result.exit_code == 0, result.output
    return place


@pytest.fixture(scope="module")
def stated(folder):
    """What the command prints for so many replicates."""
    result = call("uncertainty", folder / "run", "-n", SCANS, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.slow
def test_deviations_are_those_between_scans_with_other_noise(folder, stated, tmp_path):
    volumes = []
    for seed in range(SCANS):
        make(tmp_path / "scan.h5", *FEW, "--seed", str(seed + 100), "--overwrite")
        call(
            "fit", tmp_path / "scan.h5", "-o", tmp_path / "run", "--method", "fdk", "--no-figures", "-q", "--overwrite"
        )
        volumes.append(read_run(tmp_path / "run").volumes)
    inside = np.s_[:, 4:-4, 4:-4, 4:-4]
    true = np.sqrt(np.var(volumes, axis=0, ddof=1)[inside].mean(axis=(1, 2, 3)))
    found = read_volumes(folder / "run" / "uncertainty.h5").values[inside]
    assert np.sqrt(np.mean(found**2, axis=(1, 2, 3))) == pytest.approx(true, rel=0.25)
    assert stated["replicates"] == SCANS
    assert set(stated["volumes"]) == {"photoelectric", "compton", "kedge_63.3", "CT numbers at 70 keV"}


def test_replicates_are_kept_and_the_same_in_another_run(folder, stated):
    del stated
    times = {path: path.stat().st_mtime_ns for path in (folder / "run" / "replicates").iterdir()}
    assert len(times) == SCANS
    assert call("uncertainty", folder / "run", "-n", SCANS, "-q").exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in (folder / "run" / "replicates").iterdir()} == times
    again = folder / "again"
    shutil.copytree(folder / "run", again, ignore=shutil.ignore_patterns("replicates", "uncertainty.h5"))
    with open_dataset(folder / "scan.h5") as dataset:
        made = package.estimate_uncertainty(again, dataset, replicates=2)
    first = [read_volumes(place / "replicates" / "seed_0_000.h5").values for place in (folder / "run", again)]
    assert np.array_equal(*first)
    assert len(made.replicates) == 2
    assert made.bias == pytest.approx(made.spread.mean - read_run(again).volumes)


def test_the_deviation_of_ct_numbers_is_that_of_the_replicates(folder, stated, tmp_path):
    del stated
    target = tmp_path / "sd.h5"
    result = call("volume", folder / "run", "--as", "hu", "--energy", "60", "--deviation", "-o", target, "-q")
    assert result.exit_code == 0, result.output
    with h5py.File(target) as file:
        assert file["basis/data"].attrs["units"] == "HU"
        assert file["basis/data"].attrs["long_name"] == "standard deviation of CT numbers at 60 keV"
        written = file["basis/data"][0]
    expected = package.deviation(folder / "run", "hu", energy=60)
    assert expected.unit == "HU"
    assert written == pytest.approx(np.asarray(expected), rel=1e-5)
    one = package.readout(folder / "run", "hu", energy=60)
    assert 0 < np.median(written[4:-4, 4:-4, 4:-4]) < np.ptp(np.asarray(one))


def test_each_map_of_fractions_has_a_deviation(folder, stated, tmp_path):
    del stated
    target = tmp_path / "sd.h5"
    named = ("--as", "fractions", "--material", "water", "--material", "cortical bone")
    result = call("volume", folder / "run", *named, "--deviation", "-o", target, "-q")
    assert result.exit_code == 0, result.output
    with h5py.File(target) as file:
        names, written = file["basis/basis_name"].asstr()[...].tolist(), file["basis/data"][...]
    assert names == ["water_deviation", "cortical bone_deviation"]
    assert (written.max(axis=(1, 2, 3)) > 0).all()
    expected = package.deviation(folder / "run", "fractions", materials=["water", "cortical bone"])
    np.testing.assert_allclose(written, expected, rtol=1e-5, atol=1e-9)


def test_a_report_shows_the_deviations(folder, stated, tmp_path):
    del stated
    run = open_finished_run(folder / "run")
    with open_dataset(folder / "scan.h5") as dataset:
        picture, table = parts(Case((run,), dataset, read_truth(dataset.path), tmp_path))
    assert (tmp_path / "uncertainty.svg").is_file()
    assert f"from {SCANS} replicates" in picture.caption
    assert {row[1] for row in table.rows} == {"CT numbers at 70 keV [HU]"}


def test_what_a_user_can_do_wrong(folder, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(folder / "run", bare, ignore=shutil.ignore_patterns("replicates", "uncertainty.h5"))
    told = one_sentence(call("uncertainty", bare))
    assert "the dataset scan.h5 is neither beside" in told
    assert "--dataset" in told
    told = one_sentence(call("volume", bare, "--as", "hu", "--deviation", "-o", tmp_path / "sd.h5"))
    assert "has no replicates: make them by `recon uncertainty" in told
    assert "--deviation needs a quantity" in one_sentence(call("volume", bare, "--deviation", "-o", tmp_path / "sd.h5"))
    make(tmp_path / "other.h5", voxels=12)
    told = one_sentence(call("uncertainty", bare, "--dataset", tmp_path / "other.h5", "-q"))
    assert "has another grid or other channels than the scan of" in told
    assert not (bare / "replicates").exists()
