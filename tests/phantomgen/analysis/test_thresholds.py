from itertools import combinations

import numpy as np
import pytest

from phantomgen.analysis import thresholds
from phantomgen.analysis.single_ray import BEHIND, SingleRayBound, layers_of
from phantomgen.analysis.thresholds import TRACE, choose_thresholds
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from spectra.errors import InputError

KEDGE = SceneFile.preset("kedge-small")


@pytest.fixture(scope="module")
def choice():
    return choose_thresholds(KEDGE, "kedge_63.3")


@pytest.mark.parametrize(("basis", "channels"), [("kedge_63.3", 4), ("compton", 3), ("photoelectric", 4)])
def test_no_other_thresholds_are_better(basis, channels, monkeypatch):
    # On 3 keV steps all choices can be tried: some 12 thousand.
    monkeypatch.setattr(thresholds, "STEP", 3.0)
    found = choose_thresholds(KEDGE, basis, channels)
    candidates = found.candidates
    every = combinations(range(1, len(candidates.thresholds)), channels - 1)
    rows = np.array([(0, *row) for row in every])
    assert found.bound == pytest.approx(candidates.bounds(rows).min(), rel=1e-12)


def test_the_bound_is_that_of_the_scene_with_the_thresholds_put_in(choice):
    scan = load_scene("kedge-small", [f"detector.thresholds={choice.thresholds}"])
    point = SingleRayBound.of(scan, layers_of(BEHIND, scan), {"kedge_63.3": TRACE})
    assert choice.bound == pytest.approx(point.bounds[2], rel=1e-5)
    assert choice.bound < choice.old_bound


def test_a_threshold_lies_on_the_edge_and_the_lowest_one_stays(choice):
    assert choice.thresholds[0] == 20
    assert 63.3 in choice.thresholds


def test_old_thresholds_off_the_grid_are_never_made_worse():
    file = SceneFile.preset("kedge-small", ["detector.thresholds=[21.3, 43.61, 63.3, 77.77]"])
    found = choose_thresholds(file, "kedge_63.3")
    assert found.thresholds[0] == 21.3
    assert found.bound <= found.old_bound * (1 + 1e-6)


def test_more_channels_see_better(choice):
    bounds = [choose_thresholds(KEDGE, "kedge_63.3", n).bound for n in (3, 5, 6)]
    assert bounds[0] > choice.bound > bounds[1] > bounds[2]


def test_the_same_scene_gives_the_same_thresholds(choice):
    assert choose_thresholds(KEDGE, "kedge_63.3").thresholds == choice.thresholds


def test_one_energy_has_no_bound_and_no_traceback():
    file = SceneFile.preset("kedge-small", ["source={type: monochromatic, energy: 100, photons: 1000}"])
    found = choose_thresholds(file, "compton")
    assert found.to_dict()["new"]["bound"] is None
    assert "unbounded" in found.text


@pytest.mark.parametrize(
    ("basis", "channels", "words"),
    [
        ("kedge", None, "no basis function 'kedge'; did you mean 'kedge_63.3'"),
        ("compton", 2, "2 channels cannot tell 3 basis functions apart: choose 3 to"),
        ("compton", 999, "999 channels"),
    ],
)
def test_impossible_wishes_are_refused(basis, channels, words):
    with pytest.raises(InputError, match=words):
        choose_thresholds(KEDGE, basis, channels)


def test_many_channels_are_found_too(monkeypatch):
    monkeypatch.setattr(thresholds, "_STARTS", 1)
    found = choose_thresholds(KEDGE, "kedge_63.3", 30)
    assert len(set(found.thresholds)) == 30
    assert found.bound < found.old_bound
