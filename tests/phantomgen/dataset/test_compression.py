"""Compressed arrays are read back as they were, whoever packed them; truth in slabs is the truth."""

import sys

import h5py
import numpy as np
import pytest

from phantomgen.dataset import compression
from phantomgen.dataset import truth as dataset_truth
from phantomgen.dataset.compression import check_compression
from phantomgen.dataset.layout import new_frames, pack_image, write_image
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, NotInstalledError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 2, test_views: 0}
panel: {rows: 6, columns: 8, pitch: 4}
volume: {voxels: 12, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
  bone: {coefficients: {photoelectric: 0.02, compton: 0.03}}
objects:
  - {type: cylinder, material: water, radius: 8, length: 13}
  - {type: sphere, material: bone, radius: 5, center: [2, 1, 0]}
flats: 1
"""


def made(path, **options):
    simulate(load_scene(SceneFile("toy.yaml", SCENE)), path, **options)
    return path


@pytest.mark.parametrize("name", ["bitshuffle", "none"])
def test_compression_changes_no_value(name, tmp_path):
    if name == "bitshuffle":
        pytest.importorskip("hdf5plugin")
    paths = [made(tmp_path / f"{how}.h5", compression=how, keep_expected=True) for how in ("gzip", name)]
    assert validate(paths[1]) == []
    with open_dataset(paths[0]) as first, open_dataset(paths[1]) as second:
        assert second.counts.compression != "gzip"
        for array in ("entry/instrument/detector/data", "entry/instrument/flat/data", "truth/expected", "truth/labels"):
            assert np.array_equal(first.file[array][()], second.file[array][()])
    first, second = map(read_truth, paths)
    assert np.array_equal(first.volumes, second.volumes)
    assert np.array_equal(first.fractions, second.fractions)


@pytest.mark.parametrize("name", ["gzip", "bitshuffle", "none"])
@pytest.mark.parametrize("dtype", [np.int32, np.uint16, np.float32])
def test_packed_images_are_those_that_hdf5_reads(name, dtype, tmp_path, monkeypatch):
    if name == "bitshuffle":
        pytest.importorskip("hdf5plugin")
    monkeypatch.setattr("phantomgen.dataset.layout._CHUNK_BYTES", 700)  # several chunks, the last one not full
    images = np.random.default_rng(1).poisson(300, (2, 3, 13, 40)).astype(dtype)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        dataset = new_frames(file, "a", images.shape, dtype, "counts", name)
        assert dataset.chunks[2] < 13
        for frame, channel in np.ndindex(2, 3):
            write_image(dataset, frame, channel, pack_image(images[frame, channel], name))
        assert np.array_equal(dataset[()], images)


def test_a_missing_plugin_is_one_sentence_that_names_the_extra(tmp_path, monkeypatch):
    pytest.importorskip("hdf5plugin")
    path = made(tmp_path / "a.h5", compression="bitshuffle")
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    needs = r"needs the extra compress: pip install 'spectral-ct\[compress\]'$"
    with pytest.raises(NotInstalledError, match=f"the compression bitshuffle {needs}"):
        made(tmp_path / "b.h5", compression="bitshuffle")
    monkeypatch.setattr(compression, "_is_there", lambda number: False)
    with pytest.raises(NotInstalledError, match=f"reading .*a.h5, which is compressed by bitshuffle, {needs}"):
        open_dataset(path)
    with pytest.raises(InputError, match="there is no compression 'zip': choose from gzip, bitshuffle, none"):
        check_compression("zip")


@pytest.mark.parametrize("values", [1, 12 * 12 * 2 * 5])
def test_truth_in_slabs_is_the_truth(values, tmp_path, monkeypatch):
    whole = read_truth(made(tmp_path / "whole.h5"))
    monkeypatch.setattr(dataset_truth, "_SLAB_VALUES", values)
    slabs = read_truth(made(tmp_path / "slabs.h5"))
    # Columns are refined by what is in a slab; each estimate is within 3e-4 of a voxel.
    assert np.abs(slabs.fractions.astype(int) - whole.fractions).max() <= 6e-4 * 65535
    assert slabs.volumes == pytest.approx(whole.volumes, abs=6e-4 * 0.03)
    with open_dataset(tmp_path / "slabs.h5") as dataset:
        assert np.array_equal(dataset.file["truth/labels"][()], slabs.labels)
