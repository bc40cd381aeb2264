"""Contenders run and scored on a scan of 16^3 voxels, in this process."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from recon.comparison.campaign import fingerprint, pseudo_truth
from recon.comparison.contenders import clock as clocks
from recon.comparison.contenders import timed_gaussians as gaussian_run
from recon.comparison.contenders import timed_voxels as voxel_run
from recon.comparison.contenders.contender import contender
from recon.comparison.job import Job, read_result
from recon.comparison.worker import restricted, run, work
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import psnr
from recon.gaussians.recipe import Recipe, Stage
from recon.published_methods.paper.recipe import PaperRecipe
from recon.runs.methods import method_named
from spectra.errors import InputError
from spectra.threads import set_threads

LONG = 1e4  # seconds; nothing here takes so long


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--set", "geometry.views=12", "--set", "geometry.test_views=2")


def worked(scan, folder, word, budgets=(LONG,), pseudo=None):
    folder.mkdir()
    work(Job(str(scan), str(folder), word, budgets, "cpu", 1, pseudo))
    assert not (folder / "models").exists()
    return [read_result(folder, budget) for budget in budgets]


def test_a_method_without_a_volume_is_scored_by_its_views(scan, tmp_path, monkeypatch):
    monkeypatch.setattr(voxel_run, "method_named", lambda name: method_named(name, 4))
    found = worked(scan, tmp_path / "run", "x-gaussian")[0]
    assert found["basis"] == found["energies"] == {}
    assert all(s["psnr"] > 5 for s in found["views"]["honest"].values())
    assert found["curve"] == []


@pytest.mark.parametrize("word", ["fdk", "sart+2", "cgls+image", "one-step"])
def test_a_contender_leaves_its_scores(scan, tmp_path, word):
    pseudo = tmp_path / "pseudo.npy"
    with open_dataset(scan) as dataset:
        np.save(pseudo, pseudo_truth(dataset))
    found = worked(scan, tmp_path / "run", word, pseudo=str(pseudo))[0]
    assert found["finished"]
    assert found["done"] > 0
    assert (found["primitives"], found["kind"]) == (16**3, "voxels")
    channels = ["bin0", "bin1", "bin2", "bin3"]
    for protocol in ("honest", "paper", "r2"):
        assert list(found["views"][protocol]) == list(found["energies"][protocol]) == channels
        assert all(s["psnr"] > 10 and s["lpips"] is None for s in found["views"][protocol].values())
    bases = found["basis"]["honest"]
    missing = {"kedge_63.3"} if word == "sart+2" else set()
    assert {name for name, scores in bases.items() if not scores} == missing
    assert all(s["psnr"] > s["psnr_zero"] + 2 for s in bases.values() if s)
    assert all(s["away"] > 0 for s in found["chi_square"].values())
    assert set(found["materials"]) == {"soft_tissue", "bone", "contrast_high", "contrast_low"}
    if not missing:
        assert found["curve"][-1]["psnr_compton"] == pytest.approx(bases["compton"]["psnr"], abs=1e-6)


def test_scores_of_views_agree_with_what_counts_say(scan, tmp_path):
    """Honest PSNR of log projections, computed here from the model's own prediction of the counts."""
    with open_dataset(scan) as dataset:
        who = contender("fdk")
        job = Job(str(scan), str(tmp_path), "fdk", (LONG,), "cpu", 1, None)
        runs = run(dataset, who, job, tmp_path / "models")
        model = runs.load(runs.recorders[0].recorded[-1].path).bases
        measured = read_measurements(dataset, dataset.splits["test"])
        lengths = np.moveaxis(model.line_integrals(measured.geometry).numpy(), 1, -1)
        expected = np.moveaxis(measured.transmission.expected(lengths), -1, 1)
        air = measured.gains * measured.open_beam * measured.exposure[:, :, None, None]
        truth = np.log(air / np.maximum(measured.counts, 0.5))
        error = np.log(air / np.maximum(expected * air / measured.open_beam, 0.5)) - truth
    found = worked(scan, tmp_path / "run", "fdk")[0]["views"]["honest"]
    for c, scores in enumerate(found.values()):
        own = psnr(float(truth[:, c].max()), float(np.mean(error[:, c] ** 2)))
        assert scores["psnr"] == pytest.approx(own, abs=1e-3)


@pytest.fixture
def counting(monkeypatch):
    """A clock that goes on by a second whenever somebody looks at it."""
    ticks = count()
    monkeypatch.setitem(clocks.CLOCKS, "cpu", lambda: float(next(ticks)))


def test_a_budget_holds_the_last_iteration_within_it(scan, tmp_path, counting):
    del counting
    short, long = worked(scan, tmp_path / "run", "sirt", (20.0, LONG))
    assert short["seconds"] <= 20
    assert not short["finished"]
    assert 0 < short["done"] < long["done"] == 80
    point = next(p for p in long["curve"] if p["done"] == short["done"])
    assert short["basis"]["honest"]["compton"]["psnr"] == pytest.approx(point["psnr_compton"], abs=1e-6)


