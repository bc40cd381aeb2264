"""Response matrices of scene files: three kinds of file, and what is refused."""

import h5py
import numpy as np
import pytest

from phantomgen.dataset.reader import open_dataset
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: tube, kvp: 80, photons: 1.0e4, filters: [{composition: Al, thickness: 2.5}]}
detector: {type: response_matrix, file: response.csv, columns: channels, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 2}
panel: {rows: 6, columns: 8, pitch: 2}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 4
"""
ENERGY = np.arange(10.0, 91.0)
CHANNELS = np.stack([np.where(ENERGY >= 20, 0.8, 0.0), np.where(ENERGY >= 50, 0.7, 0.0)], axis=1)
AXES = "energies: {first: 10, step: 1}"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(SCENE, encoding="utf-8")
    write_csv(tmp_path / "response.csv", ["low", "high"], CHANNELS)
    np.save(tmp_path / "response.npy", CHANNELS)
    with h5py.File(tmp_path / "response.h5", "w") as file:
        file["czt/response"] = CHANNELS
    return tmp_path


def write_csv(path, names, matrix):
    lines = [",".join(map(str, ["energy", *names])), *(",".join(map(str, row)) for row in np.c_[ENERGY, matrix])]
    path.write_text("\n".join(lines), encoding="utf-8")


def load(folder, detector=None):
    overrides = [] if detector is None else [f"detector={{type: response_matrix, thresholds: [20, 50], {detector}}}"]
    return load_scene(folder / "scene.yaml", overrides)


@pytest.mark.parametrize("name", ["response.npy", "'response.h5:/czt/response'"])
def test_all_kinds_of_files_give_the_same_detector(folder, name):
    table = load(folder).detector
    other = load(folder, f"file: {name}, columns: channels, {AXES}").detector
    np.testing.assert_array_equal(other.energy, table.energy)
    np.testing.assert_array_equal(other.counts, CHANNELS)
    np.testing.assert_array_equal(table.counts, CHANNELS)


@pytest.mark.parametrize("per", ["bin", "keV"])
def test_deposited_energies_come_with_thresholds(folder, per):
    deposited = np.arange(0.5, 91, 0.5)
    pulses = np.eye(len(deposited))[19:180:2] * 1.5  # every photon counts one and a half times at its own energy
    write_csv(folder / "response.csv", deposited, pulses)
    table = load(folder, f"file: response.csv, columns: deposited, per: {per}").detector
    np.save(folder / "response.npy", pulses)
    declared = f"file: response.npy, columns: deposited, per: {per}, {AXES}, deposited: {{first: 0.5, step: 0.5}}"
    np.testing.assert_allclose(load(folder, declared).detector.counts, table.counts)
    factor = 1.5 if per == "bin" else 0.75
    np.testing.assert_allclose(table.counts.sum(axis=1)[ENERGY > 20.5], factor)
    assert table.counts[ENERGY < 20].max() == 0


def test_a_scan_counts_what_the_table_says(folder):
    simulate(load(folder), folder / "scan.h5", keep_expected=True)
    with open_dataset(folder / "scan.h5") as dataset:
        spectra, flat = dataset.spectra, dataset.flat
    np.testing.assert_allclose(spectra.response[1, spectra.energy > 50], 0.7)
    level = spectra.weights.sum(axis=1)
    np.testing.assert_allclose(flat.mean(axis=(1, 2)), level, atol=5 * np.sqrt(level.max() / 48 / 4))


@pytest.mark.parametrize(
    ("detector", "words"),
    [
        ("file: none.csv, columns: channels", "none.csv: the file cannot be read: No such file"),
        ("file: none.npy, columns: channels, energies: {first: 1, step: 1}", "none.npy: there is no such file"),
        ("file: response.txt, columns: channels, energies: {first: 1, step: 1}", "a response matrix is a .csv or .npy"),
        (f"file: 'response.h5:/czt', columns: channels, {AXES}", "there is no dataset /czt"),
        ("file: response.npy, columns: channels", "energies is missing: write energies: {first: 1, step: 1}"),
        (f"file: response.csv, columns: channels, {AXES}", "a CSV file has its energies in its first column"),
        ("file: response.csv, columns: deposited", "per, which is bin or keV, belongs to columns: deposited"),
        ("file: response.csv, columns: channels, per: bin", "per, which is bin or keV, belongs to columns: deposited"),
        ("file: response.csv, columns: deposited, per: bin", "'low' in line 1, column 2 is not a number"),
        (f"file: response.npy, columns: deposited, per: bin, {AXES}", "deposited, such as"),
        (
            "file: response.npy, columns: channels, energies: {first: 0, step: 0.9}",
            "ends at 72 keV, but the source at 80",
        ),
        ("file: response.csv", "columns - is missing"),
    ],
)
def test_undeclared_and_impossible_files_are_refused(folder, detector, words):
    with pytest.raises(SceneError) as caught:
        load(folder, detector)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_channel_of_zeros_is_refused(folder):
    write_csv(folder / "response.csv", ["low", "high"], CHANNELS * [1, 0])
    with pytest.raises(SceneError, match=r"scene.yaml:4:\d+: detector - channel bin1 \[50, 80\] keV sees no photons"):
        load(folder)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("energy,a,b\n10,0.1\n", "line 2 has 2 columns, the first one 3"),
        ("energy,a,b\n10,0.1,x\n", "'x' in line 2, column 3 is not a number"),
        ("energy,a,b\n", "needs a line with the names of its columns"),
        ("energy,a,b\n10,1,1\n90,1,nan\n", "got nan in row 1, column 1"),
        ("energy,a,b\n10,1,1\n90,1,-1\n", "got -1 in row 1, column 1"),
        ("energy,a\n10,1\n90,1\n", "has shape (2, 1), expected (2, 2)"),
    ],
)
def test_damaged_tables_are_refused(folder, text, words):
    (folder / "response.csv").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load(folder)
    assert words in str(caught.value)
    assert "response.csv: " in str(caught.value)
