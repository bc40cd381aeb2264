"""The paper's method on a scan of 16^3 voxels: all parts together, each part left out, same bits, same run folder."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from click.testing import CliRunner
from support.tiny_scans import make

from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main as recon
from recon.gaussians.model import Gaussians
from recon.published_methods.paper.recipe import COMPONENTS, PaperRecipe, Rate
from recon.published_methods.paper.reconstruct import reconstruct_paper
from spectra.threads import set_threads

# Few Gaussians and ten times the learning rates. Schedules are those of a fit of 30 000 steps: density control comes
# five times per fit, whatever its length.
QUICK = {
    name: Rate(10 * getattr(PaperRecipe, name).first, 10 * getattr(PaperRecipe, name).last)
    for name in ("centre_rate", "density_rate", "scale_rate", "rotation_rate", "fraction_rate")
}
RECIPE = PaperRecipe(
    steps=60, gaussians=400, most=600, densify_every=6000, densify_until=27_000, fraction_reset=9000, **QUICK
)
PARTS = ("centres", "log_scales", "quaternions", "coefficients")


@pytest.fixture(scope="module", autouse=True)
def _all_threads_again():
    yield
    set_threads(None)


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("data") / "tiny.h5"
    return make(path, "--views", "9", "--test-views", "2", rows=24, columns=24)


def run(scan, recipe=RECIPE, bases=None):
    deviances, counts = [], []

    def note(progress):
        deviances.append(progress.deviance)
        counts.append(len(progress.gaussians))

    with open_dataset(scan) as dataset:
        result = reconstruct_paper(dataset, recipe, bases, on_step=note)
    return result, np.array(deviances), counts


def test_the_start_is_of_the_lowest_channel_that_counts(scan):
    with open_dataset(scan) as dataset:
        first = dataset.spectra.channels[int(np.argmin(dataset.spectra.effective_energy))]
        result = reconstruct_paper(dataset.without_channel(first), replace(RECIPE, steps=1), 2)
    assert result.gaussians.coefficients.max() > 0


@pytest.mark.parametrize("bases", [2, 3])
def test_all_parts_together_fit_better_and_better(scan, bases):
    result, deviances, counts = run(scan, RECIPE, bases)
    assert deviances[-9:].mean() < 0.3 * deviances[:9].mean()
    assert max(counts) > 400
    assert len(result.gaussians) <= 600
    assert result.gaussians.basis_names == ("photoelectric", "compton", "kedge_63.3")[:bases]
    assert result.initial_volumes.shape == (bases, 16, 16, 16)
    assert 0 < result.node_error < 0.05


@pytest.mark.parametrize("name", COMPONENTS)
def test_every_component_can_be_left_out_and_then_matters(scan, name):
    recipe = replace(RECIPE, steps=10, densify_every=9000, most=10_000, least_density=3e-3, split_gradient=10.0)
    complete, without = (run(scan, replace(recipe, without=some))[0].gaussians for some in ((), (name,)))
    assert all(torch.isfinite(getattr(without, part)).all() for part in PARTS)
    same = len(complete) == len(without) and all(torch.equal(getattr(complete, p), getattr(without, p)) for p in PARTS)
    assert not same


def test_any_number_of_threads_gives_the_same_bits(scan, monkeypatch):
    monkeypatch.setattr("recon.ops.rasterize.cpu_calls.CHUNK", 50)
    monkeypatch.setattr("recon.ops.voxelize.cpu_calls.CHUNK", 50)
    results = []
    for threads in (1, 2):
        set_threads(threads)
        results.append(run(scan, replace(RECIPE, steps=20))[0].gaussians)
    assert all(torch.equal(*(getattr(result, part) for result in results)) for part in PARTS)


def test_the_edge_rests_and_then_moves(scan):
    frozen, free = (
        run(scan, replace(RECIPE, steps=steps, edge_freeze=freeze, edge_rate=1.0, without=("conditioning",)))[0]
        for steps, freeze in ((6, 30_000), (6, 1))
    )
    assert not torch.equal(frozen.gaussians.coefficients, free.gaussians.coefficients)


def test_the_command_writes_the_same_run_folder_and_says_what_it_did(scan, tmp_path):
    folder = tmp_path / "run"
    options = ["--recipe", "paper", "--steps", "3", "--without", "tv", "--without", "dssim", "-q", "--no-figures"]
    result = CliRunner().invoke(recon, ["fit", str(scan), "-o", str(folder), *options])
    assert result.exit_code == 0, result.output
    says = "recipe of the paper: 3 steps in place of 30000, all schedules scaled to match; without tv, dssim"
    assert says in result.stdout
    assert json.loads((folder / "metrics.json").read_text())["recipe"] == says
    assert yaml.safe_load((folder / "recipe.yaml").read_text())["without"] == ["tv", "dssim"]
    assert {p.name for p in folder.iterdir()} == {
        "model.safetensors", "volumes.h5", "metrics.json", "log.jsonl", "recipe.yaml", "scan.json", "figures",
    }  # fmt: skip
    model = Gaussians.load(folder / "model.safetensors")
    assert len(model.basis_names) == 3


@pytest.mark.parametrize(
    ("options", "code", "sentence"),
    [
        (["--recipe", "paper", "--without", "colour"], 1, "--without colour: there is no such component; choose from"),
        (["--recipe", "paper", "--sweeps", "1"], 2, "--sweeps cannot be used with --recipe paper"),
        (["--steps", "5"], 2, "--steps cannot be used with --recipe fast"),
        (["--without", "tv"], 2, "--without cannot be used with --recipe fast"),
    ],
)
def test_options_that_do_not_belong_together_are_refused(scan, tmp_path, options, code, sentence):
    result = CliRunner().invoke(recon, ["fit", str(scan), "-o", str(tmp_path / "run"), *options])
    assert result.exit_code == code
    assert sentence in result.stderr
    assert not (tmp_path / "run").exists()
