"""Short ways from Python: make, plan, open, and datasets as arrays, tensors and pictures."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from support.tiny_scans import make as make_tiny

import phantomgen
from phantomgen.simulation.checks.verification import MeasuredError
from spectra.errors import InputError

SMALL = ["panel={rows: 16, columns: 24, pitch: 8}", "geometry.views=3", "geometry.test_views=1", "volume.voxels=8"]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return make_tiny(
        tmp_path_factory.mktemp("data") / "tiny.h5", "--views", "5", "--test-views", "2", rows=12, columns=16
    )


@pytest.fixture
def dataset(path):
    with phantomgen.open(path) as opened:
        yield opened


def test_importing_the_packages_imports_nothing_heavy():
    program = (
        "import sys, phantomgen, recon; print(sorted({'torch', 'numba', 'h5py', 'matplotlib'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_a_scene_becomes_an_open_dataset_with_the_seed_that_was_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr("phantomgen.simulation.run.quick_check", lambda *_: MeasuredError(0, 0, 0, 0, 0, 0, 0))
    scan = phantomgen.load("kedge-small", SMALL)
    with phantomgen.make(scan, tmp_path / "a.h5") as one, phantomgen.make(scan, tmp_path / "b.h5", seed=7) as other:
        assert one.path == tmp_path / "a.h5"
        assert one.counts.shape == other.counts.shape == (4, 4, 16, 24)
        assert not np.array_equal(one.counts[0], other.counts[0])


def test_a_plan_says_how_wrong_a_scan_will_be():
    assert phantomgen.plan(phantomgen.load("kedge-small", SMALL)).error <= 1e-3


def test_line_integrals_are_logarithms_against_the_open_beam(dataset):
    logs = dataset.line_integrals(2)
    expected = np.log(dataset.flat * dataset.exposure[2][:, None, None] / (dataset.counts[2] - dataset.dark))
    assert logs.dtype == np.float32
    np.testing.assert_allclose(logs, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(dataset.line_integrals(-1), dataset.line_integrals(6))
    with pytest.raises(InputError, match="there is no view 7"):
        dataset.line_integrals(7)


def test_named_arrays_hold_counts_with_their_coordinates(dataset):
    pytest.importorskip("xarray")
    array = dataset.to_xarray([0, 6])
    assert array.dims == ("view", "channel", "row", "column")
    np.testing.assert_array_equal(array.sel(view=6, channel="bin2"), dataset.counts[6, 2])
    assert array.split.values.tolist() == ["train", "test"]
    assert float(array.row[0]) == -float(array.row[-1])
    assert array.units == "counts"


def test_views_for_torch_are_those_of_a_split_and_survive_pickling(dataset):
    views = dataset.torch("test")
    item = views[0]
    assert (len(views), item["view"]) == (2, 5)
    np.testing.assert_array_equal(item["counts"], dataset.counts[5])
    np.testing.assert_array_equal(item["line_integrals"], dataset.line_integrals(5))
    again = pickle.loads(pickle.dumps(views))
    np.testing.assert_array_equal(again[1]["counts"], views[1]["counts"])
    with pytest.raises(InputError, match="no split 'tests': choose from train, test, val, all"):
        dataset.torch("tests")


def test_notebooks_show_a_picture_per_channel(dataset):
    shown = dataset._repr_html_()
    assert repr(dataset) in shown
    assert shown.count("data:image/png;base64,") == 4
