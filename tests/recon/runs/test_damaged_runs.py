"""A model or volumes with values that are not numbers are refused, whoever reads them."""

import json
import shutil

import h5py
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from safetensors.torch import load_file, save_file
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main

COMMANDS = {
    "volume": ("volume", "{run}", "-o", "{out}/out.h5"),
    "render": ("render", "{run}", "--like", "{scan}", "-o", "{out}/out.h5"),
    "export": ("export", "{run}", "-o", "{out}/out.ply"),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    scan = make(folder / "scan.h5", "--views", "8")
    options = ["-o", str(folder / "run"), "--sweeps", "1", "--no-figures", "--quiet"]
    result = CliRunner().invoke(main, ["fit", str(scan), *options])
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture
def run(whole, tmp_path):
    return shutil.copytree(whole / "run", tmp_path / "run")


def call(name, run, whole, out):
    words = [word.format(run=run, scan=whole / "scan.h5", out=out) for word in COMMANDS[name]]
    return CliRunner().invoke(main, words)


def damaged(run, change):
    """The model with other arrays and the same header."""
    from safetensors import safe_open

    path = run / "model.safetensors"
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    save_file(change(load_file(path)), path, header)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["centres", "coefficients"])
def test_a_model_with_values_that_are_no_numbers_is_refused(command, value, name, run, whole, tmp_path):
    def change(tensors):
        tensors[name].view(-1)[1] = value
        return tensors

    damaged(run, change)
    if command == "volume":
        (run / "volumes.h5").unlink()
    sentence = one_sentence(call(command, run, whole, tmp_path))
    assert f"model.safetensors is damaged: {name} holds a value that is not a number" in sentence
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors: tensors | {"centres": tensors["centres"][:, :2].contiguous()},
        lambda tensors: tensors | {"coefficients": tensors["coefficients"][1:].contiguous()},
        lambda tensors: tensors | {"quaternions": tensors["quaternions"].to(torch.int64)},
        lambda tensors: tensors | {"log_scales": tensors["log_scales"] + 1e6},
        lambda tensors: {name: value for name, value in tensors.items() if name != "centres"},
        lambda tensors: tensors | {"more": torch.ones(2)},
    ],
)
@pytest.mark.wrong_types
def test_arrays_that_do_not_fit_are_one_sentence(change, run, whole, tmp_path):
    damaged(run, change)
    assert "model.safetensors" in one_sentence(call("export", run, whole, tmp_path))


def test_volumes_with_values_that_are_no_numbers_are_refused(run, whole, tmp_path):
    with h5py.File(run / "volumes.h5", "r+") as file:
        file["basis/data"][0, 1, 2, 3] = np.inf
    (run / "model.safetensors").unlink()
    assert "holds a value that is not a number" in one_sentence(call("volume", run, whole, tmp_path))


@pytest.mark.parametrize("key", ["columns", "weights"])
def test_a_record_of_the_scan_with_values_that_are_no_numbers_is_refused(key, run, whole, tmp_path):
    content = json.loads((run / "scan.json").read_text())
    content["transmission"][key] = np.full(np.shape(content["transmission"][key]), np.nan).tolist()
    (run / "scan.json").write_text(json.dumps(content))
    assert "scan.json cannot be read" in one_sentence(call("render", run, whole, tmp_path))


def test_a_volume_replaces_no_dataset_and_a_dataset_no_volume(run, whole, tmp_path):
    scan = shutil.copy(whole / "scan.h5", tmp_path / "scan.h5")
    before = scan.read_bytes()
    result = CliRunner().invoke(main, ["volume", str(run), "-o", str(scan), "--overwrite"])
    assert "scan.h5 is not an HDF5 file that recon wrote; it will not be replaced" in one_sentence(result)
    assert scan.read_bytes() == before
    volumes = run / "volumes.h5"
    result = CliRunner().invoke(phantomgen, ["make", "kedge-small", "-o", str(volumes), "--overwrite"])
    assert "volumes.h5 is not a dataset; it will not be replaced" in one_sentence(result)
    result = CliRunner().invoke(main, ["volume", str(run), "-o", str(volumes), "--overwrite", "--grid", "4", "-q"])
    assert result.exit_code == 0
