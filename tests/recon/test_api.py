"""`recon.fit` from Python: callbacks, volumes, projections, and the folder that it saves."""

import json

import numpy as np
import pytest
from support.tiny_scans import make

import phantomgen
import recon
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.recipe import Stage
from recon.runs.run_folder import open_run
from recon.scatter.chosen_scatter import SCATTER, ChosenScatter, read_scatter
from spectra.errors import InputError

SHORT = recon.Recipe(stages=(Stage(1.0, 2.0),), prior=0.0)


class Watching:
    def __init__(self, last):
        self.steps, self.last, self.ended = [], last, None

    def on_step(self, progress):
        self.steps.append(progress.step)
        return progress.step == self.last

    def on_end(self, fit):
        self.ended = fit


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return make(tmp_path_factory.mktemp("data") / "tiny.h5", "--views", "8", "--test-views", "2")


@pytest.fixture(scope="module")
def watching():
    return Watching(last=3)


@pytest.fixture(scope="module")
def fit(path, watching):
    return recon.fit(path, SHORT, callbacks=[watching, lambda progress: None])


def test_callbacks_hear_every_step_and_end_the_fit(fit, watching):
    assert watching.steps == [1, 2, 3]
    assert watching.ended is fit
    assert [entry["step"] for entry in fit.log] == [1, 2, 3]


def test_scatter_is_taken_away_as_the_command_does(path, tmp_path):
    found = recon.fit(path, SHORT, scatter="kernel:0.05,60", callbacks=[lambda progress: progress.step == 2])
    folder = found.save(tmp_path / "run")
    with phantomgen.open(path) as dataset:
        stored = read_scatter(folder / SCATTER, dataset)
        expected = ChosenScatter.of(dataset, ScatterKernel(0.05, 60.0)).dataset.scatter
    np.testing.assert_allclose(stored.values, expected.values, rtol=1e-6)
    plain = recon.fit(path, SHORT, callbacks=[lambda progress: progress.step == 2])
    assert not np.array_equal(found.gaussians.coefficients, plain.gaussians.coefficients)
    assert plain.scatter is None
    with pytest.raises(InputError, match="got 'fog'"):
        recon.fit(path, SHORT, scatter="fog")


def test_a_fit_evaluates_on_any_grid(fit):
    np.testing.assert_array_equal(fit.volume(), fit.gaussians.volume(fit.grid))
    assert fit.volume(Grid.cube(4, 20.0)).shape == (3, 4, 4, 4)


def test_a_fit_renders_what_its_model_expects(fit, path):
    with phantomgen.open(path) as dataset:
        geometry, spectra = dataset.geometry[[0, 3]], dataset.spectra
    shown = fit.render(geometry)
    np.testing.assert_allclose(
        shown.line_integrals, fit.gaussians.line_integrals(geometry).numpy(), rtol=1e-5, atol=1e-6
    )
    exact = spectra.transmission().expected(np.moveaxis(shown.line_integrals, 1, -1).astype(np.float64))
    np.testing.assert_allclose(shown.counts, np.moveaxis(exact, -1, 1), rtol=3e-3)


def test_a_saved_fit_is_a_run_folder(fit, tmp_path):
    folder = fit.save(tmp_path / "run")
    np.testing.assert_array_equal(open_run(folder).gaussians.coefficients, fit.gaussians.coefficients)
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    assert set(metrics["basis"]) == set(fit.basis_names)
    assert len((folder / "log.jsonl").read_text(encoding="utf-8").splitlines()) == 3
    with pytest.raises(InputError, match="exists"):
        fit.save(folder)


def test_a_fit_is_saved_when_its_scores_fail(fit, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.runs.outcomes.volume_outcome.score_truth", lambda *_: 1 / 0)
    with pytest.warns(RuntimeWarning, match="scoring against the truth failed.*the model and its volumes are written"):
        folder = fit.save(tmp_path / "run")
    assert set(json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["failed"]) == {
        "scoring against the truth"
    }
    np.testing.assert_array_equal(open_run(folder).gaussians.centres, fit.gaussians.centres)


def test_bases_are_chosen_by_name(path):
    fit = recon.fit(path, SHORT, bases=("compton", "photoelectric"), callbacks=[Watching(last=1)])
    assert fit.basis_names == ("photoelectric", "compton")
    assert fit.left_out == ("kedge_63.3",)
    with pytest.raises(InputError, match=r"no basis .bone.: choose from photoelectric, compton, kedge_63\.3"):
        recon.fit(path, SHORT, bases=("bone",))


def test_notebooks_show_a_slice_of_every_basis(fit):
    assert repr(fit).startswith("Fit(tiny.h5: ")
    assert fit._repr_html_().count("data:image/png;base64,") == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"recipe": "slow"}, "no recipe 'slow': choose from fast, best, paper"),
        ({"callbacks": [3]}, "a callback is a function"),
    ],
)
def test_mistakes_are_answered_in_a_sentence(options, words, path):
    with pytest.raises(InputError, match=words):
        recon.fit(path, **options)


def test_materials_of_a_fit_are_those_of_its_folder(path, tmp_path):
    fit = recon.fit(path, SHORT)
    found, stored = recon.segment(fit, energies=(60,)), recon.segment(fit.save(tmp_path / "run"), energies=(60,))
    assert [c.name for c in found.clusters] == [c.name for c in stored.clusters]
    np.testing.assert_array_equal(found.labels, stored.labels)
    assert found.options.energies == (60,)


def test_impossible_options_of_a_segmentation_are_refused(tmp_path):
    with pytest.raises(InputError, match="the domain must be one of"):
        recon.segment(tmp_path, domain="pixels")


def test_an_early_stop_ends_a_fit_that_no_longer_improves(path):
    fit = recon.fit(path, SHORT, callbacks=[recon.EarlyStop(patience=2, change=10.0, after=0.0)], progress=True)
    assert [entry["step"] for entry in fit.log] == [1, 2, 3, 4]
    with pytest.raises(InputError, match="patience of an early stop"):
        recon.EarlyStop(patience=0)
    with pytest.raises(InputError, match="part of the steps from 0 to 1"):
        recon.EarlyStop(after=2)


@pytest.mark.parametrize(
    ("recipe", "device", "message"),
    [
        ("fast", "cuda", "--device cuda needs a GPU"),
        ("fast", "tpu", "device must be cpu or cuda, got 'tpu'"),
        ("paper", "cuda", "--device cuda needs a GPU"),
    ],
)
def test_devices_that_are_not_there(path, recipe, device, message, monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(InputError, match=message):
        recon.fit(path, recipe, device=device)


def test_an_array_scores_as_the_model_that_it_comes_from(fit, path):
    truth = phantomgen.read_truth(path)
    of_array, of_fit = recon.score_truth(truth, fit.volume())["basis"], fit.score()["basis"]
    assert {name: of_array[name]["psnr"] for name in of_fit} == {name: of_fit[name]["psnr"] for name in of_fit}
    assert recon.score_truth(truth, truth.volumes)["basis"]["compton"]["rmse"] == 0
    with pytest.raises(InputError, match=r"shape of the true volumes.*photoelectric, compton"):
        recon.score_truth(truth, truth.volumes[0])