def test_a_budget_before_the_first_iteration_is_said_to_hold_nothing(scan, tmp_path):
    found = worked(scan, tmp_path / "run", "fdk", (1e-6,))[0]
    assert found["error"] == "nothing is ready within 1e-06 s: no iteration ended"
    assert found["too_short"]  # it will not be tried again


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("one-step+image", "the method one-step works on counts: leave --pipeline image out"),
        ("sart+views-99", "12 training views: 99 cannot be used"),
        ("sart+blind-red", "no channel 'red' to leave out: it has bin0, bin1, bin2, bin3"),
    ],
)
def test_what_a_method_refuses_is_its_result(scan, tmp_path, word, sentence):
    assert sentence in worked(scan, tmp_path / "run", word)[0]["error"]


def test_a_contender_sees_only_what_it_may(scan):
    with open_dataset(scan) as dataset:
        few = restricted(dataset, contender("fdk+views-3+blind-bin1"))
        measured = read_measurements(few, few.splits["train"])
        train = dataset.splits["train"]
        np.testing.assert_array_equal(few.splits["train"], train[[0, len(train) // 3, 2 * len(train) // 3]])
        np.testing.assert_array_equal(few.splits["test"], dataset.splits["test"])
        assert not measured.counts[:, 1].any()
        assert not measured.gains[1].any()
        assert measured.counts[:, 0].all()
        assert dataset.mask.sum() == 0
        with pytest.raises(InputError, match="has no channel 'bin9'"):
            dataset.without_channel("bin9")


@pytest.fixture
def quick(monkeypatch):
    """Recipes that take seconds."""
    monkeypatch.setattr(gaussian_run, "FAST", Recipe(stages=(Stage(1.0, 3.0),), views_per_step=4))
    small = PaperRecipe(steps=12, gaussians=200, most=300)
    monkeypatch.setattr(gaussian_run, "PaperRecipe", lambda without: replace(small, without=without))


@pytest.mark.parametrize("word", ["gaussian", "gaussian+2+blind-bin3", "paper+without-tv"])
@pytest.mark.slow
def test_gaussians_take_part(scan, tmp_path, quick, word):
    del quick
    found = worked(scan, tmp_path / "run", word, (1e-6, LONG))
    assert "the start alone takes" in found[0]["error"]
    assert found[1]["finished"]
    assert found[1]["kind"] == "Gaussians"
    assert found[1]["done"] == found[1]["total"]
    assert all(s["psnr"] is not None for s in found[1]["views"]["honest"].values())


@pytest.mark.slow
def test_a_fit_is_planned_to_end_within_its_budget(scan, tmp_path, quick, counting):
    """A shorter schedule from the same start, beside the whole one."""
    del quick, counting
    whole = worked(scan, tmp_path / "whole", "gaussian")[0]
    budget = whole["curve"][0]["seconds"] + 3.0
    short = worked(scan, tmp_path / "short", "gaussian", (budget,))[0]
    assert short["seconds"] <= budget
    assert short["total"] < whole["total"] == 9


@pytest.mark.slow
def test_a_budget_that_holds_no_start_holds_gaussians_that_follow_voxels(scan, tmp_path, quick, counting):
    del quick, counting
    found = worked(scan, tmp_path / "run", "gaussian", (2.5,))[0]
    assert found["seconds"] <= 2.5
    assert (found["done"], found["finished"], found["kind"]) == (0, False, "Gaussians")
    assert all(s["psnr"] > 10 for s in found["basis"]["honest"].values())


def test_a_file_is_told_from_another(scan, tmp_path):
    other = tmp_path / "other.h5"
    other.write_bytes(scan.read_bytes())
    assert fingerprint(other) == fingerprint(scan)
    other.write_bytes(scan.read_bytes()[:-1] + b"x")
    assert fingerprint(other) != fingerprint(scan)


@pytest.mark.skipif(os.name != "posix", reason="elsewhere a process does not see that its parent is gone")
def test_a_worker_ends_when_the_comparison_is_killed():
    says = "from recon.comparison.worker import end_with_parent; end_with_parent(); print(1, flush=True)"
    worker = f"{says}; import time; time.sleep(100)"
    comparison = subprocess.Popen(
        [sys.executable, "-c", f"import subprocess, sys; subprocess.run([sys.executable, '-c', {worker!r}])"],
        stdout=subprocess.PIPE,
    )
    assert comparison.stdout is not None
    assert comparison.stdout.readline() == b"1\n"  # the worker watches
    comparison.kill()
    rest, _ = comparison.communicate(timeout=50)  # waits until the worker has let go of the pipe as well
    assert (rest, comparison.returncode) == (b"", -signal.SIGKILL)
